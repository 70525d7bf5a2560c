"""Lists of the lights that reach each object, so that a fragment evaluates only lights that may reach it.

Lights that are near each other form groups, and a box meets only the lights of groups whose box it overlaps.
The groups' boxes are a little too large, never too small, and every pair that is left is tested exactly: the
lists are those of a test of all pairs.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from rhi.math.indexing import count_indices, repeat_each

_PAIRS = 1 << 20  # (object, light) pairs tested at a time: 70 MB at most
_GROUP: Final = 16  # lights
_SLACK: Final = 1e-12  # by which a group's box is too large, relative to its coordinates
_MIN_SLACK: Final = 1e-150  # the same in metres: where squares vanish
_BITS: Final = 10  # of a coordinate in the order of lights


def list_lights(lower: Floats, upper: Floats, positions: Floats, ranges: Floats) -> tuple[Indices, Indices]:
    """List, for each box, the lights within whose range it lies at least in part, ascending.

    Args:
        lower, upper: (n, 3) corners of the boxes.
        positions, ranges: (l, 3) and (l,) of the lights.

    Returns:
        `ends` (n + 1,) and `lights`, the concatenated lists: that of box i is `lights[ends[i]:ends[i + 1]]`.
    """
    count = len(positions)
    ends = np.zeros(len(lower) + 1, np.int64)
    lists = [np.zeros(0, np.int64)]
    groups = _group(positions, ranges)
    coordinates, reach = positions[groups].transpose(2, 0, 1), np.abs(ranges[groups])
    slack = _SLACK * (np.abs(coordinates) + reach) + _MIN_SLACK
    # A light with a NaN reaches nothing, and hides no other light.
    first = np.fmin.reduce(coordinates - reach - slack, -1)
    last = np.fmax.reduce(coordinates + reach + slack, -1)
    squares = ranges[groups] ** 2
    squares.reshape(-1)[count:] = -1.0  # the last group is filled up with lights that reach nothing
    step = max(_PAIRS // max(count, 1), 1)
    for start in range(0, len(lower), step):
        low, high = lower[start : start + step].T, upper[start : start + step].T
        meets = np.ones((low.shape[1], len(groups)), bool)
        for axis in range(3):
            meets &= (low[axis][:, None] <= last[axis]) & (high[axis][:, None] >= first[axis])
        box, group = np.nonzero(meets)
        squared = np.zeros((len(box), _GROUP))
        for axis in range(3):
            coordinate = coordinates[axis, group]
            away = coordinate - np.clip(coordinate, low[axis, box, None], high[axis, box, None])
            squared += away * away
        pair, member = np.nonzero(squared < squares[group])
        listed = np.sort(box[pair] * count + groups[group[pair], member])
        ends[start + 1 : start + 1 + low.shape[1]] = count_indices(listed // count, minlength=low.shape[1])
        lists.append(listed % count)
    return np.cumsum(ends), np.concatenate(lists)


def _group(positions: Floats, ranges: Floats) -> Indices:
    """Return groups (g, `_GROUP`) of near lights of similar ranges. If the last one isn't full, a light fills
    it up."""
    if not len(positions):
        return np.zeros((0, _GROUP), np.int64)
    finite = np.where(np.isfinite(positions), positions, 0.0)
    least = finite.min(0)
    cells = (finite - least) * ((2.0**_BITS - 1.0) / max(float((finite - least).max()), _MIN_SLACK))
    class_of_range = np.frexp(ranges)[1] // 2  # by powers of 4
    order = np.lexsort((_interleave(cells.astype(np.uint64)), class_of_range))
    return np.append(order, repeat_each(order[-1:], -len(order) % _GROUP)).reshape(-1, _GROUP)


def _interleave(cells: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return the positions of `cells` (n, 3) along a Z-order curve, which keeps near ones together."""
    order = np.zeros(len(cells), np.uint64)
    for bit in range(_BITS):
        for axis in range(3):
            order |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return order
