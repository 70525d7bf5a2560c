"""Where values live: a type's components, and the places that a program can read and assign.

- A local of any type is its components, each a `Slot`: a variable, or private memory where an array is in the type.
- A place in a buffer or shared memory is an index, a scale and an offset in words. Of one index the scale is kept,
  so that elements of structs are read with vector loads; of several, words are added up.
- An index that isn't constant, into a vector or into a matrix, gives a `Choice` between places.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    HostType,
    Layout,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
    place,
)
from rhi.shading.ir.lanes import Literal, MemoryRegion, ScalarKind, Uniformity, Value, Variable, apply, number

__rhi_internal__ = True

KINDS = {FLOAT: ScalarKind.FLOAT, INT: ScalarKind.INT, UINT: ScalarKind.UINT, BOOL: ScalarKind.BOOL}


@dataclass(slots=True, eq=False)
class Slot:
    """One component of a local; with `stride`, the variable is the base of an affine value."""

    variable: Variable
    stride: int = 0
    key: object = None
    scope: object = None


Home: TypeAlias = Slot | MemoryRegion


@dataclass(slots=True)
class LocalPlace:
    """Components of a local. Of those in arrays, `index` says which element (None: the first of all)."""

    type: HostType
    homes: list[Home]
    index: Value | None = None


@dataclass(slots=True)
class MemoryPlace:
    """A value in memory: at `index * scale + offset` words."""

    type: HostType
    memory: MemoryRegion
    layout: Layout | None
    index: Value
    scale: int
    offset: int


@dataclass(slots=True)
class Choice:
    """The one of several places that `index` says."""

    type: HostType
    index: Value
    places: list[AnyPlace]


AnyPlace: TypeAlias = LocalPlace | MemoryPlace | Choice


def leaf_kinds(type: HostType) -> list[tuple[ScalarKind, int]]:
    """The kinds of a type's components, and how many elements of arrays share each."""
    match type:
        case ScalarType():
            return [(KINDS[type], 0)]
        case VectorType(scalar=scalar, size=size):
            return [(KINDS[scalar], 0)] * size
        case MatrixType(size=size):
            return [(ScalarKind.FLOAT, 0)] * size**2
        case ArrayType(element=element, length=length):
            return [(kind, max(count, 1) * length) for kind, count in leaf_kinds(element)]
        case StructType(fields=fields):
            return [leaf for field in fields for leaf in leaf_kinds(field.type)]


def words_of(type: HostType) -> int:
    """Words of a value without padding: shared memory's layout, where a bool is a word."""
    return sum(max(count, 1) for _, count in leaf_kinds(type))


def all_kinds(type: HostType) -> list[ScalarKind]:
    """The kinds of all scalars of a value, arrays' elements one by one."""
    match type:
        case ArrayType(element=element, length=length):
            return all_kinds(element) * length
        case StructType(fields=fields):
            return [kind for field in fields for kind in all_kinds(field.type)]
        case _:
            return [kind for kind, _ in leaf_kinds(type)]


def word_offsets(type: HostType, layout: Layout | None) -> list[int]:
    """Where each scalar of a value lies, in words; without a layout they lie side by side."""
    if layout is None:
        return list(range(words_of(type)))
    placement = place(type, layout)
    match type:
        case ScalarType():
            return [0]
        case VectorType(size=size):
            return list(range(size))
        case MatrixType(size=size):
            return [row * placement.stride // 4 + column for row in range(size) for column in range(size)]
        case ArrayType(element=element, length=length):
            inner = word_offsets(element, layout)
            return [i * placement.stride // 4 + offset for i in range(length) for offset in inner]
        case StructType(fields=fields):
            return [
                start // 4 + offset
                for field, start in zip(fields, placement.offsets, strict=True)
                for offset in word_offsets(field.type, layout)
            ]


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


def member(at: AnyPlace, name: str) -> AnyPlace:
    """A struct's field."""
    assert isinstance(at.type, StructType)
    field = at.type.field(name)
    assert field is not None
    index = at.type.fields.index(field)
    before = at.type.fields[:index]
    match at:
        case LocalPlace():
            start = sum(len(leaf_kinds(part.type)) for part in before)
            homes = at.homes[start : start + len(leaf_kinds(field.type))]
            return LocalPlace(field.type, homes, at.index)
        case MemoryPlace(layout=layout):
            if layout is not None:
                start = place(at.type, layout).offsets[index] // 4
            else:
                start = sum(words_of(part.type) for part in before)
            return replace(at, type=field.type, offset=at.offset + start)
        case Choice():
            return Choice(field.type, at.index, [member(part, name) for part in at.places])


def part(at: AnyPlace, which: int) -> AnyPlace:
    """A vector's component, a matrix's row or an array's element whose number is known."""
    inner = element_type(at.type)
    match at:
        case LocalPlace(type=ArrayType()):
            return element(at, number(which))
        case LocalPlace():
            size = len(leaf_kinds(inner))
            return LocalPlace(inner, at.homes[which * size : (which + 1) * size], at.index)
        case MemoryPlace():
            offset = at.offset + which * _element_words(at.type, at.layout)
            return replace(at, type=inner, offset=offset)
        case Choice():
            return Choice(inner, at.index, [part(one, which) for one in at.places])


def element(at: AnyPlace, index: Value) -> AnyPlace:
    """What `at[index]` names."""
    inner = element_type(at.type)
    match at:
        case LocalPlace(type=ArrayType(length=length)):
            row = index if at.index is None else at.index * number(length) + index
            return LocalPlace(inner, at.homes, row)
        case LocalPlace(type=type):
            size = getattr(type, "size", 0)
            return Choice(inner, index, [part(at, which) for which in range(size)])
        case MemoryPlace():
            words = _element_words(at.type, at.layout)
            if isinstance(at.index, Literal) and at.index.value == 0:
                return replace(at, type=inner, index=index, scale=words)
            row = at.index * number(at.scale) + index * number(words)
            return replace(at, type=inner, index=row, scale=1)
        case Choice():
            return Choice(inner, at.index, [element(one, index) for one in at.places])


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
