"""WGSL for built-ins that need more than a spelling in the table `rhi.shading.language.builtins`."""

from __future__ import annotations

from typing import Final

from rhi.contract.layout import INT, UINT

CONVERSIONS: Final = {
    # Numbers are clamped to the range before the conversion, and the limits selected after it. NaN is found
    # by its bits.
    INT: "let y = clamp(x, {source}(-2147483648.0), {source}(2147483520.0));"
    " let r = select({type}(y), {type}(2147483647), x >= {source}(2147483648.0));"
    " return select(r, {type}(0), (bitcast<{bits}>(x) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u));",
    UINT: "let y = clamp(x, {source}(0.0), {source}(4294967040.0));"
    " let r = select({type}(y), {type}(4294967295u), x >= {source}(4294967296.0));"
    " return select(r, {type}(0), (bitcast<{bits}>(x) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u));",
}
"""Bodies of the functions that convert floats."""

BARRIER: Final = "fn rhi_barrier() { storageBarrier(); workgroupBarrier(); }"

PACK_SNORM_4X8: Final = (
    "fn rhi_pack_snorm_4x8(v: vec4<f32>) -> u32 { "
    "let b = vec4<u32>(vec4<i32>(round(clamp(v, vec4<f32>(-1.0), vec4<f32>(1.0)) * 127.0))) & vec4<u32>(255u); "
    "return b.x | (b.y << 8u) | (b.z << 16u) | (b.w << 24u); }"
)
"""Mesa folds WGSL's own function of a constant without cutting negative components to 8 bits."""

INVERSES: Final = {
    2: "return mat2x2<f32>(m[1][1], -m[0][1], -m[1][0], m[0][0]) * (1.0 / determinant(m));",
    3: "let a = cross(m[1], m[2]); let b = cross(m[2], m[0]); let c = cross(m[0], m[1]);"
    " return transpose(mat3x3<f32>(a, b, c)) * (1.0 / dot(m[0], a));",
    # E. Lengyel, Foundations of Game Engine Development 1, section 1.7.5
    4: "let a = m[0].xyz; let b = m[1].xyz; let c = m[2].xyz; let d = m[3].xyz;"
    " let x = m[0].w; let y = m[1].w; let z = m[2].w; let w = m[3].w;"
    " var s = cross(a, b); var t = cross(c, d); var u = a * y - b * x; var v = c * w - d * z;"
    " let i = 1.0 / (dot(s, v) + dot(t, u)); s *= i; t *= i; u *= i; v *= i;"
    " let p = cross(b, v) + t * y; let q = cross(v, a) - t * x; let r = cross(d, u) + s * w;"
    " let o = cross(u, c) - s * z;"
    " return mat4x4<f32>(vec4<f32>(p.x, q.x, r.x, o.x), vec4<f32>(p.y, q.y, r.y, o.y), vec4<f32>(p.z, q.z, "
    "r.z, o.z),"
    " vec4<f32>(-dot(b, t), dot(a, t), -dot(d, s), dot(c, s)));",
}
"""Bodies of the inverses of matrices `m` by size; the inverse of a transpose is the transpose of the
inverse."""

TEXTURE_CALLS: Final = {
    "sample": "textureSample({texture_and_sampler}, {at})",
    "sample_bias": "textureSampleBias({texture_and_sampler}, {at}, min({2}, 1000.0))",
    "sample_lod": "textureSampleLevel({texture_and_sampler}, {at}, min({2}, 1000.0))",
    "sample_grad": "textureSampleGrad({texture_and_sampler}, {at}, {2}, {3})",
    "sample_compare": "textureSampleCompare({texture_and_sampler}, {at}, {2})",
    "sample_compare_lod": "textureSampleCompareLevel({texture_and_sampler}, {at}, {2})",
    "gather_compare": "textureGatherCompare({texture_and_sampler}, {at}, {2})",
    "levels": "i32(textureNumLevels({texture}))",
}
"""Calls with a texture: `{texture_and_sampler}` stands for both names, `{at}` for the coordinates, a layer
included. Levels of detail are bounded, since llvmpipe takes the first level for numbers beyond 2³¹."""

DERIVING_CALLS: Final = ("sample", "sample_bias", "sample_compare")
"""The calls whose level of detail depends on differences between neighbouring fragments."""

OUTSIDE_FRAGMENTS: Final = {
    "sample": "textureSampleLevel({texture_and_sampler}, {at}, 0.0)",
    "sample_compare": "textureSampleCompareLevel({texture_and_sampler}, {at}, {2})",
}
"""Calls in stages without derivatives, which read level 0."""

INPUTS: Final = {
    "vertex_index": ("i32", "u32", "vertex_index", "i32({0})"),
    "instance_index": ("i32", "u32", "instance_index", "i32({0})"),
    "draw_index": ("i32", "u32", "draw_index", "i32({0})"),
    "fragment_coordinate": ("vec4<f32>", "vec4<f32>", "position", "{0}"),
    "front_facing": ("bool", "bool", "front_facing", "{0}"),
    "primitive_index": ("i32", "u32", "primitive_index", "i32({0})"),
    "global_id": ("vec3<i32>", "vec3<u32>", "global_invocation_id", "vec3<i32>({0})"),
    "local_id": ("vec3<i32>", "vec3<u32>", "local_invocation_id", "vec3<i32>({0})"),
    "local_index": ("i32", "u32", "local_invocation_index", "i32({0})"),
    "group_id": ("vec3<i32>", "vec3<u32>", "workgroup_id", "vec3<i32>({0})"),
    "group_count": ("vec3<i32>", "vec3<u32>", "num_workgroups", "vec3<i32>({0})"),
}
"""Inputs of stages: the type of the built-in, WGSL's type and name of it, and the conversion."""

GROUP_INPUTS: Final = ("group_id", "group_count")
"""Inputs that a work-group shares. Functions take them as parameters: WGSL takes what a private variable holds to
differ within a work-group."""

AGREEMENT: Final = """\
var<workgroup> rhi_agreed: i32;
fn rhi_agree_i32(x: i32) -> i32 {
    if (rhi_local_index == 0) { rhi_agreed = x; }
    return workgroupUniformLoad(&rhi_agreed);
}
fn rhi_agree_bool(x: bool) -> bool { return rhi_agree_i32(select(0, 1, x)) != 0; }"""
"""Functions that return what the first invocation of a work-group passes: it is the same for all, but WGSL doesn't
know that."""

EXTENSIONS: Final = ("draw_index", "primitive_index")
"""Inputs that must be enabled; devices need a feature of this name for them."""
