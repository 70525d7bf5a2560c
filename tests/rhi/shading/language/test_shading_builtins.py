"""Every row of the table of built-ins: each overload compiles on the driver, each function returns the right
value."""

import math
import struct

import numpy as np
import pytest

from rhi.contract.descriptors import Stage, TextureKind
from rhi.contract.formats import Format
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, MatrixType, ScalarType, VectorType
from rhi.shading import from_source
from rhi.shading.language import textures
from rhi.shading.language.builtins import BUILTINS, SideEffect
from rhi.shading.language.textures import methods_of
from rhi.shading.language.types import VOID, ImageType, TextureType

HEADER = "from rhi import Format\nfrom rhi.shading import *\n"


def load(source):
    return from_source(HEADER + source)


def argument(parameter):
    type = parameter.type
    if parameter.memory:
        return "self.ints[0]" if type is INT else "self.uints[0]"
    if isinstance(type, TextureType | ImageType):
        return "self.texture"
    if isinstance(type, ScalarType):
        return {"float": "x", "int": "n", "uint": "uint(n)", "bool": "b"}[type.name]
    if isinstance(type, MatrixType):
        return f"{type}(x)"
    assert isinstance(type, VectorType)
    part = {FLOAT: "x", INT: "n", UINT: "uint(n)", BOOL: "b"}[type.scalar]
    return f"{type}({', '.join([part] * type.size)})"


def calls(rows, on=""):
    lines = []
    for row in rows:
        for overload in row.overloads:
            if row.effect is SideEffect.DISCARD:
                continue
            arguments = [argument(parameter) for parameter in overload.parameters][1 if on else 0 :]
            if row.name == "gather" and len(arguments) == 2:
                arguments[1] = "3"
            call = f"{on}{row.name}({', '.join(arguments)})"
            lines.append(call if overload.result == VOID else f"r{len(lines)} = {call}")
    return "\n".join("        " + line for line in ["x = 0.5", "n = 1", "b = x < 1.0", *lines, "pass"])


BINDINGS = "    ints: StorageRW[int]\n    uints: StorageRW[uint]\n"
STAGES = {
    Stage.COMPUTE: "class Test(Shader):\n{bindings}    def compute(self) -> None:\n{calls}\n",
    Stage.VERTEX: "class Test(Shader):\n{bindings}    def vertex(self) -> vec4:\n{calls}\n        return vec4(0)\n",
    Stage.FRAGMENT: "class Test(Shader):\n{bindings}    def vertex(self) -> vec4:\n        return vec4(0)\n"
    "    def fragment(self) -> vec4:\n{calls}\n        return vec4(0)\n",
}


@pytest.mark.parametrize("stage", list(Stage))
def test_every_overload_of_every_builtin_compiles(link, stage):
    rows = [row for row in BUILTINS.values() if stage in row.stages]
    link(load(STAGES[stage].format(bindings=BINDINGS, calls=calls(rows))))


def sampled_types():
    for kind in TextureKind:
        for scalar in (FLOAT, INT, UINT):
            yield TextureType(kind, scalar)
            if kind is TextureKind.D2:
                yield TextureType(kind, scalar, samples=True)
        if kind is not TextureKind.D3:
            yield TextureType(kind, FLOAT, True)


@pytest.mark.parametrize("type", list(sampled_types()), ids=str)
def test_every_texture_method_compiles(link, type):
    for stage in (Stage.FRAGMENT, Stage.COMPUTE):
        rows = [row for row in methods_of(type).values() if stage in row.stages]
        source = STAGES[stage].format(bindings=f"    texture: {type}\n", calls=calls(rows, "self.texture."))
        link(load(source))


IMAGE_FORMATS = [f for f in Format if not f.is_depth and f is not Format.RGBA8_SRGB]


@pytest.mark.parametrize("format", IMAGE_FORMATS, ids=lambda f: f.name)
def test_every_image_format_compiles(link, format):
    for kind in (TextureKind.D2, TextureKind.D2_ARRAY, TextureKind.D3):
        type = ImageType(kind, format)
        binding = f"    texture: {type} = image(Format.{format.name})\n"
        rows = methods_of(type).values()
        source = STAGES[Stage.COMPUTE].format(bindings=binding, calls=calls(rows, "self.texture."))
        link(load(source))


def bits(value):
    return struct.unpack("<I", struct.pack("<f", value))[0]


# Arguments come from storage, so that the driver computes at run time: x = .5, y = -1.75, n = -37, u = 0xB4.
VALUES = {
    "radians": ("radians(x)", math.radians(0.5)),
    "degrees": ("degrees(x)", math.degrees(0.5)),
    "sin": ("sin(y)", math.sin(-1.75)),
    "cos": ("cos(y)", math.cos(-1.75)),
    "tan": ("tan(y)", math.tan(-1.75)),
    "asin": ("asin(x)", math.asin(0.5)),
    "acos": ("acos(x)", math.acos(0.5)),
    "atan": ("atan(y)", math.atan(-1.75)),
    "atan2": ("atan2(y, x)", math.atan2(-1.75, 0.5)),
    "sinh": ("sinh(y)", math.sinh(-1.75)),
    "cosh": ("cosh(y)", math.cosh(-1.75)),
    "tanh": ("tanh(y)", math.tanh(-1.75)),
    "asinh": ("asinh(y)", math.asinh(-1.75)),
    "acosh": ("acosh(-y)", math.acosh(1.75)),
    "atanh": ("atanh(x)", math.atanh(0.5)),
    "pow": ("pow(x, y)", 0.5**-1.75),
    "exp": ("exp(y)", math.exp(-1.75)),
    "log": ("log(x)", math.log(0.5)),
    "exp2": ("exp2(y)", 2**-1.75),
    "log2": ("log2(-y)", math.log2(1.75)),
    "sqrt": ("sqrt(x)", math.sqrt(0.5)),
    "inversesqrt": ("inversesqrt(x)", 1 / math.sqrt(0.5)),
    "abs": ("abs(y) + float(abs(n))", 38.75),
    "sign": ("sign(y) + float(sign(-n)) * 10.0", 9),
    "floor": ("floor(y)", -2),
    "ceil": ("ceil(y)", -1),
    "trunc": ("trunc(y)", -1),
    "round": ("round(x) + round(x * 3.0) * 10.0 + round(x * 5.0) * 100.0", 0 + 20 + 200),
    "fract": ("fract(y)", 0.25),
    "min": ("min(x, y)", -1.75),
    "max": ("max(x, y)", 0.5),
    "clamp": ("clamp(y, -1.0, x) + float(clamp(n, -40, 5))", -38),
    "saturate": ("saturate(y) + saturate(x) * 10.0 + saturate(x * 9.0) * 100.0", 105),
    "mix": (
        "mix(x, y, 0.25) + mix(vec2(x), vec2(y), bvec2(True, False)).x * 100.0",
        0.5 * 0.75 - 1.75 * 0.25 - 175,
    ),
    "step": ("step(y, x) + step(x, y) * 10.0", 1),
    "smoothstep": ("smoothstep(0.0, 2.0, x)", 0.25**2 * (3 - 2 * 0.25)),
    "fma": ("fma(x, y, x)", 0.5 * -1.75 + 0.5),
    "isnan": ("1.0 if isnan(sqrt(y)) and not isnan(x) else 0.0", 1),
    "isinf": ("1.0 if isinf(x / (x - 0.5)) and not isinf(x) else 0.0", 1),
    "length": ("length(vec2(x * 6.0, 4.0))", 5),
    "distance": ("distance(vec2(x * 6.0, 4.0), vec2(6.0, 8.0))", 5),
    "dot": ("dot(vec3(x, y, 1.0), vec3(2.0, 4.0, 3.0))", 1 - 7 + 3),
    "cross": ("cross(vec3(x, y, 1.0), vec3(2.0, 4.0, 3.0)).z", 0.5 * 4 + 1.75 * 2),
    "normalize": ("normalize(vec2(x * 6.0, 4.0)).y", 0.8),
    "faceforward": ("faceforward(vec2(x, 0.0), vec2(1.0, 0.0), vec2(1.0, 0.0)).x", -0.5),
    "reflect": ("reflect(vec2(x, y), vec2(0.0, 1.0)).y", 1.75),
    "refract": ("refract(vec2(0.6, -0.8), vec2(0.0, 1.0), x).x", 0.3),
    "transpose": ("transpose(mat2(x, y, 3.0, 4.0))[0][1]", 3),
    "determinant": ("determinant(mat2(x, y, 3.0, 4.0))", 2 + 5.25),
    "inverse": ("inverse(mat2(x, y, 3.0, 4.0))[0][1]", 1.75 / 7.25),
    "less_than": ("1.0 if less_than(vec2(x, y), vec2(y, x)) == bvec2(False, True) else 0.0", 1),
    "less_than_equal": (
        "1.0 if less_than_equal(vec2(x, y), vec2(x, -9.0)) == bvec2(True, False) else 0.0",
        1,
    ),
    "greater_than": ("1.0 if greater_than(vec2(x, y), vec2(y, x)) == bvec2(True, False) else 0.0", 1),
    "greater_than_equal": (
        "1.0 if greater_than_equal(vec2(x, y), vec2(x, 9.0)) == bvec2(True, False) else 0.0",
        1,
    ),
    "equal": ("1.0 if equal(vec2(x, y), vec2(x, x)) == bvec2(True, False) else 0.0", 1),
    "not_equal": ("1.0 if not_equal(vec2(x, y), vec2(x, x)) == bvec2(False, True) else 0.0", 1),
    "any": ("1.0 if any(equal(vec2(x, y), vec2(x, x))) else 0.0", 1),
    "all": ("1.0 if all(equal(vec2(x, y), vec2(x, x))) else 0.0", 0),
    "invert": ("1.0 if all(invert(equal(vec2(x, y), vec2(y, x)))) else 0.0", 1),
    "float_bits_to_int": ("float(float_bits_to_int(x) >> 20)", bits(0.5) >> 20),
    "float_bits_to_uint": ("float(float_bits_to_uint(y) >> 20)", bits(-1.75) >> 20),
    "int_bits_to_float": ("int_bits_to_float(n + 37 + 0x3F000000)", 0.5),
    "uint_bits_to_float": ("uint_bits_to_float(u - 0xB4 + 0x3F000000)", 0.5),
    "bit_count": ("float(bit_count(u))", 4),
    "find_lsb": ("float(find_lsb(u))", 2),
    "find_msb": ("float(find_msb(u))", 7),
    "bitfield_reverse": ("float(bitfield_reverse(u) >> 24)", 0x2D),
    "bitfield_extract": ("float(bitfield_extract(u, 2, 4))", 0xB4 >> 2 & 15),
    "bitfield_insert": ("float(bitfield_insert(u, uint(1), 4, 4))", 0x14),
    "pack_half_2x16": ("float(pack_half_2x16(vec2(0.0, x)) >> 16)", 0x3800),
    "unpack_half_2x16": ("unpack_half_2x16(u * 0 + 0x38000000).y", 0.5),
    "pack_unorm_2x16": ("float(pack_unorm_2x16(vec2(x * 2.0, y)))", 0xFFFF),
    "unpack_unorm_2x16": ("unpack_unorm_2x16(u).x", 0xB4 / 0xFFFF),
    "pack_snorm_2x16": ("float(pack_snorm_2x16(vec2(x * 2.0, 0.0)))", 0x7FFF),
    "unpack_snorm_2x16": ("unpack_snorm_2x16(u).x", 0xB4 / 0x7FFF),
    "pack_unorm_4x8": ("float(pack_unorm_4x8(vec4(x * 2.0, y, 0.0, 0.0)))", 0xFF),
    "unpack_unorm_4x8": ("unpack_unorm_4x8(u).x", 0xB4 / 0xFF),
    "pack_snorm_4x8": ("float(pack_snorm_4x8(vec4(x * 2.0, 0.0, 0.0, 0.0)))", 0x7F),
    "unpack_snorm_4x8": ("unpack_snorm_4x8(u).x", (0xB4 - 256) / 0x7F),
    "local_index": ("float(local_index())", 0),
    "group_count": ("float(group_count().y)", 1),
}
ELSEWHERE = {
    # tests of their own in test_shading_values.py and test_shading_table.py
    "uniform",
    "broadcast_first",
    "atomic_add",
    "atomic_min",
    "atomic_max",
    "atomic_and",
    "atomic_or",
    "atomic_xor",
    "atomic_exchange",
    "atomic_compare_exchange",
    "barrier",
    "memory_barrier",
    "global_id",
    "local_id",
    "group_id",
    # what they give depends on a draw: the conformance kit
    "ddx",
    "ddy",
    "fwidth",
    "discard",
    "vertex_index",
    "instance_index",
    "draw_index",
    "fragment_coordinate",
    "point_coordinate",
    "front_facing",
    "primitive_index",
    # what it promises: the kit's test_outside.py, test_shading_index_ranges.py
    "unchecked",
}


def test_every_builtin_has_its_value(run_everywhere):
    lines = "\n".join(f"        self.out[{i}] = {text}" for i, (text, _) in enumerate(VALUES.values()))
    source = (
        "class Test(Shader):\n"
        "    a: Storage[float]\n    ints: Storage[int]\n    uints: Storage[uint]\n    out: StorageRW[float]\n"
        "    def compute(self) -> None:\n"
        "        x = self.a[0]\n        y = self.a[1]\n        n = self.ints[0]\n        u = self.uints[0]\n"
        + lines
    )
    inputs = {
        "a": np.array([0.5, -1.75], "f4"),
        "ints": np.array([-37], "i4"),
        "uints": np.array([0xB4], "u4"),
    }
    out = run_everywhere(load(source), **inputs, out=len(VALUES))["out"]
    wrong = {
        text: (float(got), expected)
        for (text, expected), got in zip(VALUES.values(), out, strict=True)
        if not math.isclose(got, expected, rel_tol=5e-4, abs_tol=1e-6)  # Mesa's asin is 4e-4 off
    }
    assert not wrong


def test_every_builtin_is_tested():
    assert set(VALUES) | ELSEWHERE == set(BUILTINS)
    assert not set(VALUES) & ELSEWHERE


def test_every_texture_class_is_exported():
    names = {str(type) for type in sampled_types()}
    for kind in (TextureKind.D2, TextureKind.D2_ARRAY, TextureKind.D3):
        names |= {str(ImageType(kind, format)) for format in (Format.R8, Format.R32I, Format.R32UI)}
    assert names | {"image"} == set(textures.__all__)
