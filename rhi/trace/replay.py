"""`replay`: execute the commands of a trace on any device.

- Resource ids and fence values are translated to those of the device. So the device may have been used
  before, and can be used afterwards: its states are restored, passes and labels that the trace left open are
  ended.
- Ring memory (`BufferUsage.STREAM`) becomes plain memory, whose writes are in order. A ring relies on the
  fences of the device on which it was recorded.
- The shaders of a file run only if the file is trusted. The arguments of its indirect draws and dispatches
  are read back and checked before each of them: a device would execute whatever they say.
- A call that failed when it was recorded is executed, too; if it fails again, that is noted and not raised. A
  refused call never became a command, so it is only reported.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.commands.context import StreamContext
from rhi.commands.ops import CREATIONS, END_OPS, ID_ARGUMENTS, WIDTHS, Op
from rhi.commands.stream import CommandStream, Failure, Refusal
from rhi.contract import descriptors
from rhi.contract.descriptors import Id
from rhi.contract.limits import Faults, dispatch_faults, draw_faults
from rhi.contract.queries import list_draws
from rhi.contract.states import STATE_TYPES, StateChange, default_values
from rhi.device.device import Device
from rhi.errors import RhiError, refuse
from rhi.errors.rules import PASS_OPEN
from rhi.trace.file import Trace, as_trace
from rhi.trace.ids import map_ids
from rhi.trace.rules import TRACE_REFERENCE, TRACE_TRUST
from rhi.trace.validation import check_capabilities, count_vertex_array_elements, excessive_work_faults

_FOLLOWED: Final = frozenset({Op.SET_STATES, Op.BIND_PROGRAM, *END_OPS, *END_OPS.values()})
_NOT_REPEATED: Final = _FOLLOWED - {Op.BIND_PROGRAM} | {Op.DESTROY, Op.SIGNAL, Op.WAIT, Op.PRESENT}
"""The commands that aren't executed again if they failed."""


@dataclass
class Replay:
    """The result of a replay.

    Attributes:
        image: the image that was presented last, (height, width, channels) of the format's dtype, top row
            first; None if there was none.
        ids: the device's ids of the resources that the trace leaves alive, by their ids in the trace. They
            live until the device is closed.
        failures: for each call that failed when it was recorded, by its index, how it failed now; None if it
            succeeded.
        commands: number of commands that were executed.
        refusals: the calls that were refused while the trace was recorded.
    """

    image: NDArray[np.generic] | None = None
    ids: dict[Id, Id] = field(default_factory=dict)
    failures: dict[int, Failure | None] = field(default_factory=dict)
    commands: int = 0
    refusals: tuple[Refusal, ...] = ()


def replay(source: Trace | Device | CommandStream, *, on: Device) -> Replay:
    """Execute the commands of a trace on the device `on`.

    Raises:
        ValidationError: `trace-capability` if the device lacks a capability that the trace needs,
            `trace-incomplete` for a stream without its beginning, `pass-open` inside a render pass,
            `trace-trust` for a file with shaders that isn't trusted, on a device that runs shaders. No
            command was executed then.
        ValidationError: `trace-reference` for indirect arguments of a file that reach beyond what exists.
        RhiError: the error of a command that succeeded when it was recorded. A note names the command.

    Examples:
        >>> with rhi.create_device("null") as recorded:
        ...     target = recorded.texture((4, 4), rhi.Format.RGBA8)
        ...     with recorded.render_pass(target, clear=(1, 0, 0, 1)):
        ...         pass
        ...     recorded.present(target)
        ...     save(recorded, "red.zip")
        >>> with rhi.create_device("null") as other:
        ...     replay(load("red.zip"), on=other).image[0, 0].tolist()
        [255, 0, 0, 255]
    """
    trace = as_trace(source)
    core = on._core
    core.check_ready()
    if core.render_pass is not None:
        refuse(PASS_OPEN, "rhi.trace.replay", "a device with an open render pass")
    stream = trace.stream
    check_capabilities(stream, on.capabilities)
    runs_shaders = on.capabilities.shading
    if runs_shaders and not trace.trusted and stream.filter(Op.CREATE_PROGRAM):
        refuse(
            TRACE_TRUST,
            f"rhi.trace.replay on {on.backend_name}",
            f"{trace.file!r}, loaded without trusted=True",
        )
    player = Player(stream, on, checks_indirect=runs_shaders and bool(trace.file))
    try:
        player.play()
    finally:
        player.restore()
    return player.result


class Player:
    """The state of one replay."""

    def __init__(
        self,
        stream: CommandStream,
        device: Device,
        checks_indirect: bool,
        after_command: Callable[[int, StreamContext], None] | None = None,
    ) -> None:
        self.stream = stream
        self.after_command = after_command
        self.checks_indirect = checks_indirect
        self.core = device._core
        self.result = Replay(refusals=stream.refusals)
        self.context = StreamContext()
        self.fences: dict[int, int] = {0: 0}
        self.before = self.core.states.hardware.values
        presents = stream.filter(Op.PRESENT, where=lambda command: bool(command["texture"]))
        self.presents_left = len(presents)
        self.methods: list[Callable[..., Any]] = [getattr(self.core.backend, op.method) for op in Op]

    def play(self) -> None:
        """Execute all commands."""
        core = self.core
        ids = self.result.ids
        stream = self.stream
        methods = self.methods
        core.program = None
        self.set_states(self.before, default_values())
        own = {
            Op.DESTROY: self.destroy,
            Op.SIGNAL: self.signal,
            Op.WAIT: self.wait,
            Op.PRESENT: self.present,
            Op.DRAW_INDIRECT: self.draw_indirect,
            Op.DISPATCH_INDIRECT: self.dispatch_indirect,
        }
        handlers: list[Callable[[Op, list[Any]], None] | None] = [
            self.create if op in CREATIONS else self.apply if op in _FOLLOWED else own.get(op) for op in Op
        ]
        failures, data, ops = stream.failures, stream.data, tuple(Op)
        after_command = self.after_command
        plain = [
            (method, handler, WIDTHS[op] - 2, *(ID_ARGUMENTS[op] + (-1, -1))[:2])
            for op, method, handler in zip(Op, methods, handlers, strict=True)
        ]  # DRAW_INDIRECT alone has more than two ids
        offset, end, index = 0, len(data), 0
        try:
            while offset < end:
                op = data[offset]
                method, handler, width, first, second = plain[op]
                values = data[offset + 1 : offset + width]
                if failures and index in failures:
                    self.repeat_failure(index, ops[op], values)
                elif handler is not None:
                    handler(ops[op], values)
                else:
                    if first >= 0:
                        values[first] = ids[values[first]]
                    if second >= 0 and values[second]:  # 0 is none
                        values[second] = ids[values[second]]
                    method(*values)
                if after_command is not None:
                    after_command(index, self.context)
                offset += width + 2
                index += 1
        except Exception as error:
            error.add_note(f"while replaying command {index}: {stream[index]}")
            raise
        self.result.commands = index

    def restore(self) -> None:
        """End passes and labels that the trace left open, and restore the device's states."""
        backend, context = self.core.backend, self.context
        self.core.program = None
        if context.condition:
            backend.end_conditional()
        if context.open_query in self.result.ids:
            backend.end_query(self.result.ids[context.open_query])
        if context.render_pass is not None:
            backend.end_pass()
        for _ in context.labels:
            backend.pop_label()
        self.set_states(tuple(context.states.values()), self.before)

    def set_states(self, current: Sequence[object], target: Sequence[object]) -> None:
        """Send the states that differ between two lists of values in the order of `STATE_TYPES`."""
        changes = [
            StateChange(state_type, new)
            for state_type, old, new in zip(STATE_TYPES, current, target, strict=True)
            if old != new
        ]
        if changes:
            self.core.backend.set_states(changes)

    # -- commands that are changed before execution --------------------------------------------------------

    def create(self, op: Op, values: list[Any]) -> None:
        recorded, descriptor = values
        new = self.core.new_id()
        if isinstance(descriptor, descriptors.BufferDescriptor):
            descriptor = dataclasses.replace(descriptor, usage=descriptors.BufferUsage.STATIC)
        self.methods[op](new, map_ids(descriptor, self.result.ids.__getitem__))
        self.result.ids[recorded] = new
        self.context.apply(op, values)

    def destroy(self, op: Op, values: list[Any]) -> None:
        self.core.backend.destroy(self.result.ids.pop(values[0]))
        self.context.apply(op, values)

    def apply(self, op: Op, values: list[Any]) -> None:
        """Follow states, and what begins and ends."""
        self.call(op, values)
        self.context.apply(op, values)

    def call(self, op: Op, values: list[Any]) -> None:
        """Execute a command with all of its ids translated."""
        ids, id_indices = self.result.ids, ID_ARGUMENTS[op]
        translated = (
            (value and ids[value]) if i in id_indices else map_ids(value, ids.__getitem__)
            for i, value in enumerate(values)
        )
        self.methods[op](*translated)

    def draw_indirect(self, op: Op, values: list[Any]) -> None:
        """Draw, after a look at the arguments."""
        vertex_array, _, buffer, offset, draws, stride, count_buffer, count_offset = values
        descriptor = self.context.resources[vertex_array]
        if self.checks_indirect and isinstance(descriptor, descriptors.VertexArrayDescriptor):
            if count_buffer:
                count = self.core.backend.read_buffer(self.result.ids[count_buffer], count_offset, 4)
                draws = min(draws, int(np.frombuffer(count, np.uint32)[0]))
            record = descriptors.DRAW if descriptor.index_buffer else descriptors.DRAW_UNINDEXED
            data = self.read(buffer, offset, (draws - 1) * stride + record.itemsize) if draws else b""
            elements = count_vertex_array_elements(self.context.resources, descriptor)
            for draw in list_draws(np.ndarray((draws,), record, data, strides=(stride,))):
                self.require(draw_faults(elements, bool(descriptor.index_buffer), *draw))
                self.require(excessive_work_faults(draw[1] * draw[2]))
        self.call(op, values)

    def dispatch_indirect(self, op: Op, values: list[Any]) -> None:
        """Dispatch, after a look at the number of groups."""
        program = self.context.resources[self.context.program]
        if self.checks_indirect and isinstance(program, descriptors.ProgramDescriptor):
            groups: list[int] = np.frombuffer(self.read(values[0], values[1], 12), np.uint32).tolist()
            self.require(dispatch_faults(groups, f"{groups}", self.core.capabilities))
            self.require(excessive_work_faults(math.prod(groups) * math.prod(program.work_group)))
        self.call(op, values)

    def read(self, buffer: Id, offset: int, size: int) -> bytes:
        """Return bytes of a buffer of the trace."""
        return self.core.backend.read_buffer(self.result.ids[buffer], offset, size)

    def require(self, faults: Faults) -> None:
        """Refuse the trace for the first fault of the arguments in a buffer."""
        for fault in faults:
            call = f"rhi.trace.replay on {self.core.capabilities.backend}"
            refuse(TRACE_REFERENCE, call, f"indirect arguments: {fault.given}", fault.allowed)

    def signal(self, op: Op, values: list[Any]) -> None:
        self.fences[values[0]] = self.core.timeline.signal()

    def wait(self, op: Op, values: list[Any]) -> None:
        self.core.timeline.wait(self.fences[values[0]], values[1])

    def present(self, op: Op, values: list[Any]) -> None:
        texture = self.result.ids[values[0]] if values[0] else 0
        self.core.backend.present(texture)
        self.presents_left -= bool(texture)
        if texture and not self.presents_left:  # read it now, since later commands may draw to it
            descriptor = self.context.resources[values[0]]
            assert isinstance(descriptor, descriptors.TextureDescriptor)
            if descriptor.samples == 1:
                whole = descriptors.Region(0, 0, *descriptor.size)
                self.result.image = self.core.backend.read_texture(texture, 0, whole, False)[0]

    def repeat_failure(self, index: int, op: Op, values: list[Any]) -> None:
        """Execute a call that failed when it was recorded, unless it opens or ends a pass, a label or the
        like."""
        if op in _NOT_REPEATED:
            return
        try:
            if op in CREATIONS:
                new = self.core.new_id()
                self.methods[op](new, map_ids(values[1], self.result.ids.__getitem__))
                self.core.backend.destroy(new)
            else:
                self.call(op, values)
        except Exception as error:
            name = error.rule.id if isinstance(error, RhiError) else type(error).__name__
            self.result.failures[index] = Failure(name, str(error))
        else:
            self.result.failures[index] = None
