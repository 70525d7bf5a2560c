"""The definition of arrays and real numbers, wherever values come in from Python.

NumPy converts more than a device should accept, often in silence: it drops the imaginary part of complex
numbers and the mask of masked arrays, parses text, and reads sets in any order. These functions refuse all of
that; their callers turn the error into a rule's.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping, Set
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.errors.device_objects import DeviceObject

TOO_LARGE: Final = 3.4028235677973366e38
"""Smallest magnitude that rounds to infinity in a 32-bit float."""
_REAL_KINDS: Final = "fiub"
"""Kinds of dtypes whose elements are real numbers; a bool counts as 0 or 1."""
_MASK_REASON: Final = "masked elements have no value: array.filled(0) gives them one"


def to_array(value: Any) -> NDArray[Any]:
    """Return an array-like as an array, of any dtype.

    Raises:
        TypeError, ValueError: it has a mask, no order or no shape; or it is a buffer or a texture, which would
            be read here without the user's knowledge.
    """
    if value.__class__ is np.ndarray:
        array: NDArray[Any] = value
        return array
    if isinstance(value, DeviceObject):
        raise TypeError(
            f"a {type(value).__name__}: read() returns its contents, copy_to copies on the device"
        )
    check_order(value)
    try:
        array = np.asarray(value)
    except Exception as error:  # a masked integer, too large a number, a warning that is an error
        raise TypeError(str(error)) from error
    if isinstance(value, (list, tuple)) and _has_mask(value, array):
        raise TypeError(_MASK_REASON)
    return array


def to_real_array(value: Any) -> NDArray[Any]:
    """Return an array-like of real numbers as an array.

    Raises:
        TypeError, ValueError: as `to_array`; or it has elements that aren't real numbers.
    """
    array = to_array(value)
    if array.dtype.kind not in _REAL_KINDS:
        raise TypeError(f"numbers of {array.dtype}, which aren't real")
    return array


def to_real(value: Any) -> Any:
    """Return a real number as it was given, or a number of Python's for an array without dimensions.

    Raises:
        TypeError: it is no real number: complex, masked, text, a date, an array.
    """
    if isinstance(value, (float, int)):
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        if is_masked(value):
            raise TypeError(_MASK_REASON)
        if value.ndim or value.dtype.kind not in _REAL_KINDS:
            raise TypeError("no real number")
        return value.item()
    if not (hasattr(type(value), "__float__") or hasattr(type(value), "__index__")):
        raise TypeError("no real number")
    return value


def is_masked(value: Any) -> bool:
    """True if a value is an array with a mask. A program without any hasn't imported their module."""
    masked = getattr(sys.modules.get("numpy.ma"), "MaskedArray", None)  # another thread may be importing it
    return masked is not None and isinstance(value, masked)


def check_order(value: Any) -> None:
    """Refuse what has no order, or a mask.

    Raises:
        TypeError: for sets, mappings, iterators, masked arrays, and bytes that can be written.
    """
    if isinstance(value, bytearray):  # NumPy takes each byte for a number, but `bytes` for text
        raise TypeError("bytes aren't numbers: numpy.frombuffer(value, dtype) reads numbers from them")
    if is_masked(value):
        raise TypeError(_MASK_REASON)
    if isinstance(value, (Set, Mapping)) or (hasattr(value, "__next__") and not hasattr(value, "__array__")):
        raise TypeError(
            "its elements have no order" if isinstance(value, Collection) else "it can be read only once"
        )


def _has_mask(items: Collection[Any], array: NDArray[Any]) -> bool:
    """True if nested lists have an array with a mask among them.

    Their numbers are looked at only if one became NaN, as a masked one does.
    """
    depth = array.ndim - 1
    if array.dtype.kind == "f" and np.isnan(array).any():
        depth += 1
    return _has_mask_within(items, depth)


def _has_mask_within(items: Collection[Any], depth: int) -> bool:
    if depth < 1:
        return False
    return any(
        is_masked(item) or (isinstance(item, (list, tuple)) and _has_mask_within(item, depth - 1))
        for item in items
    )
