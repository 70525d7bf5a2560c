"""Queries. None of them makes the CPU wait unless it is asked to.

- Occlusion queries are GL's own until the first COUNTER query exists. GL has no running samples-passed
  counter, and allows only one active samples-passed query. So from then on a chain of such queries is always
  running, and a new one begins wherever the count is taken (`SampleCounter`). An occlusion query is then the
  difference of two counts, which is the thesis's emulation (4.4.2).
- If a query begins again while llvmpipe is still counting for it, llvmpipe adds both counts. So a query that
  begins before its last result is available gets another GL query.
- Some GPUs have one counter for all contexts of a process: NVIDIA's driver adds what another context draws to
  a query that is active here. So none stays active while another device's context draws (`suspend`,
  `resume`).
"""

from __future__ import annotations

import ctypes
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.contract.descriptors import Id, QueryKind


@dataclass(slots=True, eq=False)
class CounterValue:
    """The value of the running counter at one point of the stream; None until its result is available."""

    value: int | None = None


class SampleCounter:
    """A running count of samples passed, made of consecutive GL queries, called segments.

    `take` ends the active segment and begins the next. A count is the sum of all segments before it. Segments
    are added in order as their results become available, so a sum never omits one. No query is active outside
    `start` and `stop`.
    """

    def __init__(
        self,
        begin: Callable[[], int],
        end: Callable[[], None],
        read: Callable[[int], int | None],
        free: Callable[[int], None],
    ) -> None:
        """Create a stopped counter at 0.

        Args:
            begin: begins a GL query and returns its name.
            end: ends the active GL query.
            read: returns the result of a GL query, None while it isn't available.
            free: receives the names of queries that aren't used any more.
        """
        self._begin = begin
        self._end = end
        self._read = read
        self._free = free
        self._active = 0
        self._closed: deque[tuple[int, list[CounterValue]]] = deque()  # (query, values taken at its end)
        self._total = 0

    @property
    def is_running(self) -> bool:
        return self._active != 0

    @property
    def active(self) -> int:
        """The name of the query that counts now, 0 while the counter is stopped."""
        return self._active

    def start(self, active: int = 0) -> CounterValue:
        """Begin counting. `active` is a query that is active already; it becomes the first segment."""
        count = self._mark()
        self._active = active or self._begin()
        return count

    def stop(self) -> None:
        if self._active:
            self._end()
            self._closed.append((self._active, []))
            self._active = 0

    def take(self) -> CounterValue:
        """Return the counter's value at this point of the stream."""
        self.stop()
        count = self._mark()
        self._active = self._begin()
        self.collect(self._read)
        return count

    def collect(self, read: Callable[[int], int | None] | None = None) -> None:
        """Add the results that are available; waits only if `read` does."""
        closed, read = self._closed, read or self._read
        while closed:
            name, counts = closed[0]
            samples = read(name)
            if samples is None:
                return
            closed.popleft()
            self._free(name)
            self._total += samples
            for count in counts:
                count.value = self._total

    def restart(self) -> None:
        """Replace all segments that have no result yet by a new one. They count nothing; no query is
        active."""
        for _, counts in self._closed:
            for count in counts:
                count.value = self._total
        self._closed.clear()
        self._active = self._begin()

    def _mark(self) -> CounterValue:
        if not self._closed:
            return CounterValue(self._total)
        count = CounterValue()
        self._closed[-1][1].append(count)
        return count


@dataclass(slots=True)
class GlQuery:
    """A query of the device, with the GL query or the counter values behind it."""

    kind: QueryKind
    name: int = 0
    """GL's name of the query, for occlusion and timestamps; 0 for counters."""
    begin: CounterValue | None = None
    """The counter's value at the begin of an occlusion query, if the sample counter counts for it."""
    end: CounterValue | None = None
    is_pending: bool = False
    """Whether GL's query began and isn't known to be finished."""
    issued: int = 0
    """GL's clock, in nanoseconds, when the timestamp was issued."""


class Queries:
    """The queries of one context."""

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._queries: dict[Id, GlQuery] = {}
        self._result = ctypes.c_uint64()
        self._result_reference = ctypes.byref(self._result)
        self._spare: list[int] = []
        self._retired: deque[int] = deque()  # names of queries for which GL may still be counting
        self._counters = 0  # COUNTER queries that exist
        self._counter = SampleCounter(self._begin_segment, self._end_segment, self._poll, self._spare.append)
        self._active: GlQuery | None = None
        self._is_suspended = False
        self._no_samples = self._begin_segment()  # a query that counts no samples
        self._end_segment()

    @property
    def is_counting(self) -> bool:
        """True if the sample counter is running, so that occlusion queries are differences of it."""
        return self._counter.is_running

    @property
    def is_active(self) -> bool:
        """True if a query of GL counts now."""
        return self._counter.is_running or self._active is not None

    def __getitem__(self, query: Id) -> GlQuery:
        return self._queries[query]

    def create(self, query: Id, kind: QueryKind) -> None:
        if kind is QueryKind.COUNTER:
            self._queries[query] = GlQuery(kind)
            self._counters += 1
            if not self._counter.is_running:
                self._start_counter()
            return
        target = enums.SAMPLES_PASSED if kind is QueryKind.OCCLUSION else enums.TIMESTAMP
        self._queries[query] = GlQuery(kind, self._gl.create(self._gl.CreateQueries, target))

    def destroy(self, query: Id) -> None:
        gl_query = self._queries.pop(query)
        if gl_query.name:
            self._gl.delete(self._gl.DeleteQueries, gl_query.name)
        if gl_query.kind is QueryKind.COUNTER:
            self._counters -= 1
            self._stop_unused_counter()

    def begin(self, query: Id) -> None:
        if self._active is not None:  # an interrupt came before `end`
            self.stop()
        gl_query = self._active = self._queries[query]
        gl_query.begin = gl_query.end = None
        if self._counter.is_running:
            gl_query.begin = self._counter.take()
        else:
            if gl_query.is_pending:
                self.renew(gl_query)
            gl_query.is_pending = True
            self._gl.BeginQuery(enums.SAMPLES_PASSED, gl_query.name)

    def renew(self, query: GlQuery) -> None:
        """Replace the GL query of a query that begins again, if GL may still be counting for it."""
        if self._poll(query.name) is None:
            name = self._take_name()
            self._retired.append(query.name)
            query.name = name

    def _take_name(self) -> int:
        """Return the name of an unused samples-passed query."""
        if self._spare:
            return self._spare.pop()
        if self._retired and self._poll(self._retired[0]) is not None:
            return self._retired.popleft()
        return self._gl.create(self._gl.CreateQueries, enums.SAMPLES_PASSED)

    def end(self, query: Id) -> None:
        gl_query = self._queries[query]
        if gl_query.begin is None:
            self._gl.EndQuery(enums.SAMPLES_PASSED)
            self._active = None
        else:
            gl_query.end = self._counter.take()
            self._active = None
            self._stop_unused_counter()

    def stop(self) -> None:
        """End the active query: llvmpipe crashes if a context is destroyed while one is active."""
        if self._counter.is_running:
            self._counter.stop()
        elif self._active is not None:
            self._end_segment()
        self._active = None

    def suspend(self) -> None:
        """Stop counting until `resume`. An active query becomes a difference of counts, without other
        devices' draws."""
        if self._active is not None and not self._counter.is_running:
            self._start_counter()
        self._counter.stop()
        self._is_suspended = True

    def resume(self) -> None:
        """Count again, if `suspend` ended that."""
        if self._is_suspended:
            self._is_suspended = False
            self._counter.start()

    def restore(self, condition: tuple[Id, bool] | None) -> None:
        """Restore GL's active query and conditional rendering, after calls may have gone to another context.

        Counts that began or ended in such calls are lost."""
        gl = self._gl
        tracked = self._active
        active = ctypes.c_int()
        gl.GetQueryiv(enums.SAMPLES_PASSED, enums.CURRENT_QUERY, ctypes.byref(active))
        name = self._counter.active or (tracked.name if tracked is not None else 0)
        if active.value != name:
            if active.value:
                self._end_segment()
            if self._counter.is_running:
                self._counter.restart()
            elif tracked is not None:
                self.renew(tracked)
                gl.BeginQuery(enums.SAMPLES_PASSED, tracked.name)
        gl.EndConditionalRender()
        if condition is not None:
            self.begin_conditional(*condition)

    def write(self, query: Id) -> None:
        gl_query = self._queries[query]
        if gl_query.kind is QueryKind.TIMESTAMP:
            gl_query.issued = self._gl.get_integer(enums.TIMESTAMP)
            self._gl.QueryCounter(gl_query.name, enums.TIMESTAMP)
        else:
            gl_query.end = self._counter.take()

    def read(self, query: Id) -> int | None:
        gl_query = self._queries[query]
        if gl_query.end is None:
            samples = self._poll(gl_query.name)
            gl_query.is_pending = gl_query.is_pending and samples is None
            return samples
        self._counter.collect()
        return _difference(gl_query)

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        """Begin conditional rendering. The GPU waits for a GL query, the CPU for a difference of counts."""
        gl, gl_query = self._gl, self._queries[query]
        name = gl_query.name
        if gl_query.end is not None:
            self._counter.collect(self._wait)
            drops = (_difference(gl_query) == 0) != inverted
            name, inverted = self._no_samples, not drops
        gl.BeginConditionalRender(name, enums.QUERY_WAIT_INVERTED if inverted else enums.QUERY_WAIT)

    def end_conditional(self) -> None:
        self._gl.EndConditionalRender()

    def _start_counter(self) -> None:
        gl, active = self._gl, self._active
        if active is not None:  # its GL query becomes the first segment
            active.begin = self._counter.start(active.name)
            active.name = gl.create(gl.CreateQueries, enums.SAMPLES_PASSED)
        else:
            self._counter.start()

    def _stop_unused_counter(self) -> None:
        if not self._counters and self._active is None:
            self._counter.stop()

    def _begin_segment(self) -> int:
        name = self._take_name()
        self._gl.BeginQuery(enums.SAMPLES_PASSED, name)
        return name

    def _end_segment(self) -> None:
        self._gl.EndQuery(enums.SAMPLES_PASSED)

    def _poll(self, name: int) -> int | None:
        gl = self._gl
        result = self._result
        reference = self._result_reference
        gl.GetQueryObjectui64v(name, enums.QUERY_RESULT_AVAILABLE, reference)
        if not result.value:
            return None
        gl.GetQueryObjectui64v(name, enums.QUERY_RESULT, reference)
        return result.value

    def _wait(self, name: int) -> int:
        self._gl.GetQueryObjectui64v(name, enums.QUERY_RESULT, self._result_reference)
        return self._result.value


def _difference(query: GlQuery) -> int | None:
    """Return the samples counted between a query's begin and end, None while the end's value is unknown.

    The value at the begin is known first.
    """
    assert query.end is not None
    if query.end.value is None or query.begin is None:
        return query.end.value
    assert query.begin.value is not None
    return query.end.value - query.begin.value
