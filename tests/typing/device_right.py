"""Correct use of the device, for mypy --strict; `test_device_typing` breaks it line by line."""

from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi import (
    Access,
    BlendFunction,
    ColorWrite,
    CullMode,
    DepthWrite,
    Filter,
    Format,
    Primitive,
    SamplerDescriptor,
)
from rhi.shading import Shader, Storage, Struct, Texture2D, Uniform, mat4, vec2, vec4


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4


class Other(Struct):
    color: vec4


class Flat(Shader):
    tint: Uniform[Tint]
    many: Storage[Tint]
    albedo: Texture2D

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.tint.color


class Plain(Shader):
    def compute(self) -> None:
        pass


class ScalingShader(Shader):
    scale: Uniform[float]
    turn: Uniform[mat4]

    def compute(self) -> None:
        pass


def use(device: rhi.Device) -> None:
    flat, plain = device.program(Flat), device.program(Plain)
    mesh = device.mesh({"position": np.zeros((3, 2), np.float32)}, primitive=Primitive.QUADS)
    tint = device.uniform(Tint(color=(1, 0, 0, 1)))
    other = device.uniform(Other(color=(1, 0, 0, 1)))
    objects = device.uniform_array(Tint, 4)
    many = device.storage(Tint, 4)
    image = device.texture((8, 8), Format.RGBA8)
    smooth = device.sampler(SamplerDescriptor(magnify=Filter.LINEAR))
    assert_type(image.samples, int)
    assert_type(many.count, int)
    with device.render_pass(image, clear=(0, 0, 0, 1)):
        with device.states(CullMode.NONE, DepthWrite.OFF, ColorWrite.OFF.at(1), BlendFunction.ALPHA):
            device.draw(flat, mesh, tint=tint, many=many, albedo=image)
            device.draw(flat, mesh, tint=Tint(color=(0, 0, 0, 0)), many=many, albedo=image)
            device.draw(flat, mesh, tint={"color": (0, 0, 0, 0)}, many=many, albedo=image)
        flat.draw(mesh, 2, tint=objects[0], many=many, albedo=image.sampled(smooth))
        flat.draw(mesh, tint=objects[1], many=many, albedo=image)
        passing = device.transient.mesh(flat, np.zeros(3, Corner.dtype))
        device.draw(flat, passing, tint=objects[1], many=many, albedo=image)
        brief = device.transient.storage(Tint, 4)
        device.draw(flat, passing.view(0, 3), tint=objects[1], many=brief, albedo=image)
        device.draw_many(flat, passing, passing.draws(), tint=tint, many=brief, albedo=image)
        device.draw_many(flat, mesh, mesh.draws(), tint=tint, many=many, albedo=image)
        counted = device.query_set(2)
        device.draw_counted(flat, mesh, mesh.draws(), counted, [1], tint=tint, many=many, albedo=image)
        device.draw_conditional(flat, mesh, mesh.draws(), counted, [1], tint=tint, many=many, albedo=image)
        assert_type(counted.wait(), NDArray[np.int64])
        with device.immediate(flat, Primitive.QUADS, tint=tint, many=many, albedo=image) as quads:
            quads.vertex(position=(0, 0))
    device.dispatch(plain, (1, 1, 1))
    device.dispatch(
        device.program(ScalingShader), 1, scale=device.uniform(0.5), turn=device.transient.uniform(np.eye(4))
    )
    with device.record() as commands, commands.render_pass(image), commands.states(CullMode.NONE):
        constants = commands.transient.uniform(Tint(color=(0, 0, 0, 1)))
        commands.draw(flat, mesh, 3, tint=constants, many=many, albedo=image)
    device.submit(commands)
    with many.lock(Access.WRITE, 0, 2) as rows:
        rows["color"] = 1
    tint.write(Tint(color=(0, 0, 0, 0)))
    query = device.occlusion_query()
    with device.conditional(query):
        assert_type(query.visible_samples, int)
    assert_type(device.signal(), int)
    other.destroy()
