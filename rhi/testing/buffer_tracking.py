"""The contents of uniform and storage bindings at a command, as elements of their types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.commands.buffer_bytes import BufferBytes, UnknownDataError
from rhi.commands.stream import Command
from rhi.contract.descriptors import Binding, BindingKind, ProgramDescriptor
from rhi.contract.layout import Layout, MatrixType, ScalarType, VectorType, element_dtype, shape_of
from rhi.shading import Struct, value_type_of
from rhi.testing.arguments import checker, read_command

RANGES: Final = (BindingKind.UNIFORM, BindingKind.STORAGE)


@dataclass(slots=True)
class BufferTracker(BufferBytes):
    """Tracks the contents of a stream's bindings from command to command."""

    def read_binding(self, command: Command, name: str) -> NDArray[Any]:
        """Return the contents of a binding at a command, see `binding_data`."""
        self.advance(command.index)
        bindings = bindings_of(command)
        binding = next(
            (candidate for candidate in bindings if candidate.name == name and candidate.kind in RANGES), None
        )
        if binding is None:
            names = ", ".join(candidate.name for candidate in bindings if candidate.kind in RANGES) or "none"
            raise UnknownDataError(f"the program has no uniform or storage {name!r} (it has: {names})")
        if name not in command.bindings:
            raise UnknownDataError(f"nothing is bound as {name!r}")
        buffer, offset, size = command.bindings[name]
        dtype = _dtype(binding)
        size = dtype.itemsize if binding.kind is BindingKind.UNIFORM else size - size % dtype.itemsize
        data = self.read(repr(name), buffer, offset, size)
        base, shape = dtype.subdtype or (dtype, ())
        values = data.view(base).reshape(-1, *shape)
        return values if binding.kind is BindingKind.STORAGE else _cut_padding(values[0], binding)


def _cut_padding(value: Any, binding: Binding) -> Any:
    """Return a uniform's number, vector or matrix without the padding of its std140 layout; a struct as it
    is."""
    type = None if isinstance(binding.type, str) else value_type_of(binding.type)
    if not isinstance(type, ScalarType | VectorType | MatrixType):
        return value
    shape = shape_of(type)
    return value[tuple(slice(0, length) for length in shape) or 0]


def binding_data(command: Command, name: str) -> Any:
    """Return the numbers that the program of a draw or dispatch reads from its uniform or storage binding
    `name`.

    Returns:
        One value of the struct's std140 dtype for a uniform, or its number, vector or matrix; an array (n,) of
        its std430 dtype for storage.

    Raises:
        UnknownDataError: there is no such binding, or its contents can't be derived from the stream.

    Examples:
        >>> tint = device.uniform(Tint(color=(1, 0, 0, 1)))
        >>> with device.render_pass(image):
        ...     device.draw(device.program(Tinted), mesh, tint=tint)
        >>> binding_data(device.stream.draws()[-1], "tint")["color"].tolist()
        [1.0, 0.0, 0.0, 1.0]
    """
    checker("binding_data").text("name", name)
    return BufferTracker(read_command("binding_data", command).stream).read_binding(command, name)


WHOLE: Final = ""
"""The path of a value that is no struct."""


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
            wrong.append(f"{path or 'it'} is {np.array2string(actual, separator=', ', threshold=16)}")
    return ", ".join(wrong)


def as_fields(value: Any) -> Mapping[str, object]:
    """Return the fields of a struct's value by name; a mapping is returned as it is, and other values by the
    path of the whole."""
    if isinstance(value, Struct):
        return {field.name: getattr(value, field.name) for field in type(value).shading_type.fields}
    return value if isinstance(value, Mapping) else {WHOLE: value}


def _part(values: Any, path: str) -> Any:
    for step in path.split(".") if path != WHOLE else ():
        values = values[int(step) if step.isdigit() else step]
    return values


def bindings_of(command: Command) -> tuple[Binding, ...]:
    """Return the bindings of the program that is bound at a command; none if no program is."""
    program = command.resource(command.program)
    return program.bindings if isinstance(program, ProgramDescriptor) else ()


def _dtype(binding: Binding) -> np.dtype[Any]:
    if isinstance(binding.type, str):
        raise UnknownDataError(f"a loaded trace doesn't have the layout of {binding.type}")
    layout = Layout.STD140 if binding.kind is BindingKind.UNIFORM else Layout.STD430
    return element_dtype(value_type_of(binding.type), layout)
