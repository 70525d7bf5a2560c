"""A cache of arrays of draws as prepared draws.

- A draw that is repeated, in whichever array, finds its prepared draw by its arguments. All draws of an array are
  looked up at once, since the visible objects of a scene change from frame to frame. An array that is repeated as a
  whole, with the same counters, finds its tables by its bytes.
- Prepared draws hold for one version of the indices; with other indices, draws are prepared anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.pieces import DrawList
from rhi.backends.cl.raster.prepared import DrawSlot, PreparedDraws
from rhi.contract.descriptors import DRAW

__rhi_internal__ = True

_MAX_KNOWN: Final = 1 << 16
"""Limit of the number of cached draws, and of the number of draws in cached arrays."""
_NAMES: Final = DRAW.names or ()
_WORDS: Final = [word for word, name in enumerate(_NAMES) if name != "instances"]
"""The words of a draw that its prepared draw depends on: all but the number of instances."""
_FACTORS: Final = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64
)
"""Factors of the hash of a draw's words: odd numbers with evenly distributed bits."""


class DrawListCache:
    """The cache of one device."""

    def __init__(self, prepared: PreparedDraws) -> None:
        self._prepared = prepared
        self._draws: dict[object, _KnownDraws] = {}
        self._placed = 0  # cached draws of all keys
        self._arrays: dict[object, DrawList] = {}
        self._listed = 0  # draws of all cached arrays

    def find(
        self, key: object, draws: NDArray[Any], counters: NDArray[np.int64] | None, indexed: bool,
        fill: Callable[..., None],
    ) -> DrawList:  # fmt: skip
        """Return an array of draws with the numbers of their prepared draws.

        Args:
            key: all that prepared draws depend on besides the draws themselves.
            draws: (n,) of `rhi.DRAW`, or without `indexed` of `rhi.DRAW_UNINDEXED`.
            counters: (n,) numbers of the draws' counters, or None.
            fill: fills in a prepared draw: `fill(slot, first, count, base_vertex, base_instance)`.
        """
        whole = key, draws.tobytes(), None if counters is None else counters.tobytes()
        list_of_all = self._arrays.get(whole)
        if list_of_all is None:
            numbers, places = self._find_each(key, draws, indexed, fill)
            instances = draws["instances"].astype(np.int64)
            list_of_all = DrawList(self._prepared, numbers, places, instances, counters)
            self._listed += len(numbers)
            if self._listed > _MAX_KNOWN:
                self._arrays.clear()
                self._listed = len(numbers)
            self._arrays[whole] = list_of_all
        return list_of_all

    def _find_each(
        self, key: object, draws: NDArray[Any], indexed: bool, fill: Callable[..., None]
    ) -> tuple[NDArray[np.int64], object]:
        """Return the number of each draw's prepared draw, and the object that keeps the prepared draws alive."""
        if self._placed + len(draws) > _MAX_KNOWN:
            self._draws.clear()
            self._placed = 0
        known = self._draws.setdefault(key, _KnownDraws())
        words = np.ascontiguousarray(draws).view(np.uint32).reshape(-1, len(_NAMES))[:, _WORDS]
        hashes = (words * _FACTORS).sum(axis=1, dtype=np.uint64)
        numbers = known.find(words, hashes)
        missing = np.flatnonzero(numbers < 0)
        if not len(missing):
            return numbers, known.places
        fresh = []
        for i, (count, first, third, fourth) in zip(missing.tolist(), words[missing].tolist(), strict=True):
            place = known.places.get((count, first, third, fourth))
            if place is None:
                place = DrawSlot(self._prepared)
                # The third word of DRAW is the base vertex, which is signed; that of DRAW_UNINDEXED the base instance.
                bases = (third - (third >> 31 << 32), fourth) if indexed else (0, third)
                fill(place, first, count, *bases)
                known.places[count, first, third, fourth] = place
                fresh.append(i)
            numbers[i] = place.number
        known.add(words[fresh], hashes[fresh], numbers[fresh])
        self._placed += len(fresh)
        return numbers, known.places


class _KnownDraws:
    """The prepared draws of one key, found by sorted hashes. Draws with the same hash are found through the dictionary.

    Attributes:
        places: the prepared draws by the words of their draws.
    """

    __slots__ = ("_hashes", "_numbers", "_words", "places")

    def __init__(self) -> None:
        self.places: dict[tuple[int, int, int, int], DrawSlot] = {}
        self._hashes = np.zeros(0, np.uint64)
        self._words = np.zeros((0, len(_WORDS)), np.uint32)
        self._numbers = np.zeros(0, np.int64)

    def find(self, words: NDArray[np.uint32], hashes: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Return the number of each draw's prepared draw; -1 if its hash doesn't find it."""
        if not len(self._hashes):
            return np.full(len(words), -1, np.int64)
        at = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        return np.where((self._words[at] == words).all(axis=1), self._numbers[at], -1)

    def add(
        self, words: NDArray[np.uint32], hashes: NDArray[np.uint64], numbers: NDArray[np.int64]
    ) -> None:
        """Add draws that weren't found."""
        order = np.argsort(hashes, kind="stable")
        at = np.searchsorted(self._hashes, hashes[order])
        self._hashes = np.insert(self._hashes, at, hashes[order])
        self._words = np.insert(self._words, at, words[order], axis=0)
        self._numbers = np.insert(self._numbers, at, numbers[order])
