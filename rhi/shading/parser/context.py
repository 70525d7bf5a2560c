"""The state of parsing a stage and a function, which the modules beside this one share.

- Each of them has functions of a `FunctionParser` and a node of Python's syntax tree.
  `rhi.shading.parser.dispatch` has the table that selects one by the node's type.
- A variable has the type of its first value.
- Definite assignment is tracked while parsing: a read that some path reaches without an assignment is
  refused. Otherwise Python's UnboundLocalError would go unnoticed on a device.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from types import FunctionType, ModuleType
from typing import Any, Final, NamedTuple, NoReturn, TypeAlias

from rhi.contract.descriptors import Stage
from rhi.contract.layout import BOOL, ScalarType, VectorType
from rhi.errors import ShaderError, ShaderErrors
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Expression, Local
from rhi.shading.language import rules
from rhi.shading.language.function import NATIVE
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import MISSING, Source, SourceSpan, header_of, span_of, suggest, suggest_name
from rhi.shading.language.tips import FOREIGN
from rhi.shading.language.types import VOID, Type, scalar_of
from rhi.shading.parser.blocks import BlockBuilder, TrackedLocal, finish, place_declaration
from rhi.shading.parser.constants import constant, tip_for
from rhi.shading.parser.operators import convert
from rhi.shading.parser.signatures import Callee

MAX_NESTING: Final = 64
"""The maximum nesting of expressions, blocks and calls in a stage, counted together."""
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

ExpressionParser: TypeAlias = Callable[["FunctionParser", Any], Expression]
"""A function that returns the typed tree of an expression; its second argument is the node."""
StatementParser: TypeAlias = Callable[["FunctionParser", Any], None]
"""A function that appends a statement to the parser's current block; its second argument is the node."""


class Parsers(NamedTuple):
    """The functions that parse expressions and statements, by the type of the node in Python's syntax
    tree."""

    expressions: Mapping[type[ast.expr], ExpressionParser]
    statements: Mapping[type[ast.stmt], StatementParser]


class UnknownValueError(Exception):
    """Raised for a read of a variable whose value was refused, so that its type is unknown."""


class StageParser:
    """Parses the functions of one stage.

    - A function is compiled once per stage for each combination of argument types it is called with.
    - `nesting` is the number of expressions, blocks and calls around what is being parsed.
    - A statement that is refused doesn't end the parsing: `errors` collects what is wrong in all of them.
    """

    def __init__(self, shader: type[Shader], stage: Stage, parsers: Parsers) -> None:
        self.shader = shader
        self.stage = stage
        self.parsers = parsers
        self.instances: dict[tuple[FunctionType, tuple[Type, ...]], tree.Function] = {}
        self.finished: list[tree.Function] = []
        self.nesting = 0
        self.errors = ShaderErrors()

    def parse_entry(self, callee: Callee, types: tuple[Type, ...]) -> tree.Function:
        """Parse the stage's entry function and all that it calls, or raise all errors in them."""
        with self.errors.collect():
            function = self.parse_function(callee, types)
        self.errors.check()
        return function

    def instance(
        self, callee: Callee, types: tuple[Type, ...], at: ast.Call, caller: Source
    ) -> tree.Function:
        """Return the function compiled for arguments of these types."""
        function = self.instances.get((callee.source.function, types))
        if function is None:
            return self.parse_function(callee, types)
        if function not in self.finished:
            caller.refuse(rules.RECURSION, at, f"{caller.name} calls {callee.source.name}")
        return function

    def parse_function(self, callee: Callee, types: tuple[Type, ...]) -> tree.Function:
        """Parse a function for arguments of these types, and the functions that it calls."""
        source, described = callee.source, callee.signature
        parameters = tuple(
            tree.Local(parameter.name, type, is_parameter=True)
            for parameter, type in zip(described.parameters, types, strict=True)
        )
        function = tree.Function(
            source.node.name, source.file, span_of(source.node), parameters, described.result
        )
        self.instances[source.function, types] = function
        try:
            FunctionParser(self, callee, function).parse()
        finally:
            self.finished.append(function)
        return function


class FunctionParser:
    """Parses one function into a `tree.Function`.

    Attributes:
        untaken: the number of enclosing conditions that are constant and false.
        breaks: for each enclosing loop, the sets of assigned locals at its breaks.
        unknown: the variables whose only values were refused. Statements that read them are skipped, without
            an error.
        failed: whether a statement was refused.
    """

    def __init__(self, stage: StageParser, callee: Callee, function: tree.Function) -> None:
        self.stage = stage
        self.source = callee.source
        self.owner = callee.owner
        self.self_name = callee.signature.self_name
        self.is_lean = stage.shader.lean
        self.untaken = 0
        self.function = function
        self.variables: dict[str, TrackedLocal] = {}
        self.superseded: list[TrackedLocal] = []
        self.assigned: set[Local] = set()
        self.reachable = True
        self.blocks: list[BlockBuilder] = [BlockBuilder()]
        self.breaks: list[list[set[Local]]] = []
        self.unknown: set[str] = set()
        self.failed = False
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
        self.nest(header_of(self.source.node))
        self.statements(body)
        self.stage.nesting -= 1
        if self.function.result != VOID and self.reachable and not self.failed:
            result = str(self.function.result)
            with self.stage.errors.collect():
                self.refuse(rules.MISSING_RETURN, header_of(self.source.node), "the end is reached", result)
        if self.stage.errors:  # the stage is refused, so its tree is never read
            self.function.has_effect = True
            return
        for variable in (*self.superseded, *self.variables.values()):
            place_declaration(variable)
        self.function.body = finish(self.blocks[0])

    # -- expressions

    def expression(self, node: ast.expr, expected_type: Type | None = None) -> Expression:
        """Return the typed expression. `expected_type` gives a tuple its type; it isn't enforced
        otherwise."""
        if isinstance(node, ast.Tuple) and isinstance(expected_type, VectorType):
            parts = tuple(self.converted(part, expected_type.scalar) for part in node.elts)
            if len(parts) != expected_type.size:
                self.refuse(rules.WRONG_TYPE, node, f"{len(parts)} components", str(expected_type))
            return tree.Construct(expected_type, span_of(node), parts)
        parse = self.stage.parsers.expressions.get(type(node))
        if parse is None:
            tip = (
                "array(float, 4) makes an array of zeros; "
                "a constant array is a tuple defined in the module or class"
            )
            self.unsupported(node, tip if isinstance(node, ast.List) else "")
        self.nest(node)
        result = parse(self, node)
        self.stage.nesting -= 1
        return result

    def nest(self, at: ast.AST | SourceSpan) -> None:
        """Count one more level of nesting, or refuse it."""
        self.stage.nesting += 1
        if self.stage.nesting > MAX_NESTING:
            actual = f"more than {MAX_NESTING} levels of expressions, blocks and calls in each other"
            self.refuse(rules.TOO_DEEP, at, actual, f"up to {MAX_NESTING}")

    def converted(self, node: ast.expr, target_type: Type, what: str = "") -> Expression:
        """Return the expression converted to `target_type`, or refuse it."""
        value = self.expression(node, target_type)
        return self.convert(value, target_type, node, what)

    def convert(self, value: Expression, target_type: Type, at: ast.AST, what: str = "") -> Expression:
        """Return `value` converted to `target_type`, or refuse it at `at`."""
        result = convert(value, target_type)
        if result is None:
            actual = f"{what}: {value.type}" if what else str(value.type)
            self.refuse(
                rules.WRONG_TYPE, at, actual, str(target_type), _conversion_tip(value.type, target_type)
            )
        return result

    def condition(self, node: ast.expr) -> Expression:
        """Return the expression, which must be a bool."""
        value = self.expression(node)
        if value.type is not BOOL:
            tip = "write the comparison: `!= 0`" if isinstance(value.type, ScalarType) else ""
            if isinstance(value.type, VectorType) and value.type.scalar is BOOL:
                tip = "use any(…) or all(…)"
            self.refuse(rules.WRONG_TYPE, node, str(value.type), "bool", tip)
        return value

    def python_value(self, value: Any, at: ast.expr, name: str) -> Expression:
        """Return a Python value as a constant, or refuse it at `at`."""
        result = constant(value, span_of(at), name, self.source)
        if result is None:
            allowed = "numbers, vectors, and tuples of them"
            self.refuse(
                rules.NOT_SHADING, at, f"{name}, a {type(value).__name__}", allowed, tip_for(value, name)
            )
        return result

    def refuse(
        self, rule: Any, at: ast.AST | SourceSpan, actual: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        self.source.refuse(rule, at, actual, allowed, tip)

    def unsupported(self, node: ast.AST, tip: str = "") -> NoReturn:
        self.refuse(rules.SYNTAX, node, f"a {type(node).__name__} expression", tip=tip)

    # -- names

    def is_self(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id == self.self_name

    def static_name(self, node: ast.Name) -> Any:
        value = self.source.scope.find(node.id)
        if value is MISSING:
            tip = suggest_name(node.id, [*self.variables, *self.source.scope.names()])
            self.refuse(rules.UNKNOWN_NAME, node, repr(node.id), tip=tip)
        return value

    def static(self, node: ast.expr) -> Any:
        """Return the Python object that a dotted name refers to outside the shader, or `MISSING`."""
        if isinstance(node, ast.Name):
            if self.is_self(node) or node.id in self.stored or node.id in self.variables:
                return MISSING
            return self.static_name(node)
        if isinstance(node, ast.Attribute):
            base = self.static(node.value)
            if isinstance(base, ModuleType | type):
                value = getattr(base, node.attr, MISSING)
                if value is MISSING:
                    tip = FOREIGN.get(node.attr, "") or suggest(node.attr, dir(base))
                    self.refuse(rules.UNKNOWN_NAME, node, repr(ast.unparse(node)), tip=tip)
                return value
        return MISSING

    def read(self, name: str, at: ast.Name) -> Expression | None:
        """Return a read of the variable of that name, or None if the function has none."""
        variable = self.variables.get(name)
        if variable is None:
            if name in self.unknown:
                raise UnknownValueError
            if name == self.self_name:
                self.refuse(rules.WRONG_TYPE, at, "the shader itself", "its fields and methods")
            if name in self.stored:
                self.refuse(rules.UNASSIGNED, at, repr(name))
            return None
        if variable.local not in self.assigned and self.reachable:
            self.refuse(rules.UNASSIGNED, at, repr(name))
        self.use(variable)
        return tree.Read(variable.local.type, span_of(at), variable.local)

    def use(self, variable: TrackedLocal) -> None:
        depth = 0
        for mine, now in zip(variable.path, self.blocks, strict=False):
            if mine is not now:
                break
            depth += 1
        del variable.path[depth:]
        del variable.indices[depth:]

    def new_variable(self, name: str, type: Type) -> TrackedLocal:
        local = Local(name, type)
        variable = TrackedLocal(local, list(self.blocks), [len(block) for block in self.blocks])
        if name in self.variables:
            self.superseded.append(self.variables[name])
        self.variables[name] = variable
        return variable

    # -- statements

    def statements(self, nodes: list[ast.stmt]) -> None:
        """Parse statements into the current block."""
        for node in nodes:
            if self.is_lean and not self.reachable:
                return
            parse = self.stage.parsers.statements.get(type(node))
            if parse is None:
                name = type(node).__name__
                tip = _STATEMENT_TIPS.get(name, "")
                with self.stage.errors.collect():
                    self.refuse(rules.SYNTAX, header_of(node), f"`{_first_word(node)}`", tip=tip)
                self._skip(node)
                continue
            depths = len(self.blocks), len(self.breaks), self.stage.nesting, self.untaken
            try:
                parse(self, node)
            except (ShaderError, UnknownValueError) as error:
                del self.blocks[depths[0] :], self.breaks[depths[1] :]
                self.stage.nesting, self.untaken = depths[2:]
                too_deep = False
                if isinstance(error, ShaderError):
                    self.stage.errors.add(error.with_traceback(None))
                    too_deep = error.rule is rules.TOO_DEEP
                self._skip(node, enter=not too_deep)

    def _skip(self, node: ast.stmt, enter: bool = True) -> None:
        """Continue after a refused statement. The body of an `if` or a loop with a wrong head is still
        parsed."""
        self.failed = True
        for name in _stored_names(node):
            if name in self.variables:
                self.assigned.add(self.variables[name].local)
            else:
                self.unknown.add(name)
        if enter and isinstance(node, ast.If | ast.For | ast.While):
            reachable = self.reachable
            self.breaks.append([])
            for body in (node.body, node.orelse):
                self.reachable = reachable
                with self.block(node):
                    self.statements(body)
            self.breaks.pop()
            self.reachable = reachable
        elif isinstance(node, ast.Return):
            self.reachable = False

    @contextmanager
    def block(self, at: ast.stmt) -> Iterator[BlockBuilder]:
        yield self.enter(at)
        self.leave(len(self.blocks) - 1)

    def enter(self, at: ast.stmt) -> BlockBuilder:
        """Begin a block inside the current one."""
        self.nest(header_of(at))
        self.blocks.append(BlockBuilder())
        return self.blocks[-1]

    def leave(self, outer: int) -> None:
        """End the blocks behind the first `outer` ones."""
        self.stage.nesting -= len(self.blocks) - outer
        del self.blocks[outer:]

    def append(self, statement: tree.Statement) -> None:
        self.blocks[-1].append(statement)

    def mark_effect(self, is_evaluated: bool = False) -> None:
        """Record that the function has side effects, and whether an expression has one."""
        self.function.has_effect = True
        self.function.evaluates_effects |= is_evaluated


def _conversion_tip(source: Type, target: Type) -> str:
    a, b = scalar_of(source), scalar_of(target)
    if a is not None and b is not None and getattr(source, "size", 1) == getattr(target, "size", 1):
        return f"convert it: {target}(…)"
    return ""


def _stored_names(node: ast.stmt) -> frozenset[str]:
    return frozenset(
        part.id for part in ast.walk(node) if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
    )


def _is_empty(body: list[ast.stmt]) -> bool:
    return all(
        isinstance(node, ast.Pass) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))
        for node in body
    )


def _native_line(node: ast.FunctionDef, body: str) -> int:
    """Return the Python line where a native body's literal starts, or 0 if its lines aren't lines of the
    file."""
    for decorator in node.decorator_list:
        for argument in decorator.args if isinstance(decorator, ast.Call) else ():
            if isinstance(argument, ast.Constant) and argument.value == body:
                lines = (argument.end_lineno or 0) - argument.lineno
                return argument.lineno if lines == body.count("\n") else 0
    return 0


def _first_word(node: ast.stmt) -> str:
    return ast.unparse(node).split(maxsplit=1)[0].rstrip(":")
