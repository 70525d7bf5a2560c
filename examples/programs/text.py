"""Text and plots: a font with kerning, clip rectangles, bars and lines; three draws."""

from __future__ import annotations

import numpy as np

import rhi
from renderer.layers.canvas import Canvas, Font, srgb
from rhi_screen import save_image

VERSE = """Im Anfang war die Tat.
Ægir, Þór & Ærø? Kerning: AVATAR, To, LT.
\ttab\t123.45\ttab\t-6.7"""


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw a panel of text, the same text larger and cut off, and a plot."""
    width, height = size
    canvas = Canvas(device, Font.load(14))
    canvas.rect(10, 10, width - 20, height // 2 - 15, srgb("#16222e"))
    canvas.outlines([(10, 10, width - 20, height // 2 - 15)], srgb("#57c785"))
    _, bottom = canvas.text(20, 18, VERSE, srgb("#ffffff"))
    with canvas.clip(20, bottom + 24, width // 2, 34):
        canvas.text(20, bottom + 24, "cut off at the edges of its rectangle", srgb("#e8b64c"), scale=2)
    measured = canvas.measure("right-aligned")[0]
    canvas.text(width - 20 - measured, height // 2 - 28, "right-aligned", srgb("#8fb8de"))
    x = np.arange(10, width - 10, 4, dtype=np.float64)
    y = height * 0.75 - np.sin(x / 23) * np.cos(x / 71) * height * 0.18
    canvas.rects(np.stack([x, y, np.full(len(x), 3), height - 10 - y], axis=-1), srgb("#27506b"))
    points = np.stack([x, y], axis=-1)
    canvas.lines(np.stack([points[:-1], points[1:]], axis=1), srgb("#e86a5c"), width=2)
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    with device.render_pass(image, clear=(0.004, 0.006, 0.01, 1)):
        canvas.draw(size)
    return image


if __name__ == "__main__":
    save_image(render)
