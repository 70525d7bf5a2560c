"""The lowering of built-in functions: those of values through their expansions, and those that involve other
invocations: indices in the dispatch, atomics, barriers, `uniform`."""

from __future__ import annotations

from rhi.contract.layout import BOOL, INT
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import Uniformity, Value, apply, get, literal, number
from rhi.shading.language import rules
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.types import ImageType, TextureType
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.context import Lowering, lowers
from rhi.shading.lowering.expansions import convert, expansion_of, floored
from rhi.shading.lowering.lvalues import MemoryLvalue
from rhi.shading.lowering.memory import guarded, lvalue
from rhi.shading.lowering.textures import difference, lower_texture


@lowers(tree.BuiltinCall)
def lower_builtin(lowering: Lowering, node: tree.BuiltinCall, needs_result: bool = True) -> list[Value]:
    """Lower a call of a built-in to its scalars. `needs_result` is false if they are unused."""
    name = node.builtin.name
    if node.arguments and isinstance(node.arguments[0].type, TextureType | ImageType):
        return lower_texture(lowering, node)
    if name in lowering.inputs:
        return list(lowering.inputs[name])
    if name in ("ddx", "ddy"):
        return [difference(name, value) for value in lowering.named(node.arguments[0])]
    if name == "fwidth":
        values = lowering.named(node.arguments[0])
        return [apply("abs", difference("ddx", value)) + apply("abs", difference("ddy", value)) for value in values]
    if name.startswith("atomic_"):
        return lower_atomic(lowering, node, needs_result)
    if node.builtin.effect is SideEffect.BARRIER:
        lower_barrier(lowering, waits=name == "barrier")
        return []
    if name in ("global_id", "local_id", "group_id", "group_count", "local_index"):
        return dispatch_index(lowering, name)
    if name == "uniform":  # what helpers have may differ
        mask = lowering.effect_mask()
        return [broadcast_first(lowering, value, mask, lowering.checked) for value in lowering.named(node.arguments[0])]
    if name == "broadcast_first":  # helpers, too, must meet their value, or a loop that waits for it never ends
        return [broadcast_first(lowering, value, lowering.scope.mask) for value in lowering.named(node.arguments[0])]
    try:
        expand = expansion_of(node.builtin)
    except LookupError:
        lowering.refuse(rules.STAGE, name, tip="lane code doesn't support it yet")
    return expand(lowering.let, *(lowering.named(argument) for argument in node.arguments))


def broadcast_first(lowering: Lowering, value: Value, mask: lanes.Variable | None, is_checked: bool = False) -> Value:
    """Return the value of the first lane of a mask for all lanes of a work-item.

    Args:
        is_checked: whether it is a fault if a lane of the mask has another value.
    """
    if lowering.width <= 1 or value.uniformity < Uniformity.VARYING:
        return value
    if value.kind is BOOL:
        return apply("not_equal", broadcast_first(lowering, convert(value, INT), mask, is_checked), number(0))
    active = get(mask) if mask is not None else lanes.TRUE
    first = lowering.let(lanes.Apply(value.kind, Uniformity.LANES, "uniform", (value, active)))
    if is_checked:
        wrong = lowering.let(apply("not_equal", value, first), "wrong")
        lowering.emit(lanes.Check(lowering.line, wrong, apply("as_int", value), number(-1), mask))
    return first


def lower_atomic(lowering: Lowering, node: tree.BuiltinCall, needs_result: bool) -> list[Value]:
    target, *rest = node.arguments
    values = [lowering.let(value) for argument in rest for value in lowering.lower(argument)]
    guards: list[Value] = []
    at = lvalue(lowering, target, guards)
    assert isinstance(at, MemoryLvalue)
    (kind,) = all_kinds(at.type)
    result = lowering.variable("old", kind, lowering.own_uniformity) if needs_result else None
    if guards:
        kept = lowering.variable("old", kind, lowering.own_uniformity) if needs_result else None
        if kept is not None:
            lowering.emit(lanes.Let(lowering.line, kept, literal(0, kind)))
        with guarded(lowering, guards):
            emit_atomic(lowering, node, at, result, values)
            if kept is not None and result is not None:
                mask = lowering.scope.mask if lowering.scope.owns_mask else None
                lowering.emit(lanes.Set(lowering.line, kept, get(result), mask))
        return [get(kept)] if kept is not None else []
    emit_atomic(lowering, node, at, result, values)
    return [get(result)] if result is not None else []


def emit_atomic(
    lowering: Lowering, node: tree.BuiltinCall, at: MemoryLvalue, result: lanes.Variable | None, values: list[Value]
) -> None:
    (kind,) = all_kinds(at.type)
    lowering.emit(
        lanes.Atomic(
            lowering.line,
            result,
            node.builtin.name.removeprefix("atomic_"),
            kind,
            at.memory,
            at.index,
            at.scale,
            at.offset,
            tuple(values),
            lowering.effect_mask(),
        )
    )


def lower_barrier(lowering: Lowering, waits: bool) -> None:
    """Synchronise the work-group.

    All of its invocations must reach a barrier, so no enclosing condition may vary within the work-group.
    """
    if waits:
        conditions = [scope.uniformity for scope in lowering.scopes_up_to(None) if scope.kind != "function"]
        # Returns found so far stand before the barrier, so lanes may be missing.
        if max([*conditions, lowering.frame.return_uniformity]) > Uniformity.GROUP:
            lowering.refuse(
                rules.BARRIER,
                "a barrier that part of a work-group may not reach",
                "conditions and loop bounds that are the same for the whole work-group",
            )
    lowering.emit(lanes.Barrier(lowering.line, waits))


def dispatch_index(lowering: Lowering, name: str) -> list[Value]:
    """Return the components of a built-in index, such as `global_id()`."""
    sizes = lowering.work_group
    match name:
        case "local_index":
            return [local_index(lowering)]
        case "group_id" | "group_count":
            index = lanes.DispatchIndex(name)
            uniformity = Uniformity.GROUP if name == "group_id" else Uniformity.DISPATCH
            return [lanes.Input(INT, uniformity, index, axis) for axis in range(3)]
        case "local_id":
            return [local_axis(lowering, axis) for axis in range(3)]
    groups = dispatch_index(lowering, "group_id")
    return [groups[axis] * number(sizes[axis]) + local_axis(lowering, axis) for axis in range(3)]


def local_index(lowering: Lowering) -> Value:
    """Return the invocation's index in its work-group. The indices of the lanes are consecutive."""
    if lowering.work_group == (1, 1, 1):
        return number(0)
    if lowering.width == 0:
        return lanes.Input(INT, Uniformity.VARYING, lanes.DispatchIndex.LOCAL_INDEX)
    return lanes_from(lowering, lanes.Input(INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(lowering.width))


def lanes_from(lowering: Lowering, first: Value) -> Value:
    """Return `first` in the first lane, `first + 1` in the second, and so on."""
    return lanes.Affine(INT, Uniformity.VARYING, first, 1) if lowering.width > 1 else first


def local_axis(lowering: Lowering, axis: int) -> Value:
    """Return one component of `local_id()`."""
    size, before = lowering.work_group[axis], 1
    for inner in lowering.work_group[:axis]:
        before *= inner
    if size == 1:
        return number(0)
    if lowering.work_group[0] % max(lowering.width, 1) == 0 and lowering.width:
        # The lanes of a work-item are in one row.
        first = lanes.Input(INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(lowering.width)
        row = floored(False, floored(True, first, number(before)), number(size))
        return lanes_from(lowering, row) if axis == 0 else row
    index = local_index(lowering)
    return floored(False, floored(True, index, number(before)), number(size))
