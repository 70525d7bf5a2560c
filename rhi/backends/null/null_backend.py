"""A queue of commands in front of real memory, without a GPU.

- Calls are appended to a flat queue (`op, arguments…`, as in `rhi.commands.stream`). Only creation is
  immediate.
- The queue is executed in order when something depends on it: a signal, a wait, a read. So commands that read
  memory (indirect arguments, copies, counters) see what it holds at their place in the stream. `simulation`
  executes the same queue on its own clock.
- STREAM buffers are written immediately, without the queue, as on hardware that maps them. So memory that is
  overwritten too early shows the new contents.
- Shaders are executed only on request, and only compute shaders (`shaders`).
- Time is simulated: each executed command takes `COMMAND_NANOSECONDS`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.backends.null.answers import Answers
from rhi.backends.null.execution import DrawOutcome, ExecutionState
from rhi.backends.null.null_buffers import Buffers
from rhi.backends.null.null_capabilities import PROFILES
from rhi.backends.null.null_draws import Draw, ExecutedIndirectDraws, has_vertices, read_indirect_draws
from rhi.backends.null.null_queries import Queries
from rhi.backends.null.null_textures import Textures
from rhi.backends.null.shaders import Shaders, StandIn
from rhi.commands.context import BOUND_KINDS
from rhi.commands.ops import WIDTHS, Op
from rhi.commands.recorder import CommandMethods
from rhi.contract import descriptors
from rhi.contract.backend import Capabilities
from rhi.contract.descriptors import Id
from rhi.errors.data_classes import dataclass

COMMAND_NANOSECONDS: Final = 1000
QUEUED_BYTES: Final = 1 << 24
"""Bytes of written data that the queue may hold before it is executed."""
MAX_INDIRECT_RECORDS: Final = 1024
"""Executed indirect commands whose arguments are kept."""


@dataclass(frozen=True, slots=True)
class ExecutionStatistics:
    """Counts of what was executed since the device was created.

    Attributes:
        commands: executed commands.
        draws: executed draws; an indirect command counts each of its draws.
        dropped_draws: draws dropped by conditional rendering.
        undecided_draws: draws under a condition that is unknown.
        dispatches: executed dispatches.
        nanoseconds: simulated time.
    """

    commands: int
    draws: int
    dropped_draws: int
    undecided_draws: int
    dispatches: int
    nanoseconds: int


_INLINE: Final = (
    Op.BIND_PROGRAM,
    Op.DISPATCH,
    Op.PUSH_LABEL,
    Op.POP_LABEL,
    Op.WRITE_BUFFER,
    Op.SET_STATES,
    Op.SIGNAL,
)
"""The commands that `NullBackend._run` executes itself, besides bindings: as the executors of
`_list_executors`, which a simulation calls, but without their calls."""


class NullBackend(CommandMethods):
    """A backend that keeps memory and counts draws, without a GPU."""

    METHOD = "    self._enqueue(({op}, {arguments}))"

    def __init__(self, capabilities: Capabilities | None = None) -> None:
        self.capabilities = capabilities or PROFILES["everything"]
        self._queue: list[Any] = []
        self._enqueue: Callable[[tuple[Any, ...]], None] = self._queue.extend
        self._queued_bytes = 0
        self._fence = 0
        self._executed = 0
        self._draws = dict.fromkeys(DrawOutcome, 0)
        self._dispatches = 0
        self._buffers = Buffers()
        self._textures = Textures()
        self._queries = Queries()
        self._state = ExecutionState()
        self._shaders = Shaders(self._buffers, self._textures, self._state)
        self._streams: set[Id] = set()
        self._indirect_draws: deque[ExecutedIndirectDraws] = deque(maxlen=MAX_INDIRECT_RECORDS)
        self._indirect_dispatches: deque[tuple[int, int, int]] = deque(maxlen=MAX_INDIRECT_RECORDS)
        self._execute = self._list_executors()

    def close(self) -> None:
        self._queue.clear()
        self._buffers.clear()
        self._textures.clear()

    # -- for tests ---------------------------------------------------------------------------------------

    def count_samples(self, samples: Callable[[Draw], int | None] | None) -> None:
        """Set the function that says how many samples a draw passes, from the next command on.

        `samples(draw)` is called in the order of execution, and returns None where the number is unknown.
        """
        self._run()
        self._queries.count_samples(samples)

    def answer_queries(self, answers: Answers) -> None:
        """Set the answers of occlusion and counter queries.

        They are a number for all queries, a script in the order in which queries end, a mapping by query id,
        a function of the id, or answers recorded on another backend (`AnswerLog`). They take precedence over
        `count_samples`, which is used where they are unknown.
        """
        self._queries.answer(answers)

    def run_shaders(self, stand_ins: Mapping[Id, StandIn] = MappingProxyType({})) -> None:
        """Execute each dispatch on NumPy, from the next command on.

        `stand_ins`, by a program's id, are called in place of their programs, for each dispatch and each draw
        (for each draw of an indirect command): see `shaders.StandIn`. Draws without a stand-in execute no
        shader.
        """
        self._run()
        self._shaders.run(stand_ins)

    @property
    def statistics(self) -> ExecutionStatistics:
        """Counts of the work that the device has executed so far; all commands sent are executed first."""
        self._run()
        executed, dropped, undecided = (self._draws[outcome] for outcome in DrawOutcome)
        time = self._executed * COMMAND_NANOSECONDS
        return ExecutionStatistics(self._executed, executed, dropped, undecided, self._dispatches, time)

    @property
    def indirect_draws(self) -> tuple[ExecutedIndirectDraws, ...]:
        """The last 1,024 `draw_indirect` commands with the arguments that they read, in order of
        execution."""
        self._run()
        return tuple(self._indirect_draws)

    @property
    def indirect_dispatches(self) -> tuple[tuple[int, int, int], ...]:
        """The work-groups of the last 1,024 `dispatch_indirect` commands, in order of execution."""
        self._run()
        return tuple(self._indirect_dispatches)

    # -- immediate calls -----------------------------------------------------------------------------------

    def create_buffer(self, buffer: Id, descriptor: descriptors.BufferDescriptor) -> None:
        self._buffers.create_buffer(buffer, descriptor)
        if descriptor.usage is descriptors.BufferUsage.STREAM:
            self._streams.add(buffer)

    def create_texture(self, texture: Id, descriptor: descriptors.TextureDescriptor) -> None:
        self._textures.create_texture(texture, descriptor)

    def create_sampler(self, sampler: Id, descriptor: descriptors.SamplerDescriptor) -> None:
        self._state.create(sampler, descriptor)

    def create_program(self, program: Id, descriptor: descriptors.ProgramDescriptor) -> None:
        self._state.create(program, descriptor)

    def create_vertex_array(self, vertex_array: Id, descriptor: descriptors.VertexArrayDescriptor) -> None:
        self._state.create(vertex_array, descriptor)

    def create_query(self, query: Id, kind: descriptors.QueryKind) -> None:
        self._queries.create_query(query, kind)

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> None:
        copied = bytes(data)
        if buffer in self._streams:
            self._buffers.write_buffer(buffer, offset, copied)
            return
        self._enqueue((Op.WRITE_BUFFER, buffer, offset, copied))
        self._queued_bytes += len(copied)
        if self._queued_bytes > QUEUED_BYTES:
            self._run()

    def write_texture(self, texture: Id, level: int, region: descriptors.Region, data: BytesLike) -> None:
        copied = bytes(data)
        self._enqueue((Op.WRITE_TEXTURE, texture, level, region, copied))
        self._queued_bytes += len(copied)
        if self._queued_bytes > QUEUED_BYTES:
            self._run()

    def resolve_command(
        self, op: Op, arguments: tuple[Any, ...]
    ) -> tuple[Callable[..., object], tuple[Any, ...]]:
        """Return a call that does what a command's method does with these arguments. Where the method only
        appends to the queue, it is the queue's own method: commands that are submitted again and again then
        run no Python code here."""
        name = op.method
        is_queued = name in NullBackend.GENERATED and getattr(type(self), name) is getattr(NullBackend, name)
        return (self._enqueue, ((op, *arguments),)) if is_queued else (getattr(self, name), arguments)

    # -- calls that execute the queue ----------------------------------------------------------------------

    def read_buffer(self, buffer: Id, offset: int, size: int) -> bytes:
        self._run()
        return self._buffers.read_buffer(buffer, offset, size)

    def read_texture(
        self, texture: Id, level: int, region: descriptors.Region, stencil: bool
    ) -> NDArray[np.generic]:
        self._run()
        return self._textures.read_texture(texture, level, region, stencil)

    def signal(self, value: int) -> None:
        self._enqueue((Op.SIGNAL, value))
        self._run()

    def completed(self) -> int:
        self._run()
        return self._fence

    def wait(self, value: int, seconds: float) -> bool:
        self._run()
        return self._fence >= value

    def read_query(self, query: Id) -> int | None:
        self._run()
        return self._queries.read(query)

    # -- execution ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        """Execute the queue. A command that raises is removed; the commands after it stay in the queue."""
        queue = self._queue
        if not queue:
            return
        entries = queue.copy()
        queue.clear()
        self._queued_bytes = 0
        execute, state, shaders = self._execute, self._state, self._shaders
        slots = state.slots
        bind_program, dispatch, push, pop, write, change, signal = map(int, _INLINE)
        memory = self._buffers.memory
        position, end = 0, len(entries)
        try:
            while position < end:
                op = entries[position]
                start, position = position + 1, position + WIDTHS[op] - 2  # entries have no call site here
                self._executed += 1
                kind = BOUND_KINDS[op]
                if kind is not None:  # bindings are most of the commands
                    slots[kind, entries[start]] = tuple(entries[start + 1 : position])
                    continue
                if op == bind_program:  # these are most of what is left: they run no Python function
                    state.program = entries[start]
                    continue
                if op == write:
                    buffer, offset, data = entries[start:position]
                    memory[buffer].data[offset : offset + len(data)] = data
                    continue
                if op == signal:
                    self._fence = entries[start]
                    continue
                if op == change:
                    state.states.update(entries[start])
                    continue
                if op == push:
                    state.labels = (*state.labels, entries[start])
                    continue
                if op == pop:
                    state.labels = state.labels[:-1]
                    continue
                if op == dispatch and not shaders.runs:
                    self._dispatches += 1
                    continue
                executor = execute[op]
                if executor is not None:
                    executor(*entries[start:position])
        finally:
            queue[:0] = entries[position:]

    def _list_executors(self) -> tuple[Callable[..., None] | None, ...]:
        """Return the function that executes each op, None where there is nothing to do."""
        executors: dict[Op, Callable[..., None]] = {
            Op.DESTROY: self._destroy,
            Op.BEGIN_PASS: self._begin_pass,
            Op.END_PASS: self._end_pass,
            Op.DRAW: self._draw,
            Op.DRAW_INDIRECT: self._draw_indirect,
            Op.DISPATCH: self._dispatch,
            Op.DISPATCH_INDIRECT: self._dispatch_indirect,
            Op.SIGNAL: self._signal,
            Op.WRITE_QUERY: self._write_query,
            Op.BEGIN_CONDITIONAL: self._begin_conditional,
            Op.COPY_TEXTURE_TO_BUFFER: self._copy_texture_to_buffer,
            Op.COPY_BUFFER_TO_TEXTURE: self._copy_buffer_to_texture,
        }
        parts: dict[object, tuple[Op, ...]] = {
            self._buffers: (Op.WRITE_BUFFER, Op.COPY_BUFFER, Op.CLEAR_BUFFER),
            self._textures: (
                Op.WRITE_TEXTURE,
                Op.COPY_TEXTURE,
                Op.RESOLVE_TEXTURE,
                Op.GENERATE_MIPMAPS,
            ),
            self._state: (
                Op.SET_STATES,
                Op.BIND_PROGRAM,
                Op.BIND_UNIFORM,
                Op.BIND_STORAGE,
                Op.BIND_TEXTURE,
                Op.BIND_IMAGE,
                Op.PUSH_LABEL,
                Op.POP_LABEL,
                Op.END_CONDITIONAL,
            ),
            self._queries: (Op.BEGIN_QUERY, Op.END_QUERY),
        }
        for part, ops in parts.items():
            executors.update({op: getattr(part, op.method) for op in ops})
        return tuple(executors.get(op) for op in Op)

    def _destroy(self, resource: Id) -> None:
        self._buffers.destroy(resource)
        self._textures.destroy(resource)
        self._state.destroy(resource)
        self._queries.destroy(resource)
        self._streams.discard(resource)

    def _copy_texture_to_buffer(
        self, source: Id, level: int, region: descriptors.Region, target: Id, offset: int, row_bytes: int
    ) -> None:
        rows = self._textures.copy_rows(source, level, region)
        self._buffers.rows(target, offset, row_bytes, *rows.shape)[:] = rows

    def _copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: descriptors.Region
    ) -> None:
        rows = self._textures.copy_rows(target, level, region)
        data = self._buffers.rows(source, offset, row_bytes, *rows.shape)
        self._textures.write_texture(target, level, region, data.tobytes())

    def _begin_pass(self, descriptor: descriptors.PassDescriptor) -> None:
        self._state.render_pass = descriptor
        self._textures.begin_pass(descriptor)

    def _end_pass(self) -> None:
        descriptor = self._state.render_pass
        if descriptor is not None and descriptor.colors:
            self._textures.end_pass(descriptor)
        self._state.render_pass = None

    def _signal(self, value: int) -> None:
        self._fence = value

    def _write_query(self, query: Id) -> None:
        self._queries.write_query(query, self._executed * COMMAND_NANOSECONDS)

    def _begin_conditional(self, query: Id, inverted: bool) -> None:
        self._state.decide(self._queries.samples(query), inverted)

    def _draw(
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        if self._follows_draws:
            self._follow_draw(vertex_array, primitive, first, count, instances, base_vertex, base_instance)
        else:
            self._count_unfollowed(1, count > 0 and instances > 0)

    def _draw_indirect(
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        buffer: Id,
        offset: int,
        draws: int,
        stride: int,
        count_buffer: Id,
        count_offset: int,
    ) -> None:
        vertices: Any = self._state.resources[vertex_array]
        indexed = vertices.index_buffer != 0
        resolved = read_indirect_draws(
            self._buffers, buffer, offset, draws, stride, count_buffer, count_offset, indexed
        )
        # Both parts of the condition are asked for at once, without a call, since they are seldom true.
        may_follow = self._queries._samples is not None or self._state.program in self._shaders.stand_ins
        if may_follow and self._follows_draws:
            for count, instances, first, base_vertex, base_instance in resolved.tolist():
                self._follow_draw(
                    vertex_array, primitive, first, count, instances, base_vertex, base_instance
                )
        else:
            outcome = self._state.outcome  # as `_count_unfollowed`, without its call
            self._draws[outcome] += len(resolved)
            if outcome is not DrawOutcome.DROPPED and has_vertices(resolved):
                self._queries.add_unknown()
        executed = resolved[:0] if self._state.outcome is DrawOutcome.DROPPED else resolved
        self._indirect_draws.append(ExecutedIndirectDraws(vertex_array, primitive, executed))

    @property
    def _follows_draws(self) -> bool:
        """True if each draw must be processed individually: its samples are counted, or its program has a
        stand-in."""
        state = self._state
        return state.outcome is DrawOutcome.EXECUTED and (
            self._queries.counts or state.program in self._shaders.stand_ins
        )

    def _follow_draw(
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> None:
        """Process an executed draw whose samples are counted, or whose program has a stand-in."""
        self._draws[DrawOutcome.EXECUTED] += 1
        if count and instances:
            state = self._state
            draw = Draw(
                state.program,
                vertex_array,
                primitive,
                first,
                count,
                instances,
                base_vertex,
                base_instance,
                state.labels,
            )
            self._queries.add_draw(draw)
            if state.program in self._shaders.stand_ins:
                self._shaders.draw(draw)

    def _count_unfollowed(self, draws: int, draws_vertices: bool) -> None:
        """Count draws whose samples aren't counted. `draws_vertices` says whether any of them has
        vertices."""
        outcome = self._state.outcome
        self._draws[outcome] += draws
        if draws_vertices and outcome is not DrawOutcome.DROPPED:
            self._queries.add_unknown()

    def _dispatch(self, x: int, y: int, z: int) -> None:
        self._dispatches += 1
        self._shaders.dispatch((x, y, z))

    def _dispatch_indirect(self, buffer: Id, offset: int) -> None:
        x, y, z = self._buffers.words(buffer, offset, 3).tolist()
        self._indirect_dispatches.append((x, y, z))
        self._dispatch(x, y, z)
