"""Functions that OpenCL lane code calls, written once for every width: FLOAT, INT, UINT stand for scalars or vectors.

Memory functions are made for the space, stride and operation that a kernel uses.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

__rhi_internal__ = True

HEX: Final = "0123456789abcdef"

_HEAD: Final = "inline __attribute__((overloadable, always_inline)) "


def _estimate_text(width: int) -> str:
    """1 / sqrt(x) to 11 bits at least, by the instruction of the machine; elsewhere as OpenCL has it."""
    suffix = str(width) if width > 1 else ""
    head = f"{_HEAD}float{suffix} rhi_inversesqrt_estimate(float{suffix} x)"
    ways = {
        16: """#ifdef __AVX512F__
HEAD { return __builtin_ia32_rsqrt14ps512_mask(x, (float16)(0.0f), (ushort)0xffff); }
#elif defined(__AVX__)
HEAD { return (float16)(__builtin_ia32_rsqrtps256(x.lo), __builtin_ia32_rsqrtps256(x.hi)); }""",
        8: "#ifdef __AVX__\nHEAD { return __builtin_ia32_rsqrtps256(x); }",
        4: "#ifdef __SSE__\nHEAD { return __builtin_ia32_rsqrtps(x); }",
    }
    otherwise = f"{head} {{ return native_rsqrt(x); }}"
    if width not in ways:
        return otherwise
    return f"{ways[width].replace('HEAD', head)}\n#else\n{otherwise}\n#endif"


def _turn_text(function: str) -> Callable[[int], str]:
    """sin, cos or tan. PoCL's vector forms (3.1) are wrong by .008 in all lanes if one is above 1e7: those go alone."""

    def text(width: int) -> str:
        if width == 1:
            return f"{_HEAD}float rhi_{function}(float x) {{ return {function}(x); }}"
        alone = " ".join(f"if (far.s{HEX[i]}) r.s{HEX[i]} = {function}(x.s{HEX[i]});" for i in range(width))
        return f"""{_HEAD}float{width} rhi_{function}(float{width} x) {{
    int{width} far = fabs(x) > 1e5f;
    float{width} r = {function}(select(x, (float{width})(0.0f), far));
    if (rhi_any(far)) {{ {alone} }}
    return r;
}}"""

    return text


def _uniform_text(width: int) -> str:
    """The value of the first lane that takes part, of the first of all where the mask is a scalar."""
    if width == 1:
        return ""
    texts = []
    for kind in ("float", "int", "uint"):
        lines = [f"    if (mask.s{HEX[lane]}) return v.s{HEX[lane]};" for lane in range(1, width)]
        texts += [
            f"{_HEAD}{kind} rhi_uniform({kind}{width} v, int all) {{ return v.s0; }}",
            f"{_HEAD}{kind} rhi_uniform({kind}{width} v, int{width} mask) {{",
            "    if (mask.s0) return v.s0;",
            *lines,
            "    return v.s0;\n}",
        ]
    return "\n".join(texts)


def _check_text(width: int) -> str:
    """Writes down the first fault of a launch: its line in the text, and what was given instead of what."""
    if width == 1:
        kind, condition, first = "int", "wrong", "given"
    else:
        kind, condition, first = f"int{width}", "rhi_any(wrong)", "rhi_uniform(given, wrong)"
    return f"""{_HEAD}void rhi_check({kind} wrong, {kind} given, int limit, global int *faults, int line) {{
    if ({condition} && atomic_cmpxchg((volatile global int *)faults, 0, line) == 0) {{
        faults[1] = {first};
        faults[2] = limit;
    }}
}}"""


# name -> (text, or what writes it for a width; names it calls)
_FUNCTIONS: Final[dict[str, tuple[str | Callable[[int], str], tuple[str, ...]]]] = {
    "rhi_abs": (
        """FLOAT rhi_abs(FLOAT x) { return fabs(x); }
#INT rhi_abs(INT x) { return as_INT(abs(x)); }""",
        (),
    ),
    # One instruction for vectors; PoCL's own are not.
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
    # The remainder's sign says whether truncating was flooring. Division never traps: / 0 and INT_MIN / -1 by 1.
    "rhi_floor_divide": (
        """SINT rhi_floor_divide(SINT a, SINT b) {
    int d = b == 0 || (b == -1 && a == (int)0x80000000) ? 1 : b;
    int q = a / d, r = a - q * d;
    return r != 0 && (r < 0) != (d < 0) ? q - 1 : q;
}
#SUINT rhi_floor_divide(SUINT a, SUINT b) { return a / (b == 0 ? 1u : b); }
#VINT rhi_floor_divide(VINT a, VINT b) {
    return convert_INT(floor(convert_DOUBLE(a) / convert_DOUBLE(select(b, (INT)1, b == 0))));
}
#VUINT rhi_floor_divide(VUINT a, VUINT b) {
    return convert_UINT(convert_DOUBLE(a) / convert_DOUBLE(select(b, (UINT)1, b == 0)));
}""",
        (),
    ),
    "rhi_modulo": (
        """INT rhi_modulo(INT a, INT b) { return a - rhi_floor_divide(a, b) * b; }
#UINT rhi_modulo(UINT a, UINT b) { return a - rhi_floor_divide(a, b) * b; }""",
        ("rhi_floor_divide",),
    ),
    # To half floats and back, halves to even: F. Giesen, float_to_half_fast3_rtne and half_to_float.
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
    # The mantissa, m + 1, in 2/3…4/3; log2(1 + m) / m by a polynomial whose greatest relative error is least. Zero,
    # infinity and what is not a number aside.
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
    # t's low bits are the nearest whole number + 127, which shifted up are a power of two: 0 and infinity at the ends.
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
    # As exp2, log(2) taken off in two parts.
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
    # 0 to a power is 0, 1 or infinity, as its logarithm were that of 1e-38 to the power 1e28.
    "rhi_fast_pow": (
        """FLOAT rhi_fast_pow(FLOAT x, FLOAT y) {
    FLOAT l = SELECT(rhi_fast_log2_finite(x), (FLOAT)-1e30f, x == 0.0f);
    return rhi_fast_exp2(y * SELECT(x, l, x < INFINITY));
}""",
        ("rhi_fast_log2_finite", "rhi_fast_exp2"),
    ),
    # The machine's estimate and one step of Newton's method, which 0 and infinity do without.
    "rhi_fast_inversesqrt": (
        """FLOAT rhi_fast_inversesqrt(FLOAT x) {
    FLOAT y = rhi_inversesqrt_estimate(x), rest = fma(-x * y, y, (FLOAT)1.0f);
    return SELECT(y, fma(y * 0.5f, rest, y), rest == rest);
}""",
        ("rhi_inversesqrt_estimate",),
    ),
    "rhi_inversesqrt_estimate": (_estimate_text, ()),
    "rhi_uniform": (_uniform_text, ()),
    "rhi_check": (_check_text, ("rhi_uniform",)),
    "rhi_sin": (_turn_text("sin"), ()),
    "rhi_cos": (_turn_text("cos"), ()),
    "rhi_tan": (_turn_text("tan"), ()),
    # Quarter turns off in three steps, then Cephes' polynomials: for |x| up to some thousands. What is left of larger
    # ones is limited, so that results are never above 1.
    "rhi_fast_turn": (
        """FLOAT rhi_fast_turn(FLOAT x, int more) {
    FLOAT whole = fma(x, (FLOAT)0.636619772f, (FLOAT)12582912.0f) - 12582912.0f;
    FLOAT r = fma(whole, (FLOAT)4.37113883e-8f, fma(whole, (FLOAT)-1.57079637f, x));
    r = fma(whole, (FLOAT)1.71512489e-15f, r);
    r = rhi_min(rhi_max(r, (FLOAT)-0.8f), (FLOAT)0.8f);
    FLOAT s = r * r;
    INT quarter = convert_INT(clamp(whole, (FLOAT)-4e6f, (FLOAT)4e6f)) + more;
    FLOAT sine = fma(s, (FLOAT)-1.9515295891e-4f, (FLOAT)8.3321608736e-3f);
    sine = fma(fma(sine, s, (FLOAT)-1.6666654611e-1f) * s, r, r);
    FLOAT cosine = fma(s, (FLOAT)2.443315711e-5f, (FLOAT)-1.388731625e-3f);
    cosine = fma(fma(cosine, s, (FLOAT)4.166664568e-2f), s * s, fma(s, (FLOAT)-0.5f, (FLOAT)1.0f));
    FLOAT value = SELECT(sine, cosine, (quarter & 1) != 0);
    return as_FLOAT(as_INT(value) ^ ((quarter & 2) << 30));
}""",
        ("rhi_min", "rhi_max"),
    ),
    "rhi_fast_sin": ("FLOAT rhi_fast_sin(FLOAT x) { return rhi_fast_turn(x, 0); }", ("rhi_fast_turn",)),
    "rhi_fast_cos": ("FLOAT rhi_fast_cos(FLOAT x) { return rhi_fast_turn(x, 1); }", ("rhi_fast_turn",)),
}


def functions_in(text: str) -> list[str]:
    """The prelude's functions that a kernel calls, those that they call first."""
    found: dict[str, None] = {}

    def add(name: str) -> None:
        for inner in _FUNCTIONS[name][1]:
            add(inner)
        found[name] = None

    for name in _FUNCTIONS:
        if f"{name}(" in text:
            add(name)
    return list(found)


def function_text(name: str, width: int) -> str:
    """A function for scalars, and for vectors of `width`."""
    texts = []
    for lanes in sorted({1, width}):
        text = _FUNCTIONS[name][0]
        if not isinstance(text, str):
            texts.append(text(lanes))
            continue
        for body in text.split("\n#"):
            wide = body.startswith("V")
            if body[:2] in ("SI", "SU", "VI", "VU"):
                if wide != (lanes > 1):
                    continue
                body = body[1:].replace("(SINT", "(INT").replace(" SINT", " INT").replace("(VINT", "(INT")
                body = body.replace(" VINT", " INT").replace("(SUINT", "(UINT").replace(" SUINT", " UINT")
                body = body.replace("(VUINT", "(UINT").replace(" VUINT", " UINT")
            texts.append(_HEAD + _sized(body, lanes))
    return "\n".join(texts)


def _sized(body: str, lanes: int) -> str:
    suffix = "" if lanes == 1 else str(lanes)
    body = body.replace("SELECT(", "rhi_select(" if lanes == 1 else "select(")
    return (
        body.replace("UINT", f"uint{suffix}")
        .replace("INT", f"int{suffix}")
        .replace("FLOAT", f"float{suffix}")
        .replace("DOUBLE", f"double{suffix}")
    )


SCALAR_SELECT: Final = """#pragma clang diagnostic ignored "-Wparentheses-equality"
#define rhi_select(b, a, c) ((c) ? (a) : (b))"""


QUAD_NAMES: Final = ("rhi_ddx(", "rhi_ddy(", "rhi_quads(")

# 16 lanes are 4 by 4 pixels, lane = x + 4 y; quads are 2 by 2 of them. Each row and column has its own difference.
QUADS: Final = f"""{_HEAD}float16 rhi_ddx(float16 v) {{ return v.s1133557799bbddff - v.s0022446688aaccee; }}
{_HEAD}float16 rhi_ddy(float16 v) {{ return v.s45674567cdefcdef - v.s0123012389ab89ab; }}
{_HEAD}int16 rhi_quads(int16 mask) {{
    mask |= mask.s1032547698badcfe;
    return mask | mask.s45670123cdef89ab;
}}"""


def any_text(width: int) -> str:
    """Whether a mask has a lane. The reduction compiles to one instruction where the compiler has it."""
    return f"""{_HEAD}int rhi_any(int{width} mask) {{
#if __has_builtin(__builtin_reduce_min)
    return __builtin_reduce_min(mask) != 0;
#else
    return any(mask);
#endif
}}
{_HEAD}int rhi_all(int{width} mask) {{ return !rhi_any(~mask); }}"""


def lanes_text(width: int) -> str:
    """The lanes' numbers, and words that lie side by side at any address."""
    numbers = ", ".join(map(str, range(width)))
    words = f"typedef uint{width} rhi_words __attribute__((aligned(4)));"
    return f"{words}\n#define RHI_LANES ((int{width})({numbers}))"


def gather_text(space: str, width: int) -> str:
    """A word for each lane."""
    parts = ", ".join(f"p[i.s{HEX[lane]}]" for lane in range(width))
    return f"{_HEAD}uint{width} rhi_gather({space} const uint *p, int{width} i) {{ return (uint{width})({parts}); }}"


def load_text(name: str, space: str, width: int, stride: int, offset: int, has_steps: bool = False) -> str:
    """Words `first + lane * stride + offset`: vector loads and a transpose, or one by one near the buffer's ends.

    `has_steps`: it is told how far each lane lies behind the first, and may not find them side by side.
    """
    registers = [f"*({space} const rhi_words *)(p + first + {width * k})" for k in range(stride)]
    declared = ", ".join(f"r{k} = {text}" for k, text in enumerate(registers))
    picks = [lane * stride + offset for lane in range(width)]
    parts = ", ".join(f"r{place // width}.s{HEX[place % width]}" for place in picks)
    fast = f"return {registers[0]};"
    if stride > 1:
        fast = f"uint{width} {declared}; return (uint{width})({parts});"
    steps = "steps" if has_steps else "RHI_LANES"
    slow = f"clamp(first + {steps} * {stride} + {offset}, (int{width})0, (int{width})(words - 1))"
    given, together = (f", int{width} steps", " && rhi_all(steps == RHI_LANES)") if has_steps else ("", "")
    return f"""{_HEAD}uint{width} {name}({space} const uint *p, int first, int words{given}) {{
    if (first >= 0 && first <= words - {width * stride}{together}) {{ {fast} }}
    return rhi_gather(p, {slow});
}}"""


def store_text(name: str, space: str, width: int, count: int) -> str:
    """`count` words for each lane, side by side in memory: transposed vector stores if all lanes take part."""
    values = ", ".join(f"uint{width} v{k}" for k in range(count))
    fast = []
    for k in range(count):
        places = [divmod(k * width + lane, count) for lane in range(width)]
        parts = ", ".join(f"v{word}.s{HEX[element]}" for element, word in places)
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
    """`count` words for each lane that takes part, at any addresses, in the lanes' order."""
    values = ", ".join(f"uint{width} v{k}" for k in range(count))
    lines = []
    for lane in range(width):
        at = HEX[lane]
        sets = " ".join(f"p[i.s{at} + {k}] = v{k}.s{at};" for k in range(count))
        lines.append(f"    if (mask.s{at}) {{ {sets} }}")
    body = "\n".join(lines)
    return f"{_HEAD}void {name}({space} uint *p, int{width} i, int{width} mask, {values}) {{\n{body}\n}}"


def last_text(width: int) -> str:
    """The value of the last lane that takes part."""
    lines = [f"    if (mask.s{HEX[lane]}) return v.s{HEX[lane]};" for lane in reversed(range(width))]
    return (
        f"{_HEAD}uint rhi_last(uint{width} v, int{width} mask) {{\n" + "\n".join(lines) + "\n    return 0;\n}"
    )


def atomic_text(name: str, space: str, width: int, operation: str, kind: str) -> str:
    """An atomic for each lane that takes part, in order."""
    exchange = operation == "cmpxchg"
    values = f"{kind}{width} v" + (f", {kind}{width} w" if exchange else "")
    lines = []
    for lane in range(width):
        at = HEX[lane]
        second = f", w.s{at}" if exchange else ""
        call = f"atomic_{operation}((volatile {space} {kind} *)p + i.s{at}, v.s{at}{second})"
        lines.append(f"    if (mask.s{at}) old.s{at} = {call};")
    body = "\n".join(lines)
    return (
        f"{_HEAD}{kind}{width} {name}({space} uint *p, int{width} i, int{width} mask, {values}) {{\n"
        f"    {kind}{width} old = 0;\n{body}\n    return old;\n}}"
    )


def atomic_add_text(name: str, space: str, width: int, kind: str) -> str:
    """Adds to one address: the lanes' sum at once, each lane's old value from the sums before it."""
    lines = [f"    before.s{HEX[lane]} = sum; sum += v.s{HEX[lane]};" for lane in range(width)]
    body = "\n".join(lines)
    return f"""{_HEAD}{kind}{width} {name}({space} uint *p, int i, int{width} mask, {kind}{width} v) {{
    {kind}{width} before; {kind} sum = 0;
    v &= as_{kind}{width}(mask);
{body}
    return before + atomic_add((volatile {space} {kind} *)p + i, sum);
}}"""
