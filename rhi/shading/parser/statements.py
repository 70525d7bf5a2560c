"""The parser of functions: from Python's statements to the typed tree, with variables, their types and scopes.

- A variable has the type of its first value. Python's variables belong to the function; in the tree each is
  declared in the innermost block that contains all its uses, which is known at the end of the function.
- Definite assignment is tracked while parsing: a read that some path reaches without an assignment is refused.
  Otherwise Python's UnboundLocalError would go unnoticed on a device.
- If a condition is known at compile time (`if self.has_fog:` with a class constant), only the taken branch is kept. The
  other is checked all the same, but not in a lean shader: its branches are the features of many variants, and each is
  checked in a variant that has it.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Final

from rhi.contract.layout import BOOL, INT, UINT, MatrixType
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression, Local
from rhi.shading.language import rules
from rhi.shading.language.annotations import value_type
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.function import NATIVE
from rhi.shading.language.shader import StorageClass
from rhi.shading.language.source import SourceSpan, span_of
from rhi.shading.language.types import VOID, StorageType, Type
from rhi.shading.parser.calls import CallParser
from rhi.shading.parser.expressions import StageContext
from rhi.shading.parser.operators import convert
from rhi.shading.parser.signatures import Callee, evaluate_annotation

_STATEMENT_TIPS: Final = {
    "With": "",
    "Try": "devices have no exceptions",
    "Raise": "devices have no exceptions; use discard() to drop a fragment",
    "Assert": "test shading functions on the CPU instead",
    "FunctionDef": "define it at module level with @function, or as a method",
    "ClassDef": "define structs outside the shader's methods",
    "Match": "use if and elif",
    "Delete": "",
    "Global": "bindings are the only state that shaders share",
    "Nonlocal": "bindings are the only state that shaders share",
    "Import": "import at the top of the module",
    "ImportFrom": "import at the top of the module",
}

_LONGEST_CHAIN: Final = 8
"""The most branches of an `if` that nest in each other in the tree."""


class BlockBuilder(list[tree.Statement]):
    """A block under construction.

    Attributes:
        declares: the locals to declare in front of the statement at an index.
        prologue: statements that precede all others.
    """

    def __init__(self) -> None:
        super().__init__()
        self.declares: dict[int, list[Local]] = {}
        self.prologue: tree.Block = []


@dataclass(slots=True, eq=False)
class Splice(tree.Statement):
    """A block whose statements are inserted into its parent: the branch of a condition known at compile time."""

    block: BlockBuilder


@dataclass(slots=True, eq=False)
class TrackedLocal:
    """A local under observation: its first assignment, and the innermost block that contains all uses found so far.

    Attributes:
        path: the blocks around all uses, from the function's body inwards.
        indices: for each block of the path, the index of the statement that contains the first use.
        first: the first assignment, statement `first_index` of `first_block`.
        loops: the `for` loops that have the local as their variable.
    """

    local: Local
    path: list[BlockBuilder]
    indices: list[int]
    first: tree.Statement | None = None
    first_block: BlockBuilder | None = None
    first_index: int = 0
    loops: list[tree.For] = field(default_factory=list)


class FunctionParser(CallParser):
    """Parses one function into a `tree.Function`."""

    def __init__(self, stage_context: StageContext, callee: Callee, function: tree.Function) -> None:
        signature = callee.signature
        super().__init__(stage_context, callee.source, callee.owner, signature.self_name)
        self.function = function
        self.variables: dict[str, TrackedLocal] = {}
        self.superseded: list[TrackedLocal] = []
        self.assigned: set[Local] = set()
        self.reachable = True
        self.blocks: list[BlockBuilder] = [BlockBuilder()]
        # For each enclosing loop: the sets of assigned locals at its breaks.
        self.breaks: list[list[set[Local]]] = []
        self.stored = _stored_names(callee.source.node)
        for local in function.parameters:
            self.variables[local.name] = TrackedLocal(local, [self.blocks[0]], [0])
            self.assigned.add(local)

    def parse(self) -> None:
        """Parse the function's body."""
        body = self.source.node.body
        for language, text in getattr(self.source.function, NATIVE, {}).items():
            self.function.native[language] = replace(text, line=_native_line(self.source.node, text.body))
        if self.function.native and _is_empty(body):
            self.function.has_effect = True
            return
        self.nest(_header(self.source.node))
        self.statements(body)
        self.stage_context.nesting -= 1
        if self.function.result != VOID and self.reachable:
            wanted = str(self.function.result)
            self.refuse(rules.MISSING_RETURN, _header(self.source.node), "the end is reached", wanted)
        for variable in (*self.superseded, *self.variables.values()):
            self._place_declaration(variable)
        self.function.body = _finish(self.blocks[0])

    # -- variables

    def read(self, name: str, at: ast.Name) -> Expression | None:
        variable = self.variables.get(name)
        if variable is None:
            if name == self.self_name:
                self.refuse(rules.WRONG_TYPE, at, "the shader itself", "its fields and methods")
            if name in self.stored:
                self.refuse(rules.UNASSIGNED, at, repr(name))
            return None
        if variable.local not in self.assigned and self.reachable:
            self.refuse(rules.UNASSIGNED, at, repr(name))
        self._use(variable)
        return tree.Read(variable.local.type, span_of(at), variable.local)

    def has_variable(self, name: str) -> bool:
        return name in self.stored or name in self.variables

    def variable_names(self) -> list[str]:
        return list(self.variables)

    def _use(self, variable: TrackedLocal) -> None:
        depth = 0
        for mine, now in zip(variable.path, self.blocks, strict=False):
            if mine is not now:
                break
            depth += 1
        del variable.path[depth:]
        del variable.indices[depth:]

    def _new_variable(self, name: str, type: Type) -> TrackedLocal:
        local = Local(name, type)
        variable = TrackedLocal(local, list(self.blocks), [len(block) for block in self.blocks])
        if name in self.variables:
            self.superseded.append(self.variables[name])
        self.variables[name] = variable
        return variable

    def _place_declaration(self, variable: TrackedLocal) -> None:
        """Place the variable's declaration in the innermost block that contains all its uses."""
        if variable.local.is_parameter or not variable.path:
            return
        home, index = variable.path[-1], variable.indices[len(variable.path) - 1]
        if variable.loops:
            loop = variable.loops[0]
            own = len(variable.loops) == 1 and home is loop.body
            if own and variable.local.writes == 1:
                return  # the `For` declares it
            for loop in variable.loops:
                # The body assigns the variable, or it outlives the loop: the loop gets a counter of its own.
                loop.local = Local(f"{variable.local.name}_count", INT, writes=1)
                count = tree.Read(INT, loop.span, loop.local)
                assert isinstance(loop.body, BlockBuilder)
                loop.body.prologue.append(
                    tree.Declare(loop.span, variable.local, count)
                    if own
                    else tree.Assign(loop.span, tree.Read(INT, loop.span, variable.local), count)
                )
            if own:
                return
        if variable.first is not None and variable.first_block is home:
            assert isinstance(variable.first, tree.Assign)
            home[variable.first_index] = tree.Declare(variable.first.span, variable.local, variable.first.value)
            return
        home.declares.setdefault(index, []).append(variable.local)

    # -- statements

    def statements(self, nodes: list[ast.stmt]) -> None:
        """Parse statements into the current block."""
        for node in nodes:
            if self.is_lean and not self.reachable:
                return
            parse = getattr(self, f"_{type(node).__name__.lower()}", None)
            if parse is None:
                name = type(node).__name__
                tip = _STATEMENT_TIPS.get(name, "")
                self.refuse(rules.SYNTAX, _header(node), f"`{_first_word(node)}`", tip=tip)
            parse(node)

    @contextmanager
    def _block(self, at: ast.stmt) -> Iterator[BlockBuilder]:
        yield self._enter(at)
        self._leave(len(self.blocks) - 1)

    def _enter(self, at: ast.stmt) -> BlockBuilder:
        """Begin a block inside the current one."""
        self.nest(_header(at))
        self.blocks.append(BlockBuilder())
        return self.blocks[-1]

    def _leave(self, outer: int) -> None:
        """End the blocks behind the first `outer` ones."""
        self.stage_context.nesting -= len(self.blocks) - outer
        del self.blocks[outer:]

    def _append(self, statement: tree.Statement) -> None:
        self.blocks[-1].append(statement)

    def _pass(self, node: ast.Pass) -> None:
        pass

    def _expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant) and (node.value.value is ... or isinstance(node.value.value, str)):
            return
        if not isinstance(node.value, ast.Call):
            self.refuse(rules.SYNTAX, node, "an unused value", "a call, an assignment")
        value = self.expression(node.value)
        if isinstance(value, tree.BuiltinCall) and value.builtin.effect is SideEffect.DISCARD:
            self._append(tree.Discard(span_of(node)))
            self.mark_effect()
            self.reachable = False
            return
        if value.type != VOID and not tree.has_effect(value):
            self.refuse(rules.SYNTAX, node, f"an unused {value.type}", "a call with a side effect")
        self._append(tree.Evaluate(span_of(node), value))

    def _assign(self, node: ast.Assign) -> None:
        if len(node.targets) != 1:
            self.refuse(rules.SYNTAX, node, "several targets", "one target", "write one assignment for each")
        target = node.targets[0]
        if isinstance(target, ast.Tuple | ast.List):
            self.refuse(rules.SYNTAX, target, "a tuple of targets", "one target", "write one assignment for each")
        if isinstance(target, ast.Name):
            known = self.variables.get(target.id)
            value = self.expression(node.value, known.local.type if known is not None else None)
            self._assign_name(target, value, node)
            return
        lvalue = self._assignment_target(target)
        self._append(tree.Assign(span_of(node), lvalue, self.converted(node.value, lvalue.type)))

    def _annassign(self, node: ast.AnnAssign) -> None:
        if not isinstance(node.target, ast.Name) or node.value is None:
            self.refuse(rules.SYNTAX, node, "an annotation without a value", "name: type = value")
        wanted = value_type(evaluate_annotation(self.source, node.annotation))
        if wanted is None:
            value = self.expression(node.value)
            if not isinstance(value, tree.Zeros):
                self.refuse(rules.ANNOTATION, node.annotation, ast.unparse(node.annotation), "a value type")
        else:
            value = self.converted(node.value, wanted)
        self._assign_name(node.target, value, node)

    def _assign_name(self, target: ast.Name, value: Expression, node: ast.stmt) -> None:
        if target.id == self.self_name:
            self.refuse(rules.NOT_WRITABLE, target, target.id)
        if value.type == VOID or not isinstance(value, tree.Zeros):
            self.check_value(value, node)
        variable = self.variables.get(target.id)
        new = variable is None
        if variable is None:
            self.check_size(value.type, node, f"{target.id}: {value.type}")
            variable = self._new_variable(target.id, value.type)
        local = variable.local
        if value.type != local.type:
            converted = convert(value, local.type)
            if converted is None:
                self.refuse(rules.TYPE_CHANGED, node, f"{target.id}: {value.type}", str(local.type))
            value = converted
        self._use(variable)
        statement = tree.Assign(span_of(node), tree.Read(local.type, span_of(target), local), value)
        if new:
            variable.first, variable.first_block = statement, self.blocks[-1]
            variable.first_index = len(self.blocks[-1])
        local.writes += 1
        self.assigned.add(local)
        self._append(statement)

    def _augassign(self, node: ast.AugAssign) -> None:
        target = self._assignment_target(node.target)
        if tree.has_effect(target):
            self.refuse(rules.EVALUATED_TWICE, node.target)
        value = self.binary(tree.OPERATORS[type(node.op)], target, self.expression(node.value), node)
        if isinstance(node.target, ast.Name):
            self._assign_name(node.target, value, node)
            return
        self._append(tree.Assign(span_of(node), target, self.convert(value, target.type, node)))

    def _assignment_target(self, node: ast.expr) -> Expression:
        """Return an expression that can be assigned to, or refuse it."""
        target = self.expression(node)
        self._check_target(target, node)
        if isinstance(target, tree.Index) and isinstance(target.base.type, MatrixType):
            self.refuse(rules.NOT_WRITABLE, node, "a matrix's row", tip="write m[row][column], or make a new matrix")
        if isinstance(target, tree.Swizzle) and len(set(target.components)) < len(target.components):
            self.refuse(rules.NOT_WRITABLE, node, "the same component twice")
        return target

    def _check_target(self, target: Expression, node: ast.AST) -> StorageClass | None:
        root = tree.root_of(target)
        if isinstance(root, tree.Read):
            root.local.writes += 1
            return None
        if not isinstance(root, tree.BindingRead):
            self.refuse(
                rules.NOT_WRITABLE,
                node,
                "a temporary value",
                "variables, StorageRW, shared memory",
            )
        declaration = root.declaration
        if declaration.storage_class is StorageClass.STORAGE:
            assert isinstance(declaration.type, StorageType)
            if not declaration.type.writable:
                tip = f"declare it as StorageRW[{declaration.type.element}]"
                self.refuse(rules.NOT_WRITABLE, node, f"{declaration.name}: {declaration.type}", tip=tip)
            if root is target:
                self.refuse(rules.NOT_WRITABLE, node, "a whole buffer", "its elements")
        elif declaration.storage_class is not StorageClass.SHARED:
            self.refuse(
                rules.NOT_WRITABLE,
                node,
                f"{declaration.name}, a {declaration.storage_class.value}",
                "StorageRW, shared",
            )
        self.mark_effect()
        return declaration.storage_class

    def check_memory(self, target: Expression, at: ast.AST) -> None:
        if self._check_target(target, at) is None or isinstance(target, tree.Swizzle):
            allowed = "an int or uint in storage or shared memory"
            self.refuse(rules.NOT_WRITABLE, at, "a target that atomics don't support", allowed)

    def mark_effect(self) -> None:
        self.function.has_effect = True

    # -- control flow

    def _if(self, node: ast.If) -> None:
        """Parse a chain of `if`, `elif` and `else`, however long: after `_LONGEST_CHAIN` branches it goes on behind the
        statement, under a condition that says that no branch was taken."""
        before, reachable, depth = set(self.assigned), self.reachable, len(self.blocks)
        chain = [node]
        while len(chain[-1].orelse) == 1 and isinstance(chain[-1].orelse[0], ast.If):
            chain.append(chain[-1].orelse[0])
        pending = Local("pending", BOOL, writes=2) if len(chain) > _LONGEST_CHAIN else None
        ends: list[set[Local]] = []  # the assigned locals wherever a branch is left at its end
        decided = False  # by a condition that is constant and true

        def branch(statements: list[ast.stmt], taken: bool) -> None:
            if self.is_lean and not taken:
                return
            self.assigned, self.reachable = set(before), reachable
            self.untaken += not taken
            self.statements(statements)
            self.untaken -= not taken
            if taken and self.reachable:
                ends.append(self.assigned)

        for index, arm in enumerate(chain):
            if self.is_lean and decided:
                break
            self.assigned, self.reachable = set(before), reachable
            if pending is not None and index % _LONGEST_CHAIN == 0:
                self._continue_chain(arm, pending, depth)
            self.untaken += decided
            condition = self.condition(arm.test)
            self.untaken -= decided
            taken = not decided and not (isinstance(condition, Constant) and not condition.value)
            with self._block(arm) as then:
                branch(arm.body, taken)
            if not taken:
                continue
            if isinstance(condition, Constant):
                self._append(Splice(span_of(arm), then))
                decided = True
                continue
            statement = tree.If(_header(arm), condition, then, BlockBuilder())
            self._append(statement)
            otherwise = self._enter(arm)
            statement.otherwise = otherwise
        with self._block(node) as last:
            branch(chain[-1].orelse, not decided)
        if not decided:
            self._append(Splice(span_of(node), last))
        self._leave(depth)
        self.assigned = set.intersection(*ends) if ends else before
        self.reachable = bool(ends)

    def _continue_chain(self, arm: ast.If, pending: Local, depth: int) -> None:
        """Begin the next part of a long chain of branches: inside an `if` for its own part, behind those before."""
        read, span = tree.Read(BOOL, span_of(arm), pending), _header(arm)
        if len(self.blocks) == depth:
            self._append(tree.Declare(span, pending, Constant(BOOL, span, False)))
            return
        self._append(tree.Assign(span, read, Constant(BOOL, span, True)))
        self._leave(depth)
        statement = tree.If(span, read, BlockBuilder(), BlockBuilder())
        self._append(statement)
        statement.then = self._enter(arm)
        self._append(tree.Assign(span, tree.Read(BOOL, span, pending), Constant(BOOL, span, False)))

    def _while(self, node: ast.While) -> None:
        self._no_else(node)
        condition = self.condition(node.test)
        before, reachable = set(self.assigned), self.reachable
        self.breaks.append([])
        with self._block(node) as body:
            self.statements(node.body)
        breaks = self.breaks.pop()
        self.assigned, self.reachable = before, reachable
        if isinstance(condition, Constant) and condition.value:
            # Only a break leaves this loop.
            self.reachable = reachable and bool(breaks)
            if breaks:
                self.assigned = set.intersection(*breaks)
        self._append(tree.While(_header(node), condition, body))

    def _for(self, node: ast.For) -> None:
        self._no_else(node)
        if not isinstance(node.target, ast.Name):
            self.refuse(rules.SYNTAX, node.target, "several targets", "for name in range(…)")
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            tip = "for i in range(len(values)): value = values[i]"
            self.refuse(rules.SYNTAX, call, "a loop over values", "for name in range(…)", tip)
        if call.keywords or not 1 <= len(call.args) <= 3:
            self.refuse(rules.WRONG_ARGUMENTS, call, ast.unparse(call), "range(stop), range(start, stop[, step])")
        bounds = [self._bound(argument) for argument in call.args]
        span = span_of(node)
        if len(bounds) == 1:
            bounds.insert(0, Constant(INT, span, 0))
        if len(bounds) == 2:
            bounds.append(Constant(INT, span, 1))
        if isinstance(bounds[2], Constant) and bounds[2].value == 0:
            self.refuse(rules.OUT_OF_RANGE, call.args[2], "a step of 0", "any other step")
        before, reachable = set(self.assigned), self.reachable
        self.breaks.append([])
        with self._block(node) as body:
            name = node.target.id
            variable = self.variables.get(name)
            if variable is None or (variable.local not in before and variable.local.type is INT):
                # It wasn't assigned before the loop and can't be read after it: each loop gets a variable of its own.
                variable = self._new_variable(name, INT)
            elif variable.local.type is not INT:
                self.refuse(rules.TYPE_CHANGED, node.target, f"{name}: int", str(variable.local.type))
            else:
                self._use(variable)
            variable.local.writes += 1
            self.assigned.add(variable.local)
            loop = tree.For(_header(node), variable.local, bounds[0], bounds[1], bounds[2], body)
            variable.loops.append(loop)
            self.statements(node.body)
        self.breaks.pop()
        self.assigned, self.reachable = before, reachable
        self._append(loop)

    def _bound(self, node: ast.expr) -> Expression:
        value = self.expression(node)
        if value.type is UINT:
            return self.cast(value, INT, span_of(node))
        return self.convert(value, INT, node, "bound")

    def _no_else(self, node: ast.For | ast.While) -> None:
        if node.orelse:
            self.refuse(rules.SYNTAX, node.orelse[0], "else of a loop", tip="set a flag before break")

    def _break(self, node: ast.Break) -> None:
        if self.reachable and not self.untaken:
            self.breaks[-1].append(set(self.assigned))
        self.reachable = False
        self._append(tree.Break(span_of(node)))

    def _continue(self, node: ast.Continue) -> None:
        self.reachable = False
        self._append(tree.Continue(span_of(node)))

    def _return(self, node: ast.Return) -> None:
        result = self.function.result
        value = None
        if result == VOID:
            if node.value is not None:
                self.refuse(rules.WRONG_TYPE, node, "a value", "-> None: no value")
        elif node.value is None:
            self.refuse(rules.WRONG_TYPE, node, "no value", str(result))
        else:
            value = self.converted(node.value, result)
        self.reachable = False
        self._append(tree.Return(span_of(node), value))


def _finish(block: BlockBuilder) -> tree.Block:
    """Return the block with its declarations placed and the known branches inserted."""
    result: tree.Block = list(block.prologue)
    for index, statement in enumerate(block):
        result.extend(tree.Declare(statement.span, local, None) for local in block.declares.get(index, ()))
        match statement:
            case Splice(block=inner):
                result.extend(_finish(inner))
                if result and isinstance(result[-1], tree.Return):
                    break  # what follows is never reached
                continue
            case tree.If(then=BlockBuilder() as then, otherwise=BlockBuilder() as otherwise):
                statement.then, statement.otherwise = _finish(then), _finish(otherwise)
            case tree.For(body=BlockBuilder() as body) | tree.While(body=BlockBuilder() as body):
                statement.body = _finish(body)
        result.append(statement)
    return result


def _stored_names(node: ast.FunctionDef) -> frozenset[str]:
    return frozenset(
        part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
    )


def _is_empty(body: list[ast.stmt]) -> bool:
    return all(
        isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in body
    )


def _native_line(node: ast.FunctionDef, body: str) -> int:
    """Return the file's line of a native body that is a single string with a source line per line; otherwise 0."""
    for decorator in node.decorator_list:
        for argument in decorator.args if isinstance(decorator, ast.Call) else ():
            if isinstance(argument, ast.Constant) and argument.value == body:
                lines = (argument.end_lineno or 0) - argument.lineno
                return argument.lineno if lines == body.count("\n") else 0
    return 0


def _header(node: ast.stmt) -> SourceSpan:
    """Return the span of a statement's first line."""
    return SourceSpan(node.lineno, node.col_offset, 0)


def _first_word(node: ast.stmt) -> str:
    return ast.unparse(node).split(maxsplit=1)[0].rstrip(":")
