"""From Python's syntax to typed expressions.

`ExpressionParser` handles one function; what a name is depends on the function's variables
(`rhi.shading.statements`), and a call of another function on the stage being compiled (`Program`).
"""

from __future__ import annotations

import ast
import builtins
import enum
import numbers
from dataclasses import dataclass
from types import BuiltinFunctionType, FunctionType, ModuleType
from typing import Any, Final, NoReturn, Protocol

from rhi.layout import BOOL, FLOAT, INT, UINT, ArrayType, MatrixType, ScalarType, StructType, VectorType
from rhi.shading import rules, tree
from rhi.shading.annotations import value_type
from rhi.shading.builtins import BUILTINS, Builtin, Effect
from rhi.shading.function import Function
from rhi.shading.operators import binary, convert, unary
from rhi.shading.shader import Declaration, Shader
from rhi.shading.signatures import AnyLength, Signature, fits
from rhi.shading.source import MISSING, Place, Source, place_of, suggest
from rhi.shading.structs import Struct
from rhi.shading.textures import methods_of
from rhi.shading.tree import Constant, Expression, Operator
from rhi.shading.types import (
    VECTORS,
    ImageType,
    StorageType,
    TextureType,
    Type,
    is_value,
    scalar_of,
    with_scalar,
)
from rhi.shading.vectors import Composite, array

__rhi_internal__ = True

BINARY: Final[dict[type[ast.operator], Operator]] = {
    ast.Add: Operator.ADD,
    ast.Sub: Operator.SUBTRACT,
    ast.Mult: Operator.MULTIPLY,
    ast.Div: Operator.DIVIDE,
    ast.FloorDiv: Operator.FLOOR_DIVIDE,
    ast.Mod: Operator.MODULO,
    ast.Pow: Operator.POWER,
    ast.MatMult: Operator.MATRIX_MULTIPLY,
    ast.BitAnd: Operator.BIT_AND,
    ast.BitOr: Operator.BIT_OR,
    ast.BitXor: Operator.BIT_XOR,
    ast.LShift: Operator.SHIFT_LEFT,
    ast.RShift: Operator.SHIFT_RIGHT,
}
_UNARY: Final[dict[type[ast.unaryop], Operator]] = {
    ast.USub: Operator.NEGATE,
    ast.Invert: Operator.INVERT,
    ast.Not: Operator.NOT,
}
_COMPARE: Final[dict[type[ast.cmpop], Operator]] = {
    ast.Eq: Operator.EQUAL,
    ast.NotEq: Operator.NOT_EQUAL,
    ast.Lt: Operator.LESS,
    ast.LtE: Operator.LESS_EQUAL,
    ast.Gt: Operator.GREATER,
    ast.GtE: Operator.GREATER_EQUAL,
}
_ORDER_FUNCTIONS: Final = {
    "<": "less_than",
    "<=": "less_than_equal",
    ">": "greater_than",
    ">=": "greater_than_equal",
}
_PYTHON_BUILTINS: Final[dict[Any, Builtin]] = {
    builtins.abs: BUILTINS["abs"],
    builtins.min: BUILTINS["min"],
    builtins.max: BUILTINS["max"],
}
_AXES: Final = ("xyzw", "rgba")


class Program(Protocol):
    """What an expression needs of the stage being compiled."""

    shader: type[Shader]

    def method(self, name: str, after: type | None) -> Callee | None:
        """The shader's method of that name, or its bases' beyond `after`."""

    def signature(self, callee: Callee) -> Signature:
        """What the function takes and gives."""

    def instance(
        self, callee: Callee, types: tuple[Type, ...], at: ast.Call, caller: Source
    ) -> tree.Function:
        """The function compiled for arguments of these types."""

    def check_stage(self, builtin: Builtin, at: ast.Call, caller: Source) -> None:
        """Refuse a built-in that the stage being compiled hasn't got."""


@dataclass(frozen=True, slots=True)
class Callee:
    """A Python function to call; `owner` is the class that defines it, None for a module-level function."""

    source: Source
    owner: type | None
    has_self: bool


class ExpressionParser:
    """Parses the expressions of one function."""

    def __init__(self, program: Program, source: Source, owner: type | None, self_name: str | None) -> None:
        self.program = program
        self.source = source
        self.owner = owner
        self.self_name = self_name

    # -- what statements provide

    def read(self, name: str, at: ast.Name) -> Expression | None:
        """The variable of that name, or None if the function has none."""
        return None

    # -- entry points

    def expression(self, node: ast.expr, wanted: Type | None = None) -> Expression:
        """The typed expression; `wanted` gives a tuple its type and is not enforced otherwise."""
        if isinstance(node, ast.Tuple) and isinstance(wanted, VectorType):
            parts = tuple(self.converted(part, wanted.scalar) for part in node.elts)
            if len(parts) != wanted.size:
                self.refuse(rules.WRONG_TYPE, node, f"{len(parts)} components", str(wanted))
            return tree.Construct(wanted, place_of(node), parts)
        parse = getattr(self, f"_{type(node).__name__.lower()}", None)
        if parse is None:
            self.unsupported(node)
        result: Expression = parse(node)
        return result

    def converted(self, node: ast.expr, wanted: Type, what: str = "") -> Expression:
        """The expression as a value of type `wanted`, or a refusal."""
        value = self.expression(node, wanted)
        return self.convert(value, wanted, node, what)

    def convert(self, value: Expression, wanted: Type, at: ast.AST, what: str = "") -> Expression:
        """`value` as `wanted`, or a refusal at `at`."""
        result = convert(value, wanted)
        if result is None:
            given = f"{what}: {value.type}" if what else str(value.type)
            self.refuse(rules.WRONG_TYPE, at, given, str(wanted), _conversion_tip(value.type, wanted))
        return result

    def condition(self, node: ast.expr) -> Expression:
        """The expression as a bool."""
        value = self.expression(node)
        if value.type is not BOOL:
            tip = "write the comparison: `!= 0`" if isinstance(value.type, ScalarType) else ""
            if isinstance(value.type, VectorType) and value.type.scalar is BOOL:
                tip = "use any(…) or all(…)"
            self.refuse(rules.WRONG_TYPE, node, str(value.type), "bool", tip)
        return value

    def refuse(
        self, rule: Any, at: ast.AST | Place, given: str = "", allowed: str = "", tip: str = ""
    ) -> NoReturn:
        self.source.refuse(rule, at, given, allowed, tip)

    def unsupported(self, node: ast.AST, tip: str = "") -> NoReturn:
        self.refuse(rules.SYNTAX, node, f"a {type(node).__name__} expression", tip=tip)

    # -- leaves

    def _constant(self, node: ast.Constant) -> Expression:
        constant = self.constant(node.value, place_of(node), "")
        if constant is None:
            self.refuse(rules.SYNTAX, node, f"a {type(node.value).__name__}", "numbers and bools")
        return constant

    def _name(self, node: ast.Name) -> Expression:
        variable = self.read(node.id, node)
        if variable is not None:
            return variable
        return self._as_expression(self._static_name(node), node, node.id)

    def _static_name(self, node: ast.Name) -> Any:
        found = self.source.scope.find(node.id)
        if found is MISSING:
            tip = suggest(node.id, [*self.variable_names(), *self.source.scope.names(), *BUILTINS])
            if not tip and node.id in BUILTINS:
                tip = f"import it: from rhi.shading import {node.id}"
            self.refuse(rules.UNKNOWN_NAME, node, repr(node.id), tip=tip)
        return found

    def variable_names(self) -> list[str]:
        """The function's own names, for suggestions."""
        return []

    def _as_expression(self, found: Any, node: ast.expr, name: str) -> Expression:
        constant = self.constant(found, place_of(node), name)
        if constant is None:
            self.refuse(
                rules.NOT_SHADING,
                node,
                f"{name}, a {type(found).__name__}",
                "numbers, vectors, and tuples of them",
                "functions and types can be called, but not used as values" if callable(found) else "",
            )
        return constant

    def constant(self, value: Any, place: Place, name: str) -> Expression | None:
        """A Python value as a constant, or None if it can't be one."""
        if isinstance(value, enum.Enum) and isinstance(value, int):
            value = int(value)
        if isinstance(value, bool):
            return Constant(BOOL, place, value)
        if isinstance(value, numbers.Integral):
            if isinstance(getattr(type(value), "shading_type", None), ScalarType):
                return Constant(UINT, place, int(value))
            if not -(2**31) <= int(value) < 2**32:
                self.refuse(rules.OUT_OF_RANGE, place, str(value), "32 bits")
            return Constant(INT, place, int(value), literal=True)
        if isinstance(value, numbers.Real):
            return Constant(FLOAT, place, float(value))
        if isinstance(value, Composite):
            scalar = scalar_of(value.shading_type) or FLOAT
            parts = [Constant(scalar, place, component) for component in value.components]
            return tree.Construct(value.shading_type, place, tuple(parts))
        if isinstance(value, tuple) and value:
            return self._constant_array(value, place, name)
        return None

    def _constant_array(self, value: tuple[Any, ...], place: Place, name: str) -> Expression | None:
        elements = [self.constant(part, place, name) for part in value]
        types = [element.type for element in elements if element is not None]
        if len(types) != len(elements):
            return None
        element_type = FLOAT if set(types) == {INT, FLOAT} else types[0]
        converted = [convert(element, element_type) for element in elements if element is not None]
        if any(element is None for element in converted) or not isinstance(
            element_type, ScalarType | VectorType
        ):
            return None
        parts = tuple(element for element in converted if element is not None)
        return tree.ConstantArray(ArrayType(element_type, len(parts)), place, name, parts)

    # -- operators

    def _unaryop(self, node: ast.UnaryOp) -> Expression:
        operand = self.expression(node.operand)
        if isinstance(node.op, ast.UAdd):
            return operand
        op = _UNARY[type(node.op)]
        result = unary(op, operand, place_of(node))
        if result is None:
            tip = "use invert(v)" if op is Operator.NOT and isinstance(operand.type, VectorType) else ""
            self.refuse(rules.WRONG_TYPE, node, f"{op.value} {operand.type}", tip=tip)
        return result

    def _binop(self, node: ast.BinOp) -> Expression:
        return self.binary(
            BINARY[type(node.op)], self.expression(node.left), self.expression(node.right), node
        )

    def binary(self, op: Operator, left: Expression, right: Expression, at: ast.AST) -> Expression:
        """A typed binary operation, or a refusal."""
        try:
            result = binary(op, left, right, place_of(at))
        except (ZeroDivisionError, OverflowError, ValueError, TypeError) as error:
            self.refuse(rules.OUT_OF_RANGE, at, str(error))
        if result is None:
            self.refuse(
                rules.WRONG_TYPE,
                at,
                f"{left.type} {op.value} {right.type}",
                tip=_operator_tip(op, left, right),
            )
        return result

    def _boolop(self, node: ast.BoolOp) -> Expression:
        op = Operator.AND if isinstance(node.op, ast.And) else Operator.OR
        result = self.condition(node.values[0])
        for value in node.values[1:]:
            result = self.binary(op, result, self.condition(value), node)
        return result

    def _compare(self, node: ast.Compare) -> Expression:
        left = self.expression(node.left)
        result: Expression | None = None
        for index, (op, right_node) in enumerate(zip(node.ops, node.comparators, strict=True)):
            if type(op) not in _COMPARE:
                self.refuse(rules.SYNTAX, node, f"`{ast.unparse(node)}`", "== != < <= > >=")
            right = self.expression(right_node)
            if index + 1 < len(node.ops) and tree.has_effect(right):
                self.refuse(rules.EVALUATED_TWICE, right_node)
            one = self.binary(_COMPARE[type(op)], left, right, node)
            result = one if result is None else self.binary(Operator.AND, result, one, node)
            left = right
        assert result is not None
        return result

    def _ifexp(self, node: ast.IfExp) -> Expression:
        condition = self.condition(node.test)
        then, otherwise = self.expression(node.body), self.expression(node.orelse)
        if isinstance(condition, Constant):
            return then if condition.value else otherwise
        for value, other in ((then, otherwise), (otherwise, then)):
            converted = convert(value, other.type)
            if converted is not None:
                pair = (converted, other) if value is then else (other, converted)
                return tree.Select(other.type, place_of(node), condition, *pair)
        self.refuse(rules.WRONG_TYPE, node, f"{then.type} or {otherwise.type}", "one type")

    # -- members and elements

    def is_self(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Name) and node.id == self.self_name

    def static(self, node: ast.expr) -> Any:
        """The Python object that a dotted name means outside the shader, or `MISSING`."""
        if isinstance(node, ast.Name):
            if self.is_self(node) or self.has_variable(node.id):
                return MISSING
            return self._static_name(node)
        if isinstance(node, ast.Attribute):
            base = self.static(node.value)
            if isinstance(base, ModuleType | type):
                found = getattr(base, node.attr, MISSING)
                if found is MISSING:
                    tip = suggest(node.attr, dir(base))
                    self.refuse(rules.UNKNOWN_NAME, node, repr(ast.unparse(node)), tip=tip)
                return found
        return MISSING

    def has_variable(self, name: str) -> bool:
        """Whether the function has a variable of that name."""
        return False

    def _attribute(self, node: ast.Attribute) -> Expression:
        if self.is_self(node.value):
            return self._field_of_shader(node)
        found = self.static(node)
        if found is not MISSING:
            return self._as_expression(found, node, node.attr)
        base = self.expression(node.value)
        place = place_of(node)
        if isinstance(base.type, StructType):
            field = base.type.field(node.attr)
            if field is None:
                names = [field.name for field in base.type.fields]
                tip = suggest(node.attr, names)
                self.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", ", ".join(names), tip)
            return tree.Member(field.type, place, base, node.attr)
        if isinstance(base.type, VectorType):
            return self._swizzle(base, base.type, node)
        self.refuse(rules.UNKNOWN_MEMBER, node, f"{base.type}.{node.attr}", tip=_member_tip(base.type))

    def _swizzle(self, base: Expression, type: VectorType, node: ast.Attribute) -> Expression:
        for axes in _AXES:
            places = tuple(axes[: type.size].find(letter) for letter in node.attr)
            if len(places) <= 4 and min(places) >= 0:
                result = type.scalar if len(places) == 1 else VECTORS[type.scalar, len(places)]
                return tree.Swizzle(result, place_of(node), base, places)
        allowed = " or ".join(axes[: type.size] for axes in _AXES)
        self.refuse(rules.UNKNOWN_MEMBER, node, f"{type}.{node.attr}", f"up to 4 of {allowed}")

    def _field_of_shader(self, node: ast.Attribute) -> Expression:
        shader, place = self.program.shader, place_of(node)
        declared: Declaration | None = shader._declared.get(node.attr)
        if declared is not None:
            return tree.BindingRead(declared.type, place, declared)
        found = getattr(shader, node.attr, MISSING)
        constant = self.constant(found, place, node.attr) if found is not MISSING else None
        if constant is None:
            names = [*shader._declared, *(name for name in dir(shader) if not name.startswith("_"))]
            self.refuse(
                rules.UNKNOWN_MEMBER, node, f"{shader.__name__}.{node.attr}", tip=suggest(node.attr, names)
            )
        return constant

    def _subscript(self, node: ast.Subscript) -> Expression:
        base = self.expression(node.value)
        type, place = base.type, place_of(node)
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
            self.refuse(
                rules.SYNTAX, node, f"[{ast.unparse(node.slice)}]", "one index", "write m[row][column]"
            )
        index = self.expression(node.slice)
        if index.type not in (INT, UINT):
            self.refuse(rules.WRONG_TYPE, node.slice, str(index.type), "int or uint")
        if isinstance(index, Constant):
            index = self._constant_index(index, type, node)
        return tree.Index(element, place, base, index)

    def _constant_index(self, index: Constant, type: Type, node: ast.Subscript) -> Constant:
        value = int(index.value)
        if isinstance(type, StorageType):
            if value < 0:
                self.refuse(rules.OUT_OF_RANGE, node.slice, str(value), "0 or more", "count from len(…)")
            return index
        length = type.length if isinstance(type, ArrayType) else getattr(type, "size", 0)
        if not -length <= value < length:
            self.refuse(rules.OUT_OF_RANGE, node.slice, str(value), f"{-length} to {length - 1}")
        return Constant(INT, index.place, value % length)

    # -- calls

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
        found = self.program.method(name, after)
        if found is None:
            shader = self.program.shader
            if name in shader._declared:
                self.refuse(rules.WRONG_ARGUMENTS, node, f"{name} is a binding, not a method")
            self.refuse(
                rules.UNKNOWN_MEMBER, node.func, f"{shader.__name__}.{name}", tip=suggest(name, dir(shader))
            )
        return self._call_python(node, found)

    def _call_python(self, node: ast.Call, callee: Callee) -> tree.Call:
        signature = self.program.signature(callee)
        names = [parameter.name for parameter in signature.parameters]
        given: dict[str, ast.expr] = {}
        if len(node.args) > len(names):
            self.refuse(
                rules.WRONG_ARGUMENTS, node, f"{len(node.args)} arguments", ", ".join(names) or "none"
            )
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
        # Arguments are evaluated in the order written, which is the order of `given`.
        values = {name: self._argument(callee, signature, name, at) for name, at in given.items()}
        if [name for name in names if name in given] != list(given) and any(
            map(tree.has_effect, values.values())
        ):
            self.refuse(rules.EVALUATED_TWICE, node, "side effects in arguments out of order")
        for parameter in signature.parameters:
            if parameter.name not in values:
                default = self._default(callee, parameter.default, node)
                if default is None:
                    self.refuse(rules.WRONG_ARGUMENTS, node, f"no {parameter.name!r}", ", ".join(names))
                assert not isinstance(parameter.type, AnyLength)
                values[parameter.name] = self.convert(default, parameter.type, node)
        arguments = tuple(values[name] for name in names)
        types = tuple(argument.type for argument in arguments)
        function = self.program.instance(callee, types, node, self.source)
        if function.has_effect:
            self.mark_effect()
        return tree.Call(function.result, place_of(node), function, arguments)

    def _argument(self, callee: Callee, signature: Signature, name: str, at: ast.expr) -> Expression:
        wanted = next(parameter.type for parameter in signature.parameters if parameter.name == name)
        if not isinstance(wanted, AnyLength):
            return self.converted(at, wanted, name)
        value = self.expression(at)
        if not fits(wanted, value.type):
            self.refuse(rules.WRONG_TYPE, at, f"{name}: {value.type}", str(wanted))
        return value

    def _default(self, callee: Callee, default: ast.expr | None, node: ast.Call) -> Expression | None:
        if default is None:
            return None
        return ExpressionParser(self.program, callee.source, None, None).expression(default)

    def _call_on_value(self, node: ast.Call) -> Expression:
        if not isinstance(node.func, ast.Attribute):
            self.refuse(rules.SYNTAX, node, "a call of something that is not a name")
        base = self.expression(node.func.value)
        name = node.func.attr
        if not isinstance(base.type, TextureType | ImageType):
            self.refuse(rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}(…)", tip=_member_tip(base.type))
        methods = methods_of(base.type)
        if name not in methods:
            allowed = ", ".join(methods)
            self.refuse(
                rules.UNKNOWN_MEMBER, node.func, f"{base.type}.{name}", allowed, suggest(name, methods)
            )
        return self._call_builtin(node, methods[name], [base])

    def _call_object(self, node: ast.Call, found: Any) -> Expression:
        if isinstance(found, BuiltinFunctionType):
            found = _PYTHON_BUILTINS.get(found, found)
        if isinstance(found, Builtin):
            return self._call_builtin(node, found, [])
        if isinstance(found, Function):
            return self._call_python(node, Callee(found.source, None, False))
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
        tip = f"use rhi.shading.{known}" if known in BUILTINS else ""
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
        self.program.check_stage(row, node, self.source)
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
                self.refuse(
                    rules.OUT_OF_RANGE, node.args[-1] if node.args else node, "component", "0 to 3, constant"
                )
        if row.effect is Effect.BARRIER or row.effect is Effect.WRITE:
            self.mark_effect()
        return tree.BuiltinCall(overload.result, place_of(node), row, overload, tuple(converted))

    def check_memory(self, place: Expression, at: ast.AST) -> None:
        """Refuse an atomic's first argument unless it is a place in writable storage or shared memory."""
        raise NotImplementedError

    def mark_effect(self) -> None:
        """Note that the function changes memory."""
        raise NotImplementedError

    def _length(self, node: ast.Call) -> Expression:
        if len(node.args) != 1 or node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, f"len of {len(node.args)} arguments", "len(array)")
        value = self.expression(node.args[0])
        if isinstance(value.type, ArrayType):
            return Constant(INT, place_of(node), value.type.length, literal=True)
        if not isinstance(value.type, StorageType):
            self.refuse(rules.WRONG_TYPE, node.args[0], f"len({value.type})", "arrays and storage")
        return tree.Length(INT, place_of(node), value)

    def _zeros(self, node: ast.Call) -> Expression:
        if len(node.args) != 2 or node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, ast.unparse(node), "array(element, length)")
        element = value_type(self.static(node.args[0]))
        length = self.expression(node.args[1])
        if element is None:
            self.refuse(rules.WRONG_ARGUMENTS, node.args[0], ast.unparse(node.args[0]), "a value type")
        if not isinstance(length, Constant) or length.type is not INT or length.value < 1:
            self.refuse(
                rules.OUT_OF_RANGE, node.args[1], ast.unparse(node.args[1]), "a constant of 1 or more"
            )
        return tree.Zeros(ArrayType(element, int(length.value)), place_of(node))

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
        if list(given) != [name for name in names if name in given] and any(
            map(tree.has_effect, parts.values())
        ):
            # Python evaluates in the order written, a constructor in the order of the fields.
            self.refuse(rules.EVALUATED_TWICE, node, "side effects in fields out of order")
        for field in type.fields:
            if field.name not in parts:
                default = self.constant(cls._defaults.get(field.name), place_of(node), field.name)
                if default is None:
                    self.refuse(rules.WRONG_ARGUMENTS, node, f"no {field.name!r}", ", ".join(names))
                parts[field.name] = self.convert(default, field.type, node)
        return tree.Construct(type, place_of(node), tuple(parts[name] for name in names))

    def _construct(self, node: ast.Call, type: Type) -> Expression:
        if node.keywords:
            self.refuse(rules.WRONG_ARGUMENTS, node, f"{node.keywords[0].arg}=…", "arguments by position")
        parts = [self.expression(argument) for argument in node.args]
        place = place_of(node)
        types = ", ".join(str(part.type) for part in parts)
        if isinstance(type, ScalarType):
            if len(parts) == 1 and isinstance(parts[0].type, ScalarType):
                return self.cast(parts[0], type, place)
        elif isinstance(type, VectorType):
            only = parts[0] if len(parts) == 1 else None
            if only is not None and isinstance(only.type, VectorType) and only.type.size == type.size:
                return self.cast(only, type, place)
            if only is not None and isinstance(only.type, ScalarType):
                return tree.Construct(type, place, (self._component(only, type, node.args[0]),))
            if sum(getattr(part.type, "size", 1) for part in parts) == type.size and len(parts) > 1:
                components = [self._component(p, type, at) for p, at in zip(parts, node.args, strict=True)]
                return tree.Construct(type, place, tuple(components))
        elif isinstance(type, MatrixType):
            row = VECTORS[FLOAT, type.size]
            if len(parts) == 1 and isinstance(parts[0].type, MatrixType):
                return tree.Construct(type, place, tuple(parts))
            if len(parts) == type.size and all(part.type == row for part in parts):
                return tree.Construct(type, place, tuple(parts))
            if len(parts) in (1, type.size**2):
                scalars = [self.convert(p, FLOAT, at) for p, at in zip(parts, node.args, strict=True)]
                return tree.Construct(type, place, tuple(scalars))
        self.refuse(rules.WRONG_ARGUMENTS, node, f"{type}({types})", _constructor_tip(type))

    def _component(self, part: Expression, type: VectorType, at: ast.AST) -> Expression:
        if isinstance(part.type, ScalarType) and part.type is not BOOL:
            wanted: Type = type.scalar
        elif isinstance(part.type, ScalarType | VectorType):
            wanted = with_scalar(part.type, type.scalar)
        else:
            wanted = type
        return self.convert(part, wanted, at)

    def cast(self, value: Expression, type: ScalarType | VectorType, place: Place) -> Expression:
        """A conversion asked for by name."""
        if value.type == type:
            return value
        if isinstance(value, Constant) and isinstance(type, ScalarType):
            number = value.value
            if type is UINT:
                return Constant(UINT, place, int(number) & 0xFFFFFFFF)
            made = {BOOL: bool, INT: int, FLOAT: float}[type](number)
            return Constant(type, place, made)
        return tree.Convert(type, place, value)

    def check_value(self, value: Expression, at: ast.AST) -> None:
        """Refuse what can't be held in a variable."""
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
    if op.value in _ORDER_FUNCTIONS and vectors:
        return f"use {_ORDER_FUNCTIONS[op.value]}(a, b), which compares by component"
    if op is Operator.MATRIX_MULTIPLY:
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


def _member_tip(type: Type) -> str:
    if isinstance(type, StorageType):
        return "storage is an array: index it first"
    if isinstance(type, TextureType | ImageType):
        return "call its methods: " + ", ".join(methods_of(type))
    return ""


def _constructor_tip(type: Type) -> str:
    if isinstance(type, VectorType):
        return f"{type.size} components in all, one for all, or another vector of {type.size}"
    if isinstance(type, MatrixType):
        return f"{type.size} rows, {type.size**2} numbers row by row, one for the diagonal, or a matrix"
    return "one scalar"
