"""The reference: expected results, computed in float64 NumPy for values and in exact integers for coverage.

The code is simple rather than fast, since all results are compared with it. Colors are (…, 4) arrays, images
have their top row first, and y points down in windows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rhi import BlendFactor, BlendFunction, BlendOperation, Format, StencilOperation
from rhi.contract.formats import ChannelKind

Array = NDArray[Any]
Float = NDArray[np.float64]

SUBTEXELS = 16
"""Triangle corners lie on multiples of 1/16 texel, which every device's fixed-point grid represents
exactly."""

_COMPARISONS: dict[str, Callable[[Any, Any], Any]] = {
    "never": lambda new, stored: np.zeros(np.broadcast(new, stored).shape, bool),
    "less": np.less,
    "equal": np.equal,
    "less_equal": np.less_equal,
    "greater": np.greater,
    "not_equal": np.not_equal,
    "greater_equal": np.greater_equal,
    "always": lambda new, stored: np.ones(np.broadcast(new, stored).shape, bool),
}


def compare(function: Any, new: ArrayLike, stored: ArrayLike) -> NDArray[np.bool_]:
    """Evaluate `new OP stored` for a `Comparison`, `DepthFunction` or `AlphaFunction`."""
    return np.asarray(_COMPARISONS[function.value](np.asarray(new), np.asarray(stored)))


# -- blending and stencil --------------------------------------------------------------------------------


def blend(function: BlendFunction, source: ArrayLike, destination: ArrayLike, constant: ArrayLike) -> Float:
    """Return the blended color before it is stored; colors are (…, 4)."""
    src, dst, con = (np.asarray(v, np.float64) for v in (source, destination, constant))
    src, dst = np.broadcast_arrays(src, dst)
    color = _combine(function.operation, function.source, function.destination, src, dst, con)
    alpha = _combine(
        function.operation_alpha or function.operation,
        function.source_alpha or function.source,
        function.destination_alpha or function.destination,
        src,
        dst,
        con,
    )
    return np.concatenate([color[..., :3], alpha[..., 3:]], axis=-1)


def _combine(
    operation: BlendOperation,
    source_factor: BlendFactor,
    destination_factor: BlendFactor,
    source: Float,
    destination: Float,
    constant: Float,
) -> Float:
    if operation is BlendOperation.MINIMUM:
        return np.minimum(source, destination)
    if operation is BlendOperation.MAXIMUM:
        return np.maximum(source, destination)
    left = source * blend_factor(source_factor, source, destination, constant)
    right = destination * blend_factor(destination_factor, source, destination, constant)
    if operation is BlendOperation.SUBTRACT:
        return left - right
    if operation is BlendOperation.REVERSE_SUBTRACT:
        return right - left
    return left + right


def blend_factor(
    factor: BlendFactor, source: ArrayLike, destination: ArrayLike, constant: ArrayLike
) -> Float:
    """Blend factor of each channel, not yet clamped. All arrays are (…, 4)."""
    source, destination, constant = (np.asarray(v, np.float64) for v in (source, destination, constant))
    ones = np.ones_like(source)
    if factor is BlendFactor.SOURCE_ALPHA_SATURATE:
        saturated = np.minimum(source[..., 3:], 1.0 - destination[..., 3:])
        return np.concatenate([ones[..., :3] * saturated, ones[..., 3:]], axis=-1)
    base = {
        "zero": 0.0 * ones,
        "one": ones,
        "source_color": source,
        "source_alpha": source[..., 3:] * ones,
        "destination_color": destination,
        "destination_alpha": destination[..., 3:] * ones,
        "constant": constant * ones,
    }
    name = factor.value
    return ones - base[name.removeprefix("one_minus_")] if name.startswith("one_minus_") else base[name]


def stencil(operation: StencilOperation, stored: int, reference: int, write_mask: int = 255) -> int:
    """Return the stored stencil value after an operation."""
    new = {
        StencilOperation.KEEP: stored,
        StencilOperation.ZERO: 0,
        StencilOperation.REPLACE: reference,
        StencilOperation.INCREMENT: min(stored + 1, 255),
        StencilOperation.INCREMENT_WRAP: (stored + 1) & 255,
        StencilOperation.DECREMENT: max(stored - 1, 0),
        StencilOperation.DECREMENT_WRAP: (stored - 1) & 255,
        StencilOperation.INVERT: ~stored & 255,
    }[operation]
    return (stored & ~write_mask) | (new & write_mask)


# -- formats ---------------------------------------------------------------------------------------------


def srgb_to_linear(value: ArrayLike) -> Float:
    """Convert sRGB to linear light by IEC 61966-2-1, both 0 to 1."""
    v = np.asarray(value, np.float64)
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(value: ArrayLike) -> Float:
    """Convert linear light to sRGB by IEC 61966-2-1, both 0 to 1."""
    v = np.asarray(value, np.float64)
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0031308) ** (1 / 2.4) - 0.055)


def largest(format: Format) -> int:
    """Return the largest number that a channel of an integer or normalised format can store."""
    return int(np.iinfo(cast("np.dtype[np.integer[Any]]", format.dtype)).max)


def smallest(format: Format) -> int:
    """Return the smallest number that a channel of an integer or normalised format can store."""
    return int(np.iinfo(cast("np.dtype[np.integer[Any]]", format.dtype)).min)


def channels_of(format: Format, texels: Array) -> Array:
    """Return the numbers of each channel, (…, channels), of texels as `Texture.read` returns them."""
    if not format.is_packed:
        return texels if format.components > 1 else np.asarray(texels[..., None])
    starts = np.cumsum((0, *format.channel_bits[:-1]))
    numbers = texels[..., None].astype(np.int64) >> starts & (1 << np.array(format.channel_bits)) - 1
    if format.kind is not ChannelKind.FLOAT:
        return np.asarray(numbers)
    fraction = np.array(format.channel_bits) - 5
    exponent, rest = numbers >> fraction, numbers & (1 << fraction) - 1
    normal = (1 + rest / 2.0**fraction) * 2.0 ** (exponent - 15)
    return np.asarray(np.where(exponent == 0, rest * 2.0 ** (-14 - fraction), normal))


def _scale(format: Format) -> Any:
    """Return the stored number of each channel of a normalised format that means 1."""
    return (1 << np.array(format.channel_bits)) - 1 if format.is_packed else largest(format)


def decode(format: Format, stored: ArrayLike) -> Float:
    """Return the (…, 4) value that a shader reads for `stored` (…, channels); missing channels are 0, 0,
    1."""
    values = np.asarray(stored, np.float64)
    if format.kind is ChannelKind.UNORM:
        values = values / _scale(format)
    elif format.kind is ChannelKind.SNORM:
        values = np.maximum(values / largest(format), -1.0)
    elif format.kind is ChannelKind.SRGB:
        values = values / 255.0
        values = np.concatenate([srgb_to_linear(values[..., :3]), values[..., 3:]], axis=-1)
    full = np.zeros((*values.shape[:-1], 4))
    full[..., 3] = 1.0
    full[..., : values.shape[-1]] = values
    return full


def encode(format: Format, color: ArrayLike) -> Float:
    """Return the (…, channels) numbers to store for `color` (…, 4), not yet rounded."""
    values = np.asarray(color, np.float64)[..., : format.channels]
    if format.kind is ChannelKind.UNORM:
        return np.asarray(np.clip(values, 0.0, 1.0) * _scale(format))
    if format.kind is ChannelKind.SNORM:
        return np.asarray(np.clip(values, -1.0, 1.0) * largest(format))
    if format.kind is ChannelKind.SRGB:
        values = np.clip(values, 0.0, 1.0)
        return 255.0 * np.concatenate([linear_to_srgb(values[..., :3]), values[..., 3:]], axis=-1)
    return np.maximum(values, 0.0) if format is Format.R11G11B10F else values


def rounding(format: Format, expected: Float) -> tuple[Float, str]:
    """Return (tolerance, reason) for a conversion whose exact result is `expected`."""
    if format is Format.R11G11B10F:  # truncation is allowed here, too
        return np.maximum(
            np.abs(expected) * 2.0 ** -np.array([6, 6, 5]), 2.0**-19
        ), "truncation to 6, 6 and 5 bits"
    if format.dtype.kind == "f":
        # A device may truncate instead of rounding (OpenGL 4.3, section 2.3.4.1: implementation-dependent).
        bits = 10 if format.dtype.itemsize == 2 else 23
        return np.abs(expected) * 2.0**-bits, f"truncation to {bits} fraction bits"
    if format.kind is ChannelKind.SRGB:
        return np.ones_like(expected), "sRGB curves may be approximated within one stored number"
    if format.is_packed:
        return np.ones_like(expected), "llvmpipe converts to 10 bits within one stored number"
    # The product with 2^n - 1 is computed in float32, so a value near a half may round either way.
    return 0.5 + np.abs(expected) * 2.0**-22, "rounding to the nearest stored number"


def halve(format: Format, stored: Array) -> Float:
    """Return the next mip level of ([depth,] height, width, channels) texels, not yet rounded: a box in
    linear light.

    A texel is the mean of all that it covers, weighted by area: of 2 texels along an even axis, of 3 along an
    odd one. An axis of 1 remains.
    """
    values = decode(format, stored) if format.kind is ChannelKind.SRGB else stored.astype(np.float64)
    for axis in range(stored.ndim - 1):
        values = np.moveaxis(np.tensordot(_box(stored.shape[axis]), values, (1, axis)), 0, axis)
    return encode(format, values) if format.kind is ChannelKind.SRGB else values


def _box(size: int) -> Float:
    """Return the weights (target texels, size) of an axis that is halved."""
    targets = max(1, size // 2)
    edges = np.arange(targets + 1) * size / targets
    texels = np.arange(size)
    covered = np.minimum(edges[1:, None], texels + 1) - np.maximum(edges[:-1, None], texels)
    return np.asarray(np.maximum(covered, 0) * targets / size)


# -- coverage --------------------------------------------------------------------------------------------


def rasterise(triangle: ArrayLike, width: int, height: int, subtexels: int = SUBTEXELS) -> NDArray[np.bool_]:
    """Return the texels whose centers a triangle covers by the top-left rule, exactly.

    `triangle` is (3, 2) int: window x (right), y (down) in 1/16 texel, or in 1/`subtexels`, of either
    winding.
    """
    inside = np.ones((height, width), bool)
    for edge, is_top_left, _ in _edges(triangle, width, height, subtexels):
        inside &= (edge >= 0) if is_top_left else (edge > 0)
    return inside


def rasterise_line(
    start: ArrayLike, end: ArrayLike, line_width: int, width: int, height: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (certain, possible): the texels of a line that covers `line_width` texels in each column if it
    is wider than high, else in each row. Platforms choose at its ends, and where a texel's centre lies on its
    border.

    `start` and `end` are int: window x (right), y (down) in 1/16 texel.
    """
    (ax, ay), (bx, by) = ([int(part) for part in np.asarray(point, np.int64)] for point in (start, end))
    y, x = np.mgrid[0:height, 0:width].astype(np.int64) * SUBTEXELS + SUBTEXELS // 2
    if abs(by - ay) > abs(bx - ax):
        (ax, ay, bx, by), (x, y) = (ay, ax, by, bx), (y, x)
    away, half = 2 * abs((y - ay) * (bx - ax) - (by - ay) * (x - ax)), line_width * SUBTEXELS * abs(bx - ax)
    inside = np.minimum(x - min(ax, bx), max(ax, bx) - x)
    reach = SUBTEXELS // 2
    return (away < half) & (inside > reach), (away <= half) & (inside >= -reach)


def rasterise_within(
    triangle: ArrayLike, width: int, height: int, margin: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (certain, possible): the texels covered with every edge moved inwards, or outwards, by `margin`
    texels.

    This is for triangles that extend beyond the target: clipping them moves their edges by a rounding error.
    """
    certain, possible = np.ones((height, width), bool), np.ones((height, width), bool)
    for edge, _, length in _edges(triangle, width, height):
        certain &= edge > margin * SUBTEXELS * length
        possible &= edge >= -margin * SUBTEXELS * length
    return certain, possible


def _edges(
    triangle: ArrayLike, width: int, height: int, subtexels: int = SUBTEXELS
) -> Iterator[tuple[NDArray[np.int64], bool, float]]:
    """Yield the edges of a triangle at the texel centers, see `edge_functions`."""
    y, x = np.mgrid[0:height, 0:width].astype(np.int64) * subtexels + subtexels // 2
    return edge_functions([(int(u), int(v)) for u, v in np.asarray(triangle, np.int64)], x, y)


def edge_functions(
    corners: Sequence[tuple[int, int]], x: NDArray[np.int64], y: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], bool, float]]:
    """Yield for each edge of a triangle the edge function at places x (right) and y (down), in the corners'
    unit and positive inside; whether it is a top or left edge, to which places on it belong; and its length.
    Corners have either winding. A triangle without area gets one edge with every place outside."""
    (ax, ay), (bx, by), (cx, cy) = corners
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area == 0:
        yield np.full_like(x, -1 << 40), False, 1.0
        return
    ring = [*corners] if area > 0 else [*corners[::-1]]  # clockwise as seen with y down
    for (sx, sy), (ex, ey) in zip(ring, [*ring[1:], ring[0]], strict=True):
        dx, dy = ex - sx, ey - sy
        yield dx * (y - sy) - dy * (x - sx), dy < 0 or (dy == 0 and dx > 0), float(np.hypot(dx, dy))
