"""What formats store: conversions against exhaustive and exact references."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind, Format
from rhi.contract.texels import decode, encode, halve

NORMALIZED = [f for f in COLOR_FORMATS if f.kind in (ChannelKind.UNORM, ChannelKind.SNORM, ChannelKind.SRGB)]
BY_NAME = {"ids": lambda f: f.name}


def one(format, value):
    """The first channel of a texel in which all channels have this value."""
    return encode(format, np.full(format.channels, value, np.float64))[0]


@pytest.mark.parametrize("format", NORMALIZED, **BY_NAME)
def test_every_stored_value_of_a_normalized_format_survives_a_round_trip(format):
    limits = np.iinfo(format.dtype)
    every = np.arange(limits.min, limits.max + 1)
    texels = np.repeat(every.astype(format.dtype)[:, None], format.channels, axis=1)
    expected = np.maximum(texels, max(limits.min, -limits.max))  # the lowest snorm value is another -1
    np.testing.assert_array_equal(encode(format, decode(format, texels)), expected)


@pytest.mark.parametrize("format", NORMALIZED, **BY_NAME)
def test_the_ends_of_a_normalized_format_are_exact_and_what_lies_beyond_saturates(format):
    limits = np.iinfo(format.dtype)
    low = -1.0 if format.kind is ChannelKind.SNORM else 0.0
    assert one(format, 1.0) == one(format, 7.0) == one(format, np.inf) == limits.max
    assert one(format, low) == one(format, -7.0) == one(format, -np.inf) == round(low * limits.max)
    assert one(format, np.nan) == 0


@pytest.mark.parametrize("format", [f for f in NORMALIZED if f.kind is not ChannelKind.SRGB], **BY_NAME)
@given(value=st.floats(-1.0, 1.0))
@settings(max_examples=60)
def test_normalized_values_go_to_the_nearest_step(format, value):
    steps = int(np.iinfo(format.dtype).max)
    exact = Fraction(value) * steps
    if format.kind is not ChannelKind.SNORM:
        exact = max(exact, Fraction(0))
    assert abs(Fraction(int(one(format, value))) - exact) <= Fraction(1, 2) + Fraction(1, 1 << 30)


def test_both_lowest_values_of_a_signed_format_mean_minus_one():
    assert decode(Format.R8_SNORM, np.array([-128, -127, 127], np.int8)).tolist() == [-1.0, -1.0, 1.0]


def test_half_of_an_8_bit_channel_is_128_as_on_hardware():
    assert one(Format.RGBA8, 0.5) == 128


@pytest.mark.parametrize(
    ("linear", "stored"), [(0.0, 0), (0.0031308, 10), (0.2158605, 128), (0.5, 188), (0.7304608, 222), (1.0, 255)]
)
def test_srgb_follows_its_curve_and_leaves_alpha_linear(linear, stored):
    assert encode(Format.RGBA8_SRGB, np.array([linear, linear, linear, linear])).tolist() == [
        stored, stored, stored, round(linear * 255),
    ]  # fmt: skip


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_integer], **BY_NAME)
def test_integers_saturate_and_keep_every_bit(format):
    limits = np.iinfo(format.dtype)
    for value in (limits.max, limits.max - 1, 7, limits.min):
        assert one(format, float(value)) == value
    assert one(format, float(limits.max) + 1) == limits.max
    assert one(format, float(limits.min) - 1) == limits.min
    assert (one(format, 2.4), one(format, 2.6), one(format, np.nan)) == (2, 3, 0)


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.kind is ChannelKind.FLOAT], **BY_NAME)
def test_floats_are_rounded_once_and_overflow_to_infinity(format):
    largest = np.finfo(format.dtype).max
    assert one(format, float(largest)) == largest
    assert one(format, float(largest) * 2) == np.inf
    assert one(format, -float(largest) * 2) == -np.inf
    assert np.isnan(one(format, np.nan))
    step = float(np.finfo(format.dtype).eps)
    assert one(format, 1.0 + 0.49 * step) == 1.0
    assert one(format, 1.0 + 0.51 * step) == 1.0 + step


@pytest.mark.parametrize(
    ("format", "steps"),
    [(Format.D16, 65535), (Format.D24, 16777215), (Format.D24S8, 16777215), (Format.D32F, 0), (Format.D32FS8, 0)],
)
def test_depth_is_kept_to_the_steps_of_its_format(format, steps):
    for value in (0.0, 0.1, 1 / 3, 0.5, 0.9999, 1.0):
        expected = np.float32(round(value * steps) / steps) if steps else np.float32(value)
        assert one(format, value) == expected


@pytest.mark.parametrize("format", DEPTH_FORMATS, **BY_NAME)
def test_depth_is_kept_within_0_and_1(format):
    assert [one(format, value) for value in (-0.5, 1.5, np.inf, np.nan)] == [0.0, 1.0, 1.0, 0.0]


# -- mip levels ------------------------------------------------------------------------------------------


def gray(values):
    """One layer of R32F texels."""
    return np.asarray(values, np.float32)[None, :, :, None]


def test_a_texel_of_a_smaller_level_is_the_mean_of_four():
    level = gray([[1, 2, 10, 20], [3, 6, 30, 40]])
    assert halve(Format.R32F, level, 1)[0, ..., 0].tolist() == [[3.0, 25.0]]


def test_along_an_odd_axis_every_texel_counts_the_same():
    # 5 → 2: each result covers two and a half texels.
    assert halve(Format.R32F, gray([[10, 20, 30, 40, 50]]), 1)[0, 0, :, 0].tolist() == [18.0, 42.0]
    assert halve(Format.R32F, gray([[3], [6], [9]]), 1)[0, :, 0, 0].tolist() == [6.0]


@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 99))
@settings(max_examples=60)
def test_a_smaller_level_has_the_same_mean(width, height, seed):
    level = np.random.default_rng(seed).random((1, height, width, 1)).astype(np.float32)
    smaller = halve(Format.R32F, level, 1)
    assert smaller.shape == (1, max(1, height // 2), max(1, width // 2), 1)
    assert abs(float(smaller.mean(dtype=np.float64)) - float(level.mean(dtype=np.float64))) < 1e-6


def test_a_level_higher_than_one_strip_is_filtered_as_a_whole():
    level = np.random.default_rng(1).random((1, 1025, 2, 1)).astype(np.float32)
    rows = level[0, :, :, 0].astype(np.float64).mean(axis=1)
    index = np.arange(512)
    expected = ((512 - index) * rows[0:1023:2] + 512 * rows[1:1024:2] + (index + 1) * rows[2:1025:2]) / 1025
    np.testing.assert_allclose(halve(Format.R32F, level, 1)[0, :, 0, 0], expected, rtol=1e-6)


def test_srgb_levels_are_averaged_in_linear_light():
    level = np.array([[0, 255]], np.uint8)[None, :, :, None].repeat(4, axis=3)
    assert halve(Format.RGBA8_SRGB, level, 1)[0, 0, 0].tolist() == [188, 188, 188, 128]
    assert halve(Format.RGBA8, level, 1)[0, 0, 0].tolist() == [128] * 4


def test_a_volume_shrinks_in_depth_too_and_an_array_does_not():
    level = np.array([0, 4, 8], np.float32)[:, None, None, None] * np.ones((3, 2, 2, 1), np.float32)
    assert halve(Format.R32F, level, 1)[:, 0, 0, 0].tolist() == [4.0]
    assert halve(Format.R32F, level, 3)[:, 0, 0, 0].tolist() == [0.0, 4.0, 8.0]
