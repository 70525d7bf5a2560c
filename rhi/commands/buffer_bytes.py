"""The bytes of buffers at a command, derived from the commands before it, and the draws of indirect commands.

Bytes are tracked through creations (which zero them), writes, copies and clears. Bytes that a program wrote,
that were written while recording was paused, or before the stream begins, are unknown: reading them raises an
error, they are never guessed. A buffer may be older than the stream, as rings are after `stream.clear()`.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Mapping
from dataclasses import field
from types import CodeType
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rhi.commands.context import StreamContext
from rhi.commands.ops import BUFFER_WRITES, Op
from rhi.contract.descriptors import (
    DRAW,
    DRAW_UNINDEXED,
    BindingKind,
    BufferDescriptor,
    Id,
    ProgramDescriptor,
    VertexArrayDescriptor,
)
from rhi.errors.data_classes import dataclass


class RecordedCommands(Protocol):
    """A stream as this module reads it: `rhi.commands.stream.CommandStream`."""

    generation: int

    @property
    def failures(self) -> Mapping[int, Any]: ...
    def entry(self, index: int, /) -> tuple[Op, tuple[Any, ...], CodeType | None, int]: ...
    def skipped(self, first: int, index: int, /) -> Iterator[tuple[Op, tuple[Any, ...]]]: ...
    def initial_context(self) -> StreamContext: ...


class UnknownDataError(Exception):
    """The contents can't be derived from the stream; the message says why."""


class Origin(enum.IntEnum):
    """Where the last value of a byte comes from. Only a `KNOWN` one can be read."""

    KNOWN = 0
    OLDER = 1
    DEVICE = 2
    PAUSED = 3


_REASONS: Final = {
    Origin.OLDER: "was last written before the stream: it is older than stream.clear(), or than the trace",
    Origin.DEVICE: "was written on the device",
    Origin.PAUSED: "was written while recording was paused",
}


@dataclass(slots=True)
class _Bytes:
    """The bytes of a buffer, and the `Origin` of each."""

    data: NDArray[np.uint8]
    origins: NDArray[np.uint8]


@dataclass(slots=True)
class BufferBytes:
    """Tracks the contents of a stream's buffers from command to command.

    Attributes:
        generation: the stream's; after `stream.clear()` the tracker starts over.
        done: number of commands that have been applied.
        skipped: number of commands, skipped by the stream, that the context includes.
        context: program and bindings after these commands.
        buffers: contents of each buffer that the stream created or touched, by id.
    """

    stream: RecordedCommands
    generation: int = -1
    done: int = 0
    skipped: int = 0
    context: StreamContext = field(init=False)
    buffers: dict[Id, _Bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._start()

    def _start(self) -> None:
        self.generation = self.stream.generation
        self.done, self.skipped, self.buffers = 0, 0, {}
        self.context = self.stream.initial_context()

    def advance(self, index: int) -> None:
        """Apply all commands before `index`, starting over if some of the later ones have been applied, or if
        the stream was cleared."""
        if index < self.done or self.generation != self.stream.generation:
            self._start()
        for command_index in range(self.done, index):
            self._follow_skipped(command_index)
            if command_index not in self.stream.failures:
                op, values, _, _ = self.stream.entry(command_index)
                self._follow(op, values)
        self._follow_skipped(index)
        self.done = index

    def _follow_skipped(self, index: int) -> None:
        """Follow the commands that were called before the one at `index`, but not recorded."""
        for op, values in self.stream.skipped(self.skipped, index):
            if op is Op.WRITE_BUFFER:
                buffer, offset, size = values
                self._set(buffer, offset, np.zeros(size, np.uint8), Origin.PAUSED)
            else:
                self._follow(op, values)
            self.skipped += 1

    def _buffer(self, buffer: Id) -> _Bytes | None:
        """Return the tracked bytes of a buffer, none of them known if it is older; None if it is no buffer."""
        tracked = self.buffers.get(buffer)
        descriptor = self.context.resources.get(buffer)
        if tracked is None and isinstance(descriptor, BufferDescriptor):
            size = descriptor.size
            tracked = _Bytes(np.zeros(size, np.uint8), np.full(size, Origin.OLDER, np.uint8))
            self.buffers[buffer] = tracked
        return tracked

    def _follow(self, op: Op, values: tuple[Any, ...]) -> None:
        if op in BUFFER_WRITES:
            self._follow_write(op, values)
        elif op is Op.CREATE_BUFFER:
            size = values[1].size
            self.buffers[values[0]] = _Bytes(np.zeros(size, np.uint8), np.zeros(size, np.uint8))
        self.context.apply(op, values)

    def _follow_write(self, op: Op, values: tuple[Any, ...]) -> None:
        if op is Op.WRITE_BUFFER:
            buffer, offset, data = values
            self._set(buffer, offset, np.frombuffer(data, np.uint8), Origin.KNOWN)
        elif op is Op.CLEAR_BUFFER:
            buffer, offset, size, value = values
            pattern = np.full(size // 4, value & 0xFFFFFFFF, "<u4").view(np.uint8)
            self._set(buffer, offset, pattern, Origin.KNOWN)
        elif op is Op.COPY_BUFFER:
            source, source_offset, target, target_offset, size = values
            copied = self._buffer(source)
            if copied is None:
                self._set(target, target_offset, np.zeros(size, np.uint8), Origin.OLDER)
            else:
                part = slice(source_offset, source_offset + size)
                self._set(target, target_offset, copied.data[part].copy(), copied.origins[part].copy())
        elif op is Op.COPY_TEXTURE_TO_BUFFER:
            _, _, region, target, offset, row_bytes = values
            size = row_bytes * region.height * region.layers
            self._set(target, offset, np.zeros(size, np.uint8), Origin.DEVICE)
        else:
            program = self.context.resources.get(self.context.program)
            for binding in program.bindings if isinstance(program, ProgramDescriptor) else ():
                bound = self.context.slots.get((binding.kind, binding.slot))
                if binding.kind is BindingKind.STORAGE and binding.writes and bound:
                    self._set(bound[0], bound[1], np.zeros(bound[2], np.uint8), Origin.DEVICE)

    def _set(
        self, buffer: Id, offset: int, data: NDArray[np.uint8], origins: Origin | NDArray[np.uint8]
    ) -> None:
        tracked = self._buffer(buffer)
        if tracked is None:
            return
        part = slice(offset, min(offset + len(data), len(tracked.data)))
        tracked.data[part] = data[: part.stop - part.start]
        tracked.origins[part] = origins

    def read(self, name: str, buffer: Id, offset: int, size: int) -> NDArray[np.uint8]:
        """Return a copy of `size` bytes before the command that `advance` has reached; `name` stands for them
        in messages.

        Raises:
            UnknownDataError: some of them are unknown.
        """
        content = self._buffer(buffer)
        if content is None:
            raise UnknownDataError(f"{name} lies in buffer {buffer}, of which the stream has no size")
        part = slice(offset, offset + size)
        if (origins := content.origins[part]).any():
            first = int(np.flatnonzero(origins)[0])
            raise UnknownDataError(f"byte {first} of {name} {_REASONS[Origin(origins[first])]}")
        return content.data[part].copy()

    def read_draws(self, index: int) -> NDArray[np.void]:
        """Return the draws of the DRAW or DRAW_INDIRECT at an index as an array of `DRAW`; see
        `Command.draw_arguments`."""
        op, values, _, _ = self.stream.entry(index)
        arguments = dict(zip(op.parameters, values, strict=True))
        if op is Op.DRAW:
            draws = np.zeros(1, DRAW)
            for name in DRAW.names or ():
                draws[name] = arguments[name]
            return draws
        self.advance(index)
        number, stride = arguments["draws"], arguments["stride"]
        if arguments["count_buffer"]:
            count = self.read("the count", arguments["count_buffer"], arguments["count_offset"], 4)
            number = min(number, int(count.view("<u4")[0]))
        draws = np.zeros(number, DRAW)
        if number:
            vertex_array = self.context.resources.get(arguments["vertex_array"])
            is_indexed = isinstance(vertex_array, VertexArrayDescriptor) and vertex_array.index_buffer != 0
            layout = DRAW if is_indexed else DRAW_UNINDEXED
            size = (number - 1) * stride + layout.itemsize
            data = self.read("the arguments", arguments["buffer"], arguments["offset"], size)
            records: NDArray[np.void] = np.ndarray(number, layout, data.data, 0, (stride,))
            for name in DRAW.names or ():
                if name in (layout.names or ()):
                    draws[name] = records[name]
        return draws
