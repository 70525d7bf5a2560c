"""Declarations of OpenCL C's types and functions, which replace PoCL's header in each program.

- PoCL puts Clang's `opencl-c.h` in front of each program: 900 KB of text, which it preprocesses before it
  looks into its cache, and parses when it compiles. That is most of the time in which a cached program is
  loaded. The header is left out if `GUARD` is defined; the program then begins with the declarations of what
  occurs in it.
- Declarations are those of the header, word for word where it matters (names, types, attributes), so the same
  machine code results. A test compares them with the header.
- A program that contains a name of `_ELSEWHERE`, which rhi itself doesn't use, gets the header.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Final

GUARD: Final = "-D_OPENCL_H_"
"""Build option: the header isn't read."""
_WIDTHS: Final = ("", "2", "3", "4", "8", "16")
_FLOATS: Final = ("float", "double")
_INTEGERS: Final = ("char", "uchar", "short", "ushort", "int", "uint", "long", "ulong")
_NUMBERS: Final = (*_INTEGERS, *_FLOATS)
_SIGNED: Final = {
    "char": "char",
    "uchar": "char",
    "short": "short",
    "ushort": "short",
    "int": "int",
    "uint": "int",
    "long": "long",
    "ulong": "long",
    "float": "int",
    "double": "long",
}
"""The signed integer of an element's size."""
_SPACES: Final = ("global", "local", "private")
_PURE: Final = "__attribute__((overloadable, const))"
_READS: Final = "__attribute__((overloadable, pure))"
_CALLED: Final = "__attribute__((overloadable))"
_CONVERGENT: Final = "__attribute__((overloadable, convergent))"

# Names -> element types, and the types of the result and of the parameters: T is a scalar or a vector, E one
# of its elements, S and U a signed or an unsigned integer of the same size as T, and B what a comparison of T
# results in. Forms with a parameter E exist for vectors.
_FORMS: Final[dict[str, tuple[tuple[str, ...], tuple[str, ...]]]] = {
    "acos acosh acospi asin asinh asinpi atan atanh atanpi cbrt ceil cos cosh cospi erf erfc exp exp10 exp2 "
    "expm1 fabs "
    "floor lgamma log log10 log1p log2 logb rint round rsqrt sin sinh sinpi sqrt tan tanh tanpi tgamma trunc "
    "sign "
    "degrees radians": (_FLOATS, ("T T",)),
    "atan2 atan2pi copysign fdim fmod hypot maxmag minmag nextafter pow powr remainder": (
        _FLOATS,
        ("T T T",),
    ),
    "fma mad": (_FLOATS, ("T T T T",)),
    "fmin fmax": (_FLOATS, ("T T T", "T T E")),
    "mix": (_FLOATS, ("T T T T", "T T T E")),
    "step": (_FLOATS, ("T T T", "T E T")),
    "smoothstep": (_FLOATS, ("T T T T", "T E E T")),
    "native_cos native_exp native_exp10 native_exp2 native_log native_log10 native_log2 native_recip "
    "native_rsqrt "
    "native_sin native_sqrt native_tan": (("float",), ("T T",)),
    "native_divide native_powr": (("float",), ("T T T",)),
    "isfinite isinf isnan isnormal signbit": (_FLOATS, ("B T",)),
    "isequal isgreater isgreaterequal isless islessequal islessgreater isnotequal isordered isunordered": (
        _FLOATS,
        ("B T T",),
    ),
    "normalize": (_FLOATS, ("T T",)),
    "length": (_FLOATS, ("E T",)),
    "dot": (_FLOATS, ("E T T",)),
    "min max": (_NUMBERS, ("T T T", "T T E")),
    "clamp": (_NUMBERS, ("T T T T", "T T E E")),
    "abs": (_INTEGERS, ("U T",)),
    "abs_diff": (_INTEGERS, ("U T T",)),
    "add_sat hadd mul_hi rhadd rotate sub_sat": (_INTEGERS, ("T T T",)),
    "mad_hi mad_sat": (_INTEGERS, ("T T T T",)),
    "clz popcount": (_INTEGERS, ("T T",)),
    "mul24": (("int", "uint"), ("T T T",)),
    "mad24": (("int", "uint"), ("T T T T",)),
    "any all": (("char", "short", "int", "long"), ("int T",)),
    "bitselect": (_NUMBERS, ("T T T T",)),
    "select": (_NUMBERS, ("T T T S", "T T T U")),
}
_ATOMICS: Final = {
    "atomic_inc atomic_dec": 0,
    "atomic_add atomic_and atomic_max atomic_min atomic_or atomic_sub atomic_xchg atomic_xor": 1,
    "atomic_cmpxchg": 2,
}
"""Atomic functions, each with its number of operands besides the address."""
_SINGLE: Final = {
    "get_work_dim": f"uint {_PURE} get_work_dim(void)",
    **{
        name: f"size_t {_PURE} {name}(uint)"
        for name in (
            "get_global_id",
            "get_global_offset",
            "get_global_size",
            "get_group_id",
            "get_local_id",
            "get_local_size",
            "get_num_groups",
        )
    },
    "barrier": f"void {_CONVERGENT} barrier(cl_mem_fence_flags)",
    **{
        name: f"void {_CALLED} {name}(cl_mem_fence_flags)"
        for name in ("mem_fence", "read_mem_fence", "write_mem_fence")
    },
}
_MACROS: Final = {
    "INFINITY": "(__builtin_inff())",
    "HUGE_VALF": "(__builtin_huge_valf())",
    "HUGE_VAL": "(__builtin_huge_val())",
    "NAN": "__builtin_astype(2147483647, float)",
    "NULL": "((void*)0)",
    "MAXFLOAT": "0x1.fffffep127f",
    "CLK_LOCAL_MEM_FENCE": "0x01",
    "CLK_GLOBAL_MEM_FENCE": "0x02",
    "CHAR_BIT": "8",
    "SCHAR_MAX": "127",
    "SCHAR_MIN": "(-128)",
    "UCHAR_MAX": "255",
    "CHAR_MAX": "127",
    "CHAR_MIN": "(-128)",
    "USHRT_MAX": "65535",
    "SHRT_MAX": "32767",
    "SHRT_MIN": "(-32768)",
    "UINT_MAX": "0xffffffff",
    "INT_MAX": "2147483647",
    "INT_MIN": "(-2147483647-1)",
    "ULONG_MAX": "0xffffffffffffffffUL",
    "LONG_MAX": "0x7fffffffffffffffL",
    "LONG_MIN": "(-0x7fffffffffffffffL-1)",
}
_ELSEWHERE: Final = re.compile(
    r"(?:(?:read|write)_image|get_image_|async_|atom_|atomic_(?:compare|ex|f|init|l|st|work|\w+_t$)|sub_group_|work_group_"
    r"|get_(?:default|enq|fence|\w+_linear|kernel_(?!exec)|max_sub|num_sub|sub)|vload(?:a_|_half\d)|vstore(?:a_|_half(?!(?:_rte)?$))"
    r"|half(?:\d|_(?:cos|divide|exp|log|powr|recip|rsqrt|sin|sqrt|tan))|as_(?:half|size_t|ptr|u?intptr)|kernel_e|convert_half|fast_|bit_|bitfield_|dot_|enqueue_|ndrange_|intel_|arm_|amd_|image\dd|capture_"
    r"|is_valid_|reserve_|clk_|CLK_(?!LOCAL_MEM|GLOBAL_MEM)|CL_|MAX_WORK_DIM|(?:FLT|DBL|HALF|M|FP|ATOMIC)_(?!CONTRACT)|memory_(?:order|scope))"
    r"|(?:cross|ctz|distance|fract|frexp|ilogb|ldexp|lgamma_r|modf|nan|pown|prefetch|printf|remquo|rootn|shuffle2?|sincos|upsample"
    r"|vec_step|wait_group_events|\w+_event(?:_\w+)?|\w*_pipe\w*|queue_t|(?:u?intptr|ptrdiff)_t)$"
)
"""Names that only the driver's header declares."""
_SEPARATORS: Final = {code: " " for code in range(128) if not (chr(code).isalnum() or chr(code) == "_")}
_CONVERSION: Final = re.compile(rf"convert_({'|'.join(_NUMBERS)})(|2|3|4|8|16)(?:_sat)?(?:_rt[enpz])?")
_CAST: Final = re.compile(rf"as_((?:{'|'.join(_NUMBERS)})(?:|2|3|4|8|16))")
_LOAD: Final = re.compile(r"vload(?:(2|3|4|8|16)|_half)")
_STORE: Final = re.compile(r"vstore(?:(2|3|4|8|16)|_half(?:_rte)?)")
_FUNCTION_FORMS: Final = {
    name: (elements, forms) for names, (elements, forms) in _FORMS.items() for name in names.split()
}
_COUNTS: Final = {name: count for names, count in _ATOMICS.items() for name in names.split()}


def declare(source: str) -> str | None:
    """Return the declarations of what occurs in a program without comments, or None if it needs the
    header."""
    words = set(source.translate(_SEPARATORS).split())
    lines: list[str] = []
    for declaration in map(_declare_name, sorted(words)):
        if declaration is None:
            return None
        lines += declaration
    # Values of these types exist only where they are named, and each adds a tenth of the declarations.
    for kind in ("char", "short"):
        if not any(kind in word for word in words):
            lines = [line for line in lines if kind not in line]
    return "\n".join((_TYPES, *lines, ""))


@lru_cache(maxsize=8192)
def _declare_name(name: str) -> tuple[str, ...] | None:
    """Return the declarations of a name, or None if only the header has them."""
    if _ELSEWHERE.match(name):
        return None
    if name in _MACROS:
        return (f"#define {name} {_MACROS[name]}",)
    if match := _CAST.fullmatch(name):
        return (f"#define {name}(x) __builtin_astype((x), {match[1]})",)
    return tuple(f"{declaration};" for declaration in declare_function(name))


def declare_function(name: str) -> Iterator[str]:
    """Return the declarations of a function; none for other names."""
    if name in _SINGLE:
        yield _SINGLE[name]
    elif name in _FUNCTION_FORMS:
        elements, forms = _FUNCTION_FORMS[name]
        for element, form in product(elements, forms):
            for width in _WIDTHS:
                if not width and "E" in form[1:]:
                    continue
                signed = _SIGNED[element]
                types = {
                    "T": element + width,
                    "E": element,
                    "S": signed + width,
                    "U": f"u{signed}{width}",
                    "B": signed + width if width else "int",
                    "int": "int",
                }
                result, *parameters = (types[letter] for letter in form.split())
                yield f"{result} {_PURE} {name}({', '.join(parameters)})"
    elif name in _COUNTS:
        for space, kind in product(_SPACES[:2], ("int", "uint", "float")):
            if kind != "float" or name == "atomic_xchg":
                values = f", {kind}" * _COUNTS[name]
                yield f"{kind} {_CALLED} {name}(volatile {space} {kind} *{values})"
    elif match := _CONVERSION.fullmatch(name):
        for element in _NUMBERS:
            yield f"{match[1]}{match[2]} {_PURE} {name}({element}{match[2]})"
    elif match := _LOAD.fullmatch(name):
        for element, space in product(_NUMBERS if match[1] else ("half",), (*_SPACES, "constant")):
            result = f"{element}{match[1]}" if match[1] else "float"
            yield f"{result} {_READS} {name}(size_t, const {space} {element} *)"
    elif match := _STORE.fullmatch(name):
        for element, space in product(_NUMBERS if match[1] else _FLOATS, _SPACES):
            memory = element if match[1] else "half"
            yield f"void {_CALLED} {name}({element}{match[1] or ''}, size_t, {space} {memory} *)"


_TYPES: Final = "\n".join(
    (
        *(f"typedef unsigned {name} u{name};" for name in ("char", "short", "int", "long")),
        "typedef __SIZE_TYPE__ size_t;",
        *(
            f"typedef {name} {name}{width} __attribute__((ext_vector_type({width})));"
            for name, width in product(_NUMBERS, _WIDTHS[1:])
        ),
        "typedef uint cl_mem_fence_flags;",
    )
)
