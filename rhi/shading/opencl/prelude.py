"""The OpenCL C functions that lane code calls.

- Arithmetic functions are written once for all widths: FLOAT, INT and UINT stand for scalars or vectors.
- Memory functions are generated for the address space, stride and operation that a kernel uses.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Final

HEX: Final = "0123456789abcdef"

_HEAD: Final = "inline __attribute__((overloadable, always_inline)) "
_CALLED: Final = "static __attribute__((overloadable, noinline)) "

_LONG: Final = (
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "pow",
    "exp",
    "log",
    "exp2",
    "log2",
)
"""Functions of OpenCL that drivers inline, hundreds of instructions each.

A kernel that needs one of them more than once calls a function of its own instead. It then builds several
times as fast, and the call costs little beside the function's work.
"""


def per_lane(width: int, template: str) -> list[str]:
    """Return a text for each lane, in which `.s@` is the lane's component, or nothing for scalars."""
    if width == 1:
        return [template.replace(".s@", "")]
    return [template.replace("@", digit) for digit in HEX[:width]]


_TYPES: Final = re.compile(r"(?<![A-Z])(UINT|INT|FLOAT|DOUBLE)(?![A-Z])")
_OPERATIONS: Final = re.compile(r"\b(SELECT|ANY|NOT|BOTH|EITHER)\(")
_SCALAR: Final = {
    "SELECT": "rhi_select(",
    "ANY": "(",
    "NOT": "!(",
    "BOTH": "rhi_both(",
    "EITHER": "rhi_either(",
}
_VECTOR: Final = {**_SCALAR, "SELECT": "select(", "ANY": "rhi_any(", "NOT": "~("}


@cache
def specialise(text: str, width: int) -> str:
    """Return a text for a number of lanes: FLOAT, INT and UINT become vectors or scalars, SELECT and the like
    theirs."""
    suffix, operations = (str(width), _VECTOR) if width > 1 else ("", _SCALAR)
    text = _OPERATIONS.sub(lambda match: operations[match[1]], text)
    return _TYPES.sub(lambda match: match[1].lower() + suffix, text)


def _estimate_text(width: int) -> str:
    """Write 1 / sqrt(x) to at least 11 bits: the machine's instruction where there is one, else OpenCL's
    function."""
    suffix = str(width) if width > 1 else ""
    head = f"{_HEAD}float{suffix} rhi_inversesqrt_estimate(float{suffix} x)"
    native = {
        16: """#ifdef __AVX512F__
HEAD { return __builtin_ia32_rsqrt14ps512_mask(x, (float16)(0.0f), (ushort)0xffff); }
#elif defined(__AVX__)
HEAD { return (float16)(__builtin_ia32_rsqrtps256(x.lo), __builtin_ia32_rsqrtps256(x.hi)); }""",
        8: "#ifdef __AVX__\nHEAD { return __builtin_ia32_rsqrtps256(x); }",
        4: "#ifdef __SSE__\nHEAD { return __builtin_ia32_rsqrtps(x); }",
    }
    fallback = f"{head} {{ return native_rsqrt(x); }}"
    if width not in native:
        return fallback
    return f"{native[width].replace('HEAD', head)}\n#else\n{fallback}\n#endif"


def _tangent_text(width: int) -> str:
    """Write tan. PoCL's vector form (3.1) is wrong by .008 in all lanes if one lane is above 1e7, so lanes
    far from 0 are computed one by one."""
    if width == 1:
        return "HEADfloat rhi_tan(float x) { return tan(x); }"
    one_by_one = " ".join(per_lane(width, "if (far.s@) r.s@ = tan(x.s@);"))
    return f"""HEADfloat{width} rhi_tan(float{width} x) {{
    int{width} far = fabs(x) > 1e5f;
    float{width} r = tan(select(x, (float{width})(0.0f), far));
    if (rhi_any(far)) {{ {one_by_one} }}
    return r;
}}"""


def _turn_text(function: str, quarters: int) -> Callable[[int], str]:
    """Return a writer of sin, or of cos, which is `quarters` of a turn ahead; vectors: see
    `_range_reduction_text`."""

    def text(width: int) -> str:
        value = f"{function}(x)" if width == 1 else f"rhi_turn(x, {quarters})"
        return specialise(f"HEAD FLOAT rhi_{function}(FLOAT x) {{ return {value}; }}", width)

    return text


def _range_reduction_text(width: int) -> str:
    """Write sine and cosine of vectors, in a third of the time of PoCL's own functions.

    The remainder of whole quarter turns is computed in float64, for all lanes.

    Results are within 1.6 ulp up to 2^50. Beyond, where a float's neighbours are millions of turns away, they
    are numbers from -1 to 1. There is no branch, since a branch costs more than the computation. The result
    of `clamp` for NaN is unspecified: with AVX-512 it is a number.
    """
    if width == 1:
        return ""
    text = """HEAD FLOAT rhi_turn(FLOAT x, int more) {
    DOUBLE far = convert_DOUBLE(x), place = fma(far, (DOUBLE)0x1.45f306dc9c883p-1, (DOUBLE)0x1.8p52);
    DOUBLE whole = place - 0x1.8p52;
    FLOAT r = convert_FLOAT(fma(whole, (DOUBLE)-0x1.1a62633145c07p-54, fma(whole, (DOUBLE)-0x1.921fb54442d18p0, far)));
    return rhi_quarter(select(clamp(r, -0.8f, 0.8f), r, r != r), convert_INT(as_LONG(place)) + more);
}"""
    return specialise(text.replace("LONG", f"long{width}"), width)


def _pow_text(width: int) -> str:
    """Write pow: for vectors 2 to the power y log2 x in float64, a sixth of the time of PoCL's own.

    The mantissa, m + 1, is in 2/3…4/3; log2(1 + m) / m and 2^f, for f in -½…½, are minimax polynomials with
    relative errors of 2^-33 and 2^-29. The product y log2 x is at most 150 where the result is a number, so
    the result is within .66 ulp. All other cases than a positive number to a finite power follow C's rules.
    """
    if width == 1:
        return "HEADfloat rhi_pow(float x, float y) { return pow(x, y); }"
    text = f"""HEADFLOAT rhi_pow(FLOAT x, FLOAT y) {{
    FLOAT size = fabs(x);
    INT tiny = size < 0x1p-126f, bits = as_INT(select(size, size * 0x1p24f, tiny));
    INT whole = (bits - 0x3f2aaaab) >> 23;
    DOUBLE m = convert_DOUBLE(as_FLOAT(bits - (whole << 23)) - 1.0f);
    whole -= tiny & 24;
    DOUBLE even, odd, square = m * m;
    {_polynomial(_LOG2)}
    DOUBLE z = fma(fma(odd, m, even), m, convert_DOUBLE(whole)) * convert_DOUBLE(y);
    z = z < -200.0 ? (DOUBLE)-200.0 : z;
    z = z > 200.0 ? (DOUBLE)200.0 : z;
    DOUBLE t = z + 0x1.8p52, f = z - (t - 0x1.8p52);
    square = f * f;
    {_polynomial(_EXP2)}
    FLOAT r = convert_FLOAT(as_DOUBLE(as_LONG(fma(odd, f, even)) + (as_LONG(t) << 52)));
    if (rhi_all((x > 0.0f) & (x < INFINITY) & (fabs(y) < INFINITY))) return r;
    INT grows = (size > 1.0f) == (y > 0.0f), ends = (size == 0.0f) | (size == INFINITY) | (fabs(y) == INFINITY);
    r = select(r, select((FLOAT)0.0f, (FLOAT)INFINITY, grows), ends);
    INT is_whole = floor(y) == y, is_odd = is_whole & (fabs(y) < 0x1p24f) & ((convert_INT(y) & 1) != 0);
    r = select(r, -r, is_odd & (as_INT(x) < 0));
    r = select(r, (FLOAT)NAN, ((x < 0.0f) & (size < INFINITY) & ~is_whole) | (x != x) | (y != y));
    return select(r, (FLOAT)1.0f, (y == 0.0f) | (x == 1.0f) | ((x == -1.0f) & (fabs(y) == INFINITY)));
}}"""
    for kind in ("FLOAT", "INT", "DOUBLE", "LONG"):
        text = text.replace(kind, f"{kind.lower()}{width}")
    return text


_LOG2: Final = (
    1.44269504075, -0.721347519623, 0.480898437796, -0.360673969038, 0.288529590333, -0.240434141905, 0.206454230888,
    -0.180796177415, 0.154326256677, -0.137549949948, 0.176079375241, -0.165814848208,
)  # fmt: skip
"""Coefficients of log2(1 + m) / m for m in -1/3…1/3."""
_EXP2: Final = (
    1.000000001,
    0.6931472057,
    0.2402264689,
    0.05550328777,
    0.009618488958,
    0.001339993122,
    0.0001534581189,
)
"""Coefficients of 2^f for f in -½…½."""


def _polynomial(coefficients: Sequence[float]) -> str:
    """Write the even and the odd half of a polynomial, two chains of operations that a CPU computes side by
    side."""
    lines = []
    for name, half in (("even", coefficients[0::2]), ("odd", coefficients[1::2])):
        text = f"(DOUBLE){half[-1]!r}"
        for coefficient in reversed(half[:-1]):
            text = f"fma({text}, square, (DOUBLE){coefficient!r})"
        lines.append(f"{name} = {text};")
    return "\n    ".join(lines)


def _uniform_text(width: int) -> str:
    """Write the selection of the first active lane's value; with a scalar mask, of the first lane's."""
    if width == 1:
        return ""
    texts = []
    for kind in ("float", "int", "uint"):
        texts += [
            f"{_HEAD}{kind} rhi_uniform({kind}{width} v, int all) {{ return v.s0; }}",
            f"{_HEAD}{kind} rhi_uniform({kind}{width} v, int{width} mask) {{",
            *per_lane(width, "    if (mask.s@) return v.s@;"),
            "    return v.s0;\n}",
        ]
    return "\n".join(texts)


def _check_text(width: int) -> str:
    """Write the check that records the first fault of a launch: its line in the text, the given value and the
    limit."""
    if width == 1:
        kind, condition, first = "int", "wrong", "given"
    else:
        kind = f"int{width}"
        condition = "rhi_any(wrong)"
        first = "rhi_uniform(given, wrong)"
    return f"""{_HEAD}void rhi_check({kind} wrong, {kind} given, int limit, global int *faults, int line) {{
    if ({condition} && atomic_cmpxchg((volatile global int *)faults, 0, line) == 0) {{
        faults[1] = {first};
        faults[2] = limit;
    }}
}}"""


# name -> (text, or a function that writes it for a width; names of the functions that it calls)
_FUNCTIONS: Final[dict[str, tuple[str | Callable[[int], str], tuple[str, ...]]]] = {
    "rhi_abs": (
        """FLOAT rhi_abs(FLOAT x) { return fabs(x); }
#INT rhi_abs(INT x) { return max(x, as_INT((UINT)(0) - as_UINT(x))); }""",
        (),
    ),
    # One instruction for vectors, unlike PoCL's own functions.
    "rhi_min": (
        """FLOAT rhi_min(FLOAT x, FLOAT y) { return y < x ? y : x; }
#INT rhi_min(INT x, INT y) { return min(x, y); }
#UINT rhi_min(UINT x, UINT y) { return min(x, y); }""",
        (),
    ),
    "rhi_max": (
        """FLOAT rhi_max(FLOAT x, FLOAT y) { return x < y ? y : x; }
#INT rhi_max(INT x, INT y) { return max(x, y); }
#UINT rhi_max(UINT x, UINT y) { return max(x, y); }""",
        (),
    ),
    # The nearest int, 0 for NaN. Numbers for which OpenCL's conversions are undefined are replaced before
    # them, and their results selected after them.
    "rhi_to_int": (
        """INT rhi_to_int(FLOAT x) {
    FLOAT y = x > -0x1p31f ? x : (FLOAT)-0x1p31f;
    INT r = convert_INT(y < 0x1.fffffep30f ? y : (FLOAT)0x1.fffffep30f);
    return SELECT(SELECT(r, (INT)0x7fffffff, x >= 0x1p31f), (INT)0, x != x);
}""",
        (),
    ),
    "rhi_to_uint": (
        """UINT rhi_to_uint(FLOAT x) {
    FLOAT y = x > 0.0f ? x : (FLOAT)0.0f;
    UINT r = convert_UINT(y < 0x1.fffffep31f ? y : (FLOAT)0x1.fffffep31f);
    return SELECT(r, (UINT)0xffffffffu, x >= 0x1p32f);
}""",
        (),
    ),
    # A division by 0 is one by 1, and so is that of the least int by -1.
    "rhi_divisor": (
        """INT rhi_divisor(INT a, INT b) {
    return SELECT(b, (INT)1, (b == 0) | ((b == -1) & (a == (int)0x80000000)));
}
#UINT rhi_divisor(UINT a, UINT b) { return SELECT(b, (UINT)1, b == 0); }""",
        (),
    ),
    # The sign of the remainder tells whether truncation equals flooring.
    "rhi_floor_divide": (
        """SINT rhi_floor_divide(SINT a, SINT b) {
    int d = rhi_divisor(a, b);
    int q = a / d, r = a - q * d;
    return r != 0 && (r < 0) != (d < 0) ? q - 1 : q;
}
#SUINT rhi_floor_divide(SUINT a, SUINT b) { return a / rhi_divisor(a, b); }
#VINT rhi_floor_divide(VINT a, VINT b) {
    return convert_INT(floor(convert_DOUBLE(a) / convert_DOUBLE(rhi_divisor(a, b))));
}
#VUINT rhi_floor_divide(VUINT a, VUINT b) {
    return convert_UINT(convert_DOUBLE(a) / convert_DOUBLE(rhi_divisor(a, b)));
}""",
        ("rhi_divisor",),
    ),
    "rhi_modulo": (
        """INT rhi_modulo(INT a, INT b) { b = rhi_divisor(a, b); return a - rhi_floor_divide(a, b) * b; }
#UINT rhi_modulo(UINT a, UINT b) { b = rhi_divisor(a, b); return a - rhi_floor_divide(a, b) * b; }""",
        ("rhi_floor_divide",),
    ),
    # Half floats and back, rounding to nearest even: F. Giesen, float_to_half_fast3_rtne and half_to_float.
    "rhi_half_bits": (
        """UINT rhi_half_bits(FLOAT x) {
    UINT sign = as_UINT(x) & 0x80000000u, bits = as_UINT(x) ^ sign;
    UINT small = as_UINT(as_FLOAT(bits) + as_FLOAT((UINT)0x3f000000u)) - 0x3f000000u;
    UINT normal = (bits + 0xc8000fffu + ((bits >> 13u) & 1u)) >> 13u;
    UINT huge = SELECT((UINT)0x7c00u, (UINT)0x7e00u, bits > 0x7f800000u);
    UINT half_ = SELECT(SELECT(normal, small, bits < 0x38800000u), huge, bits >= 0x47800000u);
    return half_ | (sign >> 16u);
}""",
        (),
    ),
    "rhi_half_value": (
        """FLOAT rhi_half_value(UINT bits) {
    UINT moved = (bits & 0x7fffu) << 13u, exponent = moved & 0x0f800000u;
    UINT up = moved + 0x38000000u;
    UINT huge = up + 0x38000000u;
    UINT small = as_UINT(as_FLOAT(up + 0x00800000u) - as_FLOAT((UINT)0x38800000u));
    UINT value = SELECT(SELECT(up, small, exponent == 0u), huge, exponent == 0x0f800000u);
    return as_FLOAT(value | ((bits & 0x8000u) << 16u));
}""",
        (),
    ),
    # The mantissa, m + 1, is in 2/3…4/3; log2(1 + m) / m is a minimax polynomial in relative error. Zero,
    # infinity and NaN are not handled.
    "rhi_fast_log2_finite": (
        """FLOAT rhi_fast_log2_finite(FLOAT x) {
    INT whole = (as_INT(x) - 0x3f2aaaab) & (int)0xff800000;
    FLOAT m = as_FLOAT(as_INT(x) - whole) - 1.0f, s = m * m;
    FLOAT a = fma(m, (FLOAT)-0.221681818f, (FLOAT)0.246864453f), b = fma(m, (FLOAT)-0.236891508f, (FLOAT)0.285581708f);
    FLOAT c = fma(m, (FLOAT)-0.360783726f, (FLOAT)0.480965525f), d = fma(m, (FLOAT)-0.721346617f, (FLOAT)1.44269478f);
    FLOAT r = fma(fma(a, s, b), s * s, fma(c, s, d));
    return fma(r, m, convert_FLOAT(whole) * 1.19209290e-7f);
}""",
        (),
    ),
    "rhi_fast_log2": (
        """FLOAT rhi_fast_log2(FLOAT x) {
    FLOAT r = SELECT(rhi_fast_log2_finite(x), (FLOAT)-INFINITY, x == 0.0f);
    return SELECT(x, r, x < INFINITY);
}""",
        ("rhi_fast_log2_finite",),
    ),
    # The low bits of t are the nearest integer + 127, which shifted up are a power of two: 0 and infinity at
    # the ends.
    "rhi_fast_exp2": (
        """FLOAT rhi_fast_exp2(FLOAT x) {
    x = rhi_min(rhi_max(x, (FLOAT)-127.0f), (FLOAT)128.0f);
    FLOAT t = x + 12583039.0f, f = x - (t - 12583039.0f);
    FLOAT a = fma(f, (FLOAT)1.32764084e-3f, (FLOAT)9.67554096e-3f);
    FLOAT b = fma(f, (FLOAT)5.55071346e-2f, (FLOAT)2.40221202e-1f);
    FLOAT r = fma(fma(a, f * f, b), f * f, fma(f, (FLOAT)6.93146944e-1f, (FLOAT)1.0f));
    return r * as_FLOAT(as_INT(t) << 23);
}""",
        ("rhi_min", "rhi_max"),
    ),
    # Like exp2; log(2) is subtracted in two parts.
    "rhi_fast_exp": (
        """FLOAT rhi_fast_exp(FLOAT x) {
    x = rhi_min(rhi_max(x, (FLOAT)-88.02f), (FLOAT)88.8f);
    FLOAT t = fma(x, (FLOAT)1.44269504f, (FLOAT)12583039.0f), whole = t - 12583039.0f;
    FLOAT f = fma(whole, (FLOAT)-1.42860677e-6f, fma(whole, (FLOAT)-0.693145752f, x));
    FLOAT a = fma(f, (FLOAT)8.31249449e-3f, (FLOAT)4.18901145e-2f);
    FLOAT b = fma(f, (FLOAT)1.66671142e-1f, (FLOAT)4.99992311e-1f);
    FLOAT r = fma(fma(a, f * f, b), f * f, f + 1.0f);
    return r * as_FLOAT(as_INT(t) << 23);
}""",
        ("rhi_min", "rhi_max"),
    ),
    # The logarithm of 0 is replaced by -1e30, so that 0 to a power is 0, 1 or infinity.
    "rhi_fast_pow": (
        """FLOAT rhi_fast_pow(FLOAT x, FLOAT y) {
    FLOAT l = SELECT(rhi_fast_log2_finite(x), (FLOAT)-1e30f, x == 0.0f);
    return rhi_fast_exp2(y * SELECT(x, l, x < INFINITY));
}""",
        ("rhi_fast_log2_finite", "rhi_fast_exp2"),
    ),
    # The machine's estimate y, times the series of (1 - rest) to the power -1/2, unless x is 0 or infinity.
    # With the linear term only, 4 and 8 lanes, whose estimate has 12 bits on Intel's CPUs, were up to 3 units
    # off there.
    "rhi_fast_inversesqrt": (
        """FLOAT rhi_fast_inversesqrt(FLOAT x) {
    FLOAT y = rhi_inversesqrt_estimate(x), rest = fma(-x * y, y, (FLOAT)1.0f);
    FLOAT series = fma(rest, (FLOAT)0.375f, (FLOAT)0.5f);
    return SELECT(y, fma(y * rest, series, y), rest == rest);
}""",
        ("rhi_inversesqrt_estimate",),
    ),
    "rhi_inversesqrt_estimate": (_estimate_text, ()),
    "rhi_uniform": (_uniform_text, ()),
    "rhi_check": (_check_text, ("rhi_uniform",)),
    "rhi_turn": (_range_reduction_text, ("rhi_quarter",)),
    "rhi_sin": (_turn_text("sin", 0), ("rhi_turn",)),
    "rhi_cos": (_turn_text("cos", 1), ("rhi_turn",)),
    "rhi_tan": (_tangent_text, ()),
    "rhi_atan2": ("FLOAT rhi_atan2(FLOAT y, FLOAT x) { return atan2(y, x); }", ()),
    "rhi_pow": (_pow_text, ()),
    **{
        f"rhi_{name}": (f"FLOAT rhi_{name}(FLOAT x) {{ return {name}(x); }}", ())
        for name in _LONG
        if name not in ("sin", "cos", "tan", "atan2", "pow")
    },
    # Sine of -0.8 to 0.8, or cosine, after so many quarter turns: the polynomials of Cephes.
    "rhi_quarter": (
        """FLOAT rhi_quarter(FLOAT r, INT quarter) {
    FLOAT s = r * r;
    FLOAT sine = fma(s, (FLOAT)-1.9515295891e-4f, (FLOAT)8.3321608736e-3f);
    sine = fma(fma(sine, s, (FLOAT)-1.6666654611e-1f) * s, r, r);
    FLOAT cosine = fma(s, (FLOAT)2.443315711e-5f, (FLOAT)-1.388731625e-3f);
    cosine = fma(fma(cosine, s, (FLOAT)4.166664568e-2f), s * s, fma(s, (FLOAT)-0.5f, (FLOAT)1.0f));
    FLOAT value = SELECT(sine, cosine, (quarter & 1) != 0);
    return as_FLOAT(as_INT(value) ^ ((quarter & 2) << 30));
}""",
        (),
    ),
    # Range reduction by quarter turns in three steps: for |x| up to some thousands. The reduced argument is
    # clamped, so that results for larger ones don't exceed 1.
    "rhi_fast_turn": (
        """FLOAT rhi_fast_turn(FLOAT x, int more) {
    FLOAT whole = fma(x, (FLOAT)0.636619772f, (FLOAT)12582912.0f) - 12582912.0f;
    FLOAT r = fma(whole, (FLOAT)4.37113883e-8f, fma(whole, (FLOAT)-1.57079637f, x));
    r = fma(whole, (FLOAT)1.71512489e-15f, r);
    r = rhi_min(rhi_max(r, (FLOAT)-0.8f), (FLOAT)0.8f);
    return rhi_quarter(r, convert_INT(clamp(whole, (FLOAT)-4e6f, (FLOAT)4e6f)) + more);
}""",
        ("rhi_min", "rhi_max", "rhi_quarter"),
    ),
    "rhi_fast_sin": ("FLOAT rhi_fast_sin(FLOAT x) { return rhi_fast_turn(x, 0); }", ("rhi_fast_turn",)),
    "rhi_fast_cos": ("FLOAT rhi_fast_cos(FLOAT x) { return rhi_fast_turn(x, 1); }", ("rhi_fast_turn",)),
}


def functions_in(text: str) -> list[str]:
    """Return the names of the prelude's functions that a kernel needs, each after the functions that it
    calls."""
    names: dict[str, None] = {}

    def add(name: str) -> None:
        for inner in _FUNCTIONS[name][1]:
            add(inner)
        names[name] = None

    for name in _FUNCTIONS:
        if f"{name}(" in text:
            add(name)
    return list(names)


def function_text(name: str, width: int, calls: int = 1) -> str:
    """Return the text of a function, for scalars and for vectors of `width`; `calls`: how often it is
    called."""
    texts = []
    head = _CALLED if calls > 1 and name.removeprefix("rhi_") in _LONG else _HEAD
    for lanes in sorted({1, width}):
        text = _FUNCTIONS[name][0]
        if not isinstance(text, str):
            texts.append(text(lanes).replace("HEAD", head))
            continue
        for body in text.split("\n#"):
            wide = body.startswith("V")
            if body[:2] in ("SI", "SU", "VI", "VU"):
                if wide != (lanes > 1):
                    continue
                body = re.sub(r"\b[SV](U?INT)\b", r"\1", body)
            texts.append(head + specialise(body, lanes))
    return "\n".join(texts)


SCALAR_SELECT: Final = """#pragma clang diagnostic ignored "-Wparentheses-equality"
#define rhi_select(b, a, c) ((c) ? (a) : (b))"""


QUAD_NAMES: Final = ("rhi_ddx(", "rhi_ddy(", "rhi_quads(")

# 16 lanes are 4 by 4 pixels, lane = x + 4 y; a quad is 2 by 2 pixels. Each row and column has its own
# difference.
QUADS: Final = f"""{_HEAD}float16 rhi_ddx(float16 v) {{ return v.s1133557799bbddff - v.s0022446688aaccee; }}
{_HEAD}float16 rhi_ddy(float16 v) {{ return v.s45674567cdefcdef - v.s0123012389ab89ab; }}
{_HEAD}int16 rhi_quads(int16 mask) {{
    mask |= mask.s1032547698badcfe;
    return mask | mask.s45670123cdef89ab;
}}"""


def any_text(width: int) -> str:
    """Write the tests for any and all lanes of a mask; the reduction is one instruction where the compiler
    has it."""
    return f"""{_HEAD}int rhi_any(int{width} mask) {{
#if __has_builtin(__builtin_reduce_min)
    return __builtin_reduce_min(mask) != 0;
#else
    return any(mask);
#endif
}}
{_HEAD}int rhi_all(int{width} mask) {{ return !rhi_any(~mask); }}"""


def lanes_text(width: int) -> str:
    """Write the vector of lane numbers, and the type of a vector of words at any address."""
    numbers = ", ".join(map(str, range(width)))
    words = f"typedef uint{width} rhi_words __attribute__((aligned(4)));"
    return f"{words}\n#define RHI_LANES ((int{width})({numbers}))"


def gather_text(space: str, width: int) -> str:
    """Write the gather of a word per lane."""
    parts = ", ".join(per_lane(width, "p[i.s@]"))
    return f"{_HEAD}uint{width} rhi_gather({space} const uint *p, int{width} i) {{ return (uint{width})({parts}); }}"


def load_text(
    name: str, space: str, width: int, stride: int, offset: int, scale: int = 1, has_steps: bool = False
) -> str:
    """Write the load of the words `first * scale + lane * stride + offset`; the elements have `scale` words.

    It uses vector loads and a transpose, and loads word by word near the ends of the buffer. A lane outside
    gets the word of the nearest element.

    Args:
        has_steps: whether the function gets each lane's distance from the first, since lanes may not be
            consecutive.
    """
    start = f"first * {scale}" if scale > 1 else "first"
    registers = [f"*({space} const rhi_words *)(p + {start} + {width * k})" for k in range(stride)]
    declared = ", ".join(f"r{k} = {text}" for k, text in enumerate(registers))
    picks = [lane * stride + offset for lane in range(width)]
    parts = ", ".join(f"r{element // width}.s{HEX[element % width]}" for element in picks)
    fast = f"return {registers[0]};"
    if stride > 1:
        fast = f"uint{width} {declared}; return (uint{width})({parts});"
    steps = "steps" if has_steps else "RHI_LANES"
    inner, outer = ("", f" * {scale} + {offset}") if scale > 1 else (f" + {offset}", "")
    slow = f"clamp(first + {steps} * {stride // scale}{inner}, (int{width})0, (int{width})(count - 1)){outer}"
    extra_parameter, together = (
        (f", int{width} steps", " && rhi_all(steps == RHI_LANES)") if has_steps else ("", "")
    )
    return f"""{_HEAD}uint{width} {name}({space} const uint *p, int first, int count{extra_parameter}) {{
    if (first >= 0 && first <= count - {width * stride // scale}{together}) {{ {fast} }}
    return rhi_gather(p, {slow});
}}"""


def store_text(name: str, space: str, width: int, count: int) -> str:
    """Write the store of `count` consecutive words per lane: transposed vector stores if all lanes are
    active."""
    values = ", ".join(f"uint{width} v{k}" for k in range(count))
    fast = []
    for k in range(count):
        elements = [divmod(k * width + lane, count) for lane in range(width)]
        parts = ", ".join(f"v{word}.s{HEX[element]}" for element, word in elements)
        vector = f"(uint{width})({parts})" if count > 1 else "v0"
        fast.append(f"*({space} rhi_words *)(p + first + {width * k}) = {vector};")
    slow = []
    for lane in range(width):
        sets = " ".join(f"p[first + {lane * count + k}] = v{k}.s{HEX[lane]};" for k in range(count))
        slow.append(f"    if (mask.s{HEX[lane]}) {{ {sets} }}")
    body = "\n".join(slow)
    return f"""{_HEAD}void {name}({space} uint *p, int first, int{width} mask, {values}) {{
    if (rhi_all(mask)) {{ {" ".join(fast)} return; }}
{body}
}}"""


def scatter_text(name: str, space: str, width: int, count: int) -> str:
    """Write the scatter of `count` words per active lane, at any addresses, in the order of the lanes."""
    values = ", ".join(f"uint{width} v{k}" for k in range(count))
    sets = " ".join(f"p[i.s@ + {k}] = v{k}.s@;" for k in range(count))
    body = "\n".join(per_lane(width, f"    if (mask.s@) {{ {sets} }}"))
    return f"{_HEAD}void {name}({space} uint *p, int{width} i, int{width} mask, {values}) {{\n{body}\n}}"


def last_text(width: int) -> str:
    """Write the selection of the last active lane's value."""
    lines = reversed(per_lane(width, "    if (mask.s@) return v.s@;"))
    return (
        f"{_HEAD}uint rhi_last(uint{width} v, int{width} mask) {{\n" + "\n".join(lines) + "\n    return 0;\n}"
    )


def atomic_text(name: str, space: str, width: int, operation: str, kind: str) -> str:
    """Write an atomic operation for each active lane, in order."""
    exchange = operation == "cmpxchg"
    values = f"{kind}{width} v" + (f", {kind}{width} w" if exchange else "")
    second = ", w.s@" if exchange else ""
    call = f"atomic_{operation}((volatile {space} {kind} *)p + i.s@, v.s@{second})"
    body = "\n".join(per_lane(width, f"    if (mask.s@) old.s@ = {call};"))
    return (
        f"{_HEAD}{kind}{width} {name}({space} uint *p, int{width} i, int{width} mask, {values}) {{\n"
        f"    {kind}{width} old = 0;\n{body}\n    return old;\n}}"
    )


def atomic_add_text(name: str, space: str, width: int, kind: str) -> str:
    """Write an atomic addition of all lanes to one address.

    The sum is added at once; the old value of each lane follows from the sums before it.
    """
    body = "\n".join(per_lane(width, "    before.s@ = sum; sum += v.s@;"))
    return f"""{_HEAD}{kind}{width} {name}({space} uint *p, int i, int{width} mask, {kind}{width} v) {{
    {kind}{width} before; {kind} sum = 0;
    v &= as_{kind}{width}(mask);
{body}
    return before + atomic_add((volatile {space} {kind} *)p + i, sum);
}}"""
