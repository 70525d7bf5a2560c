"""Occlusion queries for an array of draws, executed one by one.

Every backend can do this. It is also the reference for backends that execute many queries at once
(`rhi.contract.backend.SupportsPreparedQueries`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract.backend import Backend
from rhi.contract.descriptors import DRAW, Id, Primitive


class PlainQueries:
    """A group of occlusion queries that begins and ends each query with a command of its own."""

    def __init__(self, backend: Backend, queries: Sequence[Id]) -> None:
        self._backend = backend
        self._queries = queries

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], query_indices: NDArray[np.int64]
    ) -> None:
        """Draw and count; see `rhi.contract.backend.PreparedQueries.draw`."""
        backend, queries = self._backend, self._queries
        draw, current = backend.draw, -1
        try:
            for query_index, arguments in zip(query_indices.tolist(), list_draws(draws), strict=True):
                if query_index != current:
                    if current >= 0:
                        ended, current = current, -1
                        backend.end_query(queries[ended])
                    backend.begin_query(queries[query_index])
                    current = query_index
                draw(vertex_array, primitive, *arguments)
        finally:
            if current >= 0:
                backend.end_query(queries[current])

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        """Draw on condition; see `rhi.contract.backend.PreparedQueries.draw_conditional`."""
        backend, queries = self._backend, self._queries
        size = DRAW.itemsize
        for query_index, begin, end in list_runs(query_indices):
            try:
                backend.begin_conditional(queries[query_index], False)
                backend.draw_indirect(
                    vertex_array, primitive, buffer, offset + begin * size, end - begin, size, 0, 0
                )
                backend.end_conditional()
            except BaseException:  # whether it has begun, or ended, or not
                backend.end_conditional()
                raise

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Return the samples of each query, or None; see `rhi.contract.backend.PreparedQueries.read`."""
        read, queries = self._backend.read_query, self._queries
        results = np.empty(len(query_indices), np.int64)
        for index, query_index in reversed(
            list(enumerate(query_indices.tolist()))
        ):  # the latest results arrive last
            samples = read(queries[query_index])
            if samples is None:
                return None
            results[index] = samples
        return results


def list_draws(draws: NDArray[Any]) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield the arguments of `Backend.draw` from `first` on, for each draw of an array."""
    count, instances, first, base_instance = (
        draws[name].tolist() for name in ("count", "instances", "first", "base_instance")
    )
    indexed = "base_vertex" in (draws.dtype.names or ())
    base_vertex = draws["base_vertex"].tolist() if indexed else [0] * len(draws)
    return zip(first, count, instances, base_vertex, base_instance, strict=True)


def list_runs(query_indices: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """Yield the query index, begin and end of each run of equal indices. There is at least one run."""
    begins = np.flatnonzero(np.diff(query_indices, prepend=-1))
    return zip(
        query_indices[begins].tolist(),
        begins.tolist(),
        [*begins[1:].tolist(), len(query_indices)],
        strict=True,
    )
