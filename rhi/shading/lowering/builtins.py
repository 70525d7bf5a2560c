"""The lowering of built-in functions.

Functions of values are expanded (`rhi.shading.lowering.expansions`). Functions that involve other invocations
are lowered
here: indices in the dispatch, atomics, barriers, `uniform`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from rhi.contract.layout import BOOL, INT
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import Uniformity, Value, apply, get, literal, number
from rhi.shading.language import rules
from rhi.shading.language.builtins import BUILTINS, POLYFILL, check_polyfills
from rhi.shading.language.types import ImageType, TextureType
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.context import Lowering
from rhi.shading.lowering.expansions import FUNCTIONS, convert, expansion_of, floored
from rhi.shading.lowering.lvalues import MemoryLvalue
from rhi.shading.lowering.memory import guarded, lvalue
from rhi.shading.lowering.stage_inputs import STAGE_INPUTS
from rhi.shading.lowering.textures import difference, lower_texture


def lower_builtin(lowering: Lowering, node: tree.BuiltinCall, needs_result: bool = True) -> list[Value]:
    """Lower a call of a built-in to its scalars. `needs_result` is false if they are unused."""
    name = node.builtin.name
    if node.arguments and isinstance(node.arguments[0].type, TextureType | ImageType):
        return lower_texture(lowering, node)
    if name in lowering.inputs:
        return list(lowering.inputs[name])
    if name.startswith("atomic_"):
        return lower_atomic(lowering, node, needs_result)
    lower = _FUNCTIONS.get(name)
    if lower is not None:
        return lower(lowering, node)
    expand = expansion_of(node.builtin)
    return expand(lowering.let, *(lowering.lower_named(argument) for argument in node.arguments))


def lower_difference(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    return [difference(node.builtin.name, value) for value in lowering.lower_named(node.arguments[0])]


def lower_fwidth(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    values = lowering.lower_named(node.arguments[0])
    return [
        apply("abs", difference("ddx", value)) + apply("abs", difference("ddy", value)) for value in values
    ]


def lower_uniform(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    mask = lowering.effect_mask()  # the values of helpers may differ
    return [
        broadcast_first(lowering, value, mask, lowering.checked)
        for value in lowering.lower_named(node.arguments[0])
    ]


def lower_broadcast_first(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    # Helpers, too, must meet their value, or a loop that waits for it never ends.
    mask = lowering.scope.mask
    return [broadcast_first(lowering, value, mask) for value in lowering.lower_named(node.arguments[0])]


def lower_dispatch_index(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    return dispatch_index(lowering, node.builtin.name)


def broadcast_first(
    lowering: Lowering, value: Value, mask: lanes.Variable | None, is_checked: bool = False
) -> Value:
    """Return the value of the first lane of a mask for all lanes of a work-item.

    Args:
        is_checked: whether another value in a lane of the mask is reported as a fault.
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
        guarded_result = lowering.variable("old", kind, lowering.own_uniformity) if needs_result else None
        if guarded_result is not None:
            lowering.emit(lanes.Let(lowering.line, guarded_result, literal(0, kind)))
        with guarded(lowering, guards):
            emit_atomic(lowering, node, at, result, values)
            if guarded_result is not None and result is not None:
                mask = lowering.scope.mask if lowering.scope.owns_mask else None
                lowering.emit(lanes.Set(lowering.line, guarded_result, get(result), mask))
        return [get(guarded_result)] if guarded_result is not None else []
    emit_atomic(lowering, node, at, result, values)
    return [get(result)] if result is not None else []


def emit_atomic(
    lowering: Lowering,
    node: tree.BuiltinCall,
    at: MemoryLvalue,
    result: lanes.Variable | None,
    values: list[Value],
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


def lower_barrier(lowering: Lowering, node: tree.BuiltinCall) -> list[Value]:
    """Lower `barrier()` or `memory_barrier()`.

    All invocations of a work-group must reach a barrier, so no enclosing condition may vary within the
    work-group.
    """
    waits = node.builtin.name == "barrier"
    if waits:
        conditions = [scope.uniformity for scope in lowering.scopes_up_to(None) if scope.kind != "function"]
        # Invocations that returned before the barrier don't reach it.
        if max([*conditions, lowering.frame.return_uniformity]) > Uniformity.GROUP:
            lowering.refuse(
                rules.BARRIER,
                "a barrier that part of a work-group may not reach",
                "conditions and loop bounds that are the same for the whole work-group",
            )
    lowering.emit(lanes.Barrier(lowering.line, waits))
    return []


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
    return lanes_from(
        lowering, lanes.Input(INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(lowering.width)
    )


def lanes_from(lowering: Lowering, first: Value) -> Value:
    """Return `first` in the first lane, `first + 1` in the second, and so on."""
    return lanes.Affine(INT, Uniformity.VARYING, first, 1) if lowering.width > 1 else first


def local_axis(lowering: Lowering, axis: int) -> Value:
    """Return one component of `local_id()`, the invocation's index in its work-group along an axis."""
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


_FUNCTIONS: Final[dict[str, Callable[[Lowering, tree.BuiltinCall], list[Value]]]] = {
    "ddx": lower_difference,
    "ddy": lower_difference,
    "fwidth": lower_fwidth,
    "uniform": lower_uniform,
    "broadcast_first": lower_broadcast_first,
    "barrier": lower_barrier,
    "memory_barrier": lower_barrier,
    **dict.fromkeys(
        ("global_id", "local_id", "group_id", "group_count", "local_index"), lower_dispatch_index
    ),
}
"""The built-ins that involve other invocations, with the functions that lower them."""

_WRITTEN: Final = {
    *FUNCTIONS,
    *_FUNCTIONS.keys() - {"ddx", "ddy"},  # which have spellings, too
    "discard",  # a statement of its own: `tree.Discard`
    *(name for name in BUILTINS if name.startswith("atomic_")),  # `lower_atomic`
    *(
        name for inputs in STAGE_INPUTS.values() for name in inputs
    ),  # arguments of the stage: `Lowering.inputs`
}
check_polyfills("lane code", (row.name for row in BUILTINS.values() if row.lanes is POLYFILL), _WRITTEN)
