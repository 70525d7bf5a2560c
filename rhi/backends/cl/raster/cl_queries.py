"""Queries that count samples: occlusion queries, the running counter, conditions.

Timestamps are in `rhi.backends.cl.cl_fence`.

- The stream of draws is divided into segments, wherever a query begins or ends or the running counter is
  sampled. A segment has a counter in memory, 64 bits in two words, that raster kernels add to. Without an
  active query nothing is counted.
- An occlusion query's result is the sum of its segments. A COUNTER's result is the sum of all segments before
  it, as long as COUNTER queries exist. A result is available, and read without waiting, once the batch with
  its last segment's draws is complete.
- The draws of a query set are one segment with a counter for each row of the set. The running counter adds up
  all of them.
- Counters are allocated from pages of zeros. A page's memory is cleared and reused once none of its segments
  is needed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_context import allocate_pages
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.cl_fence import is_done
from rhi.contract.descriptors import Id, QueryKind

_PAGE_COUNTERS: Final = 512
_MAX_PENDING: Final = (
    64  # batches, or segments of the running counter, that aren't checked for completion yet
)


class _CounterMemory:
    """Memory of counters. `batch`: the last batch that may add to them."""

    __slots__ = ("address", "batch", "host", "words")

    def __init__(self, counters: int) -> None:
        self.host = allocate_pages(8 * counters).view(np.uint64)
        self.words = self.host.data
        self.address: int = self.host.ctypes.data
        self.batch = 0


class _CounterPage:
    """A page that segments are allocated from. Each segment references it, so it is freed with the last
    one."""

    __slots__ = ("_queries", "memory", "used")

    def __init__(self, queries: SampleQueries, memory: _CounterMemory) -> None:
        self._queries = queries
        self.memory = memory
        self.used = 0

    def __del__(self) -> None:
        self._queries.release(self.memory)


class Segment:
    """Draws whose samples are counted together, at `address` or by one of `size` counters there. `batch`: the
    last batch that contains some of them."""

    __slots__ = ("_first", "_page", "address", "batch", "size")

    def __init__(self, page: _CounterPage, batch: int, size: int) -> None:
        self._page = page
        self._first = page.used
        self.address = page.memory.address + 8 * page.used
        self.batch = batch
        self.size = size
        page.used += size

    def read(self) -> int:
        """Return the sum of all counters. The batch has to be complete."""
        if self.size > 1:
            return int(self.read_each().sum())
        return self._page.memory.words[self._first]

    def read_each(self) -> NDArray[np.uint64]:
        """Return a view of the counters, (size,). The batch has to be complete."""
        return self._page.memory.host[self._first : self._first + self.size]


class _SampleQuery:
    __slots__ = ("kind", "segments", "total")

    def __init__(self, kind: QueryKind) -> None:
        self.kind = kind
        self.segments: list[Segment] = []
        self.total: list[int | None] | None = None  # of a COUNTER that was sampled


class SampleQueries:
    """The queries of a device that count samples.

    Attributes:
        gathering: the number of the batch that draws are gathered in now.
    """

    def __init__(
        self, count_into: Callable[[int], None], flush: Callable[[], None], is_gathering: Callable[[], bool]
    ) -> None:
        """
        Args:
            count_into: receives the address of the counter for the following draws; 0: none.
            flush: submits the gathered draws.
            is_gathering: returns whether there are gathered draws.
        """
        self._count_into = count_into
        self._flush = flush
        self._is_gathering = is_gathering
        self._free: list[_CounterMemory] = []
        self._page: _CounterPage | None = None
        self.gathering = 1
        self._done = 0
        self._batches: deque[tuple[int, cl.Event]] = deque()
        self._queries: dict[Id, _SampleQuery] = {}
        self._active: _SampleQuery | None = None
        self._segment: Segment | None = None
        self._counter_queries = 0  # number of COUNTER queries that exist
        self._passed = 0  # the sum of all segments that left `_chain`
        self._chain: deque[tuple[Segment | None, list[int | None]]] = deque()

    # -- batches -------------------------------------------------------------------------------------------

    def finish_batch(self, event: cl.Event) -> None:
        """Note that the gathered draws were submitted; `event`: their completion."""
        batches = self._batches
        batches.append((self.gathering, event))
        self.gathering += 1
        if len(batches) > _MAX_PENDING:  # nobody may ever ask for a result
            complete = cl.command_execution_status.COMPLETE
            while batches and batches[0][1].command_execution_status == complete:
                self._done = batches.popleft()[0]

    def is_done(self, batch: int) -> bool:
        """Return whether a batch is complete, without waiting."""
        if batch <= self._done:
            return True
        batches = self._batches
        while batches and is_done(batches[0][1]):
            self._done = batches.popleft()[0]
        return batch <= self._done

    # -- queries -------------------------------------------------------------------------------------------

    def create(self, query: Id, kind: QueryKind) -> None:
        self._make_room()
        self._queries[query] = _SampleQuery(kind)
        if kind is QueryKind.COUNTER:
            self._counter_queries += 1
            if self._counter_queries == 1:
                self._next_segment(None)

    def destroy(self, query: Id) -> None:
        destroyed = self._queries.pop(query)
        if destroyed.kind is QueryKind.COUNTER:
            self._counter_queries -= 1
            if not self._counter_queries and self._active is None:
                self._next_segment(None)

    def begin(self, query: Id) -> None:
        self._make_room()
        begun_query = self._active = self._queries[query]
        begun_query.segments = []
        if self._counter_queries:
            self._next_segment(None)
        else:
            begun = self._segment = self._begin_segment()
            begun_query.segments.append(begun)
            self._count_into(begun.address)

    def end(self, query: Id) -> None:
        self._make_room()
        self._active = None
        self._next_segment(None)

    def begin_set(self, size: int) -> Segment:
        """Begin a segment of `size` counters, for draws that each name one of them."""
        self._make_room(1 + size)
        if self._counter_queries:
            self._next_segment(None)
        return self._begin_segment(size)

    def end_set(self, segment: Segment) -> None:
        """End a segment of `begin_set`."""
        segment.batch = self._latest_batch()
        if self._counter_queries:
            self._chain.append((segment, [None]))

    def read_set(self, segment: Segment) -> NDArray[np.uint64] | None:
        """Return a view of the counters; or None while the result isn't available, and submit the draws that
        it needs."""
        if self.is_done(segment.batch):
            return segment.read_each()
        self._flush()
        return None

    def is_submitted(self, segment: Segment) -> bool:
        """Return whether no gathered draw counts in a segment, so that commands that follow find it
        complete."""
        return segment.batch < self.gathering

    def take(self, query: Id) -> None:
        """Sample the running counter into a COUNTER query."""
        self._make_room()
        total: list[int | None] = [None]
        self._queries[query].total = total
        self._next_segment(total)

    def read(self, query: Id) -> int | None:
        """Return a query's result; or None while it isn't available, and submit the draws that it needs."""
        state = self._queries[query]
        if state.kind is QueryKind.COUNTER:
            if state.total is None:
                return None
            self._add_up()
            answer = state.total[0]
        else:
            segments = state.segments
            is_available = segments and self.is_done(segments[-1].batch)
            answer = sum(segment.read() for segment in segments) if is_available else None
        if answer is None:
            self._flush()
        return answer

    def condition_address(self, query: Id) -> int:
        """Return the address of a counter that is nonzero exactly if the query counted any sample."""
        state = self._queries[query]
        self._flush()
        if len(state.segments) == 1:
            return state.segments[0].address
        for _, event in self._batches:
            event.wait()
        answer = self.read(query)
        summed = (
            state.segments[0]
            if answer is None
            else next((segment for segment in state.segments if segment.read()), state.segments[0])
        )
        return summed.address

    def _next_segment(self, total: list[int | None] | None) -> None:
        """End the current segment, and begin another one if any query counts."""
        ended = self._segment
        active = self._active
        counts = self._counter_queries
        if ended is not None:
            ended.batch = self._latest_batch()
        if counts and (ended is not None or total is not None):
            self._chain.append((ended, total or [None]))
            if len(self._chain) > _MAX_PENDING:
                self._add_up()
        if active is None and not counts:
            self._segment = None
            self._count_into(0)
            return
        begun = self._segment = self._begin_segment()
        if active is not None:
            active.segments.append(begun)
        self._count_into(begun.address)

    def _latest_batch(self) -> int:
        """Return the number of the batch that contains the last draw."""
        return self.gathering if self._is_gathering() else self.gathering - 1

    def _add_up(self) -> None:
        while self._chain:
            segment, total = self._chain[0]
            if segment is not None:
                if not self.is_done(segment.batch):
                    return
                self._passed += segment.read()
            total[0] = self._passed
            self._chain.popleft()

    def _make_room(self, counters: int = 1) -> None:
        """Make room for the next segments, so that nothing can fail once state changes.

        Raises:
            DeviceError: `device-out-of-memory`.
        """
        page = self._page
        if page is None or page.used + counters > len(page.memory.host):
            with translate_errors("a query", f"{counters} counters"):
                self._page = _CounterPage(self, self._take_memory(counters))

    def _begin_segment(self, size: int = 1) -> Segment:
        """Begin a segment, which `_make_room` has made room for."""
        assert self._page is not None
        return Segment(self._page, self.gathering, size)

    def _take_memory(self, size: int) -> _CounterMemory:
        for index, memory in enumerate(self._free):
            if len(memory.host) >= size and self.is_done(memory.batch):
                memory.host[:] = 0
                return self._free.pop(index)
        pages = max(1, -(-size // _PAGE_COUNTERS))
        return _CounterMemory(pages * _PAGE_COUNTERS)

    def release(self, memory: _CounterMemory) -> None:
        """Free memory that no segment needs. Draws gathered until now may still add to it."""
        memory.batch = self.gathering
        self._free.append(memory)
