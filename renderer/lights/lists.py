"""Lists of the lights that reach each object, so that a fragment evaluates only lights that may reach it."""

from __future__ import annotations

import numpy as np

from renderer.scene.arrays import Floats, Rows

_PAIRS = 1 << 20  # (object, light) pairs tested at a time: 60 MB


def list_lights(lower: Floats, upper: Floats, positions: Floats, ranges: Floats) -> tuple[Rows, Rows]:
    """List, for each box, the lights within whose range it lies at least in part, ascending.

    Args:
        lower, upper: (n, 3) corners of the boxes. positions, ranges: (l, 3) and (l,) of the lights.

    Returns:
        `ends` (n + 1,) and `lights`, the concatenated lists: that of box i is `lights[ends[i]:ends[i + 1]]`.
    """
    step = max(_PAIRS // max(len(positions), 1), 1)
    counts, lists = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(lower), step):
        low, high = lower[start : start + step, None], upper[start : start + step, None]
        away = positions - np.clip(positions, low, high)
        reached = (away * away).sum(-1) < ranges * ranges
        counts.append(reached.sum(1))
        lists.append(np.nonzero(reached)[1])
    return np.cumsum(np.concatenate(counts)), np.concatenate(lists)
