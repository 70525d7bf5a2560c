"""Exact arithmetic in GLSL: which variables are `precise`, and the values that need one.

GLSL lets a compiler rewrite `(a + b) - a` as `b`, and `a * b + c` with one rounding instead of two, unless
the result is a `precise` variable. With `Precision.EXACT` each operation of floats is rounded by itself, as
in Python and NumPy:

- Variables that get values from arithmetic of floats are `precise`.
- A value that goes elsewhere (to memory, to the caller, into a condition) is stored in a `precise` variable
  first.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from rhi.contract.layout import BOOL, FLOAT
from rhi.shading.ir import nodes, tree
from rhi.shading.ir.tree import Expression, Operator, Statement
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.source import SourceSpan
from rhi.shading.language.types import scalar_of

_ARITHMETIC: Final = frozenset(
    {
        Operator.ADD,
        Operator.SUBTRACT,
        Operator.MULTIPLY,
        Operator.DIVIDE,
        Operator.FLOOR_DIVIDE,
        Operator.MODULO,
        Operator.POWER,
        Operator.MATRIX_MULTIPLY,
    }
)
_COMPARISONS: Final = frozenset(
    {
        Operator.EQUAL,
        Operator.NOT_EQUAL,
        Operator.LESS,
        Operator.LESS_EQUAL,
        Operator.GREATER,
        Operator.GREATER_EQUAL,
    }
)


def is_rewritable(node: Expression) -> bool:
    """Return whether a compiler may compute an expression in another way, with another result."""
    return any(_is_operation(part) for part in nodes.within(node, "Expression"))


def _is_operation(node: Expression) -> bool:
    match node:
        case tree.Binary(operator=operator, type=type):
            return operator in _ARITHMETIC and scalar_of(type) is FLOAT
        case tree.Unary(operator=Operator.NOT, operand=operand):
            # `not a < b` is no `a >= b`: NaN is neither.
            return any(
                isinstance(part, tree.Binary)
                and part.operator in _COMPARISONS
                and scalar_of(part.left.type) is FLOAT
                for part in nodes.within(operand, "Expression")
            )
    return False


def precise_locals(body: tree.Block) -> set[tree.Local]:
    """Return the variables that get values from arithmetic of floats."""
    variables = set()
    for statement in nodes.walk(body):
        match statement:
            case tree.Declare(local=local, value=Expression() as value) if is_rewritable(value):
                variables.add(local)
            case tree.Assign(target=target, value=value) if is_rewritable(value):
                root = tree.root_of(target)
                if isinstance(root, tree.Read):
                    variables.add(root.local)
    return variables


def store_values(body: tree.Block) -> tree.Block:
    """Return statements in which each value of arithmetic that goes elsewhere is stored in a variable
    first."""
    result: tree.Block = []
    for statement in body:
        result += _store_value(statement)
    return result


def _store_value(node: Statement) -> tree.Block:
    match node:
        case tree.Return(value=Expression() as value) if is_rewritable(value):
            declaration, read = _variable("result", value)
            return [declaration, replace(node, value=read)]
        case tree.Assign(target=target, value=value) if is_rewritable(value):
            if not isinstance(tree.root_of(target), tree.BindingRead):
                return [node]
            declaration, read = _variable("value", value)
            return [declaration, replace(node, value=read)]
        case tree.Evaluate(value=tree.BuiltinCall() as call) if call.builtin.effect is SideEffect.WRITE:
            return _store_arguments(node, call)
        case tree.If(condition=condition, then=then, otherwise=otherwise):
            before, condition = _condition(condition)
            then, otherwise = store_values(then), store_values(otherwise)
            return [*before, replace(node, condition=condition, then=then, otherwise=otherwise)]
        case tree.While(condition=condition, body=body):
            before, test = _condition(condition)
            if not before:
                return [replace(node, body=store_values(body))]
            true = tree.Constant(BOOL, condition.span, True)
            fails = tree.Unary(BOOL, condition.span, Operator.NOT, test)
            leave = tree.If(node.span, fails, [tree.Break(node.span)], [])
            return [replace(node, condition=true, body=[*before, leave, *store_values(body)])]
        case tree.For():
            return _store_bounds(node)
    return [node]


def _store_arguments(node: tree.Evaluate, call: tree.BuiltinCall) -> tree.Block:
    """Store the arguments of an atomic or of an image's `store`, unless their order matters."""
    location, *values = call.arguments
    if not any(map(is_rewritable, values)) or any(map(tree.has_effect, call.arguments)):
        return [node]
    before: tree.Block = []
    arguments = [location]
    for value in values:
        if is_rewritable(value):
            declaration, value = _variable("value", value)
            before.append(declaration)
        arguments.append(value)
    return [*before, replace(node, value=replace(call, arguments=tuple(arguments)))]


def _store_bounds(node: tree.For) -> tree.Block:
    """Store the bounds of a loop, in order."""
    bounds: dict[str, Expression] = {"start": node.start, "stop": node.stop, "step": node.step}
    before: tree.Block = []
    if any(map(is_rewritable, bounds.values())):
        for name, value in bounds.items():
            if not isinstance(value, tree.Constant):
                declaration, bounds[name] = _variable(name, value)
                before.append(declaration)
    start, stop, step = bounds.values()
    return [*before, replace(node, start=start, stop=stop, step=step, body=store_values(node.body))]


def _condition(value: Expression) -> tuple[tree.Block, Expression]:
    if not is_rewritable(value):
        return [], value
    declaration, read = _variable("condition", value)
    return [declaration], read


def _variable(name: str, value: Expression) -> tuple[tree.Declare, tree.Read]:
    span: SourceSpan = value.span
    local = tree.Local(name, value.type, writes=1)
    return tree.Declare(span, local, value), tree.Read(value.type, span, local)
