"""A cache of arrays of draws as prepared draws.

- A draw that is repeated, in whichever array, finds its prepared draw by its arguments. All draws of an array
  are looked up at once, since the visible objects of a scene change from frame to frame. An array that is
  repeated as a whole, with the same counters, finds its tables by its bytes.
- Prepared draws hold for one version of the indices. With other indices draws are prepared anew, and the old
  ones are dropped, as all are that belong to a vertex array when it is destroyed.
- Where there are too many, arrays are dropped first: they change with each frame in which the visible objects do,
  and are made again in a thousandth of the time that their prepared draws take.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.draw_columns import COUNTER_BYTES
from rhi.backends.cl.raster.draw_tables import DrawList, DrawSlot, PreparedDraws
from rhi.contract.descriptors import DRAW, Id, Primitive

_MAX_CACHED: Final = 1 << 17
"""Limit of the number of cached draws and of draws in cached arrays, together, beyond which arrays are dropped; and
of cached draws alone, beyond which all are, unless an array has more than half as many."""
_NAMES: Final = DRAW.names or ()
_WORDS: Final = [word for word, name in enumerate(_NAMES) if name != "instances"]
"""The words of a draw that its prepared draw depends on: all but the number of instances."""
_FACTORS: Final = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93], np.uint64
)
"""Factors of the hash of a draw's words: odd numbers with evenly distributed bits."""


_Bytes: TypeAlias = tuple[bytes, bytes | None]


@dataclass(slots=True)
class _CacheEntry:
    """The cache for one vertex array and primitive, valid for one version of the indices."""

    version: int
    draws: _DrawIndex
    arrays: dict[_Bytes, DrawList]
    listed: int = 0  # draws in `arrays`, and one for each


class DrawListCache:
    """The cache of one device."""

    def __init__(self, prepared: PreparedDraws) -> None:
        self._prepared = prepared
        self._parts: dict[Id, dict[Primitive, _CacheEntry]] = {}  # by vertex array
        self._size = 0  # cached draws, and draws of cached arrays

    def lookup(
        self,
        vertex_array: Id,
        primitive: Primitive,
        version: int,
        draws: NDArray[Any],
        counters: NDArray[np.int64] | None,
        indexed: bool,
        fill: Callable[..., None],
    ) -> DrawList:
        """Return an array of draws with the numbers of their prepared draws.

        Args:
            version: that of the vertex array's indices.
            draws: (n,) of `rhi.DRAW`, or without `indexed` of `rhi.DRAW_UNINDEXED`.
            counters: (n,) numbers of the draws' counters, or None.
            fill: fills in a prepared draw: `fill(slot, first, count, base_vertex, base_instance)`.
        """
        part = self._get_entry(vertex_array, primitive, version)
        whole = draws.tobytes(), None if counters is None else counters.tobytes()
        list_of_all = part.arrays.get(whole)
        if list_of_all is None:
            part = self._make_room(part, vertex_array, primitive, len(draws))
            indices, holders = self._lookup_draws(part.draws, draws, indexed, fill)
            instances = draws["instances"].astype(np.int64)
            if counters is None:
                list_of_all = DrawList(self._prepared, indices, holders, instances, np.arange(len(indices)))
            else:
                numbers, offsets = np.zeros(len(indices), np.int64), COUNTER_BYTES * (1 + counters)
                list_of_all = DrawList(self._prepared, indices, holders, instances, numbers, samples=offsets)
            part.arrays[whole] = list_of_all
            part.listed += len(indices) + 1
            self._size += len(indices) + 1
        return list_of_all

    def make_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        version: int,
        draws: NDArray[Any],
        numbers: NDArray[np.int64],
        conditions: NDArray[np.int64],
        indexed: bool,
        fill: Callable[..., None],
    ) -> DrawList:
        """Return an array of draws with conditions, (n,) addresses of counters, and `numbers`.

        Draws are looked up as by `lookup`. The array isn't cached, since conditional draws change every
        frame."""
        part = self._get_entry(vertex_array, primitive, version)
        part = self._make_room(part, vertex_array, primitive, len(draws))
        indices, holders = self._lookup_draws(part.draws, draws, indexed, fill)
        instances = draws["instances"].astype(np.int64)
        return DrawList(self._prepared, indices, holders, instances, numbers, conditions=conditions)

    def _make_room(
        self, part: _CacheEntry, vertex_array: Id, primitive: Primitive, draws: int
    ) -> _CacheEntry:
        """Return the entry, or a new one if everything had to be dropped to make room."""
        if not self._size or self._size + 2 * draws <= _MAX_CACHED:
            return part
        for entry in (entry for entries in self._parts.values() for entry in entries.values()):
            self._size -= entry.listed
            entry.arrays.clear()
            entry.listed = 0
        if self._size <= max(_MAX_CACHED - draws, 2 * draws):
            return part
        self._parts.clear()
        self._size = 0
        return self._get_entry(vertex_array, primitive, part.version)

    def forget(self, vertex_array: Id) -> None:
        """Drop everything of a vertex array that is being destroyed."""
        for part in self._parts.pop(vertex_array, {}).values():
            self._size -= part.listed + len(part.draws.slots)

    def _get_entry(self, vertex_array: Id, primitive: Primitive, version: int) -> _CacheEntry:
        """Return the part of the cache for these indices; one for an earlier version is dropped."""
        parts = self._parts.setdefault(vertex_array, {})
        part = parts.get(primitive)
        if part is None or part.version != version:
            if part is not None:
                self._size -= part.listed + len(part.draws.slots)
            part = parts[primitive] = _CacheEntry(version, _DrawIndex(), {})
        return part

    def _lookup_draws(
        self, index: _DrawIndex, draws: NDArray[Any], indexed: bool, fill: Callable[..., None]
    ) -> tuple[NDArray[np.int64], object]:
        """Return the number of each draw's prepared draw, and the object that keeps the prepared draws
        alive."""
        words = np.ascontiguousarray(draws).view(np.uint32).reshape(-1, len(_NAMES))[:, _WORDS]
        hashes = (words * _FACTORS).sum(axis=1, dtype=np.uint64)
        numbers = index.lookup(words, hashes)
        missing = np.flatnonzero(numbers < 0)
        if not len(missing):
            return numbers, index.slots
        fresh = []
        for i, (count, first, third, fourth) in zip(missing.tolist(), words[missing].tolist(), strict=True):
            slot = index.slots.get((count, first, third, fourth))
            if slot is None:
                slot = DrawSlot(self._prepared)
                # The third word of DRAW is the base vertex, which is signed; that of DRAW_UNINDEXED the base
                # instance.
                bases = (third - (third >> 31 << 32), fourth) if indexed else (0, third)
                fill(slot, first, count, *bases)
                index.slots[count, first, third, fourth] = slot
                fresh.append(i)
            numbers[i] = slot.number
        index.add(words[fresh], hashes[fresh], numbers[fresh])
        self._size += len(fresh)
        return numbers, index.slots


class _DrawIndex:
    """The prepared draws of one key, found by sorted hashes. Draws with the same hash are found through the
    dictionary.

    Attributes:
        slots: the prepared draws by the words of their draws.
    """

    __slots__ = ("_hashes", "_numbers", "_words", "slots")

    def __init__(self) -> None:
        self.slots: dict[tuple[int, int, int, int], DrawSlot] = {}
        self._hashes = np.zeros(0, np.uint64)
        self._words = np.zeros((0, len(_WORDS)), np.uint32)
        self._numbers = np.zeros(0, np.int64)

    def lookup(self, words: NDArray[np.uint32], hashes: NDArray[np.uint64]) -> NDArray[np.int64]:
        """Return the index of each draw's prepared draw; -1 if its hash isn't in the index."""
        if not len(self._hashes):
            return np.full(len(words), -1, np.int64)
        at = np.minimum(np.searchsorted(self._hashes, hashes), len(self._hashes) - 1)
        return np.where((self._words[at] == words).all(axis=1), self._numbers[at], -1)

    def add(self, words: NDArray[np.uint32], hashes: NDArray[np.uint64], numbers: NDArray[np.int64]) -> None:
        """Add draws that `lookup` didn't find."""
        order = np.argsort(hashes, kind="stable")
        at = np.searchsorted(self._hashes, hashes[order])
        self._hashes = np.insert(self._hashes, at, hashes[order])
        self._words = np.insert(self._words, at, words[order], axis=0)
        self._numbers = np.insert(self._numbers, at, numbers[order])
