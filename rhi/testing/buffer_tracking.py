"""The contents of uniform and storage bindings at a command, derived from the commands before it.

Bytes are tracked through creations (which zero them), writes, copies and clears. Bytes that a program wrote,
and bytes that were last written before the stream begins, are unknown: reading them raises an error, they are
never guessed. A buffer may be older than the stream, as rings are after `stream.clear()`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.commands.context import StreamContext
from rhi.commands.ops import DISPATCHES, DRAWS, Op
from rhi.commands.stream import Command, CommandStream
from rhi.contract.descriptors import Binding, BindingKind, BufferDescriptor, Id, ProgramDescriptor
from rhi.contract.layout import Layout, element_dtype
from rhi.shading import Struct, value_type_of
from rhi.testing.arguments import checker, read_command

RANGES: Final = (BindingKind.UNIFORM, BindingKind.STORAGE)


class UnknownDataError(Exception):
    """The contents can't be derived from the stream; the message says why."""


@dataclass(slots=True)
class _Bytes:
    """The bytes of a buffer, and which of them are known.

    Attributes:
        is_older: bytes that no command of the stream has touched, in a buffer that is older than the stream.
    """

    data: NDArray[np.uint8]
    is_known: NDArray[np.bool_]
    is_older: NDArray[np.bool_]


@dataclass(slots=True)
class BufferTracker:
    """Tracks the contents of a stream's buffers from command to command.

    Attributes:
        done: number of commands that have been applied.
        skipped: number of commands, skipped by the stream, that the context includes.
        context: program and bindings after these commands.
        buffers: contents of each buffer that the stream created or touched, by id.
    """

    stream: CommandStream
    done: int = 0
    skipped: int = 0
    context: StreamContext = field(init=False)
    buffers: dict[Id, _Bytes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.context = self.stream.initial_context()

    def advance(self, index: int) -> None:
        """Apply all commands before `index`, starting over if some of the later ones have been applied."""
        if index < self.done:
            self.done, self.skipped, self.buffers = 0, 0, {}
            self.context = self.stream.initial_context()
        for each in range(self.done, index):
            self.skipped = self.stream.apply_skipped(self.context, self.skipped, each)
            if each not in self.stream.failures:
                op, values, _, _ = self.stream.entry(each)
                self._follow(op, values)
                self.context.apply(op, values)
        self.skipped = self.stream.apply_skipped(self.context, self.skipped, index)
        self.done = index

    def _buffer(self, buffer: Id) -> _Bytes | None:
        """Return the tracked bytes of a buffer, none of them known if it is older; None if it is no buffer."""
        tracked = self.buffers.get(buffer)
        descriptor = self.context.resources.get(buffer)
        if tracked is None and isinstance(descriptor, BufferDescriptor):
            size = descriptor.size
            tracked = _Bytes(np.zeros(size, np.uint8), np.zeros(size, np.bool_), np.ones(size, np.bool_))
            self.buffers[buffer] = tracked
        return tracked

    def _follow(self, op: Op, values: tuple[Any, ...]) -> None:
        if op is Op.CREATE_BUFFER:
            size = values[1].size
            all_bytes = np.ones(size, np.bool_)
            self.buffers[values[0]] = _Bytes(np.zeros(size, np.uint8), all_bytes, np.zeros(size, np.bool_))
        elif op is Op.WRITE_BUFFER:
            buffer, offset, data = values
            self._set(buffer, offset, np.frombuffer(data, np.uint8), True)
        elif op is Op.CLEAR_BUFFER:
            buffer, offset, size, value = values
            pattern = np.full(size // 4, value & 0xFFFFFFFF, "<u4").view(np.uint8)
            self._set(buffer, offset, pattern, True)
        elif op is Op.COPY_BUFFER:
            source, source_offset, target, target_offset, size = values
            copied = self._buffer(source)
            if copied is None:
                self._set(target, target_offset, np.zeros(size, np.uint8), False)
            else:
                part = slice(source_offset, source_offset + size)
                self._set(target, target_offset, copied.data[part].copy(), copied.is_known[part].copy())
        elif op is Op.COPY_TEXTURE_TO_BUFFER:
            _, _, region, target, offset, row_bytes = values
            self._set(target, offset, np.zeros(row_bytes * region.height * region.layers, np.uint8), False)
        elif op in DRAWS or op in DISPATCHES:
            for binding in _program_bindings(self.context.resources.get(self.context.program)):
                bound = self.context.slots.get((binding.kind, binding.slot))
                if binding.kind is BindingKind.STORAGE and binding.writes and bound:
                    self._set(bound[0], bound[1], np.zeros(bound[2], np.uint8), False)

    def _set(self, buffer: Id, offset: int, data: NDArray[np.uint8], is_known: Any) -> None:
        tracked = self._buffer(buffer)
        if tracked is None:
            return
        part = slice(offset, min(offset + len(data), len(tracked.data)))
        tracked.data[part] = data[: part.stop - part.start]
        tracked.is_known[part] = is_known
        tracked.is_older[part] = False

    def read(self, command: Command, name: str) -> NDArray[Any]:
        """Return the contents of a binding at a command, see `binding_data`."""
        self.advance(command.index)
        bindings = bindings_of(command)
        binding = next((each for each in bindings if each.name == name and each.kind in RANGES), None)
        if binding is None:
            names = ", ".join(each.name for each in bindings if each.kind in RANGES) or "none"
            raise UnknownDataError(f"the program has no uniform or storage {name!r} (it has: {names})")
        if name not in command.bindings:
            raise UnknownDataError(f"nothing is bound as {name!r}")
        buffer, offset, size = command.bindings[name]
        content, dtype = self._buffer(buffer), _dtype(binding)
        if content is None:
            raise UnknownDataError(f"{name!r} lies in buffer {buffer}, of which the stream has no size")
        size = dtype.itemsize if binding.kind is BindingKind.UNIFORM else size - size % dtype.itemsize
        part = slice(offset, offset + size)
        if not content.is_known[part].all():
            first = int(np.flatnonzero(~content.is_known[part])[0])
            if content.is_older[part][first]:
                raise UnknownDataError(
                    f"byte {first} of {name!r} was last written before the stream: it is older than "
                    "stream.clear(), or than the trace"
                )
            raise UnknownDataError(f"byte {first} of {name!r} was written on the device")
        base, shape = dtype.subdtype or (dtype, ())
        values = content.data[part].copy().view(base).reshape(-1, *shape)
        return values[0] if binding.kind is BindingKind.UNIFORM else values


def binding_data(command: Command, name: str) -> Any:
    """Return the numbers that the program of a draw or dispatch reads from its uniform or storage binding
    `name`.

    Returns:
        One value of the struct's std140 dtype for a uniform, an array (n,) of its std430 dtype for storage.

    Raises:
        UnknownDataError: there is no such binding, or its contents can't be derived from the stream.
    """
    checker("binding_data").text("name", name)
    return BufferTracker(read_command("binding_data", command).stream).read(command, name)


def describe_differences(values: Any, expected: Mapping[str, object], tolerance: float) -> str:
    """Describe the parts of a value that differ from the wanted ones by more than `tolerance`; "" if none
    does.

    A path of fields and indices names a part: "color", "lights.0.color".
    """
    wrong = []
    for path, value in expected.items():
        try:
            actual = np.asarray(_part(values, path))
        except (ValueError, KeyError, IndexError):
            wrong.append(f"there is no {path!r}")
            continue
        expected_array = np.asarray(value, np.float64)
        with np.errstate(over="ignore", invalid="ignore"):  # a float is compared as the shader reads it
            expected_array = expected_array.astype(actual.dtype if actual.dtype.kind == "f" else np.float64)
        actual = actual[tuple(slice(0, n) for n in expected_array.shape)]  # without padding
        fits = actual.shape == expected_array.shape and bool(
            (np.abs(actual - expected_array) <= tolerance).all()
        )
        if not fits:
            wrong.append(f"{path} is {np.array2string(actual, separator=', ', threshold=16)}")
    return ", ".join(wrong)


def as_fields(value: Mapping[str, object] | Struct) -> Mapping[str, object]:
    """Return the fields of a struct's value by name; a mapping is returned as it is."""
    if isinstance(value, Struct):
        return {each.name: getattr(value, each.name) for each in type(value).shading_type.fields}
    return value


def _part(values: Any, path: str) -> Any:
    for step in path.split("."):
        values = values[int(step) if step.isdigit() else step]
    return values


def bindings_of(command: Command) -> tuple[Binding, ...]:
    """Return the bindings of the program that is bound at a command; none if no program is."""
    return _program_bindings(command.resource(command.program))


def _program_bindings(program: object) -> tuple[Binding, ...]:
    return program.bindings if isinstance(program, ProgramDescriptor) else ()


def _dtype(binding: Binding) -> np.dtype[Any]:
    if isinstance(binding.type, str):
        raise UnknownDataError(f"a loaded trace doesn't have the layout of {binding.type}")
    layout = Layout.STD140 if binding.kind is BindingKind.UNIFORM else Layout.STD430
    return element_dtype(value_type_of(binding.type), layout)
