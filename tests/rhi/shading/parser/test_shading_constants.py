"""Python values in shaders: defaults, constants from NumPy, branches that a constant removes, and tips for
the names of other languages."""

import re

import numpy as np
import pytest

import rhi.shading
from rhi.errors import ShaderError
from rhi.shading import compile_shader, from_source, run_compute
from rhi.shading.language.textures import SampledTexture, methods_of
from rhi.shading.language.tips import FOREIGN, METHODS
from rhi.shading.language.types import LANGUAGE_NAMES

HEAD = """
from rhi.shading import *
class Test(Shader):
    out: StorageRW[float]
"""


def shader(*lines, before="", fields="", **scope):
    text = HEAD.replace("class", f"{before}\nclass", 1) + fields + "    def compute(self) -> None:\n"
    return from_source(text + "".join(f"        {line}\n" for line in lines), scope=scope)


def result_of(expression, **options):
    """The result of an expression, which is stored to a buffer."""
    return run_compute(shader(f"self.out[0] = {expression}", **options), out=1)["out"].tolist()[0]


def refusal_of(expression, **options):
    with pytest.raises(ShaderError) as error:
        compile_shader(shader(f"self.out[0] = {expression}", **options))
    return error.value


# -- defaults

DEFAULTS = """
K = 3.0
class Pair(Struct):
    left: float
    right: vec2
@function
def from_expression(x: float, a: float = K * 2) -> float:
    return x + a
@function
def from_name(x: float, *, a: float = K) -> float:
    return x + a
@function
def from_vector(x: float, a: vec3 = vec3(1, 2, K)) -> float:
    return x + a.z
@function
def from_struct(x: float, a: Pair = Pair(left=K, right=(1, 2))) -> float:
    return x + a.left + a.right.y
@function
def from_table(i: int, a: Array[float] = (K, 4.0)) -> float:
    return a[i]
K = 100.0
"""


@pytest.mark.parametrize(
    ("call", "expected"),
    [
        ("from_expression(1.0)", 7),
        ("from_expression(1.0, 2.0)", 3),
        ("from_name(1.0)", 4),
        ("from_vector(1.0)", 4),
        ("from_struct(1.0)", 6),
        ("from_table(0)", 3),
    ],
)
def test_a_default_has_the_value_that_it_had_when_the_function_was_defined(call, expected):
    assert result_of(call, before=DEFAULTS) == expected


def test_a_constant_in_a_body_has_the_value_that_it_has_when_the_shader_is_compiled():
    assert result_of("K", before=DEFAULTS) == 100


def test_a_default_of_a_method_is_that_of_its_class():
    method = "    def add(self, x: float, a: float = K + 1) -> float:\n        return x + a\n"
    assert result_of("self.add(1.0)", before="K = 1.0", fields=method) == 3


def test_a_default_that_is_no_constant_is_refused_where_the_call_needs_it():
    method = "    def add(self, x: float, a: float = []) -> float:\n        return x + a\n"
    assert result_of("self.add(1.0, 2.0)", fields=method) == 3
    assert refusal_of("self.add(1.0)", fields=method).rule.id == "shading-not-shading"


# -- NumPy

NUMPY = [
    (np.float32(0.5), "K", 0.5),
    (np.float64(0.5), "K", 0.5),
    (np.int32(-3), "float(K)", -3),
    (np.uint32(3), "float(uint(2) + K)", 5),
    (np.bool_(True), "1.0 if K else 2.0", 1),
    (np.array(2.5), "K", 2.5),
    (np.linspace(0, 1, 5), "K[3]", 0.75),
    (np.array([0.5]), "K[0]", 0.5),
    (np.arange(6), "float(K[4] // 3)", 1),
    (np.arange(6, dtype="u1"), "float(K[4] // uint(3))", 1),
    (np.array([True] * 3 + [False] * 3), "1.0 if K[4] else 2.0", 2),
    (np.arange(15.0).reshape(5, 3), "K[1].z", 5),
    (np.arange(6).reshape(3, 2), "float(K[2].x)", 4),
    (np.zeros((6, 4), "f4"), "float(len(K))", 6),
]


@pytest.mark.parametrize(("value", "expression", "expected"), NUMPY, ids=[f"{row[0]!r}" for row in NUMPY])
def test_a_numpy_value_is_a_constant_of_a_module_and_of_a_class(value, expression, expected):
    assert result_of(expression, K=value) == expected
    text = re.sub(r"\bK\b", "self.K", expression)
    assert result_of(text, fields="    K = OUTER\n", OUTER=value) == expected


REFUSED = [
    (np.zeros(3), "vec3(*K) for a vector or tuple(K.tolist()) for a constant array"),
    (np.zeros(2, "i4"), "ivec2(*K) for a vector"),
    (np.zeros(4, "?"), "bvec4(*K) for a vector"),
    (np.eye(3), "mat3(K) for a matrix or tuple(vec3(*row) for row in K)"),
    (np.zeros((5, 5)), "Storage"),
    (np.zeros((2, 2, 2)), "Storage"),
    (np.zeros(0), "Storage"),
    (np.zeros(3, [("x", "f4")]), "Storage"),
    (np.array(["a"]), "Storage"),
    (np.complex64(1), "vec2"),
    ([1.0, 2.0], "tuple(K)"),
]


@pytest.mark.parametrize(("value", "tip"), REFUSED, ids=[repr(row[0])[:40] for row in REFUSED])
def test_the_tip_for_an_unsuitable_numpy_value_names_the_shading_value_to_use(value, tip):
    error = refusal_of("K", K=value)
    assert error.rule.id == "shading-not-shading"
    assert tip in error.tip
    refusal = refusal_of("self.K", fields="    K = OUTER\n", OUTER=value)
    assert (refusal.rule.id, refusal.tip) == (error.rule.id, error.tip)


def test_the_tips_for_arrays_can_be_written():
    constants = {"K": np.array([1.0, 2.0, 3.0]), "M": np.diag([1.0, 2.0, 3.0])}
    before = "V = vec3(*K)\nA = tuple(K.tolist())\nN = mat3(M)\nR = tuple(vec3(*row) for row in M)"
    assert result_of("V.z + A[1] + N[2][2] + R[1].y", before=before, **constants) == 3 + 2 + 3 + 2


@pytest.mark.parametrize("value", [2**31, -(2**31) - 1])
def test_a_numpy_int_beyond_32_bits_is_refused(value):
    assert refusal_of("float(K[0])", K=np.full(6, value)).rule.id == "shading-out-of-range"
    assert result_of("float(K[0] // 65536)", K=np.full(6, value // 2)) == value // 2 // 65536


# -- branches that a constant removes


@pytest.mark.parametrize(
    "lines",
    [
        ("if self.n != 0:", "    self.out[0] = 1.0 / self.n", "else:", "    self.out[0] = 7.0"),
        ("if self.n == 0:", "    self.out[0] = 7.0", "else:", "    self.out[0] = 1.0 / self.n"),
        (
            "if self.n == 0:",
            "    self.out[0] = 7.0",
            "elif 1 // self.n > 2:",
            "    self.out[0] = 1.0 % self.n",
        ),
        ("self.out[0] = 1.0 / self.n if self.n != 0 else 7.0",),
        ("self.out[0] = 7.0 if self.n == 0 else 1.0 / self.n",),
        ("self.out[0] = 9.0 if self.n != 0 and 1 // self.n > 2 else 7.0",),
        ("self.out[0] = 7.0 if self.n == 0 or 1 // self.n > 2 else 9.0",),
        ("self.out[0] = 7.0", "if len(TABLE) > 3:", "    self.out[0] = TABLE[3]"),
    ],
)
def test_an_operation_that_python_would_not_evaluate_is_not_refused(lines):
    zero = shader(*lines, fields="    n = 0\n", TABLE=(1.0, 2.0))
    assert run_compute(zero, out=1)["out"].tolist() == [7]
    if "self.n" in "".join(lines):
        with pytest.raises(ShaderError, match="division by zero"):
            compile_shader(shader("self.out[0] = 1.0 / self.n", fields="    n = 0\n"))


def test_types_in_a_branch_that_is_removed_are_still_checked():
    with pytest.raises(ShaderError, match="vec2"):
        compile_shader(shader("if 1 == 2:", "    self.out[0] = vec2(1) + vec3(1)", "self.out[0] = 1.0"))


# -- tips

TIPS = {
    "lerp(1.0, 2.0, 0.5)": "use mix(a, b, t)",
    "frac(1.5)": "use fract(x)",
    "rsqrt(4.0)": "use inversesqrt(x)",
    "mad(1.0, 2.0, 3.0)": "fma(a, b, c)",
    "fmod(1.0, 2.0)": "x % y",
    "mul(mat4(1), vec4(1)).x": "a @ b",
    "tex2D(self.albedo, vec2(0)).x": "self.albedo.sample(uv)",
    "texture(self.albedo, vec2(0)).x": "self.albedo.sample(uv)",
    "float4(1.0).x": "use vec4",
    "int2(1).x": "use ivec2",
    "float3x3(1.0)[0].x": "use mat3",
    "float4x3(1.0)": "matrices are square",
    "dFdx(1.0)": "use ddx(x)",
    "packSnorm4x8(vec4(0))": "use pack_snorm_4x8(v)",
    "packUnorm2x16(vec2(0))": "use pack_unorm_2x16(v)",
    "atomicAnd(1, 2)": "use atomic_and(location, value)",
    "atomicOr(1, 2)": "use atomic_or(location, value)",
    "atomicXor(1, 2)": "use atomic_xor(location, value)",
    "gl_PointCoord.x": "use point_coordinate()",
    "textureQueryLevels(self.albedo)": "self.albedo.levels()",
    "np.arcsinh(1.0)": "use asinh(x)",
    "np.power(2.0, 3.0)": "write x ** y",
    "bitfieldInsert(1, 2, 3, 4)": "use bitfield_insert(base, x, offset, count)",
    "memoryBarrier()": "call memory_barrier()",
    "asuint(1.0)": "float_bits_to_uint",
    "threadIdx.x": "local_id()",
    "gl_GlobalInvocationID.x": "global_id()",
    "print(1.0)": "StorageRW",
    "sum(WEIGHTS)": "dot(v",
    "round(1.5)": "rhi.shading.round",
    "pow(2.0, 0.5)": "rhi.shading.pow",
    "divmod(1, 2)": "x // y",
    "np.sin(1.0)": "rhi.shading.sin",
    "np.arctan2(1.0, 2.0)": "use atan2(y, x)",
    "np.where(True, 1.0, 2.0)": "a if condition else b",
    "np.sum(WEIGHTS)": "dot(v",
    "np.linalg.norm(vec2(1))": "use length(v)",
    "np.float32(1.0)": "use float",
    "math.fmod(1.0, 2.0)": "x % y",
    "math.hypot(1.0, 2.0)": "length(vec2(x, y))",
    "sl.lerp(1.0, 2.0, 0.5)": "use mix(a, b, t)",
    "vec2(1).dot(vec2(2))": "write dot(…)",
    "vec2(1).length()": "write length(…)",
    "mat2(1).T[0].x": "use transpose(m)",
    "self.albedo.Sample(vec2(0)).x": "use sample(…)",
    "self.albedo.SampleLevel(vec2(0), 0.0).x": "use sample_lod(…)",
    "float(self.albedo.GetDimensions().x)": "use size(…)",
}


@pytest.mark.parametrize("expression", TIPS)
def test_a_name_of_another_language_gets_a_tip(expression):
    names = "import math\nimport numpy as np\nimport rhi.shading as sl\n"
    names += "from rhi.shading import StorageRW, Shader, Texture2D, mat2, mat4, vec2, vec4"
    text = HEAD.replace("from rhi.shading import *", names) + "    albedo: Texture2D\n"
    text += f"    def compute(self) -> None:\n        self.out[0] = {expression}\n"
    with pytest.raises(ShaderError) as error:
        compile_shader(from_source(text, scope={"WEIGHTS": (1.0, 2.0)}))
    assert TIPS[expression] in error.value.tip


def test_a_type_of_another_language_gets_a_tip_in_annotations():
    for text in (
        "    def add(self, x: float3) -> float:\n        return x.x\n",
        "    sky: Uniform[float3]\n",
    ):
        with pytest.raises(ShaderError, match="use vec3"):
            compile_shader(
                from_source(
                    HEAD + text + "    def compute(self) -> None:\n        self.out[0] = self.add(1)\n"
                )
            )
    with pytest.raises(ShaderError, match="use vec3"):
        from_source("from rhi.shading import *\nclass Light(Struct):\n    color: float3\n")


def test_a_name_close_to_a_variable_is_suggested_beside_the_tip():
    with pytest.raises(ShaderError) as error:
        compile_shader(shader("normal = 1.0", "self.out[0] = norm"))
    assert error.value.tip == "use length(v); did you mean 'normal'?"


def test_tips_name_only_names_that_exist():
    kinds = [value for value in vars(rhi.shading).values() if isinstance(value, type)]
    textures = [kind.shading_type for kind in kinds if issubclass(kind, SampledTexture)]
    methods = {name for texture in textures for name in methods_of(texture)} | {"store"}  # of images
    assert set(METHODS.values()) <= methods
    python = {
        "range",
        "len",
        "evaluate",
        "run_compute",
        "run_vertex",
        "run_fragment",
        "tuple",
        "return",
        "it",
    }
    for name, tip in FOREIGN.items():
        assert name not in LANGUAGE_NAMES, name
        for called in re.findall(r"(?<![\w.])(\w+)\(", tip):
            assert called in LANGUAGE_NAMES | python, f"{name}: {called}"
        for method in re.findall(r"self\.\w+\.(\w+)\(", tip):
            assert method in methods, f"{name}: {method}"


# -- conversions


@pytest.mark.parametrize(
    ("kind", "inside", "outside"),
    [
        (
            "int",
            [2147483647.9, -2147483648.9, -0.9],
            [2147483648.0, -2147483649.0, float("inf"), float("nan")],
        ),
        ("uint", [4294967295.9, -0.9], [4294967296.0, -1.0, float("-inf"), float("nan")]),
    ],
)
def test_a_constant_that_no_int_holds_is_refused_though_a_variable_would_give_the_nearest(
    kind, inside, outside
):
    for value in inside:
        compile_shader(shader(f"self.out[0] = float({kind}(VALUE))", VALUE=value))
    for value in outside:
        error = refusal_of(f"float({kind}(VALUE))", VALUE=value)
        assert error.rule.id == "shading-out-of-range"
        assert str(value) in error.given
        compile_shader(
            shader("x = 1.0", "if False:", f"    x = float({kind}(VALUE))", "self.out[0] = x", VALUE=value)
        )


RUN_BY_HOSTS = {
    *("HostTexture", "HostTextureTable", "NumpyKernel", "ShaderCode", "compile_shader", "evaluate"),
    *("ImageBinding", "StorageRange", "TableBinding", "TableTexture", "TextureBinding", "UniformRange"),
    *("find_element", "from_source", "opencl_kernel", "register_language", "run_compute", "run_fragment"),
    *("run_vertex", "stage_trees", "value_type_of"),
}


def test_all_that_shaders_may_import_is_suggested() -> None:
    assert set(rhi.shading.__all__) - RUN_BY_HOSTS == LANGUAGE_NAMES
