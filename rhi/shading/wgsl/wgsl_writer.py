"""WGSL from the typed tree: types, literals, declarations, built-ins.

- Every matrix is written as its transpose, whose columns are our rows. So rows are indexed as they are,
  memory is laid out as elsewhere, and only the operands of `@` are swapped.
- `select` evaluates both sides, and takes no structs, arrays and matrices. Where that matters, a choice is a
  statement before the one that contains it, and operands evaluated earlier are stored in variables. A
  compare-exchange is such a statement, too: a loop around WGSL's, which may fail spuriously.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Final, NoReturn

from rhi.contract import layout
from rhi.contract.descriptors import Stage, TextureKind
from rhi.shading.ir import tree
from rhi.shading.ir.nodes import within
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language import rules
from rhi.shading.language.builtins import BUILTINS, POLYFILL, Polyfill, Refused, SideEffect, check_polyfills
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.source import SourceSpan, refuse_at
from rhi.shading.language.textures import METHOD_NAMES
from rhi.shading.language.types import VOID, ImageType, StorageType, TextureType, Type, VoidType, scalar_of
from rhi.shading.text.names import Names
from rhi.shading.text.text_writer import TextWriter, int_text, is_constant, is_positive, unknown_indices
from rhi.shading.wgsl.wgsl_builtins import (
    AGREEMENT,
    BARRIER,
    CONVERSIONS,
    GROUP_INPUTS,
    INPUTS,
    INVERSES,
    OUTSIDE_FRAGMENTS,
    PACK_SNORM_4X8,
    TEXTURE_CALLS,
)
from rhi.shading.wgsl.wgsl_memory import UNIFORM, MemoryTypes
from rhi.shading.wgsl.wgsl_uniformity import list_agreed_conditions

SCALARS: Final = {layout.FLOAT: "f32", layout.INT: "i32", layout.UINT: "u32", layout.BOOL: "bool"}
SHAPES: Final = {
    TextureKind.D2: "2d",
    TextureKind.D2_ARRAY: "2d_array",
    TextureKind.D3: "3d",
    TextureKind.CUBE: "cube",
}
_IN_MEMORY: Final = (StorageClass.UNIFORM, StorageClass.STORAGE, StorageClass.SHARED)
_LARGEST: Final = 3.4028235677973366e38
_STATEMENTS: Final = (SideEffect.BARRIER, SideEffect.DISCARD)
_CHOICES: Final = (Operator.AND, Operator.OR)


class WgslWriter(TextWriter):
    """Writer of the functions of one stage."""

    language = "wgsl"

    def __init__(self, names: Names, stage: tree.StageTree, image_form: Callable[[Declaration], str]) -> None:
        """`image_form` returns the type of a storage image with its access, which depends on the stage."""
        super().__init__(names)
        self._image_form = image_form
        self.stage = stage.stage
        self.entry = stage.entry
        atomic_words = {
            _word_of(node.arguments[0])
            for function in stage.functions
            for node in tree.walk(function.body)
            if isinstance(node, tree.BuiltinCall) and node.builtin.name.startswith("atomic_")
        }
        self.function_result: Type = VOID  # of the function that is being written
        is_compute = stage.stage is Stage.COMPUTE
        self.agreed = list_agreed_conditions(stage) if is_compute else set()
        self.group_inputs = _list_group_inputs(stage)
        self.discarding = _discarding_functions(stage)
        self.loops_discard = any(
            self.discards(node)
            for function in stage.functions
            for node in tree.walk(function.body)
            if isinstance(node, tree.While)
        )
        self.memory = MemoryTypes(self.type, self.field, names.get, frozenset(atomic_words))

    def refuse(self, node: Expression, construct: str, tip: str = "") -> NoReturn:
        """Refuse an expression that WGSL can't express."""
        refuse_at(
            rules.NATIVE, self.entry.name, self.file, node.span, f"{construct}, which WGSL lacks", tip=tip
        )

    # -- types and literals

    def type(self, type: Type) -> str:
        """Return a type's WGSL name."""
        match type:
            case layout.ScalarType():
                return SCALARS[type]
            case layout.VectorType(scalar=scalar, size=size):
                return f"vec{size}<{SCALARS[scalar]}>"
            case layout.MatrixType(size=size):
                return f"mat{size}x{size}<f32>"
            case layout.StructType(name=name):
                return self.globals.get(type, name)
            case layout.ArrayType(element=element, length=length):
                return f"array<{self.type(element)}, {length}>"
            case TextureType(kind=kind, scalar=scalar, compare=compare, samples=samples):
                shape = f"multisampled_{SHAPES[kind]}" if samples else SHAPES[kind]
                return f"texture_depth_{shape}" if compare else f"texture_{shape}<{SCALARS[scalar]}>"
        raise TypeError(f"no {self.language} for {type}")

    def constant(self, node: tree.Constant) -> str:
        """Return a scalar literal."""
        value = node.value
        if node.type is layout.BOOL:
            return "true" if value else "false"
        if node.type is layout.UINT:
            return f"{int(value)}u"
        if node.type is layout.INT:
            return f"i32({int_text(int(value))})"
        number = float(value)
        if math.isfinite(number) and abs(number) <= _LARGEST:
            text = f"{number!r}f"
            return text if math.copysign(1.0, number) > 0 else f"({text})"
        # Constants that aren't numbers are errors in WGSL, so the bits come from a variable.
        bits = "0x7FC00000u" if math.isnan(number) else "0x7F800000u" if number > 0 else "0xFF800000u"
        self.helpers["rhi_from_bits"] = (
            "fn rhi_from_bits(x: u32) -> f32 { var y = x; return bitcast<f32>(y); }"
        )
        return f"rhi_from_bits({bits})"

    def zero(self, type: layout.HostType) -> str:
        return f"{self.type(type)}()"

    # -- statements that expressions need

    def needs_statements(self, node: Expression) -> bool:
        """Return whether a part of an expression is written as statements before the one that contains it."""
        match node:
            case tree.Select(then=then, otherwise=otherwise):
                if tree.has_effect(then) or tree.has_effect(otherwise) or not _is_selected(node.type):
                    return True
            case tree.BuiltinCall(builtin=builtin, arguments=arguments) if builtin.name.startswith("atomic_"):
                if builtin.name == "atomic_compare_exchange" or unknown_indices(arguments[0]):
                    return True
            case tree.Construct(type=layout.MatrixType(), parts=(part,)) if tree.has_effect(part):
                return True
            case tree.Member() | tree.Index() if tree.has_effect(node) and self._is_loaded_in_parts(node):
                return True
            case tree.Binary():
                chain = tree.left_chain(node)
                return self.needs_statements(chain[0].left) or any(
                    self.needs_statements(link.right) for link in chain
                )
        return any(map(self.needs_statements, tree.parts_of(node)))

    def hoist(self, node: Expression, text: str, role: str = "hoisted") -> str:
        """Evaluate an expression here, and return the name of its value."""
        name = self.names.get((node, role), role)
        self.line(f"let {name} = {text};", node.span)
        return name

    def _is_loaded_in_parts(self, node: Expression) -> bool:
        """Return whether a read repeats the path to what is read."""
        declaration = _declaration_of(node)
        return (
            declaration is not None
            and declaration.storage_class in _IN_MEMORY
            and not isinstance(node.type, layout.ScalarType | StorageType)
            and self.memory.differs(node.type, _space_of(declaration), self.is_atomic(node))  # type: ignore[arg-type]
        )

    def _evaluate_indices(self, node: Expression) -> None:
        """Evaluate here, once, the indices of a path that is repeated: those with side effects, and those
        that mention what is stored in parts."""
        root = tree.root_of(node)
        owner = getattr(root, "local", getattr(root, "declaration", None))
        for index in tree.indices_of(node):
            mentioned = [
                getattr(part, "local", getattr(part, "declaration", None))
                for part in within(index.index, "Expression")
                if isinstance(part, tree.Read | tree.BindingRead)
            ]
            if index not in self.hoisted and (owner in mentioned or tree.has_effect(index.index)):
                text = self.clamp_index(index, self.expression(index.index))
                self.hoisted[index] = self.hoist(index.index, text, "at")

    def sequence(self, nodes: Sequence[Expression]) -> list[str]:
        """Return the texts of expressions that are evaluated in this order."""
        last = max((i for i, node in enumerate(nodes) if self.needs_statements(node)), default=0)
        texts = []
        for number, node in enumerate(nodes):
            text = self.argument(node)
            fixed = isinstance(node, tree.Constant) or isinstance(node.type, TextureType | ImageType)
            texts.append(self.hoist(node, text) if number < last and not fixed else text)
        return texts

    def write_select(self, node: tree.Select) -> str:
        """Write a choice as a statement, and return the name of its value."""
        name = self.names.get((node, "selected"), "selected")
        test = self.expression(node.condition)
        self.line(f"{self.variable(self.type(node.type), name)};", node.span)
        for value, header in ((node.then, f"if ({test})"), (node.otherwise, "else")):
            with self.lines.braces(header, self.file, node.span.line):
                self.line(f"{name} = {self.expression(value)};", value.span)
        return name

    # -- expressions

    def expression(self, node: Expression) -> str:
        text = self._expression(node)
        return self.agree(node, text) if node in self.agreed else text

    def agree(self, node: Expression, text: str) -> str:
        """Return a condition or loop bound as a value that WGSL knows to be the same in the whole work-group."""
        self.helpers["rhi_agree"] = AGREEMENT
        return f"rhi_agree_{self.type(node.type)}({text})"

    def hoist_bound(self, node: tree.For, value: Expression, what: str) -> str:
        text = super().hoist_bound(node, value, what)
        if value not in self.agreed or not text.startswith("rhi_agree"):
            return text
        name = self.names.get((node, what), f"{node.local.name}_{what}")
        self.line(f"let {name} = {text};", node.span)
        return name

    def _expression(self, node: Expression) -> str:
        match node:
            case tree.Member() | tree.Index() | tree.Swizzle() | tree.BindingRead():
                declaration = _declaration_of(node)
                if declaration is not None and declaration.storage_class in _IN_MEMORY:
                    if isinstance(node.type, StorageType):
                        return self.path(node)
                    if tree.has_effect(node) and self._is_loaded_in_parts(node):
                        self._evaluate_indices(node)
                    return self.memory.load(
                        node.type,  # type: ignore[arg-type]
                        _space_of(declaration),
                        self.path(node),
                        self.is_atomic(node),
                    )
            case tree.Select() if self.needs_statements(node):
                return self.write_select(node)
            case tree.Unary(operator=Operator.NEGATE, operand=operand) if scalar_of(node.type) is layout.UINT:
                type = self.type(node.type)
                return f"{self.helper('rhi_negate', type, 'x', f'return {type}() - x;')}({self.expression(operand)})"
            case tree.Unary(operator=Operator.NEGATE, operand=operand, type=layout.MatrixType()):
                return f"({self.expression(operand)} * -1.0)"
            case tree.Unary(operator=Operator.NEGATE, operand=operand) if _is_constant_expression(operand):
                return f"(-{self.variable_value(operand, self.expression(operand))})"
            case tree.Call(function=function, arguments=arguments):
                texts = [*self.sequence(arguments), *(f"rhi_{name}" for name in self.group_inputs[function])]
                return f"{self.globals.get(function, function.name)}({', '.join(texts)})"
        return super().expression(node)

    def path(self, node: Expression) -> str:
        """Return the path to a part of a binding, a local or a value."""
        match node:
            case tree.Member(base=base, name=name):
                return f"{self.path(base)}.{self.member(base, name)}"
            case tree.Swizzle(base=base, components=components):
                return f"{self.path(base)}.{''.join('xyzw'[index] for index in components)}"
            case tree.Index(base=base):
                declaration = _declaration_of(node)
                space = _space_of(declaration) if declaration is not None else "local"
                inner = self.memory.element(base.type, space)  # type: ignore[arg-type]
                return f"{self.path(base)}[{self.index_text(node)}]{inner}"
            case tree.BindingRead(declaration=declaration):
                return self.globals.get(("binding", declaration.name), declaration.name)
        return super().expression(node)

    def is_atomic(self, node: Expression) -> bool:
        """Return whether an access in memory is to atomic words."""
        return (
            isinstance(node.type, layout.ScalarType | layout.ArrayType)
            and _word_of(node) in self.memory.atomics
        )

    def argument(self, node: Expression) -> str:
        if isinstance(node.type, TextureType):
            return ", ".join(self.texture_and_sampler(node))
        return self.expression(node)

    def index(self, node: tree.Index) -> str:
        base, index = self.sequence((node.base, node.index))
        return f"{base}[{self.clamp_index(node, index)}]"

    def construct(self, node: tree.Construct) -> str:
        type, parts = node.type, self.sequence(node.parts)
        if isinstance(type, layout.MatrixType) and len(parts) == 1:
            if tree.has_effect(node.parts[0]):
                parts = [self.hoist(node.parts[0], parts[0])]
            size, source = type.size, node.parts[0].type
            if isinstance(source, layout.ScalarType):
                cells = [parts[0] if i == j else "0.0" for i in range(size) for j in range(size)]
            else:
                assert isinstance(source, layout.MatrixType)
                source_size = source.size
                cells = [
                    f"{parts[0]}[{i}][{j}]" if max(i, j) < source_size else "1.0" if i == j else "0.0"
                    for i in range(size)
                    for j in range(size)
                ]
            return f"{self.type(type)}({', '.join(cells)})"
        return f"{self.type(type)}({', '.join(parts)})"

    def choice(self, condition: str, then: str, otherwise: str) -> str:
        return f"select(({otherwise}), ({then}), ({condition}))"

    def length(self, base: str) -> str:
        return f"i32(arrayLength(&{base}))"

    # -- operators

    def operation(self, node: tree.Binary, left: str) -> str:
        if self.needs_statements(node.right):
            if node.operator in _CHOICES:
                if node.left in self.agreed and isinstance(node.left, tree.Binary):  # a link of a chain
                    left = self.agree(node.left, left)
                name = self.hoist(node, left, "first")
                is_and = node.operator is Operator.AND
                selected = self.names.get((node, "selected"), "selected")
                self.line(f"{self.variable('bool', selected, name)};", node.span)
                with self.lines.braces(f"if ({name if is_and else f'!{name}'})", self.file, node.span.line):
                    self.line(f"{selected} = {self.expression(node.right)};", node.span)
                return selected
            left = self.hoist(node, left, "first")
        op, types = node.operator, (node.left.type, node.right.type)
        if _is_constant_expression(node.left) and _is_constant_expression(node.right):
            left = self.variable_value(node.left, left)
        match op:
            case Operator.POWER | Operator.FLOOR_DIVIDE | Operator.MODULO:
                return super().operation(node, left)
            case Operator.MATRIX_MULTIPLY:
                return f"({self.expression(node.right)} * {left})"
            case Operator.NOT_EQUAL if scalar_of(types[0]) is layout.FLOAT:
                # Compilers take WGSL's `!=` of floats as "less or greater", which isn't true of NaN.
                return f"!{self.operation(replace(node, operator=Operator.EQUAL), left)}"
            case Operator.EQUAL | Operator.NOT_EQUAL if isinstance(types[0], layout.VectorType):
                return f"{'all' if op is Operator.EQUAL else 'any'}{super().operation(node, left)}"
            case Operator.SHIFT_LEFT | Operator.SHIFT_RIGHT:
                count, form = self.expression(node.right), "u32"
                if isinstance(node.type, layout.VectorType):
                    form = f"vec{node.type.size}<u32>"
                    count = f"u32({count})" if isinstance(types[1], layout.ScalarType) else count
                count = f"{form}({count})"
                count = count if is_constant(node.right) else f"({count} & {form}(31u))"
                return f"({self.widened(node, node.left, left)} {op.sign} {count})"
            case Operator.BIT_AND | Operator.BIT_OR | Operator.BIT_XOR if types[0] != types[1]:
                right = self.widened(node, node.right, self.expression(node.right))
                return f"({self.widened(node, node.left, left)} {op.sign} {right})"
            case Operator.MULTIPLY if isinstance(node.type, layout.MatrixType) and types[0] == types[1]:
                body = f"return {self.type(node.type)}({', '.join(f'a[{i}] * b[{i}]' for i in range(node.type.size))});"
                name = self.helper("rhi_multiply", self.type(node.type), "a b", body)
                return f"{name}({left}, {self.expression(node.right)})"
            case Operator.DIVIDE if isinstance(types[0], layout.MatrixType):
                return f"({left} * (1.0 / {self.expression(node.right)}))"
        return super().operation(node, left)

    def variable_value(self, node: Expression, text: str) -> str:
        """Return a constant as a value that isn't constant to WGSL, which refuses constant results out of
        range."""
        if not isinstance(node.type, layout.ScalarType | layout.VectorType | layout.MatrixType):
            return text
        return f"{self.helper('rhi_value', self.type(node.type), 'x', 'return x;')}({text})"

    def float_power(self, type: Type, base: str, text: str, exponent: Expression) -> str:
        if is_positive(exponent):
            return f"pow({base}, {text})"
        name = self.type(type)
        body = (  # 0 to a negative power is infinity, which WGSL has no constant for
            f"let p = select(pow(x, y), y * -3e38 * 3e38, (x == {name}()) & (y < {name}())); "
            f"return select(p, {name}(1.0), y == {name}());"
        )
        return f"{self.helper('rhi_pow', name, 'x y', body)}({base}, {text})"

    def pow(self, node: tree.BuiltinCall) -> str:
        base, exponent = self.sequence(node.arguments)
        if all(map(_is_constant_expression, node.arguments)):
            base = self.variable_value(node.arguments[0], base)
        return self.float_power(node.type, base, exponent, node.arguments[1])

    def atan2(self, node: tree.BuiltinCall) -> str:
        texts, name = self.sequence(node.arguments), self.type(node.type)
        bits = name.replace("f32", "u32")
        zeros = (
            f"bitcast<{name}>((bitcast<{bits}>(y) & {bits}(0x80000000u)) | "
            f"((bitcast<{bits}>(x) >> {bits}(31u)) * 0x40490FDBu))"
        )
        body = f"return select(atan2(y, x), {zeros}, (x == {name}()) & (y == {name}()));"
        return f"{self.helper('rhi_atan2', name, 'y x', body)}({', '.join(texts)})"

    def power(self, node: tree.Binary, base: str) -> str:
        exponent = node.right
        if (
            isinstance(exponent, tree.Constant)
            and exponent.type in (layout.INT, layout.UINT)
            and not exponent.value
        ):
            return f"{self.type(node.type)}({'1.0' if scalar_of(node.type) is layout.FLOAT else '1'})"
        if (
            isinstance(exponent, tree.Constant)
            and exponent.type in (layout.INT, layout.UINT)
            and exponent.value < 0
        ):
            # WGSL divides no scalar by an integer vector, so one is of the result's type.
            inverse = tree.Constant(exponent.type, exponent.span, -exponent.value)
            positive = tree.Binary(node.type, node.span, node.operator, node.left, inverse)
            return f"({self.type(node.type)}(1) / {super().power(positive, base)})"
        return super().power(node, base)

    def floored(self, node: tree.Binary, left: str, right: str) -> str:
        """Return `//` or `%`. WGSL shifts no vectors by scalars, so powers of two are divided by as others
        are."""
        if isinstance(node.type, layout.VectorType) and scalar_of(node.type) is layout.INT:
            left, right = self.widened(node, node.left, left), self.widened(node, node.right, right)
            return f"{self.integer_helper(node, node.operator is Operator.FLOOR_DIVIDE)}({left}, {right})"
        divisor, divides = node.right, node.operator is Operator.FLOOR_DIVIDE
        if scalar_of(node.type) is layout.INT and divides and isinstance(divisor, tree.Constant):
            value = int(divisor.value)
            if value > 0 and value.bit_count() == 1:
                return f"({left} >> {value.bit_length() - 1}u)"
        if scalar_of(node.type) is layout.UINT and not is_constant(divisor):
            sign, right = "/" if divides else "%", self.widened(node, divisor, right)
            return f"({left} {sign} max({right}, {self.type(node.type)}(1)))"
        return super().floored(node, left, right)

    def integer_helper(self, node: tree.Binary, divide: bool) -> str:
        type = self.type(node.type)
        unit, zero = f"{type}(1)", f"{type}()"
        wrong = f"(r != {zero}) & ((r < {zero}) != (b < {zero}))"
        result = f"select(q, q - {unit}, {wrong})" if divide else f"select(r, r + b, {wrong})"
        # A division by 0 is one by 1, and so is that of the least int by -1.
        least = f"(b == {type}(-1)) & (a == {type}(-2147483647 - 1))"
        body = (
            f"let d = select(b, {unit}, (b == {zero}) | ({least})); "
            f"let q = a / d; let r = a - q * d; return {result};"
        )
        return self.helper("rhi_floor_divide" if divide else "rhi_modulo", type, "a b", body)

    def conversion(self, type: Type, source: Type) -> str:
        scalar, form = scalar_of(type), self.type(type)
        assert scalar is not None
        name = f"rhi_to_{''.join(filter(str.isalnum, form))}"
        bits = form.replace("i32", "u32")
        body = CONVERSIONS[scalar].format(type=form, source=self.type(source), bits=bits)
        self.helpers[name] = f"fn {name}(x: {self.type(source)}) -> {form} {{ {body} }}"
        return name

    def float_modulo(self, node: tree.Binary, left: str, right: str) -> str:
        name = self.helper("rhi_mod", self.type(node.type), "a b", "return a - b * floor(a / b);")
        return f"{name}({self.widened(node, node.left, left)}, {self.widened(node, node.right, right)})"

    # -- built-ins

    def builtin(self, node: tree.BuiltinCall) -> str:
        """Return a call of a built-in."""
        name, arguments, spelling = node.builtin.name, node.arguments, node.builtin.wgsl
        if arguments and isinstance(arguments[0].type, TextureType | ImageType):
            return self.texture_call(name, node)
        if name.startswith("atomic_"):
            return self.atomic(name, node)
        match spelling:
            case Refused(tip=tip):
                self.refuse(node, f"{name}()", tip)
            case Polyfill():
                return f"rhi_{name}" if name in INPUTS else _POLYFILLS[name](self, node)
        texts = self.sequence(arguments)
        if arguments and all(map(_is_constant_expression, arguments)):
            texts[0] = self.variable_value(arguments[0], texts[0])
        types = [argument.type for argument in arguments]
        widest = next((type for type in types if isinstance(type, layout.VectorType)), None)
        wide_texts = {
            f"v{i}": text
            if widest is None or isinstance(type, layout.VectorType)
            else f"{self.type(widest)}({text})"
            for i, (text, type) in enumerate(zip(texts, types, strict=True))
        }
        bits = f"vec{widest.size}<u32>" if widest is not None else "u32"
        type = self.type(node.type) if texts else ""
        return spelling.format(*texts, type=type, bits=bits, **wide_texts)

    def barrier(self, node: tree.BuiltinCall) -> str:
        self.helpers["rhi_barrier"] = BARRIER
        return "rhi_barrier()"

    def mix(self, node: tree.BuiltinCall) -> str:
        texts = ", ".join(self.sequence(node.arguments))
        return f"select({texts})" if scalar_of(node.arguments[2].type) is layout.BOOL else f"mix({texts})"

    def inverse(self, node: tree.BuiltinCall) -> str:
        (text,) = self.sequence(node.arguments)
        assert isinstance(node.type, layout.MatrixType)
        size = node.type.size
        return f"{self.helper(f'rhi_inverse{size}', self.type(node.type), 'm', INVERSES[size])}({text})"

    def pack_snorm_4x8(self, node: tree.BuiltinCall) -> str:
        (text,) = self.sequence(node.arguments)
        self.helpers["rhi_pack_snorm_4x8"] = PACK_SNORM_4X8
        return f"rhi_pack_snorm_4x8({text})"

    def atomic(self, name: str, node: tree.BuiltinCall) -> str:
        """Return a call of an atomic, or write a compare-exchange and return its result."""
        location, *values = node.arguments
        texts = self.sequence(values)
        unknown = unknown_indices(location)
        if name != "atomic_compare_exchange" and not unknown:
            return self.atomic_call(node, f"&{self.path(location)}", texts)
        texts = [
            self.hoist(expression, text, "argument") for expression, text in zip(values, texts, strict=True)
        ]
        old = self.names.get((node, "old"), "old")
        self.line(f"{self.variable(self.type(node.type), old)};", node.span)
        conditions = " && ".join(self.hoist_index(expression, node.span) for expression in unknown)
        guard = (
            self.lines.braces(f"if ({conditions})", self.file, node.span.line) if unknown else nullcontext()
        )
        with guard:
            pointer = f"&{self.path(location)}"
            if name == "atomic_compare_exchange":
                self.compare_exchange(node, old, pointer, *texts)
            else:
                self.line(f"{old} = {self.atomic_call(node, pointer, texts)};", node.span)
        for expression in unknown:
            del self.hoisted[expression]
        return old

    def atomic_call(self, node: tree.BuiltinCall, pointer: str, texts: list[str]) -> str:
        spelling = node.builtin.wgsl
        assert isinstance(spelling, str)
        return spelling.format(pointer, *texts)

    def compare_exchange(
        self, node: tree.BuiltinCall, old: str, pointer: str, expected: str, value: str
    ) -> None:
        """Write a loop around WGSL's compare-exchange, which may fail spuriously."""
        with self.lines.braces("loop", self.file, node.span.line):
            tried = self.names.get((node, "tried"), "tried")
            self.line(f"let {tried} = atomicCompareExchangeWeak({pointer}, {expected}, {value});", node.span)
            self.line(f"{old} = {tried}.old_value;", node.span)
            self.line(f"if ({tried}.exchanged || {old} != {expected}) {{ break; }}", node.span)

    def texture(self, node: tree.Read | tree.BindingRead) -> str:
        return ", ".join(self.texture_and_sampler(node))

    def texture_and_sampler(self, node: Expression) -> tuple[str, str]:
        """Return the names of a texture and of its sampler."""
        if isinstance(node, tree.BindingRead):
            return self.texture_and_sampler_names(
                node.declaration.name, ("binding", node.declaration.name), self.globals
            )
        assert isinstance(node, tree.Read)
        return self.texture_and_sampler_names(node.local.name, node.local, self.names)

    def texture_and_sampler_names(self, name: str, key: object, names: Names) -> tuple[str, str]:
        """Return the names of the texture and the sampler that a texture consists of."""
        return names.get((key, "texture"), f"{name}_texture"), names.get((key, "sampler"), f"{name}_sampler")

    def texture_call(self, name: str, node: tree.BuiltinCall) -> str:
        """Return a call of a texture's or an image's method."""
        source, *rest = node.arguments
        type, texts = source.type, ["", *self.sequence(rest)]
        assert isinstance(type, TextureType | ImageType)
        image = isinstance(type, ImageType)
        whole_level = image or type.samples  # type: ignore[union-attr]
        texture, sampler = (self.expression(source), "") if image else self.texture_and_sampler(source)
        layered = type.kind is TextureKind.D2_ARRAY
        if name == "size":
            size = f"textureDimensions({texture}{'' if whole_level else ', 0'})"
            if len(texts) > 1:  # llvmpipe returns the size of one level for all lanes
                level = f"u32(clamp({texts[1]}, 0, i32(textureNumLevels({texture})) - 1))"
                form = f"vec{3 if type.kind is TextureKind.D3 else 2}<u32>"
                size = _level_size(size, form, level)
            return (
                f"vec3<i32>(vec3<u32>({size}, textureNumLayers({texture})))"
                if layered
                else f"{self.type(node.type)}({size})"
            )
        if name == "load":
            return self.load(node, texture, texts[1:])
        at = texts[1] if rest else ""
        if layered and rest:
            if tree.has_effect(rest[0]):
                self.refuse(
                    rest[0], "a position in an array with a side effect", "assign it to a variable first"
                )
            whole = isinstance(rest[0].type, layout.VectorType) and rest[0].type.scalar is layout.INT
            at = f"{at}.xy, {f'{at}.z' if whole else f'i32(floor({at}.z + 0.5))'}"
        if name == "store":
            return f"textureStore({texture}, {at}, {texts[2]})"
        assert isinstance(type, TextureType)
        if type.scalar is not layout.FLOAT and name not in ("levels", "gather"):
            self.refuse(node, "an integer texture that is sampled", "load its texels")
        if name == "gather":
            component = "0"
            if len(rest) > 1:
                if not isinstance(rest[1], tree.Constant):
                    self.refuse(node, "a gathered component that isn't constant")
                component = str(int(rest[1].value))
            return f"textureGather({component}, {texture}, {sampler}, {at})"
        if name == "sample_compare_lod" and not (isinstance(rest[2], tree.Constant) and not rest[2].value):
            self.refuse(node, "a comparison at a mip level other than 0")
        if name == "sample_grad":
            texts[2:] = (
                f"clamp({text}, {self.type(part.type)}(-1e9), {self.type(part.type)}(1e9))"
                for text, part in zip(texts[2:], rest[1:], strict=True)
            )
        calls = TEXTURE_CALLS if self.stage is Stage.FRAGMENT else TEXTURE_CALLS | OUTSIDE_FRAGMENTS
        return calls[name].format(*texts, texture_and_sampler=f"{texture}, {sampler}", texture=texture, at=at)

    def load(self, node: tree.BuiltinCall, texture: str, texts: Sequence[str]) -> str:
        """Return a call of a helper that loads a texel, or zeros if there is none.

        WGSL lets `textureLoad` return zeros or any texel there; Dawn returns the nearest.
        """
        source, position, *rest = node.arguments
        type = source.type
        assert isinstance(type, TextureType | ImageType)
        if isinstance(source, tree.BindingRead) and isinstance(type, ImageType):
            form, index = self._image_form(source.declaration), None
        else:
            form, index = self.type(type), "0"
        samples = isinstance(type, TextureType) and bool(type.samples)
        layered = type.kind is TextureKind.D2_ARRAY
        size = f"vec{3 if type.kind is TextureKind.D3 else 2}<u32>"
        texel, sizes = ("at.xy" if layered else "at"), "textureDimensions(image)"
        name = f"rhi_load_{''.join(filter(str.isalnum, form))}"
        parameters, outside = [f"image: {form}", f"at: {self.type(position.type)}"], []
        is_first = not rest or (isinstance(rest[0], tree.Constant) and rest[0].value == 0)
        if samples or not is_first:
            index = "index"
            parameters.append("index: i32")
            outside.append(f"u32(index) >= textureNum{'Samples' if samples else 'Levels'}(image)")
            name += "_of"
            if not samples:
                sizes = _level_size(sizes, size, "u32(index)")
        else:
            texts = texts[:1]
        if layered:
            outside.append("u32(at.z) >= textureNumLayers(image)")
        outside.append(f"any({size}({texel}) >= {sizes})")
        arguments = ["image", texel, *(["at.z"] if layered else []), *([index] if index else [])]
        result = self.type(node.type)
        self.helpers[name] = (
            f"fn {name}({', '.join(parameters)}) -> {result} {{ "
            f"if ({' || '.join(outside)}) {{ return {result}(); }} "
            f"return textureLoad({', '.join(arguments)}); }}"
        )
        return f"{name}({', '.join([texture, *texts])})"

    # -- statements and functions

    def variable(self, type: str, name: str, value: str = "") -> str:
        return f"var {name}: {type} = {value}" if value else f"var {name}: {type}"

    def statement(self, node: tree.Statement) -> None:
        match node:
            case tree.Evaluate(value=tree.BuiltinCall(builtin=builtin) as call) if (
                builtin.effect in _STATEMENTS
            ):
                self.line(f"{self.expression(call)};", node.span)
            case tree.Evaluate(value=value):
                text = self.expression(value)
                is_call = isinstance(value, tree.Call | tree.BuiltinCall)
                void = is_call and isinstance(value.type, VoidType)
                self.line(f"{text};" if void else f"_ = {text};", node.span)
            case tree.Discard():
                if self.loops_discard:
                    self.helpers["rhi_discarded"] = "var<private> rhi_discarded: bool;"
                    self.line("rhi_discarded = true;", node.span)
                self.line("discard;", node.span)
            case tree.While(condition=condition) if self.needs_statements(condition):
                with self.lines.braces("loop", self.file, node.span.line):
                    self.line(f"if (!({self.expression(condition)})) {{ break; }}", node.span)
                    self.loop_body(node)
            case _:
                super().statement(node)

    def discards(self, loop: tree.While) -> bool:
        """Return whether a loop may discard the fragment, itself or by a call."""
        return any(
            isinstance(part, tree.Discard)
            or (isinstance(part, tree.Call) and part.function in self.discarding)
            for part in tree.walk([loop])
        )

    def loop_body(self, loop: tree.For | tree.While) -> None:
        if isinstance(loop, tree.While) and self.discards(loop):
            # A discarded fragment runs on, as a helper of its neighbours, and might never leave the loop.
            void = isinstance(self.function_result, VoidType)
            value = "" if void else f" {self.zero(self.function_result)}"  # type: ignore[arg-type]
            self.line(f"if (rhi_discarded) {{ return{value}; }}", loop.span)
        super().loop_body(loop)

    def store(self, target: Expression, value: str, span: SourceSpan) -> None:
        """Write the assignment of a value."""
        if isinstance(target, tree.Swizzle) and len(target.components) > 1:
            self._evaluate_indices(target)
            base, new = self.path(target.base), self.names.get((target, "new"), "new")
            self.line(f"let {new} = {value};", span)
            for number, component in enumerate(target.components):
                self.line(f"{base}.{'xyzw'[component]} = {new}.{'xyzw'[number]};", span)
            return
        declaration, type = _declaration_of(target), target.type
        if declaration is not None and self._is_loaded_in_parts(target):
            self._evaluate_indices(target)
        path, space = self.path(target), "local" if declaration is None else _space_of(declaration)
        if declaration is None or not self.memory.differs(type, space, self.is_atomic(target)):  # type: ignore[arg-type]
            self.line(f"{path} = {value};", span)
            return
        name = self.names.get((target, "whole"), "whole")
        self.line(f"let {name} = {value};", span)
        for line in self.memory.store(type, space, path, name, self.is_atomic(target)):  # type: ignore[arg-type]
            self.line(line, span)

    def repeat(self, node: tree.For, start: str, test: str, advance: str) -> None:
        more, _, step = advance.rpartition(", ")
        if not more:
            super().repeat(node, start, test, advance)
            return
        with self.lines.braces("", self.file, node.span.line):
            self.line(f"{start};", node.span)
            with self.lines.braces("loop", self.file, node.span.line):
                self.line(f"if (!({test})) {{ break; }}", node.span)
                self.loop_body(node)
                self.line(f"continuing {{ {more}; {step}; }}", node.span)

    def header(self, node: tree.Function) -> str:
        parts = []
        for local in node.parameters:
            if isinstance(local.type, TextureType):
                texture, sampler = self.texture_and_sampler_names(local.name, local, self.names)
                parts += [f"{texture}: {self.type(local.type)}", f"{sampler}: {sampler_type(local.type)}"]
            else:
                parts.append(f"{self._parameter_name(local)}: {self.type(local.type)}")
        parts += [f"rhi_{name}: {INPUTS[name][0]}" for name in self.group_inputs[node]]
        result = "" if isinstance(node.result, VoidType) else f" -> {self.type(node.result)}"
        return f"fn {self.globals.get(node, node.name)}({', '.join(parts)}){result}"

    def _parameter_name(self, local: tree.Local) -> str:
        """Return a parameter's name, which differs from the name of the variable that holds it."""
        name = self.names.get(local, local.name)
        return self.names.get((local, "parameter"), f"{name}_parameter") if _is_variable(local) else name

    def begin(self, node: tree.Function) -> None:
        self.function_result = node.result
        for local in node.parameters:
            if _is_variable(local) and not isinstance(local.type, TextureType):
                variable = self.variable(
                    self.type(local.type), self.names.get(local, local.name), self._parameter_name(local)
                )
                self.line(f"{variable};", node.span)

    def helper(self, name: str, type: str, parameters: str, body: str) -> str:
        name = f"{name}_{''.join(filter(str.isalnum, type))}"
        declarations = ", ".join(f"{parameter}: {type}" for parameter in parameters.split())
        self.helpers[name] = f"fn {name}({declarations}) -> {type} {{ {body} }}"
        return name


def _level_size(size: str, form: str, level: str) -> str:
    """Return the size of a mip level by that of the first; `form` is their type."""
    return f"max({size} >> {form}({level}), {form}(1u))"


_POLYFILLS: Final[dict[str, Callable[[WgslWriter, tree.BuiltinCall], str]]] = {
    "atan2": WgslWriter.atan2,
    "barrier": WgslWriter.barrier,
    "inverse": WgslWriter.inverse,
    "mix": WgslWriter.mix,
    "pack_snorm_4x8": WgslWriter.pack_snorm_4x8,
    "pow": WgslWriter.pow,
}
_WRITTEN: Final = {
    *_POLYFILLS,
    *INPUTS,
    "discard",  # a statement of its own: `tree.Discard`
    "atomic_compare_exchange",  # `WgslWriter.compare_exchange`
}
check_polyfills("WGSL", (row.name for row in BUILTINS.values() if row.wgsl is POLYFILL), _WRITTEN)
check_polyfills("WGSL", METHOD_NAMES, {"size", "load", "store", "gather", *TEXTURE_CALLS})


def sampler_type(type: TextureType) -> str:
    """Return the type of a texture's sampler."""
    return "sampler_comparison" if type.compare else "sampler"


def _discarding_functions(stage: tree.StageTree) -> set[tree.Function]:
    """Return the functions that may discard the fragment, themselves or by a call."""
    functions: set[tree.Function] = set()
    for function in stage.functions:  # callees come first
        for node in tree.walk(function.body):
            if isinstance(node, tree.Discard) or (isinstance(node, tree.Call) and node.function in functions):
                functions.add(function)
    return functions


def _list_group_inputs(stage: tree.StageTree) -> dict[tree.Function, list[str]]:
    """Return the inputs that a work-group shares and each function needs, itself or for a call."""
    inputs: dict[tree.Function, list[str]] = {}
    for function in stage.functions:  # callees come first
        names = {name for name in GROUP_INPUTS for native in function.native.values() if name in native.body}
        for node in tree.walk(function.body):
            if isinstance(node, tree.BuiltinCall) and node.builtin.name in GROUP_INPUTS:
                names.add(node.builtin.name)
            elif isinstance(node, tree.Call):
                names.update(inputs[node.function])
        inputs[function] = sorted(names)
    return inputs


def _is_variable(local: tree.Local) -> bool:
    """Return whether a parameter needs a variable: the function assigns it, or indexes it."""
    return bool(local.writes) or isinstance(local.type, layout.ArrayType)


def _is_constant_expression(node: Expression) -> bool:
    """Return whether WGSL evaluates an expression when it compiles it."""
    match node:
        case tree.Constant():
            return True
        case tree.Construct() | tree.Convert() | tree.Swizzle() | tree.Index() | tree.Unary():
            return all(map(_is_constant_expression, tree.parts_of(node)))
    return False  # other operations on constants are written as calls


def _is_selected(type: Type) -> bool:
    return isinstance(type, layout.ScalarType | layout.VectorType)


def _declaration_of(node: Expression) -> Declaration | None:
    """Return the binding or shared memory that an lvalue is a part of."""
    root = tree.root_of(node)
    return root.declaration if isinstance(root, tree.BindingRead) else None


def _space_of(declaration: Declaration) -> str:
    return UNIFORM if declaration.storage_class is StorageClass.UNIFORM else declaration.name


def _word_of(node: Expression) -> tuple[str, layout.StructType | None, str]:
    """Return the declaration of the words of an lvalue: the binding, the struct and its field."""
    declaration = _declaration_of(node)
    name = declaration.name if declaration is not None else ""
    while isinstance(node, tree.Index):
        node = node.base
    if isinstance(node, tree.Member):
        assert isinstance(node.base.type, layout.StructType)
        return name, node.base.type, node.name
    return name, None, ""
