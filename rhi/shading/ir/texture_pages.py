"""Pages of texture tables: rectangles of a 2D array texture, and the words by which shaders find them.

- Each mip level of each image is a rectangle of its own, with a border of `GUTTER` texels around it. The border
  holds what the image's sampler reads beyond the edge, so bilinear filtering is right up to the edge.
- A level has its own texels, in its own size. Nothing is scaled.
- An image that is higher than wide may lie transposed: so long strips along both axes need no square page.
- Words are `ivec4`s: word 0 is (images, width and height of a page, 0). A word for each image follows: (index
  of its first level, levels, width | height << 16, `flags_of`). Then one for each level: (x, y, width | height
  << 16, layer), where x and y are those of its texel (0, 0).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, isqrt
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Filter, SamplerDescriptor, Wrap
from rhi.contract.formats import Format
from rhi.contract.texels import encode
from rhi.errors.named_tuples import NamedTuple
from rhi.shading.ir.texture_words import border_color

GUTTER: Final = 1
"""Texels of the border on each side."""
WORDS_ACROSS: Final = 64
"""Words in a row of the texture that describes a table, a power of two."""
WORDS_FORMAT: Final = Format.RGBA32I
MAX_ANISOTROPY: Final = 256.0
"""The most that the flags can say."""
ANISOTROPY_STEPS: Final = 16
"""The steps in which the flags count anisotropy, in 1."""
TRANSPOSED: Final = 1 << 8
_ANISOTROPY_SHIFT: Final = 9
_WRAPS: Final = {Wrap.REPEAT: 0, Wrap.MIRROR: 1, Wrap.CLAMP: 2, Wrap.BORDER: 3}
_MIPS: Final = {None: 0, Filter.NEAREST: 1, Filter.LINEAR: 2}
_WIDTHS: Final = (1.0, 1.1, 1.25, 1.5, 1.75, 2.0, 2.5)
"""The widths of pages that are tried, in the side of a square of all rectangles."""
_SLIVER: Final = 4
"""Free parts thinner than a fraction of the box beside them are given up, which keeps the list short."""
_GOOD: Final = 1.25
"""Pages that take no more than this, in the area of their rectangles, are good enough to stop."""

PAGE_SAMPLER: Final = SamplerDescriptor(
    Filter.LINEAR, Filter.LINEAR, None, Wrap.CLAMP, Wrap.CLAMP, Wrap.CLAMP
)
"""How pages are read: shaders select levels and wrap coordinates themselves."""

Size = tuple[int, int]
"""Width and height in texels."""


class LevelRectangle(NamedTuple):
    """Where a mip level lies: its texel (0, 0), the layer, and its size in the page, which is transposed if
    the image is."""

    x: int
    y: int
    layer: int
    width: int
    height: int


class PagePlan(NamedTuple):
    """The size of pages, their number, and the rectangles of each image's levels."""

    size: Size
    layers: int
    levels: tuple[tuple[LevelRectangle, ...], ...]
    transposed: tuple[bool, ...]

    @property
    def texels(self) -> int:
        """The number of texels of all pages."""
        return self.size[0] * self.size[1] * self.layers


def plan_pages(images: Sequence[Sequence[Size]], max_size: int, max_layers: int) -> PagePlan | None:
    """Return pages for images with these sizes of levels, None if they don't fit.

    Args:
        images: the sizes of all levels of each image.
        max_size, max_layers: the largest page, and the most of them.
    """
    upright = _plan(images, (False,) * len(images), max_size, max_layers)
    tall = tuple(levels[0][1] > levels[0][0] for levels in images)
    area = _area(images)
    if upright is not None and (upright.texels <= _GOOD * area or not any(tall)):
        return upright
    turned = _plan(images, tall, max_size, max_layers)
    plans = [plan for plan in (upright, turned) if plan is not None]
    return min(plans, key=lambda plan: plan.texels, default=None)


def _area(images: Sequence[Sequence[Size]]) -> int:
    """Return the texels of all levels with their borders."""
    return sum((w + 2 * GUTTER) * (h + 2 * GUTTER) for levels in images for w, h in levels)


def _plan(
    images: Sequence[Sequence[Size]], transposed: tuple[bool, ...], max_size: int, max_layers: int
) -> PagePlan | None:
    sizes = [
        [(h, w) if turned else (w, h) for w, h in levels]
        for levels, turned in zip(images, transposed, strict=True)
    ]
    boxes = np.array([(w + 2 * GUTTER, h + 2 * GUTTER) for levels in sizes for w, h in levels], np.int64)
    if boxes.max(initial=1) > max_size:
        return None
    order = np.lexsort((-boxes[:, 0], -boxes[:, 1]))
    area, widest = _area(images), int(boxes[:, 0].max())
    best: tuple[int, Size, int, NDArray[np.int64]] | None = None
    square = isqrt(area)
    widths = [square * factor for factor in _WIDTHS]
    if square > max_size / 2:  # several pages may be needed, which the largest image should fill
        widths += [widest * factor for factor in (1.0, 1.5, 2.0)]
    for requested in widths:
        width = min(max(widest, ceil(requested)), max_size)
        placed = _pack(boxes, order, width, max_size, area)
        corners = placed[:, :2] + boxes
        size, layers = (int(corners[:, 0].max()), int(corners[:, 1].max())), int(placed[:, 2].max()) + 1
        texels = size[0] * size[1] * layers
        if layers <= max_layers and (best is None or texels < best[0]):
            best = texels, size, layers, placed
        if best is not None and best[0] <= _GOOD * area:
            break
    if best is None:
        return None
    _, size, layers, placed = best
    rectangles, levels, start = placed.tolist(), [], 0
    for image in sizes:
        levels.append(
            tuple(
                LevelRectangle(x + GUTTER, y + GUTTER, layer, *box)
                for (x, y, layer), box in zip(rectangles[start : start + len(image)], image, strict=True)
            )
        )
        start += len(image)
    return PagePlan(size, layers, tuple(levels), transposed)


def _pack(
    boxes: NDArray[np.int64], order: NDArray[np.intp], width: int, max_size: int, area: int
) -> NDArray[np.int64]:
    """Return (x, y, layer) of each box, in pages of this width: each goes where its lower edge is highest up.

    Free rectangles are cut along the edges of a box, so that the larger part stays whole.
    """
    layers = ceil(area / (width * max_size))
    height = max_size if layers == 1 else min(max_size, ceil(area / (layers * width) * 1.06))
    height = max(height, int(boxes[:, 1].max()))
    free = np.empty((256, 5), np.int64)  # x, y, width, height, layer
    count, pages = 0, 0
    placed = np.empty((len(boxes), 3), np.int64)
    for number in order:
        w, h = boxes[number]
        rows = free[:count]
        fits = np.flatnonzero((rows[:, 2] >= w) & (rows[:, 3] >= h))
        if not len(fits):
            if count == len(free):
                free = np.concatenate([free, np.empty_like(free)])
            free[count] = 0, 0, width, height, pages
            fits, count, pages = np.array([count]), count + 1, pages + 1
        candidates = free[fits]
        bottom = (candidates[:, 4] * (height + 1) + candidates[:, 1]) * (width + 1) + candidates[:, 2] - w
        at = int(fits[np.argmin(bottom)])
        x, y, fw, fh, layer = free[at]
        placed[number] = x, y, layer
        # The box on the left; either the strip on its right or the one below it is cut off whole.
        least = max(h // _SLIVER, 2 * GUTTER + 1)
        across = h == boxes[order[0], 1] or (fw - w) * h <= w * (fh - h) or fh > 2 * h
        right = (x + w, y, fw - w, h if across else fh, layer)
        below = (x, y + h, fw if across else w, fh - h, layer)
        count -= 1
        free[at] = free[count]
        for part in (right, below):
            if min(part[2], part[3]) >= least:
                if count == len(free):
                    free = np.concatenate([free, np.empty_like(free)])
                free[count] = part
                count += 1
    return placed


def flags_of(sampler: SamplerDescriptor, transposed: bool, *, filters: bool = True) -> int:
    """Return the word of an image's sampler; `filters`: whether the format is filtered at all."""
    nearest = [not filters or filter is Filter.NEAREST for filter in (sampler.minify, sampler.magnify)]
    anisotropy = min(sampler.max_anisotropy, MAX_ANISOTROPY) if filters else 1.0
    return (
        _WRAPS[sampler.wrap_u]
        | _WRAPS[sampler.wrap_v] << 2
        | nearest[0] << 4
        | nearest[1] << 5
        | _MIPS[sampler.mip] << 6
        | (TRANSPOSED if transposed else 0)
        | round(anisotropy * ANISOTROPY_STEPS) << _ANISOTROPY_SHIFT
    )


def describe_pages(
    plan: PagePlan, sizes: Sequence[Size], samplers: Sequence[SamplerDescriptor], *, filters: bool = True
) -> NDArray[np.int32]:
    """Return the words of a table as texels, (rows, WORDS_ACROSS, 4); `sizes`: of each image, upright."""
    count = len(plan.levels)
    total = 1 + count + sum(map(len, plan.levels))
    words = np.zeros((-(-total // WORDS_ACROSS) * WORDS_ACROSS, 4), np.int32)
    words[0] = count, *plan.size, 0
    row = 1 + count
    for image, levels in enumerate(plan.levels):
        width, height = sizes[image]
        flags = flags_of(samplers[image], plan.transposed[image], filters=filters)
        words[1 + image] = row, len(levels), width | height << 16, flags
        for rectangle in levels:
            packed = rectangle.width | rectangle.height << 16
            words[row] = rectangle.x, rectangle.y, packed, rectangle.layer
            row += 1
    return words.reshape(-1, WORDS_ACROSS, 4)


def gutter_sources(wrap: Wrap, size: int) -> tuple[int, int]:
    """Return the texels of a row that a sampler reads before its first and behind its last one; -1 for the
    border color."""
    if wrap is Wrap.BORDER:
        return -1, -1
    return (size - 1, 0) if wrap is Wrap.REPEAT else (0, size - 1)


def border_texel(format: Format, sampler: SamplerDescriptor) -> NDArray[Any]:
    """Return the border color of a sampler as a texel, (components,)."""
    return encode(format, border_color(format, sampler)[: format.channels])


def surround(level: NDArray[Any], format: Format, sampler: SamplerDescriptor) -> NDArray[Any]:
    """Return a level, (height, width, components), with the border that its sampler reads."""
    height, width = level.shape[:2]
    above, below = gutter_sources(sampler.wrap_v, height)
    left, right = gutter_sources(sampler.wrap_u, width)
    rows = np.array([above, *range(height), below])
    columns = np.array([left, *range(width), right])
    texels: NDArray[Any] = level[rows[:, None], columns]
    texels[(rows < 0)[:, None] | (columns < 0)] = border_texel(format, sampler)
    return texels
