"""The operations: one `Op` for each method of `rhi.contract.Backend` that is a command.

The names, order and types of a command's arguments come from the method's signature and are stated nowhere
else.
"""

from __future__ import annotations

import enum
from typing import Final, TypeAlias

from rhi.contract.backend import Backend
from rhi.contract.descriptors import (
    DRAW,
    BufferDescriptor,
    ProgramDescriptor,
    QueryKind,
    SamplerDescriptor,
    TextureDescriptor,
    VertexArrayDescriptor,
)
from rhi.errors.choices import ChoiceType


class Op(enum.IntEnum, metaclass=ChoiceType):
    """The operation of a command, one per method of `rhi.contract.Backend` that is a command.

    Reads that wait are commands, because they order the work of the device. `capabilities`, `completed` and
    `read_query`, which never wait, and `close` aren't commands.
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
    COPY_TEXTURE_TO_BUFFER = enum.auto()
    COPY_BUFFER_TO_TEXTURE = enum.auto()
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
        """The name of the method in `rhi.contract.Backend`."""
        return METHODS[self]

    @property
    def parameters(self) -> dict[str, str]:
        """The parameter names in order, with their annotations in `rhi.contract.Backend`."""
        return _PARAMETERS[self]


METHODS: Final = tuple(op.name.lower() for op in Op)
"""The name of each operation's method, by its number."""


def _read_parameters(op: Op) -> dict[str, str]:
    annotations: dict[str, str] = getattr(Backend, op.method).__annotations__
    return {name: annotation for name, annotation in annotations.items() if name != "return"}


_PARAMETERS: Final = {op: _read_parameters(op) for op in Op}
ID_KINDS: Final[dict[str, type]] = {
    "Id": object,
    "BufferId": BufferDescriptor,
    "TextureId": TextureDescriptor,
    "SamplerId": SamplerDescriptor,
    "ProgramId": ProgramDescriptor,
    "VertexArrayId": VertexArrayDescriptor,
    "QueryId": QueryKind,
}
"""The kind of object that an id stands for, by its annotation in the contract."""
ID_ARGUMENTS: Final = {
    op: tuple(i for i, annotation in enumerate(op.parameters.values()) if annotation in ID_KINDS) for op in Op
}
"""The indices of the arguments that are resource ids, by op."""
CREATIONS: Final = frozenset(op for op in Op if op.method.startswith("create_"))
END_OPS: Final = {
    Op.BEGIN_PASS: Op.END_PASS,
    Op.BEGIN_CONDITIONAL: Op.END_CONDITIONAL,
    Op.BEGIN_QUERY: Op.END_QUERY,
    Op.PUSH_LABEL: Op.POP_LABEL,
}
"""By the op that opens something, the op that closes it."""
DRAWS: Final = frozenset({Op.DRAW, Op.DRAW_INDIRECT})
DISPATCHES: Final = frozenset({Op.DISPATCH, Op.DISPATCH_INDIRECT})
DRAW_ARGUMENTS: Final = DRAW.names or ()
"""The arguments that `draw_indirect` reads from a buffer, for each of its draws."""
WORK: Final = DRAWS | DISPATCHES
"""The ops whose shaders may write storage buffers."""
BUFFER_WRITES: Final = WORK | {Op.WRITE_BUFFER, Op.COPY_BUFFER, Op.CLEAR_BUFFER, Op.COPY_TEXTURE_TO_BUFFER}
"""The ops that may change bytes of a buffer that exists."""
WIDTHS: Final = tuple(1 + len(op.parameters) + 2 for op in Op)
"""Number of list elements per command in a stream: its op, its arguments, and two for its call site."""

States: TypeAlias = dict[type, object]
"""The value of each state type. For types that exist per target it is a tuple of 8, one per target."""

Descriptor: TypeAlias = (
    BufferDescriptor
    | TextureDescriptor
    | SamplerDescriptor
    | ProgramDescriptor
    | VertexArrayDescriptor
    | QueryKind
)
"""The descriptor of a resource."""
