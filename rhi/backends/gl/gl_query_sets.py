"""Query sets: many occlusion queries in a loop of three GL calls per query, and one call per result.

- GL names each query and has no calls for many. So this saves Python time: queries and the addresses of their
  results are looked up once per set, and the arguments of all draws are extracted from an array at once.
- Results become available in order: if the last one is available, GL guarantees those before it.
- While a COUNTER is running, GL's only active query belongs to it. Queries are then differences of it, made
  one by one. The same goes for draws that need the CPU (QUADS).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_draws import DrawCalls
from rhi.backends.gl.gl_queries import Queries
from rhi.contract.backend import Backend
from rhi.contract.descriptors import Id, Primitive
from rhi.contract.queries import PlainQueries


class _DrawingBackend(Backend, Protocol):
    """The methods of the backend that this module uses."""

    def activate(self) -> None:
        """Make the backend's context current."""

    def prepare_calls(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any]) -> DrawCalls:
        """Return the calls that draw an array of draws with the bound program; not for QUADS."""


class GlQuerySet:
    """The queries of a set; see `rhi.contract.backend.PreparedQueries`."""

    def __init__(
        self, backend: _DrawingBackend, gl: EntryPoints, queries: Queries, ids: Sequence[Id]
    ) -> None:
        self._backend = backend
        self._gl = gl
        self._queries = queries
        self._gl_queries = [queries[query] for query in ids]
        self._answers = np.zeros(len(ids), np.uint64)
        start = self._answers.ctypes.data
        self._addresses = [ctypes.c_void_p(start + 8 * query_index) for query_index in range(len(ids))]
        self._available = ctypes.c_uint64()
        self._plain = PlainQueries(backend, ids)
        self._is_plain = False

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], query_indices: NDArray[np.int64]
    ) -> None:
        self._is_plain = self._queries.is_counting or primitive is Primitive.QUADS
        if self._is_plain:
            self._plain.draw(vertex_array, primitive, draws, query_indices)
            return
        begin = self._gl.BeginQuery
        end = self._gl.EndQuery
        samples_passed = enums.SAMPLES_PASSED
        renew = self._queries.renew
        call, arguments = self._backend.prepare_calls(vertex_array, primitive, draws)
        gl_queries, current = self._gl_queries, None
        try:
            for query_index, draw in zip(query_indices.tolist(), arguments, strict=True):
                query = gl_queries[query_index]
                if query is not current:
                    if current is not None:
                        current = None  # an interrupt may come as soon as a call returns
                        end(samples_passed)
                    if query.is_pending:
                        renew(query)
                    query.is_pending, query.begin, query.end = True, None, None
                    current = query
                    begin(samples_passed, query.name)
                call(*draw)
        finally:
            if current is not None:
                end(samples_passed)

    def draw_conditional(
        self,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        self._plain.draw_conditional(vertex_array, primitive, buffer, offset, query_indices)

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        if self._is_plain:
            return self._plain.read(query_indices)
        self._backend.activate()
        get, result = self._gl.GetQueryObjectui64v, enums.QUERY_RESULT
        asked = [self._gl_queries[query_index] for query_index in query_indices.tolist()]
        get(asked[-1].name, enums.QUERY_RESULT_AVAILABLE, ctypes.byref(self._available))
        if not self._available.value:
            return None
        for query, address in zip(asked, self._addresses, strict=False):
            get(query.name, result, address)
            query.is_pending = False
        return self._answers[: len(asked)].astype(np.int64)
