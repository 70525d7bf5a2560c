"""Query sets: many occlusion queries that one call uses, with their results in one array.

- A set has a number of queries. `draw_counted` draws an array of draws, counts each in a query, and discards
  the earlier results of the set. So a set holds the results of one call, and queries that the call did not
  use hold `NOT_COUNTED`.
- Each is an ordinary occlusion query. A backend may execute them all at once (`SupportsPreparedQueries`).
  Elsewhere, in command buffers and in front of a recorder, they are begun and ended one by one
  (`PlainQueries`), which also defines the behaviour of `SupportsPreparedQueries`.
- An emulated set (thesis 4.4.2) writes the running counter before its first draw and after the last draw of
  each query: one value more than there are queries, with one fence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from rhi.contract.backend import Backend, PreparedQueries, SupportsPreparedQueries
from rhi.contract.descriptors import Id, Primitive
from rhi.contract.queries import PlainQueries, list_draws
from rhi.device.core.core import Core
from rhi.device.queries.occlusion import PendingQuery
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.rules import QUERY_INDICES
from rhi.math.indexing import count_indices

MAX_QUERIES: Final = 1 << 20
"""Largest number of queries of a query set."""

NOT_COUNTED: Final = -1
"""The number of samples of a query that the latest call did not use."""


class EmulatedQueries:
    """`PreparedQueries` by the running counter, with one COUNTER query more than there are queries."""

    def __init__(self, backend: Backend, counters: Sequence[Id]) -> None:
        self._backend = backend
        self._counters = counters

    def draw(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], query_indices: NDArray[np.int64]
    ) -> None:
        """See `PreparedQueries.draw`. Counters are used in their order, whichever queries the draws use."""
        draw, write_counter = self._backend.draw, self._backend.write_query
        counters, current = iter(self._counters), -1
        for query_index, arguments in zip(query_indices.tolist(), list_draws(draws), strict=True):
            if query_index != current:
                write_counter(next(counters))
                current = query_index
            draw(vertex_array, primitive, *arguments)
        write_counter(next(counters))

    def read(self, query_indices: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """See `PreparedQueries.read`; `query_indices` are all queries of the latest call."""
        counts = [self._backend.read_query(counter) for counter in self._counters[: len(query_indices) + 1]]
        if None in counts:
            return None
        values = np.array(counts, np.int64)
        return values[1:] - values[:-1]


class QuerySet(PendingQuery[NDArray[np.int64]]):
    """A set of counters of visible samples, used together by `draw_counted`; created by `device.query_set`.

    `visible_samples` and `wait` return (n,) int64, the number of samples of each query, and −1 for those that
    the latest `draw_counted` did not use. The array is never written again, so it may be kept.
    """

    __slots__ = ("_in_order", "_prepared", "_query_indices", "_reader", "_size")

    def __init__(self, core: Core, size: int, emulated: bool) -> None:
        call = "device.query_set"
        core.check_ready()
        super().__init__(core, size, emulated, call)
        self._size = size
        self._query_indices = np.zeros(0, np.int64)
        self._in_order = np.arange(self._size)
        self._prepared: PreparedQueries | EmulatedQueries = self._plain(core)
        if not self.emulated and hasattr(core.backend, "prepare_queries"):
            self._prepared = cast("SupportsPreparedQueries", core.backend).prepare_queries(self.ids)
        self._reader = self._prepared

    def __len__(self) -> int:
        """Return the number of queries."""
        return self._size

    @property
    def id(self) -> Id:
        """The id of its first query in the command stream; 0 for a set without queries."""
        return self._ids[0] if self._ids else 0

    def check_query_indices(self, query_indices: object, draws: int, call: str) -> NDArray[np.int64]:
        """Return the query that counts each draw, (draws,) int64; `query-indices` if `query_indices` don't
        fit."""
        set_indices = self._resolve_query_indices(query_indices, draws, call)
        if query_indices is None:
            return set_indices
        repeated = count_indices(run_starts(set_indices)) > 1
        if repeated.any():
            repeat = f"query {repeated.argmax()} again after other queries"
            self._core.refuse(QUERY_INDICES, call, repeat, "consecutive draws for each query")
        return set_indices

    def check_conditions(
        self, query_indices: object, draws: int, counted: NDArray[np.int64], call: str
    ) -> NDArray[np.int64]:
        """Return the query that each draw depends on, (draws,) int64; `query-indices` if `query_indices`
        don't fit, or name one that isn't among `counted`."""
        set_indices = self._resolve_query_indices(query_indices, draws, call)
        missing = set_indices[~np.isin(set_indices, counted)]
        if len(missing):
            given = f"query {missing[0]}, in which the latest draw_counted counted nothing"
            self._core.refuse(QUERY_INDICES, call, given, "queries that this command buffer has used")
        return set_indices

    def _resolve_query_indices(self, query_indices: object, draws: int, call: str) -> NDArray[np.int64]:
        """Return the query of each draw, by default query i for draw i; `query-indices` if the set has none
        such."""
        size = len(self)
        if query_indices is None:
            if draws > size:
                self._core.refuse(QUERY_INDICES, call, f"{draws} draws", f"up to {size}, or `query_indices`")
            return self._in_order[:draws]
        array = ArgumentChecker(call, self._core.refuse).array("query_indices", query_indices)
        if array.shape != (draws,) or (draws and array.dtype.kind not in "iu"):
            self._core.refuse(
                QUERY_INDICES,
                call,
                f"indices of shape {array.shape} and {array.dtype}",
                f"({draws},) of integers",
            )
        set_indices: NDArray[np.int64] = array.astype(np.int64)
        if draws and not 0 <= set_indices.min() <= set_indices.max() < size:
            self._core.refuse(
                QUERY_INDICES, call, f"indices {array.min()} to {array.max()}", f"0 to {size - 1}"
            )
        return set_indices

    @property
    def counted(self) -> NDArray[np.int64]:
        """The queries that the latest `draw_counted` used, in its order."""
        return self._query_indices

    def draw(
        self,
        core: Core,
        vertex_array: Id,
        primitive: Primitive,
        draws: NDArray[Any],
        query_indices: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """Send draws and queries to `core`, the device's or a command buffer's; return the queries used, in
        order."""
        used = query_indices if query_indices.base is self._in_order else run_starts(query_indices)
        prepared = self._prepared if core is self._core else self._plain(core)
        if core is self._core:
            self.discard_result()
        if len(query_indices):
            prepared.draw(vertex_array, primitive, draws, query_indices)
        core.counters.queries += len(used)
        return used

    def draw_conditional(
        self,
        core: Core,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        query_indices: NDArray[np.int64],
    ) -> None:
        """Send draws, each on condition that its query counted a sample, to `core`. The set isn't
        emulated."""
        reader = self._reader if core is self._core else self._plain(core)
        assert not isinstance(reader, EmulatedQueries)
        reader.draw_conditional(vertex_array, primitive, buffer, offset, query_indices)

    def mark_drawn(self, query_indices: NDArray[np.int64]) -> None:
        """Note that the device has drawn with these queries."""
        self._query_indices, self._reader = query_indices, self._prepared
        self.mark_submitted(self._core.signal() if self.emulated and len(query_indices) else 0)

    def mark_indices_submitted(self, query_indices: NDArray[np.int64], fence: int) -> None:
        """Note that a command buffer with these queries was executed, before `fence`."""
        self._query_indices, self._reader = query_indices, self._plain(self._core)
        self.mark_submitted(fence)

    def _plain(self, core: Core) -> PlainQueries | EmulatedQueries:
        return (EmulatedQueries if self.emulated else PlainQueries)(core.backend, self._ids)

    def _read(self) -> NDArray[np.int64] | None:
        query_indices = self._query_indices
        samples = self._reader.read(query_indices) if len(query_indices) else query_indices
        if samples is None:
            return None
        if query_indices.base is self._in_order and len(query_indices) == len(self):
            result = samples
        else:
            result = np.full(len(self), NOT_COUNTED, np.int64)
            result[query_indices] = samples
        result.flags.writeable = False
        return result


def run_starts(query_indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the query of each run of equal queries."""
    if not len(query_indices):
        return query_indices
    begins = np.ones(len(query_indices), bool)
    np.not_equal(query_indices[1:], query_indices[:-1], out=begins[1:])
    return query_indices[begins]
