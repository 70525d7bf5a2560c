"""WebGPU's words for the contract's values."""

from __future__ import annotations

from enum import Enum
from typing import Final, TypeVar

from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import Primitive, TextureKind, VertexFormat, Wrap
from rhi.contract.formats import Format
from rhi.contract.states import BlendFactor, BlendOperation, StencilOperation
from rhi.shading.wgsl.wgsl_names import texel_format

C = TypeVar("C", bound=Enum)


def word(name: str) -> str:
    """Return WebGPU's word for a comparison or a filter, whose names are the same."""
    return name.lower().replace("_", "-")


def _translate_members(kind: type[C], **words: str) -> dict[C, str]:
    """Return WebGPU's words for an enum's members: their values, with some `words` replaced."""
    values = {member: str(member.value) for member in kind}
    for ours, theirs in words.items():
        values = {member: value.replace(ours, theirs) for member, value in values.items()}
    return {member: word(value) for member, value in values.items()}


FORMATS: Final = {format: texel_format(format) for format in Format}
DUMMY_FORMAT: Final = Format.R8
"""The format of the target of passes without targets."""
COMPRESSED: Final = {
    CompressedFormat.BC1: "bc1-rgba-unorm",
    CompressedFormat.BC1_SRGB: "bc1-rgba-unorm-srgb",
    CompressedFormat.BC2: "bc2-rgba-unorm",
    CompressedFormat.BC2_SRGB: "bc2-rgba-unorm-srgb",
    CompressedFormat.BC3: "bc3-rgba-unorm",
    CompressedFormat.BC3_SRGB: "bc3-rgba-unorm-srgb",
    CompressedFormat.BC4: "bc4-r-unorm",
    CompressedFormat.BC4_SNORM: "bc4-r-snorm",
    CompressedFormat.BC5: "bc5-rg-unorm",
    CompressedFormat.BC5_SNORM: "bc5-rg-snorm",
    CompressedFormat.BC6H: "bc6h-rgb-ufloat",
    CompressedFormat.BC6H_SIGNED: "bc6h-rgb-float",
    CompressedFormat.BC7: "bc7-rgba-unorm",
    CompressedFormat.BC7_SRGB: "bc7-rgba-unorm-srgb",
}
FACTORS: Final = _translate_members(
    BlendFactor,
    source_color="src",
    destination_color="dst",
    source="src",
    destination="dst",
    saturate="saturated",
)
OPERATIONS: Final = _translate_members(BlendOperation, minimum="min", maximum="max")
STENCIL: Final = {
    StencilOperation.KEEP: "keep",
    StencilOperation.ZERO: "zero",
    StencilOperation.REPLACE: "replace",
    StencilOperation.INCREMENT: "increment-clamp",
    StencilOperation.INCREMENT_WRAP: "increment-wrap",
    StencilOperation.DECREMENT: "decrement-clamp",
    StencilOperation.DECREMENT_WRAP: "decrement-wrap",
    StencilOperation.INVERT: "invert",
}
TOPOLOGIES: Final = {
    Primitive.POINTS: "point-list",
    Primitive.LINES: "line-list",
    Primitive.LINE_STRIP: "line-strip",
    Primitive.TRIANGLES: "triangle-list",
    Primitive.TRIANGLE_STRIP: "triangle-strip",
    Primitive.TRIANGLE_FAN: "triangle-list",
    Primitive.QUADS: "triangle-list",
}
"""Topologies; fans and quads are drawn as triangles with other indices."""
VERTICES: Final = {
    VertexFormat.FLOAT: "float32",
    VertexFormat.FLOAT2: "float32x2",
    VertexFormat.FLOAT3: "float32x3",
    VertexFormat.FLOAT4: "float32x4",
    VertexFormat.HALF2: "float16x2",
    VertexFormat.HALF4: "float16x4",
    VertexFormat.UINT: "uint32",
    VertexFormat.UINT2: "uint32x2",
    VertexFormat.UINT3: "uint32x3",
    VertexFormat.UINT4: "uint32x4",
    VertexFormat.INT: "sint32",
    VertexFormat.INT2: "sint32x2",
    VertexFormat.INT3: "sint32x3",
    VertexFormat.INT4: "sint32x4",
    VertexFormat.UNORM8X4: "unorm8x4",
    VertexFormat.SNORM8X4: "snorm8x4",
    VertexFormat.UNORM16X2: "unorm16x2",
    VertexFormat.SNORM16X2: "snorm16x2",
    VertexFormat.UINT8X4: "uint8x4",
    VertexFormat.UINT16X2: "uint16x2",
}
DIMENSIONS: Final = _translate_members(TextureKind)
WRAPS: Final = _translate_members(Wrap, mirror="mirror_repeat", clamp="clamp_to_edge", border="clamp_to_edge")
"""Address modes; `Wrap.BORDER` is refused by the device."""
