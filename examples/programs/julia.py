"""A Julia set: a loop of any length per pixel, and a palette in a texture."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.shading import FullScreen, Struct, Texture2D, Uniform, dot, fragment_coordinate, log2, vec2, vec4
from rhi_screen import save_image


class Fractal(Struct):
    size: vec2
    constant: vec2
    zoom: float


class Julia(FullScreen):
    """Counts the steps until z² + c escapes, with a fraction, so that no bands show."""

    fractal: Uniform[Fractal]
    palette: Texture2D

    def fragment(self) -> vec4:
        z = (fragment_coordinate().xy - self.fractal.size * 0.5) / self.fractal.size.y * self.fractal.zoom
        count = 0.0
        for _ in range(200):
            z = vec2(z.x * z.x - z.y * z.y, 2.0 * z.x * z.y) + self.fractal.constant
            if dot(z, z) > 256.0:
                break
            count += 1.0
        color = vec4(0.0, 0.0, 0.0, 1.0)
        if count < 200.0:
            smooth = count - log2(log2(dot(z, z)) * 0.5)
            color = self.palette.sample_lod(vec2(smooth / 64.0, 0.5), 0.0)
        return color


def make_palette(count: int = 256) -> np.ndarray:
    """Return (1, count, 4) texels that repeat smoothly."""
    t = np.arange(count) / count
    rows = [0.5 + 0.5 * np.cos(2 * np.pi * (t + phase)) for phase in (0.0, 0.1, 0.2)]
    return (np.stack([*rows, np.ones(count)], axis=-1) * 255).astype(np.uint8)[None]


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw one triangle that covers the image."""
    image = device.texture(size, rhi.Format.RGBA8)
    palette = device.texture(make_palette(), rhi.Format.RGBA8)
    fractal = device.uniform(Fractal(size=size, constant=(-0.8, 0.156), zoom=2.6))
    with device.render_pass(image):
        device.draw(device.program(Julia), device.mesh(3), fractal=fractal, palette=palette)
    return image


if __name__ == "__main__":
    save_image(render)
