"""GLSL 4.30 from the typed tree: types, expressions, statements, functions.

- The text keeps the shader's names and structure, so that messages of the driver are readable. Each line records the
  Python line that it comes from.
- Where Python and GLSL differ, Python's meaning wins: `//` and `%` round down (with helper functions, or with shift
  and mask for powers of two), bounds of loops are evaluated once, matrices are indexed by row.
"""

from __future__ import annotations

import math
from typing import Final

from rhi.contract.layout import (
    BOOL,
    FLOAT,
    INT,
    UINT,
    ArrayType,
    HostType,
    MatrixType,
    ScalarType,
    StructType,
    VectorType,
)
from rhi.shading.glsl.names import Names, legal
from rhi.shading.ir import tree
from rhi.shading.ir.text import Lines, power_steps
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language import rules
from rhi.shading.language.source import SourceSpan, refuse_at
from rhi.shading.language.types import ImageType, TextureType, Type, VoidType, scalar_of

__rhi_internal__ = True

_SHAPES: Final = {"2d": "2D", "2d_array": "2DArray", "3d": "3D", "cube": "Cube"}
_PREFIX: Final = {FLOAT: "", INT: "i", UINT: "u"}
_LONGEST_LIST: Final = 32
"""Arrays of zeros up to this length are initialised with a list, longer ones in a loop."""
_MOST_RETURNS: Final = 16
"""The most returns outside loops that are written as such."""
_LONGEST_CHAIN: Final = 16
"""Chains of more operators than this are written without brackets inside."""
_RUNS: Final = {
    Operator.ADD: "sum",
    Operator.SUBTRACT: "sum",
    Operator.MULTIPLY: "product",
    Operator.DIVIDE: "product",
}
"""Operators of one precedence, which group to the left without brackets."""


class Writer:
    """Writer of the functions of one stage. The helper functions that they need are collected in `helpers`."""

    def __init__(self, names: Names) -> None:
        self.globals = names
        self.names = Names(names)
        self.helpers: dict[str, str] = {}
        self.lines = Lines()
        self.file = ""
        self.leaving = ""  # in a function that a `break` leaves, the name of its result
        self.tails: set[tree.Return] = set()  # its returns that no statement follows

    # -- types

    def type(self, type: Type) -> str:
        """Return a type's GLSL name."""
        match type:
            case VoidType():
                return "void"
            case StructType(name=name):
                return self.globals.get(type, name)
            case ArrayType():
                lengths = ""
                element: HostType = type
                while isinstance(element, ArrayType):
                    lengths += f"[{element.length}]"
                    element = element.element
                return self.type(element) + lengths
            case TextureType(kind=kind, scalar=scalar, compare=compare):
                return f"{_PREFIX[scalar]}sampler{_SHAPES[kind.value]}{'Shadow' if compare else ''}"
            case ImageType(kind=kind):
                return f"{_PREFIX[type.scalar]}image{_SHAPES[kind.value]}"
        return str(type)

    def field(self, name: str) -> str:
        """Return a struct field's name. Each struct is its own namespace, so the name only needs to be legal."""
        return legal(name)

    def zero(self, type: HostType) -> str:
        """Return a value of this type whose components are all zero."""
        match type:
            case ScalarType():
                return {"bool": "false", "int": "0", "uint": "0u", "float": "0.0"}[type.name]
            case VectorType() | MatrixType():
                return f"{type}({self.zero(scalar_of(type) or FLOAT)})"
            case ArrayType(element=element, length=length):
                return f"{self.type(type)}({', '.join([self.zero(element)] * length)})"
            case StructType(fields=fields):
                return f"{self.type(type)}({', '.join(self.zero(field.type) for field in fields)})"

    # -- expressions

    def expression(self, node: Expression) -> str:
        """Return an expression as text that needs no parentheses around it."""
        match node:
            case tree.Read(type=TextureType()) | tree.BindingRead(type=TextureType()):
                return self.texture(node)
            case tree.Read(local=local):
                return self.names.get(local, local.name)
            case tree.Constant():
                return self.constant(node)
            case tree.BindingRead(declaration=declaration):
                return self.globals.get(("binding", declaration.name), declaration.name)
            case tree.ConstantArray(name=name):
                return self.globals.get(("constant", constant_key(node)), name)
            case tree.Member(base=base, name=name):
                return f"{self.expression(base)}.{self.field(name)}"
            case tree.Swizzle(base=base, components=components):
                return f"{self.expression(base)}.{''.join('xyzw'[index] for index in components)}"
            case tree.Index():
                return self.index(node)
            case tree.Length(base=base):
                return f"int({self.expression(base)}.length())"
            case tree.Unary(operator=operator, operand=operand):
                sign = {Operator.NEGATE: "-", Operator.INVERT: "~", Operator.NOT: "!"}[operator]
                return f"({sign}{self.expression(operand)})"
            case tree.Binary():
                return self.binary(node)
            case tree.Select(condition=condition, then=then, otherwise=otherwise):
                parts = [self.expression(part) for part in (condition, then, otherwise)]
                return f"({parts[0]} ? {parts[1]} : {parts[2]})"
            case tree.Convert(type=type, value=value):
                return f"{self.type(type)}({self.expression(value)})"
            case tree.Construct():
                return self.construct(node)
            case tree.Zeros(type=type) if isinstance(type, ArrayType):
                return self.zero(type)
            case tree.Call(function=function, arguments=arguments):
                name = self.globals.get(function, function.name)
                return f"{name}({', '.join(map(self.argument, arguments))})"
            case tree.BuiltinCall():
                return self.builtin(node)
        raise TypeError(f"no GLSL for {node}")

    def builtin(self, node: tree.BuiltinCall) -> str:
        """Return a call of a built-in."""
        overload, arguments = node.overload, node.arguments
        texts = [self.expression(argument) for argument in arguments]
        if overload.glsl == "transpose" and isinstance(arguments[0], tree.Construct):
            return self.columns(arguments[0])
        if not overload.glsl.isidentifier() or overload.glsl.startswith("gl_"):
            return overload.glsl.format(*texts)
        return f"{overload.glsl}({', '.join(texts)})"

    def texture(self, node: tree.Read | tree.BindingRead) -> str:
        """Return a texture where a built-in reads it."""
        if isinstance(node, tree.Read):
            return self.names.get(node.local, node.local.name)
        return self.globals.get(("binding", node.declaration.name), node.declaration.name)

    def argument(self, node: Expression) -> str:
        """Return an argument of a function of the stage."""
        return self.expression(node)

    def parameter(self, local: tree.Local) -> str:
        """Return a parameter's declaration."""
        return f"{self.type(local.type)} {self.names.get(local, local.name)}"

    def constant(self, node: tree.Constant) -> str:
        """Return a scalar literal."""
        value = node.value
        if node.type is BOOL:
            return "true" if value else "false"
        if node.type is UINT:
            return f"{int(value)}u"
        if node.type is INT:
            return _int_text(int(value))
        number = float(value)
        if math.isnan(number):
            return "uintBitsToFloat(0x7FC00000u)"
        if math.isinf(number) or abs(number) > 3.4028235677973366e38:
            return f"uintBitsToFloat({'0x7F800000u' if number > 0 else '0xFF800000u'})"
        text = repr(number)
        return text if math.copysign(1.0, number) > 0 else f"({text})"

    def index(self, node: tree.Index) -> str:
        """Return an indexed element. GLSL indexes a matrix by column, Python by row."""
        base, index = node.base, self.expression(node.index)
        if isinstance(base, tree.Index) and isinstance(base.base.type, MatrixType):
            return f"{self.expression(base.base)}[{index}][{self.expression(base.index)}]"
        if isinstance(base.type, MatrixType):
            if isinstance(base, tree.BuiltinCall) and base.overload.glsl == "transpose":
                return f"{self.expression(base.arguments[0])}[{index}]"
            return f"transpose({self.expression(base)})[{index}]"
        return f"{self.expression(base)}[{index}]"

    def construct(self, node: tree.Construct) -> str:
        """Return a constructor. A matrix is built from columns in GLSL, so the rows given are transposed."""
        type, parts = node.type, node.parts
        if isinstance(type, MatrixType) and len(parts) > 1:
            return f"transpose({self.columns(node)})"
        return f"{self.type(type)}({', '.join(map(self.expression, parts))})"

    def columns(self, node: tree.Construct) -> str:
        """Return a matrix constructor with the parts as columns: the transpose of the node's value."""
        return f"{self.type(node.type)}({', '.join(map(self.expression, node.parts))})"

    def binary(self, node: tree.Binary) -> str:
        """Return an operator with the chain of operators on its left, or calls of helper functions."""
        chain = tree.left_chain(node)
        text, run = self.expression(chain[0].left), ""
        for one in chain:
            before = run
            if len(chain) > _LONGEST_CHAIN and not isinstance(one.type, MatrixType):
                run = _RUNS.get(one.operator, "")
            # Compilers limit how deeply brackets nest, and a chain such as a + b - c needs none inside.
            text = self.operation(one, text[1:-1] if run and run == before else text)
        return text

    def operation(self, node: tree.Binary, left: str) -> str:
        """Return an operator, or a call of the helper function that has Python's meaning."""
        op = node.operator
        if op is Operator.POWER:
            return self.power(node, left)
        right = self.expression(node.right)
        if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
            return self.floored(node, left, right)
        if (
            op is Operator.MULTIPLY
            and node.left.type == node.right.type
            and isinstance(node.type, MatrixType)
        ):
            return f"matrixCompMult({left}, {right})"
        sign = {Operator.AND: "&&", Operator.OR: "||", Operator.MATRIX_MULTIPLY: "*"}.get(op, op.sign)
        return f"({left} {sign} {right})"

    def floored(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `//` or `%`, rounded towards minus infinity."""
        divide = node.operator is Operator.FLOOR_DIVIDE
        scalar = scalar_of(node.type)
        if scalar is FLOAT:
            return f"floor({left} / {right})" if divide else self.float_modulo(node, left, right)
        if scalar is UINT:
            return f"({left} {'/' if divide else '%'} {right})"
        divisor = node.right
        if isinstance(divisor, tree.Constant) and divisor.value > 0 and int(divisor.value).bit_count() == 1:
            # A shift of a negative int is arithmetic, and a mask of two's complement is the floored remainder.
            shift = int(divisor.value).bit_length() - 1
            return f"({left} >> {shift})" if divide else f"({left} & {int(divisor.value) - 1})"
        left, right = self.widened(node, node.left, left), self.widened(node, node.right, right)
        return f"{self.integer_helper(node, divide)}({left}, {right})"

    def widened(self, node: tree.Binary, operand: Expression, text: str) -> str:
        """Return an operand, a scalar one converted to a vector of the result's size."""
        return text if operand.type == node.type else f"{node.type}({text})"

    def integer_helper(self, node: tree.Binary, divide: bool) -> str:
        name = "rhi_floor_divide" if divide else "rhi_modulo"
        type = self.type(node.type)
        zero = self.zero(node.type)  # type: ignore[arg-type]
        if isinstance(node.type, ScalarType):
            # However `/` rounds negative operands, |r| < |b| holds, and r's sign tells whether to correct the result.
            wrong = "r != 0 && (r < 0) != (b < 0)"
            result = f"{wrong} ? q - 1 : q" if divide else f"{wrong} ? r + b : r"
        else:
            wrong = (
                f"{type}(notEqual(r, {zero})) * {type}(notEqual(lessThan(r, {zero}), lessThan(b, {zero})))"
            )
            result = f"q - {wrong}" if divide else f"r + b * {wrong}"
        body = f"{type} q = a / b; {type} r = a - q * b; return {result};"
        self.helpers[f"{name}({type})"] = f"{type} {name}({type} a, {type} b) {{ {body} }}"
        return name

    def float_modulo(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `%` of floats. GLSL's mod is x - y floor(x / y), which has the sign of y as in Python."""
        if isinstance(node.left.type, ScalarType) and isinstance(node.type, VectorType):
            left = f"{node.type}({left})"
        return f"mod({left}, {right})"

    def power(self, node: tree.Binary, base: str) -> str:
        """Return `**`: multiplications for a constant integer exponent, else pow."""
        exponent = node.right
        if not (isinstance(exponent, tree.Constant) and exponent.type in (INT, UINT)):
            return f"pow({base}, {self.widened(node, exponent, self.expression(exponent))})"
        count, type = int(exponent.value), self.type(node.type)
        one = {FLOAT: "1.0", INT: "1", UINT: "1u"}[scalar_of(node.type) or FLOAT]
        if count == 1:
            return base
        name = f"rhi_power_{'m' if count < 0 else ''}{abs(count)}"
        start = "x" if count else f"{type}({one})"
        result = "r" if count >= 0 else f"{one} / r"
        body = f"{type} r = {start}; {power_steps(abs(count))} return {result};"
        self.helpers[f"{name}({type})"] = f"{type} {name}({type} x) {{ {body} }}"
        return f"{name}({base})"

    # -- statements

    def line(self, text: str, place: SourceSpan) -> None:
        """Add a line to the current function."""
        self.lines.add(text, self.file, place.line)

    def block(self, block: tree.Block) -> None:
        """Write the statements of a block."""
        for statement in block:
            self.statement(statement)

    def statement(self, node: tree.Statement) -> None:
        """Write one statement, on one or more lines."""
        place = node.span
        match node:
            case tree.Declare(local=local, value=value):
                self.declare(local, value, place)
            case tree.Assign(target=target, value=value):
                text = self.expression(value)
                if tree.has_effect(value) and tree.has_effect(target):
                    # Python evaluates the value first; GLSL guarantees no order.
                    name = self.names.get((node, "value"), "value")
                    self.line(f"{self.type(value.type)} {name} = {text};", place)
                    text = name
                self.store(target, text, place)
            case tree.Evaluate(value=value):
                self.line(f"{self.expression(value)};", place)
            case tree.If():
                self.condition(node, "")
            case tree.For():
                self.loop(node)
            case tree.While(condition=condition, body=body):
                with self.lines.braces(f"while ({self.expression(condition)})", self.file, place.line):
                    self.loop_body(body)
            case tree.Break():
                self.line("break;", place)
            case tree.Continue():
                self.line("continue;", place)
            case tree.Discard():
                self.line("discard;", place)
            case tree.Return(value=value) if self.leaving:
                if value is not None:
                    self.line(f"{self.leaving} = {self.expression(value)};", place)
                if node not in self.tails:
                    self.line("break;", place)
            case tree.Return(value=value):
                self.line(f"return {self.expression(value)};" if value is not None else "return;", place)

    def store(self, target: Expression, value: str, place: SourceSpan) -> None:
        """Write the assignment of a value."""
        match target:
            case tree.Index(base=tree.Index(base=matrix, index=row), index=column) if (
                isinstance(matrix.type, MatrixType) and _is_bound(matrix) and not isinstance(column, tree.Constant)
            ):
                # NVIDIA's compiler refuses to store through an unknown column of a matrix in memory.
                with self.lines.braces(f"switch ({self.expression(column)})", self.file, place.line):
                    for i in range(matrix.type.size):
                        element = f"{self.expression(matrix)}[{i}][{self.expression(row)}]"
                        self.line(f"case {i}: {element} = {value}; break;", place)
            case _:
                self.line(f"{self.expression(target)} = {value};", place)

    def declare(self, local: tree.Local, value: Expression | None, place: SourceSpan) -> None:
        """Write the declaration of a local variable."""
        name, type = self.names.get(local, local.name), self.type(local.type)
        if (
            isinstance(value, tree.Zeros)
            and isinstance(local.type, ArrayType)
            and local.type.length > _LONGEST_LIST
        ):
            self.line(f"{type} {name};", place)
            index = self.names.get((local, "zero"), f"{name}_index")
            zero = self.zero(local.type.element)
            loop = f"for (int {index} = 0; {index} < {local.type.length}; {index}++)"
            self.line(f"{loop} {name}[{index}] = {zero};", place)
        elif value is None:
            self.line(f"{type} {name};", place)
        else:
            self.line(f"{type} {name} = {self.expression(value)};", place)

    def condition(self, node: tree.If, before: str) -> None:
        """Write `if`, `else if` and `else`."""
        line, otherwise = node.span.line, node.otherwise
        nested = otherwise[0] if len(otherwise) == 1 and isinstance(otherwise[0], tree.If) else None
        header = f"{before}if ({self.expression(node.condition)})"
        with self.lines.braces(header, self.file, line, "}" if not otherwise else ""):
            self.block(node.then)
        if otherwise:
            self.lines.text.pop()
            self.lines.origins.pop()
            if nested is not None:
                self.condition(nested, "} else ")
            else:
                with self.lines.braces("} else", self.file, line):
                    self.block(otherwise)

    def loop(self, node: tree.For) -> None:
        """Write a `for` loop. Bounds that might change are evaluated before it."""
        start, step = node.start, node.step
        start_text = self.once(node, start, "start") if tree.has_effect(start) else self.expression(start)
        stop, by = self.once(node, node.stop, "stop"), self.once(node, step, "step")
        name = self.names.get(node.local, node.local.name)
        change = int(step.value) if isinstance(step, tree.Constant) else 0
        advance = f"{name}++" if change == 1 else f"{name} {'-' if change < 0 else '+'}= {abs(change) or by}"
        if tree.may_overflow(node):
            start_text, test, advance = self.guard(node, start_text, stop, by, change, advance)
        else:
            test = f"{name} {'<' if change > 0 else '>'} {stop}"
        with self.lines.braces(
            f"for (int {name} = {start_text}; {test}; {advance})", self.file, node.span.line
        ):
            self.loop_body(node.body)

    def loop_body(self, body: tree.Block) -> None:
        """Write the body of a loop, where `break` leaves the loop and not the function."""
        leaving, self.leaving = self.leaving, ""
        self.block(body)
        self.leaving = leaving

    def guard(
        self, node: tree.For, start: str, stop: str, by: str, change: int, advance: str
    ) -> tuple[str, str, str]:
        """Return the three parts of the header of a loop whose counter may wrap when it advances for the last time.

        Whether there is a next value is known before the counter advances. `change` is the step, 0 for a variable one.
        """
        name = self.names.get(node.local, node.local.name)
        first, last, more = (
            self.names.get((node, what), f"{name}_{what}") for what in ("first", "last", "more")
        )
        least = _int_text(max(change, 0) - 2**31) if change else f"{_int_text(-(2**31))} + {by}"
        most = _int_text(min(change, 0) + 2**31 - 1) if change else f"{_int_text(2**31 - 1)} + {by}"
        above, below = f"max({stop}, {least}) - {by}", f"min({stop}, {most}) - {by}"
        ascending, descending = f"{first} < {stop}", f"{first} > {stop}"
        if change:
            bound, starts = (above, ascending) if change > 0 else (below, descending)
            test = f"{name} {'<' if change > 0 else '>'} {last}"
        else:
            bound = f"{by} > 0 ? {above} : {below}"
            starts = f"{by} > 0 ? {ascending} : {by} < 0 && {descending}"
            test = f"({by} > 0 ? {name} < {last} : {name} > {last})"
        self.line(f"int {first} = {start};", node.span)
        self.line(f"int {last} = {bound};", node.span)
        self.line(f"bool {more} = {starts};", node.span)
        return first, more, f"{more} = {test}, {advance}"

    def once(self, node: tree.For, value: Expression, what: str) -> str:
        """Return a bound's value, stored in a variable before the loop unless nothing can change it."""
        fixed = isinstance(value, tree.Constant) or (
            isinstance(value, tree.Read) and value.local.writes == (0 if value.local.is_parameter else 1)
        )
        text = self.expression(value)
        if fixed:
            return text
        name = self.names.get((node, what), f"{node.local.name}_{what}")
        self.line(f"int {name} = {text};", node.span)
        return name

    # -- functions

    def function(self, node: tree.Function) -> None:
        """Write a function's definition."""
        self.file = node.file
        self.names = Names(self.globals)
        parameters = ", ".join(map(self.parameter, node.parameters))
        name = self.globals.get(node, node.name)
        header = f"{self.type(node.result)} {name}({parameters})"
        with self.lines.braces(header, node.file, node.span.line):
            native = node.native.get("glsl")
            if native is not None:
                for offset, line in enumerate(native.body.splitlines()):
                    if line.strip():
                        self.line(line, SourceSpan(native.line + offset if native.line else node.span.line))
            elif node.native and not node.body:
                given = f"no body for GLSL, only for {', '.join(node.native)}"
                tip = 'add @native("glsl", …) or a Python body'
                refuse_at(rules.NATIVE, node.name, node.file, node.span, given, tip=tip)
            elif count_returns(node.body) > _MOST_RETURNS:
                self.left_by_break(node)
            else:
                self.block(node.body)

    def left_by_break(self, node: tree.Function) -> None:
        """Write a body with many returns as a loop of one turn that a `break` leaves.

        Drivers turn what follows a return into a branch, and nest these: Mesa's llvmpipe computes nonsense beyond 80.
        """
        void = isinstance(node.result, VoidType)
        self.leaving = result = self.names.get((node, "result"), "result")
        self.tails = tails_of(node.body)  # a break there would let Mesa take the loop apart
        if not void:
            self.line(f"{self.type(node.result)} {result};", node.span)
        turn = self.names.get((node, "turn"), "turn")
        with self.lines.braces(f"for (int {turn} = 0; {turn} < 1; {turn}++)", self.file, node.span.line):
            self.block(node.body)
        self.leaving = ""
        if not void:
            self.line(f"return {result};", node.span)


def count_returns(body: tree.Block) -> int:
    """Return how many returns a body has outside loops."""
    count = 0
    for statement in body:
        if isinstance(statement, tree.Return):
            count += 1
        elif isinstance(statement, tree.If):
            count += count_returns(statement.then) + count_returns(statement.otherwise)
    return count


def _is_bound(node: tree.Expression) -> bool:
    """Return whether an lvalue is a part of a binding or of shared memory."""
    while isinstance(node, tree.Member | tree.Swizzle | tree.Index):
        node = node.base
    return isinstance(node, tree.BindingRead)


def _int_text(value: int) -> str:
    """Return an int as an expression."""
    if value == -(2**31):
        return "(-2147483647 - 1)"
    return str(value) if value >= 0 else f"({value})"


def tails_of(body: tree.Block) -> set[tree.Return]:
    """Return the returns at the end of a body."""
    match body:
        case [*_, tree.Return() as last]:
            return {last}
        case [*_, tree.If(then=then, otherwise=otherwise)]:
            return tails_of(then) | tails_of(otherwise)
    return set()


def constant_key(node: tree.ConstantArray) -> tuple[object, ...]:
    """Return a key that is equal for constant arrays of the same name, type and values."""
    values = tuple(
        part.value
        if isinstance(part, tree.Constant)
        else tuple(getattr(p, "value", 0) for p in tree.parts_of(part))
        for part in node.elements
    )
    return (node.name, node.type, values)
