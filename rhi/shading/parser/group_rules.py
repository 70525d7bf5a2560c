"""A quick check of barriers and stores on the typed tree, which spares most compute stages a lowering.

Two rules depend on which values differ within a work-group: all invocations must reach a barrier together
(`shading-barrier`), and they must not store different values to one element (`shading-race`). Lane code knows
the uniformity of every value, but lowering takes longer than parsing. Most stages obviously keep both rules,
so only the doubtful ones are lowered to be checked. The check errs on one side: lowering accepts each stage
that isn't doubtful.
"""

from __future__ import annotations

import enum
import math
from typing import Final

from rhi.contract.layout import INT, UINT
from rhi.shading.ir import tree
from rhi.shading.ir.lanes import WIDTH
from rhi.shading.ir.tree import Block, Expression, Operator
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.shader import StorageClass

_COMPARISONS: Final = frozenset(
    {
        Operator.EQUAL,
        Operator.NOT_EQUAL,
        Operator.LESS,
        Operator.LESS_EQUAL,
        Operator.GREATER,
        Operator.GREATER_EQUAL,
    }
)


class LaneClass(enum.Enum):
    """The variation of a value among the lanes of a work-item.

    A work-group shares GROUP values, and the lanes of a work-item share LANES values. RISING values differ:
    they grow with the lane, or follow no pattern. NOT_FALLING values are one or the other. UNKNOWN values may
    also fall.
    """

    GROUP = "group"
    LANES = "lanes"
    RISING = "rising"
    NOT_FALLING = "not falling"
    UNKNOWN = "unknown"


_SHARED: Final = (LaneClass.GROUP, LaneClass.LANES)
_ADDABLE: Final = (*_SHARED, LaneClass.RISING, LaneClass.NOT_FALLING)
"""The classes whose sums don't fall: added to a rising value, they leave a rising one."""


def may_break_group_rules(stage: tree.StageTree, work_group: tuple[int, int, int]) -> bool:
    """Return whether the tree leaves a doubt that a compute stage keeps the rules about barriers and
    stores."""
    screening = _Screening(stage, work_group)
    return screening.has_doubtful_barrier() or screening.has_doubtful_store()


class _Screening:
    def __init__(self, stage: tree.StageTree, work_group: tuple[int, int, int]) -> None:
        self.stage = stage
        self.work_group = work_group
        self.with_barrier: set[tree.Function] = set()
        self.local_classes: dict[tree.Local, LaneClass] = {}
        """The class of each local that only its declaration assigns, and of the counters of loops that count
        up."""
        assigned = self._collect()
        for function in stage.functions:
            for node in tree.walk(function.body):  # a local is declared before it is read
                match node:
                    case tree.Declare(local=local, value=Expression() as value) if local not in assigned:
                        self.local_classes[local] = self.lane_class(value)
                    case tree.For(local=local, start=start, step=tree.Constant(value=step)) if step > 0:
                        rises = self.lane_class(start) in _ADDABLE
                        self.local_classes[local] = LaneClass.NOT_FALLING if rises else LaneClass.UNKNOWN

    def _collect(self) -> set[tree.Local]:
        """Return the locals that an assignment changes, and collect the functions that reach a barrier."""
        assigned: set[tree.Local] = set()
        for function in self.stage.functions:  # callees come first
            for node in tree.walk(function.body):
                match node:
                    case tree.Assign(target=target):
                        root = tree.root_of(target)
                        if isinstance(root, tree.Read):
                            assigned.add(root.local)
                    case tree.BuiltinCall() | tree.Call() if self._reaches_barrier(node):
                        self.with_barrier.add(function)
        return assigned

    # -- barriers

    def has_doubtful_barrier(self) -> bool:
        return any(
            self._has_doubtful_barrier(function.body) or tree.has_early_return(function.body)
            for function in self.with_barrier
        )

    def _has_doubtful_barrier(self, block: Block) -> bool:
        """Return whether a barrier lies under a condition that may differ within the work-group."""
        for statement in block:
            if not any(map(self._reaches_barrier, tree.walk([statement]))):
                continue
            match statement:
                case tree.If(condition=condition, then=then, otherwise=otherwise):
                    is_shared = self.lane_class(condition) is LaneClass.GROUP
                    if (
                        not is_shared
                        or self._has_doubtful_barrier(then)
                        or self._has_doubtful_barrier(otherwise)
                    ):
                        return True
                case tree.For(start=start, stop=stop, step=step, body=body):
                    is_shared = all(
                        self.lane_class(bound) is LaneClass.GROUP for bound in (start, stop, step)
                    )
                    leaves = any(isinstance(node, tree.Break | tree.Continue) for node in tree.walk(body))
                    if not is_shared or leaves or self._has_doubtful_barrier(body):
                        return True
                case tree.Evaluate(value=tree.BuiltinCall()):
                    pass
                case tree.Evaluate(value=tree.Call(arguments=arguments)):
                    if any(map(self._reaches_barrier, arguments)):
                        return True
                case _:
                    return True
        return False

    def _reaches_barrier(self, node: tree.Statement | Expression) -> bool:
        match node:
            case tree.BuiltinCall(builtin=builtin):
                return builtin.name == "barrier"
            case tree.Call(function=function):
                return function in self.with_barrier
        return False

    # -- stores

    def has_doubtful_store(self) -> bool:
        # Where work-items have lanes to spare, a mask leaves them out, and stores under a mask are no race.
        if math.prod(self.work_group) % WIDTH:
            return False
        return any(self._has_doubtful_store(function.body) for function in self.stage.functions)

    def _has_doubtful_store(self, block: Block) -> bool:
        for statement in block:
            match statement:
                case tree.Assign(target=target, value=value):
                    if not self._is_safe_store(target, value):
                        return True
                case tree.If(condition=condition, then=then, otherwise=otherwise):
                    if self.lane_class(condition) is not LaneClass.RISING and (
                        self._has_doubtful_store(then) or self._has_doubtful_store(otherwise)
                    ):
                        return True
                case tree.For(body=body) | tree.While(body=body):
                    if self._has_doubtful_store(body):
                        return True
        return False

    def _is_safe_store(self, target: Expression, value: Expression) -> bool:
        root = tree.root_of(target)
        if not isinstance(root, tree.BindingRead):
            return True
        if self.lane_class(value) in _SHARED:
            return True
        classes = []
        while isinstance(target, tree.Member | tree.Swizzle | tree.Index):
            if isinstance(target, tree.Index):
                classes.append(self.lane_class(target.index))
            target = target.base
        return LaneClass.RISING in classes and all(lane_class in _ADDABLE for lane_class in classes)

    # -- values

    def lane_class(self, node: Expression) -> LaneClass:
        """Return the variation among lanes of a scalar, or of each component of a vector."""
        match node:
            case tree.Constant():
                return LaneClass.GROUP
            case tree.Length(base=tree.BindingRead()):
                return LaneClass.GROUP
            case tree.Read(local=local):
                return self.local_classes.get(local, LaneClass.UNKNOWN)
            case tree.Swizzle(base=tree.BuiltinCall(builtin=builtin), components=(axis,)) if builtin.name in (
                "global_id",
                "local_id",
            ):
                return self._axis_class(axis)
            case tree.BuiltinCall(builtin=builtin, arguments=arguments):
                return self._builtin_class(builtin.name, builtin.effect, arguments)
            case tree.Member() | tree.Index() | tree.Swizzle() | tree.BindingRead():
                return self._access_class(node)
            case tree.Unary(operand=operand):
                return _shared_or_unknown(self.lane_class(operand))
            case tree.Convert(value=value):
                lane_class = self.lane_class(value)
                is_integer = node.type in (INT, UINT) and value.type in (INT, UINT)
                return lane_class if is_integer else _shared_or_unknown(lane_class)
            case tree.Construct(parts=parts):
                return _joined([self.lane_class(part) for part in parts])
            case tree.Binary():
                return self._binary_class(node)
        return LaneClass.UNKNOWN

    def _axis_class(self, axis: int) -> LaneClass:
        """Return the variation of a component of an invocation's index: 16 lanes lie in one row if rows are that
        long."""
        size, row = self.work_group[axis], self.work_group[0]
        if axis and row % WIDTH == 0:
            return LaneClass.LANES
        return LaneClass.RISING if size > 1 else LaneClass.UNKNOWN

    def _builtin_class(self, name: str, effect: SideEffect, arguments: tuple[Expression, ...]) -> LaneClass:
        if name in ("group_id", "group_count"):
            return LaneClass.GROUP
        if name == "local_index":
            return LaneClass.RISING if math.prod(self.work_group) > 1 else LaneClass.UNKNOWN
        if effect is SideEffect.NONE and arguments:
            return _joined([self.lane_class(argument) for argument in arguments])
        return LaneClass.UNKNOWN

    def _access_class(self, node: Expression) -> LaneClass:
        """Return the class of a part of a binding, local or value."""
        root, indices = node, []
        while isinstance(root, tree.Member | tree.Swizzle | tree.Index):
            if isinstance(root, tree.Index):
                indices.append(self.lane_class(root.index))
            root = root.base
        if isinstance(root, tree.BindingRead):
            if root.declaration.storage_class not in (
                StorageClass.UNIFORM,
                StorageClass.STORAGE,
                StorageClass.SHARED,
            ):
                return LaneClass.UNKNOWN
            return LaneClass.RISING if indices == [LaneClass.RISING] else _joined([LaneClass.GROUP, *indices])
        if root is node:
            return LaneClass.UNKNOWN
        return _joined([_shared_or_unknown(self.lane_class(root)), *indices])

    def _binary_class(self, node: tree.Binary) -> LaneClass:
        """Return the class of an operation, along the chain of operations on its left."""
        chain = tree.left_chain(node)
        result = self.lane_class(chain[0].left)
        for link in chain:
            right = self.lane_class(link.right)
            if LaneClass.UNKNOWN in (result, right):
                result = LaneClass.UNKNOWN
            elif result in _SHARED and right in _SHARED:
                result = _joined([result, right])
            elif link.operator is Operator.ADD:
                result = LaneClass.RISING if LaneClass.RISING in (result, right) else LaneClass.NOT_FALLING
            elif link.operator is Operator.SUBTRACT and right in _SHARED:
                pass
            elif link.operator is Operator.MULTIPLY and _is_positive(link.left, link.right):
                result = right if result in _SHARED else result
            elif link.operator in _COMPARISONS and LaneClass.RISING in (result, right):
                result = LaneClass.RISING
            else:
                result = LaneClass.UNKNOWN
        return result


def _is_positive(left: Expression, right: Expression) -> bool:
    """Return whether a product has a positive constant as a factor."""
    return any(isinstance(factor, tree.Constant) and factor.value > 0 for factor in (left, right))


def _shared_or_unknown(lane_class: LaneClass) -> LaneClass:
    return lane_class if lane_class in _SHARED else LaneClass.UNKNOWN


def _joined(classes: list[LaneClass]) -> LaneClass:
    """Return the class of a value that is computed from values of these classes."""
    if all(lane_class is LaneClass.GROUP for lane_class in classes):
        return LaneClass.GROUP
    return LaneClass.LANES if all(lane_class in _SHARED for lane_class in classes) else LaneClass.UNKNOWN
