"""Lissajous figures in immediate mode: line strips whose vertices are written each frame."""

from __future__ import annotations

import numpy as np

import rhi
from rhi import BlendFunction, Primitive
from rhi.shading import Shader, Struct, vec2, vec4
from rhi_screen import save_image

POINTS = 600


class Corner(Struct):
    position: vec2
    color: vec4


class Colored(Struct):
    clip: vec4
    color: vec4


class Line(Shader):
    """Lines with a color at each point."""

    def vertex(self, v: Corner) -> Colored:
        return Colored(clip=vec4(v.position, 0.5, 1.0), color=v.color)

    def fragment(self, v: Colored) -> vec4:
        return v.color


def make_curve(a: int, b: int, center: tuple[float, float], radius: float) -> np.ndarray:
    """Return POINTS points of the figure with frequencies a and b."""
    t = np.linspace(0, 2 * np.pi, POINTS)
    rows = np.zeros(POINTS, Corner.dtype)
    rows["position"][:, 0] = center[0] + radius * np.sin(a * t)
    rows["position"][:, 1] = center[1] + radius * np.sin(b * t + 0.7)
    rows["color"] = 1
    rows["color"][:, :3] = 0.6 + 0.4 * np.sin(t[:, None] + (0, 2, 4))
    return rows


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw nine figures."""
    image = device.texture(size, rhi.Format.RGBA8)
    program = device.program(Line)
    with device.render_pass(image, clear=(0.03, 0.03, 0.05, 1)), device.states(BlendFunction.ADDITIVE):
        for row in range(3):
            for column in range(3):
                center = ((column - 1) * 0.65, (1 - row) * 0.65)
                with device.immediate(program, Primitive.LINE_STRIP) as strip:
                    strip.vertices(make_curve(column + 1, row + 2, center, 0.28))
    return image


if __name__ == "__main__":
    save_image(render)
