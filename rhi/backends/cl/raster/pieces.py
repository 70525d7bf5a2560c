"""Tables of draws as kernels read them, in pieces that bound the memory in flight.

- A piece is a part of a batch: a table of draws, and the words that these draws bind. Its vertices are transformed all
  at once. The first piece of a batch is small and the following ones double, so that later pieces know the bounds of
  depth that earlier ones left.
- Tables are computed by NumPy, whole columns at a time; that of a single draw by plain Python, in a third of the time.
- An array of draws that is alone in its batch (`DrawList`) keeps its tables, however often it is drawn.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from struct import Struct
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.batch_state import BatchState
from rhi.backends.cl.raster.prepared import PreparedDraws
from rhi.backends.cl.raster.rows import (
    CONDITION,
    FIXED_COLUMNS,
    INSTANCES,
    INVERTED,
    PREPARED,
    SAMPLES,
    VIEW,
)
from rhi.backends.cl.raster.tables import DRAW_STRUCT

__rhi_internal__ = True

_PIECE_GROUPS: Final = 1 << 15  # of vertices: 512 k, 16 MiB of positions; larger pieces cull each other less
_FIRST_PIECE_GROUPS: Final = 1 << 14  # the following pieces double

# Consecutive fields of `DRAW_STRUCT`, and their offsets.
_AT: Final = {name: place[1] for name, place in (DRAW_STRUCT.fields or {}).items()}
_COUNTERS: Final = Struct("=2Q")  # samples, condition
_GROUPS: Final = Struct("=2i")  # vertex_group, primitive_group, or the numbers of both
_STATES: Final = Struct("=4i")  # number, row, view, inverted

Table: TypeAlias = tuple[int, int, int, bytes]
"""Number of draws, their groups of vertices and of primitives, and the draws as `DRAW_STRUCT`s."""
Piece: TypeAlias = tuple[Table, bytes]
"""Some draws of a batch, and the words that they bind."""


class DrawList:
    """The draws of an array, which all have the same bindings.

    Attributes:
        places: (n,) numbers of their prepared draws.
        instances: (n,) their numbers of instances.
        numbers: (n,) the numbers by which shaders tell them apart.
        samples: (n,) offsets of their counters in bytes from the batch's `counters`; None if all draws of the array
            share a counter.
        conditions: (n,) addresses of the counters that decide whether they are drawn; None if all draws of the array
            share a condition, or have none.
        boxed: version of the prepared draws for which all boxes are known that the draws should have.
    """

    __slots__ = (
        "_holders", "_prepared", "_tables", "_version", "boxed", "conditions", "instances", "numbers", "places",
        "samples",
    )  # fmt: skip

    def __init__(
        self, prepared: PreparedDraws, places: NDArray[np.int64], holders: object, instances: NDArray[np.int64],
        numbers: NDArray[np.int64], *, samples: NDArray[np.int64] | None = None,
        conditions: NDArray[np.int64] | None = None,
    ) -> None:  # fmt: skip
        """`holders` keeps the prepared draws alive."""
        self._prepared = prepared
        self._holders = holders
        self._tables: list[Table] = []
        self._version = self.boxed = -1
        self.places = places
        self.instances = instances
        self.numbers = numbers
        self.samples = samples
        self.conditions = conditions

    @property
    def tables(self) -> list[Table]:
        """The tables of the draws if they have the first view and the first row of bindings, and no condition but
        `conditions`."""
        if self._version != self._prepared.version:
            self._tables.clear()
            self._version = self._prepared.version
            for part, table in number_groups(self._prepared.take(self.places), self.instances):
                table["number"][:-1] = self.numbers[part]
                if self.samples is not None:
                    table["samples"][:-1] = self.samples[part]
                if self.conditions is not None:
                    table["condition"][:-1] = self.conditions[part]
                self._tables.append(pack_table(table))
        return self._tables

    def list_streams(self, count: int) -> list[int]:
        """Return the addresses of the first `count` vertex streams, which all draws of a vertex array share."""
        streams: list[int] = self._prepared.streams[self.places[0], :count].tolist()
        return streams

    def spread(self, row: Sequence[int], counters: int) -> NDArray[np.uint64]:
        """Return a row for each draw, (n, len(row)). `row`: what they have in common; `counters`: an address."""
        rows = np.empty((len(self.places), len(row)), np.uint64)
        rows[:] = row
        rows[:, PREPARED] = self.places
        words = rows.view(np.uint32)
        words[:, 2 * INSTANCES], words[:, 2 * INSTANCES + 1] = self.instances, self.numbers
        if self.samples is not None:
            rows[:, SAMPLES] = counters + self.samples
        if self.conditions is not None:
            rows[:, CONDITION], rows[:, INVERTED] = self.conditions, 0
        return rows


def number_in_runs(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return each element's number in its run of equal rows."""
    places = np.arange(len(rows))
    begins = np.where(np.diff(rows, prepend=-1) != 0, places, 0)
    return places - np.maximum.accumulate(begins)


def tabulate(
    state: BatchState, prepared: PreparedDraws, rows: NDArray[np.uint64], numbers: NDArray[np.int64],
    instances: NDArray[np.int64],
) -> Iterator[Piece]:  # fmt: skip
    """Yield the pieces of many draws.

    Args:
        rows: (n, state.width) the draws' rows.
        numbers: (n,) their prepared draws.
        instances: (n, 2) their numbers of instances, and their numbers in their arrays.
    """
    draws, streams = prepared.take(numbers), prepared.streams[numbers, : state.streams]
    for part, table in number_groups(draws, instances[:, 0]):
        mine, own = rows[part], table[:-1]
        own["view"], own["samples"] = mine[:, VIEW], mine[:, SAMPLES]
        own["condition"], own["inverted"] = mine[:, CONDITION], mine[:, INVERTED]
        own["row"], own["number"] = np.arange(len(mine)), instances[part, 1]
        bound = np.concatenate([mine[:, FIXED_COLUMNS:], streams[part]], axis=1)
        for at, size in state.pipeline.elements:
            bound[:, at] //= np.uint64(size)
        yield pack_table(table), bound.tobytes()


def tabulate_one(state: BatchState, prepared: PreparedDraws, words: array[int]) -> Piece | None:
    """Return the piece of a single draw, or None if its instances need several pieces."""
    place, numbered, view, samples, condition, inverted, *bound = words
    draw = prepared.draws[place].tobytes()
    instances = numbered & 0xFFFFFFFF
    vertex_groups, groups = (instances * count for count in _GROUPS.unpack_from(draw, _AT["vertex_groups"]))
    if instances > 1 and vertex_groups > _FIRST_PIECE_GROUPS:
        return None
    table = bytearray(2 * DRAW_STRUCT.itemsize)
    table[: len(draw)] = draw
    _COUNTERS.pack_into(table, _AT["samples"], samples, condition)
    _STATES.pack_into(table, _AT["number"], numbered >> 32, 0, view, inverted)
    _GROUPS.pack_into(table, DRAW_STRUCT.itemsize + _AT["vertex_group"], vertex_groups, groups)
    streams = prepared.streams[place, : state.streams].tolist()
    return (1, vertex_groups, groups, bytes(table)), bind_words(state, bound, streams)


def bind_words(state: BatchState, words: Iterable[int], streams: list[int]) -> bytes:
    """Return the words that a draw binds as kernels read them: sizes become numbers of elements."""
    bound = [*words, *streams]
    for at, size in state.pipeline.elements:
        bound[at] //= size
    return array("Q", bound).tobytes()


def number_groups(
    prepared: NDArray[Any], instances: NDArray[np.int64]
) -> Iterator[tuple[slice | NDArray[np.intp], NDArray[Any]]]:
    """Yield the pieces of draws: their indices, and a table with their groups numbered. The table's last row holds the
    ends of the groups."""
    groups, which = prepared["vertex_groups"] * instances, None
    if groups.max() > _FIRST_PIECE_GROUPS:
        which, instances, done = split_instances(prepared["vertex_groups"], instances)
        prepared = prepared[which]
        prepared["base_instance"] += done.astype(np.int32)
        groups = prepared["vertex_groups"] * instances
    ends = np.cumsum(groups)
    begin, room = 0, min(_FIRST_PIECE_GROUPS, _PIECE_GROUPS)
    while begin < len(prepared):
        before = int(ends[begin - 1]) if begin else 0
        end = max(int(np.searchsorted(ends, before + room, "right")), begin + 1)
        part = slice(begin, end)
        mine, counts = prepared[part], instances[part]
        table = np.empty(len(mine) + 1, DRAW_STRUCT)
        words = table.view(np.uint64).reshape(len(table), -1)
        words[:-1] = mine.view(np.uint64).reshape(len(mine), -1)
        words[-1] = 0
        table["vertex_group"][0] = table["primitive_group"][0] = 0
        np.cumsum(mine["vertex_groups"] * counts, out=table["vertex_group"][1:], dtype=np.int32)
        np.cumsum(mine["primitive_groups"] * counts, out=table["primitive_group"][1:], dtype=np.int32)
        yield part if which is None else which[part], table
        begin, room = end, min(2 * room, _PIECE_GROUPS)


def split_instances(
    groups: NDArray[np.int32], instances: NDArray[np.int64]
) -> tuple[NDArray[np.intp], NDArray[np.int64], NDArray[np.int64]]:
    """Split draws of many instances so that none exceeds the first piece, unless a single instance does. Return each
    part's draw, its number of instances, and the number of instances before it."""
    most = np.maximum(_FIRST_PIECE_GROUPS // np.maximum(groups, 1), 1)
    parts = np.maximum(-(-instances // most), 1)
    which = np.repeat(np.arange(len(parts)), parts)
    done = (np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)) * most[which]
    return which, np.minimum(most[which], instances[which] - done), done


def pack_table(table: NDArray[Any]) -> Table:
    """Return a table of `number_groups` as kernels read it."""
    groups = int(table["vertex_group"][-1]), int(table["primitive_group"][-1])
    return len(table) - 1, *groups, table.tobytes()
