"""Python values as constants of the typed tree: numbers, vectors, structs, and tuples and NumPy arrays of
them.

A NumPy array is a constant array of numbers, or of vectors if its rows have 2 to 4 numbers. An array that
might as well be a vector or a matrix is refused, and `tip_for` says what to write instead.
"""

from __future__ import annotations

import enum
import numbers
from typing import Any, Final

import numpy as np

from rhi.contract import layout
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression
from rhi.shading.language import rules
from rhi.shading.language.source import Source, SourceSpan
from rhi.shading.language.structs import Struct
from rhi.shading.language.types import VECTORS, scalar_of
from rhi.shading.language.vectors import Composite
from rhi.shading.parser.operators import convert

MAX_CONSTANTS: Final = 16_384
"""The greatest number of scalars in a constant array: 64 KiB, the constant memory that OpenCL guarantees."""

_KINDS: Final = {"f": layout.FLOAT, "i": layout.INT, "u": layout.UINT, "b": layout.BOOL}


def constant(value: Any, span: SourceSpan, name: str, source: Source) -> Expression | None:
    """Return a Python value as a constant, or None if it can't be one."""
    if isinstance(value, enum.Enum) and isinstance(value, int):
        value = int(value)
    if isinstance(value, np.ndarray):
        return _numpy_constant(value, span, name, source)
    if isinstance(value, bool | np.bool_):
        return Constant(layout.BOOL, span, bool(value))
    if isinstance(value, numbers.Integral):
        if isinstance(getattr(type(value), "shading_type", None), layout.ScalarType):
            return Constant(layout.UINT, span, int(value))
        if not -(2**31) <= int(value) < 2**32:
            source.refuse(rules.OUT_OF_RANGE, span, str(value), "32 bits")
        return Constant(layout.INT, span, int(value), literal=True)
    if isinstance(value, numbers.Real):
        return Constant(layout.FLOAT, span, float(value))
    if isinstance(value, Composite):
        scalar = scalar_of(value.shading_type) or layout.FLOAT
        parts = [Constant(scalar, span, component) for component in value.components]
        return tree.Construct(value.shading_type, span, tuple(parts))
    if isinstance(value, Struct):
        return _typed(value.shading_type, value, span)
    if isinstance(value, tuple) and value:
        return _constant_array(value, span, name, source)
    return None


def _constant_array(value: tuple[Any, ...], span: SourceSpan, name: str, source: Source) -> Expression | None:
    _check_size(len(value), span, name, source)
    elements = [constant(part, span, name, source) for part in value]
    types = [element.type for element in elements if element is not None]
    if len(types) != len(elements):
        return None
    element_type = layout.FLOAT if set(types) == {layout.INT, layout.FLOAT} else types[0]
    converted = [convert(element, element_type) for element in elements if element is not None]
    if any(element is None for element in converted) or not isinstance(
        element_type, layout.ScalarType | layout.VectorType
    ):
        return None
    parts = tuple(element for element in converted if element is not None)
    _check_size(len(parts) * getattr(element_type, "size", 1), span, name, source)
    return tree.ConstantArray(layout.ArrayType(element_type, len(parts)), span, name, parts)


def _numpy_constant(
    value: np.ndarray[Any, Any], span: SourceSpan, name: str, source: Source
) -> Expression | None:
    if value.dtype.kind not in _KINDS or _alternatives(value):
        return None
    if value.ndim == 0:
        return constant(value.item(), span, name, source)
    _check_size(value.size, span, name, source)
    scalar, rows = _KINDS[value.dtype.kind], value.tolist()
    numbers_of_array = [number for row in rows for number in row] if value.ndim == 2 else rows
    for number in numbers_of_array if scalar in (layout.INT, layout.UINT) else ():
        if not -(2**31) * (scalar is layout.INT) <= number < 2 ** (31 + (scalar is layout.UINT)):
            source.refuse(rules.OUT_OF_RANGE, span, str(number), f"{scalar}: 32 bits")
    if value.ndim == 1:
        parts: list[Expression] = [Constant(scalar, span, number) for number in rows]
        return tree.ConstantArray(layout.ArrayType(scalar, len(parts)), span, name, tuple(parts))
    vector = VECTORS[scalar, value.shape[1]]
    parts = [tree.Construct(vector, span, tuple(Constant(scalar, span, n) for n in row)) for row in rows]
    return tree.ConstantArray(layout.ArrayType(vector, len(parts)), span, name, tuple(parts))


def _check_size(scalars: int, span: SourceSpan, name: str, source: Source) -> None:
    if scalars > MAX_CONSTANTS:
        actual, allowed = f"{name}, {scalars} numbers", f"up to {MAX_CONSTANTS} numbers"
        source.refuse(
            rules.TOO_LARGE, span, actual, allowed, "pass it in a buffer: Storage[…], or in a texture"
        )


def _typed(type: layout.HostType, value: Any, span: SourceSpan) -> Expression:
    """Return a struct's value as a constant. Its fields were converted to their types when they were set."""
    match type:
        case layout.StructType(fields=fields):
            parts = tuple(_typed(field.type, getattr(value, field.name), span) for field in fields)
        case layout.ArrayType(element=element):
            parts = tuple(_typed(element, part, span) for part in value)
        case layout.VectorType() | layout.MatrixType():
            numbers_of_value = np.ravel(np.asarray(value)).tolist()
            scalar = scalar_of(type) or layout.FLOAT
            parts = tuple(Constant(scalar, span, number) for number in numbers_of_value)
        case layout.ScalarType():
            return Constant(type, span, value.item() if isinstance(value, np.generic) else value)
    return tree.Construct(type, span, parts)


def tip_for(value: Any, name: str) -> str:
    """Return a tip: what to write instead of a Python value that can't be a constant."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in _KINDS or not value.size or value.ndim > 2:
            return "pass it in a buffer: Storage[…], or in a texture"
        return (
            " or ".join(_alternatives(value)).format(name)
            or "pass it in a buffer: Storage[…], or in a texture"
        )
    if isinstance(value, list):
        return f"a constant array is a tuple: tuple({name})"
    if isinstance(value, complex | np.complexfloating):
        return "a complex number is a vec2 of its real and imaginary part"
    return "functions and types can be called, but not used as values" if callable(value) else ""


def _alternatives(value: np.ndarray[Any, Any]) -> list[str]:
    """Return the Python expressions that an ambiguous array may stand for, with {} for its name."""
    prefix = {"f": "", "i": "i", "u": "u", "b": "b"}.get(value.dtype.kind, "")
    size = value.shape[-1] if value.ndim else 0
    if value.ndim == 1 and 2 <= size <= 4:
        return [f"{prefix}vec{size}(*{{0}}) for a vector", "tuple({0}.tolist()) for a constant array"]
    if value.ndim == 2 and value.shape == (size, size) and 2 <= size <= 4 and not prefix:
        rows = f"tuple(vec{size}(*row) for row in {{0}})"
        return [f"mat{size}({{0}}) for a matrix", f"{rows} for a constant array"]
    if value.size == 0 or value.ndim > 2 or (value.ndim == 2 and not 2 <= size <= 4):
        return ["a buffer: Storage[…]"]
    return []
