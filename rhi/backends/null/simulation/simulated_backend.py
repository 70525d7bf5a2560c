"""The null backend with a GPU on a simulated clock.

- There are two clocks, in integer nanoseconds. The CPU's advances by a fixed time with every call, to the end
  of each wait, and by `spend`, for the program's own work. The GPU's advances with the commands it executes,
  by a `CostModel`.
- Calls gather in the queue. They are submitted by a signal, a wait, a read or the end of a frame, or when
  `batch` calls have gathered. They reach the GPU `submission_latency` later, and it executes them in order.
- The GPU is advanced to the CPU's present time whenever the CPU could see a difference. A command's effects
  appear when it starts; for fences and queries that is when everything before them has ended.
- Each entry of the queue has its call site, as in a `CommandStream`, so that hazards (`hazards`) name lines.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import field, replace
from functools import partial
from textwrap import indent
from types import CodeType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.null.null_backend import QUEUED_BYTES, ExecutionStatistics, NullBackend
from rhi.backends.null.simulation.activity import Activity, ActivityLog, ActivityTimeline
from rhi.backends.null.simulation.cost import CommandWork, CostModel
from rhi.backends.null.simulation.hazards import Hazard, HazardTracker
from rhi.backends.null.simulation.streams import CommandUse
from rhi.backends.null.simulation.work import WorkMeter
from rhi.commands.ops import WIDTHS, Op
from rhi.commands.recorder import CALLER_LOOKUP, CALLER_LOOKUP_GLOBALS
from rhi.contract import descriptors
from rhi.contract.backend import Capabilities
from rhi.contract.descriptors import Id
from rhi.errors import refuse
from rhi.errors.call_sites import find_user_frame
from rhi.errors.data_classes import dataclass
from rhi.errors.rules import DEVICE_ARGUMENT

Site: TypeAlias = tuple[CodeType | None, int]
"""A call site: a code object and an instruction offset."""


@dataclass(frozen=True)
class Simulation:
    """The parameters of a simulated GPU and its driver. Times are in nanoseconds.

    Attributes:
        cost: the cost of commands on the GPU.
        call: the CPU time of each call of the interface.
        submission_latency: the time from a submission until an idle GPU starts its first command.
        wake_latency: the time from the event that the CPU waits for until the CPU continues.
        batch: the number of calls after which they are submitted without a request.
        interrupt_latency: for a GPU whose sample counter only the CPU can read: the time from an event in the
            stream until an interrupt handler has read the counter (thesis 4.4.2). None: a command reads the
            counter.
        halts_at_events: whether such a GPU stops until the handler is done. If it continues, the counter has
            advanced by the time it is read.

    Raises:
        ValidationError: `device-argument` for times below 0, and for a `call` of 0: a program that polls
            until the GPU is done would poll forever.
    """

    cost: CostModel = field(default_factory=CostModel)
    call: int = 500
    submission_latency: int = 20_000
    wake_latency: int = 5_000
    batch: int = 1024
    interrupt_latency: int | None = None
    halts_at_events: bool = True

    def __post_init__(self) -> None:
        least = {"call": 1, "submission_latency": 0, "wake_latency": 0, "batch": 1, "interrupt_latency": 0}
        for name, smallest in least.items():
            value = getattr(self, name)
            if value is not None and value < smallest:
                refuse(DEVICE_ARGUMENT, f"Simulation({name}={value})", value, f"{smallest} or more")


class _Submission:
    """Submitted commands.

    Attributes:
        entries: the commands, as a flat list.
        position: where the GPU is in `entries`.
        ready: when the GPU may start with them.
    """

    __slots__ = ("entries", "position", "ready")

    def __init__(self, entries: list[Any], ready: int) -> None:
        self.entries = entries
        self.position = 0
        self.ready = ready


class SimulatedBackend(NullBackend):
    """A null backend whose commands are executed on a simulated clock."""

    METHOD = f"""\
    if self._site is None:
{indent(CALLER_LOOKUP, "    ")}\
        self._enqueue(({{op}}, {{arguments}}frame.f_code, frame.f_lasti))
    else:
        self._enqueue(({{op}}, {{arguments}}*self._site))
"""
    GLOBALS = CALLER_LOOKUP_GLOBALS

    def __init__(self, simulation: Simulation, capabilities: Capabilities | None = None) -> None:
        super().__init__(capabilities)
        self.simulation = simulation
        self._site: Site | None = None  # of a call that was forwarded by `forward`
        self._now = 0
        self._gpu = 0
        self._fence_time = 0
        self._readbacks: set[Id] = set()
        self._followed = 0  # position in the queue up to which the CPU's clock has advanced
        self._called = 0  # number of commands called, up to `_followed`
        self._submitted = 0  # number of commands submitted
        self._submissions: deque[_Submission] = deque()
        # When the handler reads the counter; the query, the number of the event's command, and the counter
        # then.
        self._interrupts: deque[tuple[int, Id, int, int | None]] = deque()
        self._issue_times: dict[Id, int] = {}  # by timestamp, when the CPU has written it
        self._read_at: dict[Id, int] = {}  # by query, when the handler read the counter
        self._log = ActivityLog()
        self._hazards = HazardTracker(
            self._buffers,
            self._textures,
            self._is_done,
            simulation.interrupt_latency is not None and not simulation.halts_at_events,
        )
        self._meter = WorkMeter(simulation.cost, self._textures, self._state)
        self._meter.indirect_draws = self._indirect_draws
        self._meter.indirect_dispatches = self._indirect_dispatches
        self._measure = self._meter.meters()
        self._fixed = tuple(simulation.cost.nanoseconds(CommandWork(op)) for op in Op)
        self._marks: dict[int, Callable[..., None]] = {
            Op.PUSH_LABEL: lambda text: self._log.begin_label(self._gpu, text),
            Op.POP_LABEL: lambda: self._log.end_label(self._gpu),
            Op.BEGIN_PASS: self._mark_pass,
            Op.END_PASS: lambda: self._log.end_label(self._gpu),
            Op.PRESENT: lambda texture: self._log.done.append(self._gpu),
        }
        self._follow = self._hazards.followers()

    def close(self) -> None:
        self._follow_calls()  # hazards depend on all calls, executed or not
        super().close()
        self._submissions.clear()
        self._followed = 0

    # -- for tests ---------------------------------------------------------------------------------------

    @property
    def now(self) -> int:
        """The CPU's clock: nanoseconds since the device was created."""
        self._follow_calls()
        return self._now

    @property
    def timeline(self) -> ActivityTimeline:
        """The activity of CPU and GPU so far."""
        self._run()
        idle = not self._submissions or self._submissions[0].ready > self._now
        return self._log.timeline(self._now, self._gpu if idle else None)

    @property
    def hazards(self) -> tuple[Hazard, ...]:
        """The hazards found so far."""
        self._run()
        return tuple(self._hazards.hazards)

    def spend(self, nanoseconds: int) -> None:
        """Advance the CPU's clock by the time of the program's own work."""
        self._follow_calls()
        self._now += nanoseconds

    @property
    def statistics(self) -> ExecutionStatistics:
        """Counts of the work that the device has executed so far, with the simulated GPU's time."""
        return replace(super().statistics, nanoseconds=self._gpu)

    # -- the CPU's side ------------------------------------------------------------------------------------

    def _enqueue_call(self, op: Op, *arguments: Any) -> None:
        """Append a call to the queue, with its site."""
        self._enqueue((op, *arguments, *self._current_site()))

    def _current_site(self) -> Site:
        frame = None if self._site is not None else find_user_frame()
        return self._site or ((None, -1) if frame is None else (frame.f_code, frame.f_lasti))

    def forward(self, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
        """Append a command that was called elsewhere, with its own call site, as in `Recorder.forward`."""
        self._site = code, offset
        try:
            getattr(self, op.method)(*arguments)
        finally:
            self._site = None

    def _follow_calls(self) -> None:
        """Advance the CPU's clock over the calls in the queue, and submit each full batch."""
        queue = self._queue
        call = self.simulation.call
        follow = self._follow
        batch = self.simulation.batch
        position = self._followed
        start = 0
        end = len(queue)
        try:
            while position < end:
                op = queue[position]
                first, position = position + 1, position + WIDTHS[op]
                self._called += 1
                self._now += call
                follower, takes_use = follow[op]
                if follower is not None:
                    if takes_use:
                        use = (self._called, queue[position - 2], queue[position - 1], op)
                        follower(use, *queue[first : position - 2])
                    else:
                        follower(*queue[first : position - 2])
                if op == Op.PRESENT:
                    self._advance(self._now)
                    self._log.present(self._now)
                if self._called - self._submitted >= batch:
                    self._send(queue[start:position])
                    start = position
        finally:
            del queue[:start]
            self._followed = position - start

    def _submit(self) -> None:
        """Submit all calls in the queue to the GPU."""
        self._follow_calls()
        if self._queue:
            self._send(self._queue.copy())
            self._queue.clear()
            self._followed = 0

    def _send(self, entries: list[Any]) -> None:
        self._submissions.append(_Submission(entries, self._now + self.simulation.submission_latency))
        self._submitted = self._called
        self._queued_bytes = 0

    def _spend_call(self) -> None:
        self._follow_calls()
        self._now += self.simulation.call

    def _stall(self, until: int, reason: str) -> None:
        if until > self._now:
            until += self.simulation.wake_latency
            self._log.add_stall(self._now, until, reason)
            self._now = until

    def _drain(self, reason: str) -> None:
        """Advance the CPU's clock to the time at which the GPU has executed everything."""
        self._submit()
        self._advance(math.inf)
        self._stall(self._gpu, reason)
        self._hazards.note_completed(self._called)

    def _is_done(self, serial: int) -> bool:
        """True if the GPU has completed a command by now."""
        self._advance(self._now)
        return serial <= self._executed - (self._gpu > self._now)

    def _make_use(self, op: Op = Op.WRITE_BUFFER) -> CommandUse:
        """Return the use of the current call, which the CPU executes immediately, for a hazard."""
        return self._called, *self._current_site(), op

    # -- calls -------------------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: descriptors.BufferDescriptor) -> None:
        self._spend_call()
        super().create_buffer(buffer, descriptor)
        if descriptor.usage is not descriptors.BufferUsage.STATIC:
            self._hazards.create_stream(buffer, descriptor)
        if descriptor.usage is descriptors.BufferUsage.READBACK:
            self._readbacks.add(buffer)

    def create_texture(self, texture: Id, descriptor: descriptors.TextureDescriptor) -> None:
        self._spend_call()
        super().create_texture(texture, descriptor)

    def create_sampler(self, sampler: Id, descriptor: descriptors.SamplerDescriptor) -> None:
        self._spend_call()
        super().create_sampler(sampler, descriptor)

    def create_program(self, program: Id, descriptor: descriptors.ProgramDescriptor) -> None:
        self._spend_call()
        super().create_program(program, descriptor)
        self._hazards.create_program(program, descriptor)

    def create_vertex_array(self, vertex_array: Id, descriptor: descriptors.VertexArrayDescriptor) -> None:
        self._spend_call()
        super().create_vertex_array(vertex_array, descriptor)
        self._hazards.create_vertex_array(vertex_array, descriptor)

    def create_query(self, query: Id, kind: descriptors.QueryKind) -> None:
        self._spend_call()
        super().create_query(query, kind)
        self._hazards.create_query(query, kind)

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        if buffer in self._streams:
            self._spend_call()
            self._advance(self._now)  # reads of the GPU up to now see the old contents
            end = offset + memoryview(data).nbytes
            self._hazards.write_stream(self._make_use, buffer, offset, end)
            self._buffers.write_buffer(buffer, offset, bytes(data))
        else:
            self._enqueue_call(Op.WRITE_BUFFER, buffer, offset, bytes(data))
            self._count_queued(memoryview(data).nbytes)

    def write_texture(self, texture: Id, level: int, region: descriptors.Region, data: BytesLike) -> None:
        self._enqueue_call(Op.WRITE_TEXTURE, texture, level, region, bytes(data))
        self._count_queued(memoryview(data).nbytes)

    def _count_queued(self, size: int) -> None:
        self._queued_bytes += size
        if self._queued_bytes > QUEUED_BYTES:
            self._submit()
            self._advance(self._now)

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        if buffer in self._readbacks:
            self._spend_call()
            self._advance(self._now)  # what the GPU has written up to now
            self._hazards.read_stream(partial(self._make_use, Op.READ_BUFFER), buffer, offset, offset + size)
            return self._buffers.read_buffer(buffer, offset, size)
        self._enqueue_call(Op.READ_BUFFER, buffer, offset, size)
        self._drain("read_buffer")
        return self._buffers.read_buffer(buffer, offset, size)

    def read_texture(
        self, texture: Id, level: int, region: descriptors.Region, stencil: bool
    ) -> NDArray[np.generic]:
        self._enqueue_call(Op.READ_TEXTURE, texture, level, region, stencil)
        self._drain("read_texture")
        return self._textures.read_texture(texture, level, region, stencil)

    def signal(self, value: int) -> None:
        self._enqueue_call(Op.SIGNAL, value)
        self._submit()

    def completed(self) -> int:
        self._spend_call()
        self._advance(self._now)
        self._hazards.note_fence(self._fence)
        return self._fence

    def wait(self, value: int, seconds: float) -> bool:
        self._spend_call()
        self._submit()
        limit = self._now + round(min(seconds, 1e6) * 1e9)
        before = self._fence
        self._advance(limit, value)
        if self._fence < value:
            self._stall(limit - self.simulation.wake_latency, f"wait({value})")
            return False
        if before < value:
            self._stall(self._fence_time, f"wait({value})")
        self._hazards.note_fence(value)
        return True

    def write_query(self, query: Id) -> None:
        if self._queries.kind(query) is descriptors.QueryKind.TIMESTAMP:
            self._follow_calls()
            self._issue_times[query] = self._now
        self._enqueue_call(Op.WRITE_QUERY, query)

    def read_issue_time(self, query: Id) -> int | None:
        """See `rhi.contract.backend.SupportsIssueTimes`."""
        return self._issue_times[query] if self._queries.read(query) is not None else None

    def read_query(self, query: Id) -> int | None:
        self._spend_call()
        self._submit()
        self._advance(self._now)
        self._hazards.read_query(self._make_use, query)
        asked = self._hazards.latest_uses.get(query, 0)
        if asked > self._executed or self._read_at.get(query, 0) > self._now:
            return None  # there may be an earlier answer, but the query was used again
        answer = self._queries.read(query)
        if answer is not None:
            self._hazards.note_answer(query)
        return answer

    # -- the GPU's side ------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Advance the GPU to the CPU's clock."""
        self._follow_calls()
        self._advance(self._now)

    def _advance(self, until: float, fence: int | None = None) -> None:
        """Execute the commands that start by `until`, up to the signal of `fence`."""
        submissions = self._submissions
        if submissions and submissions[0].ready <= until:
            self._execute_submissions(until, fence)
        if self._interrupts:
            idle = not submissions or submissions[0].ready > until
            self._handle_interrupts(
                until if idle else min(until, self._gpu), self._gpu, self._queries.counter
            )

    def _execute_submissions(self, until: float, fence: int | None) -> None:
        """Execute submitted commands, as in `_advance`. A command that raises is removed."""
        submissions = self._submissions
        execute = self._execute
        measure = self._measure
        fixed = self._fixed
        marks = self._marks
        queries = self._queries
        meter = self._meter
        nanoseconds = self.simulation.cost.nanoseconds
        hazards = self._hazards
        while submissions and (fence is None or self._fence < fence):
            submission = submissions[0]
            if submission.ready > until:
                return
            if self._gpu < submission.ready:
                self._log.add_idle(Activity.STARVED, self._gpu, submission.ready)
                self._gpu = submission.ready
            entries = submission.entries
            position = submission.position
            end = len(entries)
            try:
                while position < end:
                    if self._gpu > until or (fence is not None and self._fence >= fence):
                        return
                    op = entries[position]
                    first, position = position + 1, position + WIDTHS[op]
                    self._executed += 1
                    if op in marks:
                        marks[op](*entries[first : position - 2])
                    executor, measured = execute[op], measure[op]
                    if measured is None:
                        if executor is not None:
                            executor(*entries[first : position - 2])
                        self._gpu += fixed[op]
                        continue
                    arguments = entries[first : position - 2]
                    start, counter = self._gpu, queries.counter
                    passed, unknown = queries.passed, queries.unknown
                    if executor is not None:
                        executor(*arguments)
                    meter.samples = queries.passed - passed if queries.unknown == unknown else None
                    while 0 < hazards.next_deferred <= self._executed:
                        hazards.execute_deferred(self._executed, self._indirect_draws)
                    self._gpu += nanoseconds(measured(*arguments))
                    if self._interrupts:
                        self._handle_interrupts(self._gpu, start, counter)
            finally:
                submission.position = position
            submissions.popleft()

    def _mark_pass(self, descriptor: descriptors.PassDescriptor) -> None:
        self._log.begin_label(self._gpu, descriptor.label or "pass")

    def _signal(self, value: int) -> None:
        super()._signal(value)
        self._fence_time = self._gpu

    def _write_query(self, query: Id) -> None:
        latency = self.simulation.interrupt_latency
        if latency is None or self._queries.kind(query) is not descriptors.QueryKind.COUNTER:
            self._queries.write_query(query, self._gpu)
            return
        self._queries.begin_write(query)
        self._interrupts.append((self._gpu + latency, query, self._executed, self._queries.counter))
        if self.simulation.halts_at_events:
            self._log.add_idle(Activity.HALTED, self._gpu, self._gpu + latency, "sample counter")
            self._gpu += latency

    def _handle_interrupts(self, until: float, start: int, before: int | None) -> None:
        """Read the counter for the interrupts up to `until`.

        The counter was `before` at `start`, when the GPU began its present command. A draw is assumed to pass
        its samples evenly over its time.
        """
        while self._interrupts and self._interrupts[0][0] <= until:
            time, query, event, exact = self._interrupts.popleft()
            value = after = self._queries.counter
            if before is not None and after is not None and start < self._gpu:
                share = max(0, min(time, self._gpu) - start)
                value = before + (after - before) * share // (self._gpu - start)
            if all(
                later != query for _, later, _, _ in self._interrupts
            ):  # a later write has an answer of its own
                self._queries.finish_write(query, value)
                self._read_at[query] = time
            if value is not None and exact is not None and value > exact:
                self._hazards.confirm_race(event)
