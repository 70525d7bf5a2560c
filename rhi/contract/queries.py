"""Occlusion queries for an array of draws, executed one by one.

Every backend can do this. It is also the reference for backends that execute many queries at once
(`rhi.contract.backend.PreparesQueries`).
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

    def draw(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], rows: NDArray[np.int64]) -> None:
        """Draw and count; see `rhi.contract.backend.PreparedQueries.draw`."""
        backend, queries = self._backend, self._queries
        draw, current = backend.draw, -1
        try:
            for row, arguments in zip(rows.tolist(), list_draws(draws), strict=True):
                if row != current:
                    if current >= 0:
                        ended, current = current, -1
                        backend.end_query(queries[ended])
                    backend.begin_query(queries[row])
                    current = row
                draw(vertex_array, primitive, *arguments)
        finally:
            if current >= 0:
                backend.end_query(queries[current])

    def draw_conditional(
        self, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, rows: NDArray[np.int64]
    ) -> None:
        """Draw on condition; see `rhi.contract.backend.PreparedQueries.draw_conditional`."""
        backend, queries = self._backend, self._queries
        size = DRAW.itemsize
        for row, begin, end in list_runs(rows):
            backend.begin_conditional(queries[row], False)
            try:
                backend.draw_indirect(vertex_array, primitive, buffer, offset + begin * size, end - begin, size, 0, 0)
            finally:
                backend.end_conditional()

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """Return the samples of each row, or None; see `rhi.contract.backend.PreparedQueries.read`."""
        read, queries = self._backend.read_query, self._queries
        answers = np.empty(len(rows), np.int64)
        for place, row in reversed(list(enumerate(rows.tolist()))):  # the latest answers arrive last
            samples = read(queries[row])
            if samples is None:
                return None
            answers[place] = samples
        return answers


def list_draws(draws: NDArray[Any]) -> Iterator[tuple[int, int, int, int, int]]:
    """Yield the arguments of `Backend.draw` from `first` on, for each draw of an array."""
    count, instances, first, base_instance = (
        draws[name].tolist() for name in ("count", "instances", "first", "base_instance")
    )
    indexed = "base_vertex" in (draws.dtype.names or ())
    base_vertex = draws["base_vertex"].tolist() if indexed else [0] * len(draws)
    return zip(first, count, instances, base_vertex, base_instance, strict=True)


def list_runs(rows: NDArray[np.int64]) -> Iterator[tuple[int, int, int]]:
    """Yield the row, begin and end of each run of equal rows, of which there is at least one."""
    begins = np.flatnonzero(np.diff(rows, prepend=-1))
    return zip(rows[begins].tolist(), begins.tolist(), [*begins[1:].tolist(), len(rows)], strict=True)
