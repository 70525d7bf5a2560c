"""The lowering of built-in functions: those of values through their expansions, and those that involve other
invocations: indices in the dispatch, atomics, barriers, `uniform`."""

from __future__ import annotations

from rhi.shading.ir import lanes, tree
from rhi.shading.ir.lanes import ScalarKind, Uniformity, Value, apply, get, number
from rhi.shading.language import rules
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.types import ImageType, TextureType
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.expansions import expansion_of
from rhi.shading.lowering.expressions import ExpressionLowering
from rhi.shading.lowering.lvalues import MemoryLvalue


class BuiltinLowering(ExpressionLowering):
    """Lowers calls of `rhi.shading.language.functions`."""

    # -- provided by TextureLowering

    def texture(self, node: tree.BuiltinCall) -> list[Value]:
        """Lower a method of a texture or image, which is the call's first argument."""
        raise NotImplementedError

    # -- all calls

    def builtin(self, node: tree.BuiltinCall, needs_result: bool) -> list[Value]:
        """Lower a call of a built-in to its scalars. `needs_result` is false if they are unused."""
        name = node.builtin.name
        if node.arguments and isinstance(node.arguments[0].type, TextureType | ImageType):
            return self.texture(node)
        if name.startswith("atomic_"):
            return self.atomic(node, needs_result)
        if node.builtin.effect is SideEffect.BARRIER:
            self.barrier(waits=name == "barrier")
            return []
        if name in ("global_id", "local_id", "group_id", "group_count", "local_index"):
            return self.dispatch_index(name)
        if name == "uniform":
            return [self.uniform(value) for value in self.named(node.arguments[0])]
        try:
            expand = expansion_of(node.builtin)
        except LookupError:
            self.refuse(rules.STAGE, name, tip="lane code doesn't support it yet")
        return expand(self.let, *(self.named(argument) for argument in node.arguments))

    def uniform(self, value: Value) -> Value:
        """Return the value of the first active lane for all lanes of a work-item."""
        if self.width <= 1 or value.uniformity < Uniformity.VARYING:
            return value
        if value.kind is ScalarKind.BOOL:
            return apply("not_equal", self.uniform(self.convert(value, ScalarKind.INT)), number(0))
        mask = self.effect_mask()
        active = get(mask) if mask is not None else lanes.TRUE
        first = self.let(lanes.Apply(value.kind, Uniformity.LANES, "uniform", (value, active)))
        if self.checked:
            wrong = self.let(apply("not_equal", value, first), "wrong")
            self.emit(lanes.Check(self.line, wrong, apply("as_int", value), number(-1), self.effect_mask()))
        return first

    def atomic(self, node: tree.BuiltinCall, needs_result: bool) -> list[Value]:
        target, *rest = node.arguments
        values = [self.let(value) for argument in rest for value in self.lower(argument)]
        at = self.lvalue(target)
        assert isinstance(at, MemoryLvalue)
        (kind,) = all_kinds(at.type)
        result = self.variable("old", kind, self.own_uniformity) if needs_result else None
        self.emit(
            lanes.Atomic(
                self.line,
                result,
                node.builtin.name.removeprefix("atomic_"),
                kind,
                at.memory,
                at.index,
                at.scale,
                at.offset,
                tuple(values),
                self.effect_mask(),
            )
        )
        return [get(result)] if result is not None else []

    def barrier(self, waits: bool) -> None:
        """Synchronise the work-group.

        All of its invocations must reach a barrier, so no enclosing condition may vary within the work-group.
        """
        if waits:
            conditions = [scope.uniformity for scope in self.scopes_up_to(None) if scope.kind != "function"]
            # Returns found so far stand before the barrier, so lanes may be missing.
            if max([*conditions, self.frame.return_uniformity]) > Uniformity.GROUP:
                self.refuse(
                    rules.BARRIER,
                    "a barrier that part of a work-group may not reach",
                    "conditions and loop bounds that are the same for the whole work-group",
                )
        self.emit(lanes.Barrier(self.line, waits))

    def dispatch_index(self, name: str) -> list[Value]:
        """Return the components of a built-in index, such as `global_id()`."""
        sizes = self.work_group
        match name:
            case "local_index":
                return [self.local_index()]
            case "group_id" | "group_count":
                index = lanes.DispatchIndex(name)
                uniformity = Uniformity.GROUP if name == "group_id" else Uniformity.DISPATCH
                return [lanes.Input(ScalarKind.INT, uniformity, index, axis) for axis in range(3)]
            case "local_id":
                return [self.local_axis(axis) for axis in range(3)]
        groups = self.dispatch_index("group_id")
        return [groups[axis] * number(sizes[axis]) + self.local_axis(axis) for axis in range(3)]

    def local_index(self) -> Value:
        """Return the invocation's index in its work-group. The indices of the lanes are consecutive."""
        if self.work_group == (1, 1, 1):
            return number(0)
        if self.width == 0:
            return lanes.Input(ScalarKind.INT, Uniformity.VARYING, lanes.DispatchIndex.LOCAL_INDEX)
        return self.lanes_from(
            lanes.Input(ScalarKind.INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(self.width)
        )

    def lanes_from(self, first: Value) -> Value:
        """Return `first` in the first lane, `first + 1` in the second, and so on."""
        return lanes.Affine(ScalarKind.INT, Uniformity.VARYING, first, 1) if self.width > 1 else first

    def local_axis(self, axis: int) -> Value:
        """Return one component of `local_id()`."""
        size, before = self.work_group[axis], 1
        for inner in self.work_group[:axis]:
            before *= inner
        if size == 1:
            return number(0)
        if self.work_group[0] % max(self.width, 1) == 0 and self.width:
            # The lanes of a work-item are in one row.
            first = lanes.Input(ScalarKind.INT, Uniformity.LANES, lanes.DispatchIndex.ITEM) * number(self.width)
            row = self.floored(False, self.floored(True, first, number(before)), number(size))
            return self.lanes_from(row) if axis == 0 else row
        index = self.local_index()
        return self.floored(False, self.floored(True, index, number(before)), number(size))
