"""The built-in functions: one table with one row per function.

- A row holds a name, its signatures, and its spelling in each language. The type checks of the parser, the stubs, the
  code writers and the documentation all read this table. To support another language, add a spelling to the rows.
  Methods of textures and images have one in GLSL only: the other languages write the accesses to which
  `rhi.shading.lowering.textures` lowers them.
- In a signature, letters stand for types of one common size: F is float or vec, I, U and B are int, uint and bool or
  their vectors, V, IV, UV and BV are vectors only, M is mat. `F(F,F,float)` is four overloads. `int&` is a memory
  location that the function modifies.
- A spelling is a function's name, which is called with all arguments, or a template with `{0}` for the first argument.
  OpenCL's and NumPy's are for one component. `fast` is OpenCL's spelling with `Precision.FAST`.
- Instead of spellings for OpenCL and NumPy, `lanes` composes a built-in from others: an expression in the arguments
  a, b, c and d (`rhi.shading.lowering.expansions`). A built-in that no expression describes is a function of that
  module, with the built-in's name.
- `error` bounds the error of the results. `python -m rhi shading accuracy` measures it, and tests check the bounds.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NoReturn

from rhi.contract.descriptors import Stage
from rhi.contract.formats import Choice
from rhi.contract.layout import BOOL, FLOAT, INT, UINT
from rhi.errors import refuse
from rhi.shading.language import rules
from rhi.shading.language.types import LANGUAGE_NAMES, MATRICES, VECTORS, VOID, Type, converts

LANGUAGE_NAMES.add("Precision")


class Precision(Choice):
    """Accuracy of pow, exp, log, sin, cos, roots and divisions on OpenCL: EXACT is within a few ulp, FAST less exact.

    With FAST, OpenCL may flush numbers below 2^-126 to 0. `python -m rhi shading accuracy` measures the errors of both.
    """

    EXACT = "exact"
    FAST = "fast"


class SideEffect(enum.Enum):
    """The side effect of a built-in."""

    NONE = "none"
    WRITE = "write"
    BARRIER = "barrier"
    DISCARD = "discard"


@dataclass(frozen=True, slots=True)
class ErrorBound:
    """The largest error of a result, in the units that `rhi.testing.accuracy.probes` counts. By default they are exact.

    Attributes:
        glsl, exact, fast, numpy: bounds in units: on OpenGL (with Mesa's llvmpipe; OpenGL itself guarantees less), on
            OpenCL with either precision (EXACT's bound is OpenCL's own guarantee, FAST's is measured), and on NumPy in
            float32.
        glsl_absolute: an absolute error that is allowed on OpenGL whatever the units.
        domain: the range of each float argument in which the bounds of OpenGL and FAST hold; the last range also
            holds for the arguments after it. The bounds of EXACT and NumPy hold for every number, unless the units
            are `of_arguments`.
        of_arguments: the built-in is composed of others, and one unit is the change of the result when an argument
            changes by one unit.
        defined: where the result is defined, as a NumPy expression in the arguments a, b, c and d; everywhere if empty.
    """

    glsl: float = 0
    exact: float = 0
    fast: float = 0
    numpy: float = 0
    glsl_absolute: float = 0
    domain: tuple[tuple[float, float], ...] = ((-1e6, 1e6),)
    of_arguments: bool = False
    defined: str = ""


@dataclass(frozen=True, slots=True)
class BuiltinParameter:
    """A parameter of an overload. `memory`: a location in storage or shared memory, modified in place."""

    type: Type
    name: str = ""
    memory: bool = False


@dataclass(frozen=True, slots=True)
class Overload:
    """A signature with concrete types, and its GLSL spelling."""

    parameters: tuple[BuiltinParameter, ...]
    result: Type
    glsl: str


@dataclass(frozen=True, slots=True, eq=False)
class Builtin:
    """A row of the table: a built-in function, or a method of a texture. The module's head describes the columns."""

    name: str
    overloads: tuple[Overload, ...]
    doc: str
    effect: SideEffect = SideEffect.NONE
    stages: frozenset[Stage] = frozenset(Stage)
    extension: str = ""
    opencl: str = ""
    numpy: str = ""
    fast: str = ""
    lanes: str = ""
    error: ErrorBound = ErrorBound()
    form: str = ""
    _chosen: dict[tuple[Any, ...], Overload | None] = field(default_factory=dict, repr=False)

    def choose(self, types: Sequence[Type], literals: Sequence[bool]) -> Overload | None:
        """Return the overload for arguments of these types: an exact match, else the first that they convert to."""
        key = (*types, *literals)
        if key not in self._chosen:
            self._chosen[key] = self._choose(types, literals)
        return self._chosen[key]

    def _choose(self, types: Sequence[Type], literals: Sequence[bool]) -> Overload | None:
        fitting = [o for o in self.overloads if len(o.parameters) == len(types)]
        for overload in fitting:
            if all(p.type == t for p, t in zip(overload.parameters, types, strict=True)):
                return overload
        for overload in fitting:
            if all(
                p.type == t or (not p.memory and converts(t, p.type, literal))
                for p, t, literal in zip(overload.parameters, types, literals, strict=True)
            ):
                return overload
        return None

    def signatures(self) -> str:
        """Return all overloads as text, one per line."""
        return "\n".join(
            f"{self.name}({', '.join(str(p.type) for p in o.parameters)}) -> {o.result}" for o in self.overloads
        )

    def __call__(self, *arguments: object, **named: object) -> NoReturn:
        refuse(rules.DEVICE_ONLY, f"rhi.shading.{self.name}(…)")


def _sizes(scalar: Any, smallest: int) -> dict[int, Type]:
    all_sizes: dict[int, Type] = {1: scalar} | {size: VECTORS[scalar, size] for size in (2, 3, 4)}
    return {size: type for size, type in all_sizes.items() if size >= smallest}


_LETTERS: Final[dict[str, dict[int, Type]]] = {
    "F": _sizes(FLOAT, 1),
    "I": _sizes(INT, 1),
    "U": _sizes(UINT, 1),
    "B": _sizes(BOOL, 1),
    "V": _sizes(FLOAT, 2),
    "IV": _sizes(INT, 2),
    "UV": _sizes(UINT, 2),
    "BV": _sizes(BOOL, 2),
    "M": {**MATRICES},
}
_SIZED: Final[dict[int, dict[str, Type]]] = {
    size: {name: letter[size] for name, letter in _LETTERS.items() if size in letter} for size in (0, 1, 2, 3, 4)
}
_NAMED: Final[dict[str, Type]] = {
    "None": VOID,
    **{str(type): type for type in (BOOL, INT, UINT, FLOAT)},
    **{str(type): type for type in VECTORS.values()},
    **{str(type): type for type in MATRICES.values()},
}


def expand(signatures: str, glsl: str, names: dict[str, Type] | None = None) -> Iterator[Overload]:
    """Yield the overloads of signatures that are separated by semicolons. `names` adds type names to the known ones."""
    known = _NAMED | (names or {})
    for signature in signatures.split(";"):
        result, _, rest = signature.strip().partition("(")
        parameters = []
        for part in filter(None, (text.strip() for text in rest.rstrip(")").split(","))):
            name, _, type_name = part.rpartition(":")
            parameters.append((name.strip(), type_name.strip().rstrip("&"), part.endswith("&")))
        used = [_LETTERS[n] for n in (result, *(p[1] for p in parameters)) if n in _LETTERS]
        for size in (1, 2, 3, 4) if used else (0,):
            if all(size in letter for letter in used):
                scope = {**known, **_SIZED[size]} if used else known
                concrete = tuple(BuiltinParameter(scope[type], name, memory) for name, type, memory in parameters)
                yield Overload(concrete, scope[result], glsl)


def _row(name: str, signatures: str, glsl: str = "", doc: str = "", **more: Any) -> Builtin:
    overloads = tuple(dict.fromkeys(expand(signatures, glsl or name)))
    arguments = ", ".join(f"{{{index}}}" for index in range(len(overloads[0].parameters)))
    for language in ("opencl", "numpy", "fast"):
        if more.get(language, "").replace(".", "_").isidentifier():
            more[language] += f"({arguments})"
    return Builtin(name, overloads, doc, form=signatures, **more)


_VERTEX: Final = frozenset({Stage.VERTEX})
_FRAGMENT: Final = frozenset({Stage.FRAGMENT})
_COMPUTE: Final = frozenset({Stage.COMPUTE})
_DRAW_PARAMETERS: Final = "GL_ARB_shader_draw_parameters"
_F: Final = "F(F)"
_ROUNDED: Final = ErrorBound(0.5, 0.5, 0.5, 0.5)
# A 3x3 matrix that is not nearly singular.
_REGULAR: Final = "abs(np.linalg.det(a.reshape(-1, 3, 3))) > 1e-3 * abs(a).max(axis=-1) ** 3"
_NUMBERS: Final = ErrorBound(defined="(a == a) & (b == b)")
_WHOLE: Final = ErrorBound(defined="(a == a).all(axis=-1)")


def _composed(units: float, limit: float = 1e6, defined: str = "") -> ErrorBound:
    """Return the bound of a built-in that is composed of others in the same way in every language."""
    return ErrorBound(units, units, units, units, 0, ((-limit, limit),), True, defined)


_ATOMIC: Final = "int(int&,int);uint(uint&,uint)"
_WRITE: Final = SideEffect.WRITE

_ROWS: Final = (
    # angles
    _row(
        "radians",
        _F,
        doc="degrees to radians",
        error=ErrorBound(1, 1, 1, 1),
        lanes="a * 0.017453292519943295",
    ),
    _row("degrees", _F, doc="radians to degrees", error=ErrorBound(1, 1, 1, 1), lanes="a * 57.29577951308232"),
    _row(
        "sin",
        _F,
        doc="sine",
        opencl="rhi_sin",
        numpy="np.sin",
        fast="rhi_fast_sin",
        error=ErrorBound(2, 4, 2, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "cos",
        _F,
        doc="cosine",
        opencl="rhi_cos",
        numpy="np.cos",
        fast="rhi_fast_cos",
        error=ErrorBound(2, 4, 2, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "tan",
        _F,
        doc="tangent",
        opencl="rhi_tan",
        numpy="np.tan",
        error=ErrorBound(1000, 5, 5, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "asin",
        _F,
        doc="arc sine, -π/2…π/2",
        opencl="rhi_asin",
        numpy="np.arcsin",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((-1, 1),), defined="abs(a) <= 1"),
    ),
    _row(
        "acos",
        _F,
        doc="arc cosine, 0…π",
        opencl="rhi_acos",
        numpy="np.arccos",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((-1, 1),), defined="abs(a) <= 1"),
    ),
    _row("atan", _F, doc="arc tangent, -π/2…π/2", opencl="rhi_atan", numpy="np.arctan", error=ErrorBound(400, 5, 5, 4)),
    _row(
        "atan2",
        "F(F,F)",
        "atan",
        "angle of (y, x), -π…π; y first",
        opencl="rhi_atan2",
        numpy="np.arctan2",
        error=ErrorBound(400, 6, 6, 4, 0, ((-1e6, 1e6),), defined="(a != 0) | (b != 0)"),
    ),
    _row(
        "sinh",
        _F,
        doc="hyperbolic sine",
        opencl="rhi_sinh",
        numpy="np.sinh",
        error=ErrorBound(100, 4, 4, 4, 2e-7, ((-88, 88),)),
    ),
    _row(
        "cosh",
        _F,
        doc="hyperbolic cosine",
        opencl="rhi_cosh",
        numpy="np.cosh",
        error=ErrorBound(100, 4, 4, 4, 0, ((-88, 88),)),
    ),
    _row(
        "tanh", _F, doc="hyperbolic tangent", opencl="rhi_tanh", numpy="np.tanh", error=ErrorBound(100, 5, 5, 4, 2e-7)
    ),
    _row(
        "asinh",
        _F,
        doc="inverse hyperbolic sine",
        opencl="rhi_asinh",
        numpy="np.arcsinh",
        error=ErrorBound(4, 4, 4, 4, 5e-7),
    ),
    _row(
        "acosh",
        _F,
        doc="inverse hyperbolic cosine",
        opencl="rhi_acosh",
        numpy="np.arccosh",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((1, 1e6),), defined="a >= 1"),
    ),
    _row(
        "atanh",
        _F,
        doc="inverse hyperbolic tangent",
        opencl="rhi_atanh",
        numpy="np.arctanh",
        error=ErrorBound(4, 5, 5, 4, 5e-7, ((-1, 1),), defined="abs(a) < 1"),
    ),
    # exponentials
    _row(
        "pow",
        "F(F,F)",
        doc="x to the power y; undefined for x < 0",
        opencl="rhi_pow",
        numpy="np.power",
        fast="rhi_fast_pow",
        error=ErrorBound(128, 16, 128, 4, 0, ((1e-3, 1e3), (-10, 10)), defined="(a > 0) | (a == 0) & (b > 0)"),
    ),
    _row(
        "exp",
        _F,
        doc="e to the power x",
        opencl="rhi_exp",
        numpy="np.exp",
        fast="rhi_fast_exp",
        error=ErrorBound(100, 3, 3, 4, 0, ((-87, 88),)),
    ),
    _row(
        "log",
        _F,
        doc="natural logarithm",
        opencl="rhi_log",
        numpy="np.log",
        fast="(rhi_fast_log2({0}) * 0.69314718f)",
        error=ErrorBound(4, 3, 6, 4, 2e-7, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    _row(
        "exp2",
        _F,
        doc="2 to the power x",
        opencl="rhi_exp2",
        numpy="np.exp2",
        fast="rhi_fast_exp2",
        error=ErrorBound(4, 3, 4, 4, 0, ((-126, 127.5),)),
    ),
    _row(
        "log2",
        _F,
        doc="logarithm to base 2",
        opencl="rhi_log2",
        numpy="np.log2",
        fast="rhi_fast_log2",
        error=ErrorBound(4, 3, 5, 4, 2e-7, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    _row(
        "sqrt",
        _F,
        doc="square root",
        opencl="sqrt",
        numpy="np.sqrt",
        fast="native_sqrt",
        error=ErrorBound(0.5, 3, 3, 0.5, 0, ((0, 1e38),), defined="a >= 0"),
    ),
    _row(
        "inversesqrt",
        _F,
        doc="1 / sqrt(x)",
        opencl="(1.0f / sqrt({0}))",
        numpy="(F(1) / np.sqrt({0}))",
        fast="rhi_fast_inversesqrt",
        error=ErrorBound(1.5, 4, 2, 1.5, 0, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    # common
    _row("abs", "I(I);F(F)", doc="absolute value", opencl="rhi_abs", numpy="np.abs"),
    _row("sign", "I(I);F(F)", doc="-1, 0 or 1", lanes="-1 if a < 0 else 1 if a > 0 else 0"),
    _row("floor", _F, doc="largest whole number <= x", opencl="floor", numpy="np.floor"),
    _row("ceil", _F, doc="smallest whole number >= x", opencl="ceil", numpy="np.ceil"),
    _row("trunc", _F, doc="x rounded towards zero", opencl="trunc", numpy="np.trunc"),
    _row(
        "round",
        _F,
        "roundEven",
        "nearest whole number, halves rounded to even as in Python",
        opencl="rint",
        numpy="np.rint",
    ),
    _row("fract", _F, doc="x - floor(x)", error=_ROUNDED, lanes="a - floor(a)"),
    _row(
        "min",
        "I(I,I);I(I,int);U(U,U);U(U,uint);F(F,F);F(F,float)",
        doc="minimum, component-wise",
        opencl="rhi_min",
        numpy="np.minimum",
        error=_NUMBERS,
    ),
    _row(
        "max",
        "I(I,I);I(I,int);U(U,U);U(U,uint);F(F,F);F(F,float)",
        doc="maximum, component-wise",
        opencl="rhi_max",
        numpy="np.maximum",
        error=_NUMBERS,
    ),
    _row(
        "clamp",
        "I(I,I,I);I(I,int,int);U(U,U,U);U(U,uint,uint);F(F,F,F);F(F,float,float)",
        doc="min(max(x, low), high)",
        error=ErrorBound(defined="(b <= c) & (a == a)"),
        lanes="min(max(a, b), c)",
    ),
    _row(
        "saturate",
        _F,
        "clamp({0}, 0.0, 1.0)",
        "clamp(x, 0, 1)",
        error=ErrorBound(defined="a == a"),
        lanes="min(max(a, 0.0), 1.0)",
    ),
    _row(
        "mix",
        "F(F,F,F);V(V,V,float);V(V,V,BV)",
        doc="x (1 - a) + y a for (x, y, a); with a bvec, y where a is true, else x",
        error=_composed(4),
    ),
    _row(
        "step",
        "F(F,F);V(float,V)",
        doc="0 where x < edge, else 1, for (edge, x)",
        error=_NUMBERS,
        lanes="0.0 if b < a else 1.0",
    ),
    _row(
        "smoothstep",
        "F(F,F,F);V(float,float,V)",
        doc="smooth Hermite step from 0 to 1 for (edge0, edge1, x)",
        error=_composed(8, 1e6, "a < b"),
        lanes="(t := saturate((c - a) / (b - a))) * t * (3.0 - 2.0 * t)",
    ),
    _row(
        "fma",
        "F(F,F,F)",
        doc="a b + c",
        opencl="fma",
        numpy="R.fma({0}, {1}, {2}, F)",
        error=ErrorBound(2, 0.5, 0.5, 0.5, of_arguments=True),
    ),
    _row("isnan", "B(F)", doc="whether x is not a number", lanes="a != a"),
    _row("isinf", "B(F)", doc="whether x is infinite", lanes="abs(a) == inf"),
    # geometry
    _row("length", "float(F)", doc="Euclidean length", error=_composed(2)),
    _row("distance", "float(F,F)", doc="length(a - b)", error=_composed(2), lanes="length(a - b)"),
    _row("dot", "float(V,V)", doc="dot product", error=_composed(2)),
    _row(
        "cross",
        "vec3(vec3,vec3)",
        doc="cross product",
        error=_composed(2),
        lanes="a.yzx * b.zxy - a.zxy * b.yzx",
    ),
    _row(
        "normalize",
        "V(V)",
        doc="v / length(v); undefined for a zero vector",
        error=_composed(4),
        lanes="a * inversesqrt(dot(a, a))",
    ),
    _row(
        "faceforward",
        "V(V,V,V)",
        doc="n if dot(reference, incident) < 0, else -n, for (n, incident, reference)",
        error=_composed(0),
        lanes="a if dot(c, b) < 0.0 else -a",
    ),
    _row(
        "reflect",
        "V(V,V)",
        doc="incident vector reflected at a plane with unit normal n, for (incident, n)",
        error=_composed(4),
        lanes="a - (2.0 * dot(b, a)) * b",
    ),
    _row(
        "refract",
        "V(V,V,float)",
        doc="incident vector refracted at a plane with unit normal n, for (incident, n, eta);"
        " eta is the ratio of refractive indices",
        error=_composed(4, 1),
    ),
    # matrices
    _row("transpose", "M(M)", doc="rows and columns exchanged"),
    _row("determinant", "float(M)", doc="determinant", error=_composed(4, 1e3)),
    _row("inverse", "M(M)", doc="inverse; undefined for a singular matrix", error=_composed(100, 1e3, _REGULAR)),
    # component-wise comparisons
    _row("less_than", "BV(V,V);BV(IV,IV);BV(UV,UV)", "lessThan", "a < b, component-wise", lanes="a < b"),
    _row(
        "less_than_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        "lessThanEqual",
        "a <= b, component-wise",
        lanes="a <= b",
    ),
    _row("greater_than", "BV(V,V);BV(IV,IV);BV(UV,UV)", "greaterThan", "a > b, component-wise", lanes="a > b"),
    _row(
        "greater_than_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        "greaterThanEqual",
        "a >= b, component-wise",
        lanes="a >= b",
    ),
    _row("equal", "BV(V,V);BV(IV,IV);BV(UV,UV);BV(BV,BV)", "equal", "a == b, component-wise", lanes="a == b"),
    _row(
        "not_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV);BV(BV,BV)",
        "notEqual",
        "a != b, component-wise",
        lanes="a != b",
    ),
    _row("any", "bool(BV)", doc="whether any component is true"),
    _row("all", "bool(BV)", doc="whether all components are true"),
    _row("invert", "BV(BV)", "not", "not, component-wise", lanes="not a"),
    # bits
    _row("float_bits_to_int", "I(F)", "floatBitsToInt", "the same 32 bits as an int", lanes="as_int(a)"),
    _row("float_bits_to_uint", "U(F)", "floatBitsToUint", "the same 32 bits as a uint", lanes="as_uint(a)"),
    _row("int_bits_to_float", "F(I)", "intBitsToFloat", "the same 32 bits as a float", lanes="as_float(a)"),
    _row("uint_bits_to_float", "F(U)", "uintBitsToFloat", "the same 32 bits as a float", lanes="as_float(a)"),
    _row("bit_count", "I(I);I(U)", "bitCount", "number of set bits", lanes="as_int(bits_set(a))"),
    _row("find_lsb", "I(I);I(U)", "findLSB", "index of the lowest set bit, -1 if none"),
    _row(
        "find_msb",
        "I(I);I(U)",
        "findMSB",
        "index of the highest set bit, of a negative int that of its highest 0; -1 if none",
    ),
    _row("bitfield_reverse", "I(I);U(U)", "bitfieldReverse", "bits in reverse order"),
    _row(
        "bitfield_extract",
        "I(I,int,int);U(U,int,int)",
        "bitfieldExtract",
        "the `count` bits that start at bit `offset`, for (x, offset, count)",
        error=ErrorBound(defined="(b >= 0) & (c >= 0) & (b + c <= 32)"),
    ),
    _row(
        "bitfield_insert",
        "I(I,I,int,int);U(U,U,int,int)",
        "bitfieldInsert",
        "base with `count` bits at bit `offset` replaced by the low bits of x, for (base, x, offset, count)",
        error=ErrorBound(defined="(c >= 0) & (d >= 0) & (c + d <= 32)"),
    ),
    # packing
    _row(
        "pack_half_2x16",
        "uint(vec2)",
        "packHalf2x16",
        "two half-precision floats in a uint, x in the low bits",
        error=_WHOLE,
    ),
    _row("unpack_half_2x16", "vec2(uint)", "unpackHalf2x16", "inverse of pack_half_2x16"),
    _row(
        "pack_unorm_2x16",
        "uint(vec2)",
        "packUnorm2x16",
        "0…1 in 16 bits each",
        error=_WHOLE,
    ),
    _row("unpack_unorm_2x16", "vec2(uint)", "unpackUnorm2x16", "inverse of pack_unorm_2x16", error=_ROUNDED),
    _row(
        "pack_snorm_2x16",
        "uint(vec2)",
        "packSnorm2x16",
        "-1…1 in 16 bits each",
        error=_WHOLE,
    ),
    _row("unpack_snorm_2x16", "vec2(uint)", "unpackSnorm2x16", "inverse of pack_snorm_2x16", error=_ROUNDED),
    _row(
        "pack_unorm_4x8",
        "uint(vec4)",
        "packUnorm4x8",
        "0…1 in 8 bits each",
        error=_WHOLE,
    ),
    _row("unpack_unorm_4x8", "vec4(uint)", "unpackUnorm4x8", "inverse of pack_unorm_4x8", error=_ROUNDED),
    _row(
        "pack_snorm_4x8",
        "uint(vec4)",
        "packSnorm4x8",
        "-1…1 in 8 bits each",
        error=_WHOLE,
    ),
    _row("unpack_snorm_4x8", "vec4(uint)", "unpackSnorm4x8", "inverse of pack_snorm_4x8", error=_ROUNDED),
    # lanes
    _row(
        "uniform",
        "B(B);I(I);U(U);F(F)",
        "({0})",
        "x, declared to be the same in all active invocations; what depends only on it is computed once for all",
    ),
    _row(
        "unchecked",
        "int(int);uint(uint)",
        "({0})",
        "an index that the author knows to be inside: `a[unchecked(i)]` isn't bounded, and undefined if it is outside",
        lanes="a",
    ),
    _row(
        "broadcast_first",
        "B(B);I(I);U(U);F(F)",
        "({0})",
        "x of one of the active invocations that are executed together; the device decides which are",
    ),
    # fragments
    _row(
        "ddx",
        _F,
        "dFdx",
        "derivative in x: the change to the next pixel on the right",
        stages=_FRAGMENT,
        opencl="rhi_ddx",
        numpy="R.ddx",
    ),
    _row(
        "ddy",
        _F,
        "dFdy",
        "derivative in y: the change to the next pixel below",
        stages=_FRAGMENT,
        opencl="rhi_ddy",
        numpy="R.ddy",
    ),
    _row("fwidth", _F, "fwidth", "abs(ddx(x)) + abs(ddy(x))", stages=_FRAGMENT),
    _row(
        "discard",
        "None()",
        "discard",
        "ends the fragment without output",
        stages=_FRAGMENT,
        effect=SideEffect.DISCARD,
    ),
    # memory
    _row("atomic_add", _ATOMIC, "atomicAdd", "adds; returns the old value", effect=_WRITE),
    _row("atomic_min", _ATOMIC, "atomicMin", "stores the smaller value; returns the old one", effect=_WRITE),
    _row("atomic_max", _ATOMIC, "atomicMax", "stores the larger value; returns the old one", effect=_WRITE),
    _row("atomic_and", _ATOMIC, "atomicAnd", "bitwise and; returns the old value", effect=_WRITE),
    _row("atomic_or", _ATOMIC, "atomicOr", "bitwise or; returns the old value", effect=_WRITE),
    _row("atomic_xor", _ATOMIC, "atomicXor", "bitwise exclusive or; returns the old value", effect=_WRITE),
    _row("atomic_exchange", _ATOMIC, "atomicExchange", "stores; returns the old value", effect=_WRITE),
    _row(
        "atomic_compare_exchange",
        "int(int&,int,int);uint(uint&,uint,uint)",
        "atomicCompSwap",
        "stores if the old value is the expected one, for (location, expected, value); returns the old value",
        effect=_WRITE,
    ),
    _row(
        "barrier",
        "None()",
        "groupMemoryBarrier(); barrier()",
        "waits for all invocations of the work-group; each then sees what the others have written",
        stages=_COMPUTE,
        effect=SideEffect.BARRIER,
    ),
    _row(
        "memory_barrier",
        "None()",
        "memoryBarrier()",
        "makes this invocation's writes visible to the others before its next memory accesses",
        effect=SideEffect.BARRIER,
    ),
    # stage inputs
    _row(
        "vertex_index",
        "int()",
        "gl_VertexID",
        "index of the vertex, including the base vertex",
        stages=_VERTEX,
    ),
    _row(
        "instance_index",
        "int()",
        "(gl_BaseInstanceARB + gl_InstanceID)",
        "index of the instance, including the base instance",
        stages=_VERTEX,
        extension=_DRAW_PARAMETERS,
    ),
    _row(
        "draw_index",
        "int()",
        "gl_DrawIDARB",
        "index of the draw within a multi-draw",
        stages=_VERTEX,
        extension=_DRAW_PARAMETERS,
    ),
    _row(
        "fragment_coordinate",
        "vec4()",
        "gl_FragCoord",
        "(x, y in pixels, depth, 1 / clip w); row 0 is at the top, pixel centres at .5",
        stages=_FRAGMENT,
    ),
    _row(
        "point_coordinate",
        "vec2()",
        "gl_PointCoord",
        "(x, y) inside the square of a point, 0 to 1 from its top left; undefined for other primitives",
        stages=_FRAGMENT,
    ),
    _row("front_facing", "bool()", "gl_FrontFacing", "whether the primitive faces the camera", stages=_FRAGMENT),
    _row("primitive_index", "int()", "gl_PrimitiveID", "index of the primitive in the draw", stages=_FRAGMENT),
    _row(
        "global_id",
        "ivec3()",
        "ivec3(gl_GlobalInvocationID)",
        "index of the invocation in the dispatch",
        stages=_COMPUTE,
    ),
    _row(
        "local_id",
        "ivec3()",
        "ivec3(gl_LocalInvocationID)",
        "index of the invocation in its work-group",
        stages=_COMPUTE,
    ),
    _row(
        "local_index",
        "int()",
        "int(gl_LocalInvocationIndex)",
        "local_id as one number, x fastest",
        stages=_COMPUTE,
    ),
    _row("group_id", "ivec3()", "ivec3(gl_WorkGroupID)", "index of the work-group", stages=_COMPUTE),
    _row("group_count", "ivec3()", "ivec3(gl_NumWorkGroups)", "number of work-groups", stages=_COMPUTE),
)

BUILTINS: Final[dict[str, Builtin]] = {row.name: row for row in _ROWS}
"""All built-in functions by name."""

# Ints: no division by 0, and none of the smallest int by -1. Floats: the quotient must not underflow or overflow.
_DIVISIBLE: Final = (
    "(b != 0) & ((a != -2147483648) | (b != -1)) & ((a == 0) | ((abs(a) > abs(b) * 1e-30) & (abs(a) < abs(b) * 1e30)))"
)
# x - y floor(x / y) has no correct digits left when the quotient has as many digits as a float.
_NEAR: Final = "((abs(a) < abs(b) * 1e6) | ((a == np.floor(a)) & (b == np.floor(b))))"
_EXACT: Final = ErrorBound()
_SHIFT: Final = ErrorBound(defined="(b >= 0) & (b < 32)")
OPERATORS: Final[dict[str, ErrorBound]] = {
    **dict.fromkeys(("+", "-", "*"), _ROUNDED),
    "/": ErrorBound(2.5, 2.5, 2.5, 2.5, 0, ((-1e18, 1e18),)),
    "//": _composed(0.5, 1e6, _DIVISIBLE),
    "%": _composed(2, 1e6, f"{_DIVISIBLE} & {_NEAR}"),
    "**": BUILTINS["pow"].error,
    "@": BUILTINS["dot"].error,
    **dict.fromkeys(("<<", ">>"), _SHIFT),
    **dict.fromkeys(("&", "|", "^", "~", "neg", "==", "!=", "<", "<=", ">", ">=", "and", "or", "not"), _EXACT),
}
"""The error bounds of the operators by sign. `neg` is unary minus."""
