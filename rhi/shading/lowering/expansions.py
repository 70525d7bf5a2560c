"""Built-ins composed of others.

They are expressions in the rows of `rhi.shading.language.builtins`, and functions where no expression
suffices: whole vectors and matrices, bits, packing.

An expansion is a function of `let`, which names a value that is used more than once, and of the components of
each argument. It returns the components of the result. The arguments are variables or constants.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
from functools import cache
from typing import Final, TypeAlias

from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ScalarType
from rhi.shading.ir.lanes import Literal, Value, apply, literal
from rhi.shading.ir.tree import OPERATORS
from rhi.shading.language.builtins import BUILTINS, Builtin

Components: TypeAlias = Sequence[Value]
LetFunction: TypeAlias = Callable[[Value], Value]
Expansion: TypeAlias = Callable[..., list[Value]]


def by_component(function: Callable[..., Value]) -> Expansion:
    """Return an expansion that applies a function to each component; an argument with one component is
    broadcast."""

    def expand(let: LetFunction, *arguments: Components) -> list[Value]:
        size = max(len(argument) for argument in arguments)
        rows = [argument if len(argument) == size else [argument[0]] * size for argument in arguments]
        return [function(*parts) for parts in zip(*rows, strict=True)]

    return expand


def _if(condition: Value, then: Value, otherwise: Value) -> Value:
    return apply("select", condition, then, otherwise)


# -- conversions and operators -------------------------------------------------------------------------------


def convert(value: Value, kind: ScalarType) -> Value:
    """Return a component converted to another kind."""
    if value.kind is kind:
        return value
    if value.kind is BOOL:
        return apply("select", value, literal(1, kind), literal(0, kind))
    if kind is BOOL:
        return apply("not_equal", value, literal(0, value.kind))
    if isinstance(value, Literal) and kind is FLOAT:
        return literal(float(value.value))
    if FLOAT in (kind, value.kind):
        return apply(f"to_{kind.name}", value)
    return apply(f"as_{kind.name}", value)


def floored(divide: bool, a: Value, b: Value) -> Value:
    """Return `a // b` or, if `divide` is false, `a % b`."""
    if a.kind is FLOAT:
        return apply("floor", a / b) if divide else float_modulo(a, b)
    if isinstance(b, Literal) and b.value > 0 and int(b.value).bit_count() == 1:
        if divide:
            return apply("shift_right", a, literal(int(b.value).bit_length() - 1, a.kind))
        return a & literal(int(b.value) - 1, a.kind)
    return apply("floor_divide" if divide else "modulo", a, b)


# -- expressions -------------------------------------------------------------------------------------------


@cache
def _parse(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


class _ExpressionExpansion:
    """An expression of a built-in's arguments, with the semantics of the shading language.

    Operators act by component, a scalar operand of a vector is broadcast, `v.yzx` is a swizzle, and calls are
    of built-ins and primitives. `(t := …)` names a value for the rest of the expression, `inf` is infinity,
    and numbers have the kind of the first argument.
    """

    def __init__(self, text: str) -> None:
        self.body = _parse(text)

    def __call__(self, let: LetFunction, *arguments: Components) -> list[Value]:
        self.let, self.kind = let, arguments[0][0].kind
        self.names: dict[str, list[Value]] = dict(zip("abcd", map(list, arguments), strict=False))
        return self.value(self.body)

    def value(self, node: ast.expr) -> list[Value]:
        match node:
            case ast.Name(id="inf"):
                return [literal(float("inf"))]
            case ast.Name(id=name):
                return self.names[name]
            case ast.Constant(value=bool() | int() | float() as value):
                return [literal(value, self.kind)]
            case ast.BinOp(left=left, op=op, right=right):
                return self.apply(OPERATORS[type(op)].primitive, left, right)
            case ast.UnaryOp(op=op, operand=operand):
                return self.apply(OPERATORS[type(op)].primitive, operand)
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return self.apply(OPERATORS[type(op)].primitive, left, right)
            case ast.IfExp(test=test, body=body, orelse=otherwise):
                return self.apply("select", test, body, otherwise)
            case ast.Attribute(value=base, attr=letters):
                whole = self.value(base)
                return [whole["xyzw".index(letter)] for letter in letters]
            case ast.NamedExpr(target=target, value=inner):
                self.names[target.id] = [self.let(part) for part in self.value(inner)]
                return self.names[target.id]
            case ast.Call(func=ast.Name(id=name), args=arguments):
                row = BUILTINS.get(name)
                if row is None:
                    return self.apply(name, *arguments)
                values = [[self.let(part) for part in self.value(argument)] for argument in arguments]
                return expansion_of(row)(self.let, *values)
        raise TypeError(f"{ast.unparse(node)} in a built-in's expression")

    def apply(self, operation: str, *nodes: ast.expr) -> list[Value]:
        """Return a primitive operation applied by component."""
        values = [self.value(node) for node in nodes]
        size = max(map(len, values))
        for i, parts in enumerate(values):
            if len(parts) < size:
                values[i] = [self.let(parts[0])] * size
        return [apply(operation, *parts) for parts in zip(*values, strict=True)]


def expansion_of(builtin: Builtin) -> Expansion:
    """Return the expansion of a built-in in lane code.

    Raises:
        LookupError: the built-in has none.
    """
    if isinstance(builtin.lanes, str) and builtin.lanes:
        return _ExpressionExpansion(builtin.lanes)
    if builtin.opencl:
        return by_component(lambda *parts: apply(builtin.name, *parts))
    return FUNCTIONS[builtin.name]


# -- common ------------------------------------------------------------------------------------------------


def saturate(x: Value) -> Value:
    return clamp(x, literal(0.0), literal(1.0))


def clamp(x: Value, low: Value, high: Value) -> Value:
    return apply("min", apply("max", x, low), high)


def mix(x: Value, y: Value, a: Value) -> Value:
    if a.kind is BOOL:
        return _if(a, y, x)
    return x * (literal(1.0, x.kind) - a) + y * a


def float_modulo(x: Value, y: Value) -> Value:
    return x - y * apply("floor", x / y)


# -- geometry ----------------------------------------------------------------------------------------------


def _dot(a: Components, b: Components) -> Value:
    total = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        total = total + x * y
    return total


def dot(let: LetFunction, a: Components, b: Components) -> list[Value]:
    return [_dot(a, b)]


def length(let: LetFunction, v: Components) -> list[Value]:
    return [apply("sqrt", _dot(v, v))] if len(v) > 1 else [apply("abs", v[0])]


def refract(let: LetFunction, incident: Components, n: Components, eta: Components) -> list[Value]:
    cosine, ratio = let(_dot(n, incident)), eta[0]
    k = let(literal(1.0) - ratio * ratio * (literal(1.0) - cosine * cosine))
    inside = let(apply("less", k, literal(0.0)))
    scale = let(ratio * cosine + apply("sqrt", apply("max", k, literal(0.0))))
    zero = literal(0.0)
    return [_if(inside, zero, ratio * x - scale * y) for x, y in zip(incident, n, strict=True)]


# -- matrices, row by row ----------------------------------------------------------------------------------


def _size(m: Components) -> int:
    return {4: 2, 9: 3, 16: 4}[len(m)]


def transpose(let: LetFunction, m: Components) -> list[Value]:
    n = _size(m)
    return [m[column * n + row] for row in range(n) for column in range(n)]


def _minor(m: Components, row: int, column: int) -> list[Value]:
    n = _size(m)
    return [m[i * n + j] for i in range(n) for j in range(n) if i != row and j != column]


def _determinant(let: LetFunction, m: Components) -> Value:
    if len(m) == 1:
        return m[0]
    n = _size(m)
    total = None
    for column in range(n):
        term = m[column] * let(_determinant(let, _minor(m, 0, column)))
        total = term if total is None else total - term if column % 2 else total + term
    assert total is not None
    return total


def determinant(let: LetFunction, m: Components) -> list[Value]:
    return [_determinant(let, m)]


def inverse(let: LetFunction, m: Components) -> list[Value]:
    n = _size(m)
    cofactors = []
    for row in range(n):
        for column in range(n):
            minor = let(_determinant(let, _minor(m, row, column)))
            cofactors.append(-minor if (row + column) % 2 else minor)
    cofactors = [let(value) for value in cofactors]
    whole = cofactors[0] * m[0]
    for column in range(1, n):
        whole = whole + cofactors[column] * m[column]
    scale = let(literal(1.0) / whole)
    return [cofactors[column * n + row] * scale for row in range(n) for column in range(n)]


# -- bools -------------------------------------------------------------------------------------------------


def any_of(let: LetFunction, v: Components) -> list[Value]:
    total = v[0]
    for part in v[1:]:
        total = total | part
    return [total]


def all_of(let: LetFunction, v: Components) -> list[Value]:
    total = v[0]
    for part in v[1:]:
        total = total & part
    return [total]


# -- bits --------------------------------------------------------------------------------------------------


def _uint(value: int) -> Value:
    return literal(value, UINT)


def _int(value: int) -> Value:
    return literal(value, INT)


def find_lsb(x: Value) -> Value:
    bits = apply("as_int", x)
    return _int(31) - apply("leading_zeros", bits & -bits)


def find_msb(x: Value) -> Value:
    if x.kind is INT:
        x = apply("xor", x, apply("shift_right", x, _int(31)))
    return _int(31) - apply("as_int", apply("leading_zeros", x))


def bitfield_reverse(let: LetFunction, v: Components) -> list[Value]:
    result = []
    for part in v:
        bits = let(apply("as_uint", part))
        for count, mask in ((1, 0x55555555), (2, 0x33333333), (4, 0x0F0F0F0F), (8, 0x00FF00FF)):
            low = apply("shift_left", bits & _uint(mask), _uint(count))
            bits = let(apply("shift_right", bits, _uint(count)) & _uint(mask) | low)
        bits = apply("shift_right", bits, _uint(16)) | apply("shift_left", bits, _uint(16))
        result.append(bits if part.kind is UINT else apply("as_int", bits))
    return result


def _ones(count: Value) -> Value:
    """Return a word whose lowest `count` bits are set; `count` is 0 to 32."""
    number = apply("as_uint", count)
    below = apply("shift_left", _uint(1), number & _uint(31)) - _uint(1)
    return _if(apply("greater", number, _uint(31)), _uint(0xFFFFFFFF), below)


def _field(let: LetFunction, offset: Components, count: Components) -> tuple[Value, Value]:
    """Return the first bit of the part of a field that is inside a word, and a mask of that part's length."""
    start = let(apply("min", apply("as_uint", offset[0]), _uint(32)))
    inside = apply("min", apply("as_uint", count[0]), _uint(32) - start)
    return let(start & _uint(31)), let(_ones(let(inside)))


def bitfield_extract(let: LetFunction, v: Components, offset: Components, count: Components) -> list[Value]:
    (start, ones), result = _field(let, offset, count), []
    for part in v:
        bits = let(apply("shift_right", apply("as_uint", part), start) & ones)
        if part.kind is INT:
            # Sign extension: the field's top bit is copied to all bits above it.
            top = let(apply("xor", ones, apply("shift_right", ones, _uint(1))))
            extended = apply("xor", bits, top) - top
            result.append(apply("as_int", extended))
        else:
            result.append(bits)
    return result


def bitfield_insert(
    let: LetFunction, base: Components, v: Components, offset: Components, count: Components
) -> list[Value]:
    start, ones = _field(let, offset, count)
    field, result = let(apply("shift_left", ones, start)), []
    for old, new in zip(base, v, strict=True):
        moved = apply("shift_left", apply("as_uint", new), start) & field
        bits = apply("as_uint", old) & apply("invert", field) | moved
        result.append(bits if old.kind is UINT else apply("as_int", bits))
    return result


# -- packing -----------------------------------------------------------------------------------------------


def _join(parts: list[Value], bits: int) -> list[Value]:
    total = parts[0]
    for index, part in enumerate(parts[1:], 1):
        total = total | apply("shift_left", part, _uint(bits * index))
    return [total]


def _split(let: LetFunction, whole: Value, bits: int) -> list[Value]:
    moved = [apply("shift_right", whole, _uint(bits * index)) for index in range(32 // bits)]
    return [let(part & _uint((1 << bits) - 1)) for part in moved]


def pack_half(let: LetFunction, v: Components) -> list[Value]:
    return _join([apply("half_bits", part) for part in v], 16)


def unpack_half(let: LetFunction, v: Components) -> list[Value]:
    return [apply("half_value", part) for part in _split(let, v[0], 16)]


def pack_unorm(bits: int) -> Expansion:
    """Return an expansion that packs numbers from 0 to 1 into `bits` bits each."""
    scale = literal(float(2**bits - 1))

    def expand(let: LetFunction, v: Components) -> list[Value]:
        return _join([apply("to_uint", apply("round", saturate(part) * scale)) for part in v], bits)

    return expand


def unpack_unorm(bits: int) -> Expansion:
    """Return the inverse of `pack_unorm`."""

    def expand(let: LetFunction, v: Components) -> list[Value]:
        scale = literal(float(2**bits - 1))
        return [apply("to_float", part) / scale for part in _split(let, v[0], bits)]

    return expand


def pack_snorm(bits: int) -> Expansion:
    """Return an expansion that packs numbers from -1 to 1 into `bits` bits each."""
    scale, ones = literal(float(2 ** (bits - 1) - 1)), _uint((1 << bits) - 1)

    def expand(let: LetFunction, v: Components) -> list[Value]:
        limited = [clamp(part, literal(-1.0), literal(1.0)) for part in v]
        whole = [apply("to_int", apply("round", part * scale)) for part in limited]
        return _join([apply("as_uint", part) & ones for part in whole], bits)

    return expand


def unpack_snorm(bits: int) -> Expansion:
    """Return the inverse of `pack_snorm`."""

    def expand(let: LetFunction, v: Components) -> list[Value]:
        scale, up = literal(float(2 ** (bits - 1) - 1)), _int(32 - bits)
        result = []
        for part in _split(let, v[0], bits):
            extended = apply("shift_right", apply("shift_left", apply("as_int", part), up), up)
            result.append(clamp(apply("to_float", extended) / scale, literal(-1.0), literal(1.0)))
        return result

    return expand


FUNCTIONS: Final[dict[str, Expansion]] = {
    "mix": by_component(mix),
    "length": length,
    "dot": dot,
    "refract": refract,
    "transpose": transpose,
    "determinant": determinant,
    "inverse": inverse,
    "any": any_of,
    "all": all_of,
    "find_lsb": by_component(find_lsb),
    "find_msb": by_component(find_msb),
    "bitfield_reverse": bitfield_reverse,
    "bitfield_extract": bitfield_extract,
    "bitfield_insert": bitfield_insert,
    "pack_half_2x16": pack_half,
    "unpack_half_2x16": unpack_half,
    "pack_unorm_2x16": pack_unorm(16),
    "unpack_unorm_2x16": unpack_unorm(16),
    "pack_snorm_2x16": pack_snorm(16),
    "unpack_snorm_2x16": unpack_snorm(16),
    "pack_unorm_4x8": pack_unorm(8),
    "unpack_unorm_4x8": unpack_unorm(8),
    "pack_snorm_4x8": pack_snorm(8),
    "unpack_snorm_4x8": unpack_snorm(8),
}
"""The expansions that are functions of this module, by the name of the built-in."""
