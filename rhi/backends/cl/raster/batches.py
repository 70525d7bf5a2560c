"""The batch that draws are gathered in until they are flushed.

- A draw is a row of 64-bit words in one flat array (`rhi.backends.cl.raster.draw_columns`). Consecutive draws
  of one pass and pipeline form a batch, whatever they bind; what they have in common is a `BatchState`.
- An array of draws that is alone in its batch is kept as it is: its tables are made once
  (`draw_tables.DrawList`).
- `Batch.take` turns the rows into tables (`draw_tables`); `launcher.Launcher` runs the kernels on them.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.builds import Kernel
from rhi.backends.cl.raster.boxes import AttributeBoxes
from rhi.backends.cl.raster.cl_pipelines import Pipeline, VertexKernels
from rhi.backends.cl.raster.draw_columns import CONDITION, FIXED_COLUMNS, INSTANCES, PREPARED, SAMPLES, VIEW
from rhi.backends.cl.raster.draw_tables import (
    BoundWords,
    DrawList,
    Piece,
    PreparedDraws,
    bind_words,
    tabulate,
    tabulate_draw,
)
from rhi.backends.cl.raster.kernel_structs import (
    EMPTY_BATCH,
    MAX_PLANES,
    TILE,
    varying_word,
    varying_words,
)
from rhi.backends.cl.raster.merger import MergerKey
from rhi.backends.cl.raster.pass_surfaces import PassSurfaces
from rhi.contract.descriptors import Interpolation

_ONE_LAYER: Final = (-1,)
_EDGES: Final = 3  # of a triangle
_FIRST_GREATER: Final = 4  # the first comparison that greater depths pass, see merger.py


class BatchState:
    """The state of one batch.

    Attributes:
        bound: the words that its draws bind.
        width: number of columns of the draws' rows.
        table: fields of the batch table, without what the launcher fills in.
        surfaces: the surfaces that the raster kernel draws into.
        `addresses`: the addresses of their memory.
        layers: the layers that its kernels run for, one after the other; −1 alone if they don't choose one.
        merger_data: by layer, bytes that tell kernels the merger's key, where the surfaces begin in their
            memory and what they are cleared to.
        bounds_depth: whether the key permits bounds of depth.
    """

    __slots__ = (
        "addresses",
        "bound",
        "bounds_depth",
        "layers",
        "merger_data",
        "pipeline",
        "raster",
        "surfaces",
        "table",
        "target",
        "vertex",
        "width",
    )

    def __init__(
        self,
        pipeline: Pipeline,
        target: PassSurfaces,
        vertex: VertexKernels,
        streams: int,
        raster: Kernel,
        key: MergerKey,
        table: dict[str, float],
    ) -> None:
        """`table` is a result of `describe_batch`."""
        self.pipeline = pipeline
        self.target = target
        self.vertex = vertex
        self.bound = BoundWords(pipeline.elements, streams)
        self.raster = raster
        self.width = FIXED_COLUMNS + pipeline.starts[-1]
        surfaces = self.surfaces = target.surfaces_of(key)
        self.addresses = [surface.address for surface in surfaces] + [0] * (MAX_PLANES - len(surfaces))
        chooses = bool(target.layers) and table["target_layer"] >= 0
        self.layers = tuple(range(target.layers)) if chooses else _ONE_LAYER
        patterns = b"".join([surface.pattern for surface in surfaces])
        self.merger_data = [
            key.words + _pack_layouts([surface.layout_of(max(layer, 0)) for surface in surfaces]) + patterns
            for layer in self.layers
        ]
        self.bounds_depth = key.bounds_depth and not target.layers
        self.table = table.copy()
        self.table["binding_words"] = pipeline.starts[-1] + streams

    @property
    def leaves_bounds(self) -> bool:
        """True if the raster kernel that ran last left bounds of depth in memory; general kernels don't."""
        return self.bounds_depth and not self.raster.is_quick

    def identify_bounds(self) -> tuple[object, ...]:
        """The key of the depth bounds in memory: surface, comparison, and changes other than
        draws."""
        texture, depth = self.target.texture, self.target.depth
        surface = depth and (depth.address, depth.layout)
        return surface, bool(self.table["near_is_less"]), texture, texture and texture.changes


def _pack_layouts(layouts: Iterable[tuple[int, int, int]]) -> bytes:
    return array("Q", [word for layout in layouts for word in layout]).tobytes()


def describe_batch(
    pipeline: Pipeline, size: tuple[int, int], key: MergerKey, wireframe: bool
) -> dict[str, float]:
    """Return the batch table's fields that follow from the pipeline, the size (width, height) of the target,
    and `wireframe`: whether triangles are drawn as lines."""
    tiles_x, tiles_y = (-(-length // TILE) for length in size)
    interpolations = {varying.interpolation for varying in pipeline.descriptor.varyings}
    return EMPTY_BATCH | {
        "width": size[0],
        "height": size[1],
        "tiles_x": tiles_x,
        "tiles": tiles_x * tiles_y,
        "edges": _EDGES if wireframe else 0,
        "samples": key.samples,
        "shades": key.shades,
        "linear": Interpolation.NO_PERSPECTIVE in interpolations,
        "near_is_less": key.depth_comparison < _FIRST_GREATER,
        "depth_step": key.depth_step,
        "stage": pipeline.stage_address,
        "varying_words": varying_words(pipeline.descriptor),
        "point_size": varying_word(pipeline.descriptor, pipeline.descriptor.point_size),
        "target_layer": varying_word(pipeline.descriptor, pipeline.descriptor.target_layer),
    }


class GatheredDraws(NamedTuple):
    """The draws of a batch, ready to be launched.

    Attributes:
        pieces: their tables; they may be computed while earlier pieces run.
        views: the `VIEW_STRUCT`s that the tables refer to.
        counters: the address that the tables' counter offsets are relative to; 0 if they hold addresses.
    """

    state: BatchState
    pieces: Iterable[Piece]
    views: bytes
    counters: int


class Batch:
    """The draws gathered and not yet flushed.

    Attributes:
        state: what they have in common. It is replaced only while the batch is empty.
        rows: their rows, one after the other, `state.width` words each; empty while a draw list is alone.
        views: the `VIEW_STRUCT`s that the rows' VIEW columns number.
    """

    def __init__(self, prepared: PreparedDraws, boxes: AttributeBoxes) -> None:
        self._prepared = prepared
        self._boxes = boxes
        self.state: BatchState | None = None
        self.rows = array("Q")
        self.views: list[bytes] = []
        self._alone: tuple[DrawList, Sequence[int], int] | None = None  # the arguments of `gather`

    def __bool__(self) -> bool:
        """Return whether any draws are gathered."""
        return bool(self.rows) or self._alone is not None

    def gather(self, draws: DrawList, row: Sequence[int], counters: int = 0) -> None:
        """Add the draws of an array, which share `row`. `counters`: the address that counter offsets are
        relative to."""
        if self or row[VIEW] or row[CONDITION] or (row[SAMPLES] and draws.samples is None):
            self.spread()
            self.rows.frombytes(draws.spread(row, counters).tobytes())
        else:
            self._alone = draws, row, counters

    def spread(self) -> None:
        """Convert a draw list that is alone in the batch to rows, since other draws follow."""
        if self._alone is not None:
            draws, row, counters = self._alone
            self._alone = None
            self.rows.frombytes(draws.spread(row, counters).tobytes())

    def drop_partial_row(self) -> None:
        """Remove the words of a row that could not be written to its end: they would shift all rows behind
        them."""
        assert self.state is not None
        del self.rows[len(self.rows) - len(self.rows) % self.state.width :]

    def take(self) -> GatheredDraws:
        """Remove and return the gathered draws; there is at least one.

        Raises:
            pyopencl.Error: out of memory for boxes; the draws are lost.
        """
        try:
            state = self.state
            alone = self._alone
            words = self.rows[:]
            views = b"".join(self.views)
        finally:  # also if an interrupt comes: rows of prepared draws are used again from here on
            self._alone = None
            del self.rows[:]
            del self.views[:]
        assert state is not None
        if alone is None:
            return GatheredDraws(state, self._tabulate(state, words), views, 0)
        draws, row, counters = alone
        if draws.boxed != self._prepared.version and not self._choose_boxes(
            state, draws.prepared_indices, draws.instances
        ):
            draws.boxed = self._prepared.version
        bound = bind_words(state.bound, row[FIXED_COLUMNS:], draws.list_streams(state.bound.streams))
        return GatheredDraws(state, [(table, bound) for table in draws.tables], views, counters)

    def _tabulate(self, state: BatchState, words: array[int]) -> Iterable[Piece]:
        if len(words) == state.width:
            piece = tabulate_draw(self._prepared, state.bound, words)
            if piece is not None:
                return (piece,)
        rows = np.frombuffer(words.tobytes(), np.uint64).reshape(-1, state.width)
        numbers = rows[:, PREPARED].astype(np.int64)
        instances = rows.view(np.uint32)[:, 2 * INSTANCES : 2 * INSTANCES + 2].astype(np.int64)
        self._choose_boxes(state, numbers, instances[:, 0])
        return tabulate(self._prepared, state.bound, rows, numbers, instances)

    def _choose_boxes(
        self, state: BatchState, numbers: NDArray[np.int64], instances: NDArray[np.int64]
    ) -> bool:
        """Select the draws whose boxes the batch measures; return whether some draws still lack a box."""
        return state.vertex.measure is not None and self._boxes.assign_boxes(numbers, instances)
