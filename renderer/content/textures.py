"""Textures painted with NumPy: facades with windows, streets, flags. All are squares of `IMAGE_SIZE`."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene.images import ImagePixels, make_opaque
from rhi.math.indexing import repeat_each

IMAGE_SIZE: Final = 256
"""Width and height of all generated textures: one size, so that they can be layers of one array."""

WINDOWS: Final = 4
"""Number of windows in a facade texture, in each direction."""

ROOF_UV: Final = (0.125, 0.125)
"""Texture coordinates for roofs: the middle of a facade's only shuttered window, which is a uniform grey."""

_CELL = IMAGE_SIZE // WINDOWS

NIGHT_WINDOWS: Final = 8
"""The same in a facade's texture at night: lit windows that are repeated are seen from afar."""

_PANES: Final = {
    "punched": (0.26, 0.74, 0.20, 0.78),
    "ribbon": (0.02, 0.98, 0.24, 0.76),
    "glass": (0.05, 0.95, 0.07, 0.93),
}
"""Left, right, top and bottom edge of a window, as shares of its part of the facade."""


def paint_facade(style: str, seed: int) -> ImagePixels:
    """Paint a facade of `WINDOWS` x `WINDOWS` windows, almost white, to be tinted by a material's base
    colour.

    Styles: "punched" windows in a wall, "ribbon" windows between bands, "glass" panes in thin frames.
    """
    rng = np.random.default_rng([seed, list(_PANES).index(style)])
    left, right, top, bottom = _PANES[style]
    wall = 0.86 + 0.05 * rng.standard_normal((IMAGE_SIZE // 4, IMAGE_SIZE // 4)).repeat(4, 0).repeat(4, 1)
    pixels = repeat_each(wall[..., None], 3, axis=2)
    ramp = np.linspace(1.15, 0.8, _CELL)[:, None, None]  # the sky is reflected in the upper part of a pane
    for row in range(WINDOWS):
        for column in range(WINDOWS):
            cell = pixels[row * _CELL : (row + 1) * _CELL, column * _CELL : (column + 1) * _CELL]
            x0, x1, y0, y1 = (int(edge * _CELL) for edge in (left, right, top, bottom))
            tint = np.array([0.20, 0.27, 0.34]) * rng.uniform(0.75, 1.35)
            if rng.random() < 0.12:
                tint = np.array([0.78, 0.68, 0.45])  # a lit window
            cell[y0:y1, x0:x1] = tint * ramp[y0:y1]
            cell[y1 : y1 + 3, x0:x1] *= 0.7  # the shadow under the sill
            middle = (x0 + x1) // 2
            cell[y0:y1, middle : middle + 2] = 0.55
    shutter = pixels[:_CELL, :_CELL]
    shutter[int(top * _CELL) : int(bottom * _CELL), int(left * _CELL) : int(right * _CELL)] = 0.52
    return make_opaque(pixels)


def paint_lit_facade(style: str, seed: int) -> ImagePixels:
    """Paint a facade of `NIGHT_WINDOWS` x `NIGHT_WINDOWS` windows at night, for a material that emits light.

    The walls are dark, so that they emit as faintly as under the sky of a city, and about a third of the
    windows are bright. The first one is shuttered, as in `paint_facade`, and paints the roofs.
    """
    rng = np.random.default_rng([seed, 31, list(_PANES).index(style)])
    cell = IMAGE_SIZE // NIGHT_WINDOWS
    x0, x1, y0, y1 = (int(edge * cell) for edge in _PANES[style])
    pixels = repeat_each(0.30 + 0.02 * rng.standard_normal((IMAGE_SIZE, IMAGE_SIZE, 1)), 3, axis=2)
    window_colors = np.array(_WINDOW_COLORS[style == "glass"])
    for row in range(NIGHT_WINDOWS):
        busy = rng.random() < 0.3  # a storey where people work late
        for column in range(NIGHT_WINDOWS):
            window = pixels[row * cell + y0 : row * cell + y1, column * cell + x0 : column * cell + x1]
            window[:] = np.array([0.09, 0.11, 0.15]) * rng.uniform(0.8, 1.2)
            if rng.random() < (0.62 if busy else 0.26):
                window[:] = window_colors[rng.integers(len(window_colors))] * rng.uniform(0.72, 1.0)
                window[: int(rng.uniform(0.0, 0.5) * len(window))] *= 0.82  # a blind
            window[:, (x1 - x0) // 2] *= 0.4
    pixels[:cell, :cell] = 0.16
    return make_opaque(pixels)


_WINDOW_COLORS: Final = (
    ((1.0, 0.80, 0.50), (1.0, 0.88, 0.66), (1.0, 0.72, 0.40), (0.92, 0.92, 0.86)),
    ((0.94, 0.98, 1.0), (0.80, 0.92, 1.0), (1.0, 0.94, 0.80)),
)
"""Colours of lit windows, sRGB: of homes, and of offices."""


def paint_street(street: float, seed: int) -> ImagePixels:
    """Paint one block of ground with streets along its edges; `street` is the fraction of the width that they
    take.

    There is pavement in the middle, and around it asphalt with a dashed centre line on the texture's border
    and zebra crossings.
    """
    rng = np.random.default_rng([seed, 17])
    noise = rng.standard_normal((IMAGE_SIZE, IMAGE_SIZE))
    pixels = repeat_each((0.27 + 0.012 * noise)[..., None], 3, axis=2) * (1.0, 1.0, 1.04)
    at = (np.arange(IMAGE_SIZE) + 0.5) / IMAGE_SIZE
    edge = np.minimum(at, 1.0 - at)  # distance from the middle of the street
    x, z = np.broadcast_arrays(edge[None, :], edge[:, None])
    half = 0.5 * street
    pavement = (x > half) & (z > half)
    slabs = 0.56 + 0.01 * noise - 0.06 * ((at * 32 % 1.0 < 0.12)[None, :] | (at * 32 % 1.0 < 0.12)[:, None])
    pixels[pavement] = (slabs[..., None] * (1.0, 0.98, 0.95))[pavement]
    kerb = (np.minimum(x, z) > half) & (np.minimum(x, z) < half + 0.012)
    pixels[kerb] = 0.66
    dashes = at * 16 % 1.0 < 0.5
    for across, along in ((x, dashes[:, None]), (z, dashes[None, :])):
        other = z if across is x else x
        line = (across < 0.006) & along & (other > half + 0.05)
        pixels[line] = 0.75
        stripes = (
            (other > half + 0.008)
            & (other < half + 0.05)
            & (across < half - 0.01)
            & (across * 60 % 1.0 < 0.5)
        )
        pixels[stripes] = 0.72
    return make_opaque(pixels)


def paint_stripes(
    first: tuple[float, float, float], second: tuple[float, float, float], count: int
) -> ImagePixels:
    """Paint a flag: `count` pairs of horizontal stripes in two sRGB colours."""
    bands = (np.arange(IMAGE_SIZE) * 2 * count // IMAGE_SIZE) % 2 == 0
    column = np.where(bands[:, None], first, second)
    return make_opaque(repeat_each(column[:, None], IMAGE_SIZE, axis=1))
