"""The typed tree: what a stage does, free of Python's syntax and of any device language.

- Every expression has a type and a place in the source; conversions are nodes, so an emitter never converts
  by itself. Values are values: an assignment copies.
- Operators keep Python's meaning: `FloorDivide` and `Modulo` round towards minus infinity, `Divide` gives
  floats, `and`/`or`/`Select` evaluate only what they need, `For` evaluates its bounds once.
- A local is declared by the `Declare` in the narrowest block that holds all its uses.
- Matrices are indexed by row, as in NumPy.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

from rhi.contract.descriptors import Stage
from rhi.contract.layout import StructType
from rhi.shading.language.builtins import Builtin, Effect, Overload
from rhi.shading.language.function import Native
from rhi.shading.language.shader import Declaration
from rhi.shading.language.source import SourceSpan
from rhi.shading.language.types import Type

__rhi_internal__ = True


# -- expressions -------------------------------------------------------------------------------------------


class Operator(enum.Enum):
    """Operators on values of one type (and scalar with vector or matrix, by component)."""

    ADD = "+"
    SUBTRACT = "-"
    MULTIPLY = "*"
    DIVIDE = "/"
    FLOOR_DIVIDE = "//"
    MODULO = "%"
    POWER = "**"
    MATRIX_MULTIPLY = "@"
    BIT_AND = "&"
    BIT_OR = "|"
    BIT_XOR = "^"
    SHIFT_LEFT = "<<"
    SHIFT_RIGHT = ">>"
    EQUAL = "=="
    NOT_EQUAL = "!="
    LESS = "<"
    LESS_EQUAL = "<="
    GREATER = ">"
    GREATER_EQUAL = ">="
    NEGATE = "neg"
    INVERT = "~"
    NOT = "not"
    AND = "and"
    OR = "or"

    __hash__ = object.__hash__


@dataclass(slots=True, eq=False)
class Local:
    """A variable or parameter. `writes` counts assignments, a parameter's own value not included."""

    name: str
    type: Type
    is_parameter: bool = False
    writes: int = 0


@dataclass(slots=True, eq=False)
class Expression:
    type: Type
    span: SourceSpan


@dataclass(slots=True, eq=False)
class Constant(Expression):
    """A scalar known now; `literal`: an int that has not got a type of its own yet."""

    value: bool | int | float
    literal: bool = False


@dataclass(slots=True, eq=False)
class ConstantArray(Expression):
    """A module constant that is a tuple: elements are `Constant` or `Construct`."""

    name: str
    elements: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class Read(Expression):
    """A local's value, or the place it names."""

    local: Local


@dataclass(slots=True, eq=False)
class BindingRead(Expression):
    """A binding or shared memory of the shader."""

    declaration: Declaration


@dataclass(slots=True, eq=False)
class Member(Expression):
    """A field of a struct."""

    base: Expression
    name: str


@dataclass(slots=True, eq=False)
class Swizzle(Expression):
    """Components of a vector by place, 0 to 3; of one component, a scalar."""

    base: Expression
    components: tuple[int, ...]


@dataclass(slots=True, eq=False)
class Index(Expression):
    """An element of an array, storage buffer or vector, or a row of a matrix."""

    base: Expression
    index: Expression


@dataclass(slots=True, eq=False)
class Length(Expression):
    """How many elements a storage buffer has."""

    base: Expression


@dataclass(slots=True, eq=False)
class Unary(Expression):
    operator: Operator
    operand: Expression


@dataclass(slots=True, eq=False)
class Binary(Expression):
    operator: Operator
    left: Expression
    right: Expression


@dataclass(slots=True, eq=False)
class Select(Expression):
    """`then if condition else otherwise`: only one of the two is evaluated."""

    condition: Expression
    then: Expression
    otherwise: Expression


@dataclass(slots=True, eq=False)
class Convert(Expression):
    """A scalar or vector with its components converted (float to int towards zero)."""

    value: Expression


@dataclass(slots=True, eq=False)
class Construct(Expression):
    """A vector, matrix, struct or array from its parts, each of the right type.

    A vector takes scalars and vectors in order, or one scalar for all; a matrix one vector a row, scalars
    row by row, one scalar for the diagonal, or another matrix; a struct or array one part each.
    """

    parts: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class Zeros(Expression):
    """An array of zeros."""


@dataclass(slots=True, eq=False)
class Call(Expression):
    """A call of a function of the program."""

    function: Function
    arguments: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class BuiltinCall(Expression):
    """A call of a built-in; a texture's method has the texture as first argument."""

    builtin: Builtin
    overload: Overload
    arguments: tuple[Expression, ...]


# -- statements --------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Statement:
    span: SourceSpan


@dataclass(slots=True, eq=False)
class Declare(Statement):
    """A local begins, with a value or without."""

    local: Local
    value: Expression | None


@dataclass(slots=True, eq=False)
class Assign(Statement):
    """`target` is a Read, or Member, Swizzle, Index of a place in a local, storage or shared memory."""

    target: Expression
    value: Expression


@dataclass(slots=True, eq=False)
class Evaluate(Statement):
    """An expression for its effect."""

    value: Expression


@dataclass(slots=True, eq=False)
class If(Statement):
    condition: Expression
    then: Block
    otherwise: Block


@dataclass(slots=True, eq=False)
class For(Statement):
    """`for local in range(start, stop, step)`: bounds evaluated once, before; the body doesn't assign
    `local`, which lives in the loop only."""

    local: Local
    start: Expression
    stop: Expression
    step: Expression
    body: Block


@dataclass(slots=True, eq=False)
class While(Statement):
    condition: Expression
    body: Block


@dataclass(slots=True, eq=False)
class Break(Statement):
    pass


@dataclass(slots=True, eq=False)
class Continue(Statement):
    pass


@dataclass(slots=True, eq=False)
class Return(Statement):
    value: Expression | None


@dataclass(slots=True, eq=False)
class Discard(Statement):
    """The fragment ends without output."""


Block: TypeAlias = list[Statement]


# -- functions and stages ----------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Function:
    """A function with concrete types. `native` bodies replace `body` in their languages."""

    name: str
    file: str
    span: SourceSpan
    parameters: tuple[Local, ...]
    result: Type
    body: Block = field(default_factory=list)
    native: dict[str, Native] = field(default_factory=dict)
    has_effect: bool = False


@dataclass(slots=True, eq=False)
class StageTree:
    """A stage: its entry, the functions it calls (callees first), and what they use."""

    stage: Stage
    entry: Function
    functions: tuple[Function, ...]
    bindings: tuple[Declaration, ...]
    structs: tuple[StructType, ...]
    constants: tuple[ConstantArray, ...]
    builtins: frozenset[Builtin]
    stored: frozenset[str]
    loaded: frozenset[str]
    discards: bool


# -- walking -----------------------------------------------------------------------------------------------


def parts_of(node: Expression) -> tuple[Expression, ...]:
    """The expressions directly inside an expression."""
    match node:
        case Member(base=base) | Swizzle(base=base) | Length(base=base):
            return (base,)
        case Index(base=base, index=index):
            return (base, index)
        case Unary(operand=operand):
            return (operand,)
        case Binary(left=left, right=right):
            return (left, right)
        case Select(condition=condition, then=then, otherwise=otherwise):
            return (condition, then, otherwise)
        case Convert(value=value):
            return (value,)
        case Construct(parts=parts) | ConstantArray(elements=parts):
            return parts
        case Call(arguments=arguments) | BuiltinCall(arguments=arguments):
            return arguments
        case _:
            return ()


def has_effect(node: Expression) -> bool:
    """Whether evaluating it twice differs from evaluating it once."""
    if isinstance(node, BuiltinCall) and node.builtin.effect is not Effect.NONE:
        return True
    if isinstance(node, Call) and node.function.has_effect:
        return True
    return any(has_effect(part) for part in parts_of(node))


def has_early_return(body: Block) -> bool:
    """Whether a function returns anywhere but in its last statement."""
    return any(_returns(statement) for statement in body[:-1]) or (
        bool(body) and not isinstance(body[-1], Return) and _returns(body[-1])
    )


def _returns(statement: Statement) -> bool:
    match statement:
        case Return():
            return True
        case If(then=then, otherwise=otherwise):
            return any(map(_returns, then)) or any(map(_returns, otherwise))
        case For(body=body) | While(body=body):
            return any(map(_returns, body))
    return False


def root_of(lvalue: Expression) -> Expression:
    """The variable or binding that a place lies in."""
    while isinstance(lvalue, Member | Swizzle | Index):
        lvalue = lvalue.base
    return lvalue


def walk(block: Block) -> Iterator[Statement | Expression]:
    """All statements and expressions of a block; of a binding that is stored to, only the indices."""
    for statement in block:
        yield statement
        match statement:
            case Declare(value=value) | Return(value=value):
                if value is not None:
                    yield from _expressions(value)
            case Evaluate(value=value):
                yield from _expressions(value)
            case Assign(target=target, value=value):
                yield from _indices(target)
                yield from _expressions(value)
            case If(condition=condition, then=then, otherwise=otherwise):
                yield from _expressions(condition)
                yield from walk(then)
                yield from walk(otherwise)
            case For(start=start, stop=stop, step=step, body=body):
                for bound in (start, stop, step):
                    yield from _expressions(bound)
                yield from walk(body)
            case While(condition=condition, body=body):
                yield from _expressions(condition)
                yield from walk(body)


def _indices(lvalue: Expression) -> Iterator[Expression]:
    while isinstance(lvalue, Member | Swizzle | Index):
        if isinstance(lvalue, Index):
            yield from _expressions(lvalue.index)
        lvalue = lvalue.base


def _expressions(node: Expression) -> Iterator[Expression]:
    yield node
    for part in parts_of(node):
        yield from _expressions(part)
