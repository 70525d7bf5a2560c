"""Encoding and decoding of texels, and the box filter of mip levels.

- Conversions follow the graphics APIs: clamp, scale, round to nearest. NaN becomes 0 if the format can't
  store it. They are computed in float64 and rounded once.
- sRGB formats store gamma-encoded colors and linear alpha (IEC 61966-2-1, the exact piecewise curve).
- Depth is stored as float32, rounded to values that the format can represent.
- Floats of 11 and 10 bits have no sign: 5 bits of exponent as float16, 6 and 5 of fraction. Negative numbers
  become 0, finite ones that are too large the largest (OpenGL 4.5, 2.3.4.3).
"""

from __future__ import annotations

from functools import lru_cache
from struct import Struct
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import ChannelKind, Format

_Taps: TypeAlias = tuple[NDArray[np.intp], NDArray[np.float64]]
_CLAMPING: Final = frozenset({ChannelKind.UNORM, ChannelKind.SNORM, ChannelKind.SRGB})
_PACK: Final = {count: Struct(f"{count}d").pack for count in (1, 2, 3, 4)}
_STRIP: Final = 256  # rows of a level that are filtered at once, to bound the float64 copies


def encode(format: Format, values: NDArray[np.float64]) -> NDArray[np.generic]:
    """Encode linear values (…, channels) as a format stores them: (…, components) of its dtype. The last axis
    must fit the format's channels."""
    kind = format.kind
    if format.is_packed:
        return pack(format, _encode_channels(format, np.asarray(values, np.float64)))
    if kind is ChannelKind.FLOAT:
        with np.errstate(over="ignore"):  # values that are too large become infinite
            return values.astype(format.dtype)
    values = np.where(np.isnan(values), 0.0, values)
    if format.is_depth:
        depths, steps = np.clip(values, 0.0, 1.0), format.depth_steps
        return (np.rint(depths * steps) / steps if steps else depths).astype(np.float32)
    if kind is ChannelKind.SRGB:
        values = values.copy()
        values[..., :3] = to_srgb(np.clip(values[..., :3], 0.0, 1.0))
    limits = _limits(format)
    if format.is_integer:
        scaled = values
    elif kind is ChannelKind.SNORM:
        scaled = np.clip(values, -1.0, 1.0) * limits.max
    else:
        scaled = np.clip(values, 0.0, 1.0) * limits.max
    return np.clip(np.rint(scaled), limits.min, limits.max).astype(format.dtype)


def decode(format: Format, texels: NDArray[np.generic]) -> NDArray[np.float64]:
    """Return the linear values (…, channels) of stored texels, as a shader reads them."""
    if format.is_packed:
        values = unpack(format, texels).astype(np.float64)
        return values / _largest_channels(format) if format.kind is ChannelKind.UNORM else values
    values = texels.astype(np.float64)
    kind = format.kind
    if kind in (ChannelKind.UNORM, ChannelKind.SRGB):
        values /= _limits(format).max
    elif kind is ChannelKind.SNORM:
        values = np.maximum(values / _limits(format).max, -1.0)
    if kind is ChannelKind.SRGB:
        values[..., :3] = _LINEAR[texels[..., :3]]
    return values


def nearest(format: Format, values: tuple[float, ...]) -> tuple[float, ...]:
    """Return the values that a format holds nearest to these, so that a device has nothing to round.

    `values` has one number for each channel. More are returned as they are, and so are all if the format
    can't hold them: a number out of range, or a fraction among integers.
    """
    return _nearest(format, _PACK[len(values)](*values)) or values


@lru_cache(1024)
def _nearest(format: Format, bits: bytes) -> tuple[float, ...] | None:
    """Return `nearest`, or None where the values remain; cached by the values' bits, since -0.0 equals
    0.0."""
    values = np.frombuffer(bits)
    count = format.channels
    used = values[:count]
    if format.kind not in _CLAMPING:
        low, high = np.transpose(format.channel_bounds)
        if not ((low <= used) & (used <= high)).all() or (format.is_integer and (used % 1).any()):
            return None
    stored: list[float] = decode(format, encode(format, used)).tolist()
    if format.is_integer:
        stored = [int(number) for number in stored]
    return (*stored, *values[count:].tolist())


def unpack(format: Format, texels: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return the numbers of each channel, (…, channels), of packed texels (…, 1): uint16, or float16, which
    represents all floats of 11 and 10 bits. Texels of other formats are returned as they are."""
    if not format.is_packed:
        return texels
    words = np.asarray(texels)[..., 0].astype(np.uint32)
    start = 0
    parts = []
    for bits in format.channel_bits:
        parts.append((words >> np.uint32(start)) & np.uint32((1 << bits) - 1))
        start += bits
    numbers = np.stack(parts, axis=-1).astype(np.uint16)
    if format.kind is ChannelKind.FLOAT:  # the same exponent as float16, with fewer bits behind it
        return (numbers << np.array([15 - bits for bits in format.channel_bits], np.uint16)).view(np.float16)
    return numbers


def pack(format: Format, numbers: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return packed texels (…, 1) of the numbers (…, channels) that `unpack` returns. Bits that a channel
    doesn't have are dropped. Texels of other formats are returned as they are."""
    if not format.is_packed:
        return numbers
    numbers = np.asarray(numbers)
    if format.kind is ChannelKind.FLOAT:
        shifts = np.array([15 - bits for bits in format.channel_bits], np.uint16)
        numbers = np.ascontiguousarray(numbers, np.float16).view(np.uint16) >> shifts
    words, start = np.zeros(numbers.shape[:-1], np.uint32), 0
    for channel, bits in enumerate(format.channel_bits):
        words |= (numbers[..., channel].astype(np.uint32) & np.uint32((1 << bits) - 1)) << np.uint32(start)
        start += bits
    return words[..., None].astype(format.dtype)


def _encode_channels(format: Format, values: NDArray[np.float64]) -> NDArray[np.generic]:
    """Return the numbers of each channel of a packed format, as `pack` takes them."""
    if format.kind is not ChannelKind.FLOAT:
        largest = _largest_channels(format)
        values = np.where(np.isnan(values), 0.0, values)
        scaled = values if format.is_integer else np.clip(values, 0.0, 1.0) * largest
        return np.clip(np.rint(scaled), 0, largest).astype(np.uint16)
    fraction = np.array(format.channel_bits) - 5
    largest = 2.0**16 - 2.0 ** (15 - fraction)
    finite = np.where(np.isfinite(values), np.clip(values, 0.0, largest), 0.0)
    exponent = np.maximum(np.frexp(finite)[1] - 1, -14)
    step = np.exp2(exponent - fraction)
    result = np.minimum(np.rint(finite / step) * step, largest)
    result = np.where(np.isposinf(values), np.inf, result)
    return np.where(np.isnan(values), np.nan, result).astype(np.float16)


def _largest_channels(format: Format) -> NDArray[np.float64]:
    """Return the largest number of each channel of a packed format."""
    return np.exp2(np.array(format.channel_bits, np.float64)) - 1


def halve(format: Format, level: NDArray[np.generic], layers: int) -> NDArray[np.generic]:
    """Return the next mip level of a (layers, height, width, components) level, with `layers` layers.

    Each texel is the mean of the area that it covers: 2 texels along an even axis, 3 with fractional weights
    along an odd one. So no row or column is lost, and the mean of the level is preserved.
    """
    depth, height, width, components = level.shape
    shape = (layers, max(1, height // 2), max(1, width // 2), components)
    result = np.empty(shape, level.dtype)
    for layer in range(layers):
        for start in range(0, shape[1], _STRIP):
            stop = min(start + _STRIP, shape[1])
            mean: NDArray[np.float64] | float = 0.0
            for taps, weights in _taps(layer, layer + 1, depth, layers):
                for rows, row_weights in _taps(start, stop, height, shape[1]):
                    values = decode(format, level[taps[0], rows])
                    weighted = sum(
                        (
                            values[:, columns] * column_weights[None, :, None]
                            for columns, column_weights in _taps(0, shape[2], width, shape[2])
                        ),
                        np.float64(0.0),
                    )
                    mean = mean + weights[0] * row_weights[:, None, None] * weighted
            result[layer, start:stop] = encode(format, np.asarray(mean))
    return result


def _taps(start: int, stop: int, size: int, target: int) -> list[_Taps]:
    """Return the source texels of target texels `start` to `stop` along one axis, with their weights."""
    index = np.arange(start, stop)
    if size == target:
        return [(index, np.ones(len(index)))]
    if size % 2 == 0:
        half = np.full(len(index), 0.5)
        return [(2 * index, half), (2 * index + 1, half)]
    return [
        (2 * index, (target - index) / size),
        (2 * index + 1, np.full(len(index), target / size)),
        (2 * index + 2, (index + 1) / size),
    ]


def _limits(format: Format) -> np.iinfo[Any]:
    integer: np.dtype[Any] = format.dtype
    return np.iinfo(integer)


def to_srgb(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the gamma-encoded values of linear light; both are 0 to 1 (IEC 61966-2-1).

    Examples:
        >>> rhi.to_srgb(np.array([0.0, 0.5, 1.0])).round(3).tolist()
        [0.0, 0.735, 1.0]
    """
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)


def from_srgb(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the linear light of gamma-encoded values; both are 0 to 1 (IEC 61966-2-1).

    Examples:
        >>> rhi.from_srgb(np.array([0.0, 0.5, 1.0])).round(3).tolist()
        [0.0, 0.214, 1.0]
    """
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


_LINEAR: Final = from_srgb(np.arange(256) / 255.0)  # a power takes long, and there are only these


def add_channel_axis(texels: NDArray[Any], components: int, has_layers: bool) -> NDArray[Any]:
    """Return texels of one channel in layers, (layers, height, width), with an axis for the channel; others as
    they are."""
    if has_layers and components == 1 and texels.ndim == 3 and texels.shape[2] != 1:
        return texels[..., None]
    return texels


def convert_float64(texels: NDArray[Any], format: Format) -> NDArray[Any] | None:
    """Return texels of float64, NumPy's default, as the format's floats; others as they are. None if the format
    can't hold a number."""
    if texels.dtype != np.float64 or format.dtype.kind != "f":
        return texels
    with np.errstate(over="ignore", invalid="ignore"):
        converted = texels.astype(format.dtype)
    return converted if (np.isfinite(converted) | ~np.isfinite(texels)).all() else None
