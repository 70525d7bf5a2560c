"""Counted samples: occlusion queries, the running counter, conditions.

- The stream of draws is cut into segments, wherever a query begins or ends or the running counter is taken. A segment
  has a counter in memory, 64 bits in two words, which raster kernels add to. Where nobody asks, nothing is counted.
- An occlusion query's answer is the sum of its segments; a COUNTER's is that of all segments up to it, while there are
  COUNTER queries. An answer is there when the batch that holds its last segment's draws is done, and is then read
  without waiting.
- Draws of a query set are one segment with as many counters as the set has rows; for the running counter it is their
  sum that matters.
- Counters come from pages, zero at first; a page's memory is zeroed and used again when nobody needs its segments any
  more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.context import ClContext, allocate_pages
from rhi.backends.cl.errors import translate_errors
from rhi.backends.cl.fence import is_done
from rhi.backends.cl.pools import Addresses
from rhi.contract.descriptors import Id, QueryKind

__rhi_internal__ = True

_PAGE_COUNTERS: Final = 512


class _Memory:
    """Counters' memory; what was added to it last came before the end of batch `batch`."""

    __slots__ = ("_buffer", "_queue", "_shared", "address", "batch", "host", "words")

    def __init__(self, context: ClContext, addresses: Addresses, counters: int) -> None:
        self.host = allocate_pages(8 * counters).view(np.uint64)
        self.words = self.host.data
        self._shared = context.shares_memory
        share = cl.mem_flags.USE_HOST_PTR if self._shared else cl.mem_flags.COPY_HOST_PTR
        self._buffer = cl.Buffer(context.context, cl.mem_flags.READ_WRITE | share, hostbuf=self.host)
        self.address = addresses.find(self._buffer)
        self._queue = addresses.queue  # one that doesn't stand behind draws
        self.batch = 0

    def fetch(self) -> None:
        """Bring `host` and `words`, which are the same memory, up to date."""
        if not self._shared:
            cl.enqueue_copy(self._queue, self.host, self._buffer)

    def clear(self) -> None:
        self.host[:] = 0
        if not self._shared:
            cl.enqueue_copy(self._queue, self._buffer, self.host)


class _Page:
    """The use of some memory by segments, each of which holds its page: when the last one goes, so does the page."""

    __slots__ = ("_counters", "memory", "used")

    def __init__(self, counters: Counters, memory: _Memory) -> None:
        self._counters = counters
        self.memory = memory
        self.used = 0

    def __del__(self) -> None:
        self._counters.give_back(self.memory)


class Segment:
    """Draws whose samples are counted together; kernels add to `address`, or to one of the `size` counters there."""

    __slots__ = ("_page", "_place", "address", "batch", "size")

    def __init__(self, page: _Page, batch: int, size: int) -> None:
        self._page = page
        self._place = page.used
        self.address = page.memory.address + 8 * page.used
        self.batch = batch
        self.size = size
        page.used += size

    def read(self) -> int:
        """The samples, once the batch is done."""
        if self.size > 1:
            return int(self.read_each().sum())
        memory = self._page.memory
        memory.fetch()
        return memory.words[self._place]

    def read_each(self) -> NDArray[np.uint64]:
        """Those of each counter, once the batch is done; a view."""
        memory = self._page.memory
        memory.fetch()
        return memory.host[self._place : self._place + self.size]


class _Query:
    __slots__ = ("kind", "segments", "total")

    def __init__(self, kind: QueryKind) -> None:
        self.kind = kind
        self.segments: list[Segment] = []
        self.total: list[int | None] | None = None  # of a COUNTER that was taken


class Counters:
    """All queries of a device that count.

    Attributes:
        gathering: the number of the batch that draws gather in now.
    """

    def __init__(
        self, context: ClContext, addresses: Addresses, count_into: Callable[[int], None], flush: Callable[[], None],
        is_gathering: Callable[[], bool],
    ) -> None:  # fmt: skip
        """`count_into` is told the address of the counter for the draws that follow, 0: none; `is_gathering` says
        whether there are draws that weren't flushed."""
        self._context = context
        self._addresses = addresses
        self._count_into = count_into
        self._flush = flush
        self._is_gathering = is_gathering
        self._free: list[_Memory] = []
        self._page: _Page | None = None
        self.gathering = 1
        self._done = 0
        self._batches: deque[tuple[int, cl.Event]] = deque()
        self._queries: dict[Id, _Query] = {}
        self._active: _Query | None = None
        self._segment: Segment | None = None
        self._takers = 0  # COUNTER queries that exist
        self._passed = 0  # by all segments that were added up
        self._chain: deque[tuple[Segment | None, list[int | None]]] = deque()

    # -- batches -------------------------------------------------------------------------------------------

    def finish_batch(self, event: cl.Event) -> None:
        """The gathered draws were handed to the device; `event` is their end."""
        self._batches.append((self.gathering, event))
        self.gathering += 1

    def is_done(self, batch: int) -> bool:
        """Whether a batch is done; never waits."""
        if batch <= self._done:
            return True
        batches = self._batches
        while batches and is_done(batches[0][1]):
            self._done = batches.popleft()[0]
        return batch <= self._done

    # -- queries -------------------------------------------------------------------------------------------

    def create(self, query: Id, kind: QueryKind) -> None:
        self._make_room()
        self._queries[query] = _Query(kind)
        if kind is QueryKind.COUNTER:
            self._takers += 1
            if self._takers == 1:
                self._cut(None)

    def destroy(self, query: Id) -> None:
        made = self._queries.pop(query)
        if made.kind is QueryKind.COUNTER:
            self._takers -= 1
            if not self._takers and self._active is None:
                self._cut(None)

    def begin(self, query: Id) -> None:
        self._make_room()
        made = self._active = self._queries[query]
        made.segments = []
        if self._takers:
            self._cut(None)
        else:
            begun = self._segment = self._make()
            made.segments.append(begun)
            self._count_into(begun.address)

    def end(self, query: Id) -> None:
        self._make_room()
        self._active = None
        self._cut(None)

    def begin_set(self, size: int) -> Segment:
        """So many counters, for draws that the caller spreads over them."""
        self._make_room(1 + size)
        if self._takers:
            self._cut(None)
        return self._make(size)

    def end_set(self, segment: Segment) -> None:
        """All of its draws were gathered."""
        segment.batch = self._find_latest()
        if self._takers:
            self._chain.append((segment, [None]))

    def read_set(self, segment: Segment) -> NDArray[np.uint64] | None:
        """What each counter counted, or None while it isn't there; starts the draws."""
        if self.is_done(segment.batch):
            return segment.read_each()
        self._flush()
        return None

    def take(self, query: Id) -> None:
        """A COUNTER: the running count at this point."""
        self._make_room()
        total: list[int | None] = [None]
        self._queries[query].total = total
        self._cut(total)

    def read(self, query: Id) -> int | None:
        """The answer, or None while it isn't there; starts the draws that it needs."""
        made = self._queries[query]
        if made.kind is QueryKind.COUNTER:
            if made.total is None:
                return None
            self._add_up()
            answer = made.total[0]
        else:
            segments = made.segments
            is_there = segments and self.is_done(segments[-1].batch)
            answer = sum([segment.read() for segment in segments]) if is_there else None
        if answer is None:
            self._flush()
        return answer

    def find_condition(self, query: Id) -> int:
        """The address of a counter that says whether a query counted any sample: its own, or that of a sum."""
        made = self._queries[query]
        self._flush()
        if len(made.segments) == 1:
            return made.segments[0].address
        for _, event in self._batches:
            event.wait()
        answer = self.read(query)
        summed = made.segments[0] if answer is None else next(
            (segment for segment in made.segments if segment.read()), made.segments[0]
        )  # fmt: skip
        return summed.address

    def _cut(self, total: list[int | None] | None) -> None:
        """End the segment that runs, and begin another one if anybody counts."""
        ended, active, takers = self._segment, self._active, self._takers
        if ended is not None:
            ended.batch = self._find_latest()
        if takers and (ended is not None or total is not None):
            self._chain.append((ended, total or [None]))
        if active is None and not takers:
            self._segment = None
            self._count_into(0)
            return
        begun = self._segment = self._make()
        if active is not None:
            active.segments.append(begun)
        self._count_into(begun.address)

    def _find_latest(self) -> int:
        """The batch of the draws gathered last."""
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
        """For the next segments: what may fail comes before anything changes.

        Raises:
            DeviceError: `device-out-of-memory`.
        """
        page = self._page
        if page is None or page.used + counters > len(page.memory.host):
            with translate_errors("a query", f"{counters} counters"):
                self._page = _Page(self, self._find_memory(counters))

    def _make(self, size: int = 1) -> Segment:
        """There is room for it."""
        assert self._page is not None
        return Segment(self._page, self.gathering, size)

    def _find_memory(self, size: int) -> _Memory:
        for place, memory in enumerate(self._free):
            if len(memory.host) >= size and self.is_done(memory.batch):
                memory.clear()
                return self._free.pop(place)
        pages = max(1, -(-size // _PAGE_COUNTERS))
        return _Memory(self._context, self._addresses, pages * _PAGE_COUNTERS)

    def give_back(self, memory: _Memory) -> None:
        """No segment needs it; draws gathered until now may still add to it."""
        memory.batch = self.gathering
        self._free.append(memory)
