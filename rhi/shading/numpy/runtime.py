"""What NumPy lane code needs beside NumPy: memory, atomics, conversions.

Memory is 32-bit words whatever the dtype of floats, as on a device; shared and private memory of floats keeps that
dtype. All invocations of the groups that run together are at the same statement, so a barrier is nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.shading.ir.faults import make_index_error

__rhi_internal__ = True

Array = NDArray[Any]


class Invocations:
    """Those of a stage of a draw, an array of any shape; of fragments its last axes are rows and columns."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape


class Places(Invocations):
    """Which groups run, and what each invocation knows of its place."""

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
    """By value, towards zero."""
    return np.asarray(value).astype(dtype)[()]


def as_float(value: Any, dtype: Any) -> Any:
    """The same 32 bits as a float."""
    return np.asarray(value).view(np.float32).astype(dtype)[()]


def as_integer(value: Any, dtype: Any) -> Any:
    """The same 32 bits as an integer; of a float64, those of the nearest float32."""
    array = np.asarray(value)
    return (array.astype(np.float32) if array.dtype.kind == "f" else array).view(dtype)[()]


def floor_divide(a: Any, b: Any) -> Any:
    """`//` on integers; a division by zero gives 0."""
    return np.floor_divide(a, b)


def modulo(a: Any, b: Any) -> Any:
    """`%` on integers, with the sign of `b`."""
    return np.remainder(a, b)


def bits_set(value: Any) -> Any:
    """How many bits are 1."""
    return np.bitwise_count(np.asarray(value).view(np.uint32)).astype(np.uint32)[()]


def leading_zeros(value: Any) -> Any:
    """Zeros above the highest 1, 32 of 0; of the argument's type."""
    array = np.asarray(value)
    _, exponent = np.frexp(array.view(np.uint32).astype(np.float64))
    return (32 - exponent).astype(array.dtype)[()]


def half_bits(value: Any) -> Any:
    """The bits of the nearest half float."""
    return np.asarray(value).astype(np.float16).view(np.uint16).astype(np.uint32)[()]


def half_value(bits: Any, dtype: Any) -> Any:
    """The value of a half float's bits."""
    return np.asarray(bits).astype(np.uint16).view(np.float16).astype(dtype)[()]


def fma(a: Any, b: Any, c: Any, dtype: Any) -> Any:
    """a b + c; float32 through float64, where the product is exact."""
    if dtype is np.float32:
        return (np.float64(1) * a * b + c).astype(np.float32)
    return a * b + c


def constants(values: Sequence[float], dtype: Any) -> Array:
    """A constant array."""
    return np.array(values, dtype)


# -- differences between pixels, which come in quads of 2 by 2 ---------------------------------------------


def ddx(value: Any) -> Any:
    """The change to the right, in each row of a quad."""
    if np.ndim(value) < 1 or np.shape(value)[-1] == 1:
        return np.zeros_like(value)
    return np.repeat(value[..., 1::2] - value[..., 0::2], 2, axis=-1)


def ddy(value: Any) -> Any:
    """The change downwards, in each column of a quad."""
    if np.ndim(value) < 2 or np.shape(value)[-2] == 1:
        return np.zeros_like(value)
    return np.repeat(value[..., 1::2, :] - value[..., 0::2, :], 2, axis=-2)


def quads(mask: Any) -> Any:
    """The lanes of all quads that the mask has a lane of."""
    rows = mask[..., 0::2, :] | mask[..., 1::2, :]
    both = rows[..., 0::2] | rows[..., 1::2]
    return np.repeat(np.repeat(both, 2, axis=-2), 2, axis=-1)


def check(wrong: Any, given: Any, limit: Any, mask: Any, line: tuple[str, int]) -> None:
    """Refuse an index that isn't below its limit.

    Raises:
        ShaderError `shading-index`: with the line.
    """
    wrong, given = np.broadcast_arrays(wrong if mask is None else np.logical_and(wrong, mask), given)
    if wrong.any():
        raise make_index_error(line, int(given[wrong][0] if given.ndim else given), int(limit))


# -- memory ------------------------------------------------------------------------------------------------


def _inside(address: Any, mask: Any, size: int) -> Any:
    """Addresses that can be read: those of lanes that don't take part are 0."""
    if mask is not None:
        address = np.where(mask, address, 0)
    elif size == 0:
        address = np.zeros_like(address)
    return np.clip(address, 0, max(size - 1, 0))


def load(memory: Array, address: Any, mask: Any) -> Any:
    """Elements of an array."""
    return memory[_inside(address, mask, len(memory))]


def load_words(memory: Array, address: Any, mask: Any, dtype: Any) -> Any:
    """Words of a buffer, as numbers of `dtype`."""
    address = _inside(address, mask, memory.size)
    if memory.size == 0:
        return np.zeros(np.shape(address), dtype)
    words = memory[address]
    return words.view(np.float32).astype(dtype) if dtype in _FLOATS else words.view(dtype)


_FLOATS: Final = (np.float32, np.float64)


def load_shared(memory: Array, address: Any, mask: Any, places: Places, dtype: Any) -> Any:
    """Words of each group's shared memory."""
    return _from_shared(memory[places.rows, _inside(address, mask, memory.shape[1])], dtype)


def _from_shared(values: Array, dtype: Any) -> Array:
    """Shared memory holds 64-bit words: a float64 as its bits, whatever is stored narrower in the low half."""
    if dtype is np.float64:
        return values.view(np.float64)
    low = values.astype(np.uint32)
    return low.view(dtype)


def _to_shared(values: Any) -> Array:
    array = np.asarray(values)
    return array.view(np.uint64) if array.dtype == np.float64 else array.view(np.uint32).astype(np.uint64)


def private(length: int, dtype: Any, places: Invocations | None) -> list[Any]:
    """An array that each invocation has for itself: a list, as long as its indices are single numbers."""
    return [np.zeros((), dtype)[()]] * length


def load_private(memory: list[Any], address: Any, mask: Any) -> Any:
    """Elements of each invocation's own array."""
    if np.ndim(address) == 0:
        return memory[int(np.clip(address, 0, len(memory) - 1))]
    address = _inside(address, mask, len(memory))
    result = np.broadcast_to(memory[0], np.broadcast_shapes(np.shape(address), np.shape(memory[0])))
    for index in np.unique(address).tolist():
        result = np.where(address == index, memory[index], result)
    return result


def store_private(memory: list[Any], address: Any, value: Any, mask: Any, places: Invocations | None) -> None:
    """Set elements of each invocation's own array."""
    if np.ndim(address) == 0:
        index = int(address)
        if 0 <= index < len(memory):
            memory[index] = value if mask is None else np.where(mask, value, memory[index])
        return
    for index in np.unique(_inside(address, mask, len(memory))).tolist():
        chosen = address == index if mask is None else (address == index) & mask
        memory[index] = np.where(chosen, value, memory[index])


def _taking_part(address: Any, value: Any, mask: Any, places: Invocations) -> tuple[Array, Array]:
    """Addresses and values of the lanes that take part, in order."""
    shapes = [np.shape(part) for part in (address, value, mask) if part is not None]
    shape = np.broadcast_shapes(*shapes)
    address, value = np.broadcast_to(address, shape), np.broadcast_to(value, shape)
    if mask is None:
        return address.ravel(), value.ravel()
    chosen = np.broadcast_to(mask, shape)
    return address[chosen], value[chosen]


def _words(values: Array) -> Array:
    array = values.astype(np.float32) if values.dtype == np.float64 else np.ascontiguousarray(values)
    return array.view(np.uint32)


def store(memory: Array, address: Any, value: Any, mask: Any, places: Invocations) -> None:
    """Set words of a buffer; outside it nothing happens. Of several values for a word the last one stays."""
    address, value = _taking_part(address, value, mask, places)
    inside = (address >= 0) & (address < memory.size)
    memory[address[inside]] = _words(value)[inside]


def store_shared(memory: Array, address: Any, value: Any, mask: Any, places: Places) -> None:
    """Set words of each group's shared memory."""
    address, value = _taking_part(_flat(memory, address, places), _to_shared(value), mask, places)
    flat = memory.reshape(-1)
    inside = (address >= 0) & (address < flat.size)
    flat[address[inside]] = value[inside]


def _flat(memory: Array, address: Any, places: Places) -> Any:
    return address + places.rows * memory.shape[1]


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
    places: Invocations,
    shared: bool,
    dtype: Any,
    wanted: bool,
) -> Any:
    """An atomic in the order of the invocations; the old values where they are wanted."""
    shape = places.shape
    if shared:
        assert isinstance(places, Places)
        address = _flat(memory, address, places)
    address = np.broadcast_to(address, shape)
    mask = np.broadcast_to(True if mask is None else mask, shape)
    chosen = address[mask]
    operands = [np.broadcast_to(value, shape)[mask] for value in values]
    flat = memory.reshape(-1)
    words = flat.astype(np.uint32).view(dtype) if shared else flat.view(dtype)
    ufunc = _UFUNCS.get(operation)
    if ufunc is not None and not wanted:
        ufunc.at(words, chosen, operands[0])
        old = None
    elif operation == "add":
        old = _ordered_add(words, chosen, operands[0])
    else:
        old = np.zeros(len(chosen), dtype)
        for i, where in enumerate(chosen.tolist()):
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
    """Adds and gives the old values, by sums over the runs of equal addresses."""
    order = np.argsort(address, kind="stable")
    sorted_address, sorted_values = address[order], values[order]
    before = np.cumsum(sorted_values, dtype=values.dtype) - sorted_values
    starts = np.flatnonzero(np.r_[True, sorted_address[1:] != sorted_address[:-1]]) if len(order) else order
    run = np.repeat(before[starts], np.diff(np.r_[starts, len(order)]))
    old = np.empty_like(values)
    old[order] = words[sorted_address] + (before - run)
    np.add.at(words, address, values)
    return old
