"""Drawing in 2D with few draws: rectangles, outlines, lines and text in pixels, for overlays and interfaces.

font = Font.load()                                       # an atlas of Latin-1, made with Pillow
canvas = Canvas(device, font)
canvas.rect(8, 8, 120, 40, srgb("#102030", alpha=0.7))
canvas.text(16, 16, "frame\t12.5 ms", srgb("#ffffff"))
with device.render_pass(image):
    canvas.draw(image.size)                              # one upload, one draw for each clip rectangle
"""

from renderer.layers.canvas.canvas import Canvas, srgb
from renderer.layers.canvas.font import BOX, MONOSPACED, Font
from renderer.layers.canvas.text import TextLayout, lay_out

__all__ = ["BOX", "MONOSPACED", "Canvas", "Font", "TextLayout", "lay_out", "srgb"]
