"""A triangle with a color at each corner."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.shading import Shader, Struct, vec2, vec3, vec4
from rhi_screen import save_image


class Corner(Struct):
    position: vec2
    color: vec3


class Colored(Struct):
    clip: vec4
    color: vec3


class Triangle(Shader):
    """Interpolates the colors of the corners."""

    def vertex(self, v: Corner) -> Colored:
        return Colored(clip=vec4(v.position, 0.5, 1.0), color=v.color)

    def fragment(self, v: Colored) -> vec4:
        return vec4(v.color, 1.0)


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the triangle."""
    corners = [((-0.8, -0.8), (1, 0, 0)), ((0.8, -0.8), (0, 1, 0)), ((0.0, 0.8), (0, 0, 1))]
    mesh = device.mesh(np.array(corners, Corner.dtype))
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    with device.render_pass(image, clear=(0.02, 0.02, 0.03, 1)):
        device.draw(device.program(Triangle), mesh)
    return image


if __name__ == "__main__":
    save_image(render)
