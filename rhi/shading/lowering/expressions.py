"""The lowering of expressions to components: operators, selections, constructors, and reads of memory and
locals."""

from __future__ import annotations

from typing import Final

from rhi.contract.layout import BOOL, INT, UINT, ArrayType, MatrixType, ScalarType, StructType, VectorType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import Get, Literal, Uniformity, Value, apply, get, literal
from rhi.shading.ir.tree import Expression, Operator
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.shader import StorageClass
from rhi.shading.language.types import StorageType, scalar_of
from rhi.shading.lowering.components import all_kinds, words_of
from rhi.shading.lowering.context import Lowering
from rhi.shading.lowering.expansions import all_of, any_of, by_component, convert, dot, floored
from rhi.shading.lowering.lvalues import part, select_by_index
from rhi.shading.lowering.memory import choice_of, lvalue, read, region_of

DEEPEST_VALUE: Final = 24
"""The maximum nesting of operations in an expression of a text: compilers and Python's parser limit
brackets."""


def lower_access(lowering: Lowering, node: Expression) -> list[Value]:
    """Read an lvalue, or take a part of a value that isn't one."""
    at = lvalue(lowering, node)
    if at is not None:
        return read(lowering, at)
    match node:
        case tree.Member(base=base, name=name):
            assert isinstance(base.type, StructType)
            values, start = lowering.lower(base), 0
            for field in base.type.fields:
                if field.name == name:
                    return values[start : start + words_of(field.type)]
                start += words_of(field.type)
        case tree.Swizzle(base=base, components=components):
            whole = lvalue(lowering, base)
            if whole is not None:
                return [value for c in components for value in read(lowering, part(whole, c))]
            values = lowering.lower(base)
            return [values[c] for c in components]
        case tree.Index(base=base):
            values, size = lowering.lower_named(base), words_of(node.type)  # type: ignore[arg-type]
            rows = [values[start : start + size] for start in range(0, len(values), size)]
            row = choice_of(lowering, node)
            if isinstance(row, Literal):
                return rows[int(row.value)]
            return [select_by_index(row, list(column)) for column in zip(*rows, strict=True)]
    raise TypeError(f"no lane code for {node}")


def lower_length(lowering: Lowering, node: tree.Length) -> list[Value]:
    assert isinstance(node.base, tree.BindingRead)
    return [lanes.ElementCount(INT, Uniformity.DISPATCH, region_of(lowering, node.base.declaration))]


def lower_constant(lowering: Lowering, node: tree.Constant) -> list[Value]:
    assert isinstance(node.type, ScalarType)
    return [Literal(node.type, Uniformity.DISPATCH, node.value)]


def lower_zeros(lowering: Lowering, node: tree.Zeros) -> list[Value]:
    return [literal(0, kind) for kind in all_kinds(node.type)]  # type: ignore[arg-type]


def lower_conversion(lowering: Lowering, node: tree.Convert) -> list[Value]:
    kind = scalar_of(node.type)
    assert kind is not None
    return shallow(lowering, [convert(part, kind) for part in lowering.lower(node.value)])


def lower_construct(lowering: Lowering, node: tree.Construct) -> list[Value]:
    values = [value for part in node.parts for value in lowering.lower(part)]
    if isinstance(node.type, VectorType) and len(values) == 1:
        return [lowering.let(values[0])] * node.type.size
    if isinstance(node.type, MatrixType) and len(node.parts) == 1:
        n, source = node.type.size, node.parts[0].type
        zero, unit = literal(0.0), literal(1.0)
        if isinstance(source, MatrixType):
            m = source.size
            return [
                values[i * m + j] if max(i, j) < m else unit if i == j else zero
                for i in range(n)
                for j in range(n)
            ]
        diagonal = lowering.let(values[0])
        return [diagonal if i == j else zero for i in range(n) for j in range(n)]
    return values


def lower_select(lowering: Lowering, node: tree.Select) -> list[Value]:
    """Lower `then if condition else otherwise`."""
    condition = lowering.lower_scalar(node.condition)
    then = node.then
    otherwise = node.otherwise
    if is_simple(then) and is_simple(otherwise):
        condition = lowering.let(condition)
        pairs = zip(lowering.lower(then), lowering.lower(otherwise), strict=True)
        return shallow(lowering, [apply("select", condition, a, b) for a, b in pairs])
    condition, opposite = lowering.condition_and_negation(condition)
    kinds, key = all_kinds(then.type), (lowering.frame.path, id(then))  # type: ignore[arg-type]
    slots = []
    for i, kind in enumerate(kinds):
        slots.append(
            lowering.variable("chosen", kind, max(condition.uniformity, lowering.assume_uniformity((key, i))))
        )
        lowering.emit(lanes.Let(lowering.line, slots[-1], None))
    for branch_condition, branch in ((condition, then), (opposite, otherwise)):
        with lowering.branch(branch_condition):
            values = lowering.lower(branch)
            mask = lowering.scope.mask if lowering.scope.owns_mask else None
            for i, (slot, value) in enumerate(zip(slots, values, strict=True)):
                slot.uniformity, _ = lowering.join((key, i), max(condition.uniformity, value.uniformity))
                lowering.emit(lanes.Set(lowering.line, slot, value, mask))
    return [get(slot) for slot in slots]


# -- operators ---------------------------------------------------------------------------------------------


def lower_unary(lowering: Lowering, node: tree.Unary) -> list[Value]:
    return shallow(
        lowering, [apply(node.operator.primitive, value) for value in lowering.lower(node.operand)]
    )


def lower_binary(lowering: Lowering, node: tree.Binary) -> list[Value]:
    """Lower a binary operator, with Python's semantics, and the chain of operators on its left."""
    chain = tree.left_chain(node)
    values = lowering.lower(chain[0].left)
    for operation in chain:
        values = shallow(lowering, lower_operation(lowering, operation, values))
    return values


def shallow(lowering: Lowering, values: list[Value]) -> list[Value]:
    """Return the values; each that nests more than `DEEPEST_VALUE` operations gets a name first."""
    return [
        lanes.Affine(value.kind, value.uniformity, shallow(lowering, [value.base])[0], value.stride)
        if isinstance(value, lanes.Affine)
        else lowering.let(value)
        if isinstance(value, lanes.Apply) and value.depth > DEEPEST_VALUE
        else value
        for value in values
    ]


def lower_operation(lowering: Lowering, node: tree.Binary, left: list[Value]) -> list[Value]:
    """Lower one binary operator, whose left operand has been lowered to `left`."""
    op = node.operator
    match op:
        case Operator.AND:
            return lower_short_circuit(lowering, node, left, is_and=True)
        case Operator.OR:
            return lower_short_circuit(lowering, node, left, is_and=False)
        case Operator.MATRIX_MULTIPLY:
            return lower_matrix_product(lowering, node, left)
        case Operator.POWER:
            return lower_power(lowering, node, left)
    if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
        left, right = [lowering.let(value) for value in left], lowering.lower_named(node.right)
    else:
        right = lowering.lower(node.right)
    size = max(len(left), len(right))
    if size > min(len(left), len(right)):
        left, right = (
            [lowering.let(value) for value in side] if len(side) == 1 else side for side in (left, right)
        )
    left, right = ([*side] * (size // len(side)) for side in (left, right))
    pairs = list(zip(left, right, strict=True))
    if op in (Operator.FLOOR_DIVIDE, Operator.MODULO):
        return [floored(op is Operator.FLOOR_DIVIDE, a, b) for a, b in pairs]
    if op in (Operator.SHIFT_LEFT, Operator.SHIFT_RIGHT):
        counts = [b if isinstance(b, Literal) else b & literal(31, b.kind) for _, b in pairs]
        return [apply(op.primitive, a, convert(b, a.kind)) for (a, _), b in zip(pairs, counts, strict=True)]
    results = [apply(op.primitive, a, b) for a, b in pairs]
    if op is Operator.EQUAL:
        return all_of(lowering.let, results)
    return any_of(lowering.let, results) if op is Operator.NOT_EQUAL else results


def lower_short_circuit(
    lowering: Lowering, node: tree.Binary, operand: list[Value], is_and: bool
) -> list[Value]:
    """Lower `and` or `or`: the right operand is evaluated only where the left one doesn't decide."""
    (left,) = operand
    if is_simple(node.right):
        return [apply("and" if is_and else "or", left, lowering.lower_scalar(node.right))]
    left = lowering.let(left)
    uniformity = max(left.uniformity, lowering.assume_uniformity((lowering.frame.path, id(node))))
    result = lowering.variable("condition", BOOL, uniformity)
    lowering.emit(lanes.Let(lowering.line, result, left))
    with lowering.branch(left if is_and else apply("not", left)):
        right = lowering.lower_scalar(node.right)
        mask = lowering.scope.mask if lowering.scope.owns_mask else None
        uniformity, _ = lowering.join((lowering.frame.path, id(node)), max(left.uniformity, right.uniformity))
        lowering.emit(lanes.Set(lowering.line, result, right, mask))
    return [Get(BOOL, uniformity, result)]


def lower_matrix_product(lowering: Lowering, node: tree.Binary, left: list[Value]) -> list[Value]:
    a, b = [lowering.let(value) for value in left], lowering.lower_named(node.right)
    matrix = node.left.type if isinstance(node.left.type, MatrixType) else node.right.type
    assert isinstance(matrix, MatrixType)
    n = matrix.size
    if isinstance(node.right.type, VectorType):
        return [dot(lowering.let, a[row * n : row * n + n], b)[0] for row in range(n)]
    rows = [a] if isinstance(node.left.type, VectorType) else [a[i * n : i * n + n] for i in range(n)]
    return [dot(lowering.let, row, b[column::n])[0] for row in rows for column in range(n)]


def lower_power(lowering: Lowering, node: tree.Binary, left: list[Value]) -> list[Value]:
    exponent, left = node.right, [lowering.let(value) for value in left]
    if not (isinstance(exponent, tree.Constant) and exponent.type in (INT, UINT)):
        x, y = left, lowering.lower_named(exponent)
        return by_component(lambda x, y: apply("pow", x, y))(lowering.let, x, y)
    count, results = int(exponent.value), []
    for base in left:
        result: Value = base
        for bit in bin(abs(count))[3:]:
            result = lowering.let(result * result)
            if bit == "1":
                result = result * base
        unit = literal(1, base.kind)
        results.append(unit if count == 0 else unit / result if count < 0 else result)
    return results


def is_simple(node: Expression) -> bool:
    """Return whether inactive lanes may evaluate an expression: it has no memory access, call or side
    effect."""
    stack = [node]
    while stack:
        node = stack.pop()
        match node:
            case tree.Call() | tree.ConstantArray():
                return False
            case tree.BindingRead():
                if node.declaration.storage_class is not StorageClass.UNIFORM or isinstance(
                    node.type, ArrayType
                ):
                    return False
            case tree.Index() if isinstance(node.base.type, ArrayType | StorageType) or (
                isinstance(tree.root_of(node), tree.BindingRead) and not isinstance(node.index, tree.Constant)
            ):
                return False
            case tree.BuiltinCall() if node.builtin.effect is not SideEffect.NONE:
                return False
        stack.extend(tree.parts_of(node))
    return True
