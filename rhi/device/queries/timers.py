"""The timer tree: GPU and CPU time of labelled parts of a frame (thesis 4.4).

Each `device.event` takes two timestamps when timing is on. The tree of a frame is read, without waiting, when all of
its timestamps are available; `device.timers` is the tree of the latest such frame. Where the backend dates timestamps
(`DatesTimestamps`), nodes also say when CPU and GPU worked on their event, on one clock: so the trees of consecutive
frames show whether one is recorded while the GPU executes the other (3.7.2). A frame has at most `MAX_EVENTS`,
also in a program that never presents: further events inside an open one are only labels, otherwise a new tree begins.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from threading import get_ident
from types import TracebackType
from typing import Final, cast
from weakref import ref

from rhi.contract.backend import DatesTimestamps
from rhi.contract.descriptors import Id, QueryKind
from rhi.device.core.core import Core, find_part
from rhi.device.core.interrupts import HeldInterrupts
from rhi.device.core.scopes import Bracket, OpenScopes
from rhi.errors.arguments import Arguments

__rhi_internal__ = True


@dataclass(slots=True)
class TimerNode:
    """An event of a frame: its label, its GPU and CPU time, and the events inside.

    `gpu_span` and `cpu_span` are when the GPU executed it and when the CPU issued it: (begin, end) in milliseconds on
    the GPU's clock, since the device's first timed event. They are None on a backend that can't tell.
    """

    name: str
    gpu_milliseconds: float = 0.0
    cpu_milliseconds: float = 0.0
    children: list[TimerNode] = field(default_factory=list)
    gpu_span: tuple[float, float] | None = None
    cpu_span: tuple[float, float] | None = None

    def format(self, indent: int = 0) -> str:
        """Return the tree as text, one line per event."""
        line = f"{'  ' * indent}{self.name:<{max(1, 32 - 2 * indent)}} gpu {self.gpu_milliseconds:8.3f} ms"
        line = f"{line}  cpu {self.cpu_milliseconds:8.3f} ms"
        if self.gpu_span is not None and self.cpu_span is not None:
            (issue, issued), (start, end) = self.cpu_span, self.gpu_span
            line = f"{line}  at cpu {issue:.3f} … {issued:.3f}, gpu {start:.3f} … {end:.3f} ms"
        lines = [line]
        return "\n".join(lines + [child.format(indent + 1) for child in self.children])


class _Event(Bracket):
    """An event: open, or one whose timestamps are not available yet.

    Attributes:
        node: its place in the tree.
        began: when it began, in seconds.
        first, last: its timestamps, 0 if it takes none.
        counted: whether it is in the tree.
    """

    __slots__ = ("_timers", "began", "counted", "first", "last", "node")

    def __init__(self, timers: Timers, block: object, label: str, scopes: OpenScopes) -> None:
        self.scopes = scopes
        self.block = ref(block)
        self._timers = timers
        self.node = TimerNode(label)
        self.began = time.perf_counter()
        self.first = self.last = 0
        self.counted = True

    def describe(self) -> str:
        return f"event {self.node.name!r}"

    def finish(self, failed: bool) -> None:
        scopes, timers, events = self.scopes, self._timers, self._timers._open
        index = scopes._index - 1  # from here on nothing may be interrupted before the `try`, so it calls nothing
        scopes._data[index] = None
        scopes._index = index
        try:
            events.pop()
            if self.last:
                timers._core.backend.write_query(self.last)
                timers._pending.append(self)
            self.node.cpu_milliseconds = (time.perf_counter() - self.began) * 1e3
        finally:
            timers._core.backend.pop_label()


MAX_FRAMES: Final = 8
"""Largest number of frames that wait for their timestamps; beyond it the oldest is dropped."""
MAX_EVENTS: Final = 4096
"""Largest number of events in the tree of a frame."""


class Timers:
    """The events of the current frame, and the event tree of the latest finished frame."""

    __slots__ = (
        "_core", "_count", "_dates", "_frames", "_free", "_open", "_origin", "_pending", "_roots", "enabled", "latest",
    )  # fmt: skip

    def __init__(self, core: Core, enabled: bool) -> None:
        self._core = core
        self._dates = cast("DatesTimestamps | None", find_part(core.backend, "read_issue_time"))
        self._origin: int | None = None  # when the first event was issued, in nanoseconds on the GPU's clock
        self.enabled = enabled
        self.latest: list[TimerNode] = []
        self._open: list[_Event] = []
        self._roots: list[TimerNode] = []
        self._count = 0  # of events in the tree
        self._pending: list[_Event] = []
        self._frames: deque[tuple[list[TimerNode], list[_Event]]] = deque()
        self._free: list[Id] = []

    @property
    def depth(self) -> int:
        """Number of open events."""
        return len(self._open)

    def begin(self, label: str, block: object) -> _Event:
        """Open an event inside the innermost open one, for a `with` block."""
        scopes = self._core.scopes
        event = _Event(self, block, label, scopes)
        if self._count >= MAX_EVENTS:
            if self._open:
                event.counted = False
            else:
                self.end_frame()
        depth, siblings = len(self._open), self._open[-1].node.children if self._open else self._roots
        labelled = False
        try:
            if self.enabled and event.counted:
                event.first = self._acquire_query()
                event.last = self._acquire_query()
            self._core.backend.push_label(label)
            labelled = True
            if event.first:
                self._core.backend.write_query(event.first)
            if event.counted:
                siblings.append(event.node)
                self._count += 1
            self._open.append(event)
            scopes.push(event)
        except BaseException:
            scopes.withdraw(event)
            del self._open[depth:]
            if siblings and siblings[-1] is event.node:
                siblings.pop()
            self._free += [query for query in (event.first, event.last) if query]
            if labelled:
                self._core.backend.pop_label()
            raise
        return event

    def end_frame(self) -> None:
        """Close the frame's tree, and read the frames whose timestamps are available."""
        if not self._open and self._roots:
            self._frames.append((self._roots, self._pending))
            self._roots, self._pending, self._count = [], [], 0
        self.collect()
        while len(self._frames) > MAX_FRAMES:
            self._release(self._frames.popleft()[1])

    def collect(self) -> None:
        """Read finished frames, oldest first; never blocks."""
        while self._frames:
            roots, pending = self._frames[0]
            times = [(self._read(e.first), self._read(e.last)) for e in reversed(pending)]
            if any(begin is None or end is None for begin, end in times):
                return
            for event, (begin, end) in zip(reversed(pending), times, strict=True):
                assert begin is not None
                assert end is not None
                event.node.gpu_milliseconds = (end - begin) / 1e6
            if self._dates is not None:
                self._date(pending, self._dates)
            self._frames.popleft()
            self._release(pending)
            self.latest = roots

    def _date(self, events: list[_Event], dates: DatesTimestamps) -> None:
        """Note when GPU and CPU worked on the events of a frame whose timestamps are available."""
        issued = [dates.read_issue_time(query) or 0 for event in events for query in (event.first, event.last)]
        done = [self._read(query) or 0 for event in events for query in (event.first, event.last)]
        if self._origin is None and issued:
            self._origin = min(issued)
        origin = self._origin or 0
        for index, event in enumerate(events):
            (begin, end), (started, finished) = issued[2 * index :][:2], done[2 * index :][:2]
            event.node.cpu_span = (begin - origin) / 1e6, (end - origin) / 1e6
            event.node.gpu_span = (started - origin) / 1e6, (finished - origin) / 1e6

    def _acquire_query(self) -> Id:
        """Return an unused timestamp query, creating one if there is none."""
        free = self._free
        if not free:
            with HeldInterrupts():
                query = self._core.new_id()
                self._core.backend.create_query(query, QueryKind.TIMESTAMP)
                free.append(query)
        query = free[-1]
        del free[-1]  # no call, after which an interrupt could come
        return query

    def _read(self, query: Id) -> int | None:
        return self._core.backend.read_query(query) if query else 0

    def _release(self, pending: list[_Event]) -> None:
        self._free.extend(query for event in pending for query in (event.first, event.last) if query)


class EventScope:
    """A `with device.event(label):` block, which labels the commands inside and, with timing on, times them."""

    __slots__ = ("__weakref__", "_core", "_events", "_label", "_timers")

    def __init__(self, core: Core, timers: Timers, label: str) -> None:
        if label.__class__ is not str:
            Arguments("device.event", core.refuse).text("label", label)
        self._core = core
        self._timers = timers
        self._label = label
        self._events: list[_Event] = []

    def __enter__(self) -> None:
        self._core.check_scope()
        self._events.append(self._timers.begin(self._label, self))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        core, events = self._core, self._events
        if core.closed:
            return
        if core.thread != get_ident():
            core.check_thread("the end of an event")
        core.resume_scope()
        if not events:
            core.scopes.refuse_unopened(f"event {self._label!r}", error)
            return
        scopes, event = core.scopes, events[-1]
        if scopes._data[scopes._index - 1] is event:
            event.finish(error is not None)
        else:
            scopes.leave(event, error)
        events.pop()
