"""The description of a bound texture for lane code: its memory, format and sampler as 32-bit words.

The description is data, so that a program's text doesn't depend on which texture or sampler is bound. OpenCL
code (`rhi.shading.opencl.opencl_textures`) knows the numbers by the same names.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Filter, SamplerDescriptor, TextureKind, Wrap
from rhi.contract.formats import ChannelKind as FormatKind
from rhi.contract.formats import Format
from rhi.contract.states import Comparison
from rhi.errors.named_tuples import NamedTuple

LEVEL_ALIGNMENT: Final = 16
"""Alignment in bytes of levels and layers."""


class ChannelEncoding(enum.IntEnum):
    """The encoding of a channel, or of the channels of a packed texel.

    UNORM10 has 10, 10, 10 and 2 bits, UFLOAT11 has 11, 11 and 10. INTEGER8 and all after it are integers."""

    UNORM8 = 0
    SRGB8 = 1
    SNORM8 = 2
    UNORM16 = 3
    HALF = 4
    SINGLE = 5
    UNORM10 = 6
    UFLOAT11 = 7
    INTEGER8 = 8
    INTEGER10 = 9
    INTEGER16 = 10
    INTEGER32 = 11


class TextureWord(enum.IntEnum):
    """The position of each word in a description."""

    ENCODING = 0
    CHANNELS = 1
    TEXEL_BYTES = 2
    SHAPE = 3
    LEVEL_COUNT = 4
    MINIFY = 5  # whether linear
    MAGNIFY = 6
    MIP = 7
    ONE_FILTER = 8  # one level with one filter: the level of detail has no effect
    PLAIN8 = 9  # four channels of 8 bits, 2D or a 2D array, no border
    PLAIN_HALF = 10  # the same with half floats
    WRAP_U = 11
    WRAP_V = 12
    WRAP_W = 13
    HAS_BORDER = 14
    COMPARISON = 15
    BORDER_COLOR = 16
    CLAMPS_REFERENCE = 20  # whether references of comparisons are clamped: depth is in fixed point
    ANISOTROPY = 21  # a float: the maximum ratio of a pixel area's axes; 0 for a sampler without anisotropy
    FUNCTIONS = 22  # two words: address of the addresses of functions that sample, for kernels that call them
    PLAIN_DEPTH = 24  # one float, 2D or a 2D array; the sampler filters comparisons of one level
    LEVELS = 26  # even, as FUNCTIONS is


class LevelWord(enum.IntEnum):
    """The words of one mip level; levels follow each other. Rows and layers are counted in texels."""

    START = 0  # in grains
    WIDTH = 1
    HEIGHT = 2
    DEPTH = 3
    ROW = 4
    LAYER = 5


LEVEL_WORDS: Final = len(LevelWord)


class TextureShape(enum.IntEnum):
    """The meaning of a texture's third coordinate: none, a layer, the third dimension, a face."""

    FLAT = 0
    LAYERED = 1
    SOLID = 2
    CUBE = 3


class MipFilter(enum.IntEnum):
    """The filter between mip levels."""

    NO_MIP = 0
    NEAREST_MIP = 1
    LINEAR_MIP = 2


class WrapMode(enum.IntEnum):
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


_ENCODINGS: Final = {
    (FormatKind.UNORM, 8): ChannelEncoding.UNORM8,
    (FormatKind.SRGB, 8): ChannelEncoding.SRGB8,
    (FormatKind.SNORM, 8): ChannelEncoding.SNORM8,
    (FormatKind.UNORM, 16): ChannelEncoding.UNORM16,
    (FormatKind.FLOAT, 16): ChannelEncoding.HALF,
    (FormatKind.FLOAT, 32): ChannelEncoding.SINGLE,
    (FormatKind.DEPTH, 32): ChannelEncoding.SINGLE,
    (FormatKind.DEPTH_STENCIL, 32): ChannelEncoding.SINGLE,
    (FormatKind.UNORM, 10): ChannelEncoding.UNORM10,
    (FormatKind.FLOAT, 11): ChannelEncoding.UFLOAT11,
    (FormatKind.UINT, 8): ChannelEncoding.INTEGER8,
    (FormatKind.UINT, 10): ChannelEncoding.INTEGER10,
    (FormatKind.UINT, 16): ChannelEncoding.INTEGER16,
    (FormatKind.UINT, 32): ChannelEncoding.INTEGER32,
    (FormatKind.INT, 32): ChannelEncoding.INTEGER32,
}
"""Channel encodings by the kind of a format and the bits of its first channel."""
_SHAPES: Final = {
    TextureKind.D2: TextureShape.FLAT,
    TextureKind.D2_ARRAY: TextureShape.LAYERED,
    TextureKind.D3: TextureShape.SOLID,
    TextureKind.CUBE: TextureShape.CUBE,
}
_MIP_FILTERS: Final = {
    None: MipFilter.NO_MIP,
    Filter.NEAREST: MipFilter.NEAREST_MIP,
    Filter.LINEAR: MipFilter.LINEAR_MIP,
}
_WRAP_MODES: Final = {wrap: WrapMode[wrap.name] for wrap in Wrap}
_COMPARISONS: Final = {comparison: number for number, comparison in enumerate(Comparison, 1)}
_LOADS: Final = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)


def channel_encoding(format: Format) -> ChannelEncoding:
    """Return the encoding of a format's channels."""
    return _ENCODINGS[format.kind, format.channel_bits[0]]


def describe_texture(
    format: Format, kind: TextureKind, levels: Sequence[LevelLayout], sampler: SamplerDescriptor = _LOADS
) -> NDArray[np.int32]:
    """Return the words of a texture that is read through a sampler, or of one level used as an image.

    Integer formats are never filtered, nor anisotropic, and the edges of a cube are always seams.
    """
    words = np.zeros(TextureWord.LEVELS + LEVEL_WORDS * len(levels), np.int32)
    stored = channel_encoding(format)
    texel = format.transfer_bytes
    linear = [
        filter is Filter.LINEAR and not format.is_integer for filter in (sampler.minify, sampler.magnify)
    ]
    mip = MipFilter.NO_MIP if len(levels) == 1 else _MIP_FILTERS[sampler.mip]
    if format.is_integer and mip is MipFilter.LINEAR_MIP:
        mip = MipFilter.NEAREST_MIP
    edges = [_WRAP_MODES[wrap] for wrap in (sampler.wrap_u, sampler.wrap_v, sampler.wrap_w)]
    if kind is TextureKind.CUBE:
        edges = [WrapMode.SEAM] * 3
    used = edges if kind is TextureKind.D3 else edges[:2]
    words[TextureWord.ENCODING] = stored
    words[TextureWord.CHANNELS] = format.channels
    words[TextureWord.TEXEL_BYTES] = texel
    words[TextureWord.SHAPE] = _SHAPES[kind]
    words[TextureWord.LEVEL_COUNT] = len(levels)
    words[TextureWord.MINIFY], words[TextureWord.MAGNIFY] = linear
    words[TextureWord.MIP] = mip
    words[TextureWord.ONE_FILTER] = (
        mip is MipFilter.NO_MIP and linear[0] == linear[1] and kind is not TextureKind.CUBE
    )
    plain = (
        format.channels == 4
        and kind in (TextureKind.D2, TextureKind.D2_ARRAY)
        and WrapMode.BORDER not in used
    )
    words[TextureWord.PLAIN8] = plain and stored in (ChannelEncoding.UNORM8, ChannelEncoding.SRGB8)
    words[TextureWord.PLAIN_HALF] = plain and stored is ChannelEncoding.HALF
    words[TextureWord.PLAIN_DEPTH] = (
        stored is ChannelEncoding.SINGLE
        and bool(words[TextureWord.ONE_FILTER])
        and linear[0]
        and (texel, format.channels) == (4, 1)
        and kind in (TextureKind.D2, TextureKind.D2_ARRAY)
        and sampler.compare is not None
    )
    words[TextureWord.WRAP_U : TextureWord.WRAP_W + 1] = edges
    words[TextureWord.HAS_BORDER] = WrapMode.BORDER in used
    words[TextureWord.COMPARISON] = _COMPARISONS[sampler.compare] if sampler.compare is not None else 0
    words[TextureWord.CLAMPS_REFERENCE] = has_fixed_depth(format)
    words[TextureWord.ANISOTROPY] = np.float32(anisotropy_of(format, sampler)).view(np.int32)
    border = border_color(format, sampler)
    words[TextureWord.BORDER_COLOR : TextureWord.BORDER_COLOR + 4] = (
        border.astype(np.int64).astype(np.int32)
        if format.is_integer
        else border.astype(np.float32).view(np.int32)
    )
    for number, level in enumerate(levels):
        at = TextureWord.LEVELS + LEVEL_WORDS * number
        words[at + LevelWord.START] = np.uint32(level.start // LEVEL_ALIGNMENT).astype(np.int32)
        words[at + LevelWord.WIDTH] = level.width
        words[at + LevelWord.HEIGHT] = level.height
        words[at + LevelWord.DEPTH] = level.layers
        words[at + LevelWord.ROW] = level.pitch // texel
        words[at + LevelWord.LAYER] = level.layer_bytes // texel
    return words


def has_fixed_depth(format: Format) -> bool:
    """Return whether a format stores depth in fixed point; references of comparisons are then clamped to
    0…1."""
    return format in (Format.D16, Format.D24, Format.D24S8)


def anisotropy_of(format: Format, sampler: SamplerDescriptor) -> float:
    """Return the maximum anisotropy with which a format is sampled, 0 if it isn't."""
    return sampler.max_anisotropy if sampler.max_anisotropy > 1 and not format.is_integer else 0.0


def border_color(format: Format, sampler: SamplerDescriptor) -> NDArray[np.float64]:
    """Return the border color as a texel of the format: without channels the format lacks, clamped to its
    range."""
    border = np.array([0.0, 0.0, 0.0, 1.0])
    color = np.array(sampler.border, np.float64)[: format.channels]
    if format.kind in (FormatKind.UNORM, FormatKind.SRGB) or has_fixed_depth(format):
        color = np.clip(color, 0.0, 1.0)
    elif format.kind is FormatKind.SNORM:
        color = np.clip(color, -1.0, 1.0)
    elif format is Format.R11G11B10F:  # unsigned
        color = np.maximum(color, 0.0)
    border[: format.channels] = color
    return border


def enumerations() -> str:
    """Return the enumerations above as an OpenCL C enum, with names such as RHI_UNORM10."""
    numbers: dict[str, int] = {}
    for group in (ChannelEncoding, TextureWord, LevelWord, TextureShape, MipFilter, WrapMode):
        numbers |= {member.name: member.value for member in group}
    numbers |= {comparison.name: number for comparison, number in _COMPARISONS.items()}
    numbers |= {"LEVEL_ALIGNMENT": LEVEL_ALIGNMENT, "LEVEL_WORDS": LEVEL_WORDS}
    return "enum { " + ", ".join(f"RHI_{name} = {number}" for name, number in numbers.items()) + " };"
