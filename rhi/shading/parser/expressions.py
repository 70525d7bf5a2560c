"""The parser of expressions: from Python's syntax tree to typed expressions.

`ExpressionParser` handles one function. Names are resolved with the function's variables
(`rhi.shading.parser.statements`), calls of other functions by the stage being compiled (`StageContext`).
"""

from __future__ import annotations

import ast
from functools import reduce
from types import ModuleType
from typing import Any, Final, NoReturn, Protocol

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
)
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression, Operator
from rhi.shading.language import rules
from rhi.shading.language.builtins import Builtin
from rhi.shading.language.shader import Declaration, Shader
from rhi.shading.language.source import MISSING, Source, SourceSpan, span_of, suggest, suggest_name
from rhi.shading.language.textures import methods_of
from rhi.shading.language.tips import FOREIGN
from rhi.shading.language.types import (
    VECTORS,
    ImageType,
    StorageType,
    TextureType,
    Type,
    count_scalars,
    has_array,
    is_value,
    scalar_of,
)
from rhi.shading.parser.constants import constant, tip_for
from rhi.shading.parser.operators import binary, convert, typed, unary
from rhi.shading.parser.signatures import Callee

_ORDER_FUNCTIONS: Final = {
    "<": "less_than",
    "<=": "less_than_equal",
    ">": "greater_than",
    ">=": "greater_than_equal",
}
_AXES: Final = ("xyzw", "rgba")
MAX_LOCAL: Final = 4096
"""The greatest number of scalars in a local array: 16 KiB for each invocation."""
MAX_NESTING: Final = 64
"""The most expressions, blocks and calls, counted together, that may lie around each other in a stage."""
_WIDEST: Final = 8
"""The most conditions of an `and` or `or` that nest in each other in the tree; more are grouped."""


class StageContext(Protocol):
    """The interface that an expression parser needs of the stage being compiled."""

    shader: type[Shader]
    nesting: int
    """The number of expressions, blocks and calls around what is being parsed."""

    def method(self, name: str, after: type | None) -> Callee | None:
        """Return the shader's method of that name; with `after`, that of the bases behind this class."""

    def instance(self, callee: Callee, types: tuple[Type, ...], at: ast.Call, caller: Source) -> tree.Function:
        """Return the function compiled for arguments of these types."""

    def check_stage(self, builtin: Builtin, at: ast.Call, caller: Source) -> None:
        """Refuse a built-in that isn't available in the stage being compiled."""


class ExpressionParser:
    """Parses the expressions of one function."""

    def __init__(self, stage_context: StageContext, source: Source, owner: type | None, self_name: str | None) -> None:
        self.stage_context = stage_context
        self.source = source
        self.owner = owner
        self.self_name = self_name
        self.is_lean = stage_context.shader.lean
        self.untaken = 0  # the conditions around this place that are constant and false

    # -- provided by FunctionParser

    def read(self, name: str, at: ast.Name) -> Expression | None:
        """Return a read of the variable of that name, or None if the function has none."""
        return None

    # -- entry points

    def expression(self, node: ast.expr, wanted: Type | None = None) -> Expression:
        """Return the typed expression. `wanted` gives a tuple its type; it isn't enforced otherwise."""
        if isinstance(node, ast.Tuple) and isinstance(wanted, VectorType):
            parts = tuple(self.converted(part, wanted.scalar) for part in node.elts)
            if len(parts) != wanted.size:
                self.refuse(rules.WRONG_TYPE, node, f"{len(parts)} components", str(wanted))
            return tree.Construct(wanted, span_of(node), parts)
        parse = getattr(self, f"_{type(node).__name__.lower()}", None)
        if parse is None:
            tip = "array(float, 4) makes an array of zeros; a constant array is a tuple defined in the module or class"
            self.unsupported(node, tip if isinstance(node, ast.List) else "")
        self.nest(node)
        result: Expression = parse(node)
        self.stage_context.nesting -= 1
        return result

    def nest(self, at: ast.AST | SourceSpan) -> None:
        """Count one more level of nesting, or refuse it."""
        self.stage_context.nesting += 1
        if self.stage_context.nesting > MAX_NESTING:
            given = f"more than {MAX_NESTING} levels of expressions, blocks and calls in each other"
            self.refuse(rules.TOO_DEEP, at, given, f"up to {MAX_NESTING}")

    def converted(self, node: ast.expr, wanted: Type, what: str = "") -> Expression:
        """Return the expression converted to `wanted`, or refuse it."""
        value = self.expression(node, wanted)
        return self.convert(value, wanted, node, what)

    def convert(self, value: Expression, wanted: Type, at: ast.AST, what: str = "") -> Expression:
        """Return `value` converted to `wanted`, or refuse it at `at`."""
        result = convert(value, wanted)
        if result is None:
            given = f"{what}: {value.type}" if what else str(value.type)
            self.refuse(rules.WRONG_TYPE, at, given, str(wanted), _conversion_tip(value.type, wanted))
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

    def refuse(
        self, rule: Any, at: ast.AST | SourceSpan, given: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        self.source.refuse(rule, at, given, allowed, tip)

    def unsupported(self, node: ast.AST, tip: str = "") -> NoReturn:
        self.refuse(rules.SYNTAX, node, f"a {type(node).__name__} expression", tip=tip)

    # -- leaves

    def _constant(self, node: ast.Constant) -> Expression:
        value = constant(node.value, span_of(node), "", self.source)
        if value is None:
            self.refuse(rules.SYNTAX, node, f"a {type(node.value).__name__}", "numbers and bools")
        return value

    def _name(self, node: ast.Name) -> Expression:
        variable = self.read(node.id, node)
        if variable is not None:
            return variable
        return self.python_value(self._static_name(node), node, node.id)

    def _static_name(self, node: ast.Name) -> Any:
        found = self.source.scope.find(node.id)
        if found is MISSING:
            tip = suggest_name(node.id, [*self.variable_names(), *self.source.scope.names()])
            self.refuse(rules.UNKNOWN_NAME, node, repr(node.id), tip=tip)
        return found

    def variable_names(self) -> list[str]:
        """Return the names of the function's variables, for suggestions."""
        return []

    def python_value(self, value: Any, at: ast.expr, name: str) -> Expression:
        """Return a Python value as a constant, or refuse it at `at`."""
        found = constant(value, span_of(at), name, self.source)
        if found is None:
            allowed = "numbers, vectors, and tuples of them"
            self.refuse(rules.NOT_SHADING, at, f"{name}, a {type(value).__name__}", allowed, tip_for(value, name))
        return found

    # -- operators

    def _unaryop(self, node: ast.UnaryOp) -> Expression:
        operand = self.expression(node.operand)
        if isinstance(node.op, ast.UAdd):
            return operand
        op = tree.OPERATORS[type(node.op)]
        result = unary(op, operand, span_of(node))
        if result is None:
            tip = "use invert(v)" if op is Operator.NOT and isinstance(operand.type, VectorType) else ""
            self.refuse(rules.WRONG_TYPE, node, f"{op.sign} {operand.type}", tip=tip)
        return result

    def _binop(self, node: ast.BinOp) -> Expression:
        chain = [node]  # a + b + c nests to the left, and may be longer than Python's recursion limit
        while isinstance(chain[-1].left, ast.BinOp):
            chain.append(chain[-1].left)
        result = self.expression(chain[-1].left)
        for one in reversed(chain):
            result = self.binary(tree.OPERATORS[type(one.op)], result, self.expression(one.right), one)
        return result

    def binary(self, op: Operator, left: Expression, right: Expression, at: ast.AST) -> Expression:
        """Return a typed binary operation, or refuse its operands."""
        try:
            result = binary(op, left, right, span_of(at))
        except (ZeroDivisionError, OverflowError, ValueError, TypeError) as error:
            if not self.untaken:
                self.refuse(rules.OUT_OF_RANGE, at, str(error))
            result = typed(op, left, right, span_of(at))
        if result is None:
            self.refuse(
                rules.WRONG_TYPE,
                at,
                f"{left.type} {op.sign} {right.type}",
                tip=_operator_tip(op, left, right),
            )
        return result

    def _boolop(self, node: ast.BoolOp) -> Expression:
        is_and, operands = isinstance(node.op, ast.And), []
        decided: Constant | None = None
        for value in node.values:
            if self.is_lean and decided is not None:
                break
            self.untaken += decided is not None
            condition = self.condition(value)
            self.untaken -= decided is not None
            if decided is not None:
                continue  # Python wouldn't evaluate it
            if not isinstance(condition, Constant):
                operands.append(condition)
            elif condition.value != is_and:
                decided = condition
                operands.append(condition)
        return self._join(Operator.AND if is_and else Operator.OR, operands, node) or Constant(
            BOOL, span_of(node), is_and
        )

    def _join(self, op: Operator, operands: list[Expression], at: ast.AST) -> Expression | None:
        """Return the conjunction or disjunction of conditions, None without any. Many are grouped: a flat tree."""
        while len(operands) > 1:
            groups = [operands[i : i + _WIDEST] for i in range(0, len(operands), _WIDEST)]
            operands = [reduce(lambda a, b: self.binary(op, a, b, at), group) for group in groups]
        return operands[0] if operands else None

    def _compare(self, node: ast.Compare) -> Expression:
        left = self.expression(node.left)
        results = []
        for index, (op, right_node) in enumerate(zip(node.ops, node.comparators, strict=True)):
            if type(op) not in tree.OPERATORS:
                self.refuse(rules.SYNTAX, node, f"`{ast.unparse(node)}`", "== != < <= > >=")
            right = self.expression(right_node)
            if index + 1 < len(node.ops) and tree.has_effect(right):
                self.refuse(rules.EVALUATED_TWICE, right_node)
            results.append(self.binary(tree.OPERATORS[type(op)], left, right, node))
            left = right
        result = self._join(Operator.AND, results, node)
        assert result is not None
        return result

    def _ifexp(self, node: ast.IfExp) -> Expression:
        condition = self.condition(node.test)
        known = bool(condition.value) if isinstance(condition, Constant) else None
        self.untaken += known is False
        then = self.expression(node.body)
        self.untaken += (known is True) - (known is False)
        otherwise = self.expression(node.orelse)
        self.untaken -= known is True
        if known is not None:
            return then if known else otherwise
        for value, other in ((then, otherwise), (otherwise, then)):
            converted = convert(value, other.type)
            if converted is not None:
                pair = (converted, other) if value is then else (other, converted)
                return tree.Select(other.type, span_of(node), condition, *pair)
        self.refuse(rules.WRONG_TYPE, node, f"{then.type} or {otherwise.type}", "one type")

    # -- members and elements

    def is_self(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id == self.self_name

    def static(self, node: ast.expr) -> Any:
        """Return the Python object that a dotted name refers to outside the shader, or `MISSING`."""
        if isinstance(node, ast.Name):
            if self.is_self(node) or self.has_variable(node.id):
                return MISSING
            return self._static_name(node)
        if isinstance(node, ast.Attribute):
            base = self.static(node.value)
            if isinstance(base, ModuleType | type):
                found = getattr(base, node.attr, MISSING)
                if found is MISSING:
                    tip = FOREIGN.get(node.attr, "") or suggest(node.attr, dir(base))
                    self.refuse(rules.UNKNOWN_NAME, node, repr(ast.unparse(node)), tip=tip)
                return found
        return MISSING

    def has_variable(self, name: str) -> bool:
        """Return whether the function has a variable of that name."""
        return False

    def _attribute(self, node: ast.Attribute) -> Expression:
        if self.is_self(node.value):
            return self._field_of_shader(node)
        found = self.static(node)
        if found is not MISSING:
            return self.python_value(found, node, node.attr)
        base = self.expression(node.value)
        span = span_of(node)
        if isinstance(base.type, StructType):
            field = base.type.field(node.attr)
            if field is None:
                names = [field.name for field in base.type.fields]
                tip = suggest(node.attr, names)
                self.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", ", ".join(names), tip)
            return tree.Member(field.type, span, base, node.attr)
        if isinstance(base.type, VectorType):
            return self._swizzle(base, base.type, node)
        tip = member_tip(base.type) or ("use transpose(m)" if node.attr == "T" else "")
        self.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", tip=tip)

    def _swizzle(self, base: Expression, type: VectorType, node: ast.Attribute) -> Expression:
        for axes in _AXES:
            components = tuple(axes[: type.size].find(letter) for letter in node.attr)
            if len(components) <= 4 and min(components) >= 0:
                result = type.scalar if len(components) == 1 else VECTORS[type.scalar, len(components)]
                return tree.Swizzle(result, span_of(node), base, components)
        allowed = " or ".join(axes[: type.size] for axes in _AXES)
        self.refuse(rules.UNKNOWN_MEMBER, node, f"{type}.{node.attr}", f"up to 4 of {allowed}")

    def _field_of_shader(self, node: ast.Attribute) -> Expression:
        shader, span = self.stage_context.shader, span_of(node)
        declared: Declaration | None = shader._declared.get(node.attr)
        if declared is not None:
            return tree.BindingRead(declared.type, span, declared)
        found = getattr(shader, node.attr, MISSING)
        if found is not MISSING:
            return self.python_value(found, node, node.attr)
        names = [*shader._declared, *(name for name in dir(shader) if not name.startswith("_"))]
        self.refuse(rules.UNKNOWN_MEMBER, node, f"{shader.__name__}.{node.attr}", tip=suggest(node.attr, names))

    def _subscript(self, node: ast.Subscript) -> Expression:
        base = self.expression(node.value)
        type, span = base.type, span_of(node)
        if isinstance(type, StorageType | ArrayType):
            element: Type = type.element
        elif isinstance(type, VectorType):
            element = type.scalar
        elif isinstance(type, MatrixType):
            element = VECTORS[FLOAT, type.size]
        else:
            self.refuse(rules.WRONG_TYPE, node, f"{type}[…]", "arrays, storage, vectors, matrices")
        if isinstance(node.slice, ast.Slice):
            self.refuse(rules.SYNTAX, node, "a slice", "one index")
        if isinstance(node.slice, ast.Tuple):
            self.refuse(rules.SYNTAX, node, f"[{ast.unparse(node.slice)}]", "one index", "write m[row][column]")
        index = self.expression(node.slice)
        if index.type not in (INT, UINT):
            self.refuse(rules.WRONG_TYPE, node.slice, str(index.type), "int or uint")
        if isinstance(index, Constant):
            index = self._constant_index(index, type, node)
        return tree.Index(element, span, base, index)

    def _constant_index(self, index: Constant, type: Type, node: ast.Subscript) -> Constant:
        value = int(index.value)
        if isinstance(type, StorageType):
            if value < 0 and not self.untaken:
                self.refuse(rules.OUT_OF_RANGE, node.slice, str(value), "0 or more", "count back from len(…)")
            return index
        length = type.length if isinstance(type, ArrayType) else getattr(type, "size", 0)
        if not -length <= value < length and not self.untaken:
            self.refuse(rules.OUT_OF_RANGE, node.slice, str(value), f"{-length} to {length - 1}")
        return Constant(INT, index.span, value % length)

    # -- for calls and statements

    def check_size(self, type: Type, at: ast.AST, what: str) -> None:
        """Refuse a local array, or a struct with one, that is too large for an invocation."""
        if isinstance(type, ArrayType | StructType) and has_array(type):
            scalars = count_scalars(type)
            if scalars > MAX_LOCAL:
                given, tip = (
                    f"{what}, {scalars} numbers",
                    "use a buffer, StorageRW[…], or memory of the work-group, shared(…)",
                )
                self.refuse(rules.TOO_LARGE, at, given, f"up to {MAX_LOCAL} numbers for each invocation", tip)

    def cast(self, value: Expression, type: ScalarType | VectorType, span: SourceSpan) -> Expression:
        """Return an explicit conversion, such as `int(x)`."""
        if value.type == type:
            return value
        if isinstance(value, Constant) and isinstance(type, ScalarType):
            number = value.value
            if type is UINT:
                return Constant(UINT, span, int(number) & 0xFFFFFFFF)
            converted = {BOOL: bool, INT: int, FLOAT: float}[type](number)
            return Constant(type, span, converted)
        return tree.Convert(type, span, value)

    def check_value(self, value: Expression, at: ast.AST) -> None:
        """Refuse a value that can't be held in a variable."""
        if not is_value(value.type):
            tip = "textures and buffers are used in place" if not isinstance(value, tree.Call) else ""
            self.refuse(rules.WRONG_TYPE, at, str(value.type), "a value", tip)


def _conversion_tip(source: Type, target: Type) -> str:
    a, b = scalar_of(source), scalar_of(target)
    if a is not None and b is not None and getattr(source, "size", 1) == getattr(target, "size", 1):
        return f"convert it: {target}(…)"
    return ""


def _operator_tip(op: Operator, left: Expression, right: Expression) -> str:
    a, b = scalar_of(left.type), scalar_of(right.type)
    vectors = isinstance(left.type, VectorType) or isinstance(right.type, VectorType)
    if op.sign in _ORDER_FUNCTIONS and vectors:
        return f"use {_ORDER_FUNCTIONS[op.sign]}(a, b), which compares by component"
    if op is Operator.MATRIX_MULTIPLY:
        if isinstance(left.type, MatrixType) and isinstance(right.type, VectorType):
            size = left.type.size
            return f"a mat{size} takes a vec{size}" + ("; for a point: vec4(v, 1.0)" if size == 4 else "")
        return "@ multiplies matrices; use dot(a, b) for vectors" if vectors else ""
    if isinstance(left.type, MatrixType) and isinstance(right.type, VectorType):
        return "use @ to multiply a matrix with a vector"
    if {a, b} == {INT, UINT}:
        return "convert one of them: int(…) or uint(…)"
    if BOOL in (a, b) and op in (Operator.BIT_AND, Operator.BIT_OR):
        return "use `and`, `or`"
    if op is Operator.POWER and a in (INT, UINT):
        return "an int's exponent must be a constant of 0 to 16; convert to float otherwise"
    return ""


def member_tip(type: Type) -> str:
    """Return a tip for the use of a value that has no fields."""
    if isinstance(type, StorageType):
        return "storage is an array: index it first"
    if isinstance(type, TextureType | ImageType):
        return "call its methods: " + ", ".join(methods_of(type))
    return ""
