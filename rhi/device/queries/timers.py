"""The timer tree: GPU and CPU time of labelled parts of a frame (thesis 4.4).

Each `device.event` takes two timestamps when timing is on. The tree of a frame is read, without waiting, when all of
its timestamps are available; `device.timers` is the tree of the latest such frame.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final

from rhi.contract.descriptors import Id, QueryKind
from rhi.device.core.core import Core
from rhi.errors.arguments import Arguments
from rhi.errors.rules import SCOPE_ORDER

__rhi_internal__ = True


@dataclass(slots=True)
class TimerNode:
    """An event of a frame: its label, its GPU and CPU time, and the events inside."""

    name: str
    gpu_milliseconds: float = 0.0
    cpu_milliseconds: float = 0.0
    children: list[TimerNode] = field(default_factory=list)

    def format(self, indent: int = 0) -> str:
        """Return the tree as text, one line per event."""
        line = f"{'  ' * indent}{self.name:<{max(1, 32 - 2 * indent)}} gpu {self.gpu_milliseconds:8.3f} ms"
        lines = [f"{line}  cpu {self.cpu_milliseconds:8.3f} ms"]
        return "\n".join(lines + [child.format(indent + 1) for child in self.children])


@dataclass(slots=True)
class _PendingEvent:
    """An event whose timestamps are not available yet."""

    node: TimerNode
    started: float
    begin: Id = 0
    end: Id = 0


MAX_FRAMES: Final = 8
"""Largest number of frames that wait for their timestamps; beyond it the oldest is dropped."""


class Timers:
    """The events of the current frame, and the event tree of the latest finished frame."""

    __slots__ = ("_core", "_frames", "_free", "_open", "_pending", "_roots", "enabled", "latest")

    def __init__(self, core: Core, enabled: bool) -> None:
        self._core = core
        self.enabled = enabled
        self.latest: list[TimerNode] = []
        self._open: list[_PendingEvent] = []
        self._roots: list[TimerNode] = []
        self._pending: list[_PendingEvent] = []
        self._frames: deque[tuple[list[TimerNode], list[_PendingEvent]]] = deque()
        self._free: list[Id] = []

    @property
    def depth(self) -> int:
        """Number of open events."""
        return len(self._open)

    def begin(self, label: str) -> _PendingEvent:
        """Open an event inside the innermost open one."""
        event = _PendingEvent(TimerNode(label), time.perf_counter())
        if self.enabled:  # both queries now: what can fail comes before anything is begun
            event.begin = self._acquire_query()
            try:
                event.end = self._acquire_query()
            except BaseException:
                self._free.append(event.begin)
                raise
        self._core.backend.push_label(label)
        if event.begin:
            self._core.backend.write_query(event.begin)
        (self._open[-1].node.children if self._open else self._roots).append(event.node)
        self._open.append(event)
        return event

    def end(self, event: _PendingEvent) -> None:
        """Close an event; `scope-order` if it is not the innermost open one."""
        if not self._open or self._open[-1] is not event:
            given = f"the end of {event.node.name!r}"
            self._core.refuse(SCOPE_ORDER, "device.event", given, "the innermost open event")
        self._open.pop()
        if event.end:
            self._core.backend.write_query(event.end)
            self._pending.append(event)
        event.node.cpu_milliseconds = (time.perf_counter() - event.started) * 1e3
        self._core.backend.pop_label()

    def end_frame(self) -> None:
        """Close the frame's tree, and read the frames whose timestamps are available."""
        if not self._open and self._roots:
            self._frames.append((self._roots, self._pending))
            self._roots, self._pending = [], []
        self.collect()
        while len(self._frames) > MAX_FRAMES:
            self._release(self._frames.popleft()[1])

    def collect(self) -> None:
        """Read finished frames, oldest first; never blocks."""
        while self._frames:
            roots, pending = self._frames[0]
            times = [(self._read(e.begin), self._read(e.end)) for e in reversed(pending)]
            if any(begin is None or end is None for begin, end in times):
                return
            for event, (begin, end) in zip(reversed(pending), times, strict=True):
                assert begin is not None
                assert end is not None
                event.node.gpu_milliseconds = (end - begin) / 1e6
            self._frames.popleft()
            self._release(pending)
            self.latest = roots

    def _acquire_query(self) -> Id:
        """Return an unused timestamp query, creating one if there is none."""
        if self._free:
            return self._free.pop()
        query = self._core.new_id()
        self._core.backend.create_query(query, QueryKind.TIMESTAMP)
        return query

    def _read(self, query: Id) -> int | None:
        return self._core.backend.read_query(query) if query else 0

    def _release(self, pending: list[_PendingEvent]) -> None:
        self._free.extend(query for event in pending for query in (event.begin, event.end) if query)


class EventScope:
    """A `with device.event(label):` block, which labels the commands inside and, with timing on, times them."""

    __slots__ = ("_core", "_events", "_label", "_timers")

    def __init__(self, core: Core, timers: Timers, label: str) -> None:
        if label.__class__ is not str:
            Arguments("device.event", core.refuse).text("label", label)
        self._core = core
        self._timers = timers
        self._label = label
        self._events: list[_PendingEvent] = []

    def __enter__(self) -> None:
        self._core.check_scope()
        self._events.append(self._timers.begin(self._label))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._core.closed:
            self._core.resume_scope()
            self._timers.end(self._events[-1])
            self._events.pop()
