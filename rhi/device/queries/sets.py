"""Query sets: many occlusion queries that are used in one call and answered as one array.

- A set has a number of rows. `draw_counted` draws an array of draws, counts each in a row, and discards the earlier
  answers of the set. So a set holds the answers of one call, and rows that the call did not use hold `NOT_COUNTED`.
- Each row is an ordinary query. A backend may execute them all at once (`PreparesQueries`). Elsewhere, in command
  buffers and in front of a recorder, they are begun and ended one by one (`PlainQueries`), which also defines the
  behaviour of `PreparesQueries`.
- An emulated set (thesis 4.4.2) writes the running counter before its first draw and after the last draw of each row:
  one value more than there are rows, with one fence.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from rhi.contract.backend import Backend, PreparedQueries, PreparesQueries
from rhi.contract.descriptors import Id, Primitive
from rhi.contract.queries import PlainQueries, list_draws
from rhi.device.core.core import Core
from rhi.device.queries.occlusion import PendingQuery
from rhi.errors.arguments import Arguments
from rhi.errors.rules import QUERY_ROWS

MAX_ROWS: Final = 1 << 20
"""Largest number of rows of a query set."""

NOT_COUNTED: Final = -1
"""The number of samples of a row that the latest call did not use."""


class EmulatedQueries:
    """`PreparedQueries` by the running counter, with one COUNTER query more than there are rows."""

    def __init__(self, backend: Backend, counters: Sequence[Id]) -> None:
        self._backend = backend
        self._counters = counters

    def draw(self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], rows: NDArray[np.int64]) -> None:
        """See `PreparedQueries.draw`. Counters are used in their order, whichever rows the draws use."""
        draw, write_counter = self._backend.draw, self._backend.write_query
        counters, current = iter(self._counters), -1
        for row, arguments in zip(rows.tolist(), list_draws(draws), strict=True):
            if row != current:
                write_counter(next(counters))
                current = row
            draw(vertex_array, primitive, *arguments)
        write_counter(next(counters))

    def read(self, rows: NDArray[np.int64]) -> NDArray[np.int64] | None:
        """See `PreparedQueries.read`; `rows` are all rows of the latest call."""
        counts = [self._backend.read_query(counter) for counter in self._counters[: len(rows) + 1]]
        if None in counts:
            return None
        values = np.array(counts, np.int64)
        return values[1:] - values[:-1]


class QuerySet(PendingQuery[NDArray[np.int64]]):
    """A set of counters of visible samples, used together by `draw_counted`; created by `device.query_set`.

    `visible_samples` and `wait` return (n,) int64, the number of samples of each row, and −1 for rows that the latest
    `draw_counted` did not use. The array is never written again, so it may be kept.
    """

    __slots__ = ("_in_order", "_prepared", "_reader", "_rows", "_size")

    def __init__(self, core: Core, size: int, emulated: bool) -> None:
        call = "device.query_set"
        core.check_ready()
        super().__init__(core, size, emulated, call)
        self._size = size
        self._rows = np.zeros(0, np.int64)
        self._in_order = np.arange(self._size)
        self._prepared: PreparedQueries | EmulatedQueries = self._plain(core)
        if not self.emulated and hasattr(core.backend, "prepare_queries"):
            self._prepared = cast("PreparesQueries", core.backend).prepare_queries(self.ids)
        self._reader = self._prepared

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._size

    @property
    def id(self) -> Id:
        """The id of its first row in the command stream; 0 for a set without rows."""
        return self._ids[0] if self._ids else 0

    def check_rows(self, rows: object, draws: int, call: str) -> NDArray[np.int64]:
        """Return the row that counts each draw, (draws,) int64; `query-rows` if `rows` don't fit."""
        each = self._read_rows(rows, draws, call)
        if rows is None:
            return each
        repeated = np.bincount(find_runs(each)) > 1
        if repeated.any():
            repeat = f"row {repeated.argmax()} again after other rows"
            self._core.refuse(QUERY_ROWS, call, repeat, "consecutive draws for each row")
        return each

    def check_conditions(self, rows: object, draws: int, counted: NDArray[np.int64], call: str) -> NDArray[np.int64]:
        """Return the row that each draw depends on, (draws,) int64; `query-rows` if `rows` don't fit, or name one that
        isn't among `counted`."""
        each = self._read_rows(rows, draws, call)
        missing = each[~np.isin(each, counted)]
        if len(missing):
            given = f"row {missing[0]}, in which the latest draw_counted counted nothing"
            self._core.refuse(QUERY_ROWS, call, given, "rows that it used")
        return each

    def _read_rows(self, rows: object, draws: int, call: str) -> NDArray[np.int64]:
        """Return the row of each draw, by default row i for draw i; `query-rows` if it isn't a row of the set."""
        size = len(self)
        if rows is None:
            if draws > size:
                self._core.refuse(QUERY_ROWS, call, f"{draws} draws", f"up to {size}, or `rows`")
            return self._in_order[:draws]
        given = Arguments(call, self._core.refuse).array("rows", rows)
        if given.shape != (draws,) or (draws and given.dtype.kind not in "iu"):
            self._core.refuse(
                QUERY_ROWS, call, f"rows of shape {given.shape} and {given.dtype}", f"({draws},) of integers"
            )
        each: NDArray[np.int64] = given.astype(np.int64)
        if draws and not 0 <= each.min() <= each.max() < size:
            self._core.refuse(QUERY_ROWS, call, f"rows {given.min()} to {given.max()}", f"0 to {size - 1}")
        return each

    @property
    def counted(self) -> NDArray[np.int64]:
        """The rows that the latest `draw_counted` used, in its order."""
        return self._rows

    def draw(
        self, core: Core, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], rows: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Send draws and queries to `core`, the device's or a command buffer's; return the rows used, in order."""
        used = rows if rows.base is self._in_order else find_runs(rows)
        prepared = self._prepared if core is self._core else self._plain(core)
        if core is self._core:
            self.discard_answer()
        if len(rows):
            prepared.draw(vertex_array, primitive, draws, rows)
        core.counters.queries += len(used)
        return used

    def draw_conditional(
        self,
        core: Core,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        rows: NDArray[np.int64],
    ) -> None:
        """Send draws, each on condition that its row counted a sample, to `core`. The set isn't emulated."""
        reader = self._reader if core is self._core else self._plain(core)
        assert not isinstance(reader, EmulatedQueries)
        reader.draw_conditional(vertex_array, primitive, buffer, offset, rows)

    def mark_rows_drawn(self, rows: NDArray[np.int64]) -> None:
        """Note that the device has drawn with these rows."""
        self._rows, self._reader = rows, self._prepared
        self.mark_submitted(self._core.signal() if self.emulated and len(rows) else 0)

    def mark_rows_submitted(self, rows: NDArray[np.int64], fence: int) -> None:
        """Note that a command buffer with these rows was executed, before `fence`."""
        self._rows, self._reader = rows, self._plain(self._core)
        self.mark_submitted(fence)

    def _plain(self, core: Core) -> PlainQueries | EmulatedQueries:
        return (EmulatedQueries if self.emulated else PlainQueries)(core.backend, self._ids)

    def _read(self) -> NDArray[np.int64] | None:
        rows = self._rows
        samples = self._reader.read(rows) if len(rows) else rows
        if samples is None:
            return None
        if rows.base is self._in_order and len(rows) == len(self):
            answer = samples
        else:
            answer = np.full(len(self), NOT_COUNTED, np.int64)
            answer[rows] = samples
        answer.flags.writeable = False
        return answer


def find_runs(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the row of each run of equal rows."""
    if not len(rows):
        return rows
    begins = np.ones(len(rows), bool)
    np.not_equal(rows[1:], rows[:-1], out=begins[1:])
    return rows[begins]
