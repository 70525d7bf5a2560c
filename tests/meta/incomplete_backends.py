"""Each method of the contract left out in turn, and a run of the kit against what is left.

`python incomplete_backends.py` prints a line of JSON: for each method the tests of its group that failed, up
to the first, and those of a backend that is only late.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from faulty_backends import Faulty, Late, list_failures

DETECTED_BY_GROUP = {
    "buffers": ("create_buffer", "write_buffer", "read_buffer", "copy_buffer", "clear_buffer"),
    "textures": (
        "create_texture",
        "write_texture",
        "read_texture",
        "copy_texture",
        "copy_texture_to_buffer",
        "copy_buffer_to_texture",
        "generate_mipmaps",
        "begin_pass",
    ),
    "sampling": ("create_sampler", "bind_texture"),
    "meshes": ("create_program", "create_vertex_array", "bind_program", "draw", "draw_indirect"),
    "queries": (
        "create_query",
        "begin_query",
        "end_query",
        "read_query",
        "begin_conditional",
        "end_conditional",
    ),
    "targets": ("resolve_texture", "end_pass"),
    "depth": ("set_states",),
    "transient": ("bind_uniform",),
    "compute": ("bind_storage", "bind_image", "dispatch", "dispatch_indirect"),
    "time": ("signal", "completed", "wait", "write_query"),
}
"""Which methods each group must see, if they do nothing."""

GROUPS = {method: group for group, methods in DETECTED_BY_GROUP.items() for method in methods}

UNDETECTABLE = {
    "destroy": "memory that isn't given back shows in no result",
    "push_label": "for the driver's tools",
    "pop_label": "for the driver's tools",
    "present": "there is no window in which the kit could look",
    "close": "no call follows that could tell",
    "capabilities": "is data",
}
"""Methods whose work no result shows, and why."""


def mute(name: str) -> Callable[[Any], Any]:
    """A backend whose method `name` does nothing."""

    def do_nothing(self: object, *arguments: object) -> object:
        return ANSWERS.get(name)

    return type("Mute", (Late if name == "wait" else Faulty,), {name: do_nothing})


LATE = "all, and late"
ANSWERS = {"read_buffer": b"", "completed": 0, "wait": True, "read_query": None}


if __name__ == "__main__":
    failures = {name: list_failures(mute(name), group) for name, group in GROUPS.items()}
    failures[LATE] = list_failures(Late, GROUPS["wait"])
    print(json.dumps(failures))
