"""The types of the shading language: the value types of `rhi.contract.layout`, and the types of bindings.

- `converts` knows the only implicit conversions: int to float, as in Python, and a non-negative int literal
  to uint.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    HostType,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
)
from rhi.errors.data_classes import dataclass

LANGUAGE_NAMES: Final[set[str]] = set()
"""The names that shaders import from `rhi.shading`. Each module adds its own names when it is imported."""

VECTORS: Final = {
    (scalar, size): VectorType(scalar, size) for scalar in (FLOAT, INT, UINT, BOOL) for size in (2, 3, 4)
}
MATRICES: Final = {size: MatrixType(size) for size in (2, 3, 4)}
VEC4: Final = VECTORS[FLOAT, 4]


@dataclass(frozen=True, slots=True)
class VoidType:
    """The result type of a function that returns no value."""

    def __str__(self) -> str:
        return "None"


VOID: Final = VoidType()


@dataclass(frozen=True, slots=True)
class TextureType:
    """A sampled texture. With `compare`, a depth texture whose samples are results of a depth comparison.
    With `samples`, a texture of several samples, which are read one by one. With `table`, the pages of a
    texture table."""

    kind: TextureKind
    scalar: ScalarType = FLOAT
    compare: bool = False
    samples: bool = False
    table: bool = False

    def __str__(self) -> str:
        shape = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}[self.kind.value]
        if self.table:
            return "TextureTable"
        prefix = "Depth" if self.compare else {FLOAT: "", INT: "Int", UINT: "Uint"}[self.scalar]
        return f"{prefix}Texture{shape}{'Samples' if self.samples else ''}"


@dataclass(frozen=True, slots=True)
class ImageType:
    """A mip level of a texture that shaders load from and store to, texel by texel."""

    kind: TextureKind
    format: Format

    @property
    def scalar(self) -> ScalarType:
        """Scalar type of a texel's components in the shader."""
        return {ChannelKind.INT: INT, ChannelKind.UINT: UINT}.get(self.format.kind, FLOAT)

    def __str__(self) -> str:
        shape = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}[self.kind.value]
        return f"{ {FLOAT: '', INT: 'Int', UINT: 'Uint'}[self.scalar] }Image{shape}"


@dataclass(frozen=True, slots=True)
class StorageType:
    """An array in a storage buffer, as long as the bound range."""

    element: HostType
    writable: bool

    def __str__(self) -> str:
        return f"{'StorageRW' if self.writable else 'Storage'}[{self.element}]"


Type: TypeAlias = HostType | VoidType | TextureType | ImageType | StorageType


def stored_kind(type: TextureType | ImageType) -> TextureKind:
    """Return the kind of a texture in memory, where samples are the layers of an array."""
    several = isinstance(type, TextureType) and type.samples
    return TextureKind.D2_ARRAY if several else type.kind


def is_value(type: Type) -> bool:
    """Return whether variables can hold values of this type."""
    return isinstance(type, ScalarType | VectorType | MatrixType | ArrayType | StructType)


def count_scalars(type: HostType) -> int:
    """Return the number of scalars of a value, including all elements of arrays."""
    match type:
        case ArrayType(element=element, length=length):
            return length * count_scalars(element)
        case StructType(fields=fields):
            return sum(count_scalars(field.type) for field in fields)
        case MatrixType(size=size):
            return size**2
    return type.size if isinstance(type, VectorType) else 1


def has_array(type: HostType) -> bool:
    """Return whether a value is an array or a struct that contains one."""
    if isinstance(type, StructType):
        return any(has_array(field.type) for field in type.fields)
    return isinstance(type, ArrayType)


def count_elements(type: Type) -> int:
    """Return the number of elements that can be indexed, 0 if it depends on the bound buffer."""
    return type.length if isinstance(type, ArrayType) else getattr(type, "size", 0)


def scalar_of(type: Type) -> ScalarType | None:
    """Return the scalar type of a scalar's or vector's components, or None for other types."""
    if isinstance(type, ScalarType):
        return type
    return type.scalar if isinstance(type, VectorType) else None


def with_scalar(type: ScalarType | VectorType, scalar: ScalarType) -> ScalarType | VectorType:
    """Return the scalar or vector type of the same size with components of type `scalar`."""
    return scalar if isinstance(type, ScalarType) else VECTORS[scalar, type.size]


def converts(source: Type, target: Type, literal: bool = False) -> bool:
    """Return whether a value of type `source` is accepted where `target` is expected.

    `literal`: the value is a non-negative int literal.
    """
    return (
        source == target
        or (source is INT and target is FLOAT)
        or (literal and source is INT and target is UINT)
    )
