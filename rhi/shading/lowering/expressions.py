"""The lowering of expressions to components: lvalues and operators."""

from __future__ import annotations

from typing import Final

from rhi.contract.layout import INT, UINT, ArrayType, Layout, MatrixType, StructType, VectorType, stride_of
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Get,
    Literal,
    MemoryRegion,
    ScalarKind,
    Uniformity,
    Value,
    Variable,
    apply,
    get,
    literal,
    number,
)
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language import rules
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import StorageType, scalar_of
from rhi.shading.lowering.components import KINDS, all_kinds, word_offsets, words_of
from rhi.shading.lowering.expansions import all_of, any_of, by_component, dot, float_modulo
from rhi.shading.lowering.lvalues import (
    LocalLvalue,
    Lvalue,
    LvalueChoice,
    MemoryLvalue,
    Slot,
    count_parts,
    element,
    member,
    part,
    select_by_index,
)
from rhi.shading.lowering.scopes import ScopeLowering

DEEPEST_VALUE: Final = 24
"""The most operations that nest in one expression of a text: C's compilers and Python's parser limit brackets."""


class ExpressionLowering(ScopeLowering):
    """Lowers the expressions of the current frame. A lowered expression is the list of its scalars."""

    def __init__(self, width: int, work_group: tuple[int, int, int]) -> None:
        super().__init__(width)
        self.work_group = work_group
        self.memories: dict[object, MemoryRegion] = {}
        self.checked = False

    # -- provided by Lowering

    def call(self, node: tree.Call) -> list[Value]:
        raise NotImplementedError

    # -- provided by BuiltinLowering

    def builtin(self, node: tree.BuiltinCall, needs_result: bool) -> list[Value]:
        """Lower a call of a built-in to its scalars. `needs_result` is false if they are unused."""
        raise NotImplementedError

    # -- overridden by StageLowering

    def effect_mask(self) -> Variable | None:
        """Return the mask of the lanes that may write to memory which other invocations see."""
        return self.scope.mask

    # -- entry points

    def one(self, node: Expression) -> Value:
        """Lower a scalar expression."""
        (value,) = self.lower(node)
        return value

    def named(self, node: Expression) -> list[Value]:
        """Lower an expression whose components are used more than once."""
        return [self.let(value) for value in self.lower(node)]

    def lower(self, node: Expression) -> list[Value]:
        """Lower an expression to its scalars, in order."""
        at = self.lvalue(node)
        if at is not None:
            return self.read(at)
        match node:
            case tree.Constant(value=value):
                return [Literal(KINDS[node.type], Uniformity.DISPATCH, value)]  # type: ignore[index]
            case tree.Member(base=base, name=name):
                assert isinstance(base.type, StructType)
                values, start = self.lower(base), 0
                for field in base.type.fields:
                    if field.name == name:
                        return values[start : start + words_of(field.type)]
                    start += words_of(field.type)
            case tree.Swizzle(base=base, components=components):
                whole = self.lvalue(base)
                if whole is not None:
                    return [value for c in components for value in self.read(part(whole, c))]
                values = self.lower(base)
                return [values[c] for c in components]
            case tree.Index(base=base, index=index):
                return self.index_value(self.named(base), words_of(node.type), self.one(index))  # type: ignore[arg-type]
            case tree.Length(base=base):
                assert isinstance(base, tree.BindingRead)
                return [lanes.ElementCount(ScalarKind.INT, Uniformity.DISPATCH, self.memory(base.declaration))]
            case tree.Unary(operator=operator, operand=operand):
                return self.shallow([apply(operator.primitive, value) for value in self.lower(operand)])
            case tree.Binary():
                return self.binary(node)
            case tree.Select(condition=condition, then=then, otherwise=otherwise):
                return self.select(self.one(condition), then, otherwise)
            case tree.Convert(type=type, value=value):
                kind = KINDS[scalar_of(type)]  # type: ignore[index]
                return self.shallow([self.convert(part, kind) for part in self.lower(value)])
            case tree.Construct():
                return self.construct(node)
            case tree.Zeros(type=type):
                return [literal(0, kind) for kind in all_kinds(type)]  # type: ignore[arg-type]
            case tree.Call():
                return self.call(node)
            case tree.BuiltinCall():
                return self.builtin(node, needs_result=True)
        raise TypeError(f"no lane code for {node}")

    def convert(self, value: Value, kind: ScalarKind) -> Value:
        """Return a component converted to another kind."""
        if value.kind is kind:
            return value
        if value.kind is ScalarKind.BOOL:
            return apply("select", value, literal(1, kind), literal(0, kind))
        if kind is ScalarKind.BOOL:
            return apply("not_equal", value, literal(0, value.kind))
        if isinstance(value, Literal) and kind is ScalarKind.FLOAT:
            return literal(float(value.value))
        if ScalarKind.FLOAT in (kind, value.kind):
            return apply(f"to_{kind.value}", value)
        return apply(f"as_{kind.value}", value)

    # -- lvalues

    def memory(self, declaration: Declaration) -> MemoryRegion:
        """Return the memory region of a binding."""
        known = self.memories.get(declaration.name)
        if known is None:
            type = declaration.type
            if declaration.storage_class is StorageClass.STORAGE:
                assert isinstance(type, StorageType)
                stride = stride_of(type.element, Layout.STD430) // 4
                known = MemoryRegion(declaration.name, AddressSpace.STORAGE, stride, 0, type.writable)
            elif declaration.storage_class is StorageClass.UNIFORM:
                words = stride_of(type, Layout.STD140) // 4  # type: ignore[arg-type]
                known = MemoryRegion(declaration.name, AddressSpace.UNIFORM, length=words)
            elif declaration.storage_class is StorageClass.SHARED:
                known = MemoryRegion(declaration.name, AddressSpace.SHARED, 1, words_of(type), True)  # type: ignore[arg-type]
            else:
                self.refuse(
                    rules.NATIVE,
                    f"{declaration.name}: {type}",
                    "buffers and values",
                    "lane code accesses textures only by their methods",
                )
            self.memories[declaration.name] = known
        return known

    def lvalue(self, node: Expression) -> Lvalue | None:
        """Return an expression as an lvalue, or None if its value has to be computed."""
        match node:
            case tree.Read(local=local):
                homes = self.frame.slots[local]
                return LocalLvalue(local.type, homes)  # type: ignore[arg-type]
            case tree.BindingRead(declaration=declaration) if declaration.storage_class in (
                StorageClass.UNIFORM,
                StorageClass.SHARED,
            ):
                layout = Layout.STD140 if declaration.storage_class is StorageClass.UNIFORM else None
                memory = self.memory(declaration)
                return MemoryLvalue(declaration.type, memory, layout, number(0), 1, 0)  # type: ignore[arg-type]
            case tree.ConstantArray(type=type):
                return MemoryLvalue(type, self.constants(node), None, number(0), 1, 0)  # type: ignore[arg-type]
            case tree.Member(base=base, name=name):
                at = self.lvalue(base)
                return member(at, name) if at is not None else None
            case tree.Swizzle(base=base, components=(component,)):
                at = self.lvalue(base)
                return part(at, component) if at is not None else None
            case tree.Index(base=tree.BindingRead(declaration=declaration), index=index) if isinstance(
                declaration.type, StorageType
            ):
                memory = self.memory(declaration)
                row = self.let(self.convert(self.one(index), ScalarKind.INT))
                row = self.check_index(row, lanes.ElementCount(ScalarKind.INT, Uniformity.DISPATCH, memory))
                return MemoryLvalue(declaration.type.element, memory, Layout.STD430, row, memory.stride, 0)
            case tree.Index(base=base, index=index):
                at = self.lvalue(base)
                if at is None:
                    return None
                row = self.let(self.convert(self.one(index), ScalarKind.INT))
                row = self.check_index(row, number(count_parts(base.type)))  # type: ignore[arg-type]
                return part(at, int(row.value)) if isinstance(row, Literal) else element(at, row)
        return None

    def check_index(self, index: Value, limit: Value) -> Value:
        """Return an index. In a checked shader, one that isn't below `limit` is reported and replaced by 0."""
        if not self.checked or (isinstance(index, Literal) and isinstance(limit, Literal)):
            return index
        wrong = self.let(apply("greater_equal", apply("as_uint", index), apply("as_uint", limit)), "wrong")
        self.emit(lanes.Check(self.line, wrong, index, limit, self.effect_mask()))
        return self.let(apply("select", wrong, number(0), index))

    def constants(self, node: tree.ConstantArray) -> MemoryRegion:
        """Return the memory region of a constant array."""
        key = ("constant", id(node))
        if key not in self.memories:
            values = [value for one in node.elements for value in self.lower(one)]
            numbers = tuple(value.value for value in values if isinstance(value, Literal))
            name = f"constant_{len(self.memories)}"
            self.memories[key] = MemoryRegion(
                name, AddressSpace.CONSTANT, 1, len(values), kind=values[0].kind, values=numbers
            )
        return self.memories[key]

    def read(self, at: Lvalue) -> list[Value]:
        """Return the scalars of an lvalue."""
        match at:
            case LocalLvalue(type=ArrayType(length=length)):
                return [value for i in range(length) for value in self.read(part(at, i))]
            case LocalLvalue(type=StructType(fields=fields)):
                return [value for field in fields for value in self.read(member(at, field.name))]
            case LocalLvalue(homes=homes, index=index):
                return [self.read_home(home, index) for home in homes]
            case MemoryLvalue(type=type, layout=layout, offset=offset):
                offsets = word_offsets(type, layout)
                return [
                    self.load(at.memory, kind, at.index, at.scale, offset + place)
                    for kind, place in zip(all_kinds(type), offsets, strict=True)
                ]
            case LvalueChoice(index=index, choices=choices):
                values_of_choices = [self.read(one) for one in choices]
                return [select_by_index(index, list(values)) for values in zip(*values_of_choices, strict=True)]

    def read_home(self, home: Slot | MemoryRegion, index: Value | None) -> Value:
        if isinstance(home, MemoryRegion):
            assert index is not None
            return self.load(home, home.kind, index, 1, 0)
        variable = home.variable
        value: Value = get(variable)
        return lanes.Affine(variable.kind, Uniformity.VARYING, value, home.stride) if home.stride else value

    def load(self, memory: MemoryRegion, kind: ScalarKind, index: Value, scale: int, offset: int) -> Value:
        """Return a word of memory. Writable memory is read here, not later where the value is used."""
        uniformity = index.uniformity
        match memory.space:
            case AddressSpace.PRIVATE:
                uniformity = max(uniformity, memory.uniformity)
            case AddressSpace.SHARED:
                uniformity = max(uniformity, Uniformity.GROUP)
            case AddressSpace.STORAGE if memory.writable:
                uniformity = max(uniformity, Uniformity.GROUP)
        is_bool = kind is ScalarKind.BOOL and memory.space is not AddressSpace.PRIVATE
        stored = ScalarKind.UINT if is_bool else kind
        mask = self.scope.mask if index.uniformity > Uniformity.DISPATCH else None
        value: Value = lanes.Load(stored, uniformity, memory, index, scale, offset, mask)
        if memory.writable:
            value = self.let(value, memory.name)
        return apply("not_equal", value, literal(0, ScalarKind.UINT)) if is_bool else value

    def index_value(self, values: list[Value], size: int, index: Value) -> list[Value]:
        """Return an element of a value that isn't an lvalue; an element has `size` components."""
        rows = [values[start : start + size] for start in range(0, len(values), size)]
        if isinstance(index, Literal):
            return rows[int(index.value)]
        index = self.check_index(self.let(index), number(len(rows)))
        return [select_by_index(index, list(column)) for column in zip(*rows, strict=True)]

    # -- operators

    def binary(self, node: tree.Binary) -> list[Value]:
        """Lower a binary operator, with Python's semantics, and the chain of operators on its left."""
        chain = tree.left_chain(node)
        values = self.lower(chain[0].left)
        for one in chain:
            values = self.shallow(self.operation(one, values))
        return values

    def shallow(self, values: list[Value]) -> list[Value]:
        """Return values, with a name for each that nests more than `DEEPEST_VALUE` operations."""
        return [
            lanes.Affine(value.kind, value.uniformity, self.shallow([value.base])[0], value.stride)
            if isinstance(value, lanes.Affine)
            else self.let(value)
            if isinstance(value, lanes.Apply) and value.depth > DEEPEST_VALUE
            else value
            for value in values
        ]

    def operation(self, node: tree.Binary, left: list[Value]) -> list[Value]:
        """Lower one binary operator, whose left operand has been lowered to `left`."""
        op = node.operator
        match op:
            case Operator.AND:
                return self.short_circuit(node, left, is_and=True)
            case Operator.OR:
                return self.short_circuit(node, left, is_and=False)
            case Operator.MATRIX_MULTIPLY:
                return self.matrix_multiply(node, left)
            case Operator.POWER:
                return self.power(node, left)
        if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
            left, right = [self.let(value) for value in left], self.named(node.right)
        else:
            right = self.lower(node.right)
        size = max(len(left), len(right))
        if size > min(len(left), len(right)):
            left, right = ([self.let(value) for value in side] if len(side) == 1 else side for side in (left, right))
        left, right = ([*side] * (size // len(side)) for side in (left, right))
        pairs = list(zip(left, right, strict=True))
        if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
            return [self.floored(op is Operator.FLOOR_DIVIDE, a, b) for a, b in pairs]
        if op in (Operator.SHIFT_LEFT, Operator.SHIFT_RIGHT):
            return [apply(op.primitive, a, self.convert(b, a.kind)) for a, b in pairs]
        results = [apply(op.primitive, a, b) for a, b in pairs]
        if op is Operator.EQUAL:
            return all_of(self.let, results)
        return any_of(self.let, results) if op is Operator.NOT_EQUAL else results

    def floored(self, divide: bool, a: Value, b: Value) -> Value:
        """Return `a // b` or, if `divide` is false, `a % b`."""
        if a.kind is ScalarKind.FLOAT:
            return apply("floor", a / b) if divide else float_modulo(a, b)
        if isinstance(b, Literal) and b.value > 0 and int(b.value).bit_count() == 1:
            if divide:
                return apply("shift_right", a, literal(int(b.value).bit_length() - 1, a.kind))
            return a & literal(int(b.value) - 1, a.kind)
        return apply("floor_divide" if divide else "modulo", a, b)

    def short_circuit(self, node: tree.Binary, operand: list[Value], is_and: bool) -> list[Value]:
        """Lower `and` or `or`: the right operand is evaluated only where the left one doesn't decide."""
        (left,) = operand
        if is_simple(node.right):
            return [apply("and" if is_and else "or", left, self.one(node.right))]
        left = self.let(left)
        uniformity = max(left.uniformity, self.known_uniformity((self.frame.path, id(node))))
        result = self.variable("condition", ScalarKind.BOOL, uniformity)
        self.emit(lanes.Let(self.line, result, left))
        with self.branch(left if is_and else apply("not", left)):
            right = self.one(node.right)
            mask = self.scope.mask if self.scope.owns_mask else None
            uniformity, _ = self.join((self.frame.path, id(node)), max(left.uniformity, right.uniformity))
            self.emit(lanes.Set(self.line, result, right, mask))
        return [Get(ScalarKind.BOOL, uniformity, result)]

    def select(self, condition: Value, then: Expression, otherwise: Expression) -> list[Value]:
        """Lower `then if condition else otherwise`."""
        if is_simple(then) and is_simple(otherwise):
            condition = self.let(condition)
            pairs = zip(self.lower(then), self.lower(otherwise), strict=True)
            return self.shallow([apply("select", condition, a, b) for a, b in pairs])
        condition, opposite = self.two_branches(condition)
        kinds, key = all_kinds(then.type), (self.frame.path, id(then))  # type: ignore[arg-type]
        slots = []
        for i, kind in enumerate(kinds):
            slots.append(self.variable("chosen", kind, max(condition.uniformity, self.known_uniformity((key, i)))))
            self.emit(lanes.Let(self.line, slots[-1], None))
        for chosen, node in ((condition, then), (opposite, otherwise)):
            with self.branch(chosen):
                values = self.lower(node)
                mask = self.scope.mask if self.scope.owns_mask else None
                for i, (slot, value) in enumerate(zip(slots, values, strict=True)):
                    slot.uniformity, _ = self.join((key, i), max(condition.uniformity, value.uniformity))
                    self.emit(lanes.Set(self.line, slot, value, mask))
        return [get(slot) for slot in slots]

    def matrix_multiply(self, node: tree.Binary, left: list[Value]) -> list[Value]:
        a, b = [self.let(value) for value in left], self.named(node.right)
        matrix = node.left.type if isinstance(node.left.type, MatrixType) else node.right.type
        assert isinstance(matrix, MatrixType)
        n = matrix.size
        if isinstance(node.right.type, VectorType):
            return [dot(self.let, a[row * n : row * n + n], b)[0] for row in range(n)]
        rows = [a] if isinstance(node.left.type, VectorType) else [a[i * n : i * n + n] for i in range(n)]
        return [dot(self.let, row, b[column::n])[0] for row in rows for column in range(n)]

    def power(self, node: tree.Binary, left: list[Value]) -> list[Value]:
        exponent, left = node.right, [self.let(value) for value in left]
        if not (isinstance(exponent, tree.Constant) and exponent.type in (INT, UINT)):
            x, y = left, self.named(exponent)
            return by_component(lambda x, y: apply("pow", x, y))(self.let, x, y)
        count, results = int(exponent.value), []
        for base in left:
            result: Value = base
            for bit in bin(abs(count))[3:]:
                result = self.let(result * result)
                if bit == "1":
                    result = result * base
            one = literal(1, base.kind)
            results.append(one if count == 0 else one / result if count < 0 else result)
        return results

    def construct(self, node: tree.Construct) -> list[Value]:
        values = [value for one in node.parts for value in self.lower(one)]
        if isinstance(node.type, VectorType) and len(values) == 1:
            return [self.let(values[0])] * node.type.size
        if isinstance(node.type, MatrixType) and len(node.parts) == 1:
            n, source = node.type.size, node.parts[0].type
            zero, one = literal(0.0), literal(1.0)
            if isinstance(source, MatrixType):
                m = source.size
                return [
                    values[i * m + j] if max(i, j) < m else one if i == j else zero for i in range(n) for j in range(n)
                ]
            diagonal = self.let(values[0])
            return [diagonal if i == j else zero for i in range(n) for j in range(n)]
        return values


def is_simple(node: Expression) -> bool:
    """Return whether inactive lanes may evaluate an expression: it has no memory access, call or side effect."""
    stack = [node]
    while stack:
        node = stack.pop()
        match node:
            case tree.Call() | tree.ConstantArray():
                return False
            case tree.BindingRead():
                if node.declaration.storage_class is not StorageClass.UNIFORM or isinstance(node.type, ArrayType):
                    return False
            case tree.Index() if isinstance(node.base.type, ArrayType | StorageType):
                return False
            case tree.BuiltinCall() if node.builtin.effect is not SideEffect.NONE:
                return False
        stack.extend(tree.parts_of(node))
    return True
