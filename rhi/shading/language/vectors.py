"""Vectors, matrices, arrays and `uint` in Python: annotations and constructors in shaders, constants on the
CPU.

- The stub beside this file (`vectors.pyi`, written by `rhi.shading.tools.stubs`) declares their operators,
  swizzles and conversions in a shader. On the CPU they only hold components, so that `SKY = vec3(0.2, 0.4,
  0.9)` at module level is a constant that shaders can use. For arithmetic on the CPU, convert to NumPy:
  `numpy.asarray(SKY)`.
- `Array` is the type of arrays. `array` creates one in a shader, and gives an array field of a struct its
  length.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from rhi.contract.layout import BOOL, FLOAT, INT, UINT, HostType
from rhi.errors import ShaderError, describe_value
from rhi.errors.array_likes import TOO_LARGE, to_real, to_real_array
from rhi.shading.language.rules import VECTOR_VALUE
from rhi.shading.language.types import LANGUAGE_NAMES, MATRICES, VECTORS

__all__ = sorted(
    ["Array", "ReadOnlyArray", "array", "uint", *map(str, [*VECTORS.values(), *MATRICES.values()])]
)
LANGUAGE_NAMES.update(__all__)

T = TypeVar("T")


class uint(int):  # noqa: N801 (named like int)
    """An unsigned 32-bit integer. Its arithmetic wraps around in shaders."""

    shading_type: ClassVar[HostType] = UINT


class Composite:
    """Base class of vectors and matrices: a tuple of components with a type and a shape."""

    __slots__ = ("components",)
    shading_type: ClassVar[Any]
    shape: ClassVar[tuple[int, ...]]
    convert: ClassVar[Callable[[Any], Any]]

    def __init__(self, *parts: object) -> None:
        try:
            self.components = self._read(parts)
        except (TypeError, ValueError, OverflowError) as error:
            call = f"{type(self).__name__}({', '.join(map(describe_value, parts))})"
            raise ShaderError(VECTOR_VALUE, call, str(error)) from None

    def _read(self, parts: tuple[object, ...]) -> tuple[Any, ...]:
        """Return the components that these numbers and sequences have together."""
        flat: list[Any] = []
        for part in parts:
            if isinstance(part, int | float):
                flat.append(part)
            elif hasattr(part, "__len__"):
                flat.extend(to_real_array(part).ravel().tolist())
            else:
                flat.append(to_real(part))
        size, count = self.shape[0], math.prod(self.shape)
        if len(flat) == 1:
            # A single number is copied to all components, or to a matrix's diagonal.
            scalar = flat[0]
            flat = (
                [scalar] * size if count == size else [scalar * (i % (size + 1) == 0) for i in range(count)]
            )
        if len(flat) != count:
            raise TypeError(f"{type(self).__name__} has {count} components, not {len(flat)}")
        components = tuple(map(self.convert, flat))
        if self.convert is float and any(TOO_LARGE <= abs(number) < math.inf for number in components):
            raise OverflowError("out of range for a 32-bit float")
        return components

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        code = getattr(self.shading_type, "scalar", FLOAT).code or "?"
        return np.array(self.components, dtype or code).reshape(self.shape)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.components if len(self.shape) == 1 else np.asarray(self))

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int) -> Any:
        return self.components[index] if len(self.shape) == 1 else np.asarray(self)[index]

    def __getattr__(self, name: str) -> Any:
        axes = "xyzw" if name and name[0] in "xyzw" else "rgba"
        indices = [axes.find(letter) for letter in name]
        if len(self.shape) == 2 or len(name) > 4 or min(indices) < 0 or max(indices) >= len(self.components):
            raise AttributeError(f"{type(self).__name__} has no component {name!r}")
        parts = tuple(self.components[index] for index in indices)
        return parts[0] if len(parts) == 1 else CLASSES[self.shading_type.scalar, len(parts)](*parts)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self.components == other.components

    def __hash__(self) -> int:
        return hash((type(self), self.components))

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(map(repr, self.components))})"


CLASSES: dict[Any, Any] = {}
"""The vector classes by scalar type and size, the matrix classes by size."""

for _key, _type in [*VECTORS.items(), *MATRICES.items()]:
    _shape = (_key[1],) if isinstance(_key, tuple) else (_key, _key)
    CLASSES[_key] = globals()[str(_type)] = type(
        str(_type),
        (Composite,),
        {
            "__slots__": (),
            "__module__": __name__,
            "__doc__": f"{'x'.join(map(str, _shape))} components.",
            "shading_type": _type,
            "shape": _shape,
            "convert": {FLOAT: float, INT: int, UINT: int, BOOL: bool}[getattr(_type, "scalar", FLOAT)],
        },
    )


class ReadOnlyArray(Generic[T]):
    """An array that a shader can read: `len(a)`, `a[i]`."""


class Array(ReadOnlyArray[T]):
    """An array that a shader can read and write: `len(a)`, `a[i]`, `a[i] = value`."""


class ArrayLength:
    """Marker that `array(element, length)` returns: the length of an array field of a struct."""

    __slots__ = ("element", "length")

    def __init__(self, element: object, length: int) -> None:
        self.element = element
        self.length = length


def array(element: type[T], length: int) -> Any:
    """Declare an array of `length` elements.

    In a struct it gives a field its length: `weights: Array[float] = array(float, 4)`. In a shader it creates
    a local
    array of zeros: `stack = array(int, 32)`.
    """
    return ArrayLength(element, length)
