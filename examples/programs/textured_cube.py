"""A cube with a texture, mip levels, a depth buffer and a matrix."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.math import look_at, make_cube, perspective
from rhi.shading import Shader, Struct, Texture2D, Uniform, dot, mat4, normalize, vec2, vec3, vec4
from rhi_screen import save_image


class Camera(Struct):
    view_projection: mat4


class Vertex(Struct):
    position: vec3
    normal: vec3
    uv: vec2


class Surface(Struct):
    clip: vec4
    normal: vec3
    uv: vec2


class TexturedCube(Shader):
    """A texture, lit by one direction."""

    camera: Uniform[Camera]
    albedo: Texture2D

    def vertex(self, v: Vertex) -> Surface:
        return Surface(clip=self.camera.view_projection @ vec4(v.position, 1.0), normal=v.normal, uv=v.uv)

    def fragment(self, s: Surface) -> vec4:
        light = 0.2 + 0.8 * max(dot(normalize(s.normal), normalize(vec3(0.5, 0.9, 0.7))), 0.0)
        return vec4(self.albedo.sample(s.uv).rgb * light, 1.0)


def make_tiles(size: int = 64) -> np.ndarray:
    """Return (size, size, 4) texels: tiles with dark joints."""
    y, x = np.mgrid[0:size, 0:size]
    joint = (x % 16 < 2) | (y % 16 < 2)
    odd = (x // 16 + y // 16) % 2 == 1
    color = np.where(odd[..., None], (230, 130, 60, 255), (240, 225, 190, 255))
    return np.where(joint[..., None], (40, 35, 30, 255), color).astype(np.uint8)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the cube."""
    positions, normals, uvs, indices = make_cube()
    mesh = device.mesh({"position": positions, "normal": normals, "uv": uvs}, indices)
    albedo = device.texture(make_tiles(), rhi.Format.RGBA8_SRGB, levels=None)
    view_projection = perspective(np.radians(45), size[0] / size[1]) @ look_at((3, 2.2, 3.4), (0, 0, 0))
    camera = device.uniform(Camera(view_projection=view_projection))
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    depth = device.texture(size, rhi.Format.D32F)
    with device.render_pass(image, depth, clear=(0.05, 0.08, 0.12, 1), clear_depth=0.0):
        device.draw(device.program(TexturedCube), mesh, camera=camera, albedo=albedo)
    return image


if __name__ == "__main__":
    save_image(render)
