"""The lowering of statements, control flow and calls, and of whole compute stages and functions.

Lowering is repeated until the uniformities that it finds no longer change (`rhi.shading.lowering.scopes`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

from rhi.contract.layout import ArrayType, StructType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import (
    AddressSpace,
    Affine,
    Code,
    Get,
    InlinedCall,
    Literal,
    MemoryRegion,
    ScalarKind,
    Uniformity,
    Value,
    apply,
    get,
    literal,
    number,
)
from rhi.shading.language import rules
from rhi.shading.language.types import VOID, TextureType
from rhi.shading.lowering.components import all_kinds, leaf_kinds, word_offsets
from rhi.shading.lowering.lvalues import (
    Home,
    LocalLvalue,
    Lvalue,
    LvalueChoice,
    MemoryLvalue,
    Slot,
    member,
    part,
    private_uniformity,
)
from rhi.shading.lowering.scopes import InlinedFrame, MaskScope
from rhi.shading.lowering.textures import TextureLowering


def has_lane_code(stage: tree.StageTree) -> bool:
    """Return whether a stage can be lowered: all its functions have a Python body."""
    return not any(function.native and not function.body for function in stage.functions)


def lower_compute(
    stage: tree.StageTree, name: str, work_group: tuple[int, int, int], width: int, checked: bool = False
) -> Code:
    """Lower a compute stage for `width` lanes, or for whole arrays of any shape with 0.

    Args:
        checked: whether to test every index.

    Raises:
        ShaderError: a rule that only lowering can check, such as a barrier that part of a work-group may not reach.
    """
    lowering = Lowering(width, work_group)
    lowering.checked = checked
    lowering.settle(lambda: lowering.entry(stage.entry, ()))
    memories = tuple(lowering.memories.values())
    return Code(name, width, lowering.block, memories, work_group=work_group, checked=checked)


def lower_function(function: tree.Function) -> Code:
    """Lower a function of values for whole arrays. Its arguments are the scalars of the parameters."""
    lowering = Lowering(0, (1, 1, 1))
    kinds: list[ScalarKind] = []
    for parameter in function.parameters:
        kinds += all_kinds(parameter.type)  # type: ignore[arg-type]
    arguments = tuple(lanes.Argument(kind, Uniformity.VARYING, f"a{i}") for i, kind in enumerate(kinds))
    results = lowering.settle(lambda: lowering.entry(function, arguments))
    memories = tuple(lowering.memories.values())
    return Code(function.name, 0, lowering.block, memories, arguments, tuple(results))


class Lowering(TextureLowering):
    """Lowers functions, with all functions that they call inlined."""

    def entry(self, function: tree.Function, arguments: tuple[Value, ...]) -> list[Value]:
        """Lower the outermost function and return its result's scalars."""
        self.frame = InlinedFrame(function, ())
        invocations = math.prod(self.work_group)
        if self.width > 1 and invocations % self.width:
            first = lanes.Input(ScalarKind.INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(self.width)
            present = apply("less", self.lanes_from(first), number(invocations))
            self.scope.mask, self.scope.owns_mask = self.new_mask(present, "present"), True
        return self.inline(function, list(arguments), ())

    # -- calls

    def call(self, node: tree.Call) -> list[Value]:
        values: list[Value] = []
        textures: dict[tree.Local, tree.BindingRead] = {}
        for parameter, argument in zip(node.function.parameters, node.arguments, strict=True):
            if isinstance(parameter.type, TextureType):
                textures[parameter] = self.binding_of(argument)
            else:
                values += self.lower(argument)
        return self.inline(node.function, values, (*self.frame.path, id(node)), textures)

    def inline(
        self,
        function: tree.Function,
        values: list[Value],
        path: tuple[int, ...],
        textures: dict[tree.Local, tree.BindingRead] | None = None,
    ) -> list[Value]:
        """Inline a call and return the scalars of its result.

        Args:
            values: the scalars of the arguments.
            path: the calls that lead here.
            textures: the bindings that are passed for texture parameters.
        """
        if function.native and not function.body:
            if not self.span.line:
                self.span = function.span  # the stage itself: no call leads to it
            self.refuse(
                rules.NATIVE,
                f"{function.name} has no Python body, only {', '.join(function.native)}",
                tip="write a Python body for the other languages",
            )
        caller, outer, pending, span = self.frame, self.scope, self.jump_pending, self.span
        line = self.line
        early = self.returns_early(function, path)
        frame = InlinedFrame(function, path, caller, caller.return_uniformity, textures=textures or {})
        uniformity = self.known_uniformity((path, "function"))
        if early and function.result != VOID:
            for i, kind in enumerate(all_kinds(function.result)):  # type: ignore[arg-type]
                frame.results.append(self.new_slot(f"{function.name}_result", kind, (path, "result", i), None))
        self.frame, self.jump_pending = frame, False
        masked = early and not (self.branches(uniformity) and self.width)
        if not masked:
            uniformity = Uniformity.DISPATCH
        self.scope = MaskScope("function", outer, uniformity, outer.mask, False, path)
        results: list[Value] = []
        with self.emit_into([]) as block:
            if masked:
                self.scope.mask = self.new_mask(self.mask_value(), "inside")
                self.scope.owns_mask = True
            frame.inlined_call = InlinedCall(line, f"{function.name}_{self.count}", block)
            self.count += 1
            start = 0
            for parameter in function.parameters:
                if parameter in frame.textures:
                    continue
                kinds = all_kinds(parameter.type)  # type: ignore[arg-type]
                self.declare(parameter, values[start : start + len(kinds)])
                start += len(kinds)
            for statement in function.body:
                if not early and isinstance(statement, tree.Return):
                    self.span = statement.span
                    results = self.lower(statement.value) if statement.value is not None else []
                    results = [self.let(value) for value in results]
                    break
                self.statement(statement)
                self.emit_pending_jump()
        self.frame, self.scope, self.jump_pending, self.span = caller, outer, pending, span
        if early:
            self.emit(frame.inlined_call)
            results = [self.read_home(slot, None) for slot in frame.results]
        else:
            self.block.extend(block)
        return results

    # -- overridden by StageLowering

    def returns_early(self, function: tree.Function, path: tuple[int, ...]) -> bool:
        """Return whether a function returns anywhere but in its last statement."""
        return tree.has_early_return(function.body)

    def discard(self) -> None:
        """End the active lanes."""
        self.refuse(rules.STAGE, "discard()")

    # -- locals

    def new_slot(self, name: str, kind: ScalarKind, key: object, value: Value | None) -> Slot:
        """Declare a component of a local."""
        stride = value.stride if isinstance(value, Affine) else 0
        if value is not None:
            self.join(key, value.uniformity, stride)
        uniformity, stride = self.known(key)
        variable = self.variable(name, kind, Uniformity.LANES if stride else uniformity)
        if stride and isinstance(value, Affine):
            value = value.base
        self.emit(lanes.Let(self.line, variable, value))
        return Slot(variable, stride, key, self.scope)

    def declare(self, local: tree.Local, values: list[Value] | None, zeros: bool = False) -> None:
        """Declare a local, with initial scalars, zeros or no value."""
        path, type = self.frame.path, local.type
        homes: list[Home] = []
        self.frame.slots[local] = homes
        has_arrays = any(count for _, count in leaf_kinds(type))  # type: ignore[arg-type]
        for i, (kind, count) in enumerate(leaf_kinds(type)):  # type: ignore[arg-type]
            key = (path, id(local), i)
            if count:
                uniformity = self.known_uniformity(key)
                if self.width:
                    uniformity = private_uniformity(uniformity)
                self.count += 1
                name = f"{local.name}_{self.count}"
                memory = MemoryRegion(name, AddressSpace.PRIVATE, 1, count, True, kind, uniformity)
                self.private[id(memory)] = (key, self.scope)
                self.emit(lanes.DeclareMemory(self.line, memory, zeros))
                homes.append(memory)
            elif has_arrays:
                zero = literal(0, kind) if zeros else None
                homes.append(self.new_slot(local.name, kind, key, zero))
            else:
                value = literal(0, kind) if zeros else values[i] if values is not None else None
                homes.append(self.new_slot(local.name, kind, key, value))
        if has_arrays and values is not None:
            self.write(LocalLvalue(type, homes), values)  # type: ignore[arg-type]

    # -- assignment

    def write(self, at: Lvalue, values: list[Value]) -> None:
        """Assign scalars to an lvalue."""
        match at:
            case LocalLvalue(type=ArrayType(length=length)):
                size = len(values) // length
                for i in range(length):
                    self.write(part(at, i), values[i * size : (i + 1) * size])
            case LocalLvalue(type=StructType(fields=fields)):
                start = 0
                for field in fields:
                    size = len(all_kinds(field.type))
                    self.write(member(at, field.name), values[start : start + size])
                    start += size
            case LocalLvalue(homes=homes, index=index):
                values = self.without_aliases(homes, values)
                for home, value in zip(homes, values, strict=True):
                    if isinstance(home, Slot):
                        self.assign(home, value)
                    else:
                        assert index is not None
                        self.store_private(home, index, value)
            case MemoryLvalue():
                self.store(at, values)
            case LvalueChoice(index=index, choices=choices):
                values = [self.let(value) for value in values]
                for which, one in enumerate(choices):
                    with self.branch(apply("equal", index, number(which))):
                        self.write(one, values)

    def without_aliases(self, homes: list[Slot | MemoryRegion], values: list[Value]) -> list[Value]:
        """Return the values, copied if assigning one of them would change another: `v = v.yx`."""
        targets = {id(home.variable) for home in homes if isinstance(home, Slot)}
        clash = len(values) > 1 and any(
            id(variable) in targets for value in values for variable in lanes.variables_of(value)
        )
        return [self.copy(value) for value in values] if clash else values

    def copy(self, value: Value) -> Value:
        """Return a copy of the current value."""
        if isinstance(value, Literal):
            return value
        if isinstance(value, Affine):
            return Affine(value.kind, value.uniformity, self.copy(value.base), value.stride)
        variable = self.variable("t", value.kind, value.uniformity)
        self.emit(lanes.Let(self.line, variable, value))
        return Get(value.kind, value.uniformity, variable)

    def assign(self, slot: Slot, value: Value) -> None:
        """Assign a component of a local, blended unless all lanes that can read it are active."""
        uniformity, blend = value.uniformity, False
        for scope in self.scopes_up_to(slot.scope):
            uniformity, blend = max(uniformity, scope.uniformity), blend or scope.owns_mask
        if blend and self.scope.mask is not None:
            uniformity = max(uniformity, self.scope.mask.uniformity)
        stride = value.stride if isinstance(value, Affine) and not blend else 0
        uniformity, stride = self.join(slot.key, uniformity, stride)
        variable = slot.variable
        variable.uniformity, slot.stride = Uniformity.LANES if stride else uniformity, stride
        if stride and isinstance(value, Affine):
            value = value.base
        self.emit(lanes.Set(self.line, variable, value, self.scope.mask if blend else None))

    def store_private(self, memory: MemoryRegion, index: Value, value: Value) -> None:
        key, scope = self.private[id(memory)]
        uniformity, blend = max(value.uniformity, index.uniformity), False
        for inner in self.scopes_up_to(scope):
            uniformity, blend = max(uniformity, inner.uniformity), blend or inner.owns_mask
        self.join(key, uniformity)
        memory.uniformity = private_uniformity(self.known_uniformity(key)) if self.width else self.known_uniformity(key)
        # The index of an inactive lane is undefined.
        mask = self.scope.mask if blend or index.uniformity is Uniformity.VARYING else None
        self.emit(lanes.Store(self.line, memory, index, 1, 0, (value,), mask))

    def store(self, at: MemoryLvalue, values: list[Value]) -> None:
        memory, offsets = at.memory, word_offsets(at.type, at.layout)
        if at.index.uniformity < Uniformity.VARYING and self.scope.mask is None:
            self.check_race(memory, values)
        words = [
            apply("select", value, literal(1, ScalarKind.UINT), literal(0, ScalarKind.UINT))
            if value.kind is ScalarKind.BOOL
            else value
            for value in values
        ]
        words = [self.let(word) for word in words]
        mask, start = self.effect_mask(), 0
        while start < len(words):
            end = start + 1
            while end < len(words) and offsets[end] == offsets[end - 1] + 1:
                end += 1
            run, offset = tuple(words[start:end]), at.offset + offsets[start]
            padding = int(len(words) == 3 and memory.stride == 4 and memory.space is AddressSpace.STORAGE)
            padding = padding if at.scale == 4 and at.offset == 0 and end == 3 else 0
            self.emit(lanes.Store(self.line, memory, at.index, at.scale, offset, run, mask, padding))
            start = end

    def check_race(self, memory: MemoryRegion, values: list[Value]) -> None:
        if math.prod(self.work_group) > 1 and any(value.uniformity is Uniformity.VARYING for value in values):
            self.refuse(
                rules.RACE,
                f"a store to one element of {memory.name} by all invocations of a work-group",
                "an index that differs between them, or one invocation: `if local_index() == 0:`",
            )

    # -- statements

    def statements(self, block: tree.Block) -> None:
        """Lower the statements of a block."""
        for node in block:
            self.statement(node)
            self.emit_pending_jump()

    def statement(self, node: tree.Statement) -> None:
        """Lower a statement."""
        self.span = node.span
        match node:
            case tree.Declare(local=local, value=None):
                self.declare(local, None)
            case tree.Declare(local=local, value=tree.Zeros()):
                self.declare(local, None, zeros=True)
            case tree.Declare(local=local, value=value):
                assert value is not None
                self.declare(local, self.lower(value))
            case tree.Assign(target=target, value=value):
                values = self.lower(value)
                if tree.has_effect(target):
                    values = [self.let(one) for one in values]
                self.assign_to(target, values)
            case tree.Evaluate(value=tree.BuiltinCall() as value):
                self.builtin(value, needs_result=False)
            case tree.Evaluate(value=value):
                for one in self.lower(value):
                    self.let(one)
            case tree.If():
                self.if_(node)
            case tree.For():
                self.for_(node)
            case tree.While(condition=condition, body=body):
                self.loop(node, lambda: self.one(condition), body, [])
            case tree.Break():
                self.jump("loop", lanes.Break(self.line))
            case tree.Continue():
                self.jump("iteration", lanes.Continue(self.line))
            case tree.Return(value=value):
                values = self.lower(value) if value is not None else []
                values = [self.let(one) for one in values]
                for slot, one in zip(self.frame.results, values, strict=True):
                    self.assign(slot, one)
                assert self.frame.inlined_call is not None
                if node is self.frame.function.body[-1]:
                    return  # the end of the body: no jump is needed
                self.jump("function", lanes.Return(self.line, self.frame.inlined_call))
            case tree.Discard():
                self.discard()

    def assign_to(self, target: tree.Expression, values: list[Value]) -> None:
        if isinstance(target, tree.Swizzle) and len(target.components) > 1:
            whole = self.lvalue(target.base)
            assert whole is not None
            if isinstance(whole, LocalLvalue):
                homes = [whole.homes[c] for c in target.components]
                values = self.without_aliases(homes, values)
            values = [self.let(value) for value in values]
            for component, value in zip(target.components, values, strict=True):
                self.write(part(whole, component), [value])
            return
        at = self.lvalue(target)
        assert at is not None
        self.write(at, values)

    def if_(self, node: tree.If) -> None:
        condition = self.one(node.condition)
        if isinstance(condition, Literal):
            self.statements(node.then if condition.value else node.otherwise)
            return
        if not self.branches(condition.uniformity):
            condition, opposite = self.two_branches(condition)
            with self.branch(condition):
                self.statements(node.then)
            if node.otherwise:
                with self.branch(opposite):
                    self.statements(node.otherwise)
            return
        outer = self.scope
        self.scope = MaskScope("branch", outer, condition.uniformity, outer.mask, False)
        with self.emit_into([]) as then:
            self.statements(node.then)
        with self.emit_into([]) as otherwise:
            self.statements(node.otherwise)
        self.scope = outer
        self.emit(lanes.If(self.line, condition, then, otherwise))

    def for_(self, node: tree.For) -> None:
        path = self.frame.path
        start, stop, step = self.one(node.start), self.one(node.stop), self.one(node.step)
        start, stop, step = self.let(start), self.copy(stop), self.copy(step)
        key = (path, id(node), "count")
        uniformity = max(start.uniformity, step.uniformity)
        stride = start.stride if isinstance(start, Affine) and step.uniformity < Uniformity.VARYING else 0
        uniformity, stride = self.join(key, uniformity, stride)
        first = start.base if stride and isinstance(start, Affine) else start
        variable = self.variable(node.local.name, ScalarKind.INT, Uniformity.LANES if stride else uniformity)
        self.emit(lanes.Let(self.line, variable, first))
        slot = Slot(variable, stride, key, self.scope)
        self.frame.slots[node.local] = [slot]
        count = self.read_home(slot, None)
        if not tree.may_overflow(node):
            advance = lanes.Set(self.line, variable, get(variable) + step, None)
            order = "less" if isinstance(step, Literal) and step.value > 0 else "greater"
            self.loop(node, lambda: apply(order, count, stop), node.body, [advance])
            return
        # Whether there is a next value is known before the counter advances, which may wrap then (docs/shading.md).
        up, down = apply("greater", step, number(0)), apply("less", step, number(0))
        ascending, descending = apply("less", start, stop), apply("greater", start, stop)
        last = self.let(self.last_count(stop, step))
        if isinstance(step, Literal):
            first = ascending if step.value > 0 else descending
            more = apply("less" if step.value > 0 else "greater", count, last)
        else:
            first = apply("select", up, ascending, apply("and", down, descending))
            more = apply("select", up, apply("less", count, last), apply("greater", count, last))
        going = self.variable("more", ScalarKind.BOOL, max(first.uniformity, more.uniformity))
        self.emit(lanes.Let(self.line, going, first))
        following = apply("as_int", apply("as_uint", get(variable)) + apply("as_uint", step))
        steps: lanes.Block = [
            lanes.Set(self.line, going, more, None),
            lanes.Set(self.line, variable, following, None),
        ]
        self.loop(node, lambda: get(going), node.body, steps)

    def last_count(self, stop: Value, step: Value) -> Value:
        """Return the value that a loop's counter must not have reached for one more step to stay before `stop`."""
        if isinstance(stop, Literal) and isinstance(step, Literal):
            return number(min(max(int(stop.value) - int(step.value), -(2**31)), 2**31 - 1))
        least, most = number(-(2**31)), number(2**31 - 1)
        above = apply("subtract", apply("max", stop, apply("add", least, step)), step)
        below = apply("subtract", apply("min", stop, apply("add", most, step)), step)
        if isinstance(step, Literal):
            return above if step.value > 0 else below
        return apply("select", apply("greater", step, number(0)), above, below)

    def loop(self, node: tree.Statement, test: Callable[[], Value], body: tree.Block, advance: lanes.Block) -> None:
        """Lower a loop, with a mask if its condition or one of its breaks varies."""
        key, outer, returns = (self.frame.path, id(node)), self.scope, self.returns
        uniformity = self.known_uniformity((key, "loop"))
        iteration_uniformity = self.known_uniformity((key, "iteration"))
        mask, masked = outer.mask, not self.branches(uniformity)
        self.frame.return_uniformity = max(self.frame.return_uniformity, self.known_uniformity((key, "returns")))
        if masked:
            mask = self.new_mask(self.mask_value(), "looping")
        scope = self.scope = MaskScope("loop", outer, uniformity, mask, masked, key)
        with self.emit_into([]) as block:
            condition = test()
            self.join((key, "loop"), condition.uniformity)
            if masked:
                assert mask is not None
                if not (isinstance(condition, Literal) and condition.value):
                    both = apply("and", get(mask), condition)
                    self.emit(lanes.Set(self.line, mask, both, None))
                self.emit(lanes.Break(self.line, mask))
            elif not (isinstance(condition, Literal) and condition.value):
                stop: lanes.Block = [lanes.Break(self.line)]
                self.emit(lanes.If(self.line, apply("not", condition), stop, []))
            if not masked and mask is not None and not self.branches(self.known_uniformity((key, "returns"))):
                self.emit(lanes.Break(self.line, mask))
            if not self.branches(iteration_uniformity):
                active = self.new_mask(self.mask_value(), "iteration")
                self.scope = MaskScope("iteration", scope, iteration_uniformity, active, True, key)
            else:
                self.scope = MaskScope("iteration", scope, iteration_uniformity, mask, masked, key)
            self.statements(body)
        self.scope = outer
        self.join((key, "returns"), self.frame.return_uniformity)
        self.emit(lanes.Loop(self.line, block, advance))
        self.jump_pending = self.returns > returns

    def jump(self, kind: str, jump: lanes.Statement) -> None:
        """Lower a break, continue or return: a jump if all lanes take it, otherwise the masks lose lanes."""
        target = next(scope for scope in self.scopes_up_to(None) if scope.kind == kind)
        uniformity = max([scope.uniformity for scope in self.scopes_up_to(target)], default=Uniformity.DISPATCH)
        uniformity, _ = self.join((target.key, kind), uniformity)
        if kind == "function":
            self.frame.return_uniformity = max(self.frame.return_uniformity, uniformity)
        if self.branches(uniformity) and (self.width or kind != "function"):
            if isinstance(jump, lanes.Return):
                jump.call.returns_early = True
            self.emit(jump)
        elif self.scope.mask is not None:  # otherwise a later run will create the mask
            self.narrow(target)
            self.jump_pending = True
            self.returns += kind == "function"
