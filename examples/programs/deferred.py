"""Deferred shading: one pass stores what is seen, and one draw adds 200 lights to the pixels that they reach.

A light is a cube of its range. Its back faces are drawn, where they lie behind what is seen.
"""

from __future__ import annotations

import numpy as np

import rhi
from rhi import BlendFunction, CullMode, DepthFunction, DepthWrite, Format
from rhi.math import look_at, make_cube, perspective
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    Uniform,
    dot,
    fragment_coordinate,
    instance_index,
    ivec2,
    length,
    mat4,
    normalize,
    vec3,
    vec4,
)
from rhi_screen import save_picture

LIGHTS = 200


class Vertex(Struct):
    position: vec3
    normal: vec3


class Camera(Struct):
    view_projection: mat4


class Box(Struct):
    place: vec3
    size: vec3
    color: vec3


class Light(Struct):
    place: vec3
    range: float
    color: vec3


class Surface(Struct):
    clip: vec4
    place: vec3
    normal: vec3
    color: vec3


class Stored(Struct):
    image: vec4
    place: vec4
    normal: vec4
    color: vec4


class Volume(Struct):
    clip: vec4
    light: int


class Geometry(Shader):
    """Stores position, normal and color, and begins the picture with the light of the sky."""

    camera: Uniform[Camera]
    boxes: Storage[Box]

    def vertex(self, v: Vertex) -> Surface:
        box = self.boxes[instance_index()]
        place = v.position * box.size + box.place
        clip = self.camera.view_projection @ vec4(place, 1.0)
        return Surface(clip=clip, place=place, normal=v.normal, color=box.color)

    def fragment(self, s: Surface) -> Stored:
        dark = vec4(s.color * (0.02 + 0.02 * max(s.normal.y, 0.0)), 1.0)
        return Stored(image=dark, place=vec4(s.place, 1.0), normal=vec4(s.normal, 0.0), color=vec4(s.color, 1.0))


class Lighting(Shader):
    """Adds one light to the pixels in its cube."""

    camera: Uniform[Camera]
    lights: Storage[Light]
    places: Texture2D
    normals: Texture2D
    colors: Texture2D

    def vertex(self, v: Vertex) -> Volume:
        light = self.lights[instance_index()]
        place = vec4(v.position * light.range + light.place, 1.0)
        return Volume(clip=self.camera.view_projection @ place, light=instance_index())

    def fragment(self, v: Volume) -> vec4:
        at = ivec2(fragment_coordinate().xy)
        light = self.lights[v.light]
        to_light = light.place - self.places.load(at).xyz
        near = max(1.0 - length(to_light) / light.range, 0.0)
        facing = max(dot(self.normals.load(at).xyz, normalize(to_light)), 0.0)
        return vec4(self.colors.load(at).rgb * light.color * (facing * near * near), 0.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the geometry, then all lights in one draw."""
    rng = np.random.default_rng(3)
    boxes, lights = np.zeros(401, Box.dtype), np.zeros(LIGHTS, Light.dtype)
    boxes[0] = ((0, -0.5, 0), (20, 0.5, 20), (0.8, 0.8, 0.8))
    boxes["size"][1:] = rng.uniform(0.15, 0.6, (400, 3))
    boxes["place"][1:] = rng.uniform(-14, 14, (400, 3)) * (1, 0, 1) + boxes["size"][1:] * (0, 1, 0)
    boxes["color"][1:] = rng.uniform(0.3, 1, (400, 3))
    lights["place"] = rng.uniform((-14, 0.3, -14), (14, 1.5, 14), (LIGHTS, 3))
    lights["range"], lights["color"] = 3.0, rng.uniform(0, 2.5, (LIGHTS, 3))
    positions, normals, _, indices = make_cube()
    cube = device.mesh({"position": positions, "normal": normals}, indices)
    camera = device.uniform(
        Camera(view_projection=perspective(np.radians(50), size[0] / size[1]) @ look_at((11, 8, 13), (0, -1, 0)))
    )
    places, stored, colors = (device.texture(size, f) for f in (Format.RGBA32F, Format.RGBA16F, Format.RGBA8))
    image, depth = device.texture(size, Format.RGBA8_SRGB), device.texture(size, Format.D32F)
    with device.render_pass([image, places, stored, colors], depth, clear=(0, 0, 0, 0), clear_depth=0.0):
        device.draw(device.program(Geometry), cube, len(boxes), camera=camera, boxes=device.storage(Box, boxes))
    behind = device.states(DepthWrite.OFF, BlendFunction.ADDITIVE, CullMode.FRONT, DepthFunction.LESS_EQUAL)
    with device.render_pass(image, depth), behind:  # depth is reversed: back faces that lie behind what is seen
        device.draw(
            device.program(Lighting),
            cube,
            LIGHTS,
            camera=camera,
            lights=device.storage(Light, lights),
            places=places,
            normals=stored,
            colors=colors,
        )
    return image


if __name__ == "__main__":
    save_picture(render)
