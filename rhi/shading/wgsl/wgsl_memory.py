"""Types of memory that differ from the types of values, and conversions between the two.

- WGSL lays values out as std430 does. In uniform memory, arrays of scalars and of two components have
  elements of 16 bytes, and structs other offsets: these get types of their own (`UNIFORM`).
- Words that atomics work on are atomic in all of their memory, so structs that contain them get types of
  their own, one for each binding.
- A path through memory has the types of memory; the value at its end is converted when it is read or written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Final

from rhi.contract.layout import (
    ArrayType,
    HostType,
    Layout,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
    memory_layout,
)

UNIFORM: Final = ""
"""The space of uniform memory; storage and shared memory have spaces of their own, by the name of the
binding."""

AtomicWords = frozenset[tuple[str, StructType | None, str]]
"""Words that atomics modify: (binding, struct, field), or (binding, None, "") for words that aren't
fields."""


class MemoryTypes:
    """The types of memory of a stage. `structs` are the declarations that they need."""

    def __init__(
        self,
        type: Callable[[HostType], str],
        field: Callable[[StructType, str], str],
        name: Callable[[object, str], str],
        atomics: AtomicWords,
    ) -> None:
        """Create the types. `type`, `field` and `name` return the names of a type, of a struct's field, and
        of a key."""
        self._value_type = type
        self._field = field
        self._name = name
        self.atomics = atomics
        self.structs: dict[str, list[str]] = {}

    def is_atomic(self, space: str, owner: StructType | None, field: str) -> bool:
        """Return whether words are atomic: a field of a struct, or those of a binding without structs."""
        return (space, owner, field) in self.atomics

    def differs(self, type: HostType, space: str, atomic: bool = False) -> bool:
        """Return whether a type in memory differs from the type of its values."""
        match type:
            case ScalarType():
                return atomic
            case MatrixType(size=size):
                return space == UNIFORM and size == 2
            case ArrayType(element=element):
                return self.differs(element, space, atomic) or (space == UNIFORM and _is_narrow(element))
            case StructType(fields=fields):
                if any(self.differs(f.type, space, self.is_atomic(space, type, f.name)) for f in fields):
                    return True
                ours, theirs = memory_layout(type, Layout.STD140), memory_layout(type, Layout.STD430)
                return space == UNIFORM and (ours.offsets, ours.size) != (theirs.offsets, theirs.size)
        return False

    def type(self, type: HostType, space: str, atomic: bool = False) -> str:
        """Return the name of a type in memory, declaring the structs that it needs."""
        if not self.differs(type, space, atomic):
            return self._value_type(type)
        match type:
            case ScalarType():
                return f"atomic<{self._value_type(type)}>"
            case MatrixType():
                return "mat2x4<f32>"
            case ArrayType(element=element, length=length):
                part = self.type(element, space, atomic)
                if space == UNIFORM and _is_narrow(element):
                    scalar = element.scalar if isinstance(element, VectorType) else element
                    part = f"vec4<{self._value_type(scalar)}>"
                return f"array<{part}, {length}>"
            case StructType():
                return self._struct(type, space)
        raise TypeError(type)

    def _struct(self, type: StructType, space: str) -> str:
        name = self._name(("memory", type, space), f"{type.name}_{space or 'std140'}")
        if name not in self.structs:
            lines = []
            placed = memory_layout(type, Layout.STD140 if space == UNIFORM else Layout.STD430)
            ends = (*placed.offsets[1:], placed.size)
            for field, start, end in zip(type.fields, placed.offsets, ends, strict=True):
                marks = ""
                if space == UNIFORM:
                    marks = (
                        f"@align({memory_layout(field.type, Layout.STD140).alignment}) @size({end - start}) "
                    )
                inner = self.type(field.type, space, self.is_atomic(space, type, field.name))
                lines.append(f"{marks}{self._field(type, field.name)}: {inner},")
            self.structs[name] = lines  # after the structs that it contains
        return name

    def element(self, base: HostType, space: str) -> str:
        """Return the suffix after an index into an array, or into the rows of a matrix, in memory."""
        if space == UNIFORM:
            if isinstance(base, ArrayType) and _is_narrow(base.element):
                return ".x" if isinstance(base.element, ScalarType) else ".xy"
            if isinstance(base, MatrixType) and base.size == 2:
                return ".xy"
        return ""

    def load(self, type: HostType, space: str, path: str, atomic: bool = False) -> str:
        """Return the value at a path through memory."""
        if not self.differs(type, space, atomic):
            return path
        match type:
            case ScalarType():
                return f"atomicLoad(&{path})"
            case MatrixType():
                return f"mat2x2<f32>({path}[0].xy, {path}[1].xy)"
        parts = [
            self.load(inner, space, where, member_type)
            for inner, where, member_type in self._parts(type, space, path, atomic)
        ]
        return f"{self._value_type(type)}({', '.join(parts)})"

    def store(self, type: HostType, space: str, path: str, value: str, atomic: bool = False) -> Iterator[str]:
        """Yield the statements that store a value, the name of a variable, at a path through memory."""
        if not self.differs(type, space, atomic):
            yield f"{path} = {value};"
        elif isinstance(type, ScalarType):
            yield f"atomicStore(&{path}, {value});"
        else:
            parts = self._parts(type, space, path, atomic)
            values = self._parts(type, space, value, atomic)
            for (inner, where, member_type), (_, part, _) in zip(parts, values, strict=True):
                yield from self.store(inner, space, where, part, member_type)

    def _parts(
        self, type: HostType, space: str, path: str, atomic: bool
    ) -> Iterator[tuple[HostType, str, bool]]:
        """Yield the type and the path of each element or field, and whether it is atomic."""
        if isinstance(type, ArrayType):
            for number in range(type.length):
                yield type.element, f"{path}[{number}]{self.element(type, space)}", atomic
        elif isinstance(type, StructType):
            for field in type.fields:
                yield (
                    field.type,
                    f"{path}.{self._field(type, field.name)}",
                    self.is_atomic(space, type, field.name),
                )


def _is_narrow(element: HostType) -> bool:
    """Return whether elements of an array are smaller than the 16 bytes that uniform memory gives each."""
    return isinstance(element, ScalarType) or (isinstance(element, VectorType) and element.size == 2)
