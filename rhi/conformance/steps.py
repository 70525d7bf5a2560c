"""The order in which a port is written: its steps, the methods of each, and the groups of the kit that prove them.

One table, from which the template of a new backend is written, the scoreboard is sorted and the next step named.
A step's groups run on what the steps up to it have made; docs/porting.md goes through them one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rhi.contract.backend import Backend


@dataclass(frozen=True, slots=True)
class Step:
    """A part of a port.

    Attributes:
        methods: those of `Backend` that are written now.
        groups: those of the kit that pass then, as the scoreboard names them.
    """

    title: str
    methods: tuple[str, ...]
    groups: tuple[str, ...]


STEPS: Final = (
    Step(
        "buffers",
        ("capabilities", "close", "create_buffer", "destroy", "write_buffer", "read_buffer", "copy_buffer",
         "clear_buffer"),
        ("operation · buffers",),
    ),
    Step(
        "textures and passes",
        ("create_texture", "create_sampler", "write_texture", "read_texture", "copy_texture", "generate_mipmaps",
         "begin_pass", "end_pass"),
        ("operation · textures",),
    ),
    Step(
        "time and labels",
        ("signal", "completed", "wait", "create_query", "write_query", "read_query", "push_label", "pop_label",
         "present"),
        ("operation · time", "operation · recording"),
    ),
    Step(
        "compute",
        ("create_program", "bind_program", "bind_uniform", "bind_storage", "bind_image", "dispatch",
         "dispatch_indirect"),
        ("operation · compute", "operation · language"),
    ),
    Step(
        "draws",
        ("create_vertex_array", "set_states", "draw", "draw_indirect"),
        ("operation · orientation", "operation · rasterisation", "operation · topology", "operation · meshes",
         "operation · transient", "operation · scopes"),
    ),
    Step(
        "depth, stencil, blending and targets",
        ("resolve_texture",),
        ("operation · depth", "operation · stencil", "operation · blending", "operation · targets",
         "operation · clears"),
    ),
    Step("texture reads", ("bind_texture",), ("operation · sampling", "operation · fragments")),
    Step(
        "occlusion queries",
        ("begin_query", "end_query", "begin_conditional", "end_conditional"),
        ("operation · queries", "operation · query sets"),
    ),
    Step(
        "all together",
        (),
        ("operation · interplay", "operation · command buffers", "validation · refusals", "validation · capabilities"),
    ),
)  # fmt: skip

METHODS: Final = frozenset(name for name in vars(Backend) if not name.startswith("_"))
"""All methods of the contract, and `capabilities`."""

_NUMBERS: Final = {group: number for number, step in enumerate(STEPS, 1) for group in step.groups}


def step_of(group: str) -> int:
    """The number of the step that a group belongs to, from 1; one more than there are for a group of no backend."""
    return _NUMBERS.get(group, len(STEPS) + 1)


def find_missing(error: BaseException | None) -> str:
    """The method of the contract that a test failed for want of, "" if that isn't why.

    A method is missing if it raises NotImplementedError, as the template's do, or isn't there at all.
    """
    while error is not None:
        if isinstance(error, AttributeError) and error.name in METHODS:
            return error.name
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        if isinstance(error, NotImplementedError) and trace is not None:
            name = trace.tb_frame.f_code.co_name
            if name in METHODS:
                return name
        error = error.__cause__ or error.__context__
    return ""
