"""The built-in functions: one table with one row per function.

- A row holds a name, its signatures, and its spelling in each language. The type checks of the parser, the
  stubs, the code writers and the documentation all read this table. To support another language, add a
  column.
- Every row says what it means in every language: a spelling, `POLYFILL` if code of the language's package
  writes it, or `Refused(tip)` if the language lacks it. A row that says nothing fails at import, and so does
  a polyfill that the package lacks (`check_polyfills`).
- Methods of textures and images are in a table of their own (`rhi.shading.language.textures`).
- In a signature, letters stand for types of one common size: F is float or vec, I, U and B are int, uint and
  bool or their vectors, V, IV, UV and BV are vectors only, M is mat. `F(F,F,float)` is four overloads. `int&`
  is a memory location that the function modifies.
- A spelling is a function's name, which is called with all arguments, or a template with `{0}` for the first
  argument. OpenCL's and NumPy's are for one component. `fast` is OpenCL's spelling with `Precision.FAST`.
  WGSL's templates may also name the result's type `{type}`, the first argument's bits as uints `{bits}`, and
  the first argument as wide as the widest one `{v0}`.
- Instead of spellings for OpenCL and NumPy, `lanes` composes a built-in from others: an expression in the
  arguments a, b, c and d (`rhi.shading.lowering.expansions`). `POLYFILL` there is a function of
  `rhi.shading.lowering`.
- `error` bounds the error of the results. `python -m rhi shading accuracy` measures it, and tests check the
  bounds.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import field
from functools import cache
from typing import Any, Final, NoReturn, TypeAlias

from rhi.contract.descriptors import Stage
from rhi.contract.layout import BOOL, FLOAT, INT, UINT
from rhi.errors import refuse
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.shading.language import rules
from rhi.shading.language.types import LANGUAGE_NAMES, MATRICES, VECTORS, VOID, Type, converts

LANGUAGE_NAMES.add("Precision")


class Precision(Choice):
    """Accuracy of pow, exp, log, sin, cos, roots and divisions on OpenCL: EXACT is within a few ulp, FAST
    less exact.

    With EXACT, GLSL rounds each operation of floats by itself (docs/shading-arithmetic.md).
    With FAST, OpenCL may flush numbers below 2^-126 to 0. `python -m rhi shading accuracy` measures the
    errors of both.
    """

    EXACT = "exact"
    FAST = "fast"


class SideEffect(enum.Enum):
    """The effect of a built-in besides its result: none, a write to memory, a barrier, or the end of the
    fragment."""

    NONE = "none"
    WRITE = "write"
    BARRIER = "barrier"
    DISCARD = "discard"


class Polyfill(enum.Enum):
    """The mark of a built-in that code of a language's package writes, looked up by the built-in's name."""

    POLYFILL = "polyfill"


POLYFILL: Final = Polyfill.POLYFILL


@dataclass(frozen=True, slots=True)
class Refused:
    """The mark of a built-in that a language lacks: a use is refused, with this tip."""

    tip: str = ""


Spelling: TypeAlias = str | Polyfill | Refused


@dataclass(frozen=True, slots=True)
class ErrorBound:
    """The largest error of a result, in the units that `rhi.testing.accuracy.probes` counts. By default they
    are exact.

    Attributes:
        glsl, exact, fast, numpy: bounds in units: on OpenGL (with Mesa's llvmpipe; OpenGL itself guarantees
            less), on OpenCL with either precision (EXACT's bound is OpenCL's own guarantee, FAST's is
            measured), and on NumPy in float32.
        glsl_absolute: an absolute error that is allowed on OpenGL whatever the units.
        domain: the range of each float argument in which the bounds of OpenGL and FAST hold; the last range
            also holds for the arguments after it. The bounds of EXACT and NumPy hold for every number, unless
            the units are `of_arguments`.
        of_arguments: the built-in is composed of others, and one unit is the change of the result when an
            argument changes by one unit.
        defined: where the result is defined, as a NumPy expression in the arguments a, b, c and d; everywhere
            if empty.
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
    """A row of the table: a built-in function, or a method of a texture. The module's head describes the
    columns."""

    name: str
    overloads: tuple[Overload, ...]
    doc: str
    effect: SideEffect = SideEffect.NONE
    stages: frozenset[Stage] = frozenset(Stage)
    extension: str = ""
    wgsl: Spelling = ""
    opencl: str = ""
    numpy: str = ""
    fast: str = ""
    lanes: str | Polyfill = ""
    error: ErrorBound = ErrorBound()
    form: str = ""
    _choices: dict[tuple[Any, ...], Overload | None] = field(default_factory=dict, repr=False)

    def choose(self, types: Sequence[Type], literals: Sequence[bool]) -> Overload | None:
        """Return the overload for arguments of these types: an exact match, else the first that they convert
        to."""
        key = (*types, *literals)
        if key not in self._choices:
            self._choices[key] = self._choose(types, literals)
        return self._choices[key]

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
            f"{self.name}({', '.join(str(p.type) for p in o.parameters)}) -> {o.result}"
            for o in self.overloads
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
    size: {name: letter[size] for name, letter in _LETTERS.items() if size in letter}
    for size in (0, 1, 2, 3, 4)
}
_NAMED: Final[dict[str, Type]] = {
    "None": VOID,
    **{str(type): type for type in (BOOL, INT, UINT, FLOAT)},
    **{str(type): type for type in VECTORS.values()},
    **{str(type): type for type in MATRICES.values()},
}


def expand(signatures: str, glsl: str, names: dict[str, Type] | None = None) -> Iterator[Overload]:
    """Yield the overloads of signatures that are separated by semicolons. `names` adds type names to the
    known ones."""
    named_types = _NAMED | names if names else _NAMED
    for signature in signatures.split(";"):
        concrete = _list_concrete(signature, named_types) if names else _list_known(signature)
        for parameters, result in concrete:
            yield Overload(parameters, result, glsl)


@cache
def _list_known(signature: str) -> list[tuple[tuple[BuiltinParameter, ...], Type]]:
    """List the parameters and results of a signature, of which many built-ins have the same."""
    return _list_concrete(signature, _NAMED)


def _list_concrete(
    signature: str, named_types: Mapping[str, Type]
) -> list[tuple[tuple[BuiltinParameter, ...], Type]]:
    result, _, rest = signature.strip().partition("(")
    parameters = []
    for part in filter(None, (text.strip() for text in rest.rstrip(")").split(","))):
        name, _, type_name = part.rpartition(":")
        parameters.append((name.strip(), type_name.strip().rstrip("&"), part.endswith("&")))
    used = [_LETTERS[n] for n in (result, *(p[1] for p in parameters)) if n in _LETTERS]
    concrete = []
    for size in (1, 2, 3, 4) if used else (0,):
        if all(size in letter for letter in used):
            scope = {**named_types, **_SIZED[size]} if used else named_types
            types = [BuiltinParameter(scope[type], name, memory) for name, type, memory in parameters]
            concrete.append((tuple(types), scope[result]))
    return concrete


def _row(
    name: str,
    signatures: str,
    *,
    glsl: str = "",
    wgsl: Spelling = "",
    opencl: str = "",
    numpy: str = "",
    fast: str = "",
    lanes: str | Polyfill = "",
    doc: str = "",
    **more: Any,
) -> Builtin:
    """Return a row of the table.

    Raises:
        TypeError: a language has no spelling, polyfill or refusal of the built-in.
    """
    for language, has_meaning in (
        ("GLSL", bool(glsl)),
        ("WGSL", bool(wgsl)),
        ("OpenCL", bool(lanes or opencl)),
        ("NumPy", bool(lanes or numpy)),
    ):
        if not has_meaning:
            raise TypeError(
                f"built-in {name!r} has no meaning in {language}: give a spelling, POLYFILL, or Refused(tip) "
                "in WGSL"
            )
    overloads = tuple(dict.fromkeys(expand(signatures, glsl)))
    count = len(overloads[0].parameters)
    return Builtin(
        name,
        overloads,
        doc,
        wgsl=_call(wgsl, count) if isinstance(wgsl, str) else wgsl,
        opencl=_call(opencl, count),
        numpy=_call(numpy, count),
        fast=_call(fast, count),
        lanes=lanes,
        form=signatures,
        **more,
    )


def _call(spelling: str, count: int) -> str:
    """Return a spelling as a template: the name of a function becomes a call with `count` arguments."""
    if spelling.replace(".", "_").isidentifier():
        return f"{spelling}({', '.join(f'{{{index}}}' for index in range(count))})"
    return spelling


_VERTEX: Final = frozenset({Stage.VERTEX})
_FRAGMENT: Final = frozenset({Stage.FRAGMENT})
_COMPUTE: Final = frozenset({Stage.COMPUTE})
_DRAW_PARAMETERS: Final = "GL_ARB_shader_draw_parameters"
_F: Final = "F(F)"
_ROUNDED: Final = ErrorBound(0.5, 0.5, 0.5, 0.5)
# Where a 3x3 matrix is not nearly singular.
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
        glsl="radians",
        wgsl="radians",
        lanes="a * 0.017453292519943295",
        doc="degrees to radians",
        error=ErrorBound(1, 1, 1, 1),
    ),
    _row(
        "degrees",
        _F,
        glsl="degrees",
        wgsl="degrees",
        lanes="a * 57.29577951308232",
        doc="radians to degrees",
        error=ErrorBound(1, 1, 1, 1),
    ),
    _row(
        "sin",
        _F,
        glsl="sin",
        wgsl="sin",
        opencl="rhi_sin",
        numpy="np.sin",
        fast="rhi_fast_sin",
        doc="sine",
        error=ErrorBound(2, 4, 2, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "cos",
        _F,
        glsl="cos",
        wgsl="cos",
        opencl="rhi_cos",
        numpy="np.cos",
        fast="rhi_fast_cos",
        doc="cosine",
        error=ErrorBound(2, 4, 2, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "tan",
        _F,
        glsl="tan",
        wgsl="tan",
        opencl="rhi_tan",
        numpy="np.tan",
        doc="tangent",
        error=ErrorBound(1000, 5, 5, 4, 1e-6, ((-1e3, 1e3),)),
    ),
    _row(
        "asin",
        _F,
        glsl="asin",
        wgsl="asin",
        opencl="rhi_asin",
        numpy="np.arcsin",
        doc="arc sine, -π/2…π/2",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((-1, 1),), defined="abs(a) <= 1"),
    ),
    _row(
        "acos",
        _F,
        glsl="acos",
        wgsl="acos",
        opencl="rhi_acos",
        numpy="np.arccos",
        doc="arc cosine, 0…π",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((-1, 1),), defined="abs(a) <= 1"),
    ),
    _row(
        "atan",
        _F,
        glsl="atan",
        wgsl="atan",
        opencl="rhi_atan",
        numpy="np.arctan",
        doc="arc tangent, -π/2…π/2",
        error=ErrorBound(400, 5, 5, 4),
    ),
    _row(
        "atan2",
        "F(F,F)",
        glsl="atan",
        wgsl=POLYFILL,
        opencl="rhi_atan2",
        numpy="np.arctan2",
        doc="angle of (y, x), -π…π; y first",
        error=ErrorBound(400, 6, 6, 4, 0, ((-1e6, 1e6),)),
    ),
    _row(
        "sinh",
        _F,
        glsl="sinh",
        wgsl="sinh",
        opencl="rhi_sinh",
        numpy="np.sinh",
        doc="hyperbolic sine",
        error=ErrorBound(100, 4, 4, 4, 2e-7, ((-88, 88),)),
    ),
    _row(
        "cosh",
        _F,
        glsl="cosh",
        wgsl="cosh",
        opencl="rhi_cosh",
        numpy="np.cosh",
        doc="hyperbolic cosine",
        error=ErrorBound(100, 4, 4, 4, 0, ((-88, 88),)),
    ),
    _row(
        "tanh",
        _F,
        glsl="tanh",
        wgsl="tanh",
        opencl="rhi_tanh",
        numpy="np.tanh",
        doc="hyperbolic tangent",
        error=ErrorBound(100, 5, 5, 4, 2e-7),
    ),
    _row(
        "asinh",
        _F,
        glsl="asinh",
        wgsl="asinh",
        opencl="rhi_asinh",
        numpy="np.arcsinh",
        doc="inverse hyperbolic sine",
        error=ErrorBound(4, 4, 4, 4, 5e-7),
    ),
    _row(
        "acosh",
        _F,
        glsl="acosh",
        wgsl="acosh",
        opencl="rhi_acosh",
        numpy="np.arccosh",
        doc="inverse hyperbolic cosine",
        error=ErrorBound(4, 4, 4, 4, 5e-4, ((1, 1e6),), defined="a >= 1"),
    ),
    _row(
        "atanh",
        _F,
        glsl="atanh",
        wgsl="atanh",
        opencl="rhi_atanh",
        numpy="np.arctanh",
        doc="inverse hyperbolic tangent",
        error=ErrorBound(4, 5, 5, 4, 5e-7, ((-1, 1),), defined="abs(a) < 1"),
    ),
    # exponentials
    _row(
        "pow",
        "F(F,F)",
        glsl="pow",
        wgsl=POLYFILL,
        opencl="rhi_pow",
        numpy="np.power",
        fast="rhi_fast_pow",
        doc="x to the power y; undefined for x < 0",
        error=ErrorBound(
            128, 16, 128, 4, 0, ((1e-3, 1e3), (-10, 10)), defined="(a > 0) | (a == 0) & (b > 0) | (b == 0)"
        ),
    ),
    _row(
        "exp",
        _F,
        glsl="exp",
        wgsl="exp",
        opencl="rhi_exp",
        numpy="np.exp",
        fast="rhi_fast_exp",
        doc="e to the power x",
        error=ErrorBound(100, 3, 3, 4, 0, ((-87, 88),)),
    ),
    _row(
        "log",
        _F,
        glsl="log",
        wgsl="log",
        opencl="rhi_log",
        numpy="np.log",
        fast="(rhi_fast_log2({0}) * 0.69314718f)",
        doc="natural logarithm",
        error=ErrorBound(4, 3, 6, 4, 2e-7, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    _row(
        "exp2",
        _F,
        glsl="exp2",
        wgsl="exp2",
        opencl="rhi_exp2",
        numpy="np.exp2",
        fast="rhi_fast_exp2",
        doc="2 to the power x",
        error=ErrorBound(4, 3, 4, 4, 0, ((-126, 127.5),)),
    ),
    _row(
        "log2",
        _F,
        glsl="log2",
        wgsl="log2",
        opencl="rhi_log2",
        numpy="np.log2",
        fast="rhi_fast_log2",
        doc="logarithm to base 2",
        error=ErrorBound(4, 3, 5, 4, 2e-7, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    _row(
        "sqrt",
        _F,
        glsl="sqrt",
        wgsl="sqrt",
        opencl="sqrt",
        numpy="np.sqrt",
        fast="native_sqrt",
        doc="square root",
        error=ErrorBound(0.5, 3, 3, 0.5, 0, ((0, 1e38),), defined="a >= 0"),
    ),
    _row(
        "inversesqrt",
        _F,
        glsl="inversesqrt",
        wgsl="inverseSqrt",
        opencl="(1.0f / sqrt({0}))",
        numpy="(F(1) / np.sqrt({0}))",
        fast="rhi_fast_inversesqrt",
        doc="1 / sqrt(x)",
        error=ErrorBound(1.5, 4, 2, 1.5, 0, ((2.0**-126, 1e38),), defined="a >= 0"),
    ),
    # common
    _row(
        "abs",
        "I(I);F(F)",
        glsl="abs",
        wgsl="abs",
        opencl="rhi_abs",
        numpy="np.abs",
        doc="absolute value",
    ),
    _row(
        "sign",
        "I(I);F(F)",
        glsl="sign",
        wgsl="sign",
        lanes="-1 if a < 0 else 1 if a > 0 else 0",
        doc="-1, 0 or 1",
    ),
    _row(
        "floor",
        _F,
        glsl="floor",
        wgsl="floor",
        opencl="floor",
        numpy="np.floor",
        doc="largest whole number <= x",
    ),
    _row(
        "ceil",
        _F,
        glsl="ceil",
        wgsl="ceil",
        opencl="ceil",
        numpy="np.ceil",
        doc="smallest whole number >= x",
    ),
    _row(
        "trunc",
        _F,
        glsl="trunc",
        wgsl="trunc",
        opencl="trunc",
        numpy="np.trunc",
        doc="x rounded towards zero",
    ),
    _row(
        "round",
        _F,
        glsl="roundEven",
        wgsl="round",
        opencl="rint",
        numpy="np.rint",
        doc="nearest whole number, halves rounded to even as in Python",
    ),
    _row(
        "fract",
        _F,
        glsl="fract",
        wgsl="fract",
        lanes="a - floor(a)",
        doc="x - floor(x)",
        error=_ROUNDED,
    ),
    _row(
        "min",
        "I(I,I);I(I,int);U(U,U);U(U,uint);F(F,F);F(F,float)",
        glsl="min",
        wgsl="min({v0}, {v1})",
        opencl="rhi_min",
        numpy="np.minimum",
        doc="minimum, component-wise",
        error=_NUMBERS,
    ),
    _row(
        "max",
        "I(I,I);I(I,int);U(U,U);U(U,uint);F(F,F);F(F,float)",
        glsl="max",
        wgsl="max({v0}, {v1})",
        opencl="rhi_max",
        numpy="np.maximum",
        doc="maximum, component-wise",
        error=_NUMBERS,
    ),
    _row(
        "clamp",
        "I(I,I,I);I(I,int,int);U(U,U,U);U(U,uint,uint);F(F,F,F);F(F,float,float)",
        glsl="clamp",
        wgsl="clamp({v0}, {v1}, {v2})",
        lanes="min(max(a, b), c)",
        doc="min(max(x, low), high)",
        error=ErrorBound(defined="(b <= c) & (a == a)"),
    ),
    _row(
        "saturate",
        _F,
        glsl="clamp({0}, 0.0, 1.0)",
        wgsl="saturate",
        lanes="min(max(a, 0.0), 1.0)",
        doc="clamp(x, 0, 1)",
        error=ErrorBound(defined="a == a"),
    ),
    _row(
        "mix",
        "F(F,F,F);V(V,V,float);V(V,V,BV)",
        glsl="mix",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="x (1 - a) + y a for (x, y, a); with a bvec, y where a is true, else x",
        error=_composed(4),
    ),
    _row(
        "step",
        "F(F,F);V(float,V)",
        glsl="step",
        wgsl="step({v0}, {v1})",
        lanes="0.0 if b < a else 1.0",
        doc="0 where x < edge, else 1, for (edge, x)",
        error=_NUMBERS,
    ),
    _row(
        "smoothstep",
        "F(F,F,F);V(float,float,V)",
        glsl="smoothstep",
        wgsl="smoothstep({v0}, {v1}, {v2})",
        lanes="(t := saturate((c - a) / (b - a))) * t * (3.0 - 2.0 * t)",
        doc="smooth Hermite step from 0 to 1 for (edge0, edge1, x)",
        error=_composed(8, 1e6, "a < b"),
    ),
    _row(
        "fma",
        "F(F,F,F)",
        glsl="fma",
        wgsl="fma",
        opencl="fma",
        numpy="R.fma({0}, {1}, {2}, F)",
        doc="a b + c",
        error=ErrorBound(2, 0.5, 0.5, 0.5, of_arguments=True),
    ),
    _row(
        "isnan",
        "B(F)",
        glsl="isnan",
        wgsl="((bitcast<{bits}>({0}) & {bits}(0x7FFFFFFFu)) > {bits}(0x7F800000u))",
        lanes="a != a",
        doc="whether x is not a number",
    ),
    _row(
        "isinf",
        "B(F)",
        glsl="isinf",
        wgsl="((bitcast<{bits}>({0}) & {bits}(0x7FFFFFFFu)) == {bits}(0x7F800000u))",
        lanes="abs(a) == inf",
        doc="whether x is infinite",
    ),
    # geometry
    _row(
        "length",
        "float(F)",
        glsl="length",
        wgsl="length",
        lanes=POLYFILL,
        doc="Euclidean length",
        error=_composed(2),
    ),
    _row(
        "distance",
        "float(F,F)",
        glsl="distance",
        wgsl="distance",
        lanes="length(a - b)",
        doc="length(a - b)",
        error=_composed(2),
    ),
    _row(
        "dot",
        "float(V,V)",
        glsl="dot",
        wgsl="dot",
        lanes=POLYFILL,
        doc="dot product",
        error=_composed(2),
    ),
    _row(
        "cross",
        "vec3(vec3,vec3)",
        glsl="cross",
        wgsl="cross",
        lanes="a.yzx * b.zxy - a.zxy * b.yzx",
        doc="cross product",
        error=_composed(2),
    ),
    _row(
        "normalize",
        "V(V)",
        glsl="normalize",
        wgsl="normalize",
        lanes="a * inversesqrt(dot(a, a))",
        doc="v / length(v); undefined for a zero vector",
        error=_composed(4),
    ),
    _row(
        "faceforward",
        "V(V,V,V)",
        glsl="faceforward",
        wgsl="faceForward",
        lanes="a if dot(c, b) < 0.0 else -a",
        doc="n if dot(reference, incident) < 0, else -n, for (n, incident, reference)",
        error=_composed(0),
    ),
    _row(
        "reflect",
        "V(V,V)",
        glsl="reflect",
        wgsl="reflect",
        lanes="a - (2.0 * dot(b, a)) * b",
        doc="incident vector reflected at a plane with unit normal n, for (incident, n)",
        error=_composed(4),
    ),
    _row(
        "refract",
        "V(V,V,float)",
        glsl="refract",
        wgsl="refract",
        lanes=POLYFILL,
        doc="incident vector refracted at a plane with unit normal n, for (incident, n, eta);"
        " eta is the ratio of refractive indices",
        error=_composed(4, 1),
    ),
    # matrices
    _row(
        "transpose",
        "M(M)",
        glsl="transpose",
        wgsl="transpose",
        lanes=POLYFILL,
        doc="rows and columns exchanged",
    ),
    _row(
        "determinant",
        "float(M)",
        glsl="determinant",
        wgsl="determinant",
        lanes=POLYFILL,
        doc="determinant",
        error=_composed(4, 1e3),
    ),
    _row(
        "inverse",
        "M(M)",
        glsl="inverse",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="inverse; undefined for a singular matrix",
        error=_composed(100, 1e3, _REGULAR),
    ),
    # component-wise comparisons
    _row(
        "less_than",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        glsl="lessThan",
        wgsl="({0} < {1})",
        lanes="a < b",
        doc="a < b, component-wise",
    ),
    _row(
        "less_than_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        glsl="lessThanEqual",
        wgsl="({0} <= {1})",
        lanes="a <= b",
        doc="a <= b, component-wise",
    ),
    _row(
        "greater_than",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        glsl="greaterThan",
        wgsl="({0} > {1})",
        lanes="a > b",
        doc="a > b, component-wise",
    ),
    _row(
        "greater_than_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV)",
        glsl="greaterThanEqual",
        wgsl="({0} >= {1})",
        lanes="a >= b",
        doc="a >= b, component-wise",
    ),
    _row(
        "equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV);BV(BV,BV)",
        glsl="equal",
        wgsl="({0} == {1})",
        lanes="a == b",
        doc="a == b, component-wise",
    ),
    _row(
        "not_equal",
        "BV(V,V);BV(IV,IV);BV(UV,UV);BV(BV,BV)",
        glsl="notEqual",
        wgsl="!({0} == {1})",
        lanes="a != b",
        doc="a != b, component-wise",
    ),
    _row(
        "any",
        "bool(BV)",
        glsl="any",
        wgsl="any",
        lanes=POLYFILL,
        doc="whether any component is true",
    ),
    _row(
        "all",
        "bool(BV)",
        glsl="all",
        wgsl="all",
        lanes=POLYFILL,
        doc="whether all components are true",
    ),
    _row(
        "invert",
        "BV(BV)",
        glsl="not",
        wgsl="(!{0})",
        lanes="not a",
        doc="not, component-wise",
    ),
    # bits
    _row(
        "float_bits_to_int",
        "I(F)",
        glsl="floatBitsToInt",
        wgsl="bitcast<{type}>({0})",
        lanes="as_int(a)",
        doc="the same 32 bits as an int",
    ),
    _row(
        "float_bits_to_uint",
        "U(F)",
        glsl="floatBitsToUint",
        wgsl="bitcast<{type}>({0})",
        lanes="as_uint(a)",
        doc="the same 32 bits as a uint",
    ),
    _row(
        "int_bits_to_float",
        "F(I)",
        glsl="intBitsToFloat",
        wgsl="bitcast<{type}>({0})",
        lanes="as_float(a)",
        doc="the same 32 bits as a float",
    ),
    _row(
        "uint_bits_to_float",
        "F(U)",
        glsl="uintBitsToFloat",
        wgsl="bitcast<{type}>({0})",
        lanes="as_float(a)",
        doc="the same 32 bits as a float",
    ),
    _row(
        "bit_count",
        "I(I);I(U)",
        glsl="bitCount",
        wgsl="{type}(countOneBits({0}))",
        lanes="as_int(bits_set(a))",
        doc="number of set bits",
    ),
    _row(
        "find_lsb",
        "I(I);I(U)",
        glsl="findLSB",
        wgsl="{type}(firstTrailingBit({0}))",
        lanes=POLYFILL,
        doc="index of the lowest set bit, -1 if none",
    ),
    _row(
        "find_msb",
        "I(I);I(U)",
        glsl="findMSB",
        wgsl="{type}(firstLeadingBit({0}))",
        lanes=POLYFILL,
        doc="index of the highest set bit, of a negative int that of its highest 0; -1 if none",
    ),
    _row(
        "bitfield_reverse",
        "I(I);U(U)",
        glsl="bitfieldReverse",
        wgsl="reverseBits",
        lanes=POLYFILL,
        doc="bits in reverse order",
    ),
    _row(
        "bitfield_extract",
        "I(I,int,int);U(U,int,int)",
        glsl="bitfieldExtract",
        wgsl="extractBits({0}, u32({1}), u32({2}))",
        lanes=POLYFILL,
        doc="the `count` bits that start at bit `offset`, for (x, offset, count)",
        error=ErrorBound(defined="(b >= 0) & (c >= 0) & (b + c <= 32)"),
    ),
    _row(
        "bitfield_insert",
        "I(I,I,int,int);U(U,U,int,int)",
        glsl="bitfieldInsert",
        wgsl="insertBits({0}, {1}, u32({2}), u32({3}))",
        lanes=POLYFILL,
        doc="base with `count` bits at bit `offset` replaced by the low bits of x, for (base, x, offset, count)",
        error=ErrorBound(defined="(c >= 0) & (d >= 0) & (c + d <= 32)"),
    ),
    # packing
    _row(
        "pack_half_2x16",
        "uint(vec2)",
        glsl="packHalf2x16",
        wgsl="pack2x16float",
        lanes=POLYFILL,
        doc="two half-precision floats in a uint, x in the low bits",
        error=_WHOLE,
    ),
    _row(
        "unpack_half_2x16",
        "vec2(uint)",
        glsl="unpackHalf2x16",
        wgsl="unpack2x16float",
        lanes=POLYFILL,
        doc="inverse of pack_half_2x16",
    ),
    _row(
        "pack_unorm_2x16",
        "uint(vec2)",
        glsl="packUnorm2x16",
        wgsl="pack2x16unorm",
        lanes=POLYFILL,
        doc="0…1 in 16 bits each",
        error=_WHOLE,
    ),
    _row(
        "unpack_unorm_2x16",
        "vec2(uint)",
        glsl="unpackUnorm2x16",
        wgsl="unpack2x16unorm",
        lanes=POLYFILL,
        doc="inverse of pack_unorm_2x16",
        error=_ROUNDED,
    ),
    _row(
        "pack_snorm_2x16",
        "uint(vec2)",
        glsl="packSnorm2x16",
        wgsl="pack2x16snorm",
        lanes=POLYFILL,
        doc="-1…1 in 16 bits each",
        error=_WHOLE,
    ),
    _row(
        "unpack_snorm_2x16",
        "vec2(uint)",
        glsl="unpackSnorm2x16",
        wgsl="unpack2x16snorm",
        lanes=POLYFILL,
        doc="inverse of pack_snorm_2x16",
        error=_ROUNDED,
    ),
    _row(
        "pack_unorm_4x8",
        "uint(vec4)",
        glsl="packUnorm4x8",
        wgsl="pack4x8unorm",
        lanes=POLYFILL,
        doc="0…1 in 8 bits each",
        error=_WHOLE,
    ),
    _row(
        "unpack_unorm_4x8",
        "vec4(uint)",
        glsl="unpackUnorm4x8",
        wgsl="unpack4x8unorm",
        lanes=POLYFILL,
        doc="inverse of pack_unorm_4x8",
        error=_ROUNDED,
    ),
    _row(
        "pack_snorm_4x8",
        "uint(vec4)",
        glsl="packSnorm4x8",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="-1…1 in 8 bits each",
        error=_WHOLE,
    ),
    _row(
        "unpack_snorm_4x8",
        "vec4(uint)",
        glsl="unpackSnorm4x8",
        wgsl="unpack4x8snorm",
        lanes=POLYFILL,
        doc="inverse of pack_snorm_4x8",
        error=_ROUNDED,
    ),
    # lanes
    _row(
        "uniform",
        "B(B);I(I);U(U);F(F)",
        glsl="({0})",
        wgsl="({0})",
        lanes=POLYFILL,
        doc="x, declared to be the same in all active invocations; what depends only on it is computed once for all",
    ),
    _row(
        "unchecked",
        "int(int);uint(uint)",
        glsl="({0})",
        wgsl="({0})",
        lanes="a",
        doc="an index that the author knows to be inside: `a[unchecked(i)]` isn't bounded,"
        " and undefined if it is outside",
    ),
    _row(
        "broadcast_first",
        "B(B);I(I);U(U);F(F)",
        glsl="({0})",
        wgsl="({0})",
        lanes=POLYFILL,
        doc="x of one of the active invocations that are executed together; the device decides which are",
    ),
    # fragments
    _row(
        "ddx",
        _F,
        glsl="dFdx",
        wgsl="dpdx",
        opencl="rhi_ddx",
        numpy="R.ddx",
        doc="derivative in x: the change to the next pixel on the right",
        stages=_FRAGMENT,
    ),
    _row(
        "ddy",
        _F,
        glsl="dFdy",
        wgsl="dpdy",
        opencl="rhi_ddy",
        numpy="R.ddy",
        doc="derivative in y: the change to the next pixel below",
        stages=_FRAGMENT,
    ),
    _row(
        "fwidth",
        _F,
        glsl="fwidth",
        wgsl="fwidth",
        lanes=POLYFILL,
        doc="abs(ddx(x)) + abs(ddy(x))",
        stages=_FRAGMENT,
    ),
    _row(
        "discard",
        "None()",
        glsl="discard",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="ends the fragment without output",
        stages=_FRAGMENT,
        effect=SideEffect.DISCARD,
    ),
    # memory
    _row(
        "atomic_add",
        _ATOMIC,
        glsl="atomicAdd",
        wgsl="atomicAdd",
        lanes=POLYFILL,
        doc="adds; returns the old value",
        effect=_WRITE,
    ),
    _row(
        "atomic_min",
        _ATOMIC,
        glsl="atomicMin",
        wgsl="atomicMin",
        lanes=POLYFILL,
        doc="stores the smaller value; returns the old one",
        effect=_WRITE,
    ),
    _row(
        "atomic_max",
        _ATOMIC,
        glsl="atomicMax",
        wgsl="atomicMax",
        lanes=POLYFILL,
        doc="stores the larger value; returns the old one",
        effect=_WRITE,
    ),
    _row(
        "atomic_and",
        _ATOMIC,
        glsl="atomicAnd",
        wgsl="atomicAnd",
        lanes=POLYFILL,
        doc="bitwise and; returns the old value",
        effect=_WRITE,
    ),
    _row(
        "atomic_or",
        _ATOMIC,
        glsl="atomicOr",
        wgsl="atomicOr",
        lanes=POLYFILL,
        doc="bitwise or; returns the old value",
        effect=_WRITE,
    ),
    _row(
        "atomic_xor",
        _ATOMIC,
        glsl="atomicXor",
        wgsl="atomicXor",
        lanes=POLYFILL,
        doc="bitwise exclusive or; returns the old value",
        effect=_WRITE,
    ),
    _row(
        "atomic_exchange",
        _ATOMIC,
        glsl="atomicExchange",
        wgsl="atomicExchange",
        lanes=POLYFILL,
        doc="stores; returns the old value",
        effect=_WRITE,
    ),
    _row(
        "atomic_compare_exchange",
        "int(int&,int,int);uint(uint&,uint,uint)",
        glsl="atomicCompSwap",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="stores if the old value is the expected one, for (location, expected, value); returns the old value",
        effect=_WRITE,
    ),
    _row(
        "barrier",
        "None()",
        glsl="groupMemoryBarrier(); barrier()",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="waits for all invocations of the work-group; each then sees what the others have written",
        stages=_COMPUTE,
        effect=SideEffect.BARRIER,
    ),
    _row(
        "memory_barrier",
        "None()",
        glsl="memoryBarrier()",
        wgsl=Refused("barrier(), where all invocations of the work-group reach it"),
        lanes=POLYFILL,
        doc="makes this invocation's writes visible to the others before its next memory accesses",
        effect=SideEffect.BARRIER,
    ),
    # stage inputs
    _row(
        "vertex_index",
        "int()",
        glsl="gl_VertexID",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the vertex, including the base vertex",
        stages=_VERTEX,
    ),
    _row(
        "instance_index",
        "int()",
        glsl="(gl_BaseInstanceARB + gl_InstanceID)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the instance, including the base instance",
        stages=_VERTEX,
        extension=_DRAW_PARAMETERS,
    ),
    _row(
        "draw_index",
        "int()",
        glsl="gl_DrawIDARB",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the draw within a multi-draw",
        stages=_VERTEX,
        extension=_DRAW_PARAMETERS,
    ),
    _row(
        "fragment_coordinate",
        "vec4()",
        glsl="gl_FragCoord",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="(x, y in pixels, depth, 1 / clip w); row 0 is at the top, pixel centres at .5",
        stages=_FRAGMENT,
    ),
    _row(
        "point_coordinate",
        "vec2()",
        glsl="gl_PointCoord",
        wgsl=Refused(),
        lanes=POLYFILL,
        doc="(x, y) inside the square of a point, 0 to 1 from its top left; undefined for other primitives",
        stages=_FRAGMENT,
    ),
    _row(
        "front_facing",
        "bool()",
        glsl="gl_FrontFacing",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="whether the primitive faces the camera",
        stages=_FRAGMENT,
    ),
    _row(
        "primitive_index",
        "int()",
        glsl="gl_PrimitiveID",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the primitive in the draw",
        stages=_FRAGMENT,
    ),
    _row(
        "global_id",
        "ivec3()",
        glsl="ivec3(gl_GlobalInvocationID)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the invocation in the dispatch",
        stages=_COMPUTE,
    ),
    _row(
        "local_id",
        "ivec3()",
        glsl="ivec3(gl_LocalInvocationID)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the invocation in its work-group",
        stages=_COMPUTE,
    ),
    _row(
        "local_index",
        "int()",
        glsl="int(gl_LocalInvocationIndex)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="local_id as one number, x fastest",
        stages=_COMPUTE,
    ),
    _row(
        "group_id",
        "ivec3()",
        glsl="ivec3(gl_WorkGroupID)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="index of the work-group",
        stages=_COMPUTE,
    ),
    _row(
        "group_count",
        "ivec3()",
        glsl="ivec3(gl_NumWorkGroups)",
        wgsl=POLYFILL,
        lanes=POLYFILL,
        doc="number of work-groups",
        stages=_COMPUTE,
    ),
)

BUILTINS: Final[dict[str, Builtin]] = {row.name: row for row in _ROWS}
"""All built-in functions by name."""


def check_polyfills(language: str, expected: Iterable[str], written: Iterable[str]) -> None:
    """Compare the built-ins that a language's package must write with those that it writes, at its import.

    Raises:
        TypeError: one lacks the other.
    """
    rows, functions = set(expected), set(written)
    if rows - functions:
        raise TypeError(f"built-ins in {language}: no polyfill of {', '.join(sorted(rows - functions))}")
    if functions - rows:
        raise TypeError(
            f"built-ins in {language}: polyfills without a row: {', '.join(sorted(functions - rows))}"
        )


# Ints: no division by 0, and none of the smallest int by -1. Floats: the quotient must not underflow or
# overflow.
_DIVISIBLE: Final = (
    "(b != 0) & ((a != -2147483648) | (b != -1)) "
    "& ((a == 0) | ((abs(a) > abs(b) * 1e-30) & (abs(a) < abs(b) * 1e30)))"
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
    **dict.fromkeys(
        ("&", "|", "^", "~", "neg", "==", "!=", "<", "<=", ">", ">=", "and", "or", "not"), _EXACT
    ),
}
"""The error bounds of the operators by sign. `neg` is unary minus."""
