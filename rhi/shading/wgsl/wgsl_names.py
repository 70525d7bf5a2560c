"""The reserved words of WGSL, and WebGPU's names of texel formats."""

from __future__ import annotations

import re
from typing import Final

from rhi.contract.formats import ChannelKind, Format
from rhi.shading.language.builtins import BUILTINS

_WORDS: Final = """
alias break case const const_assert continue continuing default diagnostic discard else enable false fn for if let loop
override requires return struct switch true var while NULL Self abstract active alignas alignof as asm asm_fragment
async attribute auto await become cast catch class co_await co_return co_yield coherent column_major common compile
compile_fragment concept const_cast consteval constexpr constinit crate debugger decltype delete demote
demote_to_helper do dynamic_cast enum explicit export extends extern external fallthrough filter final finally friend
from fxgroup get goto groupshared highp impl implements import inline instanceof interface layout lowp macro
macro_rules match mediump meta mod module move mut mutable namespace new nil noexcept noinline nointerpolation
non_coherent noncoherent noperspective null nullptr of operator package packoffset partition pass patch pixelfragment
precise precision premerge priv protected pub public readonly ref regardless register reinterpret_cast require resource
restrict self set shared sizeof smooth snorm static static_assert static_cast std subroutine super target template this
thread_local throw trait try type typedef typeid typename typeof union unless unorm unsafe unsized use using varying
virtual volatile wgsl where with writeonly yield
array atomic bool f16 f32 f64 i32 i64 u32 u64 ptr vec2 vec3 vec4 vec2f vec3f vec4f vec2i vec3i vec4i vec2u vec3u vec4u
sampler sampler_comparison texture_1d texture_2d texture_2d_array texture_3d texture_cube texture_multisampled_2d
function private workgroup uniform storage read write read_write bitcast select main main_1 arrayLength RhiOutputs
"""
_FUNCTIONS: Final = """
acos all any asin atan atan2 ceil clamp cos cross degrees determinant distance dot exp exp2 floor fma fract length log
log2 max min mix normalize pow radians reflect refract round saturate sign sin smoothstep sqrt step tan transpose trunc
dpdx dpdy fwidth countOneBits reverseBits extractBits insertBits firstLeadingBit firstTrailingBit faceForward modf frexp
ldexp inverseSqrt quantizeToF16 atomicLoad atomicStore atomicCompareExchangeWeak storageBarrier workgroupBarrier
textureDimensions textureNumLayers textureNumLevels textureLoad textureStore textureGather textureGatherCompare
textureSample textureSampleBias textureSampleLevel textureSampleGrad textureSampleCompare textureSampleCompareLevel
"""
_SHAPES: Final = ("1d", "2d", "2d_array", "3d", "cube", "cube_array", "multisampled_2d")
_DEPTHS: Final = {
    Format.D16: "depth16unorm",
    Format.D24: "depth24plus",
    Format.D32F: "depth32float",
    Format.D24S8: "depth24plus-stencil8",
    Format.D32FS8: "depth32float-stencil8",
}
_KINDS: Final = {
    ChannelKind.UNORM: "unorm",
    ChannelKind.SNORM: "snorm",
    ChannelKind.FLOAT: "float",
    ChannelKind.UINT: "uint",
    ChannelKind.INT: "sint",
    ChannelKind.SRGB: "unorm-srgb",
}


def texel_format(format: Format) -> str:
    """Return WebGPU's name of a texel format, which is also WGSL's."""
    if format in _DEPTHS:
        return _DEPTHS[format]
    if format is Format.R11G11B10F:
        return "rg11b10ufloat"
    base = re.match(r"RGB10A2|[A-Z]+\d+", format.name)
    assert base is not None
    return base[0].lower() + _KINDS[format.kind]


RESERVED: Final = frozenset(
    [
        *_WORDS.split(),
        *_FUNCTIONS.split(),
        *BUILTINS,
        *(row.wgsl.partition("(")[0] for row in BUILTINS.values() if isinstance(row.wgsl, str)),
        *(
            f"mat{columns}x{rows}{suffix}"
            for columns in (2, 3, 4)
            for rows in (2, 3, 4)
            for suffix in ("", "f", "h")
        ),
        *(f"texture_{kind}{shape}" for kind in ("", "depth_", "storage_") for shape in _SHAPES),
        *map(texel_format, Format),
    ]
)
"""Words that can't be identifiers, and the names of functions, which an identifier would hide."""
