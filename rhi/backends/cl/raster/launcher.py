"""Launches the kernels of a batch: vertices, set-up, binning, raster.

- A piece's vertices are transformed all at once, its primitives rasterised in slices, which bounds the memory
  in flight: the records of a slice lie in scratch memory that the next slice overwrites.
- Bounds of depth stay in memory from slice to slice and from batch to batch, until anything but draws that
  keep them changes the depth that they belong to.
"""

from __future__ import annotations

from functools import cached_property
from typing import Final

import pyopencl as cl

from rhi.backends.cl.builds import Builds
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.memory.pools import Pool, Uploads
from rhi.backends.cl.raster.batches import BatchState, GatheredDraws
from rhi.backends.cl.raster.boxes import AttributeBoxes
from rhi.backends.cl.raster.cl_pipelines import GeometryKernels
from rhi.backends.cl.raster.draw_tables import Piece
from rhi.backends.cl.raster.kernel_structs import (
    EXTENT_BYTES,
    GROUP,
    PART,
    RECORD_BYTES,
    TILE,
    pack_batch,
    varying_words,
)

_SLICE_GROUPS: Final = 1 << 15  # 512 k records: 74 MiB of records, boxes and lists
_CHUNKS: Final = 32  # of a slice: enough to balance a few cores, few enough to keep the counts of tiles small
_MIN_CHUNK: Final = 8  # groups; fewer aren't worth a work-item
_VERTEX_CHUNK: Final = 64  # groups of vertices that a work-item transforms
_FEW_GROUPS: Final = 8  # each tile looks through a slice this small, which costs less than lists
_LIST_WORDS: Final = 1 << 20  # the smallest size of the tiles' lists
_LISTED_PER_RECORD: Final = 4

POOLS: Final = (
    "positions",
    "clips",
    "varyings",
    "extents",
    "records",
    "planes",
    "boxes",
    "counts",
    "starts",
    "list",
    "survivors",
    "scratch",
    "bounds",
)
"""The fields of a batch table that are addresses of scratch memory."""


class Scratch:
    """The scratch memory of all kernels.

    Attributes:
        pools: one for each purpose, by the field of the batch table that holds its address.
    """

    def __init__(self, in_flight: InFlight) -> None:
        self.pools = {name: Pool(in_flight) for name in POOLS}
        self._fields: dict[str, int] = {}
        self._reserved_for: object = None

    def reserve(self, vertices: int, records: int, tiles: int, words: int, shades: float) -> dict[str, int]:
        """Reserve memory for a piece's vertices and a slice's records; return the batch table's fields for
        it.

        Args:
            words: size of a vertex's varyings.
            shades: whether there is a fragment stage.

        Raises:
            pyopencl.Error: out of memory.
        """
        requested = vertices, records, tiles, words, shades
        if requested != self._reserved_for:
            listed = max(_LIST_WORDS, records * _LISTED_PER_RECORD)
            sizes = {
                "positions": 16 * vertices,
                "clips": 16 * vertices,
                "varyings": 4 * words * vertices,
                "extents": EXTENT_BYTES * vertices // GROUP,
                "bounds": 4 * (TILE // PART) ** 2 * tiles,
                "records": RECORD_BYTES * records,
                "planes": RECORD_BYTES * records if shades else 0,
                "boxes": 4 * records,
                "counts": 4 * _CHUNKS * tiles,
                "starts": 4 * (tiles + 1),
                "survivors": 4 * _CHUNKS,
                "scratch": 4 * 3 * GROUP * _CHUNKS,
                "list": 4 * listed,
            }
            self._reserved_for = None
            self._fields = {name: self.pools[name].reserve(size) for name, size in sizes.items()}
            self._fields["list_size"] = listed
            self._reserved_for = requested
        return self._fields


class Launcher:
    """Launches the batches of one device."""

    def __init__(
        self, context: ClContext, builds: Builds, in_flight: InFlight, boxes: AttributeBoxes
    ) -> None:
        self._queue = context.queue
        self._builds = builds
        self._boxes = boxes
        self._uploads = Uploads()
        self._scratch = Scratch(in_flight)
        self._bounds: tuple[object, ...] | None = (
            None  # what the bounds of depth in memory depend on, see BatchState
        )

    @cached_property
    def geometry(self) -> GeometryKernels:
        """The kernels that all batches share, built on first use."""
        return GeometryKernels(self._builds)

    def release(self) -> None:
        """Release all kernels and scratch memory; nothing is launched any more."""
        vars(self).pop("geometry", None)
        self._scratch.pools.clear()

    def launch(self, draws: GatheredDraws) -> cl.Event | None:
        """Rasterise the draws of a batch; return the event of the last kernel.

        Raises:
            pyopencl.Error: out of memory; the draws are lost.
            ShaderError: a checked program found a fault.
        """
        state = draws.state
        table, bounds = state.table, state.identify_bounds()
        table["counters"] = draws.counters
        table["bounded"] = state.bounds_depth and bounds == self._bounds
        table["cleared"] = sum(
            1 << index for index, surface in enumerate(state.surfaces) if surface.clear is not None
        )
        self._bounds = None
        event = None
        try:
            for piece in draws.pieces:
                event = self._launch_piece(state, piece, draws.views) or event
            self._boxes.mark_measured()
        finally:
            self._boxes.drop()
        if event is not None:
            self._uploads.release(event)
            self._bounds = bounds if state.leaves_bounds else None
            for faults in state.pipeline.faults.values():
                faults.read(self._queue)
        return event

    def _launch_piece(self, state: BatchState, piece: Piece, views: bytes) -> cl.Event | None:
        (count, vertex_groups, groups, draws), bound = piece
        if not groups:
            return None
        merger_data = b"".join(state.merger_data)
        tables = draws, bound, merger_data, views
        address = self._uploads.write(b"".join(tables))
        table = state.table
        table["draw_count"], table["vertex_groups"], table["vertex_chunk"] = (
            count,
            vertex_groups,
            _VERTEX_CHUNK,
        )
        for name, part in zip(("draws", "bindings", "merger", "views"), tables, strict=True):
            table[name] = address
            address += len(part)
        room = int(table["edges"]) or 1  # records of a primitive
        slice_groups = max(_SLICE_GROUPS // room, 1)
        table.update(
            self._scratch.reserve(
                vertex_groups * GROUP,
                min(groups, slice_groups) * GROUP * room,
                int(table["tiles"]),
                varying_words(state.pipeline.descriptor),
                table["shades"],
            )
        )
        return self._launch_slices(state, vertex_groups, groups, slice_groups, GROUP * room)

    def _launch_slices(
        self, state: BatchState, vertex_groups: int, groups: int, slice_groups: int, group_records: int
    ) -> cl.Event | None:
        """Launch all kernels of a piece; return the event of the last one. `group_records`: the most of a
        group."""
        table, vertex = state.table, state.vertex
        geometry = self.geometry
        queue = self._queue
        tiles, merger = int(table["tiles"]), table["merger"]
        event = None
        for first in range(0, groups, slice_groups):
            end = min(first + slice_groups, groups)
            chunk = max(_MIN_CHUNK, -(-(end - first) // _CHUNKS))
            chunks = -(-(end - first) // chunk)
            table["first_group"], table["end_group"] = first, end
            table["chunk_groups"], table["chunks"] = chunk, chunks
            table["chunk_records"] = chunk * group_records
            table["listed"] = listed = tiles > 1 and end - first > _FEW_GROUPS
            table["layer"] = state.layers[0]
            batch = self._uploads.write(pack_batch(state.addresses, table))
            if first == 0:
                if vertex.measure is not None and self._boxes.has_unmeasured:
                    vertex.measure.launch(queue, batch, int(table["draw_count"]))
                vertex.transform.launch(queue, batch, -(-vertex_groups // _VERTEX_CHUNK))
            for index, layer in enumerate(state.layers):
                if index:
                    table["layer"] = layer
                    table["merger"] = merger + index * len(state.merger_data[0])
                    batch = self._uploads.write(pack_batch(state.addresses, table))
                geometry.set_up.launch(queue, batch, chunks)
                if listed:
                    geometry.prefix.launch(queue, batch, 1)
                    geometry.scatter.launch(queue, batch, chunks)
                event = state.raster.launch(queue, batch, tiles)
            table["merger"] = merger
            table["bounded"], table["cleared"] = state.leaves_bounds, 0
            for surface in state.surfaces:
                surface.clear = None
        return event
