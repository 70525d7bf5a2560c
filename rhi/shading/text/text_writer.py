"""The typed tree as text of a language like C: expressions, statements, functions.

- The text keeps the shader's names and structure, so that messages of the driver are readable. Each line
  records the Python line that it comes from.
- Where Python and the language differ, Python's meaning wins: `//` and `%` round down (with helper functions,
  or with shift and mask for powers of two), bounds of loops are evaluated once, matrices are indexed by row.
- A language derives its writer: it says how types, literals, declarations and built-ins are written.
"""

from __future__ import annotations

from typing import ClassVar, Final

from rhi.contract.descriptors import FragmentOutput
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ArrayType, HostType, MatrixType, StructType
from rhi.shading.ir import tree
from rhi.shading.ir.text import Lines, power_steps
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language import rules
from rhi.shading.language.source import SourceSpan, refuse_at
from rhi.shading.language.types import (
    VECTORS,
    StorageType,
    TextureType,
    Type,
    VoidType,
    count_elements,
    scalar_of,
)
from rhi.shading.text.names import Names

_MAX_RETURNS: Final = 16
"""The maximum number of returns outside loops that are written as returns."""
_LONGEST_CHAIN: Final = 16
"""Chains of more operators than this are written without brackets inside."""
_RUNS: Final = {
    Operator.ADD: "sum",
    Operator.SUBTRACT: "sum",
    Operator.MULTIPLY: "product",
    Operator.DIVIDE: "product",
}
"""Operators of one precedence, which group to the left without brackets."""


class TextWriter:
    """Writer of the functions of one stage. The helper functions that they need are collected in
    `helpers`."""

    language: ClassVar[str]

    # -- what each language says in its own way

    def type(self, type: Type) -> str:
        """Return a type's name."""
        raise NotImplementedError

    def constant(self, node: tree.Constant) -> str:
        """Return a scalar literal."""
        raise NotImplementedError

    def variable(self, type: str, name: str, value: str = "") -> str:
        """Return a declaration of a variable, without its semicolon."""
        raise NotImplementedError

    def header(self, node: tree.Function) -> str:
        """Return the head of a function's definition."""
        raise NotImplementedError

    def helper(self, name: str, type: str, parameters: str, body: str) -> str:
        """Add a helper function whose parameters and result have one type, and return its name."""
        raise NotImplementedError

    def choice(self, condition: str, then: str, otherwise: str) -> str:
        """Return `then if condition else otherwise`, without brackets around it."""
        raise NotImplementedError

    def builtin(self, node: tree.BuiltinCall) -> str:
        """Return a call of a built-in."""
        raise NotImplementedError

    def texture(self, node: tree.Read | tree.BindingRead) -> str:
        """Return the text of a texture as an argument of a built-in."""
        raise NotImplementedError

    def length(self, base: str) -> str:
        """Return the number of elements of a storage buffer."""
        raise NotImplementedError

    def zero(self, type: HostType) -> str:
        """Return a value of this type whose components are all zero."""
        raise NotImplementedError

    def float_power(self, type: Type, base: str, text: str, exponent: Expression) -> str:
        """Return `pow` of floats, which is 1 where the exponent is 0. `text` is that of the exponent."""
        raise NotImplementedError

    def integer_helper(self, node: tree.Binary, divide: bool) -> str:
        """Return the name of the function that divides ints, rounding towards minus infinity."""
        raise NotImplementedError

    def float_modulo(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `%` of floats."""
        raise NotImplementedError

    def conversion(self, type: Type, source: Type) -> str:
        """Return the name of the function that converts floats to the nearest integers, and NaN to 0."""
        raise NotImplementedError

    # -- common

    def __init__(self, names: Names) -> None:
        self.globals = names
        self.names = Names(names)
        self._fields: dict[int, tuple[StructType, dict[str, str]]] = {}  # by identity: hashes take longer
        self.helpers: dict[str, str] = {}
        self.lines = Lines()
        self.file = ""
        self.break_result = ""  # the name of the result, in a function that a `break` leaves
        self.tails: set[tree.Return] = set()  # the returns of that function that no statement follows
        self.hoisted: dict[
            tree.Index, str
        ] = {}  # the texts of a write's indices, which are inside where they are used

    def field(self, struct: StructType, name: str) -> str:
        """Return the name of a struct's field, unique in the struct, which is a namespace of its own."""
        entry = self._fields.get(id(struct))
        if entry is None:
            fields = [field.name for field in struct.fields]
            texts = self.globals.apart().get_all(dict(zip(fields, fields, strict=True)))
            entry = self._fields[id(struct)] = struct, dict(zip(fields, texts, strict=True))
        return entry[1][name]

    def member(self, base: Expression, name: str) -> str:
        """Return the name of a field of a struct's value."""
        assert isinstance(base.type, StructType)
        return self.field(base.type, name)

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
                return f"{self.expression(base)}.{self.member(base, name)}"
            case tree.Swizzle(base=base, components=components):
                return f"{self.expression(base)}.{''.join('xyzw'[index] for index in components)}"
            case tree.Index():
                return self.index(node)
            case tree.Length(base=base):
                return self.length(self.expression(base))
            case tree.Unary(operator=operator, operand=operand):
                sign = {Operator.NEGATE: "-", Operator.INVERT: "~", Operator.NOT: "!"}[operator]
                return f"({sign}{self.expression(operand)})"
            case tree.Binary():
                return self.binary(node)
            case tree.Select(condition=condition, then=then, otherwise=otherwise):
                return f"({self.choice(*map(self.expression, (condition, then, otherwise)))})"
            case tree.Convert(type=type, value=value):
                scalar = scalar_of(type)
                if scalar_of(value.type) is FLOAT and scalar in (INT, UINT):
                    return f"{self.conversion(type, value.type)}({self.expression(value)})"
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
        raise TypeError(f"no {self.language} for {node}")

    def needs_statements(self, node: Expression) -> bool:
        """Return whether a part of an expression is written as statements before the one that contains it."""
        return False

    def argument(self, node: Expression) -> str:
        """Return an argument of a function of the stage."""
        return self.expression(node)

    def index(self, node: tree.Index) -> str:
        """Return an indexed element. GLSL indexes a matrix by column, Python by row."""
        base, index = node.base, self.index_text(node)
        if isinstance(base, tree.Index) and isinstance(base.base.type, MatrixType):
            return f"{self.expression(base.base)}[{index}][{self.index_text(base)}]"
        if isinstance(base.type, MatrixType):
            if isinstance(base, tree.BuiltinCall) and base.overload.glsl == "transpose":
                return f"{self.expression(base.arguments[0])}[{index}]"
            return f"transpose({self.expression(base)})[{index}]"
        return f"{self.expression(base)}[{index}]"

    def index_text(self, node: tree.Index) -> str:
        """Return the text of an index, bounded to the nearest element unless it is proven to be inside."""
        hoisted = self.hoisted.get(node)
        return hoisted if hoisted is not None else self.clamp_index(node, self.expression(node.index))

    def clamp_index(self, node: tree.Index, index: str) -> str:
        """Return the index that is inside and nearest to an index."""
        if node.inside:
            return index
        limit = self.limit(node)
        if node.index.type is UINT:
            last = f"{int(limit) - 1}u" if limit.isdigit() else f"{self.type(UINT)}({limit} - 1)"
            return f"min({index}, {last})"
        return f"clamp({index}, 0, {int(limit) - 1 if limit.isdigit() else f'{limit} - 1'})"

    def limit(self, node: tree.Index) -> str:
        """Return the number of elements that an index must be below, as an int."""
        if isinstance(node.base.type, StorageType):
            return self.length(self.expression(node.base))
        return str(count_elements(node.base.type))

    def bounds_test(self, node: tree.Index, index: str) -> str:
        """Return the condition under which an index is inside."""
        limit = self.limit(node)
        bound = f"{limit}u" if limit.isdigit() else f"{self.type(UINT)}({limit})"
        return f"{self.type(UINT)}({index}) < {bound}"

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
        for link in chain:
            before = run
            if len(chain) > _LONGEST_CHAIN and not isinstance(link.type, MatrixType):
                run = _RUNS.get(link.operator, "")
            # Compilers limit how deeply brackets nest, and a chain such as a + b - c needs none inside.
            text = self.operation(link, text[1:-1] if run and run == before else text)
        return text

    def operation(self, node: tree.Binary, left: str) -> str:
        """Return an operator, or a call of the helper function that has Python's meaning."""
        op = node.operator
        if op is Operator.POWER:
            return self.power(node, left)
        right = self.expression(node.right)
        if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
            return self.floored(node, left, right)
        if op in (Operator.SHIFT_LEFT, Operator.SHIFT_RIGHT) and not is_constant(node.right):
            right = f"({right} & {31 if scalar_of(node.right.type) is INT else '31u'})"
        sign = {Operator.AND: "&&", Operator.OR: "||", Operator.MATRIX_MULTIPLY: "*"}.get(op, op.sign)
        return f"({left} {sign} {right})"

    def floored(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `//` or `%`, rounded towards minus infinity."""
        divide = node.operator is Operator.FLOOR_DIVIDE
        scalar = scalar_of(node.type)
        if scalar is FLOAT:
            return f"floor({left} / {right})" if divide else self.float_modulo(node, left, right)
        divisor = node.right
        if scalar is UINT:
            right = right if is_constant(divisor) else f"max({right}, {self.type(divisor.type)}(1))"
            return f"({left} {'/' if divide else '%'} {right})"
        if isinstance(divisor, tree.Constant) and divisor.value > 0 and int(divisor.value).bit_count() == 1:
            # A shift of a negative int is arithmetic, and a mask of two's complement is the floored
            # remainder.
            shift = int(divisor.value).bit_length() - 1
            return f"({left} >> {shift})" if divide else f"({left} & {int(divisor.value) - 1})"
        left, right = self.widened(node, node.left, left), self.widened(node, node.right, right)
        return f"{self.integer_helper(node, divide)}({left}, {right})"

    def widened(self, node: tree.Binary, operand: Expression, text: str) -> str:
        """Return an operand, a scalar one converted to a vector of the result's size."""
        return text if operand.type == node.type else f"{self.type(node.type)}({text})"

    def power(self, node: tree.Binary, base: str) -> str:
        """Return `**`: multiplications for a constant integer exponent, else pow."""
        exponent = node.right
        if not (isinstance(exponent, tree.Constant) and exponent.type in (INT, UINT)):
            text = self.widened(node, exponent, self.expression(exponent))
            return self.float_power(node.type, base, text, exponent)
        count, type = int(exponent.value), self.type(node.type)
        unit = {FLOAT: "1.0", INT: "1", UINT: "1u"}[scalar_of(node.type) or FLOAT]
        if count == 1:
            return base
        name = f"rhi_power_{'m' if count < 0 else ''}{abs(count)}"
        start = "x" if count else f"{type}({unit})"
        result = "r" if count >= 0 else f"{unit} / r"
        body = f"{self.variable(type, 'r', start)}; {power_steps(abs(count))} return {result};"
        return f"{self.helper(name, type, 'x', body)}({base})"

    def line(self, text: str, span: SourceSpan) -> None:
        """Add a line to the current function."""
        self.lines.add(text, self.file, span.line)

    def block(self, block: tree.Block) -> None:
        """Write the statements of a block."""
        for statement in block:
            self.statement(statement)

    def statement(self, node: tree.Statement) -> None:
        """Write one statement, on one or more lines."""
        span = node.span
        match node:
            case tree.Declare(local=local, value=value):
                self.declare(local, value, span)
            case tree.Assign(target=target, value=value):
                text, unknown = self.expression(value), unknown_indices(target)
                if tree.has_effect(value) and (tree.has_effect(target) or unknown):
                    # Python evaluates the value first; GLSL guarantees no order.
                    name = self.names.get((node, "value"), "value")
                    self.line(f"{self.variable(self.type(value.type), name, text)};", span)
                    text = name
                if not unknown:
                    self.store(target, text, span)
                    return
                conditions = " && ".join(self.hoist_index(index, span) for index in unknown)
                with self.lines.braces(f"if ({conditions})", self.file, span.line):
                    self.store(target, text, span)
                self.hoisted.clear()
            case tree.Evaluate(value=value):
                self.line(f"{self.expression(value)};", span)
            case tree.If():
                self.condition(node, "")
            case tree.For():
                self.loop(node)
            case tree.While(condition=condition):
                with self.lines.braces(f"while ({self.expression(condition)})", self.file, span.line):
                    self.loop_body(node)
            case tree.Break():
                self.line("break;", span)
            case tree.Continue():
                self.line("continue;", span)
            case tree.Discard():
                self.line("discard;", span)
            case tree.Return(value=value) if self.break_result:
                if value is not None:
                    self.line(f"{self.break_result} = {self.expression(value)};", span)
                if node not in self.tails:
                    self.line("break;", span)
            case tree.Return(value=value):
                self.line(f"return {self.expression(value)};" if value is not None else "return;", span)

    def hoist_index(self, node: tree.Index, span: SourceSpan) -> str:
        """Evaluate an index of a write in a statement, and return the condition that it is inside."""
        text = self.expression(node.index)
        if not is_plain(node.index):
            name = self.names.get((node, "at"), "at")
            self.line(f"{self.variable(self.type(node.index.type), name, text)};", span)
            text = name
        self.hoisted[node] = text
        return self.bounds_test(node, text)

    def store(self, target: Expression, value: str, span: SourceSpan) -> None:
        """Write the assignment of a value."""
        self.line(f"{self.expression(target)} = {value};", span)

    def declare(self, local: tree.Local, value: Expression | None, span: SourceSpan) -> None:
        """Write the declaration of a local variable."""
        name, text = self.names.get(local, local.name), self.expression(value) if value is not None else ""
        self.line(f"{self.variable(self.local_type(local), name, text)};", span)

    def local_type(self, local: tree.Local) -> str:
        """Return the type of a local variable, with qualifiers."""
        return self.type(local.type)

    def condition(self, node: tree.If, before: str) -> None:
        """Write `if`, `else if` and `else`."""
        line, otherwise = node.span.line, node.otherwise
        nested = otherwise[0] if len(otherwise) == 1 and isinstance(otherwise[0], tree.If) else None
        if nested is not None and self.needs_statements(nested.condition):
            nested = None
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
        start_text = (
            self.hoist_bound(node, start, "start") if tree.has_effect(start) else self.expression(start)
        )
        stop, by = self.hoist_bound(node, node.stop, "stop"), self.hoist_bound(node, step, "step")
        name = self.names.get(node.local, node.local.name)
        change = int(step.value) if isinstance(step, tree.Constant) else 0
        advance = f"{name}++" if change == 1 else f"{name} {'-' if change < 0 else '+'}= {abs(change) or by}"
        if tree.may_overflow(node):
            start_text, test, advance = self.guard(node, start_text, stop, by, change, advance)
        else:
            test = f"{name} {'<' if change > 0 else '>'} {stop}"
        self.repeat(node, self.variable(self.type(INT), name, start_text), test, advance)

    def repeat(self, node: tree.For, start: str, test: str, advance: str) -> None:
        """Write a loop with its variable, its condition, and the step after each iteration."""
        with self.lines.braces(f"for ({start}; {test}; {advance})", self.file, node.span.line):
            self.loop_body(node)

    def loop_body(self, loop: tree.For | tree.While) -> None:
        """Write the body of a loop, where `break` leaves the loop and not the function."""
        break_result, self.break_result = self.break_result, ""
        self.block(loop.body)
        self.break_result = break_result

    def guard(
        self, node: tree.For, start: str, stop: str, by: str, change: int, advance: str
    ) -> tuple[str, str, str]:
        """Return the three parts of the header of a loop whose counter may wrap when it advances for the last
        time.

        The loop ends before the counter advances. `change` is the step, 0 for a variable one.
        """
        name = self.names.get(node.local, node.local.name)
        first, last, more = (
            self.names.get((node, role), f"{name}_{role}") for role in ("first", "last", "more")
        )
        least = int_text(max(change, 0) - 2**31) if change else f"{int_text(-(2**31))} + {by}"
        most = int_text(min(change, 0) + 2**31 - 1) if change else f"{int_text(2**31 - 1)} + {by}"
        above, below = f"max({stop}, {least}) - {by}", f"min({stop}, {most}) - {by}"
        ascending, descending = f"{first} < {stop}", f"{first} > {stop}"
        if change:
            bound, starts = (above, ascending) if change > 0 else (below, descending)
            test = f"{name} {'<' if change > 0 else '>'} {last}"
        else:
            up = f"{by} > 0"
            bound = self.choice(up, above, below)
            starts = self.choice(up, ascending, f"{by} < 0 && {descending}")
            test = f"({self.choice(up, f'{name} < {last}', f'{name} > {last}')})"
        for type, local, text in ((INT, first, start), (INT, last, bound), (BOOL, more, starts)):
            self.line(f"{self.variable(self.type(type), local, text)};", node.span)
        return first, more, f"{more} = {test}, {advance}"

    def hoist_bound(self, node: tree.For, value: Expression, role: str) -> str:
        """Return a bound's value, stored in a variable before the loop unless nothing can change it."""
        fixed = isinstance(value, tree.Constant) or (
            isinstance(value, tree.Read) and value.local.writes == (0 if value.local.is_parameter else 1)
        )
        text = self.expression(value)
        if fixed:
            return text
        name = self.names.get((node, role), f"{node.local.name}_{role}")
        self.line(f"{self.variable(self.type(INT), name, text)};", node.span)
        return name

    def function(self, node: tree.Function) -> None:
        """Write a function's definition."""
        self.file = node.file
        self.names = Names(self.globals)
        values = [local for local in node.parameters if not isinstance(local.type, TextureType)]
        self.names.get_all({local: local.name for local in values})  # native code uses their Python names
        with self.lines.braces(self.header(node), node.file, node.span.line):
            native = node.native.get(self.language)
            if native is not None:
                for offset, line in enumerate(native.body.splitlines()):
                    if line.strip():
                        self.line(line, SourceSpan(native.line + offset if native.line else node.span.line))
            elif node.native and not node.body:
                actual = f"no body for {self.language.upper()}, only for {', '.join(node.native)}"
                tip = f'add @native("{self.language}", …) or a Python body'
                refuse_at(rules.NATIVE, node.name, node.file, node.span, actual, tip=tip)
            else:
                self.begin(node)
                body = self.prepare(node)
                if count_returns(body) > _MAX_RETURNS:
                    self.write_with_breaks(node, body)
                else:
                    self.block(body)
                    self.end(node)

    def begin(self, node: tree.Function) -> None:
        """Write what precedes the statements of a function."""

    def prepare(self, node: tree.Function) -> tree.Block:
        """Return the statements to write for a function."""
        return node.body

    def end(self, node: tree.Function) -> None:
        """Write a return where a path ends in a `discard` or an endless loop: compilers require it."""
        if not isinstance(node.result, VoidType) and not tree.returns_everywhere(node.body):
            self.line(f"return {self.zero(node.result)};", node.span)  # type: ignore[arg-type]

    def write_with_breaks(self, node: tree.Function, body: tree.Block) -> None:
        """Write a body with many returns as a loop of one iteration that a `break` leaves.

        Drivers nest the code after each return as a branch; Mesa's llvmpipe computes nonsense beyond 80 of
        them.
        """
        void = isinstance(node.result, VoidType)
        self.break_result = result = self.names.get((node, "result"), "result")
        self.tails = tails_of(body)  # a break there would let Mesa take the loop apart
        if not void:
            self.line(f"{self.variable(self.type(node.result), result)};", node.span)
        turn = self.names.get((node, "iteration"), "iteration")
        header = f"for ({self.variable(self.type(INT), turn, '0')}; {turn} < 1; {turn}++)"
        with self.lines.braces(header, self.file, node.span.line):
            self.block(body)
        self.break_result = ""
        if not void:
            self.line(f"return {result};", node.span)


def unknown_indices(target: Expression) -> list[tree.Index]:
    """Return the indices of a write that aren't proven to be inside, innermost first."""
    indices = []
    while isinstance(target, tree.Member | tree.Swizzle | tree.Index):
        if isinstance(target, tree.Index) and not target.inside:
            indices.append(target)
        target = target.base
    return indices[::-1]


def is_plain(node: Expression) -> bool:
    """Return whether evaluating an expression costs no more than reading a variable."""
    while isinstance(node, tree.Swizzle):
        node = node.base
    return isinstance(node, tree.Constant | tree.Read)


def is_constant(node: Expression) -> bool:
    """Return whether all components are constants."""
    match node:
        case tree.Constant():
            return True
        case tree.Construct(parts=parts):
            return all(map(is_constant, parts))
        case tree.Convert(value=value):
            return is_constant(value)
    return False


def is_positive(node: Expression) -> bool:
    """Return whether all components of an expression are constants above 0."""
    match node:
        case tree.Constant(value=value):
            return value > 0
        case tree.Construct(parts=parts):
            return all(map(is_positive, parts))
        case tree.Convert(value=value):
            return is_positive(value)
    return False


def count_returns(body: tree.Block) -> int:
    """Return the number of returns in a body outside loops."""
    count = 0
    for statement in body:
        if isinstance(statement, tree.Return):
            count += 1
        elif isinstance(statement, tree.If):
            count += count_returns(statement.then) + count_returns(statement.otherwise)
    return count


def int_text(value: int) -> str:
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
        repr(part.value)  # not equality: 0.0 equals -0.0
        if isinstance(part, tree.Constant)
        else tuple(repr(getattr(p, "value", 0)) for p in tree.parts_of(part))
        for part in node.elements
    )
    return (node.name, node.type, values)


def output_type(output: FragmentOutput) -> HostType:
    """Return the type of a fragment stage's output."""
    scalar = {"float": FLOAT, "int": INT, "uint": UINT}[output.kind]
    return scalar if output.components == 1 else VECTORS[scalar, output.components]
