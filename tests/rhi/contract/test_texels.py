"""The values that formats store: conversions against exhaustive and exact references."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind, Format
from rhi.contract.texels import decode, encode, halve, pack, unpack

UNPACKED = [f for f in COLOR_FORMATS if not f.is_packed]
NORMALIZED = [f for f in UNPACKED if f.kind in (ChannelKind.UNORM, ChannelKind.SNORM, ChannelKind.SRGB)]
BY_NAME = {"ids": lambda f: f.name}


def encode_one(format, value):
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
def test_the_ends_of_a_normalized_format_are_exact_and_values_beyond_saturate(format):
    limits = np.iinfo(format.dtype)
    low = -1.0 if format.kind is ChannelKind.SNORM else 0.0
    assert encode_one(format, 1.0) == encode_one(format, 7.0) == encode_one(format, np.inf) == limits.max
    assert (
        encode_one(format, low)
        == encode_one(format, -7.0)
        == encode_one(format, -np.inf)
        == round(low * limits.max)
    )
    assert encode_one(format, np.nan) == 0


@pytest.mark.parametrize("format", [f for f in NORMALIZED if f.kind is not ChannelKind.SRGB], **BY_NAME)
@given(value=st.floats(-1.0, 1.0))
@settings(max_examples=60)
def test_normalized_values_go_to_the_nearest_step(format, value):
    steps = int(np.iinfo(format.dtype).max)
    exact = Fraction(value) * steps
    if format.kind is not ChannelKind.SNORM:
        exact = max(exact, Fraction(0))
    assert abs(Fraction(int(encode_one(format, value))) - exact) <= Fraction(1, 2) + Fraction(1, 1 << 30)


def test_both_lowest_values_of_a_signed_format_mean_minus_one():
    assert decode(Format.R8_SNORM, np.array([-128, -127, 127], np.int8)).tolist() == [-1.0, -1.0, 1.0]


def test_half_of_an_8_bit_channel_is_128_as_on_hardware():
    assert encode_one(Format.RGBA8, 0.5) == 128


@pytest.mark.parametrize(
    ("linear", "stored"),
    [(0.0, 0), (0.0031308, 10), (0.2158605, 128), (0.5, 188), (0.7304608, 222), (1.0, 255)],
)
def test_srgb_follows_its_curve_and_leaves_alpha_linear(linear, stored):
    assert encode(Format.RGBA8_SRGB, np.array([linear, linear, linear, linear])).tolist() == [
        stored,
        stored,
        stored,
        round(linear * 255),
    ]


@pytest.mark.parametrize("format", [f for f in UNPACKED if f.is_integer], **BY_NAME)
def test_integers_saturate_and_keep_every_bit(format):
    limits = np.iinfo(format.dtype)
    for value in (limits.max, limits.max - 1, 7, limits.min):
        assert encode_one(format, float(value)) == value
    assert encode_one(format, float(limits.max) + 1) == limits.max
    assert encode_one(format, float(limits.min) - 1) == limits.min
    assert (encode_one(format, 2.4), encode_one(format, 2.6), encode_one(format, np.nan)) == (2, 3, 0)


@pytest.mark.parametrize("format", [f for f in UNPACKED if f.kind is ChannelKind.FLOAT], **BY_NAME)
def test_floats_are_rounded_once_and_overflow_to_infinity(format):
    largest = np.finfo(format.dtype).max
    assert encode_one(format, float(largest)) == largest
    assert encode_one(format, float(largest) * 2) == np.inf
    assert encode_one(format, -float(largest) * 2) == -np.inf
    assert np.isnan(encode_one(format, np.nan))
    step = float(np.finfo(format.dtype).eps)
    assert encode_one(format, 1.0 + 0.49 * step) == 1.0
    assert encode_one(format, 1.0 + 0.51 * step) == 1.0 + step


@pytest.mark.parametrize(
    ("format", "steps"),
    [
        (Format.D16, 65535),
        (Format.D24, 16777215),
        (Format.D24S8, 16777215),
        (Format.D32F, 0),
        (Format.D32FS8, 0),
    ],
)
def test_depth_is_kept_to_the_steps_of_its_format(format, steps):
    for value in (0.0, 0.1, 1 / 3, 0.5, 0.9999, 1.0):
        expected = np.float32(round(value * steps) / steps) if steps else np.float32(value)
        assert encode_one(format, value) == expected


@pytest.mark.parametrize("format", DEPTH_FORMATS, **BY_NAME)
def test_depth_is_kept_within_0_and_1(format):
    assert [encode_one(format, value) for value in (-0.5, 1.5, np.inf, np.nan)] == [0.0, 1.0, 1.0, 0.0]


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


# -- packed formats ----------------------------------------------------------------------------------------


def test_the_first_channel_has_the_lowest_bits():
    assert encode(Format.RGB10A2, np.array([1.0, 0.0, 0.0, 0.0])).tolist() == [0x3FF]
    assert encode(Format.RGB10A2, np.array([0.0, 0.0, 1.0, 1.0])).tolist() == [0xFFF00000]
    assert encode(Format.R11G11B10F, np.array([1.0, 0.0, 0.0])).tolist() == [15 << 6]
    assert encode(Format.R11G11B10F, np.array([0.0, 2.0, 0.5])).tolist() == [16 << 6 << 11 | 14 << 5 << 22]


@pytest.mark.parametrize("format", [Format.RGB10A2, Format.RGB10A2UI, Format.R11G11B10F], **BY_NAME)
def test_every_packed_number_survives_a_round_trip(format):
    words = np.random.default_rng(0).integers(0, 1 << 32, (1 << 14, 1), np.uint32)
    np.testing.assert_array_equal(pack(format, unpack(format, words)), words)
    finite = np.isfinite(decode(format, words)).all(axis=-1)
    np.testing.assert_array_equal(encode(format, decode(format, words))[finite], words[finite])


@pytest.mark.parametrize(("channel", "start", "fraction"), [(0, 0, 6), (1, 11, 6), (2, 22, 5)])
def test_small_floats_decode_as_the_specification_says(channel, start, fraction):
    numbers = np.arange(1 << (5 + fraction), dtype=np.uint32)
    values = decode(Format.R11G11B10F, (numbers << np.uint32(start))[:, None])[:, channel]
    for number, value in zip(numbers.tolist(), values.tolist(), strict=True):
        exponent, rest = number >> fraction, number & (1 << fraction) - 1
        if exponent == 31:
            assert value == np.inf if rest == 0 else np.isnan(value)
        elif exponent == 0:
            assert value == 2.0**-14 * (rest / (1 << fraction))
        else:
            assert value == 2.0 ** (exponent - 15) * (1 + rest / (1 << fraction))


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_small_floats_are_rounded_to_the_nearest(channel):
    every = decode(Format.R11G11B10F, np.arange(1 << 11, dtype=np.uint32)[:, None])[:, 0]
    if channel == 2:
        every = decode(Format.R11G11B10F, np.arange(1 << 10, dtype=np.uint32)[:, None] << np.uint32(22))[:, 2]
    every = every[np.isfinite(every)]
    rng = np.random.default_rng(1)
    values = np.concatenate(
        [rng.uniform(0, 2, 500), 2.0 ** rng.uniform(-22, 16, 2000), every, every * (1 + 2.0**-9)]
    )
    colors = np.zeros((len(values), 3))
    colors[:, channel] = values
    stored = decode(Format.R11G11B10F, encode(Format.R11G11B10F, colors))[:, channel]
    nearest = np.abs(every[None] - np.minimum(values, every.max())[:, None]).min(axis=1)
    np.testing.assert_array_equal(np.abs(stored - np.minimum(values, every.max())), nearest)


def test_small_floats_have_no_sign_and_stay_finite():
    colors = [-1.0, -np.inf, 0.0], [1e9, 65024.0, 65520.0], [np.inf, np.nan, np.inf]
    stored = decode(Format.R11G11B10F, encode(Format.R11G11B10F, np.array(colors)))
    np.testing.assert_array_equal(stored, [[0, 0, 0], [65024, 65024, 64512], [np.inf, np.nan, np.inf]])


def test_packed_integers_saturate_in_each_channel():
    words = encode(Format.RGB10A2UI, np.array([[1023.0, 1024.0, -1.0, 4.0], [7.4, 7.6, np.nan, 2.0]]))
    assert unpack(Format.RGB10A2UI, words).tolist() == [[1023, 1023, 0, 3], [7, 8, 0, 2]]


@pytest.mark.parametrize("format", [Format.RGB10A2, Format.R11G11B10F], **BY_NAME)
def test_a_level_of_a_packed_format_is_averaged_by_channel(format):
    values = np.zeros((1, 2, 2, format.channels))
    values[0, 0, 0] = values[0, 1, 1] = 1.0
    (texel,) = decode(format, halve(format, encode(format, values), 1)).reshape(1, -1)
    np.testing.assert_allclose(texel, 0.5, atol=2 / 3 - 0.5)
    np.testing.assert_allclose(texel[:3], 0.5, atol=1 / 1023)


def test_srgb_is_a_curve_and_back() -> None:
    """0.04045 is where the straight part ends, and half of the light is 188 of 255."""
    encoded = np.array([0.0, 0.02, 0.04045, 0.0405, 0.5, 1.0])
    assert rhi.to_srgb(rhi.from_srgb(encoded)) == pytest.approx(encoded, abs=1e-7)
    assert rhi.from_srgb(np.array([0.04045])) == pytest.approx([0.04045 / 12.92])
    assert np.rint(255 * rhi.to_srgb(np.array([0.5]))).tolist() == [188]
