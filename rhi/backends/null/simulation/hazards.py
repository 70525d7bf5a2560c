"""Hazards: accesses of the CPU that aren't synchronised with the GPU, and passes that read what they write.

- The GPU executes in order. So the CPU's knowledge is one number: the last command up to which everything is
  done. It comes from a polled or awaited fence, a query's result, or a read that waits.
- Accessing memory or a resource that a command beyond that number uses is a hazard: it fails on some GPU that
  is slow enough. `happened` says whether it failed in this run, by the simulated clock.
- The hazards therefore depend on what the CPU has polled, not on costs or luck. A program that never polls
  has the same hazards at every latency. A program without hazards is correct on any GPU that executes in
  order.
- Ranges are exact, in bytes. The vertices that an indexed or indirect draw reads are known only when it is
  executed. Until then, writes to its buffers are kept as suspects.
- Where the CPU reads the sample counter in interrupts and the GPU runs on, the counter may have moved on when
  it is read (thesis 4.4.2). So a draw is a hazard if it is called before the CPU knows that the counter was
  read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from rhi.backends.null.null_buffers import Buffers
from rhi.backends.null.null_draws import ExecutedIndirectDraws
from rhi.backends.null.null_textures import Textures
from rhi.backends.null.simulation.streams import CommandUse, StreamMemory, vertex_ranges
from rhi.commands.context import StreamContext
from rhi.commands.ops import CREATIONS, ID_ARGUMENTS, Op
from rhi.commands.stream import call_site_at
from rhi.contract.descriptors import (
    ALL_LAYERS,
    DRAW,
    Attachment,
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    QueryKind,
    Region,
    VertexArrayDescriptor,
)
from rhi.contract.states import ColorWrite, DepthTest, DepthWrite, StencilTest
from rhi.errors.call_sites import CallSite
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass


class HazardKind(Choice):
    """The kind of a hazard; the value describes it in a sentence."""

    WRITE_IN_USE = "the CPU writes memory that the GPU may still use"
    READ_IN_USE = "the CPU reads memory that the GPU may still write"
    RING_OVERTAKEN = "a ring wraps around to memory that the GPU may still use"
    QUERY_UNFINISHED = "a query is read that isn't finished"
    COUNTER_RACE = "a draw may be counted before the CPU reads the sample counter for an earlier event"
    DESTROYED_IN_USE = "a resource is destroyed while the GPU may still use it"
    USED_DESTROYED = "a command uses a destroyed resource"
    PASS_FEEDBACK = "a pass reads what it writes"


@dataclass(frozen=True, slots=True)
class Hazard:
    """Two calls that access a resource without the synchronisation they need.

    Attributes:
        resource: the id of the resource in the command stream.
        first, second: the sites of the calls, in the order of the calls. None outside user code, or where
            there was no first call (a query that never began).
        calls: the names of the two calls.
        happened: whether the GPU was still using the resource in this run. If not, the GPU was fast enough by
            luck. For a counter: whether its value included the samples of later draws, known once it was
            read.
        bytes: the first byte and one past the last byte that both access; (0, 0) if bytes don't matter.
    """

    kind: HazardKind
    resource: Id
    first: CallSite | None
    second: CallSite | None
    calls: tuple[str, str]
    happened: bool
    bytes: tuple[int, int] = (0, 0)

    def __str__(self) -> str:
        where = f", bytes {self.bytes[0]} to {self.bytes[1]}" if self.bytes[1] else ""
        lines = [f"{self.kind.value} (resource {self.resource}{where})"]
        for call, site in zip(self.calls, (self.first, self.second), strict=True):
            if call:
                lines.append(f"  {call:<16} {site or 'outside user code'}")
        return "\n".join(lines)


class _DeferredDraw:
    """A draw whose vertices are known only when it is executed, and the writes to its buffers until then."""

    __slots__ = ("arguments", "array", "buffers", "suspects", "use")

    def __init__(
        self, use: CommandUse, array: VertexArrayDescriptor, arguments: tuple[Any, ...] = ()
    ) -> None:
        self.use = use
        self.array = array
        self.buffers = {array.index_buffer, *(stream.buffer for stream in array.streams)}
        self.arguments = arguments
        self.suspects: list[tuple[Id, int, int, CommandUse, HazardKind]] = []


_DRAW_BYTES = DRAW.itemsize
# A global is found faster than a member of an enum.
_UNIFORM = BindingKind.UNIFORM
_STORAGE = BindingKind.STORAGE
_IMAGE = BindingKind.IMAGE
_BINDING = frozenset(
    {Op.SET_STATES, Op.BIND_PROGRAM, Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE}
)
"""Commands that only bind. What is bound is used when something is drawn or dispatched."""


class HazardTracker:
    """Finds the hazards of one device. The methods named like commands are called in the order of the calls.

    Attributes:
        hazards: the hazards found, in order.
        latest_uses: by query, the number of the command that last began, ended or wrote it.
        completed: the number of the command up to which the CPU knows that everything is done.
    """

    def __init__(
        self,
        buffers: Buffers,
        textures: Textures,
        is_done: Callable[[int], bool],
        counters_race: bool = False,
    ) -> None:
        """Start without uses.

        `is_done(serial)` says whether the simulated GPU has completed a command. `counters_race`: the CPU
        reads the sample counter in interrupts, while the GPU runs on.
        """
        self._buffers = buffers
        self._textures = textures
        self._is_done = is_done
        self.hazards: list[Hazard] = []
        self.latest_uses: dict[Id, int] = {}
        self.completed = 0
        self._fences: deque[tuple[int, int]] = deque()  # (value, command) of signals not known to be reached
        self._uses: dict[Id, CommandUse] = {}  # the latest use of each resource
        self._destroyed: dict[Id, CommandUse] = {}
        self._streams: dict[Id, StreamMemory] = {}
        self._deferred: deque[_DeferredDraw] = deque()
        self._keys: dict[Id, list[tuple[BindingKind, int]]] = {}  # of the bindings of each program
        # By vertex array: its descriptor, the resources that its draws use, whether any of them is a STREAM
        # buffer.
        self._arrays: dict[Id, tuple[VertexArrayDescriptor, tuple[Id, ...], bool]] = {}
        self._context = StreamContext()
        self._pass_use: CommandUse = (0, None, -1, 0)
        self._targets: frozenset[Id] = frozenset()
        self._unfinished: dict[Id, CommandUse | None] = {}  # queries that began, or were only created (None)
        self._counters_race = counters_race
        self._counters: set[Id] = set()
        self._unread: list[
            tuple[CommandUse, Id]
        ] = []  # events whose counter isn't known to be read, no draw after
        self._raced: dict[int, int] = {}  # by an event's command: the index of its hazard

    def followers(self) -> tuple[tuple[Callable[..., None] | None, bool], ...]:
        """Return for each op the method that follows a call, and whether it takes the call's `CommandUse`
        first."""
        return tuple(self._get_follower(op) for op in Op)

    def _get_follower(self, op: Op) -> tuple[Callable[..., None] | None, bool]:
        if op in _BINDING:
            return getattr(self._context, op.method), False
        if op in CREATIONS:
            return None, True
        whole = partial(self._use_all, ID_ARGUMENTS[op]) if ID_ARGUMENTS[op] else None
        return getattr(self, op.method, whole), True

    # -- the CPU's knowledge -------------------------------------------------------------------------------

    def signal(self, use: CommandUse, value: int) -> None:
        self._fences.append((value, use[0]))

    def note_fence(self, value: int) -> None:
        """Note that the CPU has seen the fence at `value`."""
        while self._fences and self._fences[0][0] <= value:
            self.note_completed(self._fences.popleft()[1])

    def note_completed(self, serial: int) -> None:
        """Note that the CPU knows that everything up to this command is done."""
        self.completed = max(self.completed, serial)

    def note_answer(self, query: Id) -> None:
        """Note that the CPU has the result of a query. So its counter was read, and the counters of all
        earlier events."""
        serial = self.latest_uses.get(query, 0)
        self.note_completed(serial)
        if query in self._counters:
            self._unread = [event for event in self._unread if event[0][0] > serial]

    def confirm_race(self, event: int) -> None:
        """Note that the counter was read too late for an event, the command of this number."""
        hazard_index = self._raced[event]
        self.hazards[hazard_index] = replace(self.hazards[hazard_index], happened=True)

    # -- creation ------------------------------------------------------------------------------------------

    def create_stream(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        """Add a STREAM or READBACK buffer, which the CPU writes or reads without order."""
        self._streams[buffer] = StreamMemory(descriptor.size)

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._keys[program] = [(binding.kind, binding.slot) for binding in descriptor.bindings]

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        buffers = tuple(stream.buffer for stream in descriptor.streams)
        if descriptor.index_buffer:
            buffers += (descriptor.index_buffer,)
        streamed = not self._streams.keys().isdisjoint(buffers)
        self._arrays[vertex_array] = (descriptor, (vertex_array, *buffers), streamed)

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self._unfinished[query] = None
        if kind is QueryKind.COUNTER and self._counters_race:
            self._counters.add(query)

    # -- immediate calls -----------------------------------------------------------------------------------

    def write_stream(self, make_use: Callable[[], CommandUse], buffer: Id, begin: int, end: int) -> None:
        """Check an immediate write by the CPU. It is no use by the GPU, so `make_use` creates its use only
        for a hazard."""
        memory = self._streams.get(buffer)
        if memory is None:
            self._report(
                HazardKind.USED_DESTROYED, buffer, self._destroyed[buffer], make_use(), happened=True
            )
            return
        if end <= begin:
            return
        comes_round = memory.write(begin, end)
        kind = HazardKind.RING_OVERTAKEN if comes_round else HazardKind.WRITE_IN_USE
        used = memory.find_use(begin, end, self.completed)
        if used is not None:
            self._report(kind, buffer, used[2], make_use(), (max(begin, used[0]), min(end, used[1])))
        for deferred in self._deferred:
            if buffer in deferred.buffers:
                deferred.suspects.append((buffer, begin, end, make_use(), kind))

    def read_stream(self, make_use: Callable[[], CommandUse], buffer: Id, begin: int, end: int) -> None:
        """Check an immediate read by the CPU, of a buffer that the GPU only writes."""
        used = self._streams[buffer].find_use(begin, end, self.completed)
        if used is not None:
            overlap = (max(begin, used[0]), min(end, used[1]))
            self._report(HazardKind.READ_IN_USE, buffer, used[2], make_use(), overlap)

    def read_query(self, make_use: Callable[[], CommandUse], query: Id) -> None:
        """Check a read of a query's result."""
        if query in self._unfinished:
            begun = self._unfinished[query]
            hazard = Hazard(
                HazardKind.QUERY_UNFINISHED,
                query,
                _site(begun),
                _site(make_use()),
                ("begin_query" if begun else "", "read_query"),
                True,
            )
            self.hazards.append(hazard)

    def destroy(self, use: CommandUse, resource: Id) -> None:
        last = self._uses.pop(resource, None)
        if last is not None and last[0] > self.completed:
            self._report(HazardKind.DESTROYED_IN_USE, resource, last, use)
        self._destroyed[resource] = use
        self._streams.pop(resource, None)
        self._keys.pop(resource, None)
        # The descriptor of a vertex array is kept: a draw may still refer to it.
        self._unfinished.pop(resource, None)
        self._counters.discard(resource)
        self.latest_uses.pop(resource, None)

    # -- binding -------------------------------------------------------------------------------------------

    def begin_pass(self, use: CommandUse, descriptor: PassDescriptor) -> None:
        self._context.begin_pass(descriptor)
        self._pass_use = use
        self._use_targets(use, descriptor)
        depth = {descriptor.depth.texture} if descriptor.depth is not None else set()
        self._targets = frozenset({attachment.texture for attachment in descriptor.colors} | depth)

    def end_pass(self, use: CommandUse) -> None:
        if self._context.render_pass is not None:
            self._use_targets(use, self._context.render_pass)
        self._context.end_pass()
        self._targets = frozenset()

    def _use_targets(self, use: CommandUse, descriptor: PassDescriptor) -> None:
        for attachment in descriptor.colors:
            self._use(use, attachment.texture)
            if attachment.resolve:
                self._use(use, attachment.resolve)
        if descriptor.depth is not None:
            self._use(use, descriptor.depth.texture)

    # -- work ----------------------------------------------------------------------------------------------

    def draw(
        self,
        use: CommandUse,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        self._use_program(use)
        array = self._use_vertex_array(use, vertex_array)
        if self._unread and count and instances:
            self._report_races(use)
        if array is None or not count or not instances:  # most draws read no STREAM buffers
            return
        streams = self._streams
        index = array.index_buffer
        if index in streams:
            begin, end = first * array.index_format.size, (first + count) * array.index_format.size
            streams[index].use(begin, end, use, self.completed)
        if not any(stream.buffer in streams for stream in array.streams):
            return
        arguments = (primitive, [(count, instances, first, base_vertex, base_instance)])
        if index and index not in streams:
            self._deferred.append(_DeferredDraw(use, array, arguments))
        else:
            for buffer, begin, end in vertex_ranges(array, *arguments, streams, self._buffers.memory):
                streams[buffer].use(begin, end, use, self.completed)

    def draw_indirect(
        self,
        use: CommandUse,
        vertex_array: Id,
        primitive: Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        self._use_program(use)
        array = self._use_vertex_array(use, vertex_array)
        if self._unread:
            self._report_races(use)
        for index in range(draws):
            self._use_bytes(use, buffer, offset + index * stride, offset + index * stride + _DRAW_BYTES)
        if count_buffer:
            self._use_bytes(use, count_buffer, count_offset, count_offset + 4)
        if array is not None:
            self._deferred.append(_DeferredDraw(use, array))

    def dispatch(self, use: CommandUse, x: int, y: int, z: int) -> None:
        self._use_program(use)

    def dispatch_indirect(self, use: CommandUse, buffer: Id, offset: int) -> None:
        self._use_program(use)
        self._use_bytes(use, buffer, offset, offset + 12)

    def copy_buffer(
        self, use: CommandUse, source: Id, source_offset: int, target: Id, target_offset: int, size: int
    ) -> None:
        self._use_bytes(use, source, source_offset, source_offset + size)
        self._use_bytes(use, target, target_offset, target_offset + size)

    def clear_buffer(self, use: CommandUse, buffer: Id, offset: int, size: int, value: int) -> None:
        self._use_bytes(use, buffer, offset, offset + size)

    def copy_texture_to_buffer(
        self, use: CommandUse, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        self._use(use, source)
        self._use_bytes(use, target, offset, offset + row_bytes * region.height * region.layers)

    def copy_buffer_to_texture(
        self, use: CommandUse, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> None:
        self._use(use, target)
        self._use_bytes(use, source, offset, offset + row_bytes * region.height * region.layers)

    def begin_query(self, use: CommandUse, query: Id) -> None:
        self._use(use, query)
        self.latest_uses[query] = use[0]
        self._unfinished[query] = use

    def end_query(self, use: CommandUse, query: Id) -> None:
        self.write_query(use, query)

    def write_query(self, use: CommandUse, query: Id) -> None:
        self._use(use, query)
        self.latest_uses[query] = use[0]
        self._unfinished.pop(query, None)
        if query in self._counters:
            self._unread.append((use, query))

    # -- known only when executed --------------------------------------------------------------------------

    @property
    def next_deferred(self) -> int:
        """The number of the next command for which `execute_deferred` must be called, 0 if none."""
        return self._deferred[0].use[0] if self._deferred else 0

    def execute_deferred(self, serial: int, indirect: Sequence[ExecutedIndirectDraws]) -> None:
        """Check a deferred draw as the GPU executes it: its vertices are known now, and so are the writes to
        them."""
        deferred = self._deferred.popleft()
        if deferred.use[0] != serial:  # that draw failed when it was executed
            return
        array = deferred.array
        if deferred.arguments:
            primitive, draws = deferred.arguments
        else:
            primitive, draws = indirect[-1].primitive, indirect[-1].draws.tolist()
        ranges = vertex_ranges(array, primitive, draws, self._streams, self._buffers.memory)
        if not deferred.arguments and array.index_buffer in self._streams:
            size = array.index_format.size
            ranges += [
                (array.index_buffer, first * size, (first + count) * size)
                for count, instances, first, _, _ in draws
                if count and instances
            ]
        for buffer, begin, end in ranges:
            for written, write_begin, write_end, use, kind in deferred.suspects:
                if written == buffer and begin < write_end and write_begin < end:
                    overlap = (max(begin, write_begin), min(end, write_end))
                    self._report(kind, buffer, deferred.use, use, overlap, happened=True)
            if buffer in self._streams:
                self._streams[buffer].use(begin, end, deferred.use, self.completed)

    # -- helpers -------------------------------------------------------------------------------------------

    def _use(self, use: CommandUse, resource: Id) -> None:
        """Record that a command uses a resource."""
        if resource in self._destroyed:
            self._report(HazardKind.USED_DESTROYED, resource, self._destroyed[resource], use, happened=True)
        self._uses[resource] = use

    def _use_all(self, argument_indices: tuple[int, ...], use: CommandUse, *values: Any) -> None:
        """Record the uses of a command that uses the whole of each of its resources."""
        for argument_index in argument_indices:
            if values[argument_index]:
                self._use(use, values[argument_index])

    def _report_races(self, draw: CommandUse) -> None:
        """Report the events before `draw` whose counter the CPU doesn't know to be read."""
        for event, query in self._unread:
            self._raced[event[0]] = len(self.hazards)
            self._report(HazardKind.COUNTER_RACE, query, event, draw, happened=False)
        self._unread.clear()

    def _use_bytes(self, use: CommandUse, buffer: Id, begin: int, end: int) -> None:
        if buffer in self._destroyed:
            self._use(use, buffer)
        self._uses[buffer] = use
        memory = self._streams.get(buffer)
        if memory is not None:
            memory.use(begin, end, use, self.completed)

    def _use_vertex_array(self, use: CommandUse, vertex_array: Id) -> VertexArrayDescriptor | None:
        """Record the use of a vertex array and its buffers. Return its descriptor if any of them is a STREAM
        buffer."""
        entry = self._arrays.get(vertex_array)
        if entry is None:
            return None
        array, resources, streamed = entry
        uses, destroyed = self._uses, self._destroyed
        for resource in resources:
            if resource in destroyed:
                self._use(use, resource)
            uses[resource] = use
        return array if streamed else None

    def _use_program(self, use: CommandUse) -> None:
        """Record the use of the bound program, and of the resources bound to the slots it reads."""
        context = self._context
        if not context.program:
            return
        self._use(use, context.program)
        slots = context.slots
        for key in self._keys.get(context.program, ()):
            bound, kind = slots.get(key), key[0]
            if bound is None:
                continue
            if kind is _UNIFORM or kind is _STORAGE:
                buffer, offset, size = bound
                self._use_bytes(use, buffer, offset, offset + size)
                continue
            self._use(use, bound[0])
            if bound[0] in self._targets:
                level, layer = bound[1:] if kind is _IMAGE else (None, -1)
                self._check_feedback(use, bound[0], level, layer)

    def _check_feedback(self, use: CommandUse, texture: Id, level: int | None, layer: int) -> None:
        """Report a hazard if the pass writes what is read of a texture: a level (None: all) and a layer (−1:
        all)."""
        descriptor = self._context.render_pass
        if descriptor is None:
            return
        states: Any = self._context.states
        written = [
            target
            for target, write in zip(descriptor.colors, states[ColorWrite], strict=False)
            if target.clear is not None or write.red or write.green or write.blue or write.alpha
        ]
        depth = descriptor.depth
        if depth is not None and (
            depth.clear is not None
            or depth.clear_stencil is not None
            or (states[DepthTest] is DepthTest.ON and states[DepthWrite] is DepthWrite.ON)
            or (states[StencilTest] is StencilTest.ON and self._has_stencil(depth.texture))
        ):
            written.append(Attachment(depth.texture, depth.level, depth.layer))
        for target in written:
            same = level in (None, target.level) and (
                ALL_LAYERS in (layer, target.layer) or layer == target.layer
            )
            if target.texture == texture and same:
                self._report(HazardKind.PASS_FEEDBACK, texture, self._pass_use, use, happened=True)
                return

    def _has_stencil(self, texture: Id) -> bool:
        state = self._textures.textures.get(texture)
        return state is not None and state.descriptor.format.has_stencil

    def _report(
        self,
        kind: HazardKind,
        resource: Id,
        first: CommandUse,
        second: CommandUse,
        bytes: tuple[int, int] = (0, 0),
        happened: bool | None = None,
    ) -> None:
        happened = not self._is_done(first[0]) if happened is None else happened
        calls = (Op(first[3]).method, Op(second[3]).method)
        self.hazards.append(Hazard(kind, resource, _site(first), _site(second), calls, happened, bytes))


def _site(use: CommandUse | None) -> CallSite | None:
    return call_site_at(use[1], use[2]) if use is not None else None
