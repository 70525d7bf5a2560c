"""Types that CPU and device share, and their layout in memory.

- A type describes a value (`VectorType(FLOAT, 3)`), a `Layout` its place in memory: std140 for uniform
  blocks, std430 for storage buffers and vertices, PACKED for data without padding. `memory_layout` gives
  offsets and strides (OpenGL 4.3, section 7.6.2.2), `dtype_of` the equivalent NumPy dtype, padding included.
- Matrices are stored row by row, as in NumPy, so a matrix `M` that is uploaded unchanged gives `M @ v` in a
  shader. Rows are padded like vectors: a `mat3` is float32 (3, 4) with an unused column.
- `compare_layouts` prints two dtypes side by side, to explain why an array can't be uploaded.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass


class Layout(Choice):
    """The rules of a memory layout: alignment and padding of a type's parts."""

    STD140 = "std140"
    STD430 = "std430"
    PACKED = "packed"


@dataclass(frozen=True, slots=True)
class ScalarType:
    """A bool, or a 32-bit int, uint or float. A bool has no size, so it can't be part of shared memory."""

    name: str
    code: str = ""

    def __str__(self) -> str:
        return self.name


BOOL: Final = ScalarType("bool")
INT: Final = ScalarType("int", "i4")
UINT: Final = ScalarType("uint", "u4")
FLOAT: Final = ScalarType("float", "f4")

_VECTOR_PREFIX: Final = {BOOL: "bvec", INT: "ivec", UINT: "uvec", FLOAT: "vec"}


@dataclass(frozen=True, slots=True)
class VectorType:
    """A vector of 2 to 4 components of one scalar type."""

    scalar: ScalarType
    size: int

    def __str__(self) -> str:
        return f"{_VECTOR_PREFIX[self.scalar]}{self.size}"


@dataclass(frozen=True, slots=True)
class MatrixType:
    """A square matrix of floats with 2 to 4 rows."""

    size: int

    def __str__(self) -> str:
        return f"mat{self.size}"


@dataclass(frozen=True, slots=True)
class ArrayType:
    """An array of `length` elements of one type."""

    element: HostType
    length: int

    def __str__(self) -> str:
        return f"{self.element}[{self.length}]"


@dataclass(frozen=True, slots=True)
class Field:
    """A named field of a struct."""

    name: str
    type: HostType


@dataclass(frozen=True, slots=True)
class StructType:
    """A struct: named fields in order."""

    name: str
    fields: tuple[Field, ...]

    def field(self, name: str) -> Field | None:
        """Return the field with this name, or None."""
        return next((field for field in self.fields if field.name == name), None)

    def __str__(self) -> str:
        return self.name


HostType: TypeAlias = ScalarType | VectorType | MatrixType | ArrayType | StructType


@dataclass(frozen=True, slots=True)
class MemoryLayout:
    """Size, alignment, stride and offsets of a type in memory, in bytes.

    `stride` is the distance between the elements of an array or the rows of a matrix, 0 for other types.
    `offsets` has one entry per field of a struct.
    """

    size: int
    alignment: int
    stride: int = 0
    offsets: tuple[int, ...] = ()


def round_up(value: int, alignment: int) -> int:
    """Return the smallest multiple of `alignment` that is not less than `value`."""
    return -(-value // alignment) * alignment


def is_host_shareable(type: HostType) -> bool:
    """True if a type has a layout in memory: it contains no bool and isn't empty."""
    match type:
        case ScalarType():
            return type is not BOOL
        case VectorType(scalar=scalar):
            return scalar is not BOOL
        case MatrixType():
            return True
        case ArrayType(element=element):
            return is_host_shareable(element)
        case StructType(fields=fields):
            return bool(fields) and all(is_host_shareable(field.type) for field in fields)


@lru_cache(maxsize=4096)
def memory_layout(type: HostType, layout: Layout) -> MemoryLayout:
    """Return size, alignment, stride and offsets of `type` in `layout`.

    Raises:
        TypeError: the type contains a bool, whose size differs between devices.
    """
    packed, rounded = layout is Layout.PACKED, layout is Layout.STD140
    match type:
        case ScalarType():
            if type is BOOL:
                raise TypeError("a bool has no layout in memory; use a uint")
            return MemoryLayout(4, 4)
        case VectorType(scalar=scalar, size=size):
            if scalar is BOOL:
                raise TypeError("a vector of bools has no layout in memory; use a vector of uint")
            return MemoryLayout(4 * size, 4 if packed else 8 if size == 2 else 16)
        case MatrixType(size=size):
            rows = memory_layout(ArrayType(VectorType(FLOAT, size), size), layout)
            return MemoryLayout(rows.size, rows.alignment, rows.stride)
        case ArrayType(element=element, length=length):
            part = memory_layout(element, layout)
            alignment = round_up(part.alignment, 16) if rounded else part.alignment
            stride = round_up(part.size, alignment)
            return MemoryLayout(stride * length, alignment, stride)
        case StructType(fields=fields):
            end = 0
            alignment = 16 if rounded else 4
            offsets = []
            for field in fields:
                part = memory_layout(field.type, layout)
                offset = round_up(end, part.alignment)
                offsets.append(offset)
                end, alignment = offset + part.size, max(alignment, part.alignment)
            return MemoryLayout(round_up(end, alignment), alignment, 0, tuple(offsets))


def stride_of(type: HostType, layout: Layout) -> int:
    """The stride in bytes of an array of `type`, as in a storage buffer."""
    return memory_layout(ArrayType(type, 1), layout).stride


def shape_of(type: HostType) -> tuple[int, ...]:
    """Return the shape of a value without padding: () for a scalar or struct, (3, 3) for a `mat3`."""
    match type:
        case VectorType(size=size):
            return (size,)
        case MatrixType(size=size):
            return (size, size)
        case ArrayType(element=element, length=length):
            return (length, *shape_of(element))
        case _:
            return ()


@lru_cache(maxsize=4096)
def dtype_of(type: HostType, layout: Layout) -> np.dtype[Any]:
    """Return the NumPy dtype of one value, padding included.

    A struct gives a structured dtype with the struct's offsets and size. A vector, matrix or array gives a
    subarray; its padded rows or elements have more columns than the natural shape (a `mat3` is float32 (3,
    4), a std140 array of n floats is float32 (n, 4)).
    """
    placement = memory_layout(type, layout)
    match type:
        case ScalarType(code=code):
            return np.dtype("<" + code)
        case VectorType(scalar=scalar, size=size):
            return np.dtype(("<" + scalar.code, (size,)))
        case MatrixType(size=size):
            return np.dtype(("<f4", (size, placement.stride // 4)))
        case ArrayType(element=element, length=length):
            part = _padded_dtype(element, layout, placement.stride)
            base, shape = part.subdtype if part.subdtype is not None else (part, ())
            return np.dtype((base, (length, *shape)))
        case StructType(fields=fields):
            return np.dtype(
                {
                    "names": [field.name for field in fields],
                    "formats": [dtype_of(field.type, layout) for field in fields],
                    "offsets": list(placement.offsets),
                    "itemsize": placement.size,
                }
            )


def element_dtype(type: HostType, layout: Layout) -> np.dtype[Any]:
    """Return the NumPy dtype of one element of an array of `type`: `dtype_of`, padded to the stride."""
    return _padded_dtype(type, layout, stride_of(type, layout))


def _padded_dtype(element: HostType, layout: Layout, stride: int) -> np.dtype[Any]:
    dtype = dtype_of(element, layout)
    if dtype.itemsize == stride:
        return dtype
    scalar = element if isinstance(element, ScalarType) else getattr(element, "scalar", FLOAT)
    return np.dtype(("<" + scalar.code, (stride // 4,)))


def scalar_offsets(type: HostType, layout: Layout, start: int = 0) -> Iterator[tuple[int, str]]:
    """Yield (byte offset, NumPy code) for each scalar of a value, in order and without padding."""
    placement = memory_layout(type, layout)
    match type:
        case ScalarType(code=code):
            yield start, code
        case VectorType(scalar=scalar, size=size):
            yield from ((start + 4 * i, scalar.code) for i in range(size))
        case MatrixType(size=size):
            rows = range(start, start + size * placement.stride, placement.stride)
            yield from ((row + 4 * column, FLOAT.code) for row in rows for column in range(size))
        case ArrayType(element=element, length=length):
            for i in range(length):
                yield from scalar_offsets(element, layout, start + i * placement.stride)
        case StructType(fields=fields):
            for field, offset in zip(fields, placement.offsets, strict=True):
                yield from scalar_offsets(field.type, layout, start + offset)


# -- comparing ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FieldLayout:
    """A row of a layout table: a field with its byte offset and NumPy type."""

    name: str
    offset: int
    type: str


def describe_layout(dtype: np.dtype[Any], prefix: str = "", start: int = 0) -> Iterator[FieldLayout]:
    """Yield the fields of a dtype with their offsets from its start. Fields of nested structs have dotted
    names."""
    base, shape = dtype.subdtype if dtype.subdtype is not None else (dtype, dtype.shape)
    if base.names is None:
        yield FieldLayout(prefix or "(element)", start, base.name + (str(list(shape)) if shape else ""))
        return
    if shape:
        prefix += str(list(shape))
    for name in base.names:
        field, offset = base.fields[name][:2] if base.fields is not None else (base, 0)
        yield from describe_layout(field, f"{prefix}.{name}" if prefix else name, start + offset)


def accepts(expected: np.dtype[Any], actual: np.dtype[Any]) -> bool:
    """True if memory of dtype `actual` can be read as `expected`: elements have the same size, and each
    expected field is present with the same name, type and offset. Additional fields, such as named padding,
    are allowed."""
    if expected == actual:
        return True
    if expected.names is None or actual.names is None or expected.itemsize != actual.itemsize:
        return False
    return set(describe_layout(expected)) <= set(describe_layout(actual))


def repack(expected: np.dtype[Any], array: NDArray[Any]) -> NDArray[Any] | None:
    """Return a structured array with the offsets of `expected`, None if a name or a type differs.

    NumPy drops the padding of structs where it makes a new dtype: in `concatenate`, `append`, `hstack`. Fields
    are matched by name, those of nested structs too.
    """
    if expected.names is None or array.dtype.names is None or not _agrees(expected, array.dtype):
        return None
    packed = np.zeros(array.shape, expected)
    _copy_fields(packed, array)
    return packed


def _agrees(expected: np.dtype[Any], actual: np.dtype[Any]) -> bool:
    """True if two dtypes have the same names and types, at any depth; offsets may differ."""
    base, shape = expected.subdtype or (expected, ())
    actual_base, actual_shape = actual.subdtype or (actual, ())
    if shape != actual_shape:
        return False
    if base.names is None or actual_base.names is None:
        return base == actual_base
    if base.fields is None or actual_base.fields is None or set(base.names) != set(actual_base.names):
        return False
    return all(_agrees(base.fields[name][0], actual_base.fields[name][0]) for name in base.names)


def _copy_fields(target: NDArray[Any], source: NDArray[Any]) -> None:
    if target.dtype.names is None:
        target[...] = source
        return
    for name in target.dtype.names:
        _copy_fields(target[name], source[name])


def compare_layouts(expected: np.dtype[Any], actual: np.dtype[Any]) -> str:
    """Return a table of two layouts side by side: field, offset and type, with a mark where they differ."""
    left = {row.name: row for row in describe_layout(expected)}
    right = {row.name: row for row in describe_layout(actual)}
    table = [("field", "offset", "expected", "offset", "actual", "")]
    for name in [*left, *(name for name in right if name not in left)]:
        a, b = left.get(name), right.get(name)
        differs = [
            quantity
            for quantity, wrong in (
                ("missing", b is None),
                ("not expected", a is None),
                ("offset", a is not None and b is not None and a.offset != b.offset),
                ("type", a is not None and b is not None and a.type != b.type),
            )
            if wrong
        ]
        cells = [(str(row.offset), row.type) if row is not None else ("-", "-") for row in (a, b)]
        table.append((name, *cells[0], *cells[1], "<- " + ", ".join(differs) if differs else ""))
    size = "<- size" if expected.itemsize != actual.itemsize else ""
    table.append(("(bytes)", str(expected.itemsize), "", str(actual.itemsize), "", size))
    widths = [max(len(row[column]) for row in table) for column in range(6)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
