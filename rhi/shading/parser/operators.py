"""The typing rules of operators: from operands to a typed node with converted operands, or None if there is
none.

- Python's semantics apply: `/` gives floats, Python computes constant expressions, and an int is converted to
  float where it meets a float.
- Operands of different scalar types can be combined only if they are int and float, or an int literal and
  uint. Two vectors must have the same type.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.layout import BOOL, FLOAT, INT, UINT, MatrixType, ScalarType, VectorType
from rhi.shading.ir.tree import Binary, Constant, Construct, Convert, Expression, Operator, Unary
from rhi.shading.language.source import SourceSpan
from rhi.shading.language.types import Type, converts, scalar_of, with_scalar

BITWISE: Final = frozenset({Operator.BIT_AND, Operator.BIT_OR, Operator.BIT_XOR})
_DIVISIONS: Final = frozenset({Operator.DIVIDE, Operator.FLOOR_DIVIDE, Operator.MODULO})
SHIFTS: Final = frozenset({Operator.SHIFT_LEFT, Operator.SHIFT_RIGHT})
EQUALITY: Final = frozenset({Operator.EQUAL, Operator.NOT_EQUAL})
ORDER: Final = frozenset({Operator.LESS, Operator.LESS_EQUAL, Operator.GREATER, Operator.GREATER_EQUAL})

MAX_POWER: Final = 16
"""The maximum constant integer exponent that is expanded to multiplications."""


def convert(value: Expression, type: Type) -> Expression | None:
    """Return `value` as `type`, implicitly converted if needed; None if there is no implicit conversion."""
    if value.type == type:
        return value
    literal = isinstance(value, Constant) and value.literal and int(value.value) >= 0
    if not converts(value.type, type, literal):
        return None
    if isinstance(value, Constant):
        return Constant(type, value.span, float(value.value) if type is FLOAT else value.value)
    return Convert(type, value.span, value)


def unary(op: Operator, operand: Expression, span: SourceSpan) -> Expression | None:
    """Return a typed `-x`, `~x` or `not x`, folded if x is a constant; None if the type is wrong."""
    scalar = scalar_of(operand.type)
    if op is Operator.NOT:
        allowed = operand.type is BOOL
    elif op is Operator.INVERT:
        allowed = scalar in (INT, UINT)
    else:
        allowed = scalar in (INT, UINT, FLOAT) or isinstance(operand.type, MatrixType)
    if not allowed:
        return None
    if isinstance(operand, Constant) and operand.type is not UINT:
        return Constant(operand.type, span, op.fold(operand.value), operand.literal)
    return Unary(operand.type, span, op, operand)


def binary(op: Operator, left: Expression, right: Expression, span: SourceSpan) -> Expression | None:
    """Return a typed `left op right`, folded if both are constants; None if the types don't fit.

    Raises:
        ZeroDivisionError: the divisor is a constant that is zero or has a zero component.
        OverflowError, ValueError: another constant operation without a valid result.
    """
    node = typed(op, left, right, span)
    if not isinstance(node, Binary):
        return node
    if op in _DIVISIONS and 0 in _constants_of(node.right):
        integers = scalar_of(node.type) in (INT, UINT)
        raise ZeroDivisionError(f"{'integer ' * integers}division by zero")
    if (
        op is Operator.POWER
        and 0 in _constants_of(node.left)
        and any(n < 0 for n in _constants_of(node.right))
    ):
        raise ZeroDivisionError("0.0 to a negative power")
    for count in _constants_of(node.right) if op in SHIFTS else ():
        if not 0 <= count < 32:
            raise ValueError(f"a shift by {count}")
    if isinstance(node.left, Constant) and isinstance(node.right, Constant):
        value = op.fold(node.left.value, node.right.value)
        if isinstance(value, complex):
            raise ValueError("a negative number to a fractional power")
        literal = node.type is INT and getattr(left, "literal", False) and getattr(right, "literal", False)
        if node.type is UINT:
            value &= 0xFFFFFFFF
        return Constant(node.type, span, value, literal)
    return node


def _constants_of(value: Expression) -> list[bool | int | float]:
    """Return the numbers of a constant, or of a vector's constant components."""
    match value:
        case Constant(value=number):
            return [number]
        case Construct(type=VectorType(), parts=parts):
            return [number for part in parts for number in _constants_of(part)]
        case Convert(type=VectorType(), value=inner):
            return _constants_of(inner)
    return []


def typed(op: Operator, left: Expression, right: Expression, span: SourceSpan) -> Expression | None:
    """Return a typed `left op right` that isn't folded; None if the types don't fit."""
    if op is Operator.MATRIX_MULTIPLY:
        return _matrix_multiply(left, right, span)
    if op in (Operator.AND, Operator.OR):
        are_bools = left.type is BOOL and right.type is BOOL
        return Binary(BOOL, span, op, left, right) if are_bools else None
    if isinstance(left.type, MatrixType) or isinstance(right.type, MatrixType):
        return _with_matrix(op, left, right, span)
    a, b = left.type, right.type
    if not isinstance(a, ScalarType | VectorType) or not isinstance(b, ScalarType | VectorType):
        return None
    if op in EQUALITY and a == b:
        return Binary(BOOL, span, op, left, right)
    if op in EQUALITY | ORDER and (isinstance(a, VectorType) or isinstance(b, VectorType)):
        return None
    if scalar_of(a) is BOOL or scalar_of(b) is BOOL:
        return None
    if op in SHIFTS:
        integers = scalar_of(a) in (INT, UINT) and scalar_of(b) in (INT, UINT)
        shapes = isinstance(b, ScalarType) or (isinstance(a, VectorType) and a.size == b.size)
        return Binary(a, span, op, left, right) if integers and shapes else None
    if op is Operator.POWER and _is_integer_power(right):
        # A constant integer exponent is expanded to multiplications: exact, and correct for negative bases.
        if scalar_of(a) is FLOAT or (isinstance(right, Constant) and right.value >= 0):
            return Binary(a, span, op, left, right)
        return None
    if op is Operator.DIVIDE:
        left, right = _to_float(left), _to_float(right)
        a, b = left.type, right.type  # type: ignore[assignment]
    shape = b if isinstance(a, ScalarType) else a
    if isinstance(a, VectorType) and isinstance(b, VectorType) and a != b:
        return None
    scalar = _common_scalar(left, right)
    if scalar is None or (isinstance(shape, VectorType) and shape.scalar is not scalar):
        return None
    if (op in BITWISE and scalar is FLOAT) or (op is Operator.POWER and scalar is not FLOAT):
        return None
    if op is Operator.POWER and isinstance(a, ScalarType) and isinstance(b, VectorType):
        return None
    left_type, right_type = with_scalar(a, scalar), with_scalar(b, scalar)
    converted_left, converted_right = convert(left, left_type), convert(right, right_type)
    if converted_left is None or converted_right is None:
        return None
    result = BOOL if op in EQUALITY | ORDER else with_scalar(shape, scalar)
    return Binary(result, span, op, converted_left, converted_right)


def _is_integer_power(exponent: Expression) -> bool:
    return (
        isinstance(exponent, Constant)
        and exponent.type in (INT, UINT)
        and abs(int(exponent.value)) <= MAX_POWER
    )


def _to_float(value: Expression) -> Expression:
    type = value.type
    if not isinstance(type, ScalarType | VectorType) or scalar_of(type) is FLOAT:
        return value
    if isinstance(value, Constant):
        return Constant(FLOAT, value.span, float(value.value))
    return Convert(with_scalar(type, FLOAT), value.span, value)


def _common_scalar(left: Expression, right: Expression) -> ScalarType | None:
    """Return the scalar type that both operands are converted to; None if there is none."""
    a, b = scalar_of(left.type), scalar_of(right.type)
    if a is b:
        return a
    if {a, b} == {INT, FLOAT}:
        return FLOAT
    for constant, other in ((left, right), (right, left)):
        if (
            isinstance(constant, Constant)
            and constant.literal
            and constant.value >= 0
            and scalar_of(other.type) is UINT
        ):
            return UINT
    return None


def _matrix_multiply(left: Expression, right: Expression, span: SourceSpan) -> Expression | None:
    a, b = left.type, right.type
    if isinstance(a, MatrixType) and a == b:
        return Binary(a, span, Operator.MATRIX_MULTIPLY, left, right)
    for matrix, vector in ((a, b), (b, a)):
        if isinstance(matrix, MatrixType) and vector == VectorType(FLOAT, matrix.size):
            return Binary(vector, span, Operator.MATRIX_MULTIPLY, left, right)
    return None


def _with_matrix(op: Operator, left: Expression, right: Expression, span: SourceSpan) -> Expression | None:
    a, b = left.type, right.type
    if a == b and op in (Operator.ADD, Operator.SUBTRACT, Operator.MULTIPLY):
        return Binary(a, span, op, left, right)
    if isinstance(a, MatrixType) and op in (Operator.MULTIPLY, Operator.DIVIDE):
        factor = convert(right, FLOAT)
        return Binary(a, span, op, left, factor) if factor is not None else None
    if isinstance(b, MatrixType) and op is Operator.MULTIPLY:
        factor = convert(left, FLOAT)
        return Binary(b, span, op, factor, right) if factor is not None else None
    return None
