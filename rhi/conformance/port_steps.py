"""The steps of writing a port: the backend methods of each step, and the groups of the kit that test them.

One table orders the template of a new backend, sorts the scoreboard and names the next step. A step's groups
need only the methods of this step and those before it. `python -m rhi docs porting` explains the steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from rhi.contract.backend import Backend


@dataclass(frozen=True, slots=True)
class Step:
    """A step of a port.

    Attributes:
        methods: the methods of `Backend` to write in this step.
        groups: the groups of the kit that pass after it, by their names on the scoreboard.
    """

    title: str
    methods: tuple[str, ...]
    groups: tuple[str, ...]


STEPS: Final = (
    Step(
        "buffers",
        (
            "capabilities",
            "close",
            "create_buffer",
            "destroy",
            "write_buffer",
            "read_buffer",
            "copy_buffer",
            "clear_buffer",
            "signal",
            "completed",
            "wait",
        ),
        ("operation · buffers",),
    ),
    Step(
        "textures and passes",
        (
            "create_texture",
            "create_sampler",
            "write_texture",
            "read_texture",
            "copy_texture",
            "copy_texture_to_buffer",
            "copy_buffer_to_texture",
            "generate_mipmaps",
            "begin_pass",
            "end_pass",
        ),
        ("operation · textures", "operation · mip levels", "operation · clear values"),
    ),
    Step(
        "time and labels",
        ("create_query", "write_query", "read_query", "push_label", "pop_label", "present"),
        ("operation · time",),
    ),
    Step(
        "compute",
        (
            "create_program",
            "bind_program",
            "bind_uniform",
            "bind_storage",
            "bind_image",
            "dispatch",
            "dispatch_indirect",
        ),
        (
            "operation · compute",
            "operation · constant arguments",
            "operation · language",
            "operation · operators",
            "operation · outside",
        ),
    ),
    Step(
        "draws",
        ("create_vertex_array", "set_states", "draw", "draw_indirect"),
        (
            "operation · orientation",
            "operation · rasterisation",
            "operation · topology",
            "operation · meshes",
            "operation · points",
            "operation · transient",
            "operation · scopes",
            "operation · recording",
            "operation · dropped",
            "operation · draw times",
            "operation · draw bounds",
            "operation · byte order",
            "operation · rectangles",
        ),
    ),
    Step(
        "depth, stencil, blending and targets",
        ("resolve_texture",),
        (
            "operation · depth",
            "operation · clipping",
            "operation · lines",
            "operation · stencil",
            "operation · blending",
            "operation · targets",
            "operation · layers",
            "operation · clears",
        ),
    ),
    Step(
        "texture reads",
        ("bind_texture",),
        (
            "operation · textured draws",
            "operation · sampling",
            "operation · texture tables",
            "operation · samples",
            "operation · compressed textures",
            "operation · fragments",
            "operation · unreachable",
        ),
    ),
    Step(
        "occlusion queries",
        ("begin_query", "end_query", "begin_conditional", "end_conditional"),
        ("operation · queries", "operation · query sets", "operation · conditional draws"),
    ),
    Step(
        "all together",
        (),
        (
            "operation · interplay",
            "operation · command buffers",
            "operation · repeated submissions",
            "validation · refusals",
            "validation · capabilities",
            "validation · threads",
            "validation · scopes",
            "validation · platform states",
            "validation · portable uses",
        ),
    ),
)

METHODS: Final = frozenset(name for name in vars(Backend) if not name.startswith("_"))
"""The names of all methods of the contract, and `capabilities`."""

_NUMBERS: Final = {group: number for number, step in enumerate(STEPS, 1) for group in step.groups}


def step_of(group: str) -> int:
    """Return the number of a group's step, from 1, or the number of steps plus 1 for a group without a
    step."""
    return _NUMBERS.get(group, len(STEPS) + 1)


def missing_method(error: BaseException | None) -> str:
    """Return the missing method of the contract that made a test fail, or "" if it failed for another reason.

    A method is missing if it raises NotImplementedError, as those of the template do, or doesn't exist.
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
