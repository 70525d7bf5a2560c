"""The components of a type: the scalars that a value consists of, their kinds and their offsets in memory."""

from __future__ import annotations

from rhi.contract.layout import (
    FLOAT,
    ArrayType,
    HostType,
    Layout,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
    memory_layout,
)
from rhi.shading.language.types import count_scalars


def leaf_kinds(type: HostType) -> list[tuple[ScalarType, int]]:
    """Return the kinds of a type's components, each with the number of array elements that share it (0: no
    array)."""
    match type:
        case ScalarType():
            return [(type, 0)]
        case VectorType(scalar=scalar, size=size):
            return [(scalar, 0)] * size
        case MatrixType(size=size):
            return [(FLOAT, 0)] * size**2
        case ArrayType(element=element, length=length):
            return [(kind, max(count, 1) * length) for kind, count in leaf_kinds(element)]
        case StructType(fields=fields):
            return [leaf for field in fields for leaf in leaf_kinds(field.type)]


def words_of(type: HostType) -> int:
    """Return the words of a value without padding. This is the layout of shared memory, where a bool is a
    word."""
    return count_scalars(type)


def all_kinds(type: HostType) -> list[ScalarType]:
    """Return the kinds of all scalars of a value, including each element of arrays."""
    match type:
        case ArrayType(element=element, length=length):
            return all_kinds(element) * length
        case StructType(fields=fields):
            return [kind for field in fields for kind in all_kinds(field.type)]
        case _:
            return [kind for kind, _ in leaf_kinds(type)]


def word_offsets(type: HostType, layout: Layout | None) -> list[int]:
    """Return the offset of each scalar of a value in words. Without a layout they are consecutive."""
    if layout is None:
        return list(range(words_of(type)))
    placement = memory_layout(type, layout)
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
