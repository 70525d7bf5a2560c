"""The parser of calls of functions, built-ins, methods and constructors, with Python's rules for
arguments."""

from __future__ import annotations

import ast
import builtins
from types import BuiltinFunctionType, FunctionType
from typing import Any, Final

from rhi.contract.layout import BOOL, FLOAT, INT, ArrayType, MatrixType, ScalarType, VectorType
from rhi.shading.ir import tree
from rhi.shading.ir.tree import Constant, Expression
from rhi.shading.language import rules
from rhi.shading.language.annotations import value_type
from rhi.shading.language.builtins import BUILTINS, Builtin, SideEffect
from rhi.shading.language.function import ShadingFunction
from rhi.shading.language.source import MISSING, source_of, span_of, suggest
from rhi.shading.language.structs import Struct
from rhi.shading.language.textures import methods_of
from rhi.shading.language.tips import FOREIGN, METHODS
from rhi.shading.language.types import VECTORS, ImageType, StorageType, TextureType, Type, with_scalar
from rhi.shading.language.vectors import array
from rhi.shading.parser.context import FunctionParser
from rhi.shading.parser.expressions import cast, check_memory, check_size, member_tip
from rhi.shading.parser.signatures import Callee, Signature, UnsizedArray, find_method, fits
from rhi.shading.parser.texture_tables import (
    declared_table,
    method_of_table,
    parse_index,
    table_callee,
    table_of,
)

_PYTHON_BUILTINS: Final[dict[Any, Builtin]] = {
    builtins.abs: BUILTINS["abs"],
    builtins.min: BUILTINS["min"],
    builtins.max: BUILTINS["max"],
}


def parse_call(parser: FunctionParser, node: ast.Call) -> Expression:
    for part in node.args:
        if isinstance(part, ast.Starred):
            parser.unsupported(part)
    if any(keyword.arg is None for keyword in node.keywords):
        parser.refuse(rules.SYNTAX, node, "**arguments")
    callee = node.func
    if isinstance(callee, ast.Attribute):
        if parser.is_self(callee.value):
            return _call_method(parser, node, callee.attr, None)
        value = callee.value
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "super":
            return _call_method(parser, node, callee.attr, parser.owner)
    called = parser.static(callee)
    if called is MISSING:
        return _call_on_value(parser, node)
    return _call_object(parser, node, called)


def _call_method(parser: FunctionParser, node: ast.Call, name: str, after: type | None) -> Expression:
    table = table_of(parser.source.function)
    method = table_callee(table, name) if table else find_method(parser.stage.shader, name, after)
    if method is None:
        shader = parser.stage.shader
        if name in shader._declared:
            parser.refuse(rules.WRONG_ARGUMENTS, node, f"{name} is a binding, not a method")
        parser.refuse(
            rules.UNKNOWN_MEMBER, node.func, f"{shader.__name__}.{name}", tip=suggest(name, dir(shader))
        )
    return _call_python(parser, node, method)


def _call_python(
    parser: FunctionParser, node: ast.Call, callee: Callee, first: tuple[Expression, ...] = ()
) -> tree.Call:
    """Return the call of a Python function; `first`: arguments before those of the call, already parsed."""
    signature = callee.signature
    all_names = [parameter.name for parameter in signature.parameters]
    names = all_names[len(first) :]
    nodes_by_name: dict[str, ast.expr] = {}
    if len(node.args) > len(names):
        parser.refuse(rules.WRONG_ARGUMENTS, node, f"{len(node.args)} arguments", ", ".join(names) or "none")
    nodes_by_name.update(zip(names, node.args, strict=False))
    for keyword in node.keywords:
        name = keyword.arg or ""
        if name not in names or name in nodes_by_name:
            problem = "twice" if name in nodes_by_name else "unknown"
            parser.refuse(
                rules.WRONG_ARGUMENTS,
                keyword,
                f"{name}=…, {problem}",
                ", ".join(names),
                suggest(name, names),
            )
        nodes_by_name[name] = keyword.value
    # Python evaluates arguments in the order in which they are written, which is the order of
    # `nodes_by_name`.
    values = {name: _argument(parser, signature, name, at) for name, at in nodes_by_name.items()}
    if [name for name in names if name in nodes_by_name] != list(nodes_by_name) and any(
        map(tree.has_effect, values.values())
    ):
        parser.refuse(rules.EVALUATED_TWICE, node, "side effects in arguments out of order")
    values.update(zip(all_names, first, strict=False))
    for parameter in signature.parameters:
        if parameter.name not in values:
            if parameter.default is MISSING:
                parser.refuse(rules.WRONG_ARGUMENTS, node, f"no {parameter.name!r}", ", ".join(names))
            # As in Python, the value that the default had when the function was defined.
            default = parser.python_value(parameter.default, node, parameter.name)
            if not isinstance(parameter.type, UnsizedArray):
                default = parser.convert(default, parameter.type, node, parameter.name)
            elif not fits(parameter.type, default.type):
                given_type = f"{parameter.name}: {default.type}"
                parser.refuse(rules.WRONG_TYPE, node, given_type, str(parameter.type))
            values[parameter.name] = default
    arguments = tuple(values[name] for name in all_names)
    types = tuple(argument.type for argument in arguments)
    function = parser.stage.instance(callee, types, node, parser.source)
    if function.has_effect:
        parser.mark_effect(is_evaluated=True)
    return tree.Call(function.result, span_of(node), function, arguments)


def _argument(parser: FunctionParser, signature: Signature, name: str, at: ast.expr) -> Expression:
    parameter_type = next(parameter.type for parameter in signature.parameters if parameter.name == name)
    if not isinstance(parameter_type, UnsizedArray):
        return parser.converted(at, parameter_type, name)
    value = parser.expression(at)
    if not fits(parameter_type, value.type):
        parser.refuse(rules.WRONG_TYPE, at, f"{name}: {value.type}", str(parameter_type))
    return value


def _call_on_value(parser: FunctionParser, node: ast.Call) -> Expression:
    if not isinstance(node.func, ast.Attribute):
        parser.refuse(rules.SYNTAX, node, "a call of something that is not a name")
    value = node.func.value
    table = declared_table(parser, value.value) if isinstance(value, ast.Subscript) else None
    if table is not None:
        assert isinstance(value, ast.Subscript)
        method = method_of_table(parser, node, table)
        return _call_python(parser, node, method, (parse_index(parser, value.slice),))
    base = parser.expression(value)
    name = node.func.attr
    if not isinstance(base.type, TextureType | ImageType):
        tip = member_tip(base.type) or _method_tip(name)
        parser.refuse(rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}(…)", tip=tip)
    methods = methods_of(base.type)
    if name not in methods:
        allowed, foreign = ", ".join(methods), METHODS.get(name, "")
        tip = f"use {foreign}(…)" if foreign in methods else suggest(name, methods)
        parser.refuse(rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}", allowed, tip)
    return _call_builtin(parser, node, methods[name], [base])


def _call_object(parser: FunctionParser, node: ast.Call, called: Any) -> Expression:
    if isinstance(called, BuiltinFunctionType):
        called = _PYTHON_BUILTINS.get(called, called)
    if isinstance(called, Builtin):
        return _call_builtin(parser, node, called, [])
    if isinstance(called, ShadingFunction):
        return _call_python(parser, node, Callee(source_of(called.python), None, False))
    if called is builtins.len:
        return _length(parser, node)
    if called is array:
        return _zeros(parser, node)
    if isinstance(called, type) and issubclass(called, Struct):
        return _construct_struct(parser, node, called)
    type_ = value_type(called)
    if type_ is not None:
        return _construct(parser, node, type_)
    name = ast.unparse(node.func)
    if isinstance(called, FunctionType):
        parser.refuse(rules.NOT_SHADING, node.func, name, tip="decorate it with @function of rhi.shading")
    if called is builtins.range:
        parser.refuse(rules.SYNTAX, node, "range(…) outside a for loop")
    called_name = getattr(called, "__name__", "")
    tip = f"use rhi.shading.{called_name}" if called_name in BUILTINS else FOREIGN.get(called_name, "")
    parser.refuse(rules.NOT_SHADING, node.func, name, tip=tip)


def _call_builtin(
    parser: FunctionParser, node: ast.Call, row: Builtin, first: list[Expression]
) -> Expression:
    arguments = [*first, *(parser.expression(argument) for argument in node.args)]
    if node.keywords:
        names = {p.name: i for o in row.overloads for i, p in enumerate(o.parameters) if p.name and i}
        for keyword in node.keywords:
            if names.get(keyword.arg or "") != len(arguments):
                parser.refuse(rules.WRONG_ARGUMENTS, keyword, f"{keyword.arg}=…", row.signatures())
            arguments.append(parser.expression(keyword.value))
    types = [argument.type for argument in arguments]
    literals = [isinstance(a, Constant) and a.literal and a.value >= 0 for a in arguments]
    overload = row.choose(types, literals)
    if overload is None:
        actual = f"{row.name}({', '.join(str(type) for type in types)})"
        parser.refuse(rules.WRONG_ARGUMENTS, node, actual, row.signatures())
    _check_stage(parser, row, node)
    converted = []
    for argument, parameter, at in zip(
        arguments,
        overload.parameters,
        [*[node.func] * len(first), *node.args, *node.keywords],
        strict=True,
    ):
        if parameter.memory:
            check_memory(parser, argument, at)
        converted.append(parser.convert(argument, parameter.type, at))
    if row.name == "gather" and len(converted) == 3:
        component = converted[2]
        if not isinstance(component, Constant) or not 0 <= component.value < 4:
            parser.refuse(
                rules.OUT_OF_RANGE, node.args[-1] if node.args else node, "component", "0 to 3, constant"
            )
    if row.effect is SideEffect.BARRIER or row.effect is SideEffect.WRITE:
        parser.mark_effect(is_evaluated=True)
    return tree.BuiltinCall(overload.result, span_of(node), row, overload, tuple(converted))


def _check_stage(parser: FunctionParser, builtin: Builtin, at: ast.Call) -> None:
    """Refuse a built-in that isn't available in the stage being compiled."""
    stage = parser.stage.stage
    if stage not in builtin.stages:
        allowed = ", ".join(sorted(stage.value for stage in builtin.stages))
        actual = f"{builtin.name} in the {stage.value} stage of {parser.stage.shader.__name__}"
        parser.refuse(rules.STAGE, at, actual, allowed)


def _length(parser: FunctionParser, node: ast.Call) -> Expression:
    if len(node.args) != 1 or node.keywords:
        parser.refuse(rules.WRONG_ARGUMENTS, node, f"len of {len(node.args)} arguments", "len(array)")
    table = declared_table(parser, node.args[0])
    if table is not None:
        count = table_callee(table.name, "count")
        assert count is not None
        return _call_python(parser, ast.copy_location(ast.Call(node.func, [], []), node), count)
    value = parser.expression(node.args[0])
    if isinstance(value.type, ArrayType):
        return Constant(INT, span_of(node), value.type.length, literal=True)
    if not isinstance(value.type, StorageType):
        parser.refuse(rules.WRONG_TYPE, node.args[0], f"len({value.type})", "arrays and storage")
    return tree.Length(INT, span_of(node), value)


def _zeros(parser: FunctionParser, node: ast.Call) -> Expression:
    if len(node.args) != 2 or node.keywords:
        parser.refuse(rules.WRONG_ARGUMENTS, node, ast.unparse(node), "array(element, length)")
    element = value_type(parser.static(node.args[0]))
    length = parser.expression(node.args[1])
    if element is None:
        parser.refuse(rules.WRONG_ARGUMENTS, node.args[0], ast.unparse(node.args[0]), "a value type")
    if not isinstance(length, Constant) or length.type is not INT or length.value < 1:
        parser.refuse(rules.OUT_OF_RANGE, node.args[1], ast.unparse(node.args[1]), "a constant of 1 or more")
    type = ArrayType(element, int(length.value))
    check_size(parser, type, node, ast.unparse(node))
    return tree.Zeros(type, span_of(node))


def _construct_struct(parser: FunctionParser, node: ast.Call, cls: type[Struct]) -> Expression:
    type = cls.shading_type
    names = [field.name for field in type.fields]
    if node.args:
        parser.refuse(rules.WRONG_ARGUMENTS, node, "fields by position", f"by name: {', '.join(names)}")
    keywords = {keyword.arg: keyword for keyword in node.keywords}
    for name, keyword in keywords.items():
        if name not in names:
            tip = suggest(name or "", names)
            parser.refuse(rules.UNKNOWN_MEMBER, keyword, f"{type}.{name}", ", ".join(names), tip)
    parts = {}
    for name, keyword in keywords.items():
        field = type.field(name or "")
        assert field is not None
        parts[name] = parser.converted(keyword.value, field.type, f"{type}.{name}")
    if list(keywords) != [name for name in names if name in keywords] and any(
        map(tree.has_effect, parts.values())
    ):
        # Python evaluates arguments in the order written, a constructor in the order of the fields.
        parser.refuse(rules.EVALUATED_TWICE, node, "side effects in fields out of order")
    for field in type.fields:
        if field.name not in parts:
            if field.name not in cls._defaults:
                parser.refuse(rules.WRONG_ARGUMENTS, node, f"no {field.name!r}", ", ".join(names))
            default = parser.python_value(cls._defaults[field.name], node, field.name)
            parts[field.name] = parser.convert(default, field.type, node)
    return tree.Construct(type, span_of(node), tuple(parts[name] for name in names))


def _construct(parser: FunctionParser, node: ast.Call, type: Type) -> Expression:
    if node.keywords:
        parser.refuse(rules.WRONG_ARGUMENTS, node, f"{node.keywords[0].arg}=…", "arguments by position")
    parts = [parser.expression(argument) for argument in node.args]
    span = span_of(node)
    types = ", ".join(str(part.type) for part in parts)
    if isinstance(type, ScalarType):
        if len(parts) == 1 and isinstance(parts[0].type, ScalarType):
            return cast(parser, parts[0], type, span)
    elif isinstance(type, VectorType):
        only = parts[0] if len(parts) == 1 else None
        if only is not None and isinstance(only.type, VectorType) and only.type.size == type.size:
            return cast(parser, only, type, span)
        if only is not None and isinstance(only.type, ScalarType):
            return tree.Construct(type, span, (_component(parser, only, type, node.args[0]),))
        if sum(getattr(part.type, "size", 1) for part in parts) == type.size and len(parts) > 1:
            components = [_component(parser, p, type, at) for p, at in zip(parts, node.args, strict=True)]
            return tree.Construct(type, span, tuple(components))
    elif isinstance(type, MatrixType):
        row = VECTORS[FLOAT, type.size]
        if len(parts) == 1 and isinstance(parts[0].type, MatrixType):
            return tree.Construct(type, span, tuple(parts))
        if len(parts) == type.size and all(part.type == row for part in parts):
            return tree.Construct(type, span, tuple(parts))
        if len(parts) in (1, type.size**2):
            scalars = [parser.convert(p, FLOAT, at) for p, at in zip(parts, node.args, strict=True)]
            return tree.Construct(type, span, tuple(scalars))
    parser.refuse(rules.WRONG_ARGUMENTS, node, f"{type}({types})", _constructor_tip(type))


def _component(parser: FunctionParser, part: Expression, type: VectorType, at: ast.AST) -> Expression:
    if isinstance(part.type, ScalarType) and part.type is not BOOL:
        target_type: Type = type.scalar
    elif isinstance(part.type, ScalarType | VectorType):
        target_type = with_scalar(part.type, type.scalar)
    else:
        target_type = type
    return parser.convert(part, target_type, at)


def _method_tip(name: str) -> str:
    """Return a tip for a method call on a value; values of the language have no methods."""
    if name in BUILTINS:
        return f"write {name}(…) with the value as an argument"
    return FOREIGN.get(name, "")


def _constructor_tip(type: Type) -> str:
    if isinstance(type, VectorType):
        return f"{type.size} components in total, one scalar for all, or another vector of {type.size}"
    if isinstance(type, MatrixType):
        return (
            f"{type.size} rows, {type.size**2} numbers row by row, one number for the diagonal, or a matrix"
        )
    return "one scalar"
