"""The context at a point of a stream: states, labels, program, bindings, resources and render pass.

None of it is stored with a command. A `StreamContext` derives it by following the commands before that point.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

from rhi.commands.ops import CREATIONS, Descriptor, Op, States
from rhi.contract.descriptors import (
    BindingKind,
    Id,
    PassDescriptor,
)
from rhi.contract.states import STATE_TYPES, StateChange, default_values

_UNIFORM, _STORAGE = BindingKind.UNIFORM, BindingKind.STORAGE  # found faster than the members of the class
_TEXTURE, _IMAGE = BindingKind.TEXTURE, BindingKind.IMAGE


class StreamContext:
    """The context at a point of a stream. It has one method for each command that changes the context.

    Attributes:
        states: the value of every state type, as sent to the backend.
        labels: the open labels, outermost first.
        program: the id of the bound program, 0 for none.
        open_query, condition: ids of the open occlusion query and of the query that draws depend on; 0 for
            none.
        render_pass: the descriptor of the open pass, or None outside a pass.
        resources: the descriptors of existing resources, by id.
        slots: the bindings by (kind, slot): the arguments of the binding command that follow the slot.
    """

    __slots__ = (
        "condition",
        "labels",
        "open_query",
        "program",
        "render_pass",
        "resources",
        "slots",
        "states",
    )

    def __init__(self) -> None:
        self.states: States = dict(zip(STATE_TYPES, default_values(), strict=True))
        self.labels: tuple[str, ...] = ()
        self.program: Id = 0
        self.open_query: Id = 0
        self.condition: Id = 0
        self.render_pass: PassDescriptor | None = None
        self.resources: dict[Id, Descriptor] = {}
        self.slots: dict[tuple[BindingKind, int], tuple[int, ...]] = {}

    def create(self, resource: Id, descriptor: Descriptor) -> None:
        """Follow the creation of a resource of any kind."""
        self.resources[resource] = descriptor

    def destroy(self, resource: Id) -> None:
        self.resources.pop(resource, None)

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self.slots[_UNIFORM, slot] = (buffer, offset, size)

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self.slots[_STORAGE, slot] = (buffer, offset, size)

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self.slots[_TEXTURE, slot] = (texture, sampler)

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self.slots[_IMAGE, slot] = (texture, level, layer)

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self.states.update(changes)

    def bind_program(self, program: Id) -> None:
        self.program = program

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self.render_pass = descriptor

    def end_pass(self) -> None:
        self.render_pass = None

    def begin_query(self, query: Id) -> None:
        self.open_query = query

    def end_query(self, query: Id) -> None:
        self.open_query = 0

    def begin_conditional(self, query: Id, inverted: bool) -> None:
        self.condition = query

    def end_conditional(self) -> None:
        self.condition = 0

    def push_label(self, text: str) -> None:
        self.labels = (*self.labels, text)

    def pop_label(self) -> None:
        self.labels = self.labels[:-1]

    def copy(self) -> StreamContext:
        twin = StreamContext()
        twin.states = self.states.copy()
        twin.labels = self.labels
        twin.program = self.program
        twin.render_pass = self.render_pass
        twin.open_query, twin.condition = self.open_query, self.condition
        twin.resources, twin.slots = self.resources.copy(), self.slots.copy()
        return twin

    def apply(self, op: int, arguments: Sequence[Any]) -> None:
        """Update the context by one command. Most commands change nothing."""
        change = _CHANGES[op]
        if change is not None:
            change(self, *arguments)


_Change: TypeAlias = Callable[..., None]

_CHANGES: Final[tuple[_Change | None, ...]] = tuple(
    StreamContext.create if op in CREATIONS else getattr(StreamContext, op.method, None) for op in Op
)

BOUND_KINDS: Final[tuple[BindingKind | None, ...]] = tuple(
    {
        Op.BIND_UNIFORM: _UNIFORM,
        Op.BIND_STORAGE: _STORAGE,
        Op.BIND_TEXTURE: _TEXTURE,
        Op.BIND_IMAGE: _IMAGE,
    }.get(op)
    for op in Op
)
"""The kind of binding that each op sets, None for ops that bind nothing."""
CONTEXT_OPS: Final = frozenset(op for op in Op if _CHANGES[op] is not None)
"""The ops that change a `StreamContext`."""
