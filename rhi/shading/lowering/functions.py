"""The lowering of statements, control flow and calls, and of whole compute stages and functions.

Lowering is repeated until the uniformities that it finds no longer change (`rhi.shading.lowering.context`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Final

from rhi.contract.layout import BOOL, INT, ScalarType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.faults import ENDLESS
from rhi.shading.language import rules
from rhi.shading.language.types import VOID, TextureType, VoidType
from rhi.shading.lowering import expressions
from rhi.shading.lowering.builtins import lanes_from, lower_builtin
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.context import ExpressionLowering, InlinedFrame, Lowering, MaskScope
from rhi.shading.lowering.lvalues import Slot
from rhi.shading.lowering.memory import assign, assign_to, copy, declare, new_slot, read_home
from rhi.shading.lowering.textures import binding_of


def lower_compute(
    stage: tree.StageTree, name: str, work_group: tuple[int, int, int], width: int, checked: bool = False
) -> lanes.Code:
    """Lower a compute stage for `width` lanes, or for whole arrays of any shape with 0.

    Args:
        checked: whether to test every index.

    Raises:
        ShaderError: a rule that only lowering can check, such as a barrier that part of a work-group may not
            reach.
    """
    lowering = Lowering(EXPRESSIONS, width, work_group, checked=checked)
    lowering.run_to_fixpoint(lambda: lower_entry(lowering, stage.entry, ()))
    return lowering.code(name)


def lower_function(function: tree.Function) -> lanes.Code:
    """Lower a function of values for whole arrays. Its arguments are the scalars of the parameters."""
    lowering = Lowering(EXPRESSIONS, 0)
    kinds: list[ScalarType] = []
    for parameter in function.parameters:
        kinds += all_kinds(parameter.type)  # type: ignore[arg-type]
    arguments = tuple(lanes.Argument(kind, lanes.Uniformity.VARYING, f"a{i}") for i, kind in enumerate(kinds))
    results = lowering.run_to_fixpoint(lambda: lower_entry(lowering, function, arguments))
    return lowering.code(function.name, arguments, results)


def lower_entry(
    lowering: Lowering, function: tree.Function, arguments: tuple[lanes.Value, ...]
) -> list[lanes.Value]:
    """Lower the outermost function and return its result's scalars."""
    lowering.frame = InlinedFrame(function, ())
    invocations = math.prod(lowering.work_group)
    if lowering.width > 1 and invocations % lowering.width:
        first = lanes.Input(INT, lanes.Uniformity.LANES, lanes.DispatchIndex.ITEM) * lanes.number(
            lowering.width
        )
        present = lanes.apply("less", lanes_from(lowering, first), lanes.number(invocations))
        lowering.scope.mask, lowering.scope.owns_mask = lowering.new_mask(present, "present"), True
    return inline(lowering, function, list(arguments), ())


# -- calls -------------------------------------------------------------------------------------------------


def lower_call(lowering: Lowering, node: tree.Call) -> list[lanes.Value]:
    values: list[lanes.Value] = []
    textures: dict[tree.Local, tree.BindingRead] = {}
    for parameter, argument in zip(node.function.parameters, node.arguments, strict=True):
        if isinstance(parameter.type, TextureType):
            textures[parameter] = binding_of(lowering, argument)
        else:
            values += lowering.lower(argument)
    return inline(lowering, node.function, values, (*lowering.frame.path, id(node)), textures)


def inline(
    lowering: Lowering,
    function: tree.Function,
    values: list[lanes.Value],
    path: tuple[int, ...],
    textures: dict[tree.Local, tree.BindingRead] | None = None,
) -> list[lanes.Value]:
    """Inline a call and return the scalars of its result.

    Args:
        values: the scalars of the arguments.
        path: the calls that lead here.
        textures: the bindings that are passed for texture parameters.
    """
    if function.native and not function.body:
        if not lowering.span.line:
            lowering.span = function.span  # the stage itself: no call leads to it
        lowering.refuse(
            rules.NATIVE,
            f"{function.name} has no Python body, only {', '.join(function.native)}",
            tip="write a Python body for the other languages",
        )
    caller = lowering.frame
    outer = lowering.scope
    pending = lowering.jump_pending
    span = lowering.span
    line = lowering.line
    early = tree.has_early_return(function.body) or (lowering.may_discard and not path)
    discards = lowering.discards
    frame = InlinedFrame(function, path, caller, caller.return_uniformity, textures=textures or {})
    uniformity = lowering.assume_uniformity((path, "function"))
    if early and function.result != VOID:
        for i, kind in enumerate(all_kinds(function.result)):  # type: ignore[arg-type]
            frame.results.append(
                new_slot(lowering, f"{function.name}_result", kind, (path, "result", i), None)
            )
    lowering.frame, lowering.jump_pending = frame, False
    masked = early and not (lowering.branches(uniformity) and lowering.width)
    if not masked:
        uniformity = lanes.Uniformity.DISPATCH
    lowering.scope = MaskScope("function", outer, uniformity, outer.mask, False, path)
    results: list[lanes.Value] = []
    with lowering.emit_into([]) as block:
        if masked:
            lowering.scope.mask = lowering.new_mask(lowering.mask_value(), "inside", uniformity)
            lowering.scope.owns_mask = True
        frame.inlined_call = lanes.InlinedCall(line, f"{function.name}_{lowering.count}", block)
        lowering.count += 1
        start = 0
        for parameter in function.parameters:
            if parameter in frame.textures:
                continue
            kinds = all_kinds(parameter.type)  # type: ignore[arg-type]
            declare(lowering, parameter, values[start : start + len(kinds)])
            start += len(kinds)
        for statement in function.body:
            if not early and isinstance(statement, tree.Return):
                lowering.span = statement.span
                results = lowering.lower(statement.value) if statement.value is not None else []
                results = [lowering.let(value) for value in results]
                break
            lower_statement(lowering, statement)
            lowering.emit_pending_jump()
    lowering.frame, lowering.scope, lowering.jump_pending, lowering.span = caller, outer, pending, span
    if early:
        lowering.emit(frame.inlined_call)
        results = [read_home(lowering, slot, None) for slot in frame.results]
    else:
        lowering.block.extend(block)
        if not results and not isinstance(function.result, VoidType):
            # Each path ends in a discard or an endless loop: nothing sees the value.
            results = [lanes.literal(0, kind) for kind in all_kinds(function.result)]  # type: ignore[arg-type]
    if lowering.discards > discards:  # these lanes leave the caller, too
        lowering.jump_pending = True
        lowering.frame.return_uniformity = max(lowering.frame.return_uniformity, lowering.discarded)
    return results


# -- statements --------------------------------------------------------------------------------------------


def lower_block(lowering: Lowering, block: tree.Block) -> None:
    """Lower the statements of a block."""
    for node in block:
        lower_statement(lowering, node)
        lowering.emit_pending_jump()


def lower_statement(lowering: Lowering, node: tree.Statement) -> None:
    """Lower a statement."""
    lowering.span = node.span
    match node:
        case tree.Declare(local=local, value=None):
            declare(lowering, local, None)
        case tree.Declare(local=local, value=tree.Zeros()):
            declare(lowering, local, None, zeros=True)
        case tree.Declare(local=local, value=value):
            assert value is not None
            declare(lowering, local, lowering.lower(value))
        case tree.Assign(target=target, value=value):
            values = lowering.lower(value)
            if tree.has_effect(target):
                values = [lowering.let(scalar) for scalar in values]
            assign_to(lowering, target, values)
        case tree.Evaluate(value=tree.BuiltinCall() as value):
            lower_builtin(lowering, value, needs_result=False)
        case tree.Evaluate(value=value):
            for scalar in lowering.lower(value):
                lowering.let(scalar)
        case tree.If():
            lower_if(lowering, node)
        case tree.For():
            lower_for(lowering, node)
        case tree.While(condition=condition, body=body):
            lower_loop(lowering, node, lambda: lowering.lower_scalar(condition), body, [])
        case tree.Break():
            jump(lowering, "loop", lanes.Break(lowering.line))
        case tree.Continue():
            jump(lowering, "iteration", lanes.Continue(lowering.line))
        case tree.Return(value=value):
            values = lowering.lower(value) if value is not None else []
            values = [lowering.let(scalar) for scalar in values]
            for slot, scalar in zip(lowering.frame.results, values, strict=True):
                assign(lowering, slot, scalar)
            assert lowering.frame.inlined_call is not None
            if node is lowering.frame.function.body[-1]:
                return  # the end of the body: no jump is needed
            jump(lowering, "function", lanes.Return(lowering.line, lowering.frame.inlined_call))
        case tree.Discard():
            discard(lowering)


def lower_if(lowering: Lowering, node: tree.If) -> None:
    condition = lowering.lower_scalar(node.condition)
    if isinstance(condition, lanes.Literal):
        lower_block(lowering, node.then if condition.value else node.otherwise)
        return
    if not lowering.branches(condition.uniformity):
        condition, opposite = lowering.condition_and_negation(condition)
        with lowering.branch(condition):
            lower_block(lowering, node.then)
        if node.otherwise:
            with lowering.branch(opposite):
                lower_block(lowering, node.otherwise)
        return
    outer = lowering.scope
    lowering.scope = MaskScope("branch", outer, condition.uniformity, outer.mask, False)
    with lowering.emit_into([]) as then:
        lower_block(lowering, node.then)
    with lowering.emit_into([]) as otherwise:
        lower_block(lowering, node.otherwise)
    lowering.scope = outer
    lowering.emit(lanes.If(lowering.line, condition, then, otherwise))


def lower_for(lowering: Lowering, node: tree.For) -> None:
    path = lowering.frame.path
    start = lowering.lower_scalar(node.start)
    stop = lowering.lower_scalar(node.stop)
    step = lowering.lower_scalar(node.step)
    start = lowering.let(start)
    stop = copy(lowering, stop)
    step = copy(lowering, step)
    key = (path, id(node), "count")
    uniformity = max(start.uniformity, step.uniformity)
    stride = (
        start.stride if isinstance(start, lanes.Affine) and step.uniformity < lanes.Uniformity.VARYING else 0
    )
    uniformity, stride = lowering.join(key, uniformity, stride)
    first = start.base if stride and isinstance(start, lanes.Affine) else start
    variable = lowering.variable(node.local.name, INT, lanes.Uniformity.LANES if stride else uniformity)
    lowering.emit(lanes.Let(lowering.line, variable, first))
    slot = Slot(variable, stride, key, lowering.scope)
    lowering.frame.slots[node.local] = [slot]
    count = read_home(lowering, slot, None)
    if not tree.may_overflow(node):
        advance = lanes.Set(lowering.line, variable, lanes.get(variable) + step, None)
        order = "less" if isinstance(step, lanes.Literal) and step.value > 0 else "greater"
        lower_loop(lowering, node, lambda: lanes.apply(order, count, stop), node.body, [advance])
        return
    # Whether there is a next value is known before the counter advances, which may wrap then
    # (docs/shading.md).
    up, down = lanes.apply("greater", step, lanes.number(0)), lanes.apply("less", step, lanes.number(0))
    ascending, descending = lanes.apply("less", start, stop), lanes.apply("greater", start, stop)
    last = lowering.let(last_count(stop, step))
    if isinstance(step, lanes.Literal):
        first = ascending if step.value > 0 else descending
        more = lanes.apply("less" if step.value > 0 else "greater", count, last)
    else:
        first = lanes.apply("select", up, ascending, lanes.apply("and", down, descending))
        more = lanes.apply(
            "select", up, lanes.apply("less", count, last), lanes.apply("greater", count, last)
        )
    going = lowering.variable("more", BOOL, max(first.uniformity, more.uniformity))
    lowering.emit(lanes.Let(lowering.line, going, first))
    following = lanes.apply(
        "as_int", lanes.apply("as_uint", lanes.get(variable)) + lanes.apply("as_uint", step)
    )
    steps: lanes.Block = [
        lanes.Set(lowering.line, going, more, None),
        lanes.Set(lowering.line, variable, following, None),
    ]
    lower_loop(lowering, node, lambda: lanes.get(going), node.body, steps)


def last_count(stop: lanes.Value, step: lanes.Value) -> lanes.Value:
    """Return the counter's limit: below it, one more step stays before `stop`."""
    if isinstance(stop, lanes.Literal) and isinstance(step, lanes.Literal):
        return lanes.number(min(max(int(stop.value) - int(step.value), -(2**31)), 2**31 - 1))
    least, most = lanes.number(-(2**31)), lanes.number(2**31 - 1)
    above = lanes.apply("subtract", lanes.apply("max", stop, lanes.apply("add", least, step)), step)
    below = lanes.apply("subtract", lanes.apply("min", stop, lanes.apply("add", most, step)), step)
    if isinstance(step, lanes.Literal):
        return above if step.value > 0 else below
    return lanes.apply("select", lanes.apply("greater", step, lanes.number(0)), above, below)


MAX_ITERATIONS: Final = 1 << 20
"""The iterations after which a `while` ends on OpenCL, where running work can't be cancelled, not even by
Ctrl-C."""


def lower_loop(
    lowering: Lowering,
    node: tree.Statement,
    test: Callable[[], lanes.Value],
    body: tree.Block,
    advance: lanes.Block,
) -> None:
    """Lower a loop, with a mask if its condition or one of its breaks varies."""
    key = (lowering.frame.path, id(node))
    outer = lowering.scope
    returns = lowering.returns
    uniformity = lowering.assume_uniformity((key, "loop"))
    iteration_uniformity = lowering.assume_uniformity((key, "iteration"))
    mask, masked = outer.mask, not lowering.branches(uniformity)
    lowering.frame.return_uniformity = max(
        lowering.frame.return_uniformity, lowering.assume_uniformity((key, "returns"))
    )
    if masked:
        mask = lowering.new_mask(lowering.mask_value(), "looping", uniformity)
    turns = None
    if lowering.width and isinstance(node, tree.While):
        turns = lowering.variable("turns", INT, lanes.Uniformity.LANES)
        lowering.emit(lanes.Let(lowering.line, turns, lanes.number(0)))
        advance = [*advance, lanes.Set(lowering.line, turns, lanes.get(turns) + lanes.number(1), None)]
    scope = lowering.scope = MaskScope("loop", outer, uniformity, mask, masked, key)
    with lowering.emit_into([]) as block:
        condition = test()
        lowering.join((key, "loop"), condition.uniformity)
        if masked:
            assert mask is not None
            if not (isinstance(condition, lanes.Literal) and condition.value):
                going = lanes.apply("and", lanes.get(mask), condition)
                lowering.emit(lanes.Set(lowering.line, mask, going, None))
            lowering.emit(lanes.Break(lowering.line, mask))
        elif not (isinstance(condition, lanes.Literal) and condition.value):
            stop: lanes.Block = [lanes.Break(lowering.line)]
            lowering.emit(lanes.If(lowering.line, lanes.apply("not", condition), stop, []))
        if (
            not masked
            and mask is not None
            and not lowering.branches(lowering.assume_uniformity((key, "returns")))
        ):
            lowering.emit(lanes.Break(lowering.line, mask))
        if not lowering.branches(iteration_uniformity):
            active = lowering.new_mask(lowering.mask_value(), "iteration", iteration_uniformity)
            lowering.scope = MaskScope("iteration", scope, iteration_uniformity, active, True, key)
        else:
            lowering.scope = MaskScope("iteration", scope, iteration_uniformity, mask, masked, key)
        if turns is not None:
            with lowering.emit_into([]) as end:
                if lowering.checked:
                    checked = (lanes.TRUE, lanes.get(turns), lanes.number(ENDLESS), lowering.effect_mask())
                    lowering.emit(lanes.Check(lowering.line, *checked))
                lowering.emit(lanes.Break(lowering.line))
            lowering.emit(
                lanes.If(
                    lowering.line,
                    lanes.apply("equal", lanes.get(turns), lanes.number(MAX_ITERATIONS)),
                    end,
                    [],
                )
            )
        lower_block(lowering, body)
    lowering.scope = outer
    lowering.join((key, "returns"), lowering.frame.return_uniformity)
    lowering.emit(lanes.Loop(lowering.line, block, advance))
    lowering.jump_pending = lowering.returns > returns


def jump(lowering: Lowering, kind: str, jump: lanes.Statement) -> None:
    """Lower a break, continue or return: a jump if all lanes take it, otherwise an update of the masks."""
    target = next(scope for scope in lowering.scopes_up_to(None) if scope.kind == kind)
    uniformity = max(
        [scope.uniformity for scope in lowering.scopes_up_to(target)], default=lanes.Uniformity.DISPATCH
    )
    uniformity, _ = lowering.join((target.key, kind), uniformity)
    if kind == "function":
        lowering.frame.return_uniformity = max(lowering.frame.return_uniformity, uniformity)
    if lowering.branches(uniformity) and (lowering.width or kind != "function"):
        if isinstance(jump, lanes.Return):
            jump.call.returns_early = True
        lowering.emit(jump)
    elif lowering.scope.mask is not None:  # otherwise a later run will create the mask
        lowering.narrow(target)
        lowering.jump_pending = True
        lowering.returns += kind == "function"


def discard(lowering: Lowering) -> None:
    frame, scopes = lowering.frame, list(lowering.scopes_up_to(None))
    while frame.caller is not None and frame.caller.caller is not None:
        frame = frame.caller
    target = scopes[-2]  # the entry function's scope; the last one holds the stage's mask
    uniformity = max([scope.uniformity for scope in scopes[:-2]], default=lanes.Uniformity.DISPATCH)
    lowering.join((target.key, "function"), uniformity)
    lowering.discarded = max(lowering.discarded, uniformity)
    lowering.frame.return_uniformity = max(lowering.frame.return_uniformity, uniformity)
    assert frame.inlined_call is not None
    assert isinstance(lowering.result_mask, lanes.Get)
    remaining = lanes.apply("not", lowering.mask_value())
    lowering.emit(
        lanes.Set(lowering.line, lowering.result_mask.variable, lowering.result_mask & remaining, None)
    )
    if lowering.branches(uniformity) and lowering.width:
        frame.inlined_call.returns_early = True
        lowering.emit(lanes.Return(lowering.line, frame.inlined_call))
    else:
        lowering.narrow(target)
        if lowering.has_helpers:  # helpers whose quad is discarded become inactive, too
            needed = lowering.let(lanes.apply("quads", lowering.result_mask))
            for scope in scopes[:-1]:
                if scope.owns_mask and scope.mask is not None:
                    leaving = lanes.get(scope.mask) & needed
                    lowering.emit(lanes.Set(lowering.line, scope.mask, leaving, None))
        lowering.jump_pending = True
        lowering.discards += 1
        lowering.returns += 1


EXPRESSIONS: Final[Mapping[type[tree.Expression], ExpressionLowering]] = {
    tree.Read: expressions.lower_access,
    tree.BindingRead: expressions.lower_access,
    tree.ConstantArray: expressions.lower_access,
    tree.Member: expressions.lower_access,
    tree.Swizzle: expressions.lower_access,
    tree.Index: expressions.lower_access,
    tree.Length: expressions.lower_length,
    tree.Constant: expressions.lower_constant,
    tree.Zeros: expressions.lower_zeros,
    tree.Convert: expressions.lower_conversion,
    tree.Construct: expressions.lower_construct,
    tree.Select: expressions.lower_select,
    tree.Unary: expressions.lower_unary,
    tree.Binary: expressions.lower_binary,
    tree.BuiltinCall: lower_builtin,
    tree.Call: lower_call,
}
"""The function that lowers each type of expression to its scalars."""
