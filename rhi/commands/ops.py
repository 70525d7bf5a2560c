"""What can be commanded: one `Op` for each `Backend` method that is a command, and what holds after them.

- The names, order and types of a command's arguments come from the signatures of `rhi.contract.backend.Backend` and
  are said nowhere else.
- States, labels, program, bindings, resources and pass at a command aren't stored with it but derived, by a
  `Context` that is fed the commands before it.
"""

from __future__ import annotations

import enum
import inspect
from typing import Final, TypeAlias

from rhi.contract.backend import Backend
from rhi.contract.descriptors import (
    BufferDescriptor,
    ProgramDescriptor,
    QueryKind,
    SamplerDescriptor,
    TextureDescriptor,
    VertexArrayDescriptor,
)

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


