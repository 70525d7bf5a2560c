"""The output merger in intervals: conversions to and from formats, and blending."""

from __future__ import annotations

import numpy as np

from rhi import BlendColor, BlendFactor, BlendFunction, BlendOperation, Format
from rhi.conformance import reference
from rhi.conformance.programs.intervals import Float, Interval, join
from rhi.conformance.programs.tolerances import Tolerances
from rhi.contract.formats import ChannelKind


def decode(format: Format, stored: Interval, tolerances: Tolerances) -> Interval:
    """Return the (…, 4) values of stored numbers."""
    value = Interval(reference.decode(format, stored.low), reference.decode(format, stored.high))
    if format.kind is ChannelKind.SRGB:
        error = np.array([tolerances.decode_srgb] * 3 + [0.0])
        value = value.widen(np.broadcast_to(error, value.low.shape)).clip(0.0, 1.0)
    return value


def encode(format: Format, value: Interval, tolerances: Tolerances) -> Interval:
    """Return the stored numbers, (…, channels), that values may become."""
    with np.errstate(all="ignore"):
        if format.kind is ChannelKind.FLOAT:
            part = value[..., : format.channels]
            return Interval(_rounded(format, part.low, -np.inf), _rounded(format, part.high, np.inf))
        low, high = (reference.encode(format, end) for end in (value.low, value.high))
        if format.is_integer:
            return Interval(low, high)
        slack = np.full(format.channels, 1e-6 + reference.largest(format) * 2.0**-22)
        if format.kind is ChannelKind.SRGB:
            slack[:3] += tolerances.encode_srgb
        most = float(reference.largest(format))
        least = -most if format.kind is ChannelKind.SNORM else 0.0
        return Interval(np.ceil(low - 0.5 - slack), np.floor(high + 0.5 + slack)).clip(least, most)


def _rounded(format: Format, value: Float, towards: float) -> Float:
    """Return the float of the format next to `value`, or itself; infinity stays."""
    near = value.astype(format.dtype)
    beyond = near > value if towards < 0 else near < value
    moved = np.where(beyond, np.nextafter(near, near.dtype.type(towards)), near).astype(np.float64)
    return np.where(np.isinf(value), value, moved)


def quantise_depth(format: Format, z: Interval, tolerances: Tolerances) -> Interval:
    """Return the depths that the format may store."""
    z = z.clip(0.0, 1.0)
    steps = format.depth_steps
    if not steps:
        return Interval(_rounded(format, z.low, -np.inf), _rounded(format, z.high, np.inf))
    slack = 1e-3 + tolerances.depth_steps
    low, high = np.ceil(z.low * steps - 0.5 - slack), np.floor(z.high * steps + 0.5 + slack)
    return Interval(low, high).clip(0, steps)


def read_depth(format: Format, stored: Interval) -> Interval:
    """Return stored depths as floats 0 to 1."""
    scale = 1.0 / (format.depth_steps or 1)
    return Interval(stored.low * scale, stored.high * scale)


def blend(
    format: Format,
    function: BlendFunction,
    constant: BlendColor,
    source: Interval,
    stored: Interval,
    tolerances: Tolerances,
) -> Interval:
    """Return the blended color, (…, 4), before it is stored."""
    color = Interval.of([constant.red, constant.green, constant.blue, constant.alpha])
    normalised = format.kind is not ChannelKind.FLOAT
    unit = 0.0
    least = -1.0 if format.kind is ChannelKind.SNORM else 0.0
    if normalised:
        source, color = source.clip(least, 1.0), color.clip(least, 1.0)
        if tolerances.blends_in_format:
            signed = tolerances.signed_steps if format.kind is ChannelKind.SNORM else 0.0
            step = 1.0 / reference.largest(format)
            unit, lowest = (1.0 + signed) * step, least - signed * step
            source, color = (part.widen((0.5 + signed) * step).clip(lowest, 1.0) for part in (source, color))
            stored = stored.widen(signed * step)
    limits = (least, 1.0) if normalised else None
    parts = [
        _combine(
            function.operation,
            function.source,
            function.destination,
            source,
            stored,
            color,
            unit,
            limits,
            tolerances,
        ),
        _combine(
            function.operation_alpha or function.operation,
            function.source_alpha or function.source,
            function.destination_alpha or function.destination,
            source,
            stored,
            color,
            unit,
            limits,
            tolerances,
        ),
    ]
    return join(parts[0][..., :3], parts[1][..., 3:])


def _combine(
    operation: BlendOperation,
    source_factor: BlendFactor,
    destination_factor: BlendFactor,
    source: Interval,
    stored: Interval,
    constant: Interval,
    unit: float,
    limits: tuple[float, float] | None,
    tolerances: Tolerances,
) -> Interval:
    if operation is BlendOperation.MINIMUM:
        return source.minimum(stored)
    if operation is BlendOperation.MAXIMUM:
        return source.maximum(stored)
    terms = []
    for value, factor in ((source, source_factor), (stored, destination_factor)):
        scale = _factor(factor, source, stored, constant)
        if limits is not None:
            scale = scale.clip(*limits)
        product = value * scale
        if factor not in (BlendFactor.ZERO, BlendFactor.ONE):
            product = product.widen(2.0**-22 * product.size + unit)
        terms.append(product)
    left, right = terms
    if operation is BlendOperation.REVERSE_SUBTRACT:
        left, right = right, left
    total = left + right if operation is BlendOperation.ADD else left - right
    with np.errstate(all="ignore"):
        exact = (total.low == total.high) & (total.low.astype(np.float32) == total.low)
        rounding = np.where(exact, 0.0, 2.0**-22 * np.maximum(left.size, right.size))
        if tolerances.blends_in_format:
            rounding = 2.0**-22 * np.maximum(1.0, np.maximum(source.size, stored.size))
    return total.widen(np.where(np.isfinite(rounding), rounding, 0.0))


def _factor(factor: BlendFactor, source: Interval, stored: Interval, constant: Interval) -> Interval:
    ones = Interval.of(np.ones(source.low.shape))
    zero = Interval.of(np.zeros(source.low.shape))
    if factor is BlendFactor.SOURCE_ALPHA_SATURATE:
        saturated = source[..., 3:].minimum(ones[..., 3:] - stored[..., 3:])
        return join(saturated + zero[..., :3], ones[..., 3:])
    base = {
        "zero": zero,
        "one": ones,
        "source_color": source,
        "source_alpha": source[..., 3:] + zero,
        "destination_color": stored,
        "destination_alpha": stored[..., 3:] + zero,
        "constant": constant + zero,
    }
    name = factor.value
    return ones - base[name.removeprefix("one_minus_")] if name.startswith("one_minus_") else base[name]
