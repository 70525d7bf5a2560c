"""Tips for names of other languages: the name or expression that the shading language has instead.

`FOREIGN` is the table, from HLSL, GLSL, CUDA, Metal, NumPy and Python. The names that GLSL and NumPy have for
a built-in follow from its row in `BUILTINS`; the others are listed here. A test resolves each `name(` in a
tip, so that all exist.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from rhi.contract.layout import MatrixType, VectorType
from rhi.shading.language.builtins import BUILTINS, SideEffect
from rhi.shading.language.types import VOID

_SAMPLING: Final = "a texture is a field of the shader, and its methods read it: "

FOREIGN: Final[dict[str, str]] = {
    # HLSL, and GLSL's other names
    "lerp": "use mix(a, b, t)",
    "frac": "use fract(x)",
    "rsqrt": "use inversesqrt(x)",
    "rcp": "write 1.0 / x",
    "mad": "use fma(a, b, c), or write a * b + c",
    "mul": "write a @ b",
    "fmod": "x % y has the sign of y, as in Python; for the sign of x: x - y * trunc(x / y)",
    "mod": "write x % y",
    "log10": "write log(x) * 0.4342944819",
    "exp10": "write exp2(x * 3.3219280949)",
    "sincos": "call sin(x) and cos(x)",
    "clip": "use clamp(x, low, high); HLSL's clip: `if x < 0: discard()`",
    "countbits": "use bit_count(x)",
    "popcount": "use bit_count(x)",
    "popc": "use bit_count(x)",
    "firstbithigh": "use find_msb(x)",
    "firstbitlow": "use find_lsb(x)",
    "reversebits": "use bitfield_reverse(x)",
    "asfloat": "use int_bits_to_float(x) or uint_bits_to_float(x)",
    "asint": "use float_bits_to_int(x)",
    "asuint": "use float_bits_to_uint(x)",
    "as_type": "use float_bits_to_int(x) and its kin",
    "f32tof16": "use pack_half_2x16(v)",
    "f16tof32": "use unpack_half_2x16(x)",
    "dfdx": "use ddx(x)",
    "dfdy": "use ddy(x)",
    "ddx_coarse": "use ddx(x)",
    "ddx_fine": "use ddx(x)",
    "ddy_coarse": "use ddy(x)",
    "ddy_fine": "use ddy(x)",
    "matrixCompMult": "write a * b",
    "outerProduct": "write the rows: mat3(a.x * b, a.y * b, a.z * b)",
    "discard_fragment": "call discard()",
    "discardFragment": "call discard()",
    "select": "write a if condition else b",
    "where": "write a if condition else b; for each component: mix(b, a, condition)",
    # textures
    "texture": _SAMPLING + "self.albedo.sample(uv)",
    "texture2D": _SAMPLING + "self.albedo.sample(uv)",
    "tex2D": _SAMPLING + "self.albedo.sample(uv)",
    "tex3D": _SAMPLING + "self.volume.sample(at)",
    "texCUBE": _SAMPLING + "self.sky.sample(direction)",
    "tex2Dlod": _SAMPLING + "self.albedo.sample_lod(uv, level)",
    "tex2Dbias": _SAMPLING + "self.albedo.sample_bias(uv, bias)",
    "tex2Dgrad": _SAMPLING + "self.albedo.sample_grad(uv, ddx(uv), ddy(uv))",
    "textureLod": _SAMPLING + "self.albedo.sample_lod(uv, level)",
    "textureGrad": _SAMPLING + "self.albedo.sample_grad(uv, ddx(uv), ddy(uv))",
    "textureGather": _SAMPLING + "self.albedo.gather(uv)",
    "texelFetch": _SAMPLING + "self.albedo.load(texel)",
    "textureQueryLevels": _SAMPLING + "self.albedo.levels()",
    "textureSize": _SAMPLING + "self.albedo.size()",
    "imageLoad": "an image is a field of the shader, and its methods access it: self.target.load(texel)",
    "imageStore": "an image is a field of the shader, and its methods access it: "
    "self.target.store(texel, value)",
    "imageSize": "an image is a field of the shader, and its methods access it: self.target.size()",
    "sampler2D": "annotate the field with Texture2D; the sampler is bound with the texture",
    "samplerCube": "annotate the field with TextureCube; the sampler is bound with the texture",
    "sampler3D": "annotate the field with Texture3D; the sampler is bound with the texture",
    "SamplerState": "a texture is bound with its sampler: a field of type Texture2D is both",
    "RWTexture2D": "annotate the field with Image2D and give it a format: `= image(Format.RGBA8)`",
    "StructuredBuffer": "annotate the field with Storage[…]",
    "RWStructuredBuffer": "annotate the field with StorageRW[…]",
    "cbuffer": "annotate the field with Uniform[…]",
    # compute: HLSL, GLSL, CUDA
    "GroupMemoryBarrierWithGroupSync": "call barrier()",
    "syncthreads": "call barrier()",
    "__syncthreads": "call barrier()",
    "threadgroup_barrier": "call barrier()",
    "__threadfence": "call memory_barrier()",
    "atomicCAS": "use atomic_compare_exchange(location, expected, value)",
    "InterlockedAdd": "use atomic_add(location, value)",
    "InterlockedMin": "use atomic_min(location, value)",
    "InterlockedMax": "use atomic_max(location, value)",
    "threadIdx": "use local_id()",
    "blockIdx": "use group_id()",
    "blockDim": "it is the `work_group` of the class",
    "gridDim": "use group_count()",
    "groupshared": "declare it on the class: name = shared(float, 64)",
    "gl_VertexIndex": "use vertex_index()",
    "gl_InstanceID": "use instance_index()",
    "gl_InstanceIndex": "use instance_index()",
    "gl_DrawID": "use draw_index()",
    "gl_Position": "return it: a vec4, or the first field of the struct that `vertex` returns",
    "gl_FragDepth": "return a struct with a field of type FragmentDepth",
    "gl_FragColor": "return it from `fragment`",
    # NumPy and math
    "power": "write x ** y, or pow(x, y)",
    "square": "write x * x",
    "cbrt": "write sign(x) * pow(abs(x), 1.0 / 3.0)",
    "reciprocal": "write 1.0 / x",
    "absolute": "use abs(x)",
    "fabs": "use abs(x)",
    "fmin": "use min(a, b)",
    "fmax": "use max(a, b)",
    "fix": "use trunc(x)",
    "remainder": "write x % y",
    "deg2rad": "use radians(x)",
    "rad2deg": "use degrees(x)",
    "hypot": "write length(vec2(x, y))",
    "norm": "use length(v)",
    "dist": "use distance(a, b)",
    "matmul": "write a @ b",
    "inner": "use dot(a, b)",
    "vdot": "use dot(a, b)",
    "inv": "use inverse(m)",
    "det": "use determinant(m)",
    "interp": "use mix(a, b, t)",
    "copysign": "write abs(x) * sign(y)",
    "expm1": "write exp(x) - 1.0",
    "log1p": "write log(1.0 + x)",
    "isfinite": "write not (isnan(x) or isinf(x))",
    "sum": "add the components, such as v.x + v.y or dot(v, vec2(1.0)); for arrays, write a loop",
    "prod": "multiply the components; for arrays, write a loop",
    "mean": "use dot(v, vec3(1.0 / 3.0)); for arrays, write a loop",
    "zeros": "use array(float, 4)",
    "ones": "use array(float, 4) and fill it in a loop; for vectors: vec3(1.0)",
    "eye": "use mat4(1.0)",
    "identity": "use mat4(1.0)",
    # Python
    "print": "devices can't print: store the value in a StorageRW and read that, "
    "or call the shader on the CPU with "
    "run_compute(…), run_vertex(…) or run_fragment(…)",
    "divmod": "write x // y and x % y",
    "enumerate": "write for i in range(len(values)): value = values[i]",
    "zip": "write for i in range(len(values)): value = values[i]",
    "reversed": "write for i in range(len(values) - 1, -1, -1)",
    "sorted": "sort on the CPU, or write the loops",
    "list": "use array(float, 4)",
    "isinstance": "types are known when the shader is compiled",
    # types
    "double": "use float; on the CPU, evaluate(…, dtype=numpy.float64) computes in double precision",
    "float64": "use float; on the CPU, evaluate(…, dtype=numpy.float64) computes in double precision",
    "half": "use float",
    "float16": "use float",
    "float32": "use float",
    "int32": "use int",
    "int64": "use int, which has 32 bits",
    "uint32": "use uint",
    "uint64": "use uint, which has 32 bits",
    "bool_": "use bool",
    "ndarray": "use Array[float] with array(float, 4), vec3 or mat4",
    "void": "use None",
    "inout": "arguments are passed by value: return the new value",
}


def _derive_tips() -> Iterator[tuple[str, str]]:
    """Yield the names that built-ins have in GLSL and in NumPy, each with a tip."""
    for row in BUILTINS.values():
        overload = row.overloads[0]
        listed = re.search(r"\b(?:for|of) \((\w[\w, ]*)\)", row.doc)
        if row.effect is SideEffect.WRITE and not listed:
            arguments = "location, value"
        elif listed:
            arguments = listed[1]
        elif len(overload.parameters) == 1:
            is_vector = isinstance(overload.parameters[0].type, VectorType)
            arguments = (
                "v" if is_vector else "m" if isinstance(overload.parameters[0].type, MatrixType) else "x"
            )
        else:
            arguments = ", ".join("abcd"[: len(overload.parameters)])
        tip = f"{'call' if overload.result is VOID else 'use'} {row.name}({arguments})"
        for pattern, spelling in ((_GLSL_NAME, overload.glsl), (_NUMPY_NAME, row.numpy)):
            match = pattern.fullmatch(spelling)
            if match and match[1] not in BUILTINS:
                yield match[1], tip


_GLSL_NAME: Final = re.compile(r"(?:\w+\()?(?=\w*[A-Z])(\w+)\)?(?:\(\))?")
"""A name that isn't lower-case throughout, perhaps converted or called: `findLSB`,
`ivec3(gl_WorkGroupID)`."""
_NUMPY_NAME: Final = re.compile(r"np\.(\w+)\(.*\)")
FOREIGN.update({**dict(_derive_tips()), **FOREIGN})
for _size in (2, 3, 4):
    for _name in ("float", "half", "double", "dvec", "make_float"):
        FOREIGN[f"{_name}{_size}"] = f"use vec{_size}"
    for _name in ("int", "uint", "bool"):
        FOREIGN[f"{_name}{_size}"] = f"use {_name[0]}vec{_size}"
    for _name in ("float", "half", "mat"):
        for _rows in (2, 3, 4):
            _square = "matrices are square: use mat2, mat3 or mat4, or vectors"
            FOREIGN[f"{_name}{_rows}x{_size}"] = f"use mat{_size}" if _rows == _size else _square

METHODS: Final[dict[str, str]] = {
    "Sample": "sample",
    "SampleLevel": "sample_lod",
    "SampleBias": "sample_bias",
    "SampleGrad": "sample_grad",
    "SampleCmp": "sample_compare",
    "SampleCmpLevelZero": "sample_compare_lod",
    "Gather": "gather",
    "GatherRed": "gather",
    "GatherCmp": "gather_compare",
    "Load": "load",
    "read": "load",
    "fetch": "load",
    "Store": "store",
    "write": "store",
    "GetDimensions": "size",
    "shape": "size",
}
"""Methods of textures and images by their names in other languages."""
