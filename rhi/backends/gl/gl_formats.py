"""GL's enumerants for texel, vertex and index formats."""

from __future__ import annotations

from enum import Enum
from typing import Final, NamedTuple, TypeVar

from rhi.backends.gl import enums
from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import VertexFormat
from rhi.contract.formats import Format, IndexFormat

C = TypeVar("C", bound=Enum)


def map_enums(kind: type[C], **words: str) -> dict[C, int]:
    """Map the members of an enumeration to GL's enumerants of the same names, with `words` replaced."""
    names = {member: member.name for member in kind}
    for ours, theirs in words.items():
        names = {member: name.replace(ours, theirs) for member, name in names.items()}
    return {member: getattr(enums, name) for member, name in names.items()}


class PixelFormat(NamedTuple):
    """GL's internal format of a texel format, and the format and type of transfers between CPU and
    texture."""

    internal: int
    format: int
    type: int


_NAMES: Final = {
    "RGBA8_SRGB": "SRGB8_ALPHA8",
    "RGB10A2": "RGB10_A2",
    "RGB10A2UI": "RGB10_A2UI",
    "R11G11B10F": "R11F_G11F_B10F",
    "D16": "DEPTH_COMPONENT16",
    "D24": "DEPTH_COMPONENT24",
    "D32F": "DEPTH_COMPONENT32F",
    "D24S8": "DEPTH24_STENCIL8",
    "D32FS8": "DEPTH32F_STENCIL8",
}
"""The formats that have another name in GL."""

_INTERNAL: Final[dict[Format, int]] = {
    texel_format: getattr(enums, _NAMES.get(texel_format.name, texel_format.name)) for texel_format in Format
}

_TYPES: Final = {
    "u1": enums.UNSIGNED_BYTE,
    "i1": enums.BYTE,
    "u2": enums.UNSIGNED_SHORT,
    "i2": enums.SHORT,
    "u4": enums.UNSIGNED_INT,
    "i4": enums.INT,
    "f2": enums.HALF_FLOAT,
    "f4": enums.FLOAT,
}

_PACKED_TYPES: Final = {
    (10, 10, 10, 2): enums.UNSIGNED_INT_2_10_10_10_REV,
    (11, 11, 10): enums.UNSIGNED_INT_10F_11F_11F_REV,
}

_CHANNELS: Final = {1: enums.RED, 2: enums.RG, 3: enums.RGB, 4: enums.RGBA}
_INTEGER_CHANNELS: Final = {1: enums.RED_INTEGER, 2: enums.RG_INTEGER, 4: enums.RGBA_INTEGER}


def _describe(texel_format: Format) -> PixelFormat:
    if texel_format.is_depth:
        return PixelFormat(_INTERNAL[texel_format], enums.DEPTH_COMPONENT, enums.FLOAT)
    channels = _INTEGER_CHANNELS if texel_format.is_integer else _CHANNELS
    kind = (
        _PACKED_TYPES[texel_format.channel_bits]
        if texel_format.is_packed
        else _TYPES[texel_format.dtype.str[1:]]
    )
    return PixelFormat(_INTERNAL[texel_format], channels[texel_format.channels], kind)


PIXEL_FORMATS: Final = {texel_format: _describe(texel_format) for texel_format in Format}
"""Formats for transfers. Depth formats are transferred as float depth; stencil is read as STENCIL_INDEX."""

CLEAR_FORMATS: Final = PIXEL_FORMATS | {
    Format.D24S8: PixelFormat(enums.DEPTH24_STENCIL8, enums.DEPTH_STENCIL, enums.UNSIGNED_INT_24_8),
    Format.D32FS8: PixelFormat(
        enums.DEPTH32F_STENCIL8, enums.DEPTH_STENCIL, enums.FLOAT_32_UNSIGNED_INT_24_8_REV
    ),
}
"""Formats for clears, which include the stencil part."""

COMPRESSED: Final = {
    CompressedFormat.BC1: enums.COMPRESSED_RGBA_S3TC_DXT1,
    CompressedFormat.BC1_SRGB: enums.COMPRESSED_SRGB_ALPHA_S3TC_DXT1,
    CompressedFormat.BC2: enums.COMPRESSED_RGBA_S3TC_DXT3,
    CompressedFormat.BC2_SRGB: enums.COMPRESSED_SRGB_ALPHA_S3TC_DXT3,
    CompressedFormat.BC3: enums.COMPRESSED_RGBA_S3TC_DXT5,
    CompressedFormat.BC3_SRGB: enums.COMPRESSED_SRGB_ALPHA_S3TC_DXT5,
    CompressedFormat.BC4: enums.COMPRESSED_RED_RGTC1,
    CompressedFormat.BC4_SNORM: enums.COMPRESSED_SIGNED_RED_RGTC1,
    CompressedFormat.BC5: enums.COMPRESSED_RG_RGTC2,
    CompressedFormat.BC5_SNORM: enums.COMPRESSED_SIGNED_RG_RGTC2,
    CompressedFormat.BC6H: enums.COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT,
    CompressedFormat.BC6H_SIGNED: enums.COMPRESSED_RGB_BPTC_SIGNED_FLOAT,
    CompressedFormat.BC7: enums.COMPRESSED_RGBA_BPTC_UNORM,
    CompressedFormat.BC7_SRGB: enums.COMPRESSED_SRGB_ALPHA_BPTC_UNORM,
}
"""Internal formats of block-compressed textures."""

VERTEX_TYPES: Final = {vertex: _TYPES[vertex.code] for vertex in VertexFormat}

INDEX_TYPES: Final = {
    IndexFormat.UINT16: enums.UNSIGNED_SHORT,
    IndexFormat.UINT32: enums.UNSIGNED_INT,
}
