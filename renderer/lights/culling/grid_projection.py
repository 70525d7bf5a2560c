"""The grid of cells of a projection, computed in float64."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer import rules
from renderer.lights.culling.cells import ClusterGrid
from renderer.scene import Depth, Projection
from rhi.errors import refuse
from rhi.math import distance_at_depth

_FARTHEST: Final = 1e18
"""The end, in metres, of a grid that neither a projection nor a light ends: float32 can square it."""

_FARTHEST_SLICE: Final = 1e9
"""Where the last slice ends, in metres, if no projection ends it; it holds all that is beyond. So a light of
a huge range doesn't make the slices around the eye longer."""


def make_grid(
    projection: Projection,
    size: tuple[int, int],
    tile: int,
    *,
    slices: int = 1,
    first_slice: float | None = None,
    reach: float = np.inf,
) -> ClusterGrid:
    """Return the grid of cells for an image of `size` pixels, whose tiles have `tile` × `tile` pixels; fewer
    at the right and lower edge.

    Args:
        slices: number of depth slices.
        first_slice: where the second slice begins, in metres. The slices from there on are equally long in
            the logarithm of depth (as Filament's froxels). By default all slices of a perspective projection
            are (Olsson, Billeter and Assarsson 2012), and those of a parallel one are equally long.
        reach: the farthest depth that a light reaches. Cells end there.

    Raises:
        ValidationError `lights-bad-grid`: a number isn't positive, slices don't increase, or the projection
            turns or mirrors the image.
    """
    for name, value in (("size", min(size)), ("tile", tile), ("slices", slices)):
        if value < 1:
            refuse(rules.BAD_GRID, f"make_grid({name}=...)", value, "1 or more")
    m = np.asarray(projection.matrix, np.float64)
    turns = any((m[0, 1], m[1, 0], m[2, 0], m[2, 1], m[3, 0], m[3, 1]))
    if turns or not (m[0, 0] > 0.0 and m[1, 1] > 0.0):
        refuse(
            rules.BAD_GRID, "make_grid(projection=...)", m.tolist(), "x to the right and y up in the image"
        )
    nearest = 1.0 if projection.depth is Depth.REVERSED else 0.0
    near, far = distance_at_depth(m, nearest), distance_at_depth(m, 1.0 - nearest)
    slice_end, slice_rate = _slice_distribution(slices, first_slice, near, far, reach, bool(m[3, 2]))
    # With z ahead: scale · x - shift · z + constant = clip · (w + w_slope · z), where clip runs over the
    # pixels.
    scale, shift, constant = m[[0, 1], [0, 1]], m[:2, 2], m[:2, 3]
    w, w_slope = m[3, 3], -m[3, 2]
    clip, step = np.array([-1.0, 1.0]), np.array([2.0, -2.0]) / np.asarray(size)
    return ClusterGrid(
        offset=(clip * w - constant) / scale,
        offset_step=step * w / scale,
        slope=(clip * w_slope + shift) / scale,
        slope_step=step * w_slope / scale,
        depth=(m[2, 3], m[3, 3], m[2, 2], m[3, 2]),
        count=(-(-size[0] // tile), -(-size[1] // tile), slices),
        tile=tile,
        size=size,
        near=near,
        far=min(far, reach, _FARTHEST),
        slice_end=slice_end,
        slice_rate=slice_rate,
        background=1.0 - nearest,
    )


def _slice_distribution(
    slices: int, first: float | None, near: float, far: float, reach: float, is_perspective: bool
) -> tuple[float, float]:
    """Return the end of the slices, and their length in octaves: 0 if they are equally long in depth."""
    end = far if np.isfinite(far) else max(min(reach, _FARTHEST_SLICE), 2.0 * near)
    if first is not None:
        if not max(near, 0.0) < first < end:
            refuse(rules.BAD_GRID, "make_grid(first_slice=...)", first, f"between {near} and {end}")
        return end, float(np.log2(end / first)) / max(slices - 1, 1)
    return end, float(np.log2(end / near)) / slices if is_perspective else 0.0
