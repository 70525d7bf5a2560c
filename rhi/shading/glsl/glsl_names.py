"""The reserved words and built-in names of GLSL."""

from __future__ import annotations

from typing import Final

from rhi.shading.language.builtins import BUILTINS

_KEYWORDS: Final = """
attribute const uniform varying buffer shared coherent volatile restrict readonly writeonly atomic_uint
layout centroid flat smooth noperspective patch sample break continue do for while switch case default if
else subroutine in out inout float double int void bool true false invariant precise discard return lowp
mediump highp precision struct common partition active asm class union enum typedef template this resource
goto inline noinline public static extern external interface long short half fixed unsigned superp input
output filter sizeof cast namespace using main row_major packed hvec2 hvec3 hvec4 fvec2 fvec3 fvec4 dvec2
dvec3 dvec4 dmat2 dmat3 dmat4 vec2 vec3 vec4 ivec2 ivec3 ivec4 uvec2 uvec3 uvec4 bvec2 bvec3 bvec4 uint mat2
mat3 mat4 mat2x2 mat2x3 mat2x4 mat3x2 mat3x3 mat3x4 mat4x2 mat4x3 mat4x4
"""
_VULKAN: Final = """
VULKAN sampler samplerShadow texture1D texture2D texture3D textureCube texture1DArray texture2DArray textureCubeArray
texture2DMS textureBuffer subpassInput
"""
_FUNCTIONS: Final = """
texture textureLod textureGrad textureGather texelFetch textureSize textureQueryLevels textureQueryLod
textureProj textureOffset imageLoad imageStore imageSize imageAtomicAdd barrier memoryBarrier
groupMemoryBarrier memoryBarrierShared memoryBarrierBuffer memoryBarrierImage memoryBarrierAtomicCounter
modf frexp ldexp mod matrixCompMult outerProduct exp2 log2 noise1 noise2 noise3 noise4 ftransform any all
not emitVertex EmitVertex EndPrimitive interpolateAtCentroid interpolateAtSample interpolateAtOffset
uaddCarry usubBorrow umulExtended imulExtended
"""
RESERVED: Final = frozenset(
    [
        *_KEYWORDS.split(),
        *_FUNCTIONS.split(),
        *BUILTINS,
        *(overload.glsl for row in BUILTINS.values() for overload in row.overloads),
        *(
            f"{prefix}{kind}{shape}{suffix}"
            for prefix in ("", "i", "u")
            for kind in ("sampler", "image")
            for shape in (
                "1D",
                "2D",
                "3D",
                "Cube",
                "2DRect",
                "1DArray",
                "2DArray",
                "CubeArray",
                "Buffer",
                "2DMS",
            )
            for suffix in ("", "Shadow", "Array")
        ),
    ]
)
VULKAN_RESERVED: Final = RESERVED | {
    f"{prefix}{word}" for prefix in ("", "i", "u") for word in _VULKAN.split()
}
"""Those of GLSL for Vulkan."""
