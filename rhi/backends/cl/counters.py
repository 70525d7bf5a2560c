"""Counted samples: occlusion queries, the running counter, conditions.

- The stream of draws is cut into segments, wherever a query begins or ends or the running counter is taken. A segment
  has a counter in memory, 64 bits in two words, which raster kernels add to. Where nobody asks, nothing is counted.
- An occlusion query's answer is the sum of its segments; a COUNTER's is that of all segments up to it, while there are
  COUNTER queries. An answer is there when the batch that holds its last segment's draws is done, and is then read
  without waiting.
- Counters come from pages, zero at first; a page is zeroed and used again when nobody needs its segments any more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import numpy as np
import pyopencl as cl

from rhi.backends.cl.context import Context, allocate_pages
from rhi.backends.cl.memory import Addresses
from rhi.backends.cl.queries import is_done
from rhi.descriptors import Id, QueryKind

__rhi_internal__ = True

_PAGE_COUNTERS: Final = 512


class _Page:
    """Counters; `needed` segments live on it, the last of them in batch `batch`."""

    __slots__ = ("address", "batch", "host", "memory", "needed", "queue", "shared", "used")

    def __init__(self, context: Context, addresses: Addresses) -> None:
        self.host = allocate_pages(8 * _PAGE_COUNTERS).view(np.uint64)
        self.shared = context.shares_memory
        share = cl.mem_flags.USE_HOST_PTR if self.shared else cl.mem_flags.COPY_HOST_PTR
        self.memory = cl.Buffer(context.context, cl.mem_flags.READ_WRITE | share, hostbuf=self.host)
        self.address = addresses.find(self.memory)
        self.queue = addresses.queue  # one that doesn't stand behind draws
        self.used = self.needed = self.batch = 0

    def read(self, place: int) -> int:
        if not self.shared:
            cl.enqueue_copy(self.queue, self.host, self.memory)
        return int(self.host[place])

    def clear(self) -> None:
        self.host[:] = 0
        if not self.shared:
            cl.enqueue_copy(self.queue, self.memory, self.host)
        self.used = 0


class Segment:
    """Draws whose samples are counted together."""

    __slots__ = ("_counters", "_page", "_place", "batch")

    def __init__(self, counters: Counters, page: _Page) -> None:
        self._counters = counters
        self._page = page
        self._place = page.used
        self.batch = 0
        page.used += 1
        page.needed += 1

    def __del__(self) -> None:
        self._page.needed -= 1
        self._page.batch = max(self._page.batch, self._counters.gathering)

    @property
    def address(self) -> int:
        """Where kernels add to it."""
        return self._page.address + 8 * self._place

    def read(self) -> int | None:
        """The samples, or None while its draws aren't done."""
        return self._page.read(self._place) if self._counters.is_done(self.batch) else None


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
        self, context: Context, addresses: Addresses, count_into: Callable[[int], None], flush: Callable[[], None],
        is_gathering: Callable[[], bool],
    ) -> None:  # fmt: skip
        """`count_into` is told the address of the counter for the draws that follow, 0: none; `is_gathering` says
        whether there are draws that weren't flushed."""
        self._context = context
        self._addresses = addresses
        self._count_into = count_into
        self._flush = flush
        self._is_gathering = is_gathering
        self._pages: list[_Page] = []
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
        batches = self._batches
        while batches and is_done(batches[0][1]):
            self._done = batches.popleft()[0]
        return batch <= self._done

    # -- queries -------------------------------------------------------------------------------------------

    def create(self, query: Id, kind: QueryKind) -> None:
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
        made = self._active = self._queries[query]
        made.segments = []
        self._cut(None)

    def end(self, query: Id) -> None:
        self._active = None
        self._cut(None)

    def take(self, query: Id) -> None:
        """A COUNTER: the running count at this point."""
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
            counts = [segment.read() for segment in made.segments]
            answer = None if not counts or None in counts else sum(filter(None, counts))
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
        ended, self._segment = self._segment, None
        if ended is not None:
            ended.batch = self.gathering if self._is_gathering() else self.gathering - 1
        if self._takers and (ended is not None or total is not None):
            self._chain.append((ended, total or [None]))
        if self._active is not None or self._takers:
            self._segment = self._make()
            if self._active is not None:
                self._active.segments.append(self._segment)
        self._count_into(self._segment.address if self._segment is not None else 0)

    def _add_up(self) -> None:
        while self._chain:
            segment, total = self._chain[0]
            count = 0 if segment is None else segment.read()
            if count is None:
                return
            self._passed += count
            total[0] = self._passed
            self._chain.popleft()

    def _make(self) -> Segment:
        if self._page is None or self._page.used == _PAGE_COUNTERS:
            self._page = self._find_page()
        segment = Segment(self, self._page)
        segment.batch = self.gathering
        return segment

    def _find_page(self) -> _Page:
        for page in self._pages:
            if not page.needed and self.is_done(page.batch):
                page.clear()
                return page
        page = _Page(self._context, self._addresses)
        self._pages.append(page)
        return page
