"""The parser of expressions: from Python's syntax tree to typed expressions."""

from __future__ import annotations

import ast
from functools import reduce
from typing import Final

from rhi.contract import layout
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression, Operator
from rhi.shading.language import rules, types
from rhi.shading.language.shader import Declaration, StorageClass, words_of_table
from rhi.shading.language.source import MISSING, SourceSpan, span_of, suggest
from rhi.shading.language.textures import methods_of
from rhi.shading.parser.constants import constant
from rhi.shading.parser.context import FunctionParser
from rhi.shading.parser.operators import binary, convert, typed, unary
from rhi.shading.parser.texture_tables import table_of

_ORDER_FUNCTIONS: Final = {
    "<": "less_than",
    "<=": "less_than_equal",
    ">": "greater_than",
    ">=": "greater_than_equal",
}
_AXES: Final = ("xyzw", "rgba")
MAX_LOCAL: Final = 4096
"""The maximum number of scalars in a local array: 16 KiB for each invocation."""
_WIDEST: Final = 8
"""The maximum nesting of an `and` or `or` in the tree; more conditions are grouped."""


def parse_constant(parser: FunctionParser, node: ast.Constant) -> Expression:
    value = constant(node.value, span_of(node), "", parser.source)
    if value is None:
        parser.refuse(rules.SYNTAX, node, f"a {type(node.value).__name__}", "numbers and bools")
    return value


def parse_name(parser: FunctionParser, node: ast.Name) -> Expression:
    variable = parser.read(node.id, node)
    if variable is not None:
        return variable
    return parser.python_value(parser.static_name(node), node, node.id)


# -- operators


def parse_unary(parser: FunctionParser, node: ast.UnaryOp) -> Expression:
    operand = parser.expression(node.operand)
    if isinstance(node.op, ast.UAdd):
        return operand
    op = tree.OPERATORS[type(node.op)]
    result = unary(op, operand, span_of(node))
    if result is None:
        tip = "use invert(v)" if op is Operator.NOT and isinstance(operand.type, layout.VectorType) else ""
        parser.refuse(rules.WRONG_TYPE, node, f"{op.sign} {operand.type}", tip=tip)
    return result


def parse_binary(parser: FunctionParser, node: ast.BinOp) -> Expression:
    chain = [node]  # a + b + c nests to the left, and may be longer than Python's recursion limit
    while isinstance(chain[-1].left, ast.BinOp):
        chain.append(chain[-1].left)
    result = parser.expression(chain[-1].left)
    for link in reversed(chain):
        result = combine(parser, tree.OPERATORS[type(link.op)], result, parser.expression(link.right), link)
    return result


def combine(
    parser: FunctionParser, op: Operator, left: Expression, right: Expression, at: ast.AST
) -> Expression:
    """Return a typed binary operation, or refuse its operands."""
    try:
        result = binary(op, left, right, span_of(at))
    except (ZeroDivisionError, OverflowError, ValueError, TypeError) as error:
        if not parser.untaken:
            parser.refuse(rules.OUT_OF_RANGE, at, str(error))
        result = typed(op, left, right, span_of(at))
    if result is None:
        parser.refuse(
            rules.WRONG_TYPE,
            at,
            f"{left.type} {op.sign} {right.type}",
            tip=_operator_tip(op, left, right),
        )
    return result


def parse_condition(parser: FunctionParser, node: ast.BoolOp) -> Expression:
    is_and, operands = isinstance(node.op, ast.And), []
    decided: Constant | None = None
    for value in node.values:
        if parser.is_lean and decided is not None:
            break
        parser.untaken += decided is not None
        condition = parser.condition(value)
        parser.untaken -= decided is not None
        if decided is not None:
            continue  # Python wouldn't evaluate it
        if not isinstance(condition, Constant):
            operands.append(condition)
        elif condition.value != is_and:
            decided = condition
            operands.append(condition)
    return _join(parser, Operator.AND if is_and else Operator.OR, operands, node) or Constant(
        layout.BOOL, span_of(node), is_and
    )


def _join(parser: FunctionParser, op: Operator, operands: list[Expression], at: ast.AST) -> Expression | None:
    """Return the conjunction or disjunction of conditions, as a flat tree; None if there are none."""
    while len(operands) > 1:
        groups = [operands[i : i + _WIDEST] for i in range(0, len(operands), _WIDEST)]
        operands = [reduce(lambda a, b: combine(parser, op, a, b, at), group) for group in groups]
    return operands[0] if operands else None


def parse_comparison(parser: FunctionParser, node: ast.Compare) -> Expression:
    left = parser.expression(node.left)
    results = []
    for index, (op, right_node) in enumerate(zip(node.ops, node.comparators, strict=True)):
        if type(op) not in tree.OPERATORS:
            parser.refuse(rules.SYNTAX, node, f"`{ast.unparse(node)}`", "== != < <= > >=")
        right = parser.expression(right_node)
        if index + 1 < len(node.ops) and tree.has_effect(right):
            parser.refuse(rules.EVALUATED_TWICE, right_node)
        results.append(combine(parser, tree.OPERATORS[type(op)], left, right, node))
        left = right
    result = _join(parser, Operator.AND, results, node)
    assert result is not None
    return result


def parse_selection(parser: FunctionParser, node: ast.IfExp) -> Expression:
    condition = parser.condition(node.test)
    constant_condition = bool(condition.value) if isinstance(condition, Constant) else None
    parser.untaken += constant_condition is False
    then = parser.expression(node.body)
    parser.untaken += (constant_condition is True) - (constant_condition is False)
    otherwise = parser.expression(node.orelse)
    parser.untaken -= constant_condition is True
    if constant_condition is not None:
        return then if constant_condition else otherwise
    for value, other in ((then, otherwise), (otherwise, then)):
        converted = convert(value, other.type)
        if converted is not None:
            pair = (converted, other) if value is then else (other, converted)
            return tree.Select(other.type, span_of(node), condition, *pair)
    parser.refuse(rules.WRONG_TYPE, node, f"{then.type} or {otherwise.type}", "one type")


# -- members and elements


def parse_attribute(parser: FunctionParser, node: ast.Attribute) -> Expression:
    if parser.is_self(node.value):
        return _field_of_shader(parser, node)
    value = parser.static(node)
    if value is not MISSING:
        return parser.python_value(value, node, node.attr)
    base = parser.expression(node.value)
    span = span_of(node)
    if isinstance(base.type, layout.StructType):
        field = base.type.field(node.attr)
        if field is None:
            names = [field.name for field in base.type.fields]
            tip = suggest(node.attr, names)
            parser.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", ", ".join(names), tip)
        return tree.Member(field.type, span, base, node.attr)
    if isinstance(base.type, layout.VectorType):
        return _swizzle(parser, base, base.type, node)
    tip = member_tip(base.type) or ("use transpose(m)" if node.attr == "T" else "")
    parser.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", tip=tip)


def _swizzle(
    parser: FunctionParser, base: Expression, type: layout.VectorType, node: ast.Attribute
) -> Expression:
    for axes in _AXES:
        components = tuple(axes[: type.size].find(letter) for letter in node.attr)
        if len(components) <= 4 and min(components) >= 0:
            result = type.scalar if len(components) == 1 else types.VECTORS[type.scalar, len(components)]
            return tree.Swizzle(result, span_of(node), base, components)
    allowed = " or ".join(axes[: type.size] for axes in _AXES)
    parser.refuse(rules.UNKNOWN_MEMBER, node, f"{type}.{node.attr}", f"up to 4 of {allowed}")


def _field_of_shader(parser: FunctionParser, node: ast.Attribute) -> Expression:
    shader, span = parser.stage.shader, span_of(node)
    table, name = table_of(parser.source.function), node.attr
    if table:  # a function that reads tables, for the table of this name
        name = {"table": table, "table_words": words_of_table(table)}.get(name, name)
    declared: Declaration | None = shader._declared.get(name)
    if declared is not None:
        if declared.is_table and not table:
            tip = f"self.{name}[index].sample(uv), or len(self.{name})"
            parser.refuse(rules.WRONG_TYPE, node, f"{name}: {declared.type}", "its images", tip)
        return tree.BindingRead(declared.type, span, declared)
    value = getattr(shader, node.attr, MISSING)
    if value is not MISSING:
        return parser.python_value(value, node, node.attr)
    names = [*shader._declared, *(name for name in dir(shader) if not name.startswith("_"))]
    parser.refuse(rules.UNKNOWN_MEMBER, node, f"{shader.__name__}.{node.attr}", tip=suggest(node.attr, names))


def parse_subscript(parser: FunctionParser, node: ast.Subscript) -> Expression:
    base = parser.expression(node.value)
    type, span = base.type, span_of(node)
    if isinstance(type, types.StorageType | layout.ArrayType):
        element: types.Type = type.element
    elif isinstance(type, layout.VectorType):
        element = type.scalar
    elif isinstance(type, layout.MatrixType):
        element = types.VECTORS[layout.FLOAT, type.size]
    else:
        parser.refuse(rules.WRONG_TYPE, node, f"{type}[…]", "arrays, storage, vectors, matrices")
    if isinstance(node.slice, ast.Slice):
        parser.refuse(rules.SYNTAX, node, "a slice", "one index")
    if isinstance(node.slice, ast.Tuple):
        parser.refuse(rules.SYNTAX, node, f"[{ast.unparse(node.slice)}]", "one index", "write m[row][column]")
    index = parser.expression(node.slice)
    if index.type not in (layout.INT, layout.UINT):
        parser.refuse(rules.WRONG_TYPE, node.slice, str(index.type), "int or uint")
    if isinstance(index, Constant):
        index = _constant_index(parser, index, type, node)
    return tree.Index(element, span, base, index)


def _constant_index(
    parser: FunctionParser, index: Constant, type: types.Type, node: ast.Subscript
) -> Constant:
    value = int(index.value)
    if isinstance(type, types.StorageType):
        if value < 0 and not parser.untaken:
            parser.refuse(rules.OUT_OF_RANGE, node.slice, str(value), "0 or more", "count back from len(…)")
        return index
    length = type.length if isinstance(type, layout.ArrayType) else getattr(type, "size", 0)
    if not -length <= value < length and not parser.untaken:
        parser.refuse(rules.OUT_OF_RANGE, node.slice, str(value), f"{-length} to {length - 1}")
    return Constant(layout.INT, index.span, value % length)


# -- for calls and statements


def cast(
    parser: FunctionParser, value: Expression, type: layout.ScalarType | layout.VectorType, span: SourceSpan
) -> Expression:
    """Return an explicit conversion, such as `int(x)`."""
    if value.type == type:
        return value
    if isinstance(value, Constant) and isinstance(type, layout.ScalarType):
        number = value.value
        if isinstance(number, float) and type in (layout.INT, layout.UINT):
            least, most = (0, 2**32 - 1) if type is layout.UINT else (-(2**31), 2**31 - 1)
            if not least - 1 < number < most + 1:
                if not parser.untaken:
                    parser.refuse(rules.OUT_OF_RANGE, span, str(number), f"{least} to {most}")
                number = 0
        if type is layout.UINT:
            return Constant(layout.UINT, span, int(number) & 0xFFFFFFFF)
        converted = {layout.BOOL: bool, layout.INT: int, layout.FLOAT: float}[type](number)
        return Constant(type, span, converted)
    return tree.Convert(type, span, value)


def check_size(parser: FunctionParser, type: types.Type, at: ast.AST, description: str) -> None:
    """Refuse a local array, or a struct with one, that is too large for an invocation."""
    if isinstance(type, layout.ArrayType | layout.StructType) and types.has_array(type):
        scalars = types.count_scalars(type)
        if scalars > MAX_LOCAL:
            actual, tip = (
                f"{description}, {scalars} numbers",
                "use a buffer, StorageRW[…], or memory of the work-group, shared(…)",
            )
            parser.refuse(rules.TOO_LARGE, at, actual, f"up to {MAX_LOCAL} numbers for each invocation", tip)


def check_value(parser: FunctionParser, value: Expression, at: ast.AST) -> None:
    """Refuse a value that can't be held in a variable."""
    if not types.is_value(value.type):
        tip = "textures and buffers are used in place" if not isinstance(value, tree.Call) else ""
        parser.refuse(rules.WRONG_TYPE, at, str(value.type), "a value", tip)


def check_target(parser: FunctionParser, target: Expression, node: ast.AST) -> StorageClass | None:
    root = tree.root_of(target)
    if isinstance(root, tree.Read):
        root.local.writes += 1
        return None
    if not isinstance(root, tree.BindingRead):
        parser.refuse(
            rules.NOT_WRITABLE,
            node,
            "a temporary value",
            "variables, StorageRW, shared memory",
        )
    declaration = root.declaration
    if declaration.storage_class is StorageClass.STORAGE:
        assert isinstance(declaration.type, types.StorageType)
        if not declaration.type.writable:
            tip = f"declare it as StorageRW[{declaration.type.element}]"
            parser.refuse(rules.NOT_WRITABLE, node, f"{declaration.name}: {declaration.type}", tip=tip)
        if root is target:
            parser.refuse(rules.NOT_WRITABLE, node, "a whole buffer", "its elements")
    elif declaration.storage_class is not StorageClass.SHARED:
        parser.refuse(
            rules.NOT_WRITABLE,
            node,
            f"{declaration.name}, a {declaration.storage_class.value}",
            "StorageRW, shared",
        )
    parser.mark_effect()
    return declaration.storage_class


def check_memory(parser: FunctionParser, target: Expression, at: ast.AST) -> None:
    if check_target(parser, target, at) is None or isinstance(target, tree.Swizzle):
        allowed = "an int or uint in storage or shared memory"
        parser.refuse(rules.NOT_WRITABLE, at, "a target that atomics don't support", allowed)


def _operator_tip(op: Operator, left: Expression, right: Expression) -> str:
    a, b = types.scalar_of(left.type), types.scalar_of(right.type)
    vectors = isinstance(left.type, layout.VectorType) or isinstance(right.type, layout.VectorType)
    if op.sign in _ORDER_FUNCTIONS and vectors:
        return f"use {_ORDER_FUNCTIONS[op.sign]}(a, b), which compares by component"
    if op is Operator.MATRIX_MULTIPLY:
        if isinstance(left.type, layout.MatrixType) and isinstance(right.type, layout.VectorType):
            size = left.type.size
            return f"a mat{size} takes a vec{size}" + ("; for a point: vec4(v, 1.0)" if size == 4 else "")
        return "@ multiplies matrices; use dot(a, b) for vectors" if vectors else ""
    if isinstance(left.type, layout.MatrixType) and isinstance(right.type, layout.VectorType):
        return "use @ to multiply a matrix with a vector"
    if {a, b} == {layout.INT, layout.UINT}:
        return "convert one of them: int(…) or uint(…)"
    if layout.BOOL in (a, b) and op in (Operator.BIT_AND, Operator.BIT_OR):
        return "use `and`, `or`"
    if op is Operator.POWER and a in (layout.INT, layout.UINT):
        return "an int's exponent must be a constant of 0 to 16; convert to float otherwise"
    return ""


def member_tip(type: types.Type) -> str:
    """Return a tip for an attribute of a value that has no fields."""
    if isinstance(type, types.StorageType):
        return "storage is an array: index it first"
    if isinstance(type, types.TextureType | types.ImageType):
        return "call its methods: " + ", ".join(methods_of(type))
    return ""
