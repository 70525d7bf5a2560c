"""Arrays of draws as places in the table of prepared draws.

- A draw that comes again, in whichever array, finds its place by what it says: all draws of an array at once, since
  what is seen changes from frame to frame. An array that comes again and is counted by the same counters finds its
  table, too, by its bytes.
- Places are prepared for a version of the indices: other indices, other places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.batches import DrawList
from rhi.backends.cl.raster.prepared import PreparedDraws

__rhi_internal__ = True

_MAX_KNOWN: Final = 1 << 16
"""Draws, and draws of arrays, that are known."""
_WORDS: Final = (0, 2, 3, 4)
"""Those of a draw's five that its place depends on: all but the number of instances."""
_FACTORS: Final = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64
)
"""Of a hash: odd, their bits evenly set."""


class DrawSlot:
    """A prepared draw's place in the table; given back with its holder."""

    __slots__ = ("_leave", "memory", "number")

    def __init__(self, prepared: PreparedDraws) -> None:
        self.number = prepared.add()
        self.memory: object = None  # the index list, while the table has its address
        self._leave = prepared.leave

    def __del__(self) -> None:
        self._leave(self.number)


class DrawLists:
    """All arrays of draws of one device."""

    def __init__(self, prepared: PreparedDraws) -> None:
        self._prepared = prepared
        self._draws: dict[object, _Known] = {}
        self._placed = 0  # draws of all keys
        self._arrays: dict[object, DrawList] = {}
        self._listed = 0  # draws of all arrays

    def find(
        self, key: object, draws: NDArray[Any], counters: NDArray[np.int64] | None, indexed: bool,
        fill: Callable[..., None],
    ) -> DrawList:  # fmt: skip
        """Draws with their places.

        Args:
            key: all that the places depend on besides the draws.
            draws: (n,) of five uint32, as an indirect draw reads them: count, instances, first, and what depends on
                whether they are indexed, third and fourth.
            counters: (n,) numbers of those that draws are counted by.
            fill: prepares a place: `fill(place, first, count, base_vertex, base_instance)`.
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
        """The number of each draw's place, and what keeps the places."""
        if self._placed + len(draws) > _MAX_KNOWN:
            self._draws.clear()
            self._placed = 0
        known = self._draws.setdefault(key, _Known())
        words = np.ascontiguousarray(draws).view(np.uint32).reshape(-1, 5)[:, _WORDS]
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
                # With indices third is a base vertex, which is signed.
                bases = (third - (third >> 31 << 32), fourth) if indexed else (0, third)
                fill(place, first, count, *bases)
                known.places[count, first, third, fourth] = place
                fresh.append(i)
            numbers[i] = place.number
        known.add(words[fresh], hashes[fresh], numbers[fresh])
        self._placed += len(fresh)
        return numbers, known.places


class _Known:
    """The places of draws that have all else in common, by hashes in order; draws of equal hashes by the dict alone.

    Attributes:
        places: by a draw's words.
    """

    __slots__ = ("_hashes", "_numbers", "_words", "places")

    def __init__(self) -> None:
        self.places: dict[tuple[int, int, int, int], DrawSlot] = {}
        self._hashes = np.zeros(0, np.uint64)
        self._words = np.zeros((0, len(_WORDS)), np.uint32)
        self._numbers = np.zeros(0, np.int64)

    def find(self, words: NDArray[np.uint32], hashes: NDArray[np.uint64]) -> NDArray[np.int64]:
        """The number of each draw's place; -1: it isn't found so."""
        if not len(self._hashes):
            return np.full(len(words), -1, np.int64)
        at = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        return np.where((self._words[at] == words).all(axis=1), self._numbers[at], -1)

    def add(
        self, words: NDArray[np.uint32], hashes: NDArray[np.uint64], numbers: NDArray[np.int64]
    ) -> None:
        """Draws that weren't found."""
        order = np.argsort(hashes, kind="stable")
        at = np.searchsorted(self._hashes, hashes[order])
        self._hashes = np.insert(self._hashes, at, hashes[order])
        self._words = np.insert(self._words, at, words[order], axis=0)
        self._numbers = np.insert(self._numbers, at, numbers[order])
