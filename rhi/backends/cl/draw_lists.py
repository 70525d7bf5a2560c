"""Arrays of draws as places in the table of prepared draws.

- A draw that comes again, in whichever array, finds its place by what it says; an array that comes again and is counted
  by the same counters finds all of its places and its table at once, by its bytes.
- Places are prepared for a version of the indices: other indices, other places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.draws import DrawList
from rhi.backends.cl.prepared import PreparedDraws

__rhi_internal__ = True

_MAX_KNOWN: Final = 1 << 16
"""Draws, and draws of arrays, that are known."""


class Place:
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
        self._draws: dict[object, Place] = {}
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
        known = self._arrays.get(whole)
        if known is None:
            places = self._find_each(key, draws, indexed, fill)
            numbers = np.array([place.number for place in places], np.int64)
            instances = draws["instances"].astype(np.int64)
            known = DrawList(self._prepared, numbers, places, instances, counters)
            self._listed += len(places)
            if self._listed > _MAX_KNOWN:
                self._arrays.clear()
                self._listed = len(places)
            self._arrays[whole] = known
        return known

    def _find_each(
        self, key: object, draws: NDArray[Any], indexed: bool, fill: Callable[..., None]
    ) -> list[Place]:
        known, made = self._draws, []
        if len(known) + len(draws) > _MAX_KNOWN:
            known.clear()
        for count, _, first, third, fourth in draws.tolist():
            # With indices third is a base vertex, which is signed.
            bases = (third - (third >> 31 << 32), fourth) if indexed else (0, third)
            draw = first, count, *bases
            place = known.get((key, draw))
            if place is None:
                place = known[key, draw] = Place(self._prepared)
                fill(place, *draw)
            made.append(place)
        return made
