"""Types that CPU and device share, and where their parts lie in memory.

- A type says what a value is (`VectorType(FLOAT, 3)`); a `Layout` says how it lies in memory: std140 for
  uniform blocks, std430 for storage and vertices, PACKED for neither. `place` gives offsets and strides
  (OpenGL 4.3, section 7.6.2.2), `dtype_of` the same as a NumPy dtype, padding included.
- Matrices lie row by row, as in NumPy, so `M` uploaded as it is gives `M @ v` in a shader. A row is padded
  like a vector: a `mat3` is float32 (3, 4), with a column that nobody reads.
- `compare_layouts` prints two dtypes side by side: why an array can't be uploaded as it is.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, TypeAlias

import numpy as np

__rhi_internal__ = True


class Layout(enum.Enum):
    """How a type lies in memory."""

    STD140 = "std140"
    STD430 = "std430"
    PACKED = "packed"

    __hash__ = object.__hash__


@dataclass(frozen=True, slots=True)
class ScalarType:
    """A bool, int, uint or float of 32 bits. A bool has no size: memory can't be shared through it."""

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
    """2 to 4 components of one scalar type."""

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
    """`length` elements of one type."""

    element: HostType
    length: int

    def __str__(self) -> str:
        return f"{self.element}[{self.length}]"


@dataclass(frozen=True, slots=True)
class Field:
    """A named part of a struct."""

    name: str
    type: HostType


@dataclass(frozen=True, slots=True)
class StructType:
    """Named fields in order."""

    name: str
    fields: tuple[Field, ...]

    def field(self, name: str) -> Field | None:
        """The field of that name, or None."""
        return next((field for field in self.fields if field.name == name), None)

    def __str__(self) -> str:
        return self.name


HostType: TypeAlias = ScalarType | VectorType | MatrixType | ArrayType | StructType


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a type lies: all in bytes.

    `stride` is the distance between the elements of an array or the rows of a matrix, 0 for others;
    `offsets` are those of a struct's fields.
    """

    size: int
    alignment: int
    stride: int = 0
    offsets: tuple[int, ...] = ()


def round_up(value: int, alignment: int) -> int:
    """The smallest multiple of `alignment` that is not below `value`."""
    return -(-value // alignment) * alignment


def is_host_shareable(type: HostType) -> bool:
    """Whether the type has a layout: whether no bool is in it."""
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
            return all(is_host_shareable(field.type) for field in fields)


@lru_cache(maxsize=4096)
def place(type: HostType, layout: Layout) -> Placement:
    """Size, alignment, stride and offsets of `type` in `layout`.

    Raises:
        TypeError: a bool is in it; sizes of bools differ between devices.
    """
    packed, rounded = layout is Layout.PACKED, layout is Layout.STD140
    match type:
        case ScalarType():
            if type is BOOL:
                raise TypeError("a bool has no layout in memory; use a uint")
            return Placement(4, 4)
        case VectorType(scalar=scalar, size=size):
            if scalar is BOOL:
                raise TypeError("a vector of bools has no layout in memory; use a vector of uint")
            return Placement(4 * size, 4 if packed else 8 if size == 2 else 16)
        case MatrixType(size=size):
            rows = place(ArrayType(VectorType(FLOAT, size), size), layout)
            return Placement(rows.size, rows.alignment, rows.stride)
        case ArrayType(element=element, length=length):
            part = place(element, layout)
            alignment = round_up(part.alignment, 16) if rounded else part.alignment
            stride = round_up(part.size, alignment)
            return Placement(stride * length, alignment, stride)
        case StructType(fields=fields):
            end, alignment, offsets = 0, 16 if rounded else 4, []
            for field in fields:
                part = place(field.type, layout)
                offset = round_up(end, part.alignment)
                offsets.append(offset)
                end, alignment = offset + part.size, max(alignment, part.alignment)
            return Placement(round_up(end, alignment), alignment, 0, tuple(offsets))


def stride_of(type: HostType, layout: Layout) -> int:
    """Bytes from one element to the next where `type` is an array's element (a storage buffer's, say)."""
    return place(ArrayType(type, 1), layout).stride


def shape_of(type: HostType) -> tuple[int, ...]:
    """The natural shape of a value, without padding: () for a scalar or struct, (3, 3) for a `mat3`."""
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
    """The NumPy dtype of one value, padding included.

    A struct gives a structured dtype with its offsets and size; a vector or matrix a subarray, where a
    padded row or element has more columns than the natural shape (`mat3`: float32 (3, 4); a std140 array
    of n floats: float32 (n, 4)).
    """
    placement = place(type, layout)
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
    """The NumPy dtype of one element of an array of `type`: `dtype_of`, padded to the stride."""
    return _padded_dtype(type, layout, stride_of(type, layout))


def _padded_dtype(element: HostType, layout: Layout, stride: int) -> np.dtype[Any]:
    dtype = dtype_of(element, layout)
    if dtype.itemsize == stride:
        return dtype
    scalar = element if isinstance(element, ScalarType) else getattr(element, "scalar", FLOAT)
    return np.dtype(("<" + scalar.code, (stride // 4,)))


def scalar_places(type: HostType, layout: Layout, start: int = 0) -> Iterator[tuple[int, str]]:
    """(byte offset, NumPy code) of each scalar of a value, in order, padding left out."""
    placement = place(type, layout)
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
                yield from scalar_places(element, layout, start + i * placement.stride)
        case StructType(fields=fields):
            for field, offset in zip(fields, placement.offsets, strict=True):
                yield from scalar_places(field.type, layout, start + offset)


# -- comparing ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a layout table: one field, its byte offset and NumPy type."""

    name: str
    offset: int
    type: str


def describe_layout(dtype: np.dtype[Any], prefix: str = "", start: int = 0) -> Iterator[Row]:
    """The fields of a dtype with their offsets from the start, those of nested structs by dotted name."""
    base, shape = dtype.subdtype if dtype.subdtype is not None else (dtype, dtype.shape)
    if base.names is None:
        yield Row(prefix or "(element)", start, base.name + (str(list(shape)) if shape else ""))
        return
    if shape:
        prefix += str(list(shape))
    for name in base.names:
        field, offset = base.fields[name][:2] if base.fields is not None else (base, 0)
        yield from describe_layout(field, f"{prefix}.{name}" if prefix else name, start + offset)


def accepts(wanted: np.dtype[Any], given: np.dtype[Any]) -> bool:
    """Whether elements of `given` are elements of `wanted` as they lie: every wanted field has its name, type and
    offset, and elements are of one size. More fields, such as named padding, do no harm."""
    if wanted == given:
        return True
    if wanted.names is None or given.names is None or wanted.itemsize != given.itemsize:
        return False
    return set(describe_layout(wanted)) <= set(describe_layout(given))


def compare_layouts(wanted: np.dtype[Any], given: np.dtype[Any]) -> str:
    """Two layouts side by side: field, offset and type of each, with a mark where they differ."""
    left = {row.name: row for row in describe_layout(wanted)}
    right = {row.name: row for row in describe_layout(given)}
    table = [("field", "offset", "wanted", "offset", "given", "")]
    for name in [*left, *(name for name in right if name not in left)]:
        a, b = left.get(name), right.get(name)
        differs = [
            what
            for what, wrong in (
                ("missing", b is None),
                ("not wanted", a is None),
                ("offset", a is not None and b is not None and a.offset != b.offset),
                ("type", a is not None and b is not None and a.type != b.type),
            )
            if wrong
        ]
        cells = [(str(row.offset), row.type) if row is not None else ("-", "-") for row in (a, b)]
        table.append((name, *cells[0], *cells[1], "<- " + ", ".join(differs) if differs else ""))
    size = "<- size" if wanted.itemsize != given.itemsize else ""
    table.append(("(bytes)", str(wanted.itemsize), "", str(given.itemsize), "", size))
    widths = [max(len(row[column]) for row in table) for column in range(6)]
    return "\n".join(
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in table
    )
