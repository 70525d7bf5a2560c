"""Arrays of draws as places in the table of prepared draws.

- A draw that comes again, in whichever array, finds its place by what it says; an array that comes again finds all of
  its places at once, by its bytes.
- Places are prepared for a version of the indices: other indices, other places.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.draws import PreparedDraws

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
        self._arrays: dict[object, tuple[NDArray[np.int64], list[Place]]] = {}
        self._listed = 0  # draws of all arrays

    def find(
        self, key: object, arguments: NDArray[np.uint32], indexed: bool, numbered: bool, fill: Callable[..., None]
    ) -> NDArray[np.int64]:  # fmt: skip
        """The places of draws.

        Args:
            key: all that the places depend on besides the arguments.
            arguments: (n, 5), as an indirect draw reads them.
            numbered: whether each draw has its number in the array; else all have 0.
            fill: prepares a place: `fill(place, first, count, base_vertex, base_instance, number)`.
        """
        whole = key, numbered, arguments.tobytes()
        known = self._arrays.get(whole)
        if known is None:
            places = self._find_each(key, arguments, indexed, numbered, fill)
            known = np.array([place.number for place in places], np.int64), places
            self._listed += len(places)
            if self._listed > _MAX_KNOWN:
                self._arrays.clear()
                self._listed = len(places)
            self._arrays[whole] = known
        return known[0]

    def _find_each(
        self, key: object, arguments: NDArray[np.uint32], indexed: bool, numbered: bool, fill: Callable[..., None]
    ) -> list[Place]:  # fmt: skip
        draws, made = self._draws, []
        if len(draws) + len(arguments) > _MAX_KNOWN:
            draws.clear()
        count, _, first, third, fourth = (arguments[:, column].tolist() for column in range(5))
        base_vertex: Any = arguments[:, 3].view(np.int32).tolist() if indexed else [0] * len(count)
        numbers: Any = range(len(count)) if numbered else [0] * len(count)
        for draw in zip(first, count, base_vertex, fourth if indexed else third, numbers, strict=True):
            place = draws.get((key, draw))
            if place is None:
                place = draws[key, draw] = Place(self._prepared)
                fill(place, *draw)
            made.append(place)
        return made
