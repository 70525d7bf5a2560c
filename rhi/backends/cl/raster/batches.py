"""Draws, gathered into batches and then rasterised.

- A draw is a row of 64-bit words in one flat array: its prepared part (`PreparedDraws`), instances, view, counter,
  condition, and what is bound. Consecutive draws of one pass and pipeline make a batch, whatever they bind.
- An array of draws (`DrawList`) that is a batch of its own has a table that is made once, however often it comes.
- What draws have in common stands in the table that kernels are given from `begin` on; a batch fills in the rest.
- `flush` turns the rows into the tables of kernels/common.cl by NumPy, whole columns at a time, and launches vertex,
  set-up, binning and raster kernels. Whoever enqueues something else flushes first.
- Batches of many vertices or primitives go in pieces and slices, which bounds the memory in flight: a slice's records
  lie in pools that the next one uses again.
- Bounds of depth stay in memory from slice to slice and from batch to batch, as long as nothing but draws that keep
  them changes the depth that they belong to.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from struct import Struct
from typing import Any, Final, TypeAlias

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.context import ClContext
from rhi.backends.cl.pools import Addresses, Pool, Retired, Uploads
from rhi.backends.cl.raster.boxes import Boxes
from rhi.backends.cl.raster.builds import Builds, Kernel
from rhi.backends.cl.raster.merger import MergerKey
from rhi.backends.cl.raster.pipelines import Geometry, Pipeline, VertexKernels
from rhi.backends.cl.raster.prepared import PreparedDraws
from rhi.backends.cl.raster.tables import (
    DRAW,
    EMPTY_BATCH,
    EXTENT_BYTES,
    GROUP,
    MAX_PLANES,
    PART,
    RECORD_BYTES,
    TILE,
    pack_batch,
    varying_words,
)
from rhi.backends.cl.raster.targets import Surface, Target
from rhi.contract.descriptors import Interpolation

__rhi_internal__ = True

_SLICE_GROUPS: Final = 1 << 15  # 512 k primitives: 74 MiB of records, boxes and lists
_PIECE_GROUPS: Final = 1 << 15  # of vertices: 512 k, 16 MiB of positions; more hide less of each other
_FIRST_PIECE_GROUPS: Final = 1 << 14  # then each is twice the last one
_CHUNKS: Final = 32  # of a slice: enough to balance a few cores, few enough that counts of tiles stay small
_MIN_CHUNK: Final = 8  # groups: less isn't worth a work-item
_VERTEX_CHUNK: Final = 64  # groups
_FEW_GROUPS: Final = (
    8  # a slice of so few is looked through by each tile, which costs less than to make lists
)
_LIST_WORDS: Final = 1 << 20  # at the least
_LISTED_PER_PRIMITIVE: Final = 4
_FIRST_GREATER: Final = 4  # of the numbers of comparisons, see targets.py

# Fields of `DRAW` that follow one another.
_AT: Final = {name: place[1] for name, place in (DRAW.fields or {}).items()}
_COUNTERS: Final = Struct("=2Q")  # samples, condition
_GROUPS: Final = Struct("=2i")  # vertex_group, primitive_group, or how many of both
_STATES: Final = Struct("=4i")  # number, row, view, inverted

Table: TypeAlias = tuple[int, int, int, bytes]
"""Of draws: how many, their groups of vertices and of primitives, themselves."""
Piece: TypeAlias = tuple[Table, bytes]
"""Of a batch: some of its draws, and what they bind."""

# Columns of a row before what is bound. The upper half of INSTANCES is the draw's number among those of its array.
PREPARED, INSTANCES, VIEW, SAMPLES, CONDITION, INVERTED = range(6)
FIXED_COLUMNS: Final = 6
COUNTER_BYTES: Final = 8

POOLS: Final = (
    "positions", "clips", "varyings", "extents", "records", "planes", "boxes", "counts", "starts", "list", "survivors",
    "scratch", "bounds",
)  # fmt: skip
"""The addresses in a batch that are those of scratch memory."""


class DrawList:
    """Draws of an array, which bind the same.

    Attributes:
        numbers: (n,) of each among the draws of its array.
        samples: (n,) of each one's counter, in bytes from the batch's `counters` on; None: they aren't told apart.
        boxed: the version of the prepared draws in which all have boxes that are to have one.
    """

    __slots__ = (
        "_holders", "_prepared", "_tables", "_version", "boxed", "instances", "numbers", "places", "samples",
    )  # fmt: skip

    def __init__(
        self, prepared: PreparedDraws, places: NDArray[np.int64], holders: object, instances: NDArray[np.int64],
        counters: NDArray[np.int64] | None,
    ) -> None:  # fmt: skip
        """`holders` keep the places; `counters` are numbers of those that draws are counted by: they have no numbers of
        their own then."""
        self._prepared = prepared
        self._holders = holders
        self._tables: list[Table] = []
        self._version = self.boxed = -1
        self.places = places
        self.instances = instances
        self.numbers = np.arange(len(places)) if counters is None else np.zeros(len(places), np.int64)
        self.samples = None if counters is None else COUNTER_BYTES * (1 + counters)

    @property
    def tables(self) -> list[Table]:
        """Those of draws that have the first view and row, and no condition."""
        if self._version != self._prepared.version:
            self._tables.clear()
            self._version = self._prepared.version
            for part, table in number_groups(self._prepared.take(self.places), self.instances):
                table["number"][:-1] = self.numbers[part]
                if self.samples is not None:
                    table["samples"][:-1] = self.samples[part]
                self._tables.append(pack_table(table))
        return self._tables

    def list_streams(self, count: int) -> list[int]:
        """The addresses of the vertex streams, the same for all of one vertex array."""
        streams: list[int] = self._prepared.streams[self.places[0], :count].tolist()
        return streams

    def spread(self, row: Sequence[int], counters: int) -> NDArray[np.uint64]:
        """A row for each draw."""
        rows = np.empty((len(self.places), len(row)), np.uint64)
        rows[:] = row
        rows[:, PREPARED] = self.places
        words = rows.view(np.uint32)
        words[:, 2 * INSTANCES], words[:, 2 * INSTANCES + 1] = self.instances, self.numbers
        if self.samples is not None:
            rows[:, SAMPLES] = counters + self.samples
        return rows


class Batch:
    """The draws gathered and not yet flushed.

    Attributes:
        rows: their words, `width` for each draw, unless a list is alone.
        views: what their VIEW columns number.
    """

    def __init__(self, context: ClContext, builds: Builds, addresses: Addresses, retired: Retired) -> None:
        self._builds = builds
        self._queue = context.queue
        self.prepared = PreparedDraws()
        self.rows = array("Q")
        self._alone: tuple[DrawList, Sequence[int], int] | None = None  # and what `gather` was told with it
        self.views: list[bytes] = []
        self.pipeline: Pipeline | None = None
        self.target: Target | None = None
        self.vertex: VertexKernels | None = None
        self.raster: Kernel | None = None
        self._table = EMPTY_BATCH.copy()
        self._surfaces: list[Surface] = []  # that its raster kernel draws into
        self._addresses = [0] * MAX_PLANES  # of theirs
        self._places = b""  # where they begin in their memory, and what they are cleared to
        self._bounds_depth = False  # whether its raster kernel leaves bounds
        self._bounds: tuple[object, ...] | None = None  # what the bounds in memory belong to
        self._scratch: dict[str, int] = {}  # scratch memory, as a batch has it
        self._wanted: object = None  # what it is for
        self._streams = 0
        self._width = FIXED_COLUMNS
        self._uploads = Uploads(context, addresses)
        self._pools = {name: Pool(context, addresses, retired) for name in POOLS}
        self.boxes = Boxes(self.prepared, Pool(context, addresses, retired))

    @cached_property
    def geometry(self) -> Geometry:
        """The kernels that all batches share, built when first asked for."""
        return Geometry(self._builds)

    def __bool__(self) -> bool:
        """Whether draws were gathered."""
        return bool(self.rows) or self._alone is not None

    def gather(self, draws: DrawList, row: Sequence[int], counters: int = 0) -> None:
        """Add draws that have `row` in common, and are counted from the address `counters` on."""
        if self or row[VIEW] or row[CONDITION] or (row[SAMPLES] and draws.samples is None):
            self.mix()
            self.rows.frombytes(draws.spread(row, counters).tobytes())
        else:
            self._alone = draws, row, counters

    def mix(self) -> None:
        """Other draws follow: none is alone."""
        if self._alone is not None:
            draws, row, counters = self._alone
            self._alone = None
            self.rows.frombytes(draws.spread(row, counters).tobytes())

    def begin(
        self, pipeline: Pipeline, target: Target, vertex: VertexKernels, streams: int, raster: Kernel,
        key: MergerKey, table: dict[str, float],
    ) -> None:  # fmt: skip
        """What the next draws have in common; `table`: of `describe_batch`. The batch is empty."""
        self.pipeline, self.target, self.vertex, self._streams = pipeline, target, vertex, streams
        self.raster = raster
        self._width = FIXED_COLUMNS + pipeline.starts[-1]
        surfaces = self._surfaces = target.surfaces_of(key)
        self._addresses = [surface.address for surface in surfaces] + [0] * (MAX_PLANES - len(surfaces))
        places = array("Q", [word for surface in surfaces for word in surface.place])
        self._places = places.tobytes() + b"".join([surface.pattern for surface in surfaces])
        self._bounds_depth = key.bounds_depth
        self._table = table.copy()
        self._table["row_words"] = pipeline.starts[-1] + streams

    def flush(self) -> cl.Event | None:
        """Rasterise what was gathered. The event is that of the last kernel.

        Raises:
            pyopencl.Error: out of memory; the draws are lost.
            ShaderError: a checked program found a fault.
        """
        if not self:
            return None
        assert self.target is not None
        assert self.pipeline is not None
        pieces, views = self._take_pieces(), b"".join(self.views)
        self.views.clear()
        texture = self.target.texture
        depth = self.target.depth and (self.target.depth.address, self.target.depth.place)
        bounds = depth, bool(self._table["near_is_less"]), texture, texture and texture.changes
        self._table["bounded"] = self._bounds_depth and bounds == self._bounds
        self._table["cleared"] = sum(
            1 << place for place, surface in enumerate(self._surfaces) if surface.clear is not None
        )
        self._bounds = None
        event = None
        try:
            for piece in pieces:
                event = self._draw(piece, views) or event
            self.boxes.keep()
        finally:
            self.boxes.drop()
        self.prepared.recycle()
        if event is not None:
            self._uploads.release(event)
            self._bounds = bounds if self._bounds_depth else None
            for faults in self.pipeline.faults.values():
                faults.read(self._queue)
        return event

    def _take_pieces(self) -> Iterable[Piece]:
        """The pieces of what was gathered, which is forgotten."""
        words, alone = self.rows[:], self._alone
        del self.rows[:]
        self._alone = None
        self._table["counters"] = 0 if alone is None else alone[2]
        if alone is not None:
            draws, row, _ = alone
            if draws.boxed != self.prepared.version and not self._find_boxes(draws.places, draws.instances):
                draws.boxed = self.prepared.version
            bound = self._bind_one(row[FIXED_COLUMNS:], draws.list_streams(self._streams))
            return [(table, bound) for table in draws.tables]
        return self._tabulate_one(words) if len(words) == self._width else self._tabulate(words)

    def _find_boxes(self, places: NDArray[np.int64], instances: NDArray[np.int64]) -> bool:
        """Have boxes measured of draws that come again; gives whether some of the draws are still to have one."""
        assert self.vertex is not None
        return self.vertex.measure is not None and self.boxes.choose(places, instances)

    def _bind_one(self, words: Iterable[int], streams: list[int]) -> bytes:
        """What a draw binds, as kernels see it."""
        assert self.pipeline is not None
        bound = [*words, *streams]
        for at, size in self.pipeline.elements:
            bound[at] //= size
        return array("Q", bound).tobytes()

    def _tabulate(self, words: array[int]) -> Iterator[Piece]:
        """The pieces of many draws: NumPy, whole columns at a time."""
        assert self.pipeline is not None
        rows = np.frombuffer(words.tobytes(), np.uint64).reshape(-1, self._width)
        places = rows[:, PREPARED].astype(np.int64)
        numbered = rows.view(np.uint32)[:, 2 * INSTANCES : 2 * INSTANCES + 2].astype(np.int64)
        self._find_boxes(places, numbered[:, 0])
        draws, streams = self.prepared.take(places), self.prepared.streams[places, : self._streams]
        for part, table in number_groups(draws, numbered[:, 0]):
            mine, own = rows[part], table[:-1]
            own["view"], own["samples"] = mine[:, VIEW], mine[:, SAMPLES]
            own["condition"], own["inverted"] = mine[:, CONDITION], mine[:, INVERTED]
            own["row"], own["number"] = np.arange(len(mine)), numbered[part, 1]
            bound = np.concatenate([mine[:, FIXED_COLUMNS:], streams[part]], axis=1)
            for at, size in self.pipeline.elements:
                bound[:, at] //= np.uint64(size)
            yield pack_table(table), bound.tobytes()

    def _tabulate_one(self, words: array[int]) -> Iterator[Piece]:
        """The same of one draw, which takes plain Python a third of the time."""
        place, numbered, view, samples, condition, inverted, *bound = words
        draw = self.prepared.draws[place].tobytes()
        instances = numbered & 0xFFFFFFFF
        vertex_groups, groups = (
            instances * count for count in _GROUPS.unpack_from(draw, _AT["vertex_groups"])
        )
        if instances > 1 and vertex_groups > _FIRST_PIECE_GROUPS:
            yield from self._tabulate(words)
            return
        table = bytearray(2 * DRAW.itemsize)
        table[: len(draw)] = draw
        _COUNTERS.pack_into(table, _AT["samples"], samples, condition)
        _STATES.pack_into(table, _AT["number"], numbered >> 32, 0, view, inverted)
        _GROUPS.pack_into(table, DRAW.itemsize + _AT["vertex_group"], vertex_groups, groups)
        streams = self.prepared.streams[place, : self._streams].tolist()
        yield (1, vertex_groups, groups, bytes(table)), self._bind_one(bound, streams)

    def _draw(self, piece: Piece, views: bytes) -> cl.Event | None:
        """One piece: its vertices all at once, its primitives slice by slice."""
        (count, vertex_groups, groups, draws), bound = piece
        if not groups:
            return None
        tables = draws, bound, self._places, views
        address = self._uploads.write(b"".join(tables))
        table = self._table
        table["draw_count"], table["vertex_groups"] = count, vertex_groups
        for name, part in zip(("draws", "rows", "places", "views"), tables, strict=True):
            table[name] = address
            address += len(part)
        self._reserve(table, vertex_groups * GROUP, min(groups, _SLICE_GROUPS) * GROUP)
        return self._launch(table, vertex_groups, groups)

    def _reserve(self, batch: dict[str, float], vertices: int, primitives: int) -> None:
        """Scratch memory for a piece's vertices and a slice's primitives."""
        assert self.pipeline is not None
        tiles, words = int(batch["tiles"]), varying_words(self.pipeline.descriptor)
        wanted = vertices, primitives, tiles, words, batch["shades"]
        if wanted != self._wanted:
            listed = max(_LIST_WORDS, primitives * _LISTED_PER_PRIMITIVE)
            sizes = {
                "positions": 16 * vertices,
                "clips": 16 * vertices,
                "varyings": 4 * words * vertices,
                "extents": EXTENT_BYTES * vertices // GROUP,
                "bounds": 4 * (TILE // PART) ** 2 * tiles,
                "records": RECORD_BYTES * primitives,
                "planes": RECORD_BYTES * primitives if batch["shades"] else 0,
                "boxes": 4 * primitives,
                "counts": 4 * _CHUNKS * tiles,
                "starts": 4 * (tiles + 1),
                "survivors": 4 * _CHUNKS,
                "scratch": 4 * 3 * GROUP * _CHUNKS,
                "list": 4 * listed,
            }
            self._wanted = None
            self._scratch = {name: self._pools[name].reserve(size) for name, size in sizes.items()}
            self._scratch["list_size"] = listed
            self._wanted = wanted
        batch.update(self._scratch)

    def _launch(self, batch: dict[str, float], vertex_groups: int, groups: int) -> cl.Event | None:
        """All kernels of a piece; the event is that of the last one."""
        assert self.vertex is not None
        assert self.raster is not None
        geometry, queue, tiles, event = self.geometry, self._queue, int(batch["tiles"]), None
        for first in range(0, groups, _SLICE_GROUPS):
            end = min(first + _SLICE_GROUPS, groups)
            chunk = max(_MIN_CHUNK, -(-(end - first) // _CHUNKS))
            chunks = -(-(end - first) // chunk)
            batch["first_group"], batch["end_group"] = first, end
            batch["chunk_groups"], batch["chunks"] = chunk, chunks
            batch["listed"] = listed = tiles > 1 and end - first > _FEW_GROUPS
            place = self._uploads.write(pack_batch(self._addresses, batch))
            if first == 0:
                if self.boxes.chosen and self.vertex.measure is not None:
                    self.vertex.measure.launch(queue, place, int(batch["draw_count"]))
                self.vertex.transform.launch(queue, place, -(-vertex_groups // _VERTEX_CHUNK))
            geometry.set_up.launch(queue, place, chunks)
            if listed:
                geometry.prefix.launch(queue, place, 1)
                geometry.scatter.launch(queue, place, chunks)
            event = self.raster.launch(queue, place, tiles)
            batch["bounded"], batch["cleared"] = self._bounds_depth, 0
            for surface in self._surfaces:
                surface.clear = None
        return event


def describe_batch(pipeline: Pipeline, size: tuple[int, int], key: MergerKey) -> dict[str, float]:
    """What batches of a pipeline have in common that draw into targets of this size."""
    tiles_x, tiles_y = (-(-length // TILE) for length in size)
    interpolations = {varying.interpolation for varying in pipeline.descriptor.varyings}
    return EMPTY_BATCH | {
        "vertex_chunk": _VERTEX_CHUNK,
        "width": size[0],
        "height": size[1],
        "tiles_x": tiles_x,
        "tiles": tiles_x * tiles_y,
        "samples": key.samples,
        "shades": key.shades,
        "linear": Interpolation.NO_PERSPECTIVE in interpolations,
        "near_is_less": key.depth_passes < _FIRST_GREATER,
        "depth_step": key.depth_step,
    }


def number_groups(
    prepared: NDArray[Any], instances: NDArray[np.int64]
) -> Iterator[tuple[slice | NDArray[np.intp], NDArray[Any]]]:
    """The pieces of draws: which of them, and their table with numbered groups; its last row is where groups end."""
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
        table = np.empty(len(mine) + 1, DRAW)
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
    """Draws of many instances as several of fewer, none more than the first piece holds unless an instance is: which
    draw each is of, its instances, and how many came before them."""
    most = np.maximum(_FIRST_PIECE_GROUPS // np.maximum(groups, 1), 1)
    parts = np.maximum(-(-instances // most), 1)
    which = np.repeat(np.arange(len(parts)), parts)
    done = (np.arange(len(which)) - np.repeat(np.cumsum(parts) - parts, parts)) * most[which]
    return which, np.minimum(most[which], instances[which] - done), done


def pack_table(table: NDArray[Any]) -> Table:
    """A table of `number_groups` as kernels read it."""
    groups = int(table["vertex_group"][-1]), int(table["primitive_group"][-1])
    return len(table) - 1, *groups, table.tobytes()
