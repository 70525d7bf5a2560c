"""Block compression: BC1 to BC7 (S3TC, RGTC, BPTC), and their decoder in NumPy.

- A block is 8 or 16 bytes for 4 × 4 texels. Levels consist of whole blocks; what lies beyond an edge isn't
  used.
- Definitions are those of the Khronos Data Format Specification 1.3, chapters 18 to 20. BC1 to BC5
  interpolate real numbers there. The decoder computes them exactly and rounds once, to the nearest number of
  8 bits; drivers may be off by a few units. BC6H and BC7 are defined to the bit.
- Blocks are decoded side by side, grouped by their mode: each step is one array operation over all blocks of
  a mode.
"""

from __future__ import annotations

import re
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import Format
from rhi.errors.choices import Choice
from rhi.errors.named_tuples import NamedTuple

BLOCK: Final = 4
"""Edge length of a block in texels."""
_STRIP: Final = 1 << 13  # blocks that are decoded at once, to bound the memory for their bits


class CompressedFormat(Choice):
    """A block-compressed format: (bytes of a block, the format of its decoded texels).

    The parts are also attributes: `block_bytes` and `decoded`.
    """

    BC1 = (8, "RGBA8")
    BC1_SRGB = (8, "RGBA8_SRGB")
    BC2 = (16, "RGBA8")
    BC2_SRGB = (16, "RGBA8_SRGB")
    BC3 = (16, "RGBA8")
    BC3_SRGB = (16, "RGBA8_SRGB")
    BC4 = (8, "R8")
    BC4_SNORM = (8, "R8_SNORM")
    BC5 = (16, "RG8")
    BC5_SNORM = (16, "RG8_SNORM")
    BC6H = (16, "RGBA16F")
    BC6H_SIGNED = (16, "RGBA16F")
    BC7 = (16, "RGBA8")
    BC7_SRGB = (16, "RGBA8_SRGB")

    block_bytes: int
    decoded: Format

    def __init__(self, block_bytes: int, decoded: str) -> None:
        self.block_bytes = block_bytes
        self.decoded = Format[decoded]

    def __new__(cls, *parts: object) -> CompressedFormat:
        member = object.__new__(cls)
        member._value_ = len(cls.__members__)  # formats with equal parts aren't aliases
        return member


def decode_blocks(format: CompressedFormat, blocks: NDArray[np.uint8]) -> NDArray[np.generic]:
    """Return the texels (…, 4 rows, 4 columns, channels) of blocks (…, bytes), in the format
    `format.decoded`."""
    shape = blocks.shape[:-1]
    flat = np.ascontiguousarray(blocks, np.uint8).reshape(-1, format.block_bytes)
    channels = format.decoded.channels
    texels = np.empty((len(flat), BLOCK * BLOCK, channels), format.decoded.dtype)
    for start in range(0, len(flat), _STRIP):
        texels[start : start + _STRIP] = _decode(format, flat[start : start + _STRIP])
    return texels.reshape(*shape, BLOCK, BLOCK, channels)


def _decode(format: CompressedFormat, flat: NDArray[np.uint8]) -> NDArray[np.generic]:
    """Return the texels of blocks (n, bytes), (n, 16, channels)."""
    kind = format.name.removesuffix("_SRGB")
    texels: NDArray[Any]
    if kind == "BC1":
        texels = _decode_colors(flat, True)
    elif kind in ("BC2", "BC3"):
        texels = _decode_colors(flat[:, 8:], False)
        texels[..., 3] = _decode_alphas(flat[:, :8]) if kind == "BC2" else _decode_channel(flat[:, :8], False)
    elif kind in ("BC6H", "BC6H_SIGNED"):
        texels = _decode_floats(flat, kind == "BC6H_SIGNED")
    elif kind == "BC7":
        texels = _decode_bc7(flat)
    else:
        signed = kind.endswith("_SNORM")
        parts = [_decode_channel(flat[:, at : at + 8], signed) for at in range(0, format.block_bytes, 8)]
        texels = np.stack(parts, axis=-1)
    return texels


def decode_level(
    format: CompressedFormat, blocks: NDArray[np.uint8], width: int, height: int
) -> NDArray[np.generic]:
    """Return the texels (layers, height, width, channels) of blocks (layers, rows, columns, bytes)."""
    layers, rows, columns, _ = blocks.shape
    texels = decode_blocks(format, blocks).swapaxes(2, 3).reshape(layers, rows * BLOCK, columns * BLOCK, -1)
    return np.ascontiguousarray(texels[:, :height, :width])


# -- BC1 to BC5 --------------------------------------------------------------------------------------------


def _round_ratio(numerator: Any, denominator: int) -> Any:
    """Return the integers nearest to a ratio; halves are rounded away from 0."""
    return np.sign(numerator) * ((2 * np.abs(numerator) + denominator) // (2 * denominator))


def _bits(blocks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bits of blocks, (n, 8 × bytes), the lowest of each byte first."""
    return np.unpackbits(blocks, axis=1, bitorder="little")


def _field(bits: NDArray[np.uint8], start: int, count: int) -> NDArray[np.int32]:
    """Return `count` bits from `start` on as numbers, (n,)."""
    weights = 1 << np.arange(count, dtype=np.int32)
    return np.asarray(bits[:, start : start + count].astype(np.int32) @ weights, np.int32)


def _fields(bits: NDArray[np.uint8], start: int, count: int) -> NDArray[np.int32]:
    """Return 16 consecutive numbers of `count` bits, (n, 16)."""
    weights = 1 << np.arange(count, dtype=np.int32)
    parts = bits[:, start : start + 16 * count].reshape(len(bits), 16, count)
    return np.asarray(parts.astype(np.int32) @ weights, np.int32)


def _decode_colors(blocks: NDArray[np.uint8], has_alpha: bool) -> NDArray[np.uint8]:
    """Decode the colors of BC1, (n, 16, 4). With alpha, the order of the two end colors says whether a texel
    may be transparent."""
    bits = _bits(blocks)
    palette = np.zeros((len(blocks), 4, 4), np.uint8)
    palette[..., 3] = 255
    first, second = _field(bits, 0, 16), _field(bits, 16, 16)
    opaque = (first > second) | (not has_alpha)
    for channel, (start, count) in enumerate(((11, 5), (5, 6), (0, 5))):
        largest = (1 << count) - 1
        a, b = first >> start & largest, second >> start & largest
        palette[:, 0, channel] = _round_ratio(255 * a, largest)
        palette[:, 1, channel] = _round_ratio(255 * b, largest)
        third, half = _round_ratio(255 * (2 * a + b), 3 * largest), _round_ratio(255 * (a + b), 2 * largest)
        palette[:, 2, channel] = np.where(opaque, third, half)
        palette[:, 3, channel] = np.where(opaque, _round_ratio(255 * (a + 2 * b), 3 * largest), 0)
    palette[:, 3, 3] = np.where(opaque, 255, 0)
    return np.asarray(np.take_along_axis(palette, _fields(bits, 32, 2)[..., None], axis=1))


def _decode_alphas(blocks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Decode the alphas of BC2, (n, 16): 4 bits each."""
    return (_fields(_bits(blocks), 0, 4) * 17).astype(np.uint8)


def _decode_channel(blocks: NDArray[np.uint8], signed: bool) -> NDArray[np.generic]:
    """Decode one channel of BC3, BC4 or BC5, (n, 16)."""
    dtype: Any = np.int8 if signed else np.uint8
    ends = blocks[:, :2].view(dtype).astype(np.int32)
    many = ends[:, 0] > ends[:, 1]
    ends = np.maximum(ends, -127)  # -128 also means -1
    a, b = ends[:, 0], ends[:, 1]
    palette = np.zeros((len(blocks), 8), np.int32)
    palette[:, 0], palette[:, 1] = a, b
    for step in range(1, 7):
        seventh = _round_ratio((7 - step) * a + step * b, 7)
        fifth = _round_ratio((5 - step) * a + step * b, 5) if step < 5 else (step - 5) * 255
        if signed and step >= 5:
            fifth = -127 if step == 5 else 127
        palette[:, step + 1] = np.where(many, seventh, fifth)
    return np.take_along_axis(palette, _fields(_bits(blocks), 16, 3), axis=1).astype(dtype)


# -- what BC6H and BC7 share -------------------------------------------------------------------------------

_WEIGHTS: Final = {
    2: np.array([0, 21, 43, 64]),
    3: np.array([0, 9, 18, 27, 37, 46, 55, 64]),
    4: np.array([0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64]),
}
# The subset of each texel. Of two: a hexadecimal number, texel 0 is its lowest bit. Of three: a digit per
# texel.
_TWO_SUBSETS: Final = """
    cccc 8888 eeee ecc8 c880 feec fec8 ec80 c800 ffec fe80 e800 ffe8 ff00 fff0 f000
    f710 008e 7100 08ce 008c 7310 3100 8cce 088c 3110 6666 366c 17e8 0ff0 718e 399c
    aaaa f0f0 5a5a 33cc 3c3c 55aa 9696 a55a 73ce 13c8 324c 3bdc 6996 c33c 9966 0660
    0272 04e4 4e40 2720 c936 936c 39c6 639c 9336 9cc6 817e e718 ccf0 0fcc 7744 ee22
"""
_THREE_SUBSETS: Final = """
    0011001102212222 0001001122112221 0000200122112211 0222002200110111 0000000011221122 0011001100220022
    0022002211111111 0011001122112211 0000000011112222 0000111111112222 0000111122222222 0012001200120012
    0112011201120112 0122012201220122 0011011211221222 0011200122002220 0001001101121122 0111001120012200
    0000112211221122 0022002200221111 0111011102220222 0001000122212221 0000001101220122 0000110022102210
    0122012200110000 0012001211222222 0110122112210110 0000011012211221 0022110211020022 0110011020022222
    0011012201220011 0000200022112221 0000000211221222 0222002200120011 0011001200220222 0120012001200120
    0000111122220000 0120120120120120 0120201212010120 0011220011220011 0011112222000011 0101010122222222
    0000000021212121 0022112200221122 0022001100220011 0220122102201221 0101222222220101 0000212121212121
    0101010101012222 0222011102220111 0002111200021112 0000211221122112 0222011101110222 0002111211120002
    0110011001102222 0000000021122112 0110011022222222 0022001100110022 0022112211220022 0000000000002112
    0002000100020001 0222122202221222 0101222222222222 0111201122012220
"""
# The texel of the second subset of two, and of the second and third of three, whose index lacks its highest
# bit.
_ANCHORS: Final = (
    "ffffffffffffffff f282288f28228822 ff6828ff28222ff6 6268ff22fffff22f",
    "33ff83ff88666533 338f336a588685ff 8f356a8ff3f5ffff 3f55585a5a8dfc33",
    "f883ff38fffffff8 f8f3f8f83f6affa8 f3faa89a6f8f3668 f3ffffffffff3ff8",
)


@cache
def _partitions(subsets: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the subset of each texel, and which texels are anchors, both (64, 16), by partition."""
    texels, anchors = np.zeros((64, 16), np.int64), np.zeros((64, 16), np.bool_)
    anchors[:, 0] = True
    if subsets == 2:
        numbers = np.array([int(word, 16) for word in _TWO_SUBSETS.split()])
        texels[:] = numbers[:, None] >> np.arange(16) & 1
    elif subsets == 3:
        texels[:] = [[int(digit) for digit in word] for word in _THREE_SUBSETS.split()]
    for row in {1: (), 2: _ANCHORS[:1], 3: _ANCHORS[1:]}[subsets]:
        anchors[np.arange(64), [int(digit, 16) for digit in row.replace(" ", "")]] = True
    return texels, anchors


def _indices(
    bits: NDArray[np.uint8], start: int, count: int, anchors: NDArray[np.bool_]
) -> NDArray[np.int32]:
    """Return 16 indices of `count` bits, (n, 16); the indices of anchors are one bit shorter."""
    sizes = count - anchors.astype(np.int64)
    starts = start + np.cumsum(sizes, axis=1) - sizes
    result = np.zeros(sizes.shape, np.int32)
    for bit in range(count):
        there = np.take_along_axis(bits, np.minimum(starts + bit, bits.shape[1] - 1), axis=1)
        result |= np.where(bit < sizes, there, 0).astype(np.int32) << bit
    return result


def _mix(first: Any, second: Any, weights: Any) -> Any:
    return first * (64 - weights) + second * weights + 32 >> 6


# -- BC7 ---------------------------------------------------------------------------------------------------


class _Bc7Mode(NamedTuple):
    """The fields of a mode. `unique_bits`: each end has a lowest bit of its own; `shared_bits`: each subset
    has one."""

    subsets: int
    partition_bits: int
    rotation_bits: int
    selection_bits: int
    color_bits: int
    alpha_bits: int
    unique_bits: bool
    shared_bits: bool
    index_bits: int
    second_bits: int


_BC7_MODES: Final = (
    _Bc7Mode(3, 4, 0, 0, 4, 0, True, False, 3, 0),
    _Bc7Mode(2, 6, 0, 0, 6, 0, False, True, 3, 0),
    _Bc7Mode(3, 6, 0, 0, 5, 0, False, False, 2, 0),
    _Bc7Mode(2, 6, 0, 0, 7, 0, True, False, 2, 0),
    _Bc7Mode(1, 0, 2, 1, 5, 6, False, False, 2, 3),
    _Bc7Mode(1, 0, 2, 0, 7, 8, False, False, 2, 2),
    _Bc7Mode(1, 0, 0, 0, 7, 7, True, False, 4, 0),
    _Bc7Mode(2, 6, 0, 0, 5, 5, True, False, 2, 0),
)


def _decode_bc7(blocks: NDArray[np.uint8]) -> NDArray[np.uint8]:
    texels = np.zeros((len(blocks), 16, 4), np.uint8)  # a reserved mode is transparent black
    lowest = blocks[:, 0] & -blocks[:, 0].astype(np.int16)
    for number, mode in enumerate(_BC7_MODES):
        block_indices = np.flatnonzero(lowest == 1 << number)
        if len(block_indices):
            texels[block_indices] = _decode_bc7_mode(_bits(blocks[block_indices]), mode, number + 1)
    return texels


def _decode_bc7_mode(bits: NDArray[np.uint8], mode: _Bc7Mode, start: int) -> NDArray[np.uint8]:
    def read(count: int) -> NDArray[np.int32]:
        nonlocal start
        start += count
        return _field(bits, start - count, count)

    partition, rotation, selection = (
        read(n) for n in (mode.partition_bits, mode.rotation_bits, mode.selection_bits)
    )
    ends = np.full((len(bits), mode.subsets, 2, 4), 255, np.int32)
    sizes = [*[mode.color_bits] * 3, *([mode.alpha_bits] if mode.alpha_bits else [])]
    for channel, size in enumerate(sizes):
        for end in range(2 * mode.subsets):
            ends[:, end // 2, end % 2, channel] = read(size)
    if mode.unique_bits or mode.shared_bits:
        for end in range(0, 2 * mode.subsets, 1 if mode.unique_bits else 2):
            bit = read(1)
            for index in (end,) if mode.unique_bits else (end, end + 1):
                part = ends[:, index // 2, index % 2, : len(sizes)]
                part[:] = part << 1 | bit[:, None]
        sizes = [size + 1 for size in sizes]
    for channel, size in enumerate(sizes):  # repeat the highest bits below
        part = ends[..., channel]
        part[:] = part << 8 - size | part >> 2 * size - 8
    subset_of, anchors = _partitions(mode.subsets)
    first = _indices(bits, start, mode.index_bits, anchors[partition])
    color_weights = alpha_weights = _WEIGHTS[mode.index_bits][first]
    if mode.second_bits:
        start += 16 * mode.index_bits - 1
        _, single = _partitions(1)
        second = _WEIGHTS[mode.second_bits][
            _indices(bits, start, mode.second_bits, single[np.zeros(len(bits), np.int64)])
        ]
        swapped = selection[:, None] == 1
        color_weights, alpha_weights = (
            np.where(swapped, second, color_weights),
            np.where(swapped, color_weights, second),
        )
    pixel_ends = ends[np.arange(len(bits))[:, None], subset_of[partition]]  # (n, 16, 2, 4)
    weights = np.stack([color_weights] * 3 + [alpha_weights], axis=-1)
    texels = _mix(pixel_ends[:, :, 0], pixel_ends[:, :, 1], weights)
    for channel in range(3):  # a rotation exchanges alpha with a color
        turned = rotation == channel + 1
        texels[turned] = texels[turned][..., _ROTATIONS[channel]]
    return np.asarray(texels, np.uint8)


_ROTATIONS: Final = ([3, 1, 2, 0], [0, 3, 2, 1], [0, 1, 3, 2])

# -- BC6H --------------------------------------------------------------------------------------------------


class _FloatMode(NamedTuple):
    """The fields of a mode behind its number: channel, end (w and x of subset 0, y and z of subset 1), and
    the bits from the first to the last. All ends but w are differences to w if the mode `differs`."""

    differs: bool
    end_bits: int
    difference_bits: tuple[int, int, int]
    fields: str


_FLOAT_MODES: Final = {
    0: _FloatMode(
        True,
        10,
        (5, 5, 5),
        ("gy4 by4 bz4 rw0:9 gw0:9 bw0:9 rx0:4 gz4 gy0:3 gx0:4 bz0 gz0:3 bx0:4 bz1 by0:3 ry0:4 bz2 rz0:4 bz3"),
    ),
    1: _FloatMode(
        True,
        7,
        (6, 6, 6),
        (
            "gy5 gz4 gz5 rw0:6 bz0 bz1 by4 gw0:6 by5 bz2 gy4 bw0:6 bz3 bz5 bz4 rx0:5 gy0:3 gx0:5 gz0:3 bx0:5 "
            "by0:3 ry0:5 rz0:5"
        ),
    ),
    2: _FloatMode(
        True,
        11,
        (5, 4, 4),
        ("rw0:9 gw0:9 bw0:9 rx0:4 rw10 gy0:3 gx0:3 gw10 bz0 gz0:3 bx0:3 bw10 bz1 by0:3 ry0:4 bz2 rz0:4 bz3"),
    ),
    3: _FloatMode(False, 10, (10, 10, 10), ("rw0:9 gw0:9 bw0:9 rx0:9 gx0:9 bx0:9")),
    6: _FloatMode(
        True,
        11,
        (4, 5, 4),
        (
            "rw0:9 gw0:9 bw0:9 rx0:3 rw10 gz4 gy0:3 gx0:4 gw10 gz0:3 bx0:3 bw10 bz1 by0:3 ry0:3 bz0 bz2 "
            "rz0:3 gy4 bz3"
        ),
    ),
    7: _FloatMode(True, 11, (9, 9, 9), ("rw0:9 gw0:9 bw0:9 rx0:8 rw10 gx0:8 gw10 bx0:8 bw10")),
    10: _FloatMode(
        True,
        11,
        (4, 4, 5),
        (
            "rw0:9 gw0:9 bw0:9 rx0:3 rw10 by4 gy0:3 gx0:3 gw10 bz0 gz0:3 bx0:4 bw10 by0:3 ry0:3 bz1 bz2 "
            "rz0:3 bz4 bz3"
        ),
    ),
    11: _FloatMode(True, 12, (8, 8, 8), ("rw0:9 gw0:9 bw0:9 rx0:7 rw11:10 gx0:7 gw11:10 bx0:7 bw11:10")),
    14: _FloatMode(
        True,
        9,
        (5, 5, 5),
        ("rw0:8 by4 gw0:8 gy4 bw0:8 bz4 rx0:4 gz4 gy0:3 gx0:4 bz0 gz0:3 bx0:4 bz1 by0:3 ry0:4 bz2 rz0:4 bz3"),
    ),
    15: _FloatMode(True, 16, (4, 4, 4), ("rw0:9 gw0:9 bw0:9 rx0:3 rw15:10 gx0:3 gw15:10 bx0:3 bw15:10")),
    18: _FloatMode(
        True,
        8,
        (6, 5, 5),
        ("rw0:7 gz4 by4 gw0:7 bz2 gy4 bw0:7 bz3 bz4 rx0:5 gy0:3 gx0:4 bz0 gz0:3 bx0:4 bz1 by0:3 ry0:5 rz0:5"),
    ),
    22: _FloatMode(
        True,
        8,
        (5, 6, 5),
        (
            "rw0:7 bz0 by4 gw0:7 gy5 gy4 bw0:7 gz5 bz4 rx0:4 gz4 gy0:3 gx0:5 gz0:3 bx0:4 bz1 by0:3 ry0:4 bz2 "
            "rz0:4 bz3"
        ),
    ),
    26: _FloatMode(
        True,
        8,
        (5, 5, 6),
        (
            "rw0:7 bz1 by4 gw0:7 by5 gy4 bw0:7 bz5 bz4 rx0:4 gz4 gy0:3 gx0:4 bz0 gz0:3 bx0:5 by0:3 ry0:4 bz2 "
            "rz0:4 bz3"
        ),
    ),
    30: _FloatMode(
        False,
        6,
        (6, 6, 6),
        (
            "rw0:5 gz4 bz0 bz1 by4 gw0:5 gy5 by5 bz2 gy4 bw0:5 gz5 bz3 bz5 bz4 rx0:5 gy0:3 gx0:5 gz0:3 bx0:5 "
            "by0:3 ry0:5 rz0:5"
        ),
    ),
}
_PARTITION_START: Final = 77
_FIELD: Final = r"([rgb])([wxyz])(\d+)(?::(\d+))?"


def _decode_floats(blocks: NDArray[np.uint8], signed: bool) -> NDArray[np.float16]:
    texels = np.zeros((len(blocks), 16, 4), np.uint16)  # a reserved mode is black
    number = np.where(blocks[:, 0] & 2, blocks[:, 0] & 31, blocks[:, 0] & 1)
    for mode_number, mode in _FLOAT_MODES.items():
        block_indices = np.flatnonzero(number == mode_number)
        if len(block_indices):
            start = 2 if mode_number < 2 else 5
            texels[block_indices, :, :3] = _decode_float_mode(
                _bits(blocks[block_indices]), mode, start, signed
            )
    texels[..., 3] = 0x3C00
    return texels.view(np.float16)


def _extend(values: Any, bits: int) -> Any:
    """Return numbers of `bits` bits in two's complement."""
    return (values & (1 << bits) - 1 ^ 1 << bits - 1) - (1 << bits - 1)


def _decode_float_mode(
    bits: NDArray[np.uint8], mode: _FloatMode, start: int, signed: bool
) -> NDArray[np.uint16]:
    ends = np.zeros((len(bits), 4, 3), np.int32)
    for channel, end, first, last in re.findall(_FIELD, mode.fields):
        step = 1 if int(first) <= int(last or first) else -1
        for bit in range(int(first), int(last or first) + step, step):
            ends[:, "wxyz".index(end), "rgb".index(channel)] |= bits[:, start].astype(np.int32) << bit
            start += 1
    subsets = 2 if "ry" in mode.fields else 1
    size = mode.end_bits
    if signed:
        ends[:, 0] = _extend(ends[:, 0], size)
    if mode.differs:
        for channel, count in enumerate(mode.difference_bits):
            ends[:, 1:, channel] = _extend(ends[:, 1:, channel], count)
        ends[:, 1:] = ends[:, 1:] + ends[:, :1] & (1 << size) - 1
    if signed:
        ends[:, 1:] = _extend(ends[:, 1:], size)
    ends = _unquantize(ends, size, signed)
    partition = _field(bits, _PARTITION_START, 5) if subsets == 2 else np.zeros(len(bits), np.int32)
    subset_of, anchors = _partitions(subsets)
    count = 3 if subsets == 2 else 4
    indices = _indices(bits, 82 if subsets == 2 else 65, count, anchors[partition])
    pixel_ends = ends.reshape(-1, 2, 2, 3)[np.arange(len(bits))[:, None], subset_of[partition]]
    mixed = _mix(pixel_ends[:, :, 0], pixel_ends[:, :, 1], _WEIGHTS[count][indices][..., None])
    if not signed:
        return np.asarray(mixed * 31 >> 6, np.uint16)
    size_bits = np.abs(mixed) * 31 >> 5
    return np.asarray(np.where(mixed < 0, size_bits | 0x8000, size_bits), np.uint16)


def _unquantize(values: NDArray[np.int32], bits: int, signed: bool) -> NDArray[np.int32]:
    if not signed:
        if bits >= 15:
            return values
        scaled = (values << 15) + 0x4000 >> bits - 1
        largest = (1 << bits) - 1
        return np.where(values == 0, 0, np.where(values == largest, 0xFFFF, scaled))
    if bits >= 16:
        return values
    size = np.abs(values)
    scaled = (size << 15) + 0x4000 >> bits - 1
    scaled = np.where(size == 0, 0, np.where(size >= (1 << bits - 1) - 1, 0x7FFF, scaled))
    return np.where(values < 0, -scaled, scaled)
