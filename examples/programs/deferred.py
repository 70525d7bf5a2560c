"""Deferred shading: one pass stores what is seen, and one draw adds 200 lights to the pixels that they reach.

A light is a cube of its range. Its back faces are drawn, where they lie behind what is seen.
"""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi import BlendFunction, CullMode, DepthFunction, DepthWrite, Format
from rhi.math import look_at, make_cube, perspective
from rhi_screen import save_image

LIGHTS = 200


class Vertex(sl.Struct):
    position: sl.vec3
    normal: sl.vec3


class Camera(sl.Struct):
    view_projection: sl.mat4


class Box(sl.Struct):
    position: sl.vec3
    size: sl.vec3
    color: sl.vec3


class Light(sl.Struct):
    position: sl.vec3
    range: float
    color: sl.vec3


class Surface(sl.Struct):
    clip: sl.vec4
    position: sl.vec3
    normal: sl.vec3
    color: sl.vec3


class Stored(sl.Struct):
    image: sl.vec4
    position: sl.vec4
    normal: sl.vec4
    color: sl.vec4


class Volume(sl.Struct):
    clip: sl.vec4
    light: int


class Geometry(sl.Shader):
    """Stores position, normal and color, and begins the image with the light of the sky."""

    camera: sl.Uniform[Camera]
    boxes: sl.Storage[Box]

    def vertex(self, v: Vertex) -> Surface:
        box = self.boxes[sl.instance_index()]
        position = v.position * box.size + box.position
        clip = self.camera.view_projection @ sl.vec4(position, 1.0)
        return Surface(clip=clip, position=position, normal=v.normal, color=box.color)

    def fragment(self, s: Surface) -> Stored:
        dark = sl.vec4(s.color * (0.02 + 0.02 * max(s.normal.y, 0.0)), 1.0)
        return Stored(
            image=dark,
            position=sl.vec4(s.position, 1.0),
            normal=sl.vec4(s.normal, 0.0),
            color=sl.vec4(s.color, 1.0),
        )


class Lighting(sl.Shader):
    """Adds one light to the pixels in its cube."""

    camera: sl.Uniform[Camera]
    lights: sl.Storage[Light]
    stored_positions: sl.Texture2D
    normals: sl.Texture2D
    colors: sl.Texture2D

    def vertex(self, v: Vertex) -> Volume:
        light = self.lights[sl.instance_index()]
        position = sl.vec4(v.position * light.range + light.position, 1.0)
        return Volume(clip=self.camera.view_projection @ position, light=sl.instance_index())

    def fragment(self, v: Volume) -> sl.vec4:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        light = self.lights[v.light]
        to_light = light.position - self.stored_positions.load(at).xyz
        near = max(1.0 - sl.length(to_light) / light.range, 0.0)
        facing = max(sl.dot(self.normals.load(at).xyz, sl.normalize(to_light)), 0.0)
        return sl.vec4(self.colors.load(at).rgb * light.color * (facing * near * near), 0.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the geometry, then all lights in one draw."""
    rng = np.random.default_rng(3)
    boxes, lights = np.zeros(401, Box.dtype), np.zeros(LIGHTS, Light.dtype)
    boxes[0] = ((0, -0.5, 0), (20, 0.5, 20), (0.8, 0.8, 0.8))
    boxes["size"][1:] = rng.uniform(0.15, 0.6, (400, 3))
    boxes["position"][1:] = rng.uniform(-14, 14, (400, 3)) * (1, 0, 1) + boxes["size"][1:] * (0, 1, 0)
    boxes["color"][1:] = rng.uniform(0.3, 1, (400, 3))
    lights["position"] = rng.uniform((-14, 0.3, -14), (14, 1.5, 14), (LIGHTS, 3))
    lights["range"], lights["color"] = 3.0, rng.uniform(0, 2.5, (LIGHTS, 3))
    positions, normals, _, indices = make_cube()
    cube = device.mesh({"position": positions, "normal": normals}, indices)
    camera = device.uniform(
        Camera(
            view_projection=perspective(np.radians(50), size[0] / size[1]) @ look_at((11, 8, 13), (0, -1, 0))
        )
    )
    stored_positions, stored, colors = (
        device.texture(size, f) for f in (Format.RGBA32F, Format.RGBA16F, Format.RGBA8)
    )
    image, depth = device.texture(size, Format.RGBA8_SRGB), device.texture(size, Format.D32F)
    with device.render_pass(
        [image, stored_positions, stored, colors], depth, clear=(0, 0, 0, 0), clear_depth=0.0
    ):
        device.draw(
            device.program(Geometry), cube, len(boxes), camera=camera, boxes=device.storage(Box, boxes)
        )
    behind = device.states(DepthWrite.OFF, BlendFunction.ADDITIVE, CullMode.FRONT, DepthFunction.LESS_EQUAL)
    with (
        device.render_pass(image, depth),
        behind,
    ):  # depth is reversed: back faces that lie behind what is seen
        device.draw(
            device.program(Lighting),
            cube,
            LIGHTS,
            camera=camera,
            lights=device.storage(Light, lights),
            stored_positions=stored_positions,
            normals=stored,
            colors=colors,
        )
    return image


if __name__ == "__main__":
    save_image(render)
