"""What lane code can do to components: one table with the spelling in OpenCL C and in NumPy.

Operators stand here; built-ins that act by component have their spellings in their own row
(`rhi.shading.language.builtins`) and are found through `spelling`.

- `{0}`, `{1}` are the arguments, `{type}` is the OpenCL type of the result.
- `infix`: OpenCL takes a scalar beside a vector. Elsewhere all arguments are widened to the widest.
- `fast` replaces the OpenCL form with Precision.FAST.
- A `vector` form replaces the OpenCL one where a lane's value varies: there a bool is 0 or -1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rhi.shading.language.builtins import BUILTINS, Builtin, Precision

__rhi_internal__ = True


@dataclass(frozen=True, slots=True)
class Primitive:
    """A row: the spellings."""

    opencl: str
    numpy: str
    vector: str = ""
    infix: bool = False
    fast: str = ""


def _infix(sign: str, numpy: str = "") -> Primitive:
    text = f"({{0}} {sign} {{1}})"
    return Primitive(text, numpy or text, infix=True)


PRIMITIVES: Final[dict[str, Primitive]] = {
    "add": _infix("+"),
    "subtract": _infix("-"),
    "multiply": _infix("*"),
    "divide": Primitive("({0} / {1})", "({0} / {1})", infix=True, fast="native_divide({0}, {1})"),
    "integer_divide": Primitive("rhi_integer_divide({0}, {1})", "R.floor_divide({0}, {1})"),
    "negate": Primitive("(-{0})", "(-{0})"),
    "floor_divide": Primitive("rhi_floor_divide({0}, {1})", "R.floor_divide({0}, {1})"),
    "modulo": Primitive("rhi_modulo({0}, {1})", "R.modulo({0}, {1})"),
    "equal": _infix("=="),
    "not_equal": _infix("!="),
    "less": _infix("<"),
    "less_equal": _infix("<="),
    "greater": _infix(">"),
    "greater_equal": _infix(">="),
    "and": _infix("&"),
    "or": _infix("|"),
    "xor": _infix("^"),
    "invert": Primitive("(~{0})", "(~{0})"),
    "not": Primitive("(!{0})", "np.logical_not({0})", "(~{0})"),
    "select": Primitive("({0} ? {1} : {2})", "np.where({0}, {1}, {2})", "select({2}, {1}, {0})"),
    "shift_left": Primitive("({0} << {1})", "({0} << {1})"),
    "shift_right": Primitive("({0} >> {1})", "({0} >> {1})"),
    "to_float": Primitive("convert_{type}({0})", "R.convert({0}, F)"),
    "to_int": Primitive("convert_{type}({0})", "R.convert({0}, np.int32)"),
    "to_uint": Primitive("convert_{type}({0})", "R.convert({0}, np.uint32)"),
    "as_float": Primitive("as_{type}({0})", "R.as_float({0}, F)"),
    "as_int": Primitive("as_{type}({0})", "R.as_integer({0}, np.int32)"),
    "as_uint": Primitive("as_{type}({0})", "R.as_integer({0}, np.uint32)"),
    "leading_zeros": Primitive("clz({0})", "R.leading_zeros({0})"),
    "bits_set": Primitive("popcount({0})", "R.bits_set({0})"),
    "quads": Primitive("rhi_quads({0})", "R.quads({0})"),
    "uniform": Primitive("rhi_uniform({0}, {1})", ""),
    "half_bits": Primitive("rhi_half_bits({0})", "R.half_bits({0})"),
    "half_value": Primitive("rhi_half_value({0})", "R.half_value({0}, F)"),
}


def spelling(operation: str, precision: Precision = Precision.EXACT) -> Primitive:
    """The row of an operation: an operator's, or that of a built-in by component."""
    row: Primitive | Builtin | None = PRIMITIVES.get(operation)
    if row is None:
        row = BUILTINS[operation]
    if precision is Precision.FAST and row.fast:
        return Primitive(row.fast, row.numpy)
    return row if isinstance(row, Primitive) else Primitive(row.opencl, row.numpy)
