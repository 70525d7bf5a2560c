"""The types of the language: those of `rhi.contract.layout`, which are values, and those of bindings, which aren't.

- `promote` and `converts` hold the only conversions that happen by themselves: int to float, as in Python,
  and an int literal to uint.
"""

from __future__ import annotations

from dataclasses import dataclass
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

__rhi_internal__ = True

LANGUAGE_NAMES: Final[set[str]] = set()
"""The names that shaders import from `rhi.shading`. Each module that defines some adds them when it is imported."""

VECTORS: Final = {
    (scalar, size): VectorType(scalar, size) for scalar in (FLOAT, INT, UINT, BOOL) for size in (2, 3, 4)
}
MATRICES: Final = {size: MatrixType(size) for size in (2, 3, 4)}
VEC4: Final = VECTORS[FLOAT, 4]


@dataclass(frozen=True, slots=True)
class VoidType:
    """What a function without a value returns."""

    def __str__(self) -> str:
        return "None"


VOID: Final = VoidType()


@dataclass(frozen=True, slots=True)
class TextureType:
    """A sampled texture; `compare` makes it a depth texture whose samples are comparisons."""

    kind: TextureKind
    scalar: ScalarType = FLOAT
    compare: bool = False

    def __str__(self) -> str:
        shape = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}[self.kind.value]
        prefix = "Depth" if self.compare else {FLOAT: "", INT: "Int", UINT: "Uint"}[self.scalar]
        return f"{prefix}Texture{shape}"


@dataclass(frozen=True, slots=True)
class ImageType:
    """A texture level that is loaded from and stored to by texel."""

    kind: TextureKind
    format: Format

    @property
    def scalar(self) -> ScalarType:
        """The type of a component in the shader."""
        return {ChannelKind.INT: INT, ChannelKind.UINT: UINT}.get(self.format.kind, FLOAT)

    def __str__(self) -> str:
        shape = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}[self.kind.value]
        return f"{ {FLOAT: '', INT: 'Int', UINT: 'Uint'}[self.scalar] }Image{shape}"


@dataclass(frozen=True, slots=True)
class StorageType:
    """A storage buffer: as many elements as are bound."""

    element: HostType
    writable: bool

    def __str__(self) -> str:
        return f"{'StorageRW' if self.writable else 'Storage'}[{self.element}]"


ValueType: TypeAlias = HostType | VoidType
Type: TypeAlias = HostType | VoidType | TextureType | ImageType | StorageType


def is_value(type: Type) -> bool:
    """Whether values of this type can be stored in variables."""
    return isinstance(type, ScalarType | VectorType | MatrixType | ArrayType | StructType)


def scalar_of(type: Type) -> ScalarType | None:
    """The scalar type of a scalar's or vector's components; None for others."""
    if isinstance(type, ScalarType):
        return type
    return type.scalar if isinstance(type, VectorType) else None


def with_scalar(type: ScalarType | VectorType, scalar: ScalarType) -> ScalarType | VectorType:
    """The scalar or vector type of the same size with other components."""
    return scalar if isinstance(type, ScalarType) else VECTORS[scalar, type.size]


def converts(source: Type, target: Type, literal: bool = False) -> bool:
    """Whether a value of `source` is taken where `target` is wanted; `literal`: a non-negative int literal."""
    return (
        source == target
        or (source is INT and target is FLOAT)
        or (literal and source is INT and target is UINT)
    )
