"""Occlusion queries of an array of draws, one at a time: what every backend can do, and what those that do more at
once must be like."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract.backend import Backend
from rhi.contract.descriptors import Id, Primitive

__rhi_internal__ = True


class PlainQueries:
    """Occlusion queries that are begun and ended one by one, as every backend can do it."""

    def __init__(self, backend: Backend, queries: Sequence[Id]) -> None:
        self._backend = backend
        self._queries = queries

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], rows: NDArray[np.int64]
    ) -> None:
        """As `PreparedQueries.draw`."""
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

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """As `PreparedQueries.read`."""
        read, queries = self._backend.read_query, self._queries
        answers = np.empty(len(rows), np.int64)
        for place, row in reversed(list(enumerate(rows.tolist()))):  # those that come last first
            samples = read(queries[row])
            if samples is None:
                return None
            answers[place] = samples
        return answers


def list_draws(draws: NDArray[Any]) -> Iterator[tuple[int, int, int, int, int]]:
    """Draws of an array as `Backend.draw` takes them, from `first` on."""
    count, instances, first, base_instance = (
        draws[name].tolist() for name in ("count", "instances", "first", "base_instance")
    )
    indexed = "base_vertex" in (draws.dtype.names or ())
    base_vertex = draws["base_vertex"].tolist() if indexed else [0] * len(draws)
    return zip(first, count, instances, base_vertex, base_instance, strict=True)
