"""The constructor that is generated for a struct of scalars, vectors and matrices.

- Checking and converting field by field takes ten times as long as the draw that uses the constants. The
  generated constructor unpacks all fields at once and packs them as a uniform block (std140); `struct.pack`
  checks the values.
- It accepts the usual cases only. The struct itself handles all others field by field, refusals included.
- NumPy's complex and masked numbers convert to floats with no more than a warning, and sets unpack in any
  order. So the types of numbers and sequences are among the usual ones, or the struct looks closer.
- The numbers are stored as passed, a matrix as its bytes. Fields are created when one is read or set.
"""

from __future__ import annotations

import builtins
import struct
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

import numpy as np

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    Field,
    Layout,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
    memory_layout,
)
from rhi.shading.language.vectors import CLASSES, uint

MISSING: Final = object()
"""The value of a field that was not passed."""

_CODES: Final = {"f4": "f", "i4": "i", "u4": "I"}
_FLOAT: Final = np.dtype("<f4")
_KINDS: Final[dict[object, type]] = {FLOAT: float, INT: int, UINT: int}
_NUMBERS: Final = frozenset(
    {float, int, bool, uint, bytes, np.bool_, np.float16, np.float32, np.float64}
    | {getattr(np, f"{sign}int{bits}") for sign in ("", "u") for bits in (8, 16, 32, 64)}
)
"""Types of numbers that `struct.pack` converts exactly or refuses, and that of the bytes of matrices."""
_SEQUENCES: Final = frozenset({tuple, list, np.ndarray, *CLASSES.values()})
_PACK_ROWS: Final = {size: struct.Struct("<" + f"{size}f{16 - 4 * size}x" * size).pack for size in (2, 3, 4)}
"""By size, what packs the numbers of a matrix, whose rows are 16 bytes; too large ones are an
OverflowError."""
_ERRORS: Final = (TypeError, ValueError, OverflowError, struct.error, Warning)
"""Exceptions that unpacking and packing raise for unusual values; warnings, where a program turns them into
errors."""


def make_constructor(
    owner: type, type: StructType, defaults: Mapping[str, Any]
) -> Callable[..., None] | None:
    """Return the `__init__` of a struct class, or None if a field is no scalar, vector or matrix.

    The constructor sets `_numbers` and `_bytes` of the value, or calls `_set_fields(values)`.
    """
    if not type.fields or not all(map(_is_simple, type.fields)):
        return None
    unpack, names, parameters = [], [], []
    checks: list[str] = []
    numbers: dict[Any, list[str]] = {float: [], int: [], bytes: []}
    scope: dict[str, Any] = {
        "__rhi_internal__": True,
        "__name__": __name__,
        "_errors": _ERRORS,
        "_owner": owner,
        "_bytes_of": _matrix_bytes,
        "_pack": struct.Struct(_format_of(type)).pack,
        "_are_numbers": _NUMBERS.issuperset,
        "_sequences": _SEQUENCES,
        "_type": builtins.type,
        "_float": float,
        "_int": int,
        "_map": map,
    }
    for i, field in enumerate(type.fields):
        parts = [f"_{i}_{j}" for j in range(_count(field))]
        if isinstance(field.type, MatrixType):
            unpack.append(f"            {parts[0]} = _bytes_of({field.name}, {field.type.size})")
        elif isinstance(field.type, VectorType):
            unpack.append(f"            {', '.join(parts)} = {field.name}")
            checks.append(f"_type({field.name}) in _sequences")
        else:
            parts = [field.name]
        names += parts
        scalar = getattr(field.type, "scalar", field.type)
        numbers[_KINDS.get(scalar, bytes)] += parts
        scope[f"_default_{i}"] = defaults.get(field.name, MISSING)
        parameters.append(f"{field.name}=_default_{i}")
    usual = " and ".join(
        " is ".join([*(f"_type({part})" for part in parts), f"_{kind.__name__}"])
        for kind, parts in numbers.items()
        if parts and kind is not bytes
    )
    if usual:  # asking for the usual types one by one takes a quarter of the time of asking all at once
        checks.append(f"({usual} or _are_numbers(_map(_type, _numbers)))")
    entries = ", ".join(f"{field.name!r}: {field.name}" for field in type.fields)
    lines = [
        f"def __init__(_self, /, *, {', '.join(parameters)}, **_unknown):",
        "    if not _unknown and _self.__class__ is _owner:",
        "        try:",
        *unpack,
        f"            _numbers = ({', '.join(names)},)",
        f"            if {' and '.join(checks) or 'True'}:",
        "                _self._bytes = _pack(*_numbers)",
        "                _self._numbers = _numbers",
        "                return",
        "        except _errors:",
        "            pass",
        f"    _self._set_fields({{{entries}, **_unknown}})",
    ]
    exec(compile("\n".join(lines), f"<constructor of {type.name}>", "exec"), scope)
    constructor: Callable[..., None] = scope["__init__"]
    return constructor


def split_numbers(type: StructType, numbers: tuple[Any, ...]) -> Iterator[tuple[Field, Any]]:
    """Yield each field with its part of a value's numbers: one, a tuple, or a square array of float32."""
    start = 0
    for field in type.fields:
        part = numbers[start : start + _count(field)]
        start += len(part)
        if isinstance(field.type, VectorType):
            yield field, part
        elif isinstance(field.type, MatrixType):
            yield field, np.frombuffer(part[0], _FLOAT).reshape(-1, 4)[:, : field.type.size]
        else:
            yield field, part[0]


def _is_simple(field: Field) -> bool:
    type = field.type
    if isinstance(type, MatrixType):
        return True
    scalar = type.scalar if isinstance(type, VectorType) else type
    return isinstance(scalar, ScalarType) and scalar is not BOOL


def _count(field: Field) -> int:
    """Return the count of numbers in a field; the bytes of a matrix are one."""
    return field.type.size if isinstance(field.type, VectorType) else 1


def _format_of(type: StructType) -> str:
    """Return the format for `struct` of a uniform block, in which a row of a matrix is 16 bytes."""
    placement, text, end = memory_layout(type, Layout.STD140), "<", 0
    for field, offset in zip(type.fields, placement.offsets, strict=True):
        scalar = field.type.scalar if isinstance(field.type, VectorType) else field.type
        part = _CODES[scalar.code] * _count(field) if isinstance(scalar, ScalarType) else ""
        part = f"{16 * field.type.size}s" if isinstance(field.type, MatrixType) else part
        text += f"{offset - end}x{part}"
        end = offset + struct.calcsize(f"<{part}")
    return f"{text}{placement.size - end}x"


def _matrix_bytes(value: Any, size: int) -> bytes:
    """Return the bytes of a square array, row by row."""
    if value.__class__ is not np.ndarray or value.shape != (size, size):
        raise TypeError
    if size == 4 and value.dtype == _FLOAT:
        return value.tobytes()
    if value.dtype.kind == "O":
        raise TypeError  # its elements may be anything
    return _PACK_ROWS[size](*value.ravel().tolist())
