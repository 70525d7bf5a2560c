"""The parser of functions: from Python's statements to the typed tree, with variables, their types and
scopes.

- A variable has the type of its first value. Python's variables belong to the function; in the tree each is
  declared in the innermost block that contains all its uses, which is known at the end of the function.
- Definite assignment is tracked while parsing: a read that some path reaches without an assignment is
  refused. Otherwise Python's UnboundLocalError would go unnoticed on a device.
- If a condition is known at compile time (`if self.has_fog:` with a class constant), only the taken branch is
  kept. The other is checked all the same, but not in a lean shader: its branches are the features of many
  variants, and each is checked in a variant that has it.
"""

from __future__ import annotations

import ast
from typing import Final

from rhi.contract.layout import BOOL, INT, UINT, MatrixType
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression, Local
from rhi.shading.language import rules
from rhi.shading.language.annotations import value_type
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.source import header_of, span_of
from rhi.shading.language.types import VOID, Type, converts
from rhi.shading.parser.blocks import BlockBuilder, Splice
from rhi.shading.parser.context import FunctionParser
from rhi.shading.parser.expressions import cast, check_size, check_target, check_value, combine
from rhi.shading.parser.operators import convert
from rhi.shading.parser.signatures import evaluate_annotation

_LONGEST_CHAIN: Final = 8
"""The maximum nesting of `elif` branches in the tree."""


def parse_pass(parser: FunctionParser, node: ast.Pass) -> None:
    pass


def parse_expr(parser: FunctionParser, node: ast.Expr) -> None:
    if isinstance(node.value, ast.Constant) and (
        node.value.value is ... or isinstance(node.value.value, str)
    ):
        return
    if not isinstance(node.value, ast.Call):
        parser.refuse(rules.SYNTAX, node, "an unused value", "a call, an assignment")
    value = parser.expression(node.value)
    if isinstance(value, tree.BuiltinCall) and value.builtin.effect is SideEffect.DISCARD:
        parser.append(tree.Discard(span_of(node)))
        parser.mark_effect()
        parser.reachable = False
        return
    if value.type != VOID and not tree.has_effect(value):
        parser.refuse(rules.SYNTAX, node, f"an unused {value.type}", "a call with a side effect")
    parser.append(tree.Evaluate(span_of(node), value))


def parse_assignment(parser: FunctionParser, node: ast.Assign) -> None:
    if len(node.targets) != 1:
        parser.refuse(rules.SYNTAX, node, "several targets", "one target", "write one assignment for each")
    target = node.targets[0]
    if isinstance(target, ast.Tuple | ast.List):
        _assign_tuple(parser, target, node)
        return
    if isinstance(target, ast.Name):
        _assign_name(parser, target, parser.expression(node.value, _current_type(parser, target)), node)
        return
    lvalue = _assignment_target(parser, target)
    parser.append(tree.Assign(span_of(node), lvalue, parser.converted(node.value, lvalue.type)))


def _assign_tuple(parser: FunctionParser, target: ast.Tuple | ast.List, node: ast.Assign) -> None:
    """Parse `a, b = b, a`: as in Python, all values are evaluated before the first target is assigned."""
    values = node.value.elts if isinstance(node.value, ast.Tuple | ast.List) else []
    if len(values) != len(target.elts) or any(
        isinstance(part, ast.Starred) for part in (*values, *target.elts)
    ):
        allowed = f"{len(target.elts)} values, as in `a, b = b, a`"
        parser.refuse(rules.SYNTAX, node, ast.unparse(node.value), allowed, "write one assignment for each")
    parts: list[Expression] = []
    for part, source in zip(target.elts, values, strict=True):
        value = parser.expression(source, _current_type(parser, part))
        if not isinstance(value, Constant | tree.Zeros):
            check_value(parser, value, source)
            local = Local("value", value.type, writes=1)
            parser.append(tree.Declare(span_of(source), local, value))
            value = tree.Read(value.type, span_of(source), local)
        parts.append(value)
    for part, value in zip(target.elts, parts, strict=True):
        if isinstance(part, ast.Name):
            _assign_name(parser, part, value, node)
        elif isinstance(part, ast.Tuple | ast.List):
            parser.refuse(rules.SYNTAX, part, "targets inside of targets", "names, fields and elements")
        else:
            lvalue = _assignment_target(parser, part)
            parser.append(tree.Assign(span_of(node), lvalue, parser.convert(value, lvalue.type, part)))


def _current_type(parser: FunctionParser, target: ast.expr) -> Type | None:
    """Return the type of the variable that a target names; None if it is new or isn't a variable."""
    variable = parser.variables.get(target.id) if isinstance(target, ast.Name) else None
    return variable.local.type if variable is not None else None


def parse_annotated(parser: FunctionParser, node: ast.AnnAssign) -> None:
    if not isinstance(node.target, ast.Name) or node.value is None:
        parser.refuse(rules.SYNTAX, node, "an annotation without a value", "name: type = value")
    type = value_type(evaluate_annotation(parser.source, node.annotation))
    if type is None:
        value = parser.expression(node.value)
        if not isinstance(value, tree.Zeros):
            parser.refuse(rules.ANNOTATION, node.annotation, ast.unparse(node.annotation), "a value type")
    else:
        value = parser.converted(node.value, type)
    _assign_name(parser, node.target, value, node)


def _assign_name(parser: FunctionParser, target: ast.Name, value: Expression, node: ast.stmt) -> None:
    if target.id == parser.self_name:
        parser.refuse(rules.NOT_WRITABLE, target, target.id)
    if value.type == VOID or not isinstance(value, tree.Zeros):
        check_value(parser, value, node)
    variable = parser.variables.get(target.id)
    new = variable is None
    if variable is None:
        check_size(parser, value.type, node, f"{target.id}: {value.type}")
        variable = parser.new_variable(target.id, value.type)
    local = variable.local
    if value.type != local.type:
        converted = convert(value, local.type)
        if converted is None:
            begin = f"begin with `{target.id}: {value.type} = …`, or convert the value"
            tip = begin if converts(local.type, value.type, literal=True) else ""
            parser.refuse(rules.TYPE_CHANGED, node, f"{target.id}: {value.type}", str(local.type), tip)
        value = converted
    parser.use(variable)
    statement = tree.Assign(span_of(node), tree.Read(local.type, span_of(target), local), value)
    if new:
        variable.first, variable.first_block = statement, parser.blocks[-1]
        variable.first_index = len(parser.blocks[-1])
    local.writes += 1
    parser.assigned.add(local)
    parser.append(statement)


def parse_augmented(parser: FunctionParser, node: ast.AugAssign) -> None:
    target = _assignment_target(parser, node.target)
    if tree.has_effect(target):
        parser.refuse(rules.EVALUATED_TWICE, node.target)
    value = combine(parser, tree.OPERATORS[type(node.op)], target, parser.expression(node.value), node)
    if isinstance(node.target, ast.Name):
        _assign_name(parser, node.target, value, node)
        return
    parser.append(tree.Assign(span_of(node), target, parser.convert(value, target.type, node)))


def _assignment_target(parser: FunctionParser, node: ast.expr) -> Expression:
    """Return an expression that can be assigned to, or refuse it."""
    target = parser.expression(node)
    check_target(parser, target, node)
    if isinstance(target, tree.Index) and isinstance(target.base.type, MatrixType):
        parser.refuse(
            rules.NOT_WRITABLE, node, "a matrix's row", tip="write m[row][column], or make a new matrix"
        )
    if isinstance(target, tree.Swizzle) and len(set(target.components)) < len(target.components):
        parser.refuse(rules.NOT_WRITABLE, node, "the same component twice")
    return target


# -- control flow


def parse_if(parser: FunctionParser, node: ast.If) -> None:
    """Parse a chain of `if`, `elif` and `else` of any length.

    After `_LONGEST_CHAIN` branches the chain continues in a new statement, under the condition that no branch
    was taken."""
    before = set(parser.assigned)
    reachable = parser.reachable
    depth = len(parser.blocks)
    chain = [node]
    while len(chain[-1].orelse) == 1 and isinstance(chain[-1].orelse[0], ast.If):
        chain.append(chain[-1].orelse[0])
    pending = Local("pending", BOOL, writes=2) if len(chain) > _LONGEST_CHAIN else None
    ends: list[set[Local]] = []  # the assigned locals at each branch's end that is reached
    decided = False  # a condition is constant and true

    def branch(statements: list[ast.stmt], taken: bool) -> None:
        if parser.is_lean and not taken:
            return
        parser.assigned, parser.reachable = set(before), reachable
        parser.untaken += not taken
        parser.statements(statements)
        parser.untaken -= not taken
        if taken and parser.reachable:
            ends.append(parser.assigned)

    for index, arm in enumerate(chain):
        if parser.is_lean and decided:
            break
        parser.assigned, parser.reachable = set(before), reachable
        if pending is not None and index % _LONGEST_CHAIN == 0:
            _continue_chain(parser, arm, pending, depth)
        parser.untaken += decided
        condition = parser.condition(arm.test)
        parser.untaken -= decided
        taken = not decided and not (isinstance(condition, Constant) and not condition.value)
        with parser.block(arm) as then:
            branch(arm.body, taken)
        if not taken:
            continue
        if isinstance(condition, Constant):
            parser.append(Splice(span_of(arm), then))
            decided = True
            continue
        statement = tree.If(header_of(arm), condition, then, BlockBuilder())
        parser.append(statement)
        otherwise = parser.enter(arm)
        statement.otherwise = otherwise
    with parser.block(node) as last:
        branch(chain[-1].orelse, not decided)
    if not decided:
        parser.append(Splice(span_of(node), last))
    parser.leave(depth)
    parser.assigned = set.intersection(*ends) if ends else before
    parser.reachable = bool(ends)


def _continue_chain(parser: FunctionParser, arm: ast.If, pending: Local, depth: int) -> None:
    """Begin the next part of a long chain: an `if` of its own after the parts before it."""
    read, span = tree.Read(BOOL, span_of(arm), pending), header_of(arm)
    if len(parser.blocks) == depth:
        parser.append(tree.Declare(span, pending, Constant(BOOL, span, False)))
        return
    parser.append(tree.Assign(span, read, Constant(BOOL, span, True)))
    parser.leave(depth)
    statement = tree.If(span, read, BlockBuilder(), BlockBuilder())
    parser.append(statement)
    statement.then = parser.enter(arm)
    parser.append(tree.Assign(span, tree.Read(BOOL, span, pending), Constant(BOOL, span, False)))


def parse_while(parser: FunctionParser, node: ast.While) -> None:
    _no_else(parser, node)
    condition = parser.condition(node.test)
    before, reachable = set(parser.assigned), parser.reachable
    parser.breaks.append([])
    with parser.block(node) as body:
        parser.statements(node.body)
    breaks = parser.breaks.pop()
    parser.assigned, parser.reachable = before, reachable
    if isinstance(condition, Constant) and condition.value:
        # Only a break leaves this loop.
        parser.reachable = reachable and bool(breaks)
        if breaks:
            parser.assigned = set.intersection(*breaks)
    parser.append(tree.While(header_of(node), condition, body))


def parse_for(parser: FunctionParser, node: ast.For) -> None:
    _no_else(parser, node)
    if not isinstance(node.target, ast.Name):
        parser.refuse(rules.SYNTAX, node.target, "several targets", "for name in range(…)")
    call = node.iter
    if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
        tip = "for i in range(len(values)): value = values[i]"
        parser.refuse(rules.SYNTAX, call, "a loop over values", "for name in range(…)", tip)
    if call.keywords or not 1 <= len(call.args) <= 3:
        parser.refuse(
            rules.WRONG_ARGUMENTS, call, ast.unparse(call), "range(stop), range(start, stop[, step])"
        )
    bounds = [_bound(parser, argument) for argument in call.args]
    span = span_of(node)
    if len(bounds) == 1:
        bounds.insert(0, Constant(INT, span, 0))
    if len(bounds) == 2:
        bounds.append(Constant(INT, span, 1))
    if isinstance(bounds[2], Constant) and bounds[2].value == 0:
        parser.refuse(rules.OUT_OF_RANGE, call.args[2], "a step of 0", "any other step")
    before, reachable = set(parser.assigned), parser.reachable
    parser.breaks.append([])
    with parser.block(node) as body:
        name = node.target.id
        variable = parser.variables.get(name)
        if variable is None or (variable.local not in before and variable.local.type is INT):
            # It wasn't assigned before the loop and can't be read after it: each loop gets a variable of its
            # own.
            variable = parser.new_variable(name, INT)
        elif variable.local.type is not INT:
            parser.refuse(rules.TYPE_CHANGED, node.target, f"{name}: int", str(variable.local.type))
        else:
            parser.use(variable)
        variable.local.writes += 1
        parser.assigned.add(variable.local)
        loop = tree.For(header_of(node), variable.local, bounds[0], bounds[1], bounds[2], body)
        variable.loops.append(loop)
        parser.statements(node.body)
    parser.breaks.pop()
    parser.assigned, parser.reachable = before, reachable
    parser.append(loop)


def _bound(parser: FunctionParser, node: ast.expr) -> Expression:
    value = parser.expression(node)
    if value.type is UINT:
        return cast(parser, value, INT, span_of(node))
    return parser.convert(value, INT, node, "bound")


def _no_else(parser: FunctionParser, node: ast.For | ast.While) -> None:
    if node.orelse:
        parser.refuse(rules.SYNTAX, node.orelse[0], "else of a loop", tip="set a flag before break")


def parse_break(parser: FunctionParser, node: ast.Break) -> None:
    if parser.reachable and not parser.untaken:
        parser.breaks[-1].append(set(parser.assigned))
    parser.reachable = False
    parser.append(tree.Break(span_of(node)))


def parse_continue(parser: FunctionParser, node: ast.Continue) -> None:
    parser.reachable = False
    parser.append(tree.Continue(span_of(node)))


def parse_return(parser: FunctionParser, node: ast.Return) -> None:
    result = parser.function.result
    value = None
    if result == VOID:
        if node.value is not None:
            parser.refuse(rules.WRONG_TYPE, node, "a value", "-> None: no value")
    elif node.value is None:
        parser.refuse(rules.WRONG_TYPE, node, "no value", str(result))
    else:
        value = parser.converted(node.value, result)
    parser.reachable = False
    parser.append(tree.Return(span_of(node), value))
