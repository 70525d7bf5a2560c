"""The timer tree: GPU and CPU time of labelled parts of a frame (thesis 4.4).

Each `device.event` takes two timestamps when timing is on. The tree of a frame is read, without waiting, when
all of its timestamps are available; `device.timers` is the tree of the latest such frame. Where the backend
dates timestamps (`SupportsIssueTimes`), nodes also say when CPU and GPU worked on their event, on one clock:
so the trees of consecutive frames show whether one is recorded while the GPU executes the other (3.7.2). A
frame has at most `MAX_EVENTS`, also in a program that never presents: further events inside an open one are
only labels, otherwise a new tree begins.
"""

from __future__ import annotations

from collections import deque
from dataclasses import field
from threading import get_ident
from time import perf_counter
from typing import Final, TypeAlias, cast

from rhi.contract.backend import SupportsIssueTimes
from rhi.contract.descriptors import Id, QueryKind
from rhi.contract.interrupts import DeferredInterrupts
from rhi.device.core.core import Core, find_optional_part
from rhi.device.core.scopes import Scope
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject


@dataclass(slots=True)
class TimerNode:
    """An event of a frame: its label, its GPU and CPU time, and the events inside.

    `gpu_span` and `cpu_span` are when the GPU executed it and when the CPU issued it: (begin, end) in
    milliseconds on the GPU's clock, since the device's first timed event. They are None on a backend that
    can't tell.
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


PendingEvent: TypeAlias = tuple[TimerNode, Id, Id]
"""An event whose timestamps are not available yet: its node, and the queries of its begin and end."""
MAX_FRAMES: Final = 8
"""Largest number of frames that wait for their timestamps; beyond it the oldest is dropped."""
MAX_EVENTS: Final = 4096
"""Largest number of events in the tree of a frame."""


class Timers(DeviceObject):
    """The events of the current frame, and the event tree of the latest finished frame."""

    __slots__ = (
        "_core",
        "_count",
        "_dates",
        "_frames",
        "_free",
        "_open",
        "_origin",
        "_pending",
        "_roots",
        "enabled",
        "latest",
    )

    def __init__(self, core: Core, enabled: bool) -> None:
        self._core = core
        self._dates = cast("SupportsIssueTimes | None", find_optional_part(core.backend, "read_issue_time"))
        self._origin: int | None = None  # when the first event was issued, in nanoseconds on the GPU's clock
        self.enabled = enabled
        self.latest: list[TimerNode] = []
        self._open: list[TimerNode] = []
        self._roots: list[TimerNode] = []
        self._count = 0  # of events in the tree
        self._pending: list[PendingEvent] = []
        self._frames: deque[tuple[list[TimerNode], list[PendingEvent]]] = deque()
        self._free: list[Id] = []

    @property
    def depth(self) -> int:
        """Number of open events."""
        return len(self._open)

    def begin(self, event: EventScope) -> None:
        """Open an event inside the innermost open one."""
        core = self._core
        opened = self._open
        label = event.label
        node = TimerNode(label)
        counted = self._count < MAX_EVENTS
        if not counted and not opened:
            self.end_frame()
            counted = True
        depth, siblings = len(opened), opened[-1].children if opened else self._roots
        event.began = perf_counter()
        event.first = 0
        event.last = 0
        labelled = False
        try:
            if self.enabled and counted:
                event.first = self._acquire_query()
                event.last = self._acquire_query()
            core.backend.push_label(label)
            labelled = True
            if event.first:
                core.backend.write_query(event.first)
            if counted:
                siblings.append(node)
                self._count += 1
            opened.append(node)
            event.node = node
            core.scopes.push(event)
        except BaseException:
            core.scopes.withdraw(event)
            event.node = None
            del opened[depth:]
            if siblings and siblings[-1] is node:
                siblings.pop()
            self._free += [query for query in (event.first, event.last) if query]
            if labelled:
                core.backend.pop_label()
            raise

    def end_frame(self) -> None:
        """Close the frame's tree, and read the frames whose timestamps are available."""
        if not (self._open or self._pending or self._frames):  # no times were taken: nothing to wait for
            if self._roots:
                self.latest, self._roots, self._count = self._roots, [], 0
            return
        if not self._open and self._roots:
            self._frames.append((self._roots, self._pending))
            self._roots = []
            self._pending = []
            self._count = 0
        self.collect()
        while len(self._frames) > MAX_FRAMES:
            self._release(self._frames.popleft()[1])

    def collect(self) -> None:
        """Read finished frames, oldest first; never blocks."""
        while self._frames:
            roots, pending = self._frames[0]
            if not pending:  # no times were taken
                self._frames.popleft()
                self.latest = roots
                continue
            times = [(self._read(first), self._read(last)) for _, first, last in reversed(pending)]
            if any(begin is None or end is None for begin, end in times):
                return
            for (node, _, _), (begin, end) in zip(reversed(pending), times, strict=True):
                assert begin is not None
                assert end is not None
                node.gpu_milliseconds = (end - begin) / 1e6
            if self._dates is not None:
                self._date(pending, self._dates)
            self._frames.popleft()
            self._release(pending)
            self.latest = roots

    def _date(self, events: list[PendingEvent], dates: SupportsIssueTimes) -> None:
        """Note when GPU and CPU worked on the events of a frame whose timestamps are available."""
        queries = [query for _, *pair in events for query in pair]
        issued = [dates.read_issue_time(query) or 0 for query in queries]
        done = [self._read(query) or 0 for query in queries]
        if self._origin is None and issued:
            self._origin = min(issued)
        origin = self._origin or 0
        for index, (node, _, _) in enumerate(events):
            (begin, end), (started, finished) = issued[2 * index :][:2], done[2 * index :][:2]
            node.cpu_span = (begin - origin) / 1e6, (end - origin) / 1e6
            node.gpu_span = (started - origin) / 1e6, (finished - origin) / 1e6

    def _acquire_query(self) -> Id:
        """Return an unused timestamp query, creating one if there is none."""
        free = self._free
        if not free:
            with DeferredInterrupts():
                query = self._core.new_id()
                self._core.backend.create_query(query, QueryKind.TIMESTAMP)
                free.append(query)
        query = free[-1]
        del free[-1]  # no call, after which an interrupt could come
        return query

    def _read(self, query: Id) -> int | None:
        return self._core.backend.read_query(query) if query else 0

    def _release(self, pending: list[PendingEvent]) -> None:
        self._free.extend(query for _, *queries in pending for query in queries)


class EventScope(Scope):
    """A `with device.event(label):` block, which labels the commands inside and, with timing on, times them.

    One object may be kept and entered again, also inside itself.

    Attributes:
        label: its label.
        node: its node of the tree while it is open, None otherwise.
        began: when it began, in seconds.
        first, last: its timestamps, 0 if it takes none.
    """

    __slots__ = ("_core", "_timers", "began", "first", "label", "last", "node")
    began: float
    first: Id
    last: Id

    def __init__(self, core: Core, timers: Timers, label: str) -> None:
        if label.__class__ is not str or not label.isascii():
            ArgumentChecker("device.event", core.refuse).text("label", label)
        self._core = core
        self._timers = timers
        self.label = label
        self.node: TimerNode | None = None

    def __enter__(self) -> None:
        core = self._core
        if core.render_pass is None:  # as `check_scope`, without its call
            if core.closed or core._context is not None or get_ident() != core.thread or core.records:
                core.check_ready()  # seldom
        else:
            core.check_command()
        if self.node is None:
            self._timers.begin(self)
        else:
            self._timers.begin(_ReenteredEvent(self, self._core, self._timers, self.label))

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._core
        if core.closed:
            return
        if core.thread != get_ident():
            core.check_thread("the end of an event")
        if core._context is not None:
            core.resume_scope()
        scopes = core.scopes
        if scopes._data[scopes._index - 1] is self:
            self.finish(error is not None)
        else:
            scopes.leave(self, error)

    def describe(self) -> str:
        """Return the scope's text in messages."""
        return f"event {self.label!r}"

    def finish(self, failed: bool) -> None:
        """Pop the scope, the innermost one, and end the event."""
        core = self._core
        timers = self._timers
        node = self.node
        assert node is not None
        scopes = core.scopes
        index = (
            scopes._index - 1
        )  # from here on nothing may be interrupted before the `try`, so it calls nothing
        scopes._data[index] = None
        scopes._index = index
        del timers._open[-1]
        self.node = None
        try:
            if self.last:
                core.backend.write_query(self.last)
                timers._pending.append((node, self.first, self.last))
            node.cpu_milliseconds = (perf_counter() - self.began) * 1e3
        finally:
            core.backend.pop_label()


class _ReenteredEvent(EventScope):
    """An event in the stack that was entered through one that was already open."""

    __slots__ = ("block",)

    def __init__(self, block: EventScope, core: Core, timers: Timers, label: str) -> None:
        super().__init__(core, timers, label)
        self.block = block

    def get_block(self) -> Scope:
        return self.block
