"""Query sets: one segment of counters, and draws that name their counters in a column of their rows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.cl_queries import Segment
from rhi.backends.cl.raster.draw_columns import COUNTER_BYTES
from rhi.backends.cl.raster.rasteriser import Rasteriser
from rhi.contract.descriptors import Id, Primitive


class ClQuerySet:
    """See `rhi.contract.backend.PreparedQueries`. Each `draw` has counters of its own: earlier draws may
    still run."""

    def __init__(self, rasteriser: Rasteriser, size: int) -> None:
        self._rasteriser = rasteriser
        self._size = size
        self._segment: Segment | None = None

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], query_indices: NDArray[np.int64]
    ) -> None:
        queries = self._rasteriser.queries
        self._segment = segment = queries.begin_set(self._size)
        try:
            self._rasteriser.draws.draw_counted(
                vertex_array, primitive, draws, query_indices, segment.address
            )
        finally:
            queries.end_set(segment)

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        segment = self._segment
        assert segment is not None
        counters = segment.address + COUNTER_BYTES * query_indices
        is_counted = self._rasteriser.queries.is_submitted(segment)
        self._rasteriser.draws.draw_conditional(
            vertex_array, primitive, buffer, offset, query_indices, counters, is_counted=is_counted
        )

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        assert self._segment is not None
        counted = self._rasteriser.queries.read_set(self._segment)
        return None if counted is None else counted.view(np.int64).take(query_indices)
