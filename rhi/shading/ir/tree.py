"""The typed tree: a representation of stages that is independent of Python's syntax and of any device
language.

- Every expression has a type and a span of the source. Conversions are nodes, so an emitter never converts
  implicitly. Types have value semantics: an assignment copies.
- Operators keep Python's meaning: `FloorDivide` and `Modulo` round towards minus infinity, `Divide` gives
  floats, `and`/`or`/`Select` evaluate only the operands they need, `For` evaluates its bounds once.
- A local is declared by a `Declare` in the innermost block that contains all its uses.
- Matrices are indexed by row, as in NumPy.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Iterator
from dataclasses import field
from typing import Any, Final, TypeAlias

from rhi.contract.descriptors import Stage
from rhi.contract.layout import StructType
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.shading.ir import nodes
from rhi.shading.language.builtins import Builtin, Overload, SideEffect
from rhi.shading.language.function import Native
from rhi.shading.language.shader import Declaration
from rhi.shading.language.source import SourceSpan
from rhi.shading.language.types import Type

# -- expressions -------------------------------------------------------------------------------------------


class Operator(Choice):
    """Operators on values of one type, or on a scalar and a vector or matrix by component.

    Attributes:
        sign: the operator in Python.
        syntax: its class in Python's syntax tree.
        fold: the function that computes it from constants.
        primitive: its name in lane code (`rhi.shading.ir.primitives`), "" if it takes more than one
            operation.
    """

    ADD = "+", ast.Add, operator.add, "add"
    SUBTRACT = "-", ast.Sub, operator.sub, "subtract"
    MULTIPLY = "*", ast.Mult, operator.mul, "multiply"
    DIVIDE = "/", ast.Div, operator.truediv, "divide"
    FLOOR_DIVIDE = "//", ast.FloorDiv, operator.floordiv, "floor_divide"
    MODULO = "%", ast.Mod, operator.mod, "modulo"
    POWER = "**", ast.Pow, operator.pow, ""
    MATRIX_MULTIPLY = "@", ast.MatMult, operator.matmul, ""
    BIT_AND = "&", ast.BitAnd, operator.and_, "and"
    BIT_OR = "|", ast.BitOr, operator.or_, "or"
    BIT_XOR = "^", ast.BitXor, operator.xor, "xor"
    SHIFT_LEFT = "<<", ast.LShift, operator.lshift, "shift_left"
    SHIFT_RIGHT = ">>", ast.RShift, operator.rshift, "shift_right"
    EQUAL = "==", ast.Eq, operator.eq, "equal"
    NOT_EQUAL = "!=", ast.NotEq, operator.ne, "not_equal"
    LESS = "<", ast.Lt, operator.lt, "less"
    LESS_EQUAL = "<=", ast.LtE, operator.le, "less_equal"
    GREATER = ">", ast.Gt, operator.gt, "greater"
    GREATER_EQUAL = ">=", ast.GtE, operator.ge, "greater_equal"
    NEGATE = "neg", ast.USub, operator.neg, "negate"
    INVERT = "~", ast.Invert, operator.invert, "invert"
    NOT = "not", ast.Not, operator.not_, "not"
    AND = "and", ast.And, lambda a, b: a and b, ""
    OR = "or", ast.Or, lambda a, b: a or b, ""

    def __init__(self, sign: str, syntax: type[ast.AST], fold: Callable[..., Any], primitive: str) -> None:
        self.sign = sign
        self.syntax = syntax
        self.fold = fold
        self.primitive = primitive


OPERATORS: Final = {op.syntax: op for op in Operator}
"""The operators by their classes in Python's syntax tree."""


@dataclass(slots=True, eq=False)
class Local:
    """A variable or parameter. `writes` counts assignments, excluding the initial value of a parameter."""

    name: str
    type: Type
    is_parameter: bool = False
    writes: int = 0


@dataclass(slots=True, eq=False)
class Expression:
    """An expression with its type and its span of the source."""

    type: Type
    span: SourceSpan


@dataclass(slots=True, eq=False)
class Constant(Expression):
    """A scalar known at compile time. `literal` marks an int whose type isn't fixed yet."""

    value: bool | int | float
    literal: bool = False


@dataclass(slots=True, eq=False)
class ConstantArray(Expression):
    """A tuple constant of a module. Its elements are `Constant` or `Construct`."""

    name: str
    elements: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class Read(Expression):
    """The value of a local or, in an lvalue, the local itself."""

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
    """Components of a vector by index, 0 to 3. A single component is a scalar."""

    base: Expression
    components: tuple[int, ...]


@dataclass(slots=True, eq=False)
class Index(Expression):
    """An element of an array, storage buffer or vector, or a row of a matrix.

    `inside`: the index is known to be inside. Otherwise a read outside gives the nearest element, and a write
    outside is dropped; each language says so in its text.
    """

    base: Expression
    index: Expression
    inside: bool = False


@dataclass(slots=True, eq=False)
class Length(Expression):
    """The number of elements of a storage buffer."""

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
    """`then if condition else otherwise`, of which only one operand is evaluated."""

    condition: Expression
    then: Expression
    otherwise: Expression


@dataclass(slots=True, eq=False)
class Convert(Expression):
    """A conversion of a scalar, or of each component of a vector (float to int rounds towards zero)."""

    value: Expression


@dataclass(slots=True, eq=False)
class Construct(Expression):
    """A vector, matrix, struct or array constructed from parts that have the right types.

    The parts of a vector are scalars and vectors in order, or one scalar for all components; those of a
    matrix are one vector for each row, scalars row by row, one scalar for the diagonal, or another matrix;
    those of a struct or array are one for each field or element.
    """

    parts: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class Zeros(Expression):
    """An array of zeros."""


@dataclass(slots=True, eq=False)
class Call(Expression):
    """A call of a function of the stage."""

    function: Function
    arguments: tuple[Expression, ...]


@dataclass(slots=True, eq=False)
class BuiltinCall(Expression):
    """A call of a built-in. For a texture's method, the first argument is the texture."""

    builtin: Builtin
    overload: Overload
    arguments: tuple[Expression, ...]


# -- statements --------------------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Statement:
    """A statement with its span of the source."""

    span: SourceSpan


@dataclass(slots=True, eq=False)
class Declare(Statement):
    """Declare a local, with or without an initial value."""

    local: Local
    value: Expression | None


@dataclass(slots=True, eq=False)
class Assign(Statement):
    """Assign to an lvalue: a Read, or a Member, Swizzle or Index of a local, of storage or of shared
    memory."""

    target: Expression
    value: Expression


@dataclass(slots=True, eq=False)
class Evaluate(Statement):
    """Evaluate an expression for its side effects."""

    value: Expression


@dataclass(slots=True, eq=False)
class If(Statement):
    condition: Expression
    then: Block
    otherwise: Block


@dataclass(slots=True, eq=False)
class For(Statement):
    """`for local in range(start, stop, step)`.

    The bounds are evaluated once, before the loop. The body doesn't assign `local`, whose scope is the loop.
    """

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
    """End the fragment without output."""


Block: TypeAlias = list[Statement]


# -- functions and stages ----------------------------------------------------------------------------------


@dataclass(slots=True, eq=False)
class Function:
    """A function with concrete types. A `native` body replaces `body` in its language.

    `has_effect`: whether a call has side effects. `evaluates_effects`: whether an expression of the body has.
    """

    name: str
    file: str
    span: SourceSpan
    parameters: tuple[Local, ...]
    result: Type
    body: Block = field(default_factory=list)
    native: dict[str, Native] = field(default_factory=dict)
    has_effect: bool = False
    evaluates_effects: bool = False


@dataclass(slots=True, eq=False)
class StageTree:
    """A stage: its entry function, the functions it calls (callees first), and the declarations they use.

    `stored` and `loaded` name the bindings that are written and read.
    """

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


def has_python_bodies(stage: StageTree) -> bool:
    """Return whether all functions of a stage have a Python body, so that the stage can be lowered to lane
    code."""
    return not any(function.native and not function.body for function in stage.functions)


def may_overflow(loop: For) -> bool:
    """Return whether a loop's counter could pass the range of an int when it advances for the last time.

    Such a loop compares its counter with the last value from which it may advance, before it advances.
    """
    step, stop = loop.step, loop.stop
    if not isinstance(step, Constant):
        return True
    if abs(step.value) == 1:
        return False  # the counter meets the bound, which is an int
    if isinstance(stop, Constant):
        beyond = int(stop.value) - 1 + step.value if step.value > 0 else int(stop.value) + 1 + step.value
        return not -(2**31) <= beyond < 2**31
    return not (isinstance(stop, Length) and 0 < step.value <= 2**30)  # of 2^30 words or fewer


# -- walking -----------------------------------------------------------------------------------------------


def parts_of(node: Expression | Statement) -> tuple[Expression, ...]:
    """Return the direct operands of an expression or statement."""
    return nodes.operands(node, "Expression")


def left_chain(node: Binary) -> list[Binary]:
    """Return the operations of a chain such as `a + b - c`, which nests to the left, in the order of
    evaluation.

    Chains may be longer than Python's recursion limit, so visitors iterate over them.
    """
    chain = [node]
    while isinstance(chain[-1].left, Binary):
        chain.append(chain[-1].left)
    return chain[::-1]


def has_effect(node: Expression) -> bool:
    """Return whether an expression has side effects, so that evaluating it twice differs from evaluating it
    once."""
    for part in nodes.within(node, "Expression"):
        if isinstance(part, BuiltinCall) and part.builtin.effect is not SideEffect.NONE:
            return True
        if isinstance(part, Call) and part.function.has_effect:
            return True
    return False


def has_early_return(body: Block) -> bool:
    """Return whether a function body returns anywhere but in its last statement."""
    return any(_returns(statement) for statement in body[:-1]) or (
        bool(body) and not isinstance(body[-1], Return) and _returns(body[-1])
    )


def _returns(statement: Statement) -> bool:
    return any(isinstance(part, Return) for part in nodes.walk([statement]))


def returns_everywhere(body: Block) -> bool:
    """Return whether every path through a function's body ends in a `return`."""
    match body:
        case [*_, Return()]:
            return True
        case [*_, If(then=then, otherwise=otherwise)]:
            return returns_everywhere(then) and returns_everywhere(otherwise)
    return False


def is_left(statement: Statement) -> bool:
    """Return whether what follows a statement is never reached, because each path through it leaves the
    block."""
    match statement:
        case Return() | Break() | Continue() | Discard():
            return True
        case If(then=then, otherwise=otherwise):
            return any(map(is_left, then)) and any(map(is_left, otherwise))
        case While(condition=Constant(value=value), body=body):
            return bool(value) and not has_break(body)
    return False


def has_break(body: Block) -> bool:
    """Return whether a loop with this body has a `break` of its own."""
    return any(
        isinstance(statement, Break)
        or (isinstance(statement, If) and (has_break(statement.then) or has_break(statement.otherwise)))
        for statement in body
    )


def root_of(lvalue: Expression) -> Expression:
    """Return the variable or binding that an lvalue belongs to."""
    while isinstance(lvalue, Member | Swizzle | Index):
        lvalue = lvalue.base
    return lvalue


def indices_of(lvalue: Expression) -> list[Index]:
    """Return the indices of an lvalue, in the order in which they are evaluated: innermost first."""
    indices = []
    while isinstance(lvalue, Member | Swizzle | Index):
        if isinstance(lvalue, Index):
            indices.append(lvalue)
        lvalue = lvalue.base
    return indices[::-1]


def walk(block: Block) -> Iterator[Statement | Expression]:
    """Yield all statements and expressions of a block. Of the target of an assignment only the indices are
    included."""
    for statement in nodes.walk(block):
        yield statement
        for part in parts_of(statement):
            is_target = isinstance(statement, Assign) and part is statement.target
            yield from _indices(part) if is_target else nodes.within(part, "Expression")


def _indices(lvalue: Expression) -> Iterator[Expression]:
    while isinstance(lvalue, Member | Swizzle | Index):
        if isinstance(lvalue, Index):
            yield from nodes.within(lvalue.index, "Expression")
        lvalue = lvalue.base
