"""Lvalues: the storage that a stage can read and assign.

- A local is stored by component: each has a `Slot`, which is a variable, or private memory if it belongs to
  an array.
- An lvalue in a buffer or in shared memory is an index, a scale and an offset in words. The scale of a single
  index is kept, so that elements of structs are read with vector loads; several indices are summed to a word
  index.
- A vector or matrix indexed with a variable gives an `LvalueChoice`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeAlias

from rhi.contract.layout import (
    FLOAT,
    ArrayType,
    HostType,
    Layout,
    MatrixType,
    StructType,
    VectorType,
    memory_layout,
)
from rhi.errors.data_classes import dataclass
from rhi.shading.ir.lanes import Literal, MemoryRegion, Value, Variable, apply, number
from rhi.shading.lowering.components import leaf_kinds, words_of


@dataclass(slots=True, eq=False)
class Slot:
    """A component of a local. If `stride` isn't 0, the variable is the base of an affine value."""

    variable: Variable
    stride: int = 0
    key: object = None
    scope: object = None


Home: TypeAlias = Slot | MemoryRegion


@dataclass(slots=True)
class LocalLvalue:
    """Components of a local. For those in arrays, `index` selects the element (None: the whole array)."""

    type: HostType
    homes: list[Home]
    index: Value | None = None


@dataclass(slots=True)
class MemoryLvalue:
    """A value in memory, at the word `index * scale + offset`. `limit`: as for `lanes.Load`."""

    type: HostType
    memory: MemoryRegion
    layout: Layout | None
    index: Value
    scale: int
    offset: int
    limit: Value | None = None


@dataclass(slots=True)
class LvalueChoice:
    """A choice among several lvalues, selected by `index`."""

    type: HostType
    index: Value
    choices: list[Lvalue]


Lvalue: TypeAlias = LocalLvalue | MemoryLvalue | LvalueChoice


def _element_words(type: HostType, layout: Layout | None) -> int:
    """Return the words from one element of an array, matrix or vector to the next."""
    match type:
        case ArrayType(element=element):
            return memory_layout(type, layout).stride // 4 if layout is not None else words_of(element)
        case MatrixType(size=size):
            return memory_layout(type, layout).stride // 4 if layout is not None else size
        case _:
            return 1


def element_type(type: HostType) -> HostType:
    """Return the type that indexing gives."""
    match type:
        case ArrayType(element=element):
            return element
        case MatrixType(size=size):
            return VectorType(FLOAT, size)
        case VectorType(scalar=scalar):
            return scalar
    raise TypeError(f"{type} has no elements")


def member(at: Lvalue, name: str) -> Lvalue:
    """Return the lvalue of a struct's field."""
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
                start = memory_layout(at.type, layout).offsets[index] // 4
            else:
                start = sum(words_of(part.type) for part in before)
            return replace(at, type=field.type, offset=at.offset + start)
        case LvalueChoice():
            return LvalueChoice(field.type, at.index, [member(part, name) for part in at.choices])


def part(at: Lvalue, position: int) -> Lvalue:
    """Return the lvalue of a vector's component, matrix's row or array's element with a constant index."""
    inner = element_type(at.type)
    match at:
        case LocalLvalue(type=ArrayType()):
            return element(at, number(position))
        case LocalLvalue():
            size = len(leaf_kinds(inner))
            return LocalLvalue(inner, at.homes[position * size : (position + 1) * size], at.index)
        case MemoryLvalue():
            offset = at.offset + position * _element_words(at.type, at.layout)
            return replace(at, type=inner, offset=offset)
        case LvalueChoice():
            return LvalueChoice(inner, at.index, [part(choice, position) for choice in at.choices])


def element(at: Lvalue, index: Value) -> Lvalue:
    """Return the lvalue `at[index]`."""
    inner = element_type(at.type)
    match at:
        case LocalLvalue(type=ArrayType(length=length)):
            row = index if at.index is None else at.index * number(length) + index
            return LocalLvalue(inner, at.homes, row)
        case LocalLvalue(type=type):
            size = getattr(type, "size", 0)
            return LvalueChoice(inner, index, [part(at, position) for position in range(size)])
        case MemoryLvalue():
            words = _element_words(at.type, at.layout)
            if isinstance(at.index, Literal) and at.index.value == 0:
                return replace(at, type=inner, index=index, scale=words)
            row = at.index * number(at.scale) + index * number(words)
            return replace(at, type=inner, index=row, scale=1)
        case LvalueChoice():
            return LvalueChoice(inner, at.index, [element(choice, index) for choice in at.choices])


def select_by_index(index: Value, values: list[Value]) -> Value:
    """Return `values[index]`, or the nearest value, by a chain of selects."""
    result = values[0]
    for position, value in enumerate(values[1:], 1):
        is_chosen = apply("greater_equal", index, number(position))
        result = apply("select", is_chosen, value, result)
    return result
