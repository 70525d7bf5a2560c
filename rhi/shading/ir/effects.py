"""The reads and writes of an expression in memory that calls may change: writable buffers, shared memory and
images.

Two operands conflict if one writes what the other reads or writes, so that their order can be observed.
Buffers are told apart by their names: what a program writes isn't bound a second time.
"""

from __future__ import annotations

from typing import Final

from rhi.errors.data_classes import dataclass
from rhi.shading.ir import nodes, tree
from rhi.shading.ir.tree import Expression, Function, Statement
from rhi.shading.language.builtins import SideEffect
from rhi.shading.language.shader import Declaration, StorageClass
from rhi.shading.language.types import ImageType, StorageType

_BARRIER: Final = "barrier()"
"""What each access reads and a barrier writes: after it, the writes of other invocations are seen."""
_DISCARD: Final = "discard()"
"""What each write reads and a discard writes: after it, nothing is written any more."""


@dataclass(frozen=True, slots=True)
class Effects:
    """The names of the memory that an expression reads and writes."""

    reads: frozenset[str] = frozenset()
    writes: frozenset[str] = frozenset()

    def __or__(self, other: Effects) -> Effects:
        return Effects(self.reads | other.reads, self.writes | other.writes)

    def conflicts_with(self, other: Effects) -> bool:
        """Return whether the order of two expressions can be observed."""
        return not (
            self.writes.isdisjoint(other.reads)
            and self.writes.isdisjoint(other.writes)
            and self.reads.isdisjoint(other.writes)
        )


NONE: Final = Effects()
_ANY: Final = Effects(frozenset({_BARRIER, _DISCARD}), frozenset({_BARRIER, _DISCARD}))
"""The effects of a native body, which isn't parsed."""
_OF_BUILTINS: Final = {
    SideEffect.BARRIER: Effects(frozenset({_BARRIER}), frozenset({_BARRIER})),
    SideEffect.DISCARD: Effects(writes=frozenset({_DISCARD})),
}


class EffectAnalysis:
    """The effects of expressions, and of the functions that they call."""

    def __init__(self) -> None:
        self._functions: dict[Function, Effects] = {}

    def of(self, *expressions: Expression) -> Effects:
        """Return the effects of all of these expressions."""
        effects = NONE
        pending: list[Expression] = list(expressions)
        while pending:
            node = pending.pop()
            match node:
                case tree.Length():
                    continue  # the number of elements never changes
                case tree.BindingRead(declaration=declaration) if _is_changeable(declaration):
                    effects |= Effects(frozenset({declaration.name, _BARRIER}))
                case tree.Call(function=function):
                    effects |= self.of_function(function)
                case tree.BuiltinCall(builtin=builtin):
                    effects |= _OF_BUILTINS.get(builtin.effect, NONE)
                    if builtin.effect is SideEffect.WRITE:
                        effects |= _write(node.arguments[0])
            pending += tree.parts_of(node)
        return effects

    def of_function(self, function: Function) -> Effects:
        """Return the effects of a call of a function, without those of its arguments."""
        effects = self._functions.get(function)
        if effects is None:
            effects = _ANY if function.native and not function.body else NONE
            for statement in nodes.walk(function.body):
                effects |= self._of_statement(statement)
            self._functions[function] = effects
        return effects

    def _of_statement(self, statement: Statement) -> Effects:
        match statement:
            case tree.Discard():
                return _OF_BUILTINS[SideEffect.DISCARD]
            case tree.Assign(target=target, value=value):
                indices = [index.index for index in tree.indices_of(target)]
                return self.of(value, *indices) | _write(target)
        return self.of(*tree.parts_of(statement))


def _is_changeable(declaration: Declaration) -> bool:
    """Return whether memory may change while a stage runs."""
    type = declaration.type
    if isinstance(type, StorageType):
        return type.writable
    return isinstance(type, ImageType) or declaration.storage_class is StorageClass.SHARED


def _write(target: Expression) -> Effects:
    """Return the effect of a write to an lvalue."""
    root = tree.root_of(target)
    if isinstance(root, tree.BindingRead):
        return Effects(frozenset({_BARRIER, _DISCARD}), frozenset({root.declaration.name}))
    return NONE
