"""Code that type checkers must accept: a shader, its structs, and a typed draw call with its bindings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, ParamSpec, assert_type

import numpy as np

from rhi import Format
from rhi.shading import (
    Array,
    Flat,
    FragmentDepth,
    Image2D,
    ImageBinding,
    Shader,
    Storage,
    StorageRange,
    StorageRW,
    Struct,
    Texture2D,
    TextureBinding,
    Uniform,
    UniformRange,
    array,
    atomic_add,
    discard,
    dot,
    function,
    global_id,
    image,
    ivec2,
    ivec3,
    mat3,
    mat4,
    max,
    mix,
    normalize,
    shared,
    uint,
    vec2,
    vec3,
    vec4,
)

P = ParamSpec("P")


class Program(Generic[P]):
    pass


class Device:
    def program(self, shader: Callable[P, Shader]) -> Program[P]:
        return Program()

    def draw(
        self, program: Program[P], mesh: object, instances: int = 1, *args: P.args, **bindings: P.kwargs
    ) -> None:
        pass


class Light(Struct):
    position: vec3
    power: float
    flags: uint
    weights: Array[float] = array(float, 4)


class Corner(Struct):
    position: vec2
    color: vec3


class Varying(Struct):
    clip: vec4
    color: vec3
    id: Flat[uint]


class Output(Struct):
    color: vec4
    depth: FragmentDepth


@function
def lambert(n: vec3, light: vec3) -> float:
    return max(dot(n, light), 0)


class Lit(Shader):
    work_group = (64,)
    strength = 0.5
    partial = shared(float, 64)
    total = shared(uint)
    light: Uniform[Light]
    lights: Storage[Light]
    counts: StorageRW[uint]
    albedo: Texture2D
    target: Image2D = image(Format.RGBA8)

    def vertex(self, v: Corner) -> Varying:
        assert_type(self.light, Light)
        assert_type(self.light.position, vec3)
        assert_type(v.position.yx, vec2)
        assert_type(v.color.rgb * 2.0, vec3)
        assert_type(2 * v.color / 3 + 1, vec3)
        assert_type(min(v.color, v.color.bgr), vec3)
        assert_type(min(ivec2(1, 2), ivec2(2, 1)), ivec2)
        assert_type(mat4(1.0) @ vec4(v.position, 0.5, 1), vec4)
        assert_type(mat3(1.0) @ mat3(mat4(1.0)), mat3)
        assert_type(ivec2(7, 2) // 2 % 5, ivec2)
        assert_type(ivec2(7, 2) / 2, vec2)
        return Varying(clip=vec4(v.position, 0.5, 1.0), color=v.color, id=uint(3))

    def fragment(self, v: Varying) -> Output:
        assert_type(self.lights[0].position.x, float)
        assert_type(self.lights[0].flags & 1, uint)
        assert_type(len(self.lights), int)
        assert_type(self.albedo.sample(v.color.xy), vec4)
        assert_type(self.albedo.load(ivec2(1, 2), level=1), vec4)
        assert_type(mix(v.color, vec3(1), 0.5), vec3)
        if v.color.x < 0.5:
            discard()
        shade = lambert(normalize(v.color), self.light.position) * self.strength
        return Output(color=vec4(v.color * shade, 1.0), depth=0.5)

    def count(self) -> None:
        assert_type(global_id(), ivec3)
        old = atomic_add(self.counts[0], 1)
        assert_type(old, uint)
        self.counts[old] = 3
        self.partial[0] = 1.5
        self.total = old << 2
        self.target.store(global_id().xy, vec4(0))
        stack = array(int, 8)
        assert_type(stack[0], int)


def use(
    device: Device,
    light: UniformRange[Light],
    lights: StorageRange[Light],
    counts: StorageRange[uint],
    texture: TextureBinding,
    target: ImageBinding,
) -> None:
    lit = device.program(Lit)
    device.draw(lit, None, light=light, lights=lights, counts=counts, albedo=texture, target=target)
    device.draw(lit, None, 3, light=light, lights=lights, counts=counts, albedo=texture, target=target)
    Light(position=(0, 1, 0), power=1, flags=3, weights=[1, 2, 3, 4])
    value = Light(position=np.zeros(3), power=1.5, flags=uint(3), weights=np.zeros(4))
    value.position = (1, 2, 3)
    rows: np.ndarray[Any, np.dtype[Any]] = np.zeros(4, Light.dtype)
    assert_type(value.position.x, float)
    del rows
