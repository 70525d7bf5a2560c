"""Conditions on a command. Each describes itself and how a command misses it, so that a failed expectation
can show the commands that come nearest.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from rhi.commands.buffer_bytes import UnknownDataError
from rhi.commands.ops import DRAW_ARGUMENTS, DRAWS, Op
from rhi.commands.stream import Command
from rhi.commands.text import describe
from rhi.contract.descriptors import BindingKind, Id, ProgramDescriptor
from rhi.contract.layout import FLOAT, ArrayType, HostType, MatrixType, StructType, VectorType, shape_of
from rhi.contract.states import MAX_TARGETS, PER_TARGET, PlatformState
from rhi.errors import refuse
from rhi.errors.rules import ASSERTION_ARGUMENT
from rhi.shading import value_type_of
from rhi.testing.arguments import refuse_name
from rhi.testing.buffer_tracking import (
    RANGES,
    WHOLE,
    BufferTracker,
    bindings_of,
    describe_differences,
)

_ANY_LENGTH: Final = 1 << 31
"""Of a storage buffer, whose length its type doesn't say."""


class Condition(Protocol):
    """A condition that a command meets or misses."""

    def miss(self, command: Command) -> str:
        """Describe how the command misses the condition; return "" if it meets it."""

    def __str__(self) -> str:
        """Describe the condition."""


@dataclass(frozen=True)
class IsOp:
    """The condition that the command is of one of these kinds."""

    ops: frozenset[Op]

    def miss(self, command: Command) -> str:
        return "" if command.op in self.ops else f"it is a {command.op.method}"

    def __str__(self) -> str:
        return "draws" if self.ops == DRAWS else " or ".join(op.method for op in sorted(self.ops))


@dataclass(frozen=True)
class Within:
    """The condition that the command lies in these labels, nested in this order; other labels may lie
    between."""

    labels: tuple[str, ...]

    def miss(self, command: Command) -> str:
        open_labels = iter(command.labels)
        if all(label in open_labels for label in self.labels):  # each is searched after the one before
            return ""
        return f"its labels are {' / '.join(command.labels) or 'none'}"

    def __str__(self) -> str:
        return f"within {' / '.join(self.labels)}"


@dataclass(frozen=True)
class HasArguments:
    """The condition that the command has these arguments; `pytest.approx` gives a tolerance.

    Of an indirect command, one of its draws has those that `DRAW_ARGUMENTS` names.
    """

    expected: Mapping[str, object]

    def miss(self, command: Command) -> str:
        arguments = command.arguments
        if command.op is Op.DRAW_INDIRECT and not self.expected.keys() <= arguments.keys():
            return self._miss_indirect(command, arguments)
        return self._miss_arguments(arguments)

    def _miss_indirect(self, command: Command, arguments: dict[str, Any]) -> str:
        """Describe how the draw that comes nearest misses the condition."""
        try:
            draws = command.draw_arguments
        except UnknownDataError as error:
            return str(error)
        misses = []
        for draw in draws.tolist():
            missed = self._miss_arguments({**arguments, **dict(zip(DRAW_ARGUMENTS, draw, strict=True))})
            if not missed:
                return ""
            misses.append(missed)
        return "of its draws, " + " / ".join(dict.fromkeys(misses)) if misses else "it has no draws"

    def _miss_arguments(self, arguments: Mapping[str, Any]) -> str:
        wrong = [
            f"{name} is {describe(arguments[name])}" if name in arguments else f"it has no {name}"
            for name, value in self.expected.items()
            if name not in arguments or arguments[name] != value
        ]
        return ", ".join(wrong)

    def __str__(self) -> str:
        return "with " + ", ".join(f"{name}={describe(value)}" for name, value in self.expected.items())


@dataclass(frozen=True)
class UsesProgram:
    """The condition that this program is bound, given as an object, an id, or the shader's name."""

    program: object

    def miss(self, command: Command) -> str:
        bound = command.program
        name = name_program(command, bound)
        expected = self.program
        if isinstance(expected, str):
            fits = expected in (name, name.rpartition(".")[2])
        else:
            fits = bound == getattr(expected, "id", expected)
        return "" if fits else f"its program is {name or 'none'}"

    def __str__(self) -> str:
        expected = self.program
        name = expected if isinstance(expected, str) else getattr(expected, "name", expected)
        return f"of program {name!r}"


@dataclass(frozen=True)
class HasStates:
    """The condition that these states are set, their numbers within a tolerance."""

    states: tuple[object, ...]
    tolerance: float

    def miss(self, command: Command) -> str:
        current = command.states
        wrong = [
            f"{type(state).__name__} is {describe(value)}"
            for state in self.states
            for value in self._current(current, state)
            if not is_near(value, state, self.tolerance)
        ]
        return ", ".join(dict.fromkeys(wrong))

    @staticmethod
    def _current(current: Mapping[type, object], state: object) -> Iterable[object]:
        """Return the current values to compare with `state`: one, or one for each target that it applies
        to."""
        if isinstance(state, PlatformState):
            platform_states: Any = current.get(PlatformState)
            return (
                next(
                    (
                        platform_state
                        for platform_state in platform_states
                        if type(platform_state) is type(state)
                    ),
                    state.default(),
                ),
            )
        value: Any = current.get(type(state))
        if type(state) not in PER_TARGET:
            return (value,)
        target = getattr(state, "target", None)
        return value[:MAX_TARGETS] if target is None else (value[target],)

    def __str__(self) -> str:
        return "with " + ", ".join(map(describe, self.states))


@dataclass(frozen=True)
class HasBindings:
    """The condition that these resources are bound, by the names of the program's bindings."""

    expected: Mapping[str, object]

    def miss(self, command: Command) -> str:
        bound = command.bindings
        wrong = []
        for name, value in self.expected.items():
            if name not in bound:
                names = ", ".join(binding.name for binding in bindings_of(command))
                wrong.append(f"nothing is bound as {name} (the program's bindings: {names or 'none'})")
            elif not self._fits(command, bound[name], value):
                wrong.append(f"{name} is {describe_resource(command, bound[name][0])}{list(bound[name][1:])}")
        return ", ".join(wrong)

    def check_names(self, programs: Sequence[ProgramDescriptor]) -> None:
        """Refuse a name that no program's binding has."""
        names = {binding.name for program in programs for binding in program.bindings}
        for name in self.expected if programs else ():
            if name not in names:
                refuse_name("with_bindings", "binding", name, names)

    @staticmethod
    def _fits(command: Command, bound: tuple[int, ...], expected: Any) -> bool:
        """True if a binding refers to the wanted resource.

        A label or an id names a resource. A range or view must be exactly the bound one; a whole buffer or
        texture matches any part of it.
        """
        resource = bound[0]
        if isinstance(expected, str):
            return getattr(command.resource(resource), "label", None) == expected
        if isinstance(expected, int):
            return resource == expected
        if getattr(expected, "owner", expected) is expected and hasattr(expected, "id"):
            return resource == int(expected.id)
        if hasattr(expected, "buffer") and hasattr(expected, "offset"):
            return bound[:2] == (int(expected.buffer), int(expected.offset))
        if hasattr(expected, "sampler"):
            return bound == (int(expected.texture), int(expected.sampler))
        layer = -1 if expected.layer is None else expected.layer
        return bound == (int(expected.texture), int(expected.level), layer)

    def __str__(self) -> str:
        return "with " + ", ".join(f"{name}={value!r}" for name, value in self.expected.items()) + " bound"


@dataclass(frozen=True)
class HasData:
    """The condition that a uniform or storage binding contains these numbers."""

    binding: str
    expected: Mapping[str, object]
    tolerance: float
    trackers: list[BufferTracker] = dataclasses.field(default_factory=list, compare=False, repr=False)
    """The tracker of the latest command's stream, if any; kept so that each command is applied once."""

    def check_names(self, programs: Sequence[ProgramDescriptor]) -> None:
        """Refuse a binding that no program has, and a field that its type hasn't."""
        ranges = [binding for program in programs for binding in program.bindings if binding.kind in RANGES]
        types = self._list_types(programs)
        if programs and self.binding not in {binding.name for binding in ranges}:
            refuse_name("with_data", "binding", self.binding, {binding.name for binding in ranges})
        for path in self.expected if types else ():
            if all(part_type(data_type, path) is None for data_type in types):
                fields = {field.name for data_type in types for field in getattr(data_type, "fields", ())}
                refuse_name("with_data", f"field of {self.binding}", path, fields)

    def check_shapes(self, programs: Sequence[ProgramDescriptor]) -> None:
        """Refuse numbers of another shape than the field's: a part of them would be compared."""
        types = self._list_types(programs)
        for path, value in self.expected.items():
            parts = [part for data_type in types if (part := part_type(data_type, path)) is not None]
            if path == WHOLE and any(isinstance(part, StructType | ArrayType) for part in parts):
                allowed = "a struct's value, or numbers by name or index"
                refuse(ASSERTION_ARGUMENT, "with_data", f"expected={value!r}", allowed)
            shapes = {shape_of(part) for part in parts if not isinstance(part, StructType)}
            numbers: Any = value
            if parts and np.shape(numbers) not in shapes:
                allowed = " or ".join(map(str, sorted(shapes)))
                refuse(
                    ASSERTION_ARGUMENT,
                    "with_data",
                    f"{path or self.binding}={value!r}",
                    f"numbers of shape {allowed}",
                )

    def _list_types(self, programs: Sequence[ProgramDescriptor]) -> list[HostType]:
        """The types that the binding has in these programs; a loaded trace has none."""
        bindings = [
            binding for program in programs for binding in program.bindings if binding.name == self.binding
        ]
        types: list[HostType] = []
        for binding in bindings:
            if binding.kind in RANGES and not isinstance(binding.type, str):
                type = value_type_of(binding.type)
                types.append(ArrayType(type, _ANY_LENGTH) if binding.kind is BindingKind.STORAGE else type)
        return types

    def miss(self, command: Command) -> str:
        if not self.trackers or self.trackers[0].stream is not command.stream:
            self.trackers[:] = [BufferTracker(command.stream)]
        try:
            values = self.trackers[0].read_binding(command, self.binding)
        except UnknownDataError as error:
            return str(error)
        wrong = describe_differences(values, self.expected, self.tolerance)
        return f"of {self.binding}, {wrong}" if wrong else ""

    def __str__(self) -> str:
        values = ", ".join(
            f"{name}={value!r}" if name else f"{value!r}" for name, value in self.expected.items()
        )
        within = f" within {self.tolerance:g}" if self.tolerance else ""
        return f"with {values} in {self.binding}{within}"


@dataclass(frozen=True)
class Where:
    """A custom predicate, with a name for messages."""

    name: str
    predicate: Callable[[Command], bool]

    def miss(self, command: Command) -> str:
        return "" if self.predicate(command) else f"not {self.name}"

    def __str__(self) -> str:
        return self.name


def is_near(actual: object, expected: object, tolerance: float) -> bool:
    """True if two states are equal, their numbers within `tolerance`; the target of a per-target state is
    ignored."""
    if type(actual) is not type(expected):
        return False
    if isinstance(expected, enum.Enum) or not dataclasses.is_dataclass(expected):
        return actual == expected
    for field in dataclasses.fields(expected):
        if field.name == "target":
            continue
        a, b = getattr(actual, field.name), getattr(expected, field.name)
        if isinstance(b, float) and isinstance(a, (int, float)):
            if not math.isclose(a, b, rel_tol=0.0, abs_tol=tolerance):
                return False
        elif isinstance(b, int) and not isinstance(b, bool) and isinstance(a, (int, float)):
            if abs(a - b) > tolerance:
                return False
        elif a != b:
            return False
    return True


def part_type(type: HostType, path: str) -> HostType | None:
    """Return the type of a part of a value, which a path of fields and indices names; None if it hasn't
    any."""
    part: HostType | None = type
    for step in path.split(".") if path != WHOLE else ():
        index = int(step) if step.isdigit() else -1
        match part:
            case ArrayType(element=element, length=length):
                part = element if 0 <= index < length else None
            case StructType():
                field = part.field(step)
                part = field.type if field is not None else None
            case VectorType(scalar=scalar, size=size):
                part = scalar if 0 <= index < size else None
            case MatrixType(size=size):
                part = VectorType(FLOAT, size) if 0 <= index < size else None
            case _:
                part = None
    return part


def name_program(command: Command, program: Id) -> str:
    """Return the name of a program, "" if it isn't known."""
    descriptor = command.resource(program)
    return descriptor.name if isinstance(descriptor, ProgramDescriptor) else ""


def describe_resource(command: Command, resource: Id) -> str:
    """Describe a resource for a message: its label or name if it has one, and its id."""
    descriptor = command.resource(resource)
    label = getattr(descriptor, "label", "") or getattr(descriptor, "name", "")
    return f"{label!r} (id {resource})" if label and isinstance(label, str) else f"id {resource}"
