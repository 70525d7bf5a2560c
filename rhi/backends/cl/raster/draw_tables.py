"""Tables of draws as kernels read them: rows that stay from frame to frame, and pieces that bound the memory
in flight.

- The part of a draw that stays the same from frame to frame is a row of `PreparedDraws`. It exists as long as
  its `DrawSlot` is referenced.
- A piece is a part of a batch: a table of draws, and the words that these draws bind. Its vertices are
  transformed all at once. The first piece of a batch is small and the following ones double, so that later
  pieces know the bounds of depth that earlier ones left.
- Tables are computed by NumPy, whole columns at a time; that of a single draw by plain Python, in a third of
  the time.
- An array of draws that is alone in its batch (`DrawList`) keeps its tables, however often it is drawn.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from struct import Struct
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.draw_columns import (
    CONDITION,
    FIXED_COLUMNS,
    INSTANCES,
    INVERTED,
    PREPARED,
    SAMPLES,
    VIEW,
)
from rhi.backends.cl.raster.kernel_structs import DRAW_STRUCT, GROUP, MAX_STREAMS
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY
from rhi.math.indexing import repeat_each

_PIECE_GROUPS: Final = 1 << 15  # of vertices: 512 k, 16 MiB of positions; larger pieces cull each other less
_FIRST_PIECE_GROUPS: Final = 1 << 14  # the following pieces double

# Consecutive fields of `DRAW_STRUCT`, and their offsets.
_AT: Final = {name: field[1] for name, field in (DRAW_STRUCT.fields or {}).items()}
_COUNTERS: Final = Struct("=2Q")  # samples, condition
_GROUPS: Final = Struct("=2i")  # vertex_group, primitive_group, or the numbers of both
_STATES: Final = Struct("=4i")  # number, binding_index, view, inverted

_MAX_PARTS: Final = 1 << 20
"""Limit of the pieces of one draw: half a trillion vertices, more than any device finishes."""

Table: TypeAlias = tuple[int, int, int, bytes]
"""Number of draws, their groups of vertices and of primitives, and the draws as `DRAW_STRUCT`s."""
Piece: TypeAlias = tuple[Table, bytes]
"""Some draws of a batch, and the words that they bind."""


class PreparedDraws:
    """The prepared draws of one device: tables that grow, with a row for each.

    Attributes:
        draws: (n,) of `DRAW_STRUCT`, without the fields that are numbered batch by batch.
        streams: (n, MAX_STREAMS) addresses of the vertex streams.
        arrays: (n,) ids of the vertex arrays.
        was_drawn: (n,) whether the draw was drawn since it was prepared or its vertices changed.
        version: changes whenever boxes do (rhi.backends.cl.raster.boxes). As long as it stays, rows that are
            in use don't change.
    """

    def __init__(self) -> None:
        size = 256
        self.draws = np.zeros(size, DRAW_STRUCT)
        self.streams = np.zeros((size, MAX_STREAMS), np.uint64)
        self.arrays = np.zeros(size, np.int64)
        self.was_drawn = np.zeros(size, bool)
        self.version = 0
        self._free: list[int] = list(range(size))
        self._released: list[int] = []  # still referenced by gathered draws

    def add(self) -> int:
        """Return a free row's number."""
        if not self._free:
            size = len(self.draws)
            self.draws = np.concatenate([self.draws, np.zeros_like(self.draws)])
            self.streams = np.concatenate([self.streams, np.zeros_like(self.streams)])
            self.arrays = np.concatenate([self.arrays, np.zeros_like(self.arrays)])
            self.was_drawn = np.concatenate([self.was_drawn, np.zeros_like(self.was_drawn)])
            self._free = list(range(size, 2 * size))
        return self._free.pop()

    def release(self, number: int) -> None:
        """Free a row once the draws gathered so far are flushed."""
        self._released.append(number)

    def take(self, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of rows of `draws`. They are copied as plain words: NumPy copies structs field by
        field."""
        words = self.draws.view(np.uint64).reshape(len(self.draws), -1)
        return words.take(numbers, axis=0).view(DRAW_STRUCT).reshape(-1)

    def recycle(self) -> None:
        """Free the released rows, since the gathered draws have been flushed."""
        self._free += self._released
        self._released.clear()


class DrawSlot:
    """A row of the prepared draws; released together with its holder.

    Attributes:
        memory: the index list that the row refers to, kept alive here.
    """

    __slots__ = ("_release", "memory", "number")

    def __init__(self, prepared: PreparedDraws) -> None:
        self.number = prepared.add()
        self.memory: object = None
        self._release = prepared.release

    def __del__(self) -> None:
        self._release(self.number)


class BoundWords(NamedTuple):
    """The words that a draw binds.

    Attributes:
        elements: the index of each size in the row's words, and the bytes of an element.
        streams: number of vertex streams, whose addresses follow.
    """

    elements: Sequence[tuple[int, int]]
    streams: int


class DrawList:
    """The draws of an array, which all have the same bindings.

    Attributes:
        prepared_indices: (n,) indices of their prepared draws.
        instances: (n,) their numbers of instances.
        numbers: (n,) the numbers by which shaders tell them apart.
        samples: (n,) offsets of their counters in bytes from the batch's `counters`; None if all draws of the
            array share a counter.
        conditions: (n,) addresses of the counters that decide whether they are drawn; None if all draws of
            the array share a condition, or have none.
        boxed: version of the prepared draws for which all boxes are known that the draws should have.
    """

    __slots__ = (
        "_holders",
        "_prepared",
        "_tables",
        "_version",
        "boxed",
        "conditions",
        "instances",
        "numbers",
        "prepared_indices",
        "samples",
    )

    def __init__(
        self,
        prepared: PreparedDraws,
        prepared_indices: NDArray[np.int64],
        holders: object,
        instances: NDArray[np.int64],
        numbers: NDArray[np.int64],
        *,
        samples: NDArray[np.int64] | None = None,
        conditions: NDArray[np.int64] | None = None,
    ) -> None:
        """`holders` keeps the prepared draws alive."""
        self._prepared = prepared
        self._holders = holders
        self._tables: list[Table] = []
        self._version = self.boxed = -1
        self.prepared_indices = prepared_indices
        self.instances = instances
        self.numbers = numbers
        self.samples = samples
        self.conditions = conditions

    @property
    def tables(self) -> list[Table]:
        """The tables of the draws if they have the first view and the first row of bindings, and no condition
        but `conditions`."""
        if self._version != self._prepared.version:
            self._tables.clear()
            self._version = self._prepared.version
            for part, table in number_groups(self._prepared.take(self.prepared_indices), self.instances):
                table["number"][:-1] = self.numbers[part]
                if self.samples is not None:
                    table["samples"][:-1] = self.samples[part]
                if self.conditions is not None:
                    table["condition"][:-1] = self.conditions[part]
                self._tables.append(pack_table(table))
        return self._tables

    def list_streams(self, count: int) -> list[int]:
        """Return the addresses of the first `count` vertex streams, which all draws of a vertex array
        share."""
        streams: list[int] = self._prepared.streams[self.prepared_indices[0], :count].tolist()
        return streams

    def spread(self, row: Sequence[int], counters: int) -> NDArray[np.uint64]:
        """Return a row for each draw, (n, len(row)). `row`: what they have in common; `counters`: an
        address."""
        rows = np.empty((len(self.prepared_indices), len(row)), np.uint64)
        rows[:] = row
        rows[:, PREPARED] = self.prepared_indices
        words = rows.view(np.uint32)
        words[:, 2 * INSTANCES], words[:, 2 * INSTANCES + 1] = self.instances, self.numbers
        if self.samples is not None:
            rows[:, SAMPLES] = counters + self.samples
        if self.conditions is not None:
            rows[:, CONDITION], rows[:, INVERTED] = self.conditions, 0
        return rows


def number_in_runs(indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return each element's number in its run of equal rows."""
    positions = np.arange(len(indices))
    begins = np.where(np.diff(indices, prepend=-1) != 0, positions, 0)
    return positions - np.maximum.accumulate(begins)


def tabulate(
    prepared: PreparedDraws,
    layout: BoundWords,
    rows: NDArray[np.uint64],
    numbers: NDArray[np.int64],
    instances: NDArray[np.int64],
) -> Iterator[Piece]:
    """Yield the pieces of many draws.

    Args:
        rows: (n, …) the draws' rows.
        numbers: (n,) their prepared draws.
        instances: (n, 2) their numbers of instances, and their numbers in their arrays.
    """
    draws, streams = prepared.take(numbers), prepared.streams[numbers, : layout.streams]
    for part, table in number_groups(draws, instances[:, 0]):
        mine, written = rows[part], table[:-1]
        written["view"], written["samples"] = mine[:, VIEW], mine[:, SAMPLES]
        written["condition"], written["inverted"] = mine[:, CONDITION], mine[:, INVERTED]
        written["binding_index"], written["number"] = np.arange(len(mine)), instances[part, 1]
        bound = np.concatenate([mine[:, FIXED_COLUMNS:], streams[part]], axis=1)
        for at, size in layout.elements:
            bound[:, at] //= np.uint64(size)
        yield pack_table(table), bound.tobytes()


def tabulate_draw(prepared: PreparedDraws, layout: BoundWords, words: array[int]) -> Piece | None:
    """Return the piece of a single draw, or None if its instances need several pieces."""
    field, numbered, view, samples, condition, inverted, *bound = words
    draw = prepared.draws[field].tobytes()
    instances = numbered & 0xFFFFFFFF
    vertex_groups, groups = (instances * count for count in _GROUPS.unpack_from(draw, _AT["vertex_groups"]))
    if instances > 1 and vertex_groups > _FIRST_PIECE_GROUPS:
        return None
    table = bytearray(2 * DRAW_STRUCT.itemsize)
    table[: len(draw)] = draw
    _COUNTERS.pack_into(table, _AT["samples"], samples, condition)
    _STATES.pack_into(table, _AT["number"], numbered >> 32, 0, view, inverted)
    _GROUPS.pack_into(table, DRAW_STRUCT.itemsize + _AT["vertex_group"], vertex_groups, groups)
    streams = prepared.streams[field, : layout.streams].tolist()
    return (1, vertex_groups, groups, bytes(table)), bind_words(layout, bound, streams)


def bind_words(layout: BoundWords, words: Iterable[int], streams: list[int]) -> bytes:
    """Return the words that a draw binds as kernels read them: sizes become numbers of elements."""
    bound = [*words, *streams]
    for at, size in layout.elements:
        bound[at] //= size
    return array("Q", bound).tobytes()


def number_groups(
    prepared: NDArray[Any], instances: NDArray[np.int64]
) -> Iterator[tuple[slice | NDArray[np.intp], NDArray[Any]]]:
    """Yield the pieces of draws: their indices, and a table with their groups numbered. The table's last row
    holds the ends of the groups."""
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
    """Split draws of many instances so that none exceeds the first piece, unless a single instance does.
    Return each part's draw, its number of instances, and the number of instances before it."""
    most = np.maximum(_FIRST_PIECE_GROUPS // np.maximum(groups, 1), 1)
    parts = np.maximum(-(-instances // most), 1)
    if parts.sum() > _MAX_PARTS:
        given = f"{int((groups * instances).sum()) * GROUP:,} vertices in one draw"
        raise DeviceError(DEVICE_MEMORY, "draw", given)
    which = repeat_each(np.arange(len(parts)), parts)
    done = (np.arange(len(which)) - repeat_each(np.cumsum(parts) - parts, parts)) * most[which]
    return which, np.minimum(most[which], instances[which] - done), done


def pack_table(table: NDArray[Any]) -> Table:
    """Return a table of `number_groups` as kernels read it."""
    groups = int(table["vertex_group"][-1]), int(table["primitive_group"][-1])
    return len(table) - 1, *groups, table.tobytes()
