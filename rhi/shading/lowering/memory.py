"""The lowering of reads and assignments: of locals, buffers, shared memory and constant arrays.

Nothing outside memory is read or written, whatever the index (`bound_index`): a read gets the nearest
element, a write is under a condition. A variable index of a vector or matrix selects among its components,
which needs neither.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

from rhi.contract.layout import BOOL, INT, UINT, ArrayType, Layout, ScalarType, StructType, stride_of
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Affine,
    Get,
    Literal,
    MemoryRegion,
    Uniformity,
    Value,
    apply,
    get,
    literal,
    number,
)
from rhi.shading.ir.tree import Expression
from rhi.shading.language import rules
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import StorageType, count_elements
from rhi.shading.lowering import lvalues
from rhi.shading.lowering.components import all_kinds, leaf_kinds, word_offsets, words_of
from rhi.shading.lowering.context import Lowering
from rhi.shading.lowering.expansions import convert

# -- lvalues -----------------------------------------------------------------------------------------------


def region_of(lowering: Lowering, declaration: Declaration) -> MemoryRegion:
    """Return the memory region of a binding."""
    region = lowering.memories.get(declaration.name)
    if region is None:
        type = declaration.type
        if declaration.storage_class is StorageClass.STORAGE:
            assert isinstance(type, StorageType)
            stride = stride_of(type.element, Layout.STD430) // 4
            region = MemoryRegion(declaration.name, AddressSpace.STORAGE, stride, 0, type.writable)
        elif declaration.storage_class is StorageClass.UNIFORM:
            words = stride_of(type, Layout.STD140) // 4  # type: ignore[arg-type]
            region = MemoryRegion(declaration.name, AddressSpace.UNIFORM, length=words)
        elif declaration.storage_class is StorageClass.SHARED:
            region = MemoryRegion(declaration.name, AddressSpace.SHARED, 1, words_of(type), True)  # type: ignore[arg-type]
        else:
            lowering.refuse(
                rules.NATIVE,
                f"{declaration.name}: {type}",
                "buffers and values",
                "lane code accesses textures only by their methods",
            )
        lowering.memories[declaration.name] = region
    return region


def lvalue(lowering: Lowering, node: Expression, guards: list[Value] | None = None) -> lvalues.Lvalue | None:
    """Return an expression as an lvalue, or None if its value has to be computed.

    Args:
        guards: for a write, the list to which the conditions that all indices are inside are added.
    """
    match node:
        case tree.Read(local=local):
            homes = lowering.frame.slots[local]
            return lvalues.LocalLvalue(local.type, homes)  # type: ignore[arg-type]
        case tree.BindingRead(declaration=declaration) if declaration.storage_class in (
            StorageClass.UNIFORM,
            StorageClass.SHARED,
        ):
            layout = Layout.STD140 if declaration.storage_class is StorageClass.UNIFORM else None
            memory = region_of(lowering, declaration)
            return lvalues.MemoryLvalue(declaration.type, memory, layout, number(0), 1, 0)  # type: ignore[arg-type]
        case tree.ConstantArray(type=type):
            return lvalues.MemoryLvalue(type, constant_region(lowering, node), None, number(0), 1, 0)  # type: ignore[arg-type]
        case tree.Member(base=base, name=name):
            at = lvalue(lowering, base, guards)
            return lvalues.member(at, name) if at is not None else None
        case tree.Swizzle(base=base, components=(component,)):
            at = lvalue(lowering, base, guards)
            return lvalues.part(at, component) if at is not None else None
        case tree.Index(base=tree.BindingRead(declaration=declaration)) if isinstance(
            declaration.type, StorageType
        ):
            memory = region_of(lowering, declaration)
            elements = lanes.ElementCount(INT, Uniformity.DISPATCH, memory)
            row, limit = bound_index(lowering, node, elements, guards, streams=True)
            return lvalues.MemoryLvalue(
                declaration.type.element, memory, Layout.STD430, row, memory.stride, 0, limit
            )
        case tree.Index(base=base):
            at = lvalue(lowering, base, guards)
            if at is None:
                return None
            if isinstance(at, lvalues.MemoryLvalue) or isinstance(at.type, ArrayType):
                count = number(count_elements(base.type))
                row, limit = bound_index(lowering, node, count, guards, streams=is_whole(at))
            else:
                row, limit = choice_of(lowering, node), None
            if isinstance(row, Literal):
                return lvalues.part(at, int(row.value))
            at = lvalues.element(bound_lvalue(lowering, at), row)
            return replace(at, limit=limit) if isinstance(at, lvalues.MemoryLvalue) else at
    return None


def bound_index(
    lowering: Lowering, node: tree.Index, count: Value, guards: list[Value] | None, streams: bool = False
) -> tuple[Value, Value | None]:
    """Return an index as an int that is inside: below `count`, and not negative.

    Where it isn't known to be, a read gets the nearest index, and a write adds a condition to `guards`.
    Consecutive indices of a region that `streams` stay as they are, so that vectors are loaded: the second
    result is their limit.
    """
    row = lowering.let(lowering.lower_scalar(node.index))
    if lowering.checked:
        return check_index(lowering, lowering.let(convert(row, INT)), count), None
    if node.inside and not (lowering.has_helpers and is_unchecked(node)):
        return lowering.let(convert(row, INT)), None
    if guards is not None:
        guards.append(apply("less", convert(row, UINT), convert(count, UINT)))
        return lowering.let(convert(row, INT)), None
    if streams and isinstance(row, Affine) and row.kind is INT:
        return row, count
    return clamp_index(lowering, row, count), None


def clamp_index(lowering: Lowering, index: Value, count: Value) -> Value:
    """Return the index of `count` elements that is nearest to an index."""
    last = count - number(1)
    if index.kind is UINT:
        return lowering.let(convert(apply("min", index, convert(last, UINT)), INT))
    return lowering.let(apply("max", apply("min", index, last), number(0)))


def is_unchecked(node: tree.Index) -> bool:
    """Return whether an index is `unchecked(…)`, a promise that doesn't hold for helper invocations."""
    return isinstance(node.index, tree.BuiltinCall) and node.index.builtin.name == "unchecked"


def is_whole(at: lvalues.Lvalue) -> bool:
    """Return whether an array is a whole declaration of shared memory."""
    if not isinstance(at, lvalues.MemoryLvalue) or at.memory.space is not AddressSpace.SHARED:
        return False
    return isinstance(at.index, Literal) and not at.offset and words_of(at.type) == at.memory.length


def choice_of(lowering: Lowering, node: tree.Index) -> Value:
    """Return an index that selects a component of a vector or a row of a matrix."""
    row, size = lowering.let(lowering.lower_scalar(node.index)), number(count_elements(node.base.type))
    if lowering.checked:
        return check_index(lowering, lowering.let(convert(row, INT)), size)
    if row.kind is UINT and not node.inside:
        # Writes at `size` and above are still dropped.
        return clamp_index(lowering, row, size + number(1))
    return lowering.let(convert(row, INT))


def bound_lvalue(lowering: Lowering, at: lvalues.Lvalue) -> lvalues.Lvalue:
    """Return an lvalue whose index is inside, so that another can be added to it."""
    if not isinstance(at, lvalues.MemoryLvalue) or at.limit is None:
        return at
    return replace(at, index=clamp_index(lowering, at.index, at.limit), limit=None)


@contextmanager
def guarded(lowering: Lowering, guards: list[Value]) -> Iterator[None]:
    """Emit the statements of this context where all indices of a written lvalue are inside."""
    condition: Value = lanes.TRUE
    for guard in guards:
        condition = guard if condition is lanes.TRUE else condition & guard
    if condition is lanes.TRUE:
        yield
        return
    with lowering.branch(lowering.let(condition, "inside")):
        yield


def check_index(lowering: Lowering, index: Value, limit: Value) -> Value:
    """Return an index. In a checked shader, one that isn't below `limit` is reported and replaced by 0."""
    if not lowering.checked or (isinstance(index, Literal) and isinstance(limit, Literal)):
        return index
    wrong = lowering.let(apply("greater_equal", apply("as_uint", index), apply("as_uint", limit)), "wrong")
    lowering.emit(lanes.Check(lowering.line, wrong, index, limit, lowering.effect_mask()))
    return lowering.let(apply("select", wrong, number(0), index))


def constant_region(lowering: Lowering, node: tree.ConstantArray) -> MemoryRegion:
    """Return the memory region of a constant array."""
    key = ("constant", id(node))
    if key not in lowering.memories:
        values = [value for element in node.elements for value in lowering.lower(element)]
        numbers = tuple(value.value for value in values if isinstance(value, Literal))
        count = len(lowering.memories)
        while (name := f"constant_{count}") in lowering.names or name in lowering.reserved:
            count += 1
        lowering.reserved.add(name)
        lowering.memories[key] = MemoryRegion(
            name, AddressSpace.CONSTANT, 1, len(values), kind=values[0].kind, values=numbers
        )
    return lowering.memories[key]


# -- reading -----------------------------------------------------------------------------------------------


def read(lowering: Lowering, at: lvalues.Lvalue) -> list[Value]:
    """Return the scalars of an lvalue."""
    match at:
        case lvalues.LocalLvalue(type=ArrayType(length=length)):
            return [value for i in range(length) for value in read(lowering, lvalues.part(at, i))]
        case lvalues.LocalLvalue(type=StructType(fields=fields)):
            return [value for field in fields for value in read(lowering, lvalues.member(at, field.name))]
        case lvalues.LocalLvalue(homes=homes, index=index):
            return [read_home(lowering, home, index) for home in homes]
        case lvalues.MemoryLvalue(type=type, layout=layout, offset=offset):
            offsets = word_offsets(type, layout)
            return [
                load(lowering, at.memory, kind, at.index, at.scale, offset + word, at.limit)
                for kind, word in zip(all_kinds(type), offsets, strict=True)
            ]
        case lvalues.LvalueChoice(index=index, choices=choices):
            values_of_choices = [read(lowering, choice) for choice in choices]
            return [
                lvalues.select_by_index(index, list(values))
                for values in zip(*values_of_choices, strict=True)
            ]


def read_home(lowering: Lowering, home: lvalues.Slot | MemoryRegion, index: Value | None) -> Value:
    if isinstance(home, MemoryRegion):
        assert index is not None
        return load(lowering, home, home.kind, index, 1, 0)
    variable = home.variable
    value: Value = get(variable)
    return lanes.Affine(variable.kind, Uniformity.VARYING, value, home.stride) if home.stride else value


def load(
    lowering: Lowering,
    memory: MemoryRegion,
    kind: ScalarType,
    index: Value,
    scale: int,
    offset: int,
    limit: Value | None = None,
) -> Value:
    """Return a word of memory. Writable memory is read here, not later where the value is used."""
    uniformity = index.uniformity
    match memory.space:
        case AddressSpace.PRIVATE:
            uniformity = max(uniformity, memory.uniformity)
        case AddressSpace.SHARED:
            uniformity = max(uniformity, Uniformity.GROUP)
        case AddressSpace.STORAGE if memory.writable:
            uniformity = max(uniformity, Uniformity.GROUP)
    is_bool = kind is BOOL and memory.space is not AddressSpace.PRIVATE
    stored = UINT if is_bool else kind
    mask = lowering.scope.mask if index.uniformity > Uniformity.DISPATCH else None
    value: Value = lanes.Load(stored, uniformity, memory, index, scale, offset, mask, limit)
    if memory.writable:
        value = lowering.let(value, memory.name)
    return apply("not_equal", value, literal(0, UINT)) if is_bool else value


# -- declaring ---------------------------------------------------------------------------------------------


def new_slot(
    lowering: Lowering, name: str, kind: ScalarType, key: object, value: Value | None
) -> lvalues.Slot:
    """Declare a component of a local."""
    stride = value.stride if isinstance(value, Affine) else 0
    if value is not None:
        lowering.join(key, value.uniformity, stride)
    uniformity, stride = lowering.assume(key)
    variable = lowering.variable(name, kind, Uniformity.LANES if stride else uniformity)
    if stride and isinstance(value, Affine):
        value = value.base
    lowering.emit(lanes.Let(lowering.line, variable, value))
    return lvalues.Slot(variable, stride, key, lowering.scope)


def declare(lowering: Lowering, local: tree.Local, values: list[Value] | None, zeros: bool = False) -> None:
    """Declare a local, with initial scalars, zeros or no value."""
    path, type = lowering.frame.path, local.type
    homes: list[lvalues.Home] = []
    lowering.frame.slots[local] = homes
    has_arrays = any(count for _, count in leaf_kinds(type))  # type: ignore[arg-type]
    for i, (kind, count) in enumerate(leaf_kinds(type)):  # type: ignore[arg-type]
        key = (path, id(local), i)
        if count:
            uniformity = private_uniformity(lowering, key)
            memory = MemoryRegion(
                lowering.new_name(local.name), AddressSpace.PRIVATE, 1, count, True, kind, uniformity
            )
            lowering.private[id(memory)] = (key, lowering.scope)
            lowering.emit(lanes.DeclareMemory(lowering.line, memory, zeros))
            homes.append(memory)
        elif has_arrays:
            zero = literal(0, kind) if zeros else None
            homes.append(new_slot(lowering, local.name, kind, key, zero))
        else:
            value = literal(0, kind) if zeros else values[i] if values is not None else None
            homes.append(new_slot(lowering, local.name, kind, key, value))
    if has_arrays and values is not None:
        write(lowering, lvalues.LocalLvalue(type, homes), values)  # type: ignore[arg-type]


def private_uniformity(lowering: Lowering, key: object) -> Uniformity:
    """Return the uniformity of private memory so far: at best, the lanes of a work-item share it."""
    uniformity = lowering.assume_uniformity(key)
    return max(uniformity, Uniformity.LANES) if lowering.width else uniformity


# -- assigning ---------------------------------------------------------------------------------------------


def write(lowering: Lowering, at: lvalues.Lvalue, values: list[Value]) -> None:
    """Assign scalars to an lvalue."""
    match at:
        case lvalues.LocalLvalue(type=ArrayType(length=length)):
            size = len(values) // length
            for i in range(length):
                write(lowering, lvalues.part(at, i), values[i * size : (i + 1) * size])
        case lvalues.LocalLvalue(type=StructType(fields=fields)):
            start = 0
            for field in fields:
                size = len(all_kinds(field.type))
                write(lowering, lvalues.member(at, field.name), values[start : start + size])
                start += size
        case lvalues.LocalLvalue(homes=homes, index=index):
            values = without_aliases(lowering, homes, values)
            for home, value in zip(homes, values, strict=True):
                if isinstance(home, lvalues.Slot):
                    assign(lowering, home, value)
                else:
                    assert index is not None
                    store_private(lowering, home, index, value)
        case lvalues.MemoryLvalue():
            store(lowering, at, values)
        case lvalues.LvalueChoice(index=index, choices=choices):
            values = [lowering.let(value) for value in values]
            for which, choice in enumerate(choices):
                with lowering.branch(apply("equal", index, number(which))):
                    write(lowering, choice, values)


def assign_to(lowering: Lowering, target: tree.Expression, values: list[Value]) -> None:
    guards: list[Value] = []
    if isinstance(target, tree.Swizzle) and len(target.components) > 1:
        whole = lvalue(lowering, target.base, guards)
        assert whole is not None
        if isinstance(whole, lvalues.LocalLvalue):
            homes = [whole.homes[c] for c in target.components]
            values = without_aliases(lowering, homes, values)
        values = [lowering.let(value) for value in values]
        with guarded(lowering, guards):
            for component, value in zip(target.components, values, strict=True):
                write(lowering, lvalues.part(whole, component), [value])
        return
    at = lvalue(lowering, target, guards)
    assert at is not None
    if guards:
        values = [lowering.let(value) for value in values]
    with guarded(lowering, guards):
        write(lowering, at, values)


def without_aliases(
    lowering: Lowering, homes: list[lvalues.Slot | MemoryRegion], values: list[Value]
) -> list[Value]:
    """Return the values, copied if assigning one of them would change another: `v = v.yx`."""
    targets = {id(home.variable) for home in homes if isinstance(home, lvalues.Slot)}
    clash = len(values) > 1 and any(
        id(variable) in targets for value in values for variable in lanes.variables_of(value)
    )
    return [copy(lowering, value) for value in values] if clash else values


def copy(lowering: Lowering, value: Value) -> Value:
    """Return a copy of the current value."""
    if isinstance(value, Literal):
        return value
    if isinstance(value, Affine):
        return Affine(value.kind, value.uniformity, copy(lowering, value.base), value.stride)
    variable = lowering.variable("t", value.kind, value.uniformity)
    lowering.emit(lanes.Let(lowering.line, variable, value))
    return Get(value.kind, value.uniformity, variable)


def assign(lowering: Lowering, slot: lvalues.Slot, value: Value) -> None:
    """Assign a component of a local, blended unless all lanes that can read it are active."""
    uniformity, blend = value.uniformity, False
    for scope in lowering.scopes_up_to(slot.scope):
        uniformity, blend = max(uniformity, scope.uniformity), blend or scope.owns_mask
    if blend and lowering.scope.mask is not None:
        uniformity = max(uniformity, lowering.scope.mask.uniformity)
    stride = value.stride if isinstance(value, Affine) and not blend else 0
    uniformity, stride = lowering.join(slot.key, uniformity, stride)
    variable = slot.variable
    variable.uniformity, slot.stride = Uniformity.LANES if stride else uniformity, stride
    if stride and isinstance(value, Affine):
        value = value.base
    lowering.emit(lanes.Set(lowering.line, variable, value, lowering.scope.mask if blend else None))


def store_private(lowering: Lowering, memory: MemoryRegion, index: Value, value: Value) -> None:
    key, scope = lowering.private[id(memory)]
    uniformity, blend = max(value.uniformity, index.uniformity), False
    for inner in lowering.scopes_up_to(scope):
        uniformity, blend = max(uniformity, inner.uniformity), blend or inner.owns_mask
    lowering.join(key, uniformity)
    memory.uniformity = private_uniformity(lowering, key)
    # The index of an inactive lane is undefined.
    mask = lowering.scope.mask if blend or index.uniformity is Uniformity.VARYING else None
    lowering.emit(lanes.Store(lowering.line, memory, index, 1, 0, (value,), mask))


def store(lowering: Lowering, at: lvalues.MemoryLvalue, values: list[Value]) -> None:
    memory, offsets = at.memory, word_offsets(at.type, at.layout)
    if at.index.uniformity < Uniformity.VARYING and lowering.scope.mask is None:
        check_race(lowering, memory, values)
    words = [
        apply("select", value, literal(1, UINT), literal(0, UINT)) if value.kind is BOOL else value
        for value in values
    ]
    words = [lowering.let(word) for word in words]
    mask, start = lowering.effect_mask(), 0
    while start < len(words):
        end = start + 1
        while end < len(words) and offsets[end] == offsets[end - 1] + 1:
            end += 1
        run, offset = tuple(words[start:end]), at.offset + offsets[start]
        padding = int(len(words) == 3 and memory.stride == 4 and memory.space is AddressSpace.STORAGE)
        padding = padding if at.scale == 4 and at.offset == 0 and end == 3 else 0
        lowering.emit(lanes.Store(lowering.line, memory, at.index, at.scale, offset, run, mask, padding))
        start = end


def check_race(lowering: Lowering, memory: MemoryRegion, values: list[Value]) -> None:
    if math.prod(lowering.work_group) > 1 and any(value.uniformity is Uniformity.VARYING for value in values):
        lowering.refuse(
            rules.RACE,
            f"a store to one element of {memory.name} by all invocations of a work-group",
            "an index that differs between them, or one invocation: `if local_index() == 0:`",
        )
