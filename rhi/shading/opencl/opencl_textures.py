"""Textures and images in OpenCL lane code: the functions of `textures.cl`, written for the width of a kernel.

- A texture is described by words in memory (sizes, format, filters, wraps; `rhi.shading.ir.texture_words`).
  They are uniform over the lanes: branches on them are real, and the text of a kernel doesn't depend on the
  bound textures.
- Functions aren't inlined, so that a kernel contains each of them once however often it samples; except loads
  of texels of one float, such as depth, which take less time than a call.
- PoCL copies a kernel's functions once for each chain of calls that leads to them, and a chain may leave out
  functions between its ends. So each link more doubles their number, and functions with one or two callers are
  inlined in quick kernels too (`RHI_FUSED`).
- Two adjacent texels are one load, and so is a row of single floats; those of a whole block of pixels are a
  few (`blocks.cl`). Lanes that need different mip levels are served level by level.
"""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Iterable
from functools import cache, reduce
from typing import Final, NamedTuple

from rhi.contract.descriptors import TextureKind
from rhi.shading.ir.texture_words import enumerations
from rhi.shading.language.builtins import Precision
from rhi.shading.opencl import prelude
from rhi.shading.opencl.prelude import per_lane, specialise

_HEAD: Final = """typedef global const uchar *rhi_texture;
typedef global uchar *rhi_image;
typedef global const int *rhi_description;
typedef ulong rhi_wide __attribute__((aligned(4)));
#define rhi_both(a, b) ((a) & (b))
#define rhi_either(a, b) ((a) | (b))
#define RHI_CALLED __attribute__((overloadable, noinline))
#define RHI_INLINE __attribute__((overloadable, always_inline))
#define RHI_FUSED __attribute__((overloadable, __always_inline__))  // in quick kernels too, for short call chains
#if __has_builtin(__builtin_elementwise_floor) && __has_builtin(__builtin_elementwise_roundeven)
#define rhi_floor __builtin_elementwise_floor  // one instruction, where PoCL's own are fifteen
#define rhi_round __builtin_elementwise_roundeven
#else
#define rhi_floor floor
#define rhi_round rint
#endif
static RHI_INLINE rhi_texture rhi_start(rhi_texture t, rhi_description level) {
    return t + (size_t)(uint)level[RHI_START] * RHI_LEVEL_ALIGNMENT;
}
static RHI_INLINE int rhi_levels(rhi_description w) { return w[RHI_LEVEL_COUNT]; }
static RHI_INLINE int rhi_size(rhi_description w, int number, int axis) {
    return w[RHI_LEVELS + RHI_LEVEL_WORDS * clamp(number, 0, w[RHI_LEVEL_COUNT] - 1) + RHI_WIDTH + axis];
}"""

# Minimax polynomials: the sRGB curve at the 256 stored values above its straight part, within 1.8e-6 and 1 at
# 1; the curve of llvmpipe, within a third of a stored step; and log2 of 1…2, within 1.2e-4 and exact at both
# ends.
_SRGB: Final[tuple[float, ...]] = (
    0.000873782, 0.034559786319732666, 0.4953084886074066, 0.7994788289070129, -0.6501849293708801,
    0.5261836647987366, -0.264753520488739, 0.058533925563097,
)  # fmt: skip
_FAST_SRGB: Final[tuple[float, ...]] = (0.0023, 0.0030, 0.6935, 0.3012)
_LOG2: Final = (-0.43872565031051636, 0.23905783891677856, -0.08213036507368088)


CALLED_WIDTH: Final = 16
"""The width of kernels that call the functions that sample."""
_FAST: Final = "RHI_FAST = "
_PLAIN: Final = "RHI_PLAIN_SAMPLES"
_COMPARES: Final = "#define RHI_COMPARES "
_OTHER_CALLS: Final = re.compile(
    r"\brhi_(?:sample_compare(?:_grad)?|gather(?:_compare)?|load(?:_each)?|size_each|store)\("
)
"""Calls of what a function for plain samples lacks."""
_CALLS: Final = "#ifndef RHI_CALLS_TEXTURES", "#else  // calls of textures", "#endif  // calls of textures"


class TextureFunction(NamedTuple):
    """A function that stages call to sample.

    Attributes:
        precision: with FAST precision, sRGB and levels of detail use shorter polynomials.
        is_plain: whether it only samples 2D textures and arrays of them, without comparison: half of the code.
    """

    precision: Precision
    is_plain: bool

    @property
    def slot(self) -> int:
        """Its number among `FUNCTION_COUNT` addresses, as in called_textures.cl."""
        return int(self.precision is Precision.FAST) + 2 * self.is_plain


FUNCTION_COUNT: Final = 2 * len(Precision)


def textures_text(
    width: int, shapes: Iterable[TextureKind], precision: Precision, compares: bool = True
) -> str:
    """Return the functions for textures of these kinds, `width` lanes wide.

    Args:
        width: number of lanes.
        shapes: the kinds of textures.
        precision: with FAST precision, sRGB and levels of detail use shorter polynomials.
        compares: whether samples may be compared with a depth.
    """
    used = set(shapes)
    options = {
        "SOLIDS": TextureKind.D3 in used,
        "CUBES": TextureKind.CUBE in used,
        "FAST": precision is Precision.FAST,
    }
    constants = "enum { " + ", ".join(f"RHI_{name} = {int(value)}" for name, value in options.items()) + " };"
    body = _text(width)
    if width == CALLED_WIDTH:
        body = "\n".join([_CALLS[0], body, _CALLS[1], _called_text(), _CALLS[2]])
    return "\n".join([enumerations(), constants, f"{_COMPARES}{int(compares)}", _HEAD, body])


def call_textures(text: str, function: TextureFunction) -> str:
    """Return the text of a stage, `CALLED_WIDTH` lanes wide, that calls the function that it needs to sample
    (`texture_function`) instead of containing it. Its lines keep their numbers."""
    before, _, rest = text.partition(_CALLS[0])
    body, _, rest = rest.partition(_CALLS[1])
    slot_define = f"#define {_PLAIN} {int(function.is_plain)}  // "
    before = before.replace(_COMPARES, slot_define, 1)  # which nothing reads here
    return "".join([before, "\n" * body.count("\n"), rest.replace(_CALLS[2], "", 1)])


def texture_function(text: str) -> TextureFunction | None:
    """Return the function that a stage's text needs to sample; None if it needs none, or if it isn't `CALLED_WIDTH`
    lanes wide."""
    if _CALLS[0] not in text:
        return None
    precision = Precision.FAST if f"{_FAST}1" in text else Precision.EXACT
    is_flat = "RHI_SOLIDS = 0" in text and "RHI_CUBES = 0" in text
    return TextureFunction(precision, is_flat and not _OTHER_CALLS.search(text.partition(_CALLS[2])[2]))


def texture_function_text(name: str, function: TextureFunction) -> str:
    """Return the functions for textures of all kinds, or for plain samples, and behind them the function of this
    name that stages call (`call_textures`)."""
    shapes = (TextureKind.D2,) if function.is_plain else tuple(TextureKind)
    body = textures_text(CALLED_WIDTH, shapes, function.precision, compares=not function.is_plain)
    texts = [prelude.SCALAR_SELECT, prelude.any_text(CALLED_WIDTH), prelude.lanes_text(CALLED_WIDTH)]
    texts += [prelude.function_text(inner, CALLED_WIDTH) for inner in prelude.functions_in(body)]
    return "\n".join([*texts, body, f"#define RHI_TEXTURE_FUNCTION {name}", _called_text()])


@cache
def _called_text() -> str:
    return specialise(_read("called_textures.cl"), CALLED_WIDTH)


@cache
def _text(width: int) -> str:
    template = _read("textures.cl")
    for name, coefficients in (("FAST_SRGB_CURVE", _FAST_SRGB), ("SRGB_CURVE", _SRGB)):
        scaled = tuple(coefficient / 255**power for power, coefficient in enumerate(coefficients))
        template = template.replace(name, _polynomial(scaled, "c"))
    curve = _polynomial(_LOG2, "m")
    template = template.replace("LOG2_CURVE", f"m * fma(m - 1.0f, {curve}, (FLOAT)1.0f)")
    blocks = _read("blocks.cl") if width == 16 else ""
    return specialise("\n".join([_memory_text(width), blocks, template]), width)


def _read(name: str) -> str:
    return importlib.resources.files(__package__).joinpath(name).read_text("utf-8")


def _polynomial(coefficients: tuple[float, ...], name: str) -> str:
    text = f"(FLOAT){coefficients[-1]!r}f"
    for coefficient in coefficients[-2::-1]:
        text = f"fma({name}, {text}, (FLOAT){coefficient!r}f)"
    return text


def _memory_text(width: int) -> str:
    """Write the loads and stores whose addresses differ from lane to lane."""
    lanes = per_lane(width, "i.s@")
    texts = [_machine_text(width)]
    for bits, type in ((8, "uchar"), (16, "ushort"), (32, "uint")):
        parts = ", ".join(f"q[{lane}]" for lane in lanes)
        stores = " ".join(per_lane(width, f"if (mask.s@) q[i.s@] = ({type})v.s@;"))
        texts.append(
            f"static RHI_INLINE UINT rhi_gather{bits}(rhi_texture p, INT i) {{\n"
            f"#ifdef RHI_GATHER{bits}\n    return RHI_GATHER{bits}(p, i);\n#else\n"
            f"    global const {type} *q = (global const {type} *)p;\n    return "
            f"(UINT)({parts});\n#endif\n}}\n"
            f"static RHI_INLINE void rhi_scatter{bits}(rhi_image p, INT i, INT mask, UINT v) {{\n"
            f"    global {type} *q = (global {type} *)p;\n    {stores}\n}}"
        )
    texts += [_pair_text(lanes), _long_pair_text(lanes), _reduce_min_text(width)]
    return "\n".join(texts)


def _machine_text(width: int) -> str:
    """Write operations that some machines do in one instruction and OpenCL C can't express.

    Without them, the compiler gathers only a part of the loads and inserts the others; and `vload_half` goes
    through memory.
    """
    texts = []
    if width == 16:
        texts.append("""#if defined(__AVX512F__) && __has_builtin(__builtin_ia32_gathersiv8di)
#define RHI_GATHER32(p, i) as_uint16(__builtin_ia32_gathersiv16si((int16)0, (const void *)(size_t)(p), i, 65535, 4))
#define RHI_GATHER64(p, i) as_ulong8(__builtin_ia32_gathersiv8di((long8)0, (const void *)(size_t)(p), i, 255, 4))
#endif""")
    if width > 1:
        texts.append(f"""#ifdef __F16C__
typedef __fp16 rhi_halves __attribute__((ext_vector_type({width})));
#define RHI_FROM_HALF(x) __builtin_convertvector(__builtin_astype(convert_ushort{width}(x), rhi_halves), FLOAT)
#endif""")
    return "\n".join(texts)


def _pair_text(lanes: list[str]) -> str:
    """Write the load of two adjacent words per lane, from word number `i` on."""
    head = "static RHI_INLINE void rhi_pair(rhi_texture p, INT i, UINT *left, UINT *right) {"
    half = len(lanes) // 2
    if not half:
        lines = [
            "    ulong both = *(global const rhi_wide *)((global const uint *)p + i);",
            "    *left = (uint)both, *right = (uint)(both >> 32);",
        ]
        return "\n".join([head, *lines, "}"])
    loads, gathers = ["    global const uint *q = (global const uint *)p;"], []
    for name, part, suffix in (("low", lanes[:half], "lo"), ("high", lanes[half:], "hi")):
        parts = ", ".join(f"*(global const rhi_wide *)(q + {lane})" for lane in part)
        loads.append(f"    ulong{half} {name} = (ulong{half})({parts});")
        gathers.append(f"    ulong{half} {name} = RHI_GATHER64(p, i.{suffix});")
    lines = ["#ifdef RHI_GATHER64", *gathers, "#else", *loads, "#endif"]
    for name, suffix in (("left", "even"), ("right", "odd")):
        lines.append(f"    *{name} = (UINT)(as_UINT(low).{suffix}, as_UINT(high).{suffix});")
    return "\n".join([head, *lines, "}"])


def _long_pair_text(lanes: list[str]) -> str:
    """Write the load of two adjacent pairs of words per lane, from pair number `i` on."""
    head = "static RHI_INLINE void rhi_long_pair(rhi_texture p, INT i, UINT *left, UINT *right) {"
    lines = ["    global const ulong *q = (global const ulong *)p;"]
    half = len(lanes) // 2
    if not half:
        for name, texel in (("left", "q[i]"), ("right", "q[i + 1]")):
            lines.append(f"    {name}[0] = (uint){texel}, {name}[1] = (uint)({texel} >> 32);")
        return "\n".join([head, *lines, "}"])
    for name, part in (("low", lanes[:half]), ("high", lanes[half:])):
        parts = ", ".join(f"vload2(0, q + {lane})" for lane in part)
        lines.append(f"    ulong{len(lanes)} {name} = (ulong{len(lanes)})({parts});")
    for name, suffix in (("left", "even"), ("right", "odd")):
        for number, word in enumerate(("even", "odd")):
            words = ", ".join(f"as_UINT({half_lanes}.{suffix}).{word}" for half_lanes in ("low", "high"))
            lines.append(f"    {name}[{number}] = (UINT)({words});")
    return "\n".join([head, *lines, "}"])


def _reduce_min_text(width: int) -> str:
    """Write the minimum over all lanes."""
    head = "static RHI_INLINE int rhi_reduce_min(INT x) {"
    if width == 1:
        return f"{head} return x; }}"
    minimum = reduce(lambda least, lane: f"min({least}, {lane})", per_lane(width, "x.s@"))
    return "\n".join(
        [
            head,
            "#if __has_builtin(__builtin_reduce_min)",
            "    return __builtin_reduce_min(x);",
            "#else",
            f"    return {minimum};",
            "#endif",
            "}",
        ]
    )
