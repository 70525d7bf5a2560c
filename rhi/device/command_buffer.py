"""Command buffers: commands that are recorded once and executed later, any number of times (thesis 3.7.2).

- A `CommandBuffer` is an encoder with a core of its own: it has its own states, bindings and open pass, so
  several can be recorded at a time, each on one thread. Its backend is a `CommandWriter`; nothing reaches the
  device.
- It starts from default states and ends balanced: no scope, pass, label or query is left open
  (`record-open`). So state scopes have no effect across its border, in either direction.
- Nothing depends on states before its first draw. There the hardware is brought from whatever it has to that
  draw's states, in place of the recorded change from the defaults, and at the end the device's cache adopts
  the states it ends with. So a buffer that ends with the states of its first draw changes none when it is
  submitted again.
- Commands refer to buffers and textures, whose contents are read at execution. Only data that is passed to
  the encoder itself (transient constants, vertices, arrays of draws) is copied, into an `Arena` that lives as
  long as the command buffer.
- During recording, `rhi.device.recording` takes the place of the device.
- It is notified of each of its resources that is destroyed (`Timeline.watch`). Then a submission is refused,
  with the lines that used and destroyed the resource.
- At the first execution, its commands become a list of calls with their arguments, with draws and bindings as
  the backend prepares them. Later executions only iterate over that list, or execute parts of it together
  (`SupportsRecordedDraws`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, islice
from operator import length_hint
from threading import get_ident
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from rhi.commands.ops import END_OPS, METHODS, WIDTHS, Op
from rhi.commands.recorder import CommandWriter, Recorder, RepeatableCommand
from rhi.commands.stream import CommandStream, call_site_at
from rhi.contract.descriptors import BufferDescriptor, Id, Region
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.states import AlphaTest, default_values
from rhi.device.core.arena import Arena
from rhi.device.core.core import Core
from rhi.device.core.state_cache import StateVector
from rhi.device.encoder import Encoder, check_mesh
from rhi.device.queries.occlusion import Conditional, OcclusionQuery, QueryScope
from rhi.device.queries.sets import QuerySet
from rhi.device.queries.timers import Timers
from rhi.device.recording import RecordedProgram, RecordingCore
from rhi.device.resources.buffers import Buffer, StorageBuffer, check_buffer
from rhi.device.resources.meshes import Drawable
from rhi.device.resources.programs import Program
from rhi.device.resources.textures import Texture
from rhi.device.transient import TransientMemory
from rhi.errors import RhiError, rules
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.call_sites import find_user_frame

_EMPTY = "not recorded"
_RECORDING = "being recorded"
_READY = "recorded"
_INVALID = "invalid after an error"
_DEFAULTS: Final = StateVector(default_values())
_DRAW_OPS: Final = frozenset({Op.DRAW, Op.DRAW_INDIRECT})


class CommandBuffer(Encoder):
    """Recorded commands; created by `device.record()`, recorded in its `with` block, executed by
    `device.submit`.

    It has the commands of a device, except those that wait or synchronise (reads, locks, signals, `present`).
    Its memory is released with the last reference to it.
    """

    NAME = "commands"

    def __init__(self, device: Core, label: str) -> None:
        self._writer = CommandWriter(device.capabilities)
        self._arena = Arena(device.new_id())
        core = self._recorder = RecordingCore(device, self._writer)
        super().__init__(core, Timers(core, False), TransientMemory(core, arena=self._arena))
        self.label = label
        self._state = _EMPTY
        self._programs: dict[Program[...], RecordedProgram] = {}
        self._calls: list[RepeatableCommand] | None = None
        self._together: Sequence[tuple[int, int, Callable[[], bool]]] = ()
        self._first_change: int | None = (
            None  # index of the first command that sets states, if no draw comes before it
        )
        self._draws_with_defaults = False  # whether the first draw comes before any change of states
        self._destroyed_uses: dict[Id, str] = {}
        self._draws = 0
        self._dispatches = 0
        self._queries = 0
        self._later_changes = 0
        self._owned: list[Id] = []
        device.timeline.hold(self, self._owned)
        device.timeline.watch(self)

    @property
    def stream(self) -> CommandStream:
        """The recorded commands; `rhi.testing` accepts them like those of a device."""
        return self._writer.stream

    @property
    def is_stale(self) -> bool:
        """True if a resource it uses was destroyed, or a program was exchanged by a `Reloader`; `submit` then
        refuses it."""
        return bool(self._destroyed_uses)

    def __len__(self) -> int:
        return len(self.stream)

    def __repr__(self) -> str:
        return f"CommandBuffer({self.label!r}, {len(self)} commands, {self._state})"

    # -- recording ---------------------------------------------------------------------------------------

    def __enter__(self) -> Self:
        if self._state is not _EMPTY:
            self._recorder.refuse(
                rules.RECORD_STATE,
                "device.record",
                f"a command buffer that is {self._state}",
                "a new command buffer",
            )
        self._state = _RECORDING
        self._recorder.thread = get_ident()
        self._recorder.recording = True
        if self.label:
            self._writer.push_label(self.label)
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._recorder
        if self._state is not _RECORDING:
            core.scopes.refuse_unopened("device.record()", error)
            return
        core.check_thread("the end of device.record()")
        core.recording = False
        self._state = _INVALID
        left = [scope.describe() for scope in core.scopes]
        core.scopes.close()
        self._programs.clear()  # with the draws that they have prepared
        if kind is not None:
            return
        if left:
            core.refuse(
                rules.RECORD_OPEN, "the end of device.record()", f"open: {', '.join(left)}", "no open scope"
            )
        if self.label:
            self._writer.pop_label()
        statistics = core.statistics()
        self._draws, self._dispatches = statistics.draws, statistics.dispatches
        self._queries = statistics.queries
        self._note_first_states()
        self._state = _READY

    def _note_first_states(self) -> None:
        """Note where the states of the first draw come from: a change before it, or the defaults."""
        stream = self.stream
        for index in range(len(stream)):
            op = stream.entry(index)[0]
            if op in _DRAW_OPS:
                self._draws_with_defaults = True
                return
            if op is Op.SET_STATES:
                self._first_change = index
                return

    def _draw(self, program: Program[...], mesh: Drawable, instances: int = 1, /, **bindings: Any) -> None:
        """Draw `mesh` with `program`; see `Encoder.draw`."""
        if self._state is not _RECORDING:
            self._recorder.check_open()
        try:
            resolved: Program[...] = self._programs[program]
        except (KeyError, TypeError, ValueError):  # a memoryview's hash may raise the last one
            resolved = self._resolve_program(program, "commands.draw")
        check_mesh(self._recorder, mesh, "commands.draw", Drawable)
        resolved.draw_with(mesh, instances, bindings)

    if not TYPE_CHECKING:
        draw = _draw  # typed by `Encoder.draw`; its *args, always empty, would cost 80 ns a call

    def query(self, query: OcclusionQuery) -> RecordedQuery:
        """Record a query: `with commands.query(query):` counts the visible samples of the draws inside.

        Each submission counts anew; the query has the result of the latest submission.
        """
        return RecordedQuery(self._recorder, query)

    def _check_query_set(self, queries: QuerySet, call: str) -> None:
        super()._check_query_set(queries, call)
        if queries.id in self._recorder.queries:
            self._recorder.refuse(
                rules.QUERY_STATE, call, "the same query set twice in a command buffer", "each set once"
            )

    def _mark_queries_drawn(self, queries: QuerySet, query_indices: NDArray[np.int64]) -> None:
        self._recorder.queries[queries.id] = partial(queries.mark_indices_submitted, query_indices)
        self._recorder.counted_queries[queries.id] = query_indices

    def _get_counted_queries(self, queries: QuerySet, call: str) -> NDArray[np.int64]:
        counted = self._recorder.counted_queries.get(queries.id)
        if counted is None:
            given = "a query set that this command buffer hasn't used in draw_counted"
            self._recorder.refuse(rules.QUERY_STATE, call, given, "one that it has used before")
        return counted

    def conditional(self, query: OcclusionQuery, *, inverted: bool = False) -> Conditional:
        """Create a condition: `with commands.conditional(query):` skips draws on the GPU if the query counted
        nothing.

        The query must have ended before, earlier in this buffer or before the submission (`query-state`).
        """
        return _RecordedConditional(self._recorder, query, inverted)

    def clear(self, buffer: Buffer | StorageBuffer[Any], value: int = 0) -> None:
        """Record a `Buffer.clear`."""
        check = ArgumentChecker("commands.clear", self._recorder.refuse)
        check_buffer(check, "buffer", buffer)._clear(self._recorder, value)

    def copy_buffer(
        self,
        source: Buffer | StorageBuffer[Any],
        target: Buffer | StorageBuffer[Any],
        *,
        size: int | None = None,
        offset: int = 0,
        target_offset: int = 0,
    ) -> None:
        """Record a `Buffer.copy_to`."""
        check = ArgumentChecker("commands.copy_buffer", self._recorder.refuse)
        check_buffer(check, "source", source)._copy(self._recorder, target, size, offset, target_offset)

    def copy_texture(
        self,
        source: Texture,
        target: Texture,
        *,
        level: int = 0,
        region: Region | None = None,
        target_level: int = 0,
        x: int = 0,
        y: int = 0,
        layer: int = 0,
    ) -> None:
        """Record a `Texture.copy_to`."""
        self._check_texture("commands.copy_texture", "source", source)
        source._copy(self._recorder, target, level, region, target_level, x, y, layer)

    def copy_texture_to_buffer(
        self,
        source: Texture,
        target: Buffer | StorageBuffer[Any],
        *,
        level: int = 0,
        region: Region | None = None,
        offset: int = 0,
        row_bytes: int | None = None,
    ) -> None:
        """Record a `Texture.copy_to_buffer`."""
        self._check_texture("commands.copy_texture_to_buffer", "source", source)
        source._copy_to_buffer(self._recorder, target, level, region, offset, row_bytes)

    def copy_buffer_to_texture(
        self,
        source: Buffer | StorageBuffer[Any],
        target: Texture,
        *,
        offset: int = 0,
        row_bytes: int | None = None,
        level: int = 0,
        region: Region | None = None,
    ) -> None:
        """Record a `Texture.copy_from_buffer`."""
        self._check_texture("commands.copy_buffer_to_texture", "target", target)
        target._copy_from_buffer(self._recorder, source, level, region, offset, row_bytes)

    def resolve(self, source: Texture, target: Texture) -> None:
        """Record a `Texture.resolve_to`."""
        self._check_texture("commands.resolve", "source", source)
        source._resolve(self._recorder, target)

    def generate_mipmaps(self, texture: Texture) -> None:
        """Record a `Texture.generate_mipmaps`."""
        self._check_texture("commands.generate_mipmaps", "texture", texture)
        texture._generate_mipmaps(self._recorder)

    def _check_texture(self, call: str, name: str, texture: Texture) -> None:
        ArgumentChecker(call, self._recorder.refuse).instance(name, texture, Texture, "a Texture")

    def _resolve_program(self, program: object, call: str) -> Program[...]:
        core = self._recorder
        core.check_open()
        if not isinstance(program, Program):
            core.refuse(rules.DEVICE_ARGUMENT, call, repr(program), "a Program from device.program(…)")
        if program.core is not core.device:
            core.refuse(rules.RESOURCE_FOREIGN, call, repr(program))
        resolved = self._programs.get(program)
        if resolved is None:
            resolved = self._programs[program] = RecordedProgram(core, self._transient.uniforms, program)
        return resolved

    # -- execution ---------------------------------------------------------------------------------------

    def note_retired(self, resource: Id) -> None:
        """Note the line that destroyed a resource of this buffer; called by `Timeline`."""
        if resource in self._recorder.uses and resource not in self._destroyed_uses:
            frame = find_user_frame()
            self._destroyed_uses[resource] = (
                str(call_site_at(frame.f_code, frame.f_lasti)) if frame is not None else ""
            )

    def execute(self) -> None:
        """Execute the recorded commands; called by `Device.submit`, which has checked them."""
        core, device = self._recorder, self._recorder.device
        if self._calls is None:
            self._create_resources()
            self._calls = self._prepare_calls()
            device.counters.recorded_commands += len(self)
        device.program = None
        if self._draws_with_defaults:
            device.send_states(_DEFAULTS)
        calls = iter(self._calls)
        try:
            if isinstance(backend := device.backend, Recorder):
                backend.repeat(calls)
            else:
                self._execute_calls(calls)
            if self._first_change is not None or self._draws_with_defaults:
                device.adopt_states(core.states.hardware.values)
        except BaseException as error:
            self._clean_up(len(self._calls) - length_hint(calls) - 1, not isinstance(error, RhiError))
            raise
        device.states.hardware_changes += self._later_changes
        device.states.software_changes += core.states.software_changes
        device.draws += self._draws
        device.dispatches += self._dispatches
        device.counters.queries += self._queries
        if core.queries:
            fence = device.signal()
            for mark_submitted in core.queries.values():
                mark_submitted(fence)

    def _execute_calls(self, calls: Iterator[RepeatableCommand]) -> None:
        """Execute the calls, and those together that the backend can."""
        position = 0
        for start, end, execute in self._together:
            _call_all(islice(calls, start - position))
            first = next(calls)  # its failure is that of the part's first command
            rest = islice(calls, end - start - 1)
            if execute():
                deque(rest, maxlen=0)
            else:
                _call_all(chain((first,), rest))
            position = end
        _call_all(calls)

    def _create_resources(self) -> None:
        """Create the arena's buffer and the vertex arrays, for which recording had no backend.

        If a creation fails, the next submission tries it again.
        """
        core = self._recorder
        device = self._recorder.device
        arena = self._arena
        if arena.data:
            if arena.buffer not in self._owned:
                descriptor = BufferDescriptor(len(arena.data), label="command buffer")
                with DeferredInterrupts():
                    device.create(device.backend.create_buffer, arena.buffer, descriptor, descriptor.size)
                    self._owned.append(arena.buffer)
            device.backend.write_buffer(arena.buffer, 0, bytes(arena.data))
            device.upload_bytes += len(arena.data)
        for vertex_array, vertices in core.own_arrays.items():
            if vertex_array not in self._owned:
                with DeferredInterrupts():
                    device.create(device.backend.create_vertex_array, vertex_array, vertices)
                    self._owned.append(vertex_array)
        for key in list(core.vertex_arrays):
            (program, data), (vertex_array, vertices) = key, core.vertex_arrays[key]
            with DeferredInterrupts():
                device.create(device.backend.create_vertex_array, vertex_array, vertices)
                data.cache_vertex_array(program, program.id, vertex_array)
                del core.vertex_arrays[key]

    def _prepare_calls(self) -> list[RepeatableCommand]:
        """Return the commands as calls with their arguments. The first change of states starts from the
        hardware's states at execution and leads to the recorded ones."""
        device, stream = self._recorder.device, self.stream
        calls = self._prepare_commands()
        self._together = self._prepare_draws()
        self._later_changes = self._recorder.states.hardware_changes
        first = self._first_change
        if first is not None:
            (changes,) = stream[first].values
            self._later_changes -= len(changes)
            vector = StateVector(tuple(stream.context(first + 1).states.values()))
            calls[first] = None, device.send_states, (vector,)
        return calls

    def _prepare_draws(self) -> Sequence[tuple[int, int, Callable[[], bool]]]:
        """Return the parts of the commands that the backend executes together. It doesn't know the first change of
        states, which differs from submission to submission."""
        device, stream = self._recorder.device, self.stream
        if isinstance(device.backend, Recorder):
            return ()
        entries = map(stream.entry, range(len(stream)))
        commands = [(METHODS[op], tuple(values)) for op, values, *_ in entries]
        if self._first_change is not None:
            commands[self._first_change] = "", ()
        return device.prepare_recorded_draws(commands)

    def _prepare_commands(self) -> list[RepeatableCommand]:
        """Return the commands as calls of the backend."""
        device, data = self._recorder.device, self.stream.data
        backend = device.backend
        if isinstance(backend, Recorder):
            stream = self.stream
            return [backend.prepare(*stream.entry(index)) for index in range(len(stream))]
        calls: list[RepeatableCommand] = []
        tests_alpha, program = False, 0
        methods: list[Callable[..., object]] = [getattr(backend, op.method) for op in Op]
        draws: dict[tuple[Any, ...], Callable[[int], object]] = {}
        uniforms: dict[Id, Callable[[int, int, int], object]] = {}
        position, end = 0, len(data)
        while position < end:
            op = data[position]
            first, position = position + 1, position + WIDTHS[op]
            if op == Op.DRAW and not tests_alpha:
                vertex_array, primitive, start, count, instances, base_vertex, base_instance = data[
                    first : position - 2
                ]
                key = (program, vertex_array, primitive, start, count, base_vertex, base_instance)
                draw = draws.get(key)
                if draw is None:
                    draw = draws[key] = device.prepare_draw(*key)
                calls.append((None, draw, (instances,)))
            elif op == Op.BIND_UNIFORM:
                slot, buffer, offset, size = data[first : position - 2]
                bind = uniforms.get(buffer)
                if bind is None:
                    bind = uniforms[buffer] = device.prepare_uniform(buffer)
                calls.append((None, bind, (slot, offset, size)))
            else:
                arguments = tuple(data[first : position - 2])
                calls.append((None, methods[op], arguments))
                if op == Op.BIND_PROGRAM:
                    program = arguments[0]
                elif op == Op.SET_STATES:
                    for state_type, value in arguments[0]:
                        if state_type is AlphaTest:
                            tests_alpha = value is AlphaTest.ON
        return calls

    def _clean_up(self, done: int, interrupted: bool) -> None:
        """Close the scopes that the first `done` commands opened, after the next command has failed. If that
        command was interrupted, it may have been executed."""
        device, stream = self._recorder.device, self.stream
        if interrupted and done < len(stream) and stream[done].op in END_OPS:
            done += 1
        opened: list[tuple[Op, tuple[Any, ...]]] = []
        for command in stream[:done]:
            if command.op in END_OPS:
                opened.append((END_OPS[command.op], command.values))
            elif opened and command.op is opened[-1][0]:
                opened.pop()
        for op, values in reversed(opened):
            with suppress(RhiError):  # fails again on a lost device
                getattr(device.backend, op.method)(*(values if op is Op.END_QUERY else ()))
        sets_states = self._first_change is not None and done > self._first_change
        if sets_states or self._draws_with_defaults:
            device.adopt_states(tuple(stream.context(done).states.values()))
        if interrupted:
            device.states.lose_hardware()


def _call_all(calls: Iterable[RepeatableCommand]) -> None:
    for _, call, arguments in calls:
        call(*arguments)


class RecordedQuery(QueryScope):
    """A `with commands.query(query):` block."""

    __slots__ = ("_core", "_query")
    _core: RecordingCore

    def __init__(self, core: RecordingCore, query: OcclusionQuery) -> None:
        call = "commands.query"
        core.check_open()
        allowed = "an OcclusionQuery from device.occlusion_query()"
        ArgumentChecker(call, core.refuse).instance("query", query, OcclusionQuery, allowed)
        query.check_usable(core.device, call)
        self._core = core
        self._query = query

    def __enter__(self) -> None:
        core, query, call = self._core, self._query, "commands.query"
        core.check_open()
        if core.open_query is not None:
            core.refuse(rules.QUERY_NESTED, call, "a second open query")
        if core.render_pass is None:
            core.refuse(rules.DRAW_OUTSIDE_PASS, call, "no open pass")
        if query.id in core.queries:
            core.refuse(
                rules.QUERY_STATE, call, "the same query twice in a command buffer", "each query once"
            )
        for resource in query.ids:
            core.note_use(resource, query)
        core.scopes.push(self)
        query.write_begin(core)
        core.open_query = self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self._core.scopes.leave(self, error)

    def complete(self) -> None:
        """End the query."""
        core = self._core
        self._query.write_end(core)
        core.counters.queries += 1
        core.queries[self._query.id] = self._query.mark_submitted

    def abandon(self) -> None:
        """End the query, as its pass ends."""
        self._query.write_end(self._core)


class _RecordedConditional(Conditional):
    """A condition on the result that a query has at execution."""

    __slots__ = ()
    _core: RecordingCore

    def _check(self) -> None:
        self._query.check_usable(self._core.device, "commands.conditional")
        for resource in self._query.ids:
            self._core.note_use(resource, self._query)
        if self._query.id not in self._core.queries:
            self._core.conditions.append(self._query)


def check_submissions(buffers: Iterable[CommandBuffer], device: Core) -> None:
    """Refuse command buffers that can't be executed one after the other; see `Device.submit`."""
    call = "device.submit"
    ended: set[Id] = set()
    for buffer in buffers:
        if not isinstance(buffer, CommandBuffer):
            device.refuse(rules.DEVICE_ARGUMENT, call, repr(buffer), "command buffers from device.record()")
        core = buffer._recorder
        if core.device is not device:
            device.refuse(rules.RESOURCE_FOREIGN, call, repr(buffer))
        if buffer._state is not _READY:
            core.refuse(
                rules.RECORD_STATE,
                call,
                f"a command buffer that is {buffer._state}",
                "one whose `with` block has ended without an error",
            )
        for resource, site in buffer._destroyed_uses.items():
            use = core.uses[resource]
            recorded = call_site_at(use.code, use.offset)
            given = f"{use.name}, destroyed at {site}, used by a command recorded at {recorded}"
            core.refuse(rules.RESOURCE_DESTROYED, call, given, "", "record the commands anew")
        for use in core.uses.values() if device.locked else ():
            if device.is_locked(use.owner):
                core.refuse(rules.LOCK_OPEN, call, f"{use.name}, which has an open lock")
        if device.condition_open and core.condition_count:
            given = f"{buffer!r}, which contains a condition, inside device.conditional"
            core.refuse(rules.CONDITION_NESTED, call, given)
        for query in core.conditions:
            if query.id not in ended:
                query.check_ended(device, call)
        ended.update(core.queries)
