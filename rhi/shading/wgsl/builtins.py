"""How built-ins are spelled in WGSL."""

from __future__ import annotations

from typing import Final

from rhi.contract.layout import INT, UINT

SPELLINGS: Final = {
    "inversesqrt": "inverseSqrt",
    "faceforward": "faceForward",
    "uniform": "({0})",
    "unchecked": "({0})",
    "broadcast_first": "({0})",
    # The bits decide: compilers may assume that there are no NaNs.
    "isnan": "((bitcast<{bits}>({0}) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u))",
    "isinf": "((bitcast<{bits}>({0}) & {bits}(0x7FFFFFFFu)) == {bits}(0x7F800000u))",
    "less_than": "({0} < {1})",
    "less_than_equal": "({0} <= {1})",
    "greater_than": "({0} > {1})",
    "greater_than_equal": "({0} >= {1})",
    "equal": "({0} == {1})",
    "not_equal": "({0} != {1})",
    "invert": "(!{0})",
    **dict.fromkeys(
        ("float_bits_to_int", "float_bits_to_uint", "int_bits_to_float", "uint_bits_to_float"), "bitcast<{type}>({0})"
    ),
    "bit_count": "{type}(countOneBits({0}))",
    "find_lsb": "{type}(firstTrailingBit({0}))",
    "find_msb": "{type}(firstLeadingBit({0}))",
    "bitfield_reverse": "reverseBits",
    "bitfield_extract": "extractBits({0}, u32({1}), u32({2}))",
    "bitfield_insert": "insertBits({0}, {1}, u32({2}), u32({3}))",
    **{
        f"{way}_{ours}": f"{way}{theirs}"
        for way in ("pack", "unpack")
        for ours, theirs in (
            ("half_2x16", "2x16float"), ("unorm_2x16", "2x16unorm"), ("snorm_2x16", "2x16snorm"),
            ("unorm_4x8", "4x8unorm"), ("snorm_4x8", "4x8snorm"),
        )
    },
    "ddx": "dpdx",
    "ddy": "dpdy",
    "discard": "discard",
    "barrier": "rhi_barrier()",
    **{
        f"atomic_{name}": f"atomic{name.capitalize()}"
        for name in ("add", "min", "max", "and", "or", "xor", "exchange")
    },
}  # fmt: skip
"""Names of functions, and templates of calls: `{type}` is the result's type, `{bits}` the first argument's as uints.
Built-ins that aren't here have the same name."""

CONVERSIONS: Final = {
    # Conversions take place in range, and what they replace is chosen after them. The bits tell NaN.
    INT: "let y = clamp(x, {source}(-2147483648.0), {source}(2147483520.0));"
    " let r = select({type}(y), {type}(2147483647), x >= {source}(2147483648.0));"
    " return select(r, {type}(0), (bitcast<{bits}>(x) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u));",
    UINT: "let y = clamp(x, {source}(0.0), {source}(4294967040.0));"
    " let r = select({type}(y), {type}(4294967295u), x >= {source}(4294967296.0));"
    " return select(r, {type}(0), (bitcast<{bits}>(x) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u));",
}
"""Bodies of the functions that convert floats."""

BARRIER: Final = "fn rhi_barrier() { storageBarrier(); workgroupBarrier(); }"

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
    " return mat4x4<f32>(vec4<f32>(p.x, q.x, r.x, o.x), vec4<f32>(p.y, q.y, r.y, o.y), vec4<f32>(p.z, q.z, r.z, o.z),"
    " vec4<f32>(-dot(b, t), dot(a, t), -dot(d, s), dot(c, s)));",
}
"""Bodies of the inverses of matrices `m` by size; the inverse of a transpose is the transpose of the inverse."""

TEXTURE_CALLS: Final = {
    "sample": "textureSample({halves}, {at})",
    "sample_bias": "textureSampleBias({halves}, {at}, {2})",
    "sample_lod": "textureSampleLevel({halves}, {at}, {2})",
    "sample_grad": "textureSampleGrad({halves}, {at}, {2}, {3})",
    "sample_compare": "textureSampleCompare({halves}, {at}, {2})",
    "sample_compare_lod": "textureSampleCompareLevel({halves}, {at}, {2})",
    "gather_compare": "textureGatherCompare({halves}, {at}, {2})",
    "levels": "i32(textureNumLevels({texture}))",
}
"""Calls with a texture: `{halves}` are the texture and its sampler, `{at}` is the place, a layer included."""

OUTSIDE_FRAGMENTS: Final = {
    "sample": "textureSampleLevel({halves}, {at}, 0.0)",
    "sample_compare": "textureSampleCompareLevel({halves}, {at}, {2})",
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

EXTENSIONS: Final = ("draw_index", "primitive_index")
"""Inputs that must be enabled; devices need a feature of this name for them."""
