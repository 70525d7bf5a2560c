"""The canvas: collects what is drawn in 2D, and draws it through the device's transient memory.

Everything is a parallelogram with a piece of the font's atlas on it: a glyph has its own, a rectangle or a
line the corner of full coverage. So whatever is drawn between two changes of the clip rectangle is one draw,
in the order of the calls. A parallelogram is 48 bytes, which the vertex stage reads by its index: a third of
what four vertices and their indices would take.

The arrays are kept from frame to frame and grow by doubling; a frame is one upload to the device's rings, and
16 bytes of constants.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

import rhi.shading as sl
from renderer.layers.canvas.font import WHITE, Font
from renderer.layers.canvas.text import TextLayout, lay_out
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Device, Format, Scissor, from_srgb
from rhi.math.indexing import repeat_each

_CAPACITY: Final = 1024  # parallelograms at first
_CORNERS: Final = 6  # of the two triangles

Clip = tuple[int, int, int, int]


class CanvasQuad(sl.Struct):
    """A parallelogram in pixels: a corner and the edges from there, a rectangle of the atlas, and a colour.

    `texels` is its top left and its size, each with x in the lower 16 bits and y in the upper ones. The
    colour is linear and premultiplied.
    """

    corner: sl.vec2
    across: sl.vec2
    down: sl.vec2
    texels: sl.uvec2
    color: sl.vec4


class CanvasVarying(sl.Struct):
    """The varyings of `CanvasShader`."""

    clip: sl.vec4
    texel: sl.vec2
    color: sl.vec4


class CanvasShader(sl.Shader):
    """Draws parallelograms without vertices: two triangles each, found by the vertex index."""

    quads: sl.Storage[CanvasQuad]
    scale: sl.Uniform[sl.vec2]  # from pixels to clip space
    atlas: sl.Texture2D

    def vertex(self) -> CanvasVarying:
        number = sl.vertex_index()
        quad = self.quads[number // 6]
        turn = number % 6
        x = float((22 >> turn) & 1)  # the corners of the two triangles: 00 10 11, 00 11 01
        y = float((52 >> turn) & 1)
        position = quad.corner + quad.across * x + quad.down * y
        first = sl.vec2(float(quad.texels.x & 65535), float(quad.texels.x >> 16))
        size = sl.vec2(float(quad.texels.y & 65535), float(quad.texels.y >> 16))
        return CanvasVarying(
            clip=sl.vec4(position.x * self.scale.x - 1.0, 1.0 - position.y * self.scale.y, 0.5, 1.0),
            texel=first + size * sl.vec2(x, y),
            color=quad.color,
        )

    def fragment(self, v: CanvasVarying) -> sl.vec4:
        return v.color * self.atlas.load(sl.ivec2(sl.floor(v.texel))).x


@lru_cache(256)
def srgb(text: str, alpha: float = 1.0) -> NDArray[np.float32]:
    """Return the linear, premultiplied colour (4,) of `#rrggbb` and an alpha of 0 to 1. Don't write to it."""
    encoded = np.frombuffer(bytes.fromhex(text.removeprefix("#")), np.uint8) / 255.0
    color = np.append(from_srgb(encoded) * alpha, alpha).astype(np.float32)
    color.flags.writeable = False
    return color


class Canvas:
    """Collects rectangles, outlines, lines and text, and draws them in the order in which they were added.

    Coordinates are pixels from the top left; pixel (0, 0) is the square from 0 to 1. Colours are linear and
    premultiplied: (4,), or one for each element. `srgb` makes them. Edges are not smoothed, so what lies on
    whole pixels is crisp.

    Attributes:
        font: the font of `text`.
    """

    def __init__(self, device: Device, font: Font) -> None:
        self.font = font
        self._device = device
        self._program: Any = device.program(CanvasShader)
        self._atlas = device.texture(font.coverage, Format.R8, label="font")
        self._rows = np.zeros((0, CanvasQuad.dtype.itemsize // 4), np.float32)
        self._texels = self._rows.view(np.uint32)[:, 6:8]
        self._mesh = device.mesh(_CORNERS * _CAPACITY, label="canvas")
        self._count = 0
        self._clips: list[Clip | None] = [None]
        self._runs: list[tuple[int, Clip | None]] = [(0, None)]  # where each begins, and its clip rectangle
        origins, extents = font.atlas_position.astype(np.uint32), font.extent.astype(np.uint32)
        self._glyph_texels = np.stack(
            [pair[:, 0] | pair[:, 1] << np.uint32(16) for pair in (origins, extents)], axis=1
        )
        self._glyph_sizes = font.extent.astype(np.float32)

    def __len__(self) -> int:
        """Return the number of parallelograms that are to be drawn."""
        return self._count

    def rect(self, x: float, y: float, width: float, height: float, color: ArrayLike) -> None:
        """Add a filled rectangle."""
        self.rects(np.array(((x, y, width, height),)), color)

    def rects(self, boxes: ArrayLike, color: ArrayLike) -> None:
        """Add filled rectangles (n, 4): x, y, width, height."""
        boxes = np.asarray(boxes).reshape(-1, 4)
        rows = self._take(len(boxes), color)
        rows[:, 0:2] = boxes[:, 0:2]
        rows[:, 2], rows[:, 3] = boxes[:, 2], 0.0
        rows[:, 4], rows[:, 5] = 0.0, boxes[:, 3]

    def outlines(self, boxes: ArrayLike, color: ArrayLike, line: float = 1.0) -> None:
        """Add the edges of rectangles (n, 4): four strips of the width `line` inside of each, which don't
        overlap."""
        boxes = np.asarray(boxes, np.float32).reshape(-1, 4)
        x, y, wide, high = boxes.T
        across, down = np.minimum(line, wide), np.minimum(line, 0.5 * high)
        sides = np.empty((len(boxes), 4, 4), np.float32)
        sides[:, 0] = np.stack([x, y, wide, down], axis=1)
        sides[:, 1] = np.stack([x, y + high - down, wide, down], axis=1)
        sides[:, 2] = np.stack([x, y + down, np.minimum(across, 0.5 * wide), high - 2.0 * down], axis=1)
        sides[:, 3] = sides[:, 2]
        sides[:, 3, 0] += wide - sides[:, 2, 2]
        colors = np.asarray(color, np.float32)
        self.rects(sides.reshape(-1, 4), repeat_each(colors, 4, axis=0) if colors.ndim > 1 else colors)

    def lines(self, points: ArrayLike, color: ArrayLike, width: float = 1.0) -> None:
        """Add lines (n, 2, 2) between pairs of points; a line of no length draws nothing."""
        points = np.asarray(points, np.float32).reshape(-1, 2, 2)
        rows = self._take(len(points), color)
        along = points[:, 1] - points[:, 0]
        length = np.hypot(along[:, 0], along[:, 1])
        normal = along[:, ::-1] * (width / np.maximum(length, 1e-20))[:, None]
        normal[:, 0] *= -1.0
        rows[:, 0:2] = points[:, 0] - 0.5 * normal
        rows[:, 2:4], rows[:, 4:6] = along, normal

    def text(self, x: float, y: float, text: str, color: ArrayLike, scale: int = 1) -> tuple[int, int]:
        """Add text with its top left at the whole pixel nearest to (x, y), and return its (width, height).

        `scale` enlarges each texel of the atlas to a square of pixels. A text may have several lines, and
        tabs.
        """
        layout = lay_out(self.font, text)
        self.glyphs(round(x), round(y), layout, color, scale)
        return layout.width * scale, layout.height * scale

    def glyphs(self, x: float, y: float, layout: TextLayout, color: ArrayLike, scale: int = 1) -> None:
        """Add a text that was laid out before; a colour for each glyph is possible."""
        glyphs = layout.glyphs
        rows = self._take(len(glyphs), color)
        np.multiply(layout.positions, scale, out=rows[:, 0:2], casting="unsafe")
        rows[:, 0] += x
        rows[:, 1] += y
        sizes = self._glyph_sizes.take(glyphs, axis=0)
        sizes *= scale
        rows[:, 2], rows[:, 3] = sizes[:, 0], 0.0
        rows[:, 4], rows[:, 5] = 0.0, sizes[:, 1]
        self._texels[self._count - len(glyphs) : self._count] = self._glyph_texels.take(glyphs, axis=0)

    def measure(self, text: str, scale: int = 1) -> tuple[int, int]:
        """Return the (width, height) of a text."""
        layout = lay_out(self.font, text)
        return layout.width * scale, layout.height * scale

    @contextmanager
    def clip(self, x: float, y: float, width: float, height: float) -> Iterator[None]:
        """Draw what is added in the block only inside of a rectangle, rounded to whole pixels, and of those
        around."""
        left, top, right, bottom = (round(edge) for edge in (x, y, x + width, y + height))
        outer = self._clips[-1]
        if outer is not None:
            left, top = max(left, outer[0]), max(top, outer[1])
            right, bottom = min(right, outer[0] + outer[2]), min(bottom, outer[1] + outer[3])
        self._clips.append((left, top, max(right - left, 0), max(bottom - top, 0)))
        self._begin_run()
        try:
            yield
        finally:
            self._clips.pop()
            self._begin_run()

    def draw(self, size: tuple[int, int]) -> int:
        """Draw all that was added in the open pass, whose targets have this size, and begin anew.

        Returns:
            The number of draws.
        """
        runs, count = self._cut_runs(size), self._count
        self.forget()
        if not runs:
            return 0
        device = self._device
        array = self._rows[:count].reshape(-1).view(CanvasQuad.dtype)
        quads = device.transient.storage(CanvasQuad, array)
        scale = device.transient.uniform(np.array((2.0 / size[0], 2.0 / size[1]), np.float32))
        with device.states(CullMode.NONE, DepthTest.OFF, DepthWrite.OFF, BlendFunction.PREMULTIPLIED):
            for first, end, clip in runs:
                mesh = self._mesh.view(_CORNERS * first, _CORNERS * (end - first))
                with device.states(Scissor(*clip)):
                    device.draw(self._program, mesh, quads=quads, scale=scale, atlas=self._atlas)
        return len(runs)

    def forget(self) -> None:
        """Drop all that was added."""
        self._count = 0
        self._runs[:] = [(0, self._clips[-1])]

    def destroy(self) -> None:
        """Destroy the atlas on the device."""
        self._atlas.destroy()
        self._mesh.destroy()

    def _cut_runs(self, size: tuple[int, int]) -> list[tuple[int, int, Clip]]:
        """Return begin, end and clip rectangle of the parallelograms that are drawn together."""
        ends = [*(first for first, _ in self._runs[1:]), self._count]
        runs: list[tuple[int, int, Clip]] = []
        for (first, clip), end in zip(self._runs, ends, strict=True):
            x, y, wide, high = clip or (0, 0, *size)
            left, top = max(x, 0), max(y, 0)
            inside = left, top, min(x + wide, size[0]) - left, min(y + high, size[1]) - top
            if first == end or inside[2] <= 0 or inside[3] <= 0:
                continue
            if runs and runs[-1][1:] == (first, inside):
                runs[-1] = (runs[-1][0], end, inside)
            else:
                runs.append((first, end, inside))
        return runs

    def _begin_run(self) -> None:
        if self._runs[-1][0] == self._count:
            self._runs.pop()
        self._runs.append((self._count, self._clips[-1]))

    def _take(self, count: int, color: ArrayLike) -> NDArray[np.float32]:
        """Add `count` parallelograms of full coverage, and return their rows for corners and edges."""
        begin, end = self._count, self._count + count
        if end > len(self._rows):
            self._reserve(max(1 << (end - 1).bit_length(), _CAPACITY))
        self._rows[begin:end, 8:12] = color
        self._texels[begin:end] = (WHITE | WHITE << 16, 0)
        self._count = end
        return self._rows[begin:end]

    def _reserve(self, count: int) -> None:
        """Make room for `count` parallelograms."""
        if self._mesh.count < _CORNERS * count:
            old, self._mesh = self._mesh, self._device.mesh(_CORNERS * count, label="canvas")
            old.destroy()
        rows = np.zeros((count, self._rows.shape[1]), np.float32)
        rows[: self._count] = self._rows[: self._count]
        self._rows, self._texels = rows, rows.view(np.uint32)[:, 6:8]
