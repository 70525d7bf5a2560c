"""Hazards: what the CPU does without knowing that the GPU is done, and passes that read what they write.

- The GPU executes in order, so all that the CPU can know is one number: up to which command everything is
  done. It learns it from a fence it asked or waited for, from a query's answer, from a read that waited.
- Whatever touches memory or a resource in use by a command beyond that number is a hazard: on some GPU, slow
  enough, it goes wrong. `happened` says whether it did in this run, by the simulated clock.
- So what is found depends on what the CPU was told, not on costs or luck: a program that asks nothing has the
  same hazards at every latency. What isn't found can't go wrong on any GPU that executes in order.
- Ranges are exact, in bytes. Which vertices an indexed or indirect draw reads is known when it is executed;
  until then writes to its buffers wait as suspects.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from rhi.backends.null.buffers import Buffers
from rhi.backends.null.draws import ExecutedIndirectDraws
from rhi.backends.null.simulation.streams import CommandUse, StreamMemory, vertex_ranges
from rhi.backends.null.textures import Textures
from rhi.commands.context import StreamContext
from rhi.commands.ops import Op
from rhi.commands.stream import find_site
from rhi.contract.descriptors import (
    DRAW,
    Attachment,
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    Region,
    VertexArrayDescriptor,
)
from rhi.contract.states import ColorWrite, DepthTest, DepthWrite, StateChange, StencilTest
from rhi.errors import CallSite

__rhi_internal__ = True


class HazardKind(enum.Enum):
    """What went wrong; the value is a sentence."""

    WRITE_IN_USE = "the CPU writes memory that the GPU may still use"
    RING_OVERTAKEN = "a ring comes round to memory that the GPU may still use"
    QUERY_UNFINISHED = "a query is read that isn't finished"
    DESTROYED_IN_USE = "a resource is destroyed while the GPU may still use it"
    USED_DESTROYED = "a command uses a destroyed resource"
    PASS_FEEDBACK = "a pass reads what it writes"


@dataclass(frozen=True, slots=True)
class Hazard:
    """Two calls that must not meet.

    Attributes:
        resource: its id in the command stream.
        first, second: the calls' sites, in the order in which they were made; None if outside user code, or
            where there was no first call (a query that was never begun).
        calls: the names of the two calls.
        happened: whether in this run the GPU was really not done. If not, it was only fast enough.
        bytes: the first and the one past the last that both touch; (0, 0) where it isn't about bytes.
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


class _Deferred:
    """A draw whose vertices are known when it is executed, and writes until then to buffers it reads."""

    __slots__ = ("arguments", "array", "buffers", "suspects", "use")

    def __init__(
        self, use: CommandUse, array: VertexArrayDescriptor, arguments: tuple[Any, ...] = ()
    ) -> None:
        self.use = use
        self.array = array
        self.buffers = {array.index_buffer, *(stream.buffer for stream in array.streams)}
        self.arguments = arguments
        self.suspects: list[tuple[Id, int, int, CommandUse, HazardKind]] = []


_Slots = tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...], tuple[int, ...]]
_NO_SLOTS: _Slots = ((), (), (), ())
_DRAW_BYTES = DRAW.itemsize
_BINDING = frozenset(
    {Op.SET_STATES, Op.BIND_PROGRAM, Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE}
)
"""What is bound isn't used before something is drawn or dispatched."""


class HazardTracker:
    """One device's. The methods named as commands follow the calls in the order in which they are made.

    Attributes:
        hazards: what was found, in order.
        asked: by query, the number of the command that last began, ended or wrote it.
        known: the number of the command up to which the CPU knows that all is done.
    """

    def __init__(self, buffers: Buffers, textures: Textures, is_done: Callable[[int], bool]) -> None:
        """`is_done(serial)` says whether the GPU is in truth done with a command."""
        self._buffers = buffers
        self._textures = textures
        self._is_done = is_done
        self.hazards: list[Hazard] = []
        self.asked: dict[Id, int] = {}
        self.known = 0
        self._fences: deque[tuple[int, int]] = deque()  # (value, serial) of signals not known to be reached
        self._uses: dict[Id, CommandUse] = {}  # by resource, the latest
        self._destroyed: dict[Id, CommandUse] = {}
        self._streams: dict[Id, StreamMemory] = {}
        self._deferred: deque[_Deferred] = deque()
        self._slots: dict[Id, _Slots] = {}
        # By vertex array: its descriptor, all that its draws use, whether any of that is a stream buffer.
        self._arrays: dict[Id, tuple[VertexArrayDescriptor, tuple[Id, ...], bool]] = {}
        self._program: Id = 0
        self._bound_uniforms: dict[int, tuple[Id, int, int]] = {}
        self._bound_storages: dict[int, tuple[Id, int, int]] = {}
        self._bound_textures: dict[int, Id] = {}
        self._bound_images: dict[int, tuple[Id, int, int]] = {}
        self._pass: tuple[PassDescriptor, CommandUse] | None = None
        self._targets: frozenset[Id] = frozenset()
        self._states = StreamContext().states
        self._unfinished: dict[Id, CommandUse | None] = {}  # queries begun or only created

    def followers(self) -> tuple[tuple[Callable[..., None] | None, bool], ...]:
        """By op, what follows a call, and whether it takes the call's `CommandUse` before the call's arguments."""
        followers: list[tuple[Callable[..., None] | None, bool]] = []
        for op in Op:
            follower = None if op.method.startswith("create_") else getattr(self, op.method, None)
            followers.append((follower, op not in _BINDING))
        return tuple(followers)

    # -- what the CPU knows --------------------------------------------------------------------------------

    def signal(self, use: CommandUse, value: int) -> None:
        self._fences.append((value, use[0]))

    def learn_fence(self, value: int) -> None:
        """The CPU has seen the fence at `value`."""
        while self._fences and self._fences[0][0] <= value:
            self.learn(self._fences.popleft()[1])

    def learn(self, serial: int) -> None:
        """The CPU has seen that everything up to this command is done."""
        self.known = max(self.known, serial)

    # -- creation ------------------------------------------------------------------------------------------

    def create_stream(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        """A buffer that is written unordered."""
        self._streams[buffer] = StreamMemory(descriptor.size)

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        slots: dict[BindingKind, list[int]] = {kind: [] for kind in BindingKind}
        for binding in descriptor.bindings:
            slots[binding.kind].append(binding.slot)
        uniforms, storages, textures, images = (
            tuple(slots[kind])
            for kind in (BindingKind.UNIFORM, BindingKind.STORAGE, BindingKind.TEXTURE, BindingKind.IMAGE)
        )
        self._slots[program] = (uniforms, storages, textures, images)

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        buffers = tuple(stream.buffer for stream in descriptor.streams)
        if descriptor.index_buffer:
            buffers += (descriptor.index_buffer,)
        streamed = not self._streams.keys().isdisjoint(buffers)
        self._arrays[vertex_array] = (descriptor, (vertex_array, *buffers), streamed)

    def create_query(self, query: Id) -> None:
        self._unfinished[query] = None

    # -- what the CPU does at once -------------------------------------------------------------------------

    def write_stream(self, make_use: Callable[[], CommandUse], buffer: Id, begin: int, end: int) -> None:
        """The CPU writes memory past the queue; that is no use of the GPU's. `make_use` finds the call."""
        memory = self._streams.get(buffer)
        if memory is None:
            self._report(
                HazardKind.USED_DESTROYED, buffer, self._destroyed[buffer], make_use(), happened=True
            )
            return
        if end <= begin:
            return
        in_place = begin < memory.written[1] and memory.written[0] < end
        kind = HazardKind.WRITE_IN_USE if in_place else HazardKind.RING_OVERTAKEN
        memory.written = (begin, end)
        met = memory.find(begin, end, self.known)
        if met is not None:
            self._report(kind, buffer, met[2], make_use(), (max(begin, met[0]), min(end, met[1])))
        for deferred in self._deferred:
            if buffer in deferred.buffers:
                deferred.suspects.append((buffer, begin, end, make_use(), kind))

    def read_query(self, make_use: Callable[[], CommandUse], query: Id) -> None:
        """The CPU asks for an answer."""
        if query in self._unfinished:
            begun = self._unfinished[query]
            hazard = Hazard(HazardKind.QUERY_UNFINISHED, query, _site(begun), _site(make_use()),
                            ("begin_query" if begun else "", "read_query"), True)  # fmt: skip
            self.hazards.append(hazard)

    def destroy(self, use: CommandUse, resource: Id) -> None:
        last = self._uses.pop(resource, None)
        if last is not None and last[0] > self.known:
            self._report(HazardKind.DESTROYED_IN_USE, resource, last, use)
        self._destroyed[resource] = use
        self._streams.pop(resource, None)
        self._slots.pop(resource, None)
        # Of a vertex array what it was is kept: a draw may still name it.
        self._unfinished.pop(resource, None)
        self.asked.pop(resource, None)

    # -- binding -------------------------------------------------------------------------------------------

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self._states.update(changes)

    def bind_program(self, program: Id) -> None:
        self._program = program

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bound_uniforms[slot] = (buffer, offset, size)

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self._bound_storages[slot] = (buffer, offset, size)

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self._bound_textures[slot] = texture

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self._bound_images[slot] = (texture, level, layer)

    def begin_pass(self, use: CommandUse, descriptor: PassDescriptor) -> None:
        self._pass = (descriptor, use)
        self._touch_targets(use, descriptor)
        depth = {descriptor.depth.texture} if descriptor.depth is not None else set()
        self._targets = frozenset({attachment.texture for attachment in descriptor.colors} | depth)

    def end_pass(self, use: CommandUse) -> None:
        if self._pass is not None:
            self._touch_targets(use, self._pass[0])
        self._pass, self._targets = None, frozenset()

    def _touch_targets(self, use: CommandUse, descriptor: PassDescriptor) -> None:
        for attachment in descriptor.colors:
            self._touch(use, attachment.texture)
            if attachment.resolve:
                self._touch(use, attachment.resolve)
        if descriptor.depth is not None:
            self._touch(use, descriptor.depth.texture)

    # -- work ----------------------------------------------------------------------------------------------

    def draw(
        self, use: CommandUse, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int,
        base_vertex: int, base_instance: int,
    ) -> None:  # fmt: skip
        self._use_program(use)
        array = self._use_vertex_array(use, vertex_array)
        if array is None or not count or not instances:  # most draws read nothing that is written unordered
            return
        streams = self._streams
        index = array.index_buffer
        if index in streams:
            begin, end = first * array.index_format.size, (first + count) * array.index_format.size
            streams[index].use(begin, end, use, self.known)
        if not any(stream.buffer in streams for stream in array.streams):
            return
        arguments = (primitive, [(count, instances, first, base_vertex, base_instance)])
        if index and index not in streams:
            self._deferred.append(_Deferred(use, array, arguments))
        else:
            for buffer, begin, end in vertex_ranges(array, *arguments, streams, self._buffers.memory):
                streams[buffer].use(begin, end, use, self.known)

    def draw_indirect(
        self, use: CommandUse, vertex_array: Id, primitive: Primitive, buffer: Id, offset: int, draws: int, stride: int,
        count_buffer: Id, count_offset: int,
    ) -> None:  # fmt: skip
        self._use_program(use)
        array = self._use_vertex_array(use, vertex_array)
        for index in range(draws):
            self._use_bytes(use, buffer, offset + index * stride, offset + index * stride + _DRAW_BYTES)
        if count_buffer:
            self._use_bytes(use, count_buffer, count_offset, count_offset + 4)
        if array is not None:
            self._deferred.append(_Deferred(use, array))

    def dispatch(self, use: CommandUse, x: int, y: int, z: int) -> None:
        self._use_program(use)

    def dispatch_indirect(self, use: CommandUse, buffer: Id, offset: int) -> None:
        self._use_program(use)
        self._use_bytes(use, buffer, offset, offset + 12)

    def write_buffer(self, use: CommandUse, buffer: Id, offset: int, data: bytes) -> None:
        self._touch(use, buffer)

    def read_buffer(self, use: CommandUse, buffer: Id, offset: int, size: int) -> None:
        self._touch(use, buffer)

    def copy_buffer(
        self, use: CommandUse, source: Id, source_offset: int, target: Id, target_offset: int, size: int
    ) -> None:
        self._use_bytes(use, source, source_offset, source_offset + size)
        self._use_bytes(use, target, target_offset, target_offset + size)

    def clear_buffer(self, use: CommandUse, buffer: Id, offset: int, size: int, value: int) -> None:
        self._use_bytes(use, buffer, offset, offset + size)

    def write_texture(self, use: CommandUse, texture: Id, level: int, region: Region, data: bytes) -> None:
        self._touch(use, texture)

    def read_texture(self, use: CommandUse, texture: Id, level: int, region: Region, stencil: bool) -> None:
        self._touch(use, texture)

    def copy_texture(
        self, use: CommandUse, source: Id, source_level: int, source_region: Region, target: Id, *place: int
    ) -> None:
        self._touch(use, source)
        self._touch(use, target)

    def resolve_texture(self, use: CommandUse, source: Id, target: Id) -> None:
        self._touch(use, source)
        self._touch(use, target)

    def generate_mipmaps(self, use: CommandUse, texture: Id) -> None:
        self._touch(use, texture)

    def present(self, use: CommandUse, texture: Id) -> None:
        if texture:
            self._touch(use, texture)

    def begin_query(self, use: CommandUse, query: Id) -> None:
        self._touch(use, query)
        self.asked[query] = use[0]
        self._unfinished[query] = use

    def end_query(self, use: CommandUse, query: Id) -> None:
        self.write_query(use, query)

    def write_query(self, use: CommandUse, query: Id) -> None:
        self._touch(use, query)
        self.asked[query] = use[0]
        self._unfinished.pop(query, None)

    def begin_conditional(self, use: CommandUse, query: Id, inverted: bool) -> None:
        self._touch(use, query)

    # -- what only execution tells -------------------------------------------------------------------------

    @property
    def waits_for(self) -> int:
        """The number of the next command that `executed` must be told of, 0 if none."""
        return self._deferred[0].use[0] if self._deferred else 0

    def executed(self, serial: int, indirect: Sequence[ExecutedIndirectDraws]) -> None:
        """The GPU is at that draw: its vertices are known, and what was written before it came to them."""
        deferred = self._deferred.popleft()
        if deferred.use[0] != serial:  # it failed when it was executed
            return
        array = deferred.array
        if deferred.arguments:
            primitive, draws = deferred.arguments
        else:
            primitive, draws = indirect[-1].primitive, indirect[-1].draws.tolist()
        ranges = vertex_ranges(array, primitive, draws, self._streams, self._buffers.memory)
        if not deferred.arguments and array.index_buffer in self._streams:
            size = array.index_format.size
            ranges += [(array.index_buffer, first * size, (first + count) * size)
                       for count, _, first, _, _ in draws if count]  # fmt: skip
        for buffer, begin, end in ranges:
            for written, write_begin, write_end, use, kind in deferred.suspects:
                if written == buffer and begin < write_end and write_begin < end:
                    both = (max(begin, write_begin), min(end, write_end))
                    self._report(kind, buffer, deferred.use, use, both, happened=True)
            if buffer in self._streams:
                self._streams[buffer].use(begin, end, deferred.use, self.known)

    # -- inside --------------------------------------------------------------------------------------------

    def _touch(self, use: CommandUse, resource: Id) -> None:
        """A command uses a resource."""
        if resource in self._destroyed:
            self._report(HazardKind.USED_DESTROYED, resource, self._destroyed[resource], use, happened=True)
        self._uses[resource] = use

    def _use_bytes(self, use: CommandUse, buffer: Id, begin: int, end: int) -> None:
        if buffer in self._destroyed:
            self._touch(use, buffer)
        self._uses[buffer] = use
        memory = self._streams.get(buffer)
        if memory is not None:
            memory.use(begin, end, use, self.known)

    def _use_vertex_array(self, use: CommandUse, vertex_array: Id) -> VertexArrayDescriptor | None:
        """What a draw reads its vertices through; None if none of it is written unordered."""
        known = self._arrays.get(vertex_array)
        if known is None:
            return None
        array, resources, streamed = known
        uses, destroyed = self._uses, self._destroyed
        for resource in resources:
            if resource in destroyed:
                self._touch(use, resource)
            uses[resource] = use
        return array if streamed else None

    def _use_program(self, use: CommandUse) -> None:
        """The bound program and what is bound to the slots it reads."""
        program = self._program
        if not program:
            return
        self._touch(use, program)
        uniforms, storages, textures, images = self._slots.get(program, _NO_SLOTS)
        for slots, bound in ((uniforms, self._bound_uniforms), (storages, self._bound_storages)):
            for slot in slots:
                if slot in bound:
                    buffer, offset, size = bound[slot]
                    self._use_bytes(use, buffer, offset, offset + size)
        for slot in textures:
            if slot in self._bound_textures:
                texture = self._bound_textures[slot]
                self._touch(use, texture)
                if texture in self._targets:
                    self._check_feedback(use, texture, None, -1)
        for slot in images:
            if slot in self._bound_images:
                texture, level, layer = self._bound_images[slot]
                self._touch(use, texture)
                if texture in self._targets:
                    self._check_feedback(use, texture, level, layer)

    def _check_feedback(self, use: CommandUse, texture: Id, level: int | None, layer: int) -> None:
        """Whether the part of a texture that is read (None: all levels; −1: all layers) is written."""
        if self._pass is None:
            return
        descriptor, begun = self._pass
        states: Any = self._states
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
            same = level in (None, target.level) and layer in (-1, target.layer)
            if target.texture == texture and same:
                self._report(HazardKind.PASS_FEEDBACK, texture, begun, use, happened=True)
                return

    def _has_stencil(self, texture: Id) -> bool:
        made = self._textures.textures.get(texture)
        return made is not None and made.descriptor.format.has_stencil

    def _report(
        self, kind: HazardKind, resource: Id, first: CommandUse, second: CommandUse, bytes: tuple[int, int] = (0, 0),
        happened: bool | None = None,
    ) -> None:  # fmt: skip
        happened = not self._is_done(first[0]) if happened is None else happened
        calls = (Op(first[3]).method, Op(second[3]).method)
        self.hazards.append(Hazard(kind, resource, _site(first), _site(second), calls, happened, bytes))


def _site(use: CommandUse | None) -> CallSite | None:
    return find_site(use[1], use[2]) if use is not None else None
