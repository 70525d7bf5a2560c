"""Occlusion queries that are asked together: a loop of three calls of GL per query, and one per answer.

- GL has a name for each query and nothing for many. So what is saved is Python: queries, and places in memory for the
  answers, are looked up once per set, and the arguments of all draws come out of an array at once.
- Answers come in order: where the last one is there, GL promises that those before it are.
- While a COUNTER runs, only one query of GL at a time may count, and it does. Queries are then differences of it, taken
  one by one; so are those of draws that need the CPU (QUADS).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl import enums
from rhi.backends.gl.draws import DrawCalls
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.queries import Queries
from rhi.contract.backend import Backend
from rhi.contract.descriptors import Id, Primitive
from rhi.contract.queries import PlainQueries

__rhi_internal__ = True


class _DrawingBackend(Backend, Protocol):
    """The backend, as this module sees it."""

    def activate(self) -> None:
        """Make its context the current one."""

    def prepare_calls(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any]) -> DrawCalls:
        """What draws an array of draws, with the bound program. Not for QUADS."""


class GlQuerySet:
    """See `rhi.contract.backend.PreparedQueries`."""

    def __init__(
        self, backend: _DrawingBackend, gl: EntryPoints, queries: Queries, ids: Sequence[Id]
    ) -> None:
        self._backend = backend
        self._gl = gl
        self._queries = queries
        self._made = [queries[query] for query in ids]
        self._answers = np.zeros(len(ids), np.uint64)
        start = self._answers.ctypes.data
        self._places = [ctypes.c_void_p(start + 8 * place) for place in range(len(ids))]
        self._there = ctypes.c_uint64()
        self._plain = PlainQueries(backend, ids)
        self._is_plain = False

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], rows: NDArray[np.int64]
    ) -> None:
        self._is_plain = self._queries.is_counting or primitive is Primitive.QUADS
        if self._is_plain:
            self._plain.draw(vertex_array, primitive, draws, rows)
            return
        begin, end, samples_passed, renew = (
            self._gl.BeginQuery, self._gl.EndQuery, enums.SAMPLES_PASSED, self._queries.renew,
        )  # fmt: skip
        call, arguments = self._backend.prepare_calls(vertex_array, primitive, draws)
        made, current = self._made, None
        try:
            for row, draw in zip(rows.tolist(), arguments, strict=True):
                query = made[row]
                if query is not current:
                    if current is not None:
                        end(samples_passed)
                    if query.is_pending:
                        renew(query)
                    query.is_pending, query.begin, query.end = True, None, None
                    begin(samples_passed, query.name)
                    current = query
                call(*draw)
        finally:
            if current is not None:
                end(samples_passed)

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        if self._is_plain:
            return self._plain.read(rows)
        self._backend.activate()
        get, result = self._gl.GetQueryObjectui64v, enums.QUERY_RESULT
        asked = [self._made[row] for row in rows.tolist()]
        get(asked[-1].name, enums.QUERY_RESULT_AVAILABLE, ctypes.byref(self._there))
        if not self._there.value:
            return None
        for query, place in zip(asked, self._places, strict=False):
            get(query.name, result, place)
            query.is_pending = False
        return self._answers[: len(asked)].astype(np.int64)
