"""The primitive operations of lane code: one table with their spellings in OpenCL C and NumPy.

The table holds operators. Built-ins that act by component have their spellings in their own row of
`rhi.shading.language.builtins`; `spelling` finds both.

- `{0}`, `{1}` are the arguments, `{type}` is the OpenCL type of the result.
- `infix`: OpenCL accepts a scalar operand beside a vector. For all others, arguments are widened to the
  widest.
- `fast` replaces the OpenCL form with Precision.FAST.
- A `vector` form replaces the OpenCL form where the value varies among lanes: a varying bool is 0 or -1.
"""

from __future__ import annotations

from typing import Final

from rhi.errors.data_classes import dataclass
from rhi.shading.language.builtins import BUILTINS, Builtin, Precision


@dataclass(frozen=True, slots=True)
class PrimitiveOperation:
    """The spellings of one operation."""

    opencl: str
    numpy: str
    vector: str = ""
    infix: bool = False
    fast: str = ""


def _infix(sign: str, numpy: str = "") -> PrimitiveOperation:
    text = f"({{0}} {sign} {{1}})"
    return PrimitiveOperation(text, numpy or text, infix=True)


PRIMITIVES: Final[dict[str, PrimitiveOperation]] = {
    "add": _infix("+"),
    "subtract": _infix("-"),
    "multiply": _infix("*"),
    "divide": PrimitiveOperation("({0} / {1})", "({0} / {1})", infix=True, fast="native_divide({0}, {1})"),
    "negate": PrimitiveOperation("(-{0})", "(-{0})"),
    "floor_divide": PrimitiveOperation("rhi_floor_divide({0}, {1})", "R.floor_divide({0}, {1})"),
    "modulo": PrimitiveOperation("rhi_modulo({0}, {1})", "R.modulo({0}, {1})"),
    "equal": _infix("=="),
    "not_equal": _infix("!="),
    "less": _infix("<"),
    "less_equal": _infix("<="),
    "greater": _infix(">"),
    "greater_equal": _infix(">="),
    "and": _infix("&"),
    "or": _infix("|"),
    "xor": _infix("^"),
    "invert": PrimitiveOperation("(~{0})", "(~{0})"),
    "not": PrimitiveOperation("(!{0})", "np.logical_not({0})", "(~{0})"),
    "select": PrimitiveOperation("({0} ? {1} : {2})", "np.where({0}, {1}, {2})", "select({2}, {1}, {0})"),
    "shift_left": PrimitiveOperation("({0} << {1})", "({0} << {1})"),
    "shift_right": PrimitiveOperation("({0} >> {1})", "({0} >> {1})"),
    "to_float": PrimitiveOperation("convert_{type}({0})", "R.convert({0}, F)"),
    "to_int": PrimitiveOperation("rhi_to_int({0})", "R.to_integer({0}, np.int32)"),
    "to_uint": PrimitiveOperation("rhi_to_uint({0})", "R.to_integer({0}, np.uint32)"),
    "as_float": PrimitiveOperation("as_{type}({0})", "R.as_float({0}, F)"),
    "as_int": PrimitiveOperation("as_{type}({0})", "R.as_integer({0}, np.int32)"),
    "as_uint": PrimitiveOperation("as_{type}({0})", "R.as_integer({0}, np.uint32)"),
    "leading_zeros": PrimitiveOperation("clz({0})", "R.leading_zeros({0})"),
    "bits_set": PrimitiveOperation("popcount({0})", "R.bits_set({0})"),
    "quads": PrimitiveOperation("rhi_quads({0})", "R.quads({0})"),
    "uniform": PrimitiveOperation("rhi_uniform({0}, {1})", ""),
    "half_bits": PrimitiveOperation("rhi_half_bits({0})", "R.half_bits({0})"),
    "half_value": PrimitiveOperation("rhi_half_value({0})", "R.half_value({0}, F)"),
}


def spelling(operation: str, precision: Precision = Precision.EXACT) -> PrimitiveOperation:
    """Return the spellings of an operator or of a built-in that acts by component."""
    row: PrimitiveOperation | Builtin | None = PRIMITIVES.get(operation)
    if row is None:
        row = BUILTINS[operation]
    if precision is Precision.FAST and row.fast:
        return PrimitiveOperation(row.fast, row.numpy)
    return row if isinstance(row, PrimitiveOperation) else PrimitiveOperation(row.opencl, row.numpy)
