"""The description of a bound texture for lane programs: its memory, format and sampler as 32-bit words.

The description is data, so that a program's text doesn't depend on which texture or sampler is bound. OpenCL code
(`rhi.shading.opencl.textures`) knows the numbers by the same names.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Filter, SamplerDescriptor, TextureKind, Wrap
from rhi.contract.formats import ChannelKind as FormatKind
from rhi.contract.formats import Format
from rhi.contract.states import Comparison

GRAIN: Final = 16
"""Alignment in bytes of levels and layers."""


class Stored(enum.IntEnum):
    """The storage type of a channel, or of the channels of a packed texel: UNORM10 is 10, 10, 10 and 2 bits, POSITIVE11
    is 11, 11 and 10. WHOLE8 and those after it are integers."""

    UNORM8 = 0
    SRGB8 = 1
    SNORM8 = 2
    UNORM16 = 3
    HALF = 4
    SINGLE = 5
    UNORM10 = 6
    POSITIVE11 = 7
    WHOLE8 = 8
    WHOLE10 = 9
    WHOLE16 = 10
    WHOLE32 = 11


class Word(enum.IntEnum):
    """The position of each word in a description."""

    STORED = 0
    CHANNELS = 1
    TEXEL = 2  # bytes
    SHAPE = 3
    LEVEL_COUNT = 4
    MINIFY = 5  # whether linear
    MAGNIFY = 6
    MIP = 7
    ONE_FILTER = 8  # one level with one filter: the level of detail has no effect
    PLAIN8 = 9  # four channels of 8 bits, 2D or a 2D array, no border
    PLAIN_HALF = 10  # the same of half floats
    WRAP_U = 11
    WRAP_V = 12
    WRAP_W = 13
    HAS_BORDER = 14
    COMPARISON = 15
    BORDER_COLOR = 16
    CLAMPED = 20  # whether references of comparisons are clamped: depth is in fixed point
    ANISOTROPY = 21  # a float: the most that a footprint's longer axis is of its shorter one; 0 for a sampler without
    LEVELS = 22


class LevelWord(enum.IntEnum):
    """The words of one mip level; levels follow each other. Rows and layers are counted in texels."""

    START = 0  # in grains
    WIDTH = 1
    HEIGHT = 2
    DEPTH = 3
    ROW = 4
    LAYER = 5


LEVEL_WORDS: Final = len(LevelWord)


class Shape(enum.IntEnum):
    """The meaning of a texture's third coordinate: none, a layer, the third dimension, a face."""

    FLAT = 0
    LAYERED = 1
    SOLID = 2
    CUBE = 3


class Mip(enum.IntEnum):
    """The filter between mip levels."""

    NO_MIP = 0
    NEAREST_MIP = 1
    LINEAR_MIP = 2


class Edge(enum.IntEnum):
    """The wrap mode at an edge. SEAM continues on the adjacent face of a cube."""

    REPEAT = 0
    MIRROR = 1
    CLAMP = 2
    BORDER = 3
    SEAM = 4


class LevelLayout(NamedTuple):
    """The memory layout of a mip level in bytes, and its size in texels."""

    start: int
    width: int
    height: int
    layers: int
    pitch: int
    layer_bytes: int


_STORED: Final = {
    (FormatKind.UNORM, 8): Stored.UNORM8,
    (FormatKind.SRGB, 8): Stored.SRGB8,
    (FormatKind.SNORM, 8): Stored.SNORM8,
    (FormatKind.UNORM, 16): Stored.UNORM16,
    (FormatKind.FLOAT, 16): Stored.HALF,
    (FormatKind.FLOAT, 32): Stored.SINGLE,
    (FormatKind.DEPTH, 32): Stored.SINGLE,
    (FormatKind.DEPTH_STENCIL, 32): Stored.SINGLE,
    (FormatKind.UNORM, 10): Stored.UNORM10,
    (FormatKind.FLOAT, 11): Stored.POSITIVE11,
    (FormatKind.UINT, 8): Stored.WHOLE8,
    (FormatKind.UINT, 10): Stored.WHOLE10,
    (FormatKind.UINT, 16): Stored.WHOLE16,
    (FormatKind.UINT, 32): Stored.WHOLE32,
    (FormatKind.INT, 32): Stored.WHOLE32,
}
"""Storage types by the kind of a format and the bits of its first channel."""
_SHAPES: Final = {
    TextureKind.D2: Shape.FLAT,
    TextureKind.D2_ARRAY: Shape.LAYERED,
    TextureKind.D3: Shape.SOLID,
    TextureKind.CUBE: Shape.CUBE,
}
_MIPS: Final = {None: Mip.NO_MIP, Filter.NEAREST: Mip.NEAREST_MIP, Filter.LINEAR: Mip.LINEAR_MIP}
_EDGES: Final = {wrap: Edge[wrap.name] for wrap in Wrap}
_COMPARISONS: Final = {comparison: number for number, comparison in enumerate(Comparison, 1)}
_LOADS: Final = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)


def find_stored(format: Format) -> Stored:
    """Return the storage type of a format's channels."""
    return _STORED[format.kind, format.channel_bits[0]]


def describe_texture(
    format: Format, kind: TextureKind, levels: Sequence[LevelLayout], sampler: SamplerDescriptor = _LOADS
) -> NDArray[np.int32]:
    """Return the words of a texture that is read through a sampler, or of one level used as an image.

    Integer formats are never filtered, nor anisotropic, and the edges of a cube are always seams.
    """
    words = np.zeros(Word.LEVELS + LEVEL_WORDS * len(levels), np.int32)
    stored = find_stored(format)
    texel = format.transfer_bytes
    linear = [filter is Filter.LINEAR and not format.is_integer for filter in (sampler.minify, sampler.magnify)]
    mip = Mip.NO_MIP if len(levels) == 1 else _MIPS[sampler.mip]
    if format.is_integer and mip is Mip.LINEAR_MIP:
        mip = Mip.NEAREST_MIP
    edges = [_EDGES[wrap] for wrap in (sampler.wrap_u, sampler.wrap_v, sampler.wrap_w)]
    if kind is TextureKind.CUBE:
        edges = [Edge.SEAM] * 3
    used = edges if kind is TextureKind.D3 else edges[:2]
    words[Word.STORED] = stored
    words[Word.CHANNELS] = format.channels
    words[Word.TEXEL] = texel
    words[Word.SHAPE] = _SHAPES[kind]
    words[Word.LEVEL_COUNT] = len(levels)
    words[Word.MINIFY], words[Word.MAGNIFY] = linear
    words[Word.MIP] = mip
    words[Word.ONE_FILTER] = mip is Mip.NO_MIP and linear[0] == linear[1] and kind is not TextureKind.CUBE
    plain = format.channels == 4 and kind in (TextureKind.D2, TextureKind.D2_ARRAY) and Edge.BORDER not in used
    words[Word.PLAIN8] = plain and stored in (Stored.UNORM8, Stored.SRGB8)
    words[Word.PLAIN_HALF] = plain and stored is Stored.HALF
    words[Word.WRAP_U : Word.WRAP_W + 1] = edges
    words[Word.HAS_BORDER] = Edge.BORDER in used
    words[Word.COMPARISON] = _COMPARISONS[sampler.compare] if sampler.compare is not None else 0
    words[Word.CLAMPED] = has_fixed_depth(format)
    words[Word.ANISOTROPY] = np.float32(anisotropy_of(format, sampler)).view(np.int32)
    border = border_color(format, sampler)
    words[Word.BORDER_COLOR : Word.BORDER_COLOR + 4] = (
        border.astype(np.int64).astype(np.int32) if format.is_integer else border.astype(np.float32).view(np.int32)
    )
    for number, level in enumerate(levels):
        at = Word.LEVELS + LEVEL_WORDS * number
        words[at + LevelWord.START] = np.uint32(level.start // GRAIN).astype(np.int32)
        words[at + LevelWord.WIDTH] = level.width
        words[at + LevelWord.HEIGHT] = level.height
        words[at + LevelWord.DEPTH] = level.layers
        words[at + LevelWord.ROW] = level.pitch // texel
        words[at + LevelWord.LAYER] = level.layer_bytes // texel
    return words


def has_fixed_depth(format: Format) -> bool:
    """Return whether depth is in fixed point, so that references of comparisons are clamped to 0…1."""
    return format in (Format.D16, Format.D24, Format.D24S8)


def anisotropy_of(format: Format, sampler: SamplerDescriptor) -> float:
    """Return the anisotropy that a format is read with, 0 if it is none."""
    return sampler.max_anisotropy if sampler.max_anisotropy > 1 and not format.is_integer else 0.0


def border_color(format: Format, sampler: SamplerDescriptor) -> NDArray[np.float64]:
    """Return the border color as a texel of the format: without channels the format lacks, clamped to its range."""
    border = np.array([0.0, 0.0, 0.0, 1.0])
    given = np.array(sampler.border, np.float64)[: format.channels]
    if format.kind in (FormatKind.UNORM, FormatKind.SRGB) or has_fixed_depth(format):
        given = np.clip(given, 0.0, 1.0)
    elif format.kind is FormatKind.SNORM:
        given = np.clip(given, -1.0, 1.0)
    elif format is Format.R11G11B10F:  # which has no sign
        given = np.maximum(given, 0.0)
    border[: format.channels] = given
    return border


def enumerations() -> str:
    """Return the numbers above as an OpenCL C enum: each name is RHI_ and the member's name."""
    numbers: dict[str, int] = {}
    for group in (Stored, Word, LevelWord, Shape, Mip, Edge):
        numbers |= {member.name: member.value for member in group}
    numbers |= {comparison.name: number for comparison, number in _COMPARISONS.items()}
    numbers |= {"GRAIN": GRAIN, "LEVEL_WORDS": LEVEL_WORDS}
    return "enum { " + ", ".join(f"RHI_{name} = {number}" for name, number in numbers.items()) + " };"
