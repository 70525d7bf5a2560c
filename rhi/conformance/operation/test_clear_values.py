"""Clear values: one rule for every format.

A number that the format can't hold is refused: a fraction or a number out of range in integers, one beyond
the largest float. Normalised formats clamp. What is stored is the format's nearest number, the same on all
devices.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device, Format
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import require_format, require_renderable
from rhi.conformance.reference import channels_of, encode
from rhi.conformance.validation.refusal import refuses
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind
from rhi.errors.rules import PASS_CLEAR

SIZE = (3, 2)
INTEGERS = [f for f in COLOR_FORMATS if f.is_integer]
FLOATS = [f for f in COLOR_FORMATS if f.kind is ChannelKind.FLOAT]
NORMALISED = [f for f in COLOR_FORMATS if not f.is_integer and f.kind is not ChannelKind.FLOAT]
LARGEST = {"f2": 65504.0, "f4": float(np.finfo(np.float32).max)}


def identity(value: Any) -> str:
    return value.name if isinstance(value, Format) else str(value)


def bounds(format: Format) -> list[tuple[float, float]]:
    """Return the smallest and the largest number of each channel of an integer or float format."""
    if format is Format.R11G11B10F:  # 5 bits of exponent, no sign
        return [(0.0, 65024.0), (0.0, 65024.0), (0.0, 64512.0)]
    if format.kind is ChannelKind.FLOAT:
        largest = LARGEST[format.dtype.str[1:]]
        return [(-largest, largest)] * format.channels
    if format.kind is ChannelKind.INT:
        return [(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in format.channel_bits]
    return [(0, 2**bits - 1) for bits in format.channel_bits]


def pad(values: Any) -> tuple[float, ...]:
    return (*values, *(0,) * (4 - len(values)))


def clear(device: Device, format: Format, value: Any) -> NDArray[Any]:
    """Return the channels (channels,) of a target that is cleared, after checking that all its texels are
    alike."""
    with device.texture(SIZE, format) as image:
        with device.render_pass(image, clear=value):
            pass
        channels = channels_of(format, image.read()).reshape(SIZE[0] * SIZE[1], -1)
        assert_same(channels, np.broadcast_to(channels[0], channels.shape))
        return np.asarray(channels[0])


def nearest(format: Format, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the numbers that a format stores for (n, channels) values that lie halfway between none of
    them."""
    exact = encode(format, np.concatenate([values, np.zeros((len(values), 4 - format.channels))], axis=1))
    if format.kind is not ChannelKind.FLOAT:
        return np.rint(exact)
    if format is not Format.R11G11B10F:
        return exact.astype(format.dtype).astype(np.float64)
    fraction = np.array(format.channel_bits) - 5
    step = np.exp2(np.maximum(np.floor(np.log2(np.maximum(exact, 1e-30))), -14) - fraction)
    return np.asarray(np.rint(exact / step) * step)


@pytest.mark.parametrize("format", [*NORMALISED, *FLOATS], ids=identity)
def test_a_color_is_cleared_to_the_nearest_that_the_format_holds(device: Device, format: Format) -> None:
    require_renderable(device, format)
    random = np.random.default_rng(11)
    values = random.uniform(-1.25 if format.kind is not ChannelKind.FLOAT else 0, 1.25, (24, 4))
    values[12:] *= 0.01
    results = [clear(device, format, tuple(value)) for value in values.tolist()]
    assert_same(results, nearest(format, values[:, : format.channels]))


@pytest.mark.parametrize("format", [*INTEGERS, *FLOATS], ids=identity)
def test_the_ends_of_a_format_s_range_are_cleared_to(device: Device, format: Format) -> None:
    require_renderable(device, format)
    for end in zip(*bounds(format), strict=True):
        assert_same(clear(device, format, pad(end)), end)


@pytest.mark.parametrize("format", INTEGERS, ids=identity)
def test_whole_numbers_of_any_type_are_integers(device: Device, format: Format) -> None:
    require_renderable(device, format)
    for value in ((1.0, 2.0, 3.0, 2.0), np.array([1, 2, 3, 2], np.uint8), [np.int64(1), np.float32(2), 3, 2]):
        assert_same(clear(device, format, value), (1, 2, 3, 2)[: format.channels])


@pytest.mark.parametrize("format", INTEGERS, ids=identity)
@pytest.mark.parametrize("fraction", [0.5, 2.7, 1 - 2**-40, 1e-300], ids=str)
def test_fractions_are_refused_by_integers(device: Device, format: Format, fraction: float) -> None:
    require_renderable(device, format)
    for channel in range(format.channels):
        value = [0.0, 0.0, 0.0, 0.0]
        value[channel] = fraction
        with device.texture(SIZE, format) as image, refuses(PASS_CLEAR):
            device.render_pass(image, clear=value)


@pytest.mark.parametrize("format", [*INTEGERS, *FLOATS], ids=identity)
def test_numbers_beyond_the_format_s_range_are_refused(device: Device, format: Format) -> None:
    """In each channel of the format. Those that it doesn't have may be anything."""
    require_renderable(device, format)
    with device.texture(SIZE, format) as image:
        for channel, (low, high) in enumerate(bounds(format)):
            step = 1.0 if format.is_integer else abs(high) * 2.0**-8
            for outside in (low - step, high + step):
                value = [0.0, 0.0, 0.0, 0.0]
                value[channel] = outside
                with refuses(PASS_CLEAR):
                    device.render_pass(image, clear=value)
        with device.render_pass(image, clear=(*(0,) * format.channels, *(1e30,) * (4 - format.channels))):
            pass
        assert_same(image.read(), 0)


@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
@pytest.mark.parametrize("number", [float("nan"), float("inf"), -float("inf")], ids=str)
def test_numbers_that_are_not_finite_are_refused_by_every_format(
    device: Device, format: Format, number: float
) -> None:
    require_renderable(device, format)
    with device.texture(SIZE, format) as image:
        for channel in range(4):
            value = [0.0, 0.0, 0.0, 0.0]
            value[channel] = number
            with refuses(PASS_CLEAR):
                device.render_pass(image, clear=value)


def test_one_value_for_several_targets_suits_each_of_them(device: Device) -> None:
    with device.texture(SIZE, Format.RGBA8) as color, device.texture(SIZE, Format.R32UI) as number:
        with refuses(PASS_CLEAR):
            device.render_pass([color, number], clear=(0.5, 0.25, 0, 1))
        with device.render_pass([color, number], clear=[(0.2, 0.4, 0, 1), (4_294_967_295, 0.25, 0, 1)]):
            pass
        assert_same(color.read(), (51, 102, 0, 255))
        assert_same(number.read(), 4_294_967_295)


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=identity)
def test_a_depth_is_cleared_to_the_nearest_that_the_format_holds(device: Device, format: Format) -> None:
    require_format(device, format)
    steps = format.depth_steps
    depths = [0.0, 1.0, 0.3, *np.random.default_rng(5).uniform(0, 1, 24).tolist(), 1e-6, 1 - 2.0**-24]
    for depth in depths:
        expected = np.float32(np.rint(depth * steps) / steps if steps else depth)
        with device.texture(SIZE, format) as target:
            with device.render_pass(depth=target, clear_depth=depth):
                pass
            near = 2.0**-24 if steps > 1 << 16 else 0.0
            assert_near(target.read(), expected, near, "24 bits that a shader reads, in float32")


@pytest.mark.parametrize("depth", [-1e-9, 1.0000001, float("nan"), float("inf"), 1e300], ids=str)
def test_depths_outside_of_their_range_are_refused(device: Device, depth: float) -> None:
    with device.texture(SIZE, Format.D32F) as target, refuses(PASS_CLEAR):
        device.render_pass(depth=target, clear_depth=depth)


@pytest.mark.requires("stencil")
@pytest.mark.parametrize("stencil", [-1, 256, 1 << 40])
def test_stencils_outside_of_their_range_are_refused(device: Device, stencil: int) -> None:
    require_format(device, Format.D24S8)
    with device.texture(SIZE, Format.D24S8) as target:
        with refuses(PASS_CLEAR):
            device.render_pass(depth=target, clear_stencil=stencil)
        with device.render_pass(depth=target, clear_depth=0, clear_stencil=255):
            pass
        assert_same(target.read_stencil(), 255)


def test_a_refused_clear_leaves_the_target(device: Device) -> None:
    with device.texture(SIZE, Format.R8UI) as image:
        with device.render_pass(image, clear=(7, 0, 0, 0)):
            pass
        with refuses(PASS_CLEAR), device.render_pass(image, clear=(256, 0, 0, 0)):
            pass
        assert_same(image.read(), 7)
        with device.record() as commands, refuses(PASS_CLEAR):
            commands.render_pass(image, clear=(-1, 0, 0, 0))
        device.submit(commands)
        assert_same(image.read(), 7)
