"""The runtime of lane code on NumPy: memory, atomics and conversions.

- Buffers are 32-bit words whatever the dtype of floats, as on a device. Floats in shared and private memory
  keep their dtype.
- All invocations of the groups that run together execute the same statement, so a barrier needs no code.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.math.indexing import repeat_each
from rhi.shading.ir.faults import make_index_error

Array = NDArray[Any]


class Invocations:
    """The invocations of a stage of a draw, an array of any shape; the last axes of fragments are rows and
    columns."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape


class WorkGroups(Invocations):
    """The invocations of the work-groups that run together, of shape (groups, invocations of a group).

    Attributes:
        group_id: the groups' indices, three arrays (groups, 1).
        group_count: the number of groups of the whole dispatch along each axis.
        local_index: the invocations' indices in their group, (1, invocations).
        rows: the groups' rows in shared memory, (groups, 1).
    """

    def __init__(self, first: int, count: int, groups: tuple[int, int, int], invocations: int) -> None:
        flat = np.arange(first, first + count, dtype=np.int32)[:, None]
        x, y = np.int32(groups[0]), np.int32(groups[1])
        self.group_id = (flat % x, flat // x % y, flat // (x * y))
        self.group_count = tuple(np.int32(number) for number in groups)
        self.local_index = np.arange(invocations, dtype=np.int32)[None, :]
        self.rows = np.arange(count)[:, None]
        super().__init__((count, invocations))


# -- conversions -------------------------------------------------------------------------------------------


def convert(value: Any, dtype: Any) -> Any:
    """Convert numbers by value, rounding towards zero."""
    return np.asarray(value).astype(dtype)[()]


def to_integer(value: Any, dtype: Any) -> Any:
    """Convert floats to integers, rounding towards zero: the nearest integer, and 0 for NaN."""
    array, limits = np.asarray(value, np.float64), np.iinfo(dtype)
    return np.clip(np.where(array == array, array, 0), limits.min, limits.max).astype(dtype)[()]


def as_float(value: Any, dtype: Any) -> Any:
    """Reinterpret 32 bits as a float."""
    return np.asarray(value).view(np.float32).astype(dtype)[()]


def as_integer(value: Any, dtype: Any) -> Any:
    """Reinterpret 32 bits as an integer; a float64 is rounded to float32 first."""
    array = np.asarray(value)
    return (array.astype(np.float32) if array.dtype.kind == "f" else array).view(dtype)[()]


def _divisor(a: Any, b: Any) -> Any:
    """Return `b`, with 1 in place of 0, and of -1 where `a` is the least int."""
    by_one = b == 0
    if np.asarray(b).dtype.kind == "i":
        by_one |= (b == -1) & (a == np.iinfo(np.int32).min)
    return np.where(by_one, np.ones_like(b), b)[()]


def floor_divide(a: Any, b: Any) -> Any:
    """Return `a // b` of integers."""
    return np.floor_divide(a, _divisor(a, b))


def modulo(a: Any, b: Any) -> Any:
    """Return `a % b` of integers, with the sign of `b`."""
    return np.remainder(a, _divisor(a, b))


_BITS_SET: Final = np.array([byte.bit_count() for byte in range(256)], np.uint8)


def bits_set(value: Any) -> Any:
    """Count the bits that are 1."""
    array = np.ascontiguousarray(value).reshape(np.shape(value))
    counts = _BITS_SET[array[..., None].view(np.uint8)]  # `np.bitwise_count` needs NumPy 2
    return counts.sum(-1, dtype=np.uint32)[()]


def leading_zeros(value: Any) -> Any:
    """Count the zeros above the highest 1, 32 for 0; the result has the argument's type."""
    array = np.asarray(value)
    _, exponent = np.frexp(array.view(np.uint32).astype(np.float64))
    return (32 - exponent).astype(array.dtype)[()]


def half_bits(value: Any) -> Any:
    """Return the bits of the nearest half float."""
    return np.asarray(value).astype(np.float16).view(np.uint16).astype(np.uint32)[()]


def half_value(bits: Any, dtype: Any) -> Any:
    """Return the value of a half float, given as bits."""
    return np.asarray(bits).astype(np.uint16).view(np.float16).astype(dtype)[()]


def fma(a: Any, b: Any, c: Any, dtype: Any) -> Any:
    """Return a b + c; float32 is computed in float64, where the product is exact."""
    if dtype is np.float32:
        a, b, c = (np.asarray(value, np.float64) for value in (a, b, c))
        return (a * b + c).astype(np.float32)
    return a * b + c


def constants(values: Sequence[float], dtype: Any) -> Array:
    """Return a constant array."""
    return np.array(values, dtype)


# -- differences between the pixels of a quad (2 by 2) -----------------------------------------------------


def ddx(value: Any) -> Any:
    """Return the difference from left to right, in each row of a quad."""
    if np.ndim(value) < 1 or np.shape(value)[-1] == 1:
        return np.zeros_like(value)
    return repeat_each(value[..., 1::2] - value[..., 0::2], 2, axis=-1)


def ddy(value: Any) -> Any:
    """Return the difference from top to bottom, in each column of a quad."""
    if np.ndim(value) < 2 or np.shape(value)[-2] == 1:
        return np.zeros_like(value)
    return repeat_each(value[..., 1::2, :] - value[..., 0::2, :], 2, axis=-2)


def quads(mask: Any) -> Any:
    """Extend a mask to all lanes of each quad in which it has a lane."""
    rows = mask[..., 0::2, :] | mask[..., 1::2, :]
    row_pairs = rows[..., 0::2] | rows[..., 1::2]
    return repeat_each(repeat_each(row_pairs, 2, axis=-2), 2, axis=-1)


def check(wrong: Any, value: Any, limit: Any, mask: Any, line: tuple[str, int]) -> None:
    """Check that no index reaches its limit.

    Raises:
        ShaderError `shading-index`: an index is out of range; the error names `line`, which reads it.
    """
    wrong, value = np.broadcast_arrays(wrong if mask is None else np.logical_and(wrong, mask), value)
    if wrong.any():
        raise make_index_error(line, int(value[wrong][0] if value.ndim else value), int(limit))


# -- memory ------------------------------------------------------------------------------------------------


def clamp(index: Any, size: int) -> Any:
    """Return the nearest index of an array of `size` elements, 0 if it is empty; in a third of `np.clip`'s
    time."""
    return np.minimum(np.maximum(index, 0), max(size - 1, 0))


def _readable(address: Any, mask: Any, size: int) -> Any:
    """Return addresses that are safe to read: clamped, and 0 in inactive lanes."""
    if mask is not None:
        address = np.where(mask, address, 0)
    elif size == 0:
        address = np.zeros_like(address)
    return clamp(address, size)


def load(memory: Array, address: Any, mask: Any) -> Any:
    """Read elements of an array."""
    return memory[_readable(address, mask, len(memory))]


def load_words(memory: Array, address: Any, mask: Any, dtype: Any) -> Any:
    """Read words of a buffer as numbers of `dtype`."""
    address = _readable(address, mask, memory.size)
    if memory.size == 0:
        return np.zeros(np.shape(address), dtype)
    words = memory[address]
    return words.view(np.float32).astype(dtype) if dtype in _FLOATS else words.view(dtype)


_FLOATS: Final = (np.float32, np.float64)


def load_shared(memory: Array, address: Any, mask: Any, invocations: WorkGroups, dtype: Any) -> Any:
    """Read words of each group's shared memory."""
    return _from_shared(memory[invocations.rows, _readable(address, mask, memory.shape[1])], dtype)


def _from_shared(values: Array, dtype: Any) -> Array:
    """Reinterpret 64-bit words of shared memory, which hold a float64, or a narrower type in the low half."""
    if dtype is np.float64:
        return values.view(np.float64)
    low = values.astype(np.uint32)
    return low.view(dtype)


def _to_shared(values: Any) -> Array:
    array = np.asarray(values)
    return array.view(np.uint64) if array.dtype == np.float64 else array.view(np.uint32).astype(np.uint64)


def private(length: int, dtype: Any) -> list[Any]:
    """Create a private array: a list whose elements are single numbers until invocations differ."""
    return [np.zeros((), dtype)[()]] * length


def load_private(memory: list[Any], address: Any, mask: Any) -> Any:
    """Read elements of each invocation's private array."""
    if np.ndim(address) == 0:
        return memory[int(clamp(address, len(memory)))]
    address = _readable(address, mask, len(memory))
    result = np.broadcast_to(memory[0], np.broadcast_shapes(np.shape(address), np.shape(memory[0])))
    for index in np.unique(address).tolist():
        result = np.where(address == index, memory[index], result)
    return result


def store_private(memory: list[Any], address: Any, value: Any, mask: Any) -> None:
    """Write elements of each invocation's private array."""
    if np.ndim(address) == 0:
        index = int(address)
        if 0 <= index < len(memory):
            memory[index] = value if mask is None else np.where(mask, value, memory[index])
        return
    for index in np.unique(_readable(address, mask, len(memory))).tolist():
        is_stored = address == index if mask is None else (address == index) & mask
        memory[index] = np.where(is_stored, value, memory[index])


def _active(address: Any, value: Any, mask: Any) -> tuple[Array, Array]:
    """Return the addresses and values of the active lanes, in order."""
    shapes = [np.shape(part) for part in (address, value, mask) if part is not None]
    shape = np.broadcast_shapes(*shapes)
    address, value = np.broadcast_to(address, shape), np.broadcast_to(value, shape)
    if mask is None:
        return address.ravel(), value.ravel()
    is_active = np.broadcast_to(mask, shape)
    return address[is_active], value[is_active]


def _words(values: Array) -> Array:
    array = values.astype(np.float32) if values.dtype == np.float64 else np.ascontiguousarray(values)
    return array.view(np.uint32)


def store(memory: Array, address: Any, value: Any, mask: Any) -> None:
    """Write words of a buffer; writes outside it are dropped. The last of several values for a word stays."""
    address, value = _active(address, value, mask)
    inside = (address >= 0) & (address < memory.size)
    memory[address[inside]] = _words(value)[inside]


def store_shared(memory: Array, address: Any, value: Any, mask: Any, invocations: WorkGroups) -> None:
    """Write words of each group's shared memory; writes outside it are dropped."""
    inside = (address >= 0) & (address < memory.shape[1])
    address = _flat(memory, address, invocations)
    address, value = _active(address, _to_shared(value), inside if mask is None else inside & mask)
    memory.reshape(-1)[address] = value


def _flat(memory: Array, address: Any, invocations: WorkGroups) -> Any:
    return address + invocations.rows * memory.shape[1]


_UFUNCS: Final = {
    "add": np.add,
    "min": np.minimum,
    "max": np.maximum,
    "and": np.bitwise_and,
    "or": np.bitwise_or,
    "xor": np.bitwise_xor,
}


def atomic(
    operation: str,
    memory: Array,
    address: Any,
    values: tuple[Any, ...],
    mask: Any,
    invocations: Invocations,
    shared: bool,
    dtype: Any,
    returns_old: bool,
) -> Any:
    """Execute an atomic operation in the order of the invocations; return the old values if `returns_old`.

    An operation outside the memory does nothing, and returns 0.
    """
    shape = invocations.shape
    inside = (address >= 0) & (address < memory.shape[-1])
    if shared:
        assert isinstance(invocations, WorkGroups)
        address = _flat(memory, address, invocations)
    address = np.broadcast_to(address, shape)
    mask = np.broadcast_to(inside if mask is None else inside & mask, shape)
    addresses = address[mask]
    operands = [np.broadcast_to(value, shape)[mask] for value in values]
    flat = memory.reshape(-1)
    words = flat.astype(np.uint32).view(dtype) if shared else flat.view(dtype)
    ufunc = _UFUNCS.get(operation)
    if ufunc is not None and not returns_old:
        ufunc.at(words, addresses, operands[0])
        old = None
    elif operation == "add":
        old = _ordered_add(words, addresses, operands[0])
    else:
        old = np.zeros(len(addresses), dtype)
        for i, where in enumerate(addresses.tolist()):
            before = words[where]
            old[i] = before
            if ufunc is not None:
                words[where] = ufunc(before, operands[0][i])
            elif operation == "exchange":
                words[where] = operands[0][i]
            elif before == operands[0][i]:
                words[where] = operands[1][i]
    if shared:
        flat[:] = words.view(np.uint32)
    if old is None:
        return None
    result = np.zeros(shape, dtype)
    result[mask] = old
    return result


def _ordered_add(words: Array, address: Array, values: Array) -> Array:
    """Add values and return the old ones, by prefix sums over runs of equal addresses."""
    order = np.argsort(address, kind="stable")
    sorted_address, sorted_values = address[order], values[order]
    before = np.cumsum(sorted_values, dtype=values.dtype) - sorted_values
    starts = np.flatnonzero(np.r_[True, sorted_address[1:] != sorted_address[:-1]]) if len(order) else order
    run = repeat_each(before[starts], np.diff(np.r_[starts, len(order)]))
    old = np.empty_like(values)
    old[order] = words[sorted_address] + (before - run)
    np.add.at(words, address, values)
    return old
