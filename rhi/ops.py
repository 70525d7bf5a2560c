"""What can be commanded: one `Op` for each `Backend` method that is a command, and what holds after them.

- The names, order and types of a command's arguments come from the signatures of `rhi.backend.Backend` and
  are said nowhere else.
- States, labels, program, bindings, resources and pass at a command aren't stored with it but derived, by a
  `Context` that is fed the commands before it.
"""

from __future__ import annotations

import enum
import inspect
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

from rhi.backend import Backend
from rhi.descriptors import (
    BindingKind,
    BufferDescriptor,
    Id,
    PassDescriptor,
    ProgramDescriptor,
    QueryKind,
    SamplerDescriptor,
    TextureDescriptor,
    VertexArrayDescriptor,
)
from rhi.state_cache import StateChange, default_values
from rhi.states import STATE_TYPES

__rhi_internal__ = True


class Op(enum.IntEnum):
    """What a command does: one member for each method of `Backend` that is a command.

    Reads that wait are commands, since they order what the device does. `capabilities`, `completed`,
    `read_query` (which never wait) and `close` aren't.
    """

    CREATE_BUFFER = 0
    CREATE_TEXTURE = enum.auto()
    CREATE_SAMPLER = enum.auto()
    CREATE_PROGRAM = enum.auto()
    CREATE_VERTEX_ARRAY = enum.auto()
    CREATE_QUERY = enum.auto()
    DESTROY = enum.auto()
    WRITE_BUFFER = enum.auto()
    READ_BUFFER = enum.auto()
    COPY_BUFFER = enum.auto()
    CLEAR_BUFFER = enum.auto()
    WRITE_TEXTURE = enum.auto()
    READ_TEXTURE = enum.auto()
    COPY_TEXTURE = enum.auto()
    RESOLVE_TEXTURE = enum.auto()
    GENERATE_MIPMAPS = enum.auto()
    BEGIN_PASS = enum.auto()
    END_PASS = enum.auto()
    SET_STATES = enum.auto()
    BIND_PROGRAM = enum.auto()
    BIND_UNIFORM = enum.auto()
    BIND_STORAGE = enum.auto()
    BIND_TEXTURE = enum.auto()
    BIND_IMAGE = enum.auto()
    DRAW = enum.auto()
    DRAW_INDIRECT = enum.auto()
    DISPATCH = enum.auto()
    DISPATCH_INDIRECT = enum.auto()
    SIGNAL = enum.auto()
    WAIT = enum.auto()
    BEGIN_QUERY = enum.auto()
    END_QUERY = enum.auto()
    WRITE_QUERY = enum.auto()
    BEGIN_CONDITIONAL = enum.auto()
    END_CONDITIONAL = enum.auto()
    PUSH_LABEL = enum.auto()
    POP_LABEL = enum.auto()
    PRESENT = enum.auto()

    @property
    def method(self) -> str:
        """The name of the `Backend` method."""
        return self.name.lower()

    @property
    def parameters(self) -> dict[str, str]:
        """The arguments' names, in order, with their types as written in `Backend`."""
        return _PARAMETERS[self]


def _read_parameters(op: Op) -> dict[str, str]:
    parameters = inspect.signature(getattr(Backend, op.method)).parameters
    return {name: parameter.annotation for name, parameter in parameters.items() if name != "self"}


_PARAMETERS: Final = {op: _read_parameters(op) for op in Op}
DRAWS: Final = frozenset({Op.DRAW, Op.DRAW_INDIRECT})
WIDTHS: Final = tuple(1 + len(op.parameters) + 2 for op in Op)
"""Places that a command takes in a stream: its op, its arguments, its call site (two)."""

States: TypeAlias = dict[type, object]
"""The value of each state type; for those that exist per target a tuple of 8, one per target."""

Descriptor: TypeAlias = (
    BufferDescriptor
    | TextureDescriptor
    | SamplerDescriptor
    | ProgramDescriptor
    | VertexArrayDescriptor
    | QueryKind
)
"""What a resource is made from."""


class Context:
    """What holds at a point of a stream. Its methods are the commands that change it.

    Attributes:
        states: the value of every state type, as the backend was told.
        labels: the open labels, outermost first.
        program: the bound program, 0 for none.
        render_pass: the open pass, None outside.
        resources: what each living resource was made from, by id.
        slots: what is bound, by kind and slot: the arguments of the binding command after the slot.
    """

    __slots__ = ("labels", "program", "render_pass", "resources", "slots", "states")

    def __init__(self) -> None:
        self.states: States = dict(zip(STATE_TYPES, default_values(), strict=True))
        self.labels: tuple[str, ...] = ()
        self.program: Id = 0
        self.render_pass: PassDescriptor | None = None
        self.resources: dict[Id, Descriptor] = {}
        self.slots: dict[tuple[BindingKind, int], tuple[int, ...]] = {}

    def create_buffer(self, buffer: Id, descriptor: BufferDescriptor) -> None:
        self.resources[buffer] = descriptor

    def create_texture(self, texture: Id, descriptor: TextureDescriptor) -> None:
        self.resources[texture] = descriptor

    def create_sampler(self, sampler: Id, descriptor: SamplerDescriptor) -> None:
        self.resources[sampler] = descriptor

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self.resources[program] = descriptor

    def create_vertex_array(self, vertex_array: Id, descriptor: VertexArrayDescriptor) -> None:
        self.resources[vertex_array] = descriptor

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self.resources[query] = kind

    def destroy(self, resource: Id) -> None:
        self.resources.pop(resource, None)

    def bind_uniform(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self.slots[BindingKind.UNIFORM, slot] = (buffer, offset, size)

    def bind_storage(self, slot: int, buffer: Id, offset: int, size: int) -> None:
        self.slots[BindingKind.STORAGE, slot] = (buffer, offset, size)

    def bind_texture(self, slot: int, texture: Id, sampler: Id) -> None:
        self.slots[BindingKind.TEXTURE, slot] = (texture, sampler)

    def bind_image(self, slot: int, texture: Id, level: int, layer: int) -> None:
        self.slots[BindingKind.IMAGE, slot] = (texture, level, layer)

    def set_states(self, changes: Sequence[StateChange]) -> None:
        self.states.update(changes)

    def bind_program(self, program: Id) -> None:
        self.program = program

    def begin_pass(self, descriptor: PassDescriptor) -> None:
        self.render_pass = descriptor

    def end_pass(self) -> None:
        self.render_pass = None

    def push_label(self, text: str) -> None:
        self.labels = (*self.labels, text)

    def pop_label(self) -> None:
        self.labels = self.labels[:-1]

    def copy(self) -> Context:
        twin = Context()
        twin.states = self.states.copy()
        twin.labels, twin.program, twin.render_pass = self.labels, self.program, self.render_pass
        twin.resources, twin.slots = self.resources.copy(), self.slots.copy()
        return twin

    def follow(self, op: int, arguments: Sequence[Any]) -> None:
        """Take a command into account; most change nothing."""
        change = _CHANGES[op]
        if change is not None:
            change(self, *arguments)


_Change: TypeAlias = Callable[..., None]
_CHANGES: Final[tuple[_Change | None, ...]] = tuple(getattr(Context, op.method, None) for op in Op)
CONTEXT_OPS: Final = frozenset(op for op in Op if _CHANGES[op] is not None)
"""Those that a `Context` follows."""
