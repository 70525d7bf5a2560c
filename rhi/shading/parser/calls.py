"""The parser of calls of functions, built-ins, methods and constructors, with Python's rules for arguments."""

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
from rhi.shading.parser.expressions import ExpressionParser, member_tip
from rhi.shading.parser.signatures import Callee, Signature, UnsizedArray, fits

_PYTHON_BUILTINS: Final[dict[Any, Builtin]] = {
    builtins.abs: BUILTINS["abs"],
    builtins.min: BUILTINS["min"],
    builtins.max: BUILTINS["max"],
}


class CallParser(ExpressionParser):
    """Parses the calls of one function."""

    def _call(self, node: ast.Call) -> Expression:
        for part in node.args:
            if isinstance(part, ast.Starred):
                self.unsupported(part)
        if any(keyword.arg is None for keyword in node.keywords):
            self.refuse(rules.SYNTAX, node, "**arguments")
        callee = node.func
        if isinstance(callee, ast.Attribute):
            if self.is_self(callee.value):
                return self._call_method(node, callee.attr, None)
            value = callee.value
            if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id == "super":
                return self._call_method(node, callee.attr, self.owner)
        found = self.static(callee)
        if found is MISSING:
            return self._call_on_value(node)
        return self._call_object(node, found)

    def _call_method(self, node: ast.Call, name: str, after: type | None) -> Expression:
        found = self.stage_context.method(name, after)
        if found is None:
            shader = self.stage_context.shader
            if name in shader._declared:
                self.refuse(rules.WRONG_ARGUMENTS, node, f"{name} is a binding, not a method")
            self.refuse(rules.UNKNOWN_MEMBER, node.func, f"{shader.__name__}.{name}", tip=suggest(name, dir(shader)))
        return self._call_python(node, found)

    def _call_python(self, node: ast.Call, callee: Callee) -> tree.Call:
        signature = callee.signature
        names = [parameter.name for parameter in signature.parameters]
        given: dict[str, ast.expr] = {}
        if len(node.args) > len(names):
            self.refuse(rules.WRONG_ARGUMENTS, node, f"{len(node.args)} arguments", ", ".join(names) or "none")
        given.update(zip(names, node.args, strict=False))
        for keyword in node.keywords:
            name = keyword.arg or ""
            if name not in names or name in given:
                what = "twice" if name in given else "unknown"
                self.refuse(
                    rules.WRONG_ARGUMENTS,
                    keyword,
                    f"{name}=…, {what}",
                    ", ".join(names),
                    suggest(name, names),
                )
            given[name] = keyword.value
        # Python evaluates arguments in the order in which they are written, which is the order of `given`.
        values = {name: self._argument(signature, name, at) for name, at in given.items()}
        if [name for name in names if name in given] != list(given) and any(map(tree.has_effect, values.values())):
            self.refuse(rules.EVALUATED_TWICE, node, "side effects in arguments out of order")
        for parameter in signature.parameters:
            if parameter.name not in values:
                if parameter.default is MISSING:
                    self.refuse(rules.WRONG_ARGUMENTS, node, f"no {parameter.name!r}", ", ".join(names))
                # As in Python, the value that the default had when the function was defined.
                default = self.python_value(parameter.default, node, parameter.name)
                if not isinstance(parameter.type, UnsizedArray):
                    default = self.convert(default, parameter.type, node, parameter.name)
                elif not fits(parameter.type, default.type):
                    given_type = f"{parameter.name}: {default.type}"
                    self.refuse(rules.WRONG_TYPE, node, given_type, str(parameter.type))
                values[parameter.name] = default
        arguments = tuple(values[name] for name in names)
        types = tuple(argument.type for argument in arguments)
        function = self.stage_context.instance(callee, types, node, self.source)
        if function.has_effect:
            self.mark_effect()
        return tree.Call(function.result, span_of(node), function, arguments)

    def _argument(self, signature: Signature, name: str, at: ast.expr) -> Expression:
        wanted = next(parameter.type for parameter in signature.parameters if parameter.name == name)
        if not isinstance(wanted, UnsizedArray):
            return self.converted(at, wanted, name)
        value = self.expression(at)
        if not fits(wanted, value.type):
            self.refuse(rules.WRONG_TYPE, at, f"{name}: {value.type}", str(wanted))
        return value

    def _call_on_value(self, node: ast.Call) -> Expression:
        if not isinstance(node.func, ast.Attribute):
            self.refuse(rules.SYNTAX, node, "a call of something that is not a name")
        base = self.expression(node.func.value)
        name = node.func.attr
        if not isinstance(base.type, TextureType | ImageType):
            tip = member_tip(base.type) or _method_tip(name)
            self.refuse(rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}(…)", tip=tip)
        methods = methods_of(base.type)
        if name not in methods:
            allowed, foreign = ", ".join(methods), METHODS.get(name, "")
            tip = f"use {foreign}(…)" if foreign in methods else suggest(name, methods)
            self.refuse(rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}", allowed, tip)
        return self._call_builtin(node, methods[name], [base])

    def _call_object(self, node: ast.Call, found: Any) -> Expression:
        if isinstance(found, BuiltinFunctionType):
            found = _PYTHON_BUILTINS.get(found, found)
        if isinstance(found, Builtin):
            return self._call_builtin(node, found, [])
        if isinstance(found, ShadingFunction):
            return self._call_python(node, Callee(source_of(found.python), None, False))
        if found is builtins.len:
            return self._length(node)
        if found is array:
            return self._zeros(node)
        if isinstance(found, type) and issubclass(found, Struct):
            return self._construct_struct(node, found)
        type_ = value_type(found)
        if type_ is not None:
            return self._construct(node, type_)
        name = ast.unparse(node.func)
        if isinstance(found, FunctionType):
            self.refuse(rules.NOT_SHADING, node.func, name, tip="decorate it with @function of rhi.shading")
        if found is builtins.range:
            self.refuse(rules.SYNTAX, node, "range(…) outside a for loop")
        known = getattr(found, "__name__", "")
        tip = f"use rhi.shading.{known}" if known in BUILTINS else FOREIGN.get(known, "")
        self.refuse(rules.NOT_SHADING, node.func, name, tip=tip)

    def _call_builtin(self, node: ast.Call, row: Builtin, first: list[Expression]) -> Expression:
        arguments = [*first, *(self.expression(argument) for argument in node.args)]
        if node.keywords:
            names = {p.name: i for o in row.overloads for i, p in enumerate(o.parameters) if p.name and i}
            for keyword in node.keywords:
                if names.get(keyword.arg or "") != len(arguments):
                    self.refuse(rules.WRONG_ARGUMENTS, keyword, f"{keyword.arg}=…", row.signatures())
                arguments.append(self.expression(keyword.value))
        types = [argument.type for argument in arguments]
        literals = [isinstance(a, Constant) and a.literal and a.value >= 0 for a in arguments]
        overload = row.choose(types, literals)
        if overload is None:
            given = f"{row.name}({', '.join(str(type) for type in types)})"
            self.refuse(rules.WRONG_ARGUMENTS, node, given, row.signatures())
        self.stage_context.check_stage(row, node, self.source)
        converted = []
        for argument, parameter, at in zip(
            arguments,
            overload.parameters,
            [*[node.func] * len(first), *node.args, *node.keywords],
            strict=True,
        ):
            if parameter.memory:
                self.check_memory(argument, at)
            converted.append(self.convert(argument, parameter.type, at))
        if row.name == "gather" and len(converted) == 3:
            component = converted[2]
            if not isinstance(component, Constant) or not 0 <= component.value < 4:
                self.refuse(rules.OUT_OF_RANGE, node.args[-1] if node.args else node, "component", "0 to 3, constant")
        if row.effect is SideEffect.BARRIER or row.effect is SideEffect.WRITE:
            self.mark_effect()
        return tree.BuiltinCall(overload.result, span_of(node), row, overload, tuple(converted))

    def check_memory(self, target: Expression, at: ast.AST) -> None:
        """Refuse an atomic's first argument unless it is an lvalue in writable storage or shared memory."""
        raise NotImplementedError

    def mark_effect(self) -> None:
        """Record that the function has side effects."""
        raise NotImplementedError

    def _length(self, node: ast.Call) -> Expression:
        if len(node.args) != 1 or node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, f"len of {len(node.args)} arguments", "len(array)")
        value = self.expression(node.args[0])
        if isinstance(value.type, ArrayType):
            return Constant(INT, span_of(node), value.type.length, literal=True)
        if not isinstance(value.type, StorageType):
            self.refuse(rules.WRONG_TYPE, node.args[0], f"len({value.type})", "arrays and storage")
        return tree.Length(INT, span_of(node), value)

    def _zeros(self, node: ast.Call) -> Expression:
        if len(node.args) != 2 or node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, ast.unparse(node), "array(element, length)")
        element = value_type(self.static(node.args[0]))
        length = self.expression(node.args[1])
        if element is None:
            self.refuse(rules.WRONG_ARGUMENTS, node.args[0], ast.unparse(node.args[0]), "a value type")
        if not isinstance(length, Constant) or length.type is not INT or length.value < 1:
            self.refuse(rules.OUT_OF_RANGE, node.args[1], ast.unparse(node.args[1]), "a constant of 1 or more")
        type = ArrayType(element, int(length.value))
        self.check_size(type, node, ast.unparse(node))
        return tree.Zeros(type, span_of(node))

    def _construct_struct(self, node: ast.Call, cls: type[Struct]) -> Expression:
        type = cls.shading_type
        names = [field.name for field in type.fields]
        if node.args:
            self.refuse(rules.WRONG_ARGUMENTS, node, "fields by position", f"by name: {', '.join(names)}")
        given = {keyword.arg: keyword for keyword in node.keywords}
        for name, keyword in given.items():
            if name not in names:
                tip = suggest(name or "", names)
                self.refuse(rules.UNKNOWN_MEMBER, keyword, f"{type}.{name}", ", ".join(names), tip)
        parts = {}
        for name, keyword in given.items():
            field = type.field(name or "")
            assert field is not None
            parts[name] = self.converted(keyword.value, field.type, f"{type}.{name}")
        if list(given) != [name for name in names if name in given] and any(map(tree.has_effect, parts.values())):
            # Python evaluates arguments in the order written, a constructor in the order of the fields.
            self.refuse(rules.EVALUATED_TWICE, node, "side effects in fields out of order")
        for field in type.fields:
            if field.name not in parts:
                if field.name not in cls._defaults:
                    self.refuse(rules.WRONG_ARGUMENTS, node, f"no {field.name!r}", ", ".join(names))
                default = self.python_value(cls._defaults[field.name], node, field.name)
                parts[field.name] = self.convert(default, field.type, node)
        return tree.Construct(type, span_of(node), tuple(parts[name] for name in names))

    def _construct(self, node: ast.Call, type: Type) -> Expression:
        if node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, f"{node.keywords[0].arg}=…", "arguments by position")
        parts = [self.expression(argument) for argument in node.args]
        span = span_of(node)
        types = ", ".join(str(part.type) for part in parts)
        if isinstance(type, ScalarType):
            if len(parts) == 1 and isinstance(parts[0].type, ScalarType):
                return self.cast(parts[0], type, span)
        elif isinstance(type, VectorType):
            only = parts[0] if len(parts) == 1 else None
            if only is not None and isinstance(only.type, VectorType) and only.type.size == type.size:
                return self.cast(only, type, span)
            if only is not None and isinstance(only.type, ScalarType):
                return tree.Construct(type, span, (self._component(only, type, node.args[0]),))
            if sum(getattr(part.type, "size", 1) for part in parts) == type.size and len(parts) > 1:
                components = [self._component(p, type, at) for p, at in zip(parts, node.args, strict=True)]
                return tree.Construct(type, span, tuple(components))
        elif isinstance(type, MatrixType):
            row = VECTORS[FLOAT, type.size]
            if len(parts) == 1 and isinstance(parts[0].type, MatrixType):
                return tree.Construct(type, span, tuple(parts))
            if len(parts) == type.size and all(part.type == row for part in parts):
                return tree.Construct(type, span, tuple(parts))
            if len(parts) in (1, type.size**2):
                scalars = [self.convert(p, FLOAT, at) for p, at in zip(parts, node.args, strict=True)]
                return tree.Construct(type, span, tuple(scalars))
        self.refuse(rules.WRONG_ARGUMENTS, node, f"{type}({types})", _constructor_tip(type))

    def _component(self, part: Expression, type: VectorType, at: ast.AST) -> Expression:
        if isinstance(part.type, ScalarType) and part.type is not BOOL:
            wanted: Type = type.scalar
        elif isinstance(part.type, ScalarType | VectorType):
            wanted = with_scalar(part.type, type.scalar)
        else:
            wanted = type
        return self.convert(part, wanted, at)


def _method_tip(name: str) -> str:
    """Return a tip for a call of a value's method: the values of the language have none."""
    if name in BUILTINS:
        return f"write {name}(…) with the value as an argument"
    return FOREIGN.get(name, "")


def _constructor_tip(type: Type) -> str:
    if isinstance(type, VectorType):
        return f"{type.size} components in total, one scalar for all, or another vector of {type.size}"
    if isinstance(type, MatrixType):
        return f"{type.size} rows, {type.size**2} numbers row by row, one number for the diagonal, or a matrix"
    return "one scalar"
