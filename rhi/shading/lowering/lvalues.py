"""Where values live: a type's components, and the places that a program can read and assign.

- A local of any type is its components, each a `Slot`: a variable, or private memory where an array is in the type.
- A place in a buffer or shared memory is an index, a scale and an offset in words. Of one index the scale is kept,
  so that elements of structs are read with vector loads; of several, words are added up.
- An index that isn't constant, into a vector or into a matrix, gives a `LvalueChoice` between places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

from rhi.contract.layout import (
    FLOAT,
    ArrayType,
    HostType,
    Layout,
    MatrixType,
    StructType,
    VectorType,
    place,
)
from rhi.shading.ir.lanes import Literal, MemoryRegion, Uniformity, Value, Variable, apply, number
from rhi.shading.lowering.components import leaf_kinds, words_of

__rhi_internal__ = True


@dataclass(slots=True, eq=False)
class Slot:
    """One component of a local; with `stride`, the variable is the base of an affine value."""

    variable: Variable
    stride: int = 0
    key: object = None
    scope: object = None


Home: TypeAlias = Slot | MemoryRegion


@dataclass(slots=True)
class LocalLvalue:
    """Components of a local. Of those in arrays, `index` says which element (None: the first of all)."""

    type: HostType
    homes: list[Home]
    index: Value | None = None


@dataclass(slots=True)
class MemoryLvalue:
    """A value in memory: at `index * scale + offset` words."""

    type: HostType
    memory: MemoryRegion
    layout: Layout | None
    index: Value
    scale: int
    offset: int


@dataclass(slots=True)
class LvalueChoice:
    """The one of several places that `index` says."""

    type: HostType
    index: Value
    choices: list[Lvalue]


Lvalue: TypeAlias = LocalLvalue | MemoryLvalue | LvalueChoice


def _element_words(type: HostType, layout: Layout | None) -> int:
    """Words from one part of an array, matrix or vector to the next."""
    match type:
        case ArrayType(element=element):
            return place(type, layout).stride // 4 if layout is not None else words_of(element)
        case MatrixType(size=size):
            return place(type, layout).stride // 4 if layout is not None else size
        case _:
            return 1


def element_type(type: HostType) -> HostType:
    """What indexing gives."""
    match type:
        case ArrayType(element=element):
            return element
        case MatrixType(size=size):
            return VectorType(FLOAT, size)
        case VectorType(scalar=scalar):
            return scalar
    raise TypeError(f"{type} has no elements")


def count_parts(type: HostType) -> int:
    """How many parts indexing chooses from."""
    return type.length if isinstance(type, ArrayType) else getattr(type, "size", 0)


def member(at: Lvalue, name: str) -> Lvalue:
    """A struct's field."""
    assert isinstance(at.type, StructType)
    field = at.type.field(name)
    assert field is not None
    index = at.type.fields.index(field)
    before = at.type.fields[:index]
    match at:
        case LocalLvalue():
            start = sum(len(leaf_kinds(part.type)) for part in before)
            homes = at.homes[start : start + len(leaf_kinds(field.type))]
            return LocalLvalue(field.type, homes, at.index)
        case MemoryLvalue(layout=layout):
            if layout is not None:
                start = place(at.type, layout).offsets[index] // 4
            else:
                start = sum(words_of(part.type) for part in before)
            return replace(at, type=field.type, offset=at.offset + start)
        case LvalueChoice():
            return LvalueChoice(field.type, at.index, [member(part, name) for part in at.choices])


def part(at: Lvalue, which: int) -> Lvalue:
    """A vector's component, a matrix's row or an array's element whose number is known."""
    inner = element_type(at.type)
    match at:
        case LocalLvalue(type=ArrayType()):
            return element(at, number(which))
        case LocalLvalue():
            size = len(leaf_kinds(inner))
            return LocalLvalue(inner, at.homes[which * size : (which + 1) * size], at.index)
        case MemoryLvalue():
            offset = at.offset + which * _element_words(at.type, at.layout)
            return replace(at, type=inner, offset=offset)
        case LvalueChoice():
            return LvalueChoice(inner, at.index, [part(one, which) for one in at.choices])


def element(at: Lvalue, index: Value) -> Lvalue:
    """What `at[index]` names."""
    inner = element_type(at.type)
    match at:
        case LocalLvalue(type=ArrayType(length=length)):
            row = index if at.index is None else at.index * number(length) + index
            return LocalLvalue(inner, at.homes, row)
        case LocalLvalue(type=type):
            size = getattr(type, "size", 0)
            return LvalueChoice(inner, index, [part(at, which) for which in range(size)])
        case MemoryLvalue():
            words = _element_words(at.type, at.layout)
            if isinstance(at.index, Literal) and at.index.value == 0:
                return replace(at, type=inner, index=index, scale=words)
            row = at.index * number(at.scale) + index * number(words)
            return replace(at, type=inner, index=row, scale=1)
        case LvalueChoice():
            return LvalueChoice(inner, at.index, [element(one, index) for one in at.choices])


def private_uniformity(uniformity: Uniformity) -> Uniformity:
    """Private memory is never shared beyond the lanes of a work-item."""
    return max(uniformity, Uniformity.LANES)


def select_by_index(index: Value, values: list[Value]) -> Value:
    """The value whose number is `index`."""
    result = values[0]
    for which, value in enumerate(values[1:], 1):
        wanted = apply("equal", index, number(which))
        result = apply("select", wanted, value, result)
    return result
