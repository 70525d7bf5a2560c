"""The types of the two kinds of arrays that are used throughout the renderer, ids that are checked, and
ranges."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from rhi.errors import refuse
from rhi.errors.array_likes import to_real_array
from rhi.math import Floats as Floats
from rhi.math.indexing import repeat_each

Indices = NDArray[np.int64]
"""Row numbers: of objects, nodes, boxes or members, as the signature says."""


def read_ids(call: str, values: ArrayLike, count: int) -> Indices:
    """Return ids (k,) from 0 to `count` - 1; a single id becomes (1,).

    Raises:
        ValidationError: `scene-bad-index`, in the name of `call`.
    """
    try:
        numbers = np.atleast_1d(to_real_array(values))
        ids = numbers.astype(np.int64)
    except (TypeError, ValueError, OverflowError) as error:
        refuse(rules.BAD_INDEX, call, values, f"0 to {count - 1}: {error}")
    if ids.size and (ids.min() < 0 or ids.max() >= count or (ids != numbers).any()):
        refuse(rules.BAD_INDEX, call, ids, f"0 to {count - 1}")
    return ids


def list_ranges(firsts: ArrayLike, counts: ArrayLike) -> Indices:
    """Return the `counts` (k,) numbers from each of `firsts` (k,) on, one range after another."""
    begins, sizes = np.asarray(firsts, np.int64), np.asarray(counts, np.int64)
    indices: Indices = np.arange(sizes.sum()) + repeat_each(begins - np.cumsum(sizes) + sizes, sizes)
    return indices


def hash_to_unit(key: NDArray[np.uint64]) -> Floats:
    """Hash to [0, 1) with SplitMix64 (Steele, Lea and Flood, 2014)."""
    x = (key + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((x ^ (x >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) * 2.0**-53
