"""Block compression, against decoders that compute one texel at a time from the definitions."""

from fractions import Fraction

import numpy as np
import pytest

from rhi.contract.blocks import CompressedFormat, decode_blocks, decode_level

RNG = np.random.default_rng(0)


def nearest(value):
    """The integer nearest to a fraction; halves away from 0."""
    whole = int(abs(value) + Fraction(1, 2))
    return whole if value >= 0 else -whole


def colors_of(block, has_alpha):
    """16 texels of a BC1 block: integers of 8 bits."""
    words = [int.from_bytes(block[i : i + 2], "little") for i in (0, 2)]
    ends = [[Fraction(w >> 11, 31), Fraction(w >> 5 & 63, 63), Fraction(w & 31, 31)] for w in words]
    palette = [[nearest(255 * c) for c in end] + [255] for end in ends]
    if words[0] > words[1] or not has_alpha:
        for t in (Fraction(1, 3), Fraction(2, 3)):
            palette.append([nearest(255 * ((1 - t) * a + t * b)) for a, b in zip(*ends, strict=True)] + [255])
    else:
        palette.append([nearest(255 * (a + b) / 2) for a, b in zip(*ends, strict=True)] + [255])
        palette.append([0, 0, 0, 0])
    indices = int.from_bytes(block[4:8], "little")
    return [palette[indices >> 2 * i & 3] for i in range(16)]


def channel_of(block, signed):
    """16 numbers of a BC4 block."""
    a, b = (int(np.int8(np.uint8(n))) if signed else int(n) for n in block[:2])
    many = a > b
    a, b = max(a, -127), max(b, -127)
    steps = 7 if many else 5
    palette = [a, b] + [nearest(Fraction((steps - i) * a + i * b, steps)) for i in range(1, steps)]
    palette += [] if many else [-127 if signed else 0, 127 if signed else 255]
    indices = int.from_bytes(block[2:8], "little")
    return [palette[indices >> 3 * i & 7] for i in range(16)]


def texels_of(format, block):
    kind = format.name.removesuffix("_SRGB")
    if kind == "BC1":
        return colors_of(block, True)
    if kind in ("BC2", "BC3"):
        alphas = int.from_bytes(block[:8], "little")
        alpha = (
            [(alphas >> 4 * i & 15) * 17 for i in range(16)]
            if kind == "BC2"
            else channel_of(block[:8], False)
        )
        return [[*color[:3], a] for color, a in zip(colors_of(block[8:], False), alpha, strict=True)]
    halves = [channel_of(block[i : i + 8], kind.endswith("_SNORM")) for i in range(0, len(block), 8)]
    return [list(texel) for texel in zip(*halves, strict=True)]


def hard_blocks(format):
    """Random blocks, with equal, ordered and extreme ends among them."""
    blocks = RNG.integers(0, 256, (300, format.block_bytes), np.uint8)
    blocks[:20] = 0
    blocks[20:30] = 255
    blocks[30:60, 2:4] = blocks[30:60, 0:2]
    blocks[60:90, 1] = blocks[60:90, 0]
    blocks[90:100, :2] = (128, 127)
    blocks[100:110, :2] = (127, 128)
    blocks[20:110, -4:] = RNG.integers(0, 256, (90, 4), np.uint8)
    return blocks


@pytest.mark.parametrize("format", [f for f in CompressedFormat if f.name[:3] < "BC6"], ids=lambda f: f.name)
def test_ratios_are_computed_exactly_and_rounded_once(format):
    blocks = hard_blocks(format)
    expected = np.array([texels_of(format, bytes(block)) for block in blocks])
    np.testing.assert_array_equal(decode_blocks(format, blocks).reshape(expected.shape), expected)


def pack(*fields):
    """A block of (value, bits) from the lowest bit on."""
    number = position = 0
    for value, bits in fields:
        number |= value << position
        position += bits
    assert position <= 128
    return np.frombuffer(number.to_bytes(16, "little"), np.uint8)


def test_mode_6_of_bc7_has_two_ends_and_16_steps():
    ends = [(0, 127), (127, 0), (64, 64), (127, 127)]  # red, green, blue, alpha of both
    fields = (
        [(n, 7) for pair in ends for n in pair] + [(0, 1), (1, 1), (7, 3)] + [(i, 4) for i in range(1, 16)]
    )
    block = pack((1 << 6, 7), *fields)
    texels = decode_blocks(CompressedFormat.BC7, block).reshape(16, 4)
    weights = [0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64]
    whole = [(2 * a, 2 * b + 1) for a, b in ends]
    for index, texel in enumerate(texels.tolist()):
        w = weights[7 if index == 0 else index]
        assert texel == [(a * (64 - w) + b * w + 32) >> 6 for a, b in whole]


def test_a_rotation_of_bc7_exchanges_alpha():
    fields = [(1 << 5, 6), (0, 2), (100, 7), (100, 7), (50, 7), (50, 7), (20, 7), (20, 7), (200, 8), (200, 8)]
    plain = decode_blocks(CompressedFormat.BC7, pack(*fields))[0, 0].tolist()
    assert plain == [100 << 1 | 100 >> 6, 50 << 1 | 50 >> 6, 20 << 1 | 20 >> 6, 200]
    for rotation in (1, 2, 3):
        fields[1] = (rotation, 2)
        turned = list(plain)
        turned[3], turned[rotation - 1] = turned[rotation - 1], turned[3]
        assert decode_blocks(CompressedFormat.BC7, pack(*fields))[0, 0].tolist() == turned


def test_two_subsets_of_bc7_have_their_own_ends():
    """Partition 13: the lower half of the block. Mode 1 with equal ends in each subset."""
    reds, zero = [(10, 6), (10, 6), (50, 6), (50, 6)], [(0, 6)] * 4
    texels = decode_blocks(CompressedFormat.BC7, pack((2, 2), (13, 6), *reds, *zero, *zero, (0, 2)))
    seven = [n << 1 for n in (10, 50)]
    assert texels[:2, :, 0].tolist() == [[seven[0] << 1 | seven[0] >> 6] * 4] * 2
    assert texels[2:, :, 0].tolist() == [[seven[1] << 1 | seven[1] >> 6] * 4] * 2


def test_a_reserved_mode_is_black():
    assert not decode_blocks(CompressedFormat.BC7, np.zeros(16, np.uint8)).any()
    for mode in (19, 23, 27, 31):
        texels = decode_blocks(CompressedFormat.BC6H, pack((mode, 5), (1 << 100, 123)))
        np.testing.assert_array_equal(texels.reshape(16, 4), [(0, 0, 0, 1)] * 16)


@pytest.mark.parametrize(
    ("format", "bits", "expected"),
    [
        (CompressedFormat.BC6H, 0, 0.0),
        (CompressedFormat.BC6H, 1023, 65504.0),
        (CompressedFormat.BC6H_SIGNED, 511, 65504.0),
        (CompressedFormat.BC6H_SIGNED, 512, -65504.0),
    ],
)
def test_mode_3_of_bc6h_stores_both_ends(format, bits, expected):
    texels = decode_blocks(format, pack((3, 5), *[(bits, 10)] * 6)).reshape(16, 4)
    np.testing.assert_array_equal(texels, [(expected, expected, expected, 1)] * 16)


def test_a_level_is_cut_at_its_edges():
    blocks = RNG.integers(0, 256, (2, 2, 3, 8), np.uint8)
    level = decode_level(CompressedFormat.BC4, blocks, 10, 7)
    assert level.shape == (2, 7, 10, 1)
    np.testing.assert_array_equal(
        level[1, 4:7, 8:10], decode_blocks(CompressedFormat.BC4, blocks[1, 1, 2])[:3, :2]
    )


def test_formats_with_equal_parts_are_different():
    assert CompressedFormat.BC2 is not CompressedFormat.BC3
    assert len(set(CompressedFormat)) == 14
