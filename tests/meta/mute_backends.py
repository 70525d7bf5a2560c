"""Each method of the contract left out in turn, and a run of the kit against what is left.

`python mute_backends.py` prints a line of JSON: for each method the tests of its group that failed, up to the first,
and those of a backend that is only late.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from faulty_backends import Faulty, Late, find_failures

GROUPS = {
    "create_buffer": "buffers",
    "create_texture": "textures",
    "create_sampler": "sampling",
    "create_program": "meshes",
    "create_vertex_array": "meshes",
    "create_query": "queries",
    "write_buffer": "buffers",
    "read_buffer": "buffers",
    "copy_buffer": "buffers",
    "clear_buffer": "buffers",
    "write_texture": "textures",
    "read_texture": "textures",
    "copy_texture": "textures",
    "copy_texture_to_buffer": "textures",
    "copy_buffer_to_texture": "textures",
    "resolve_texture": "targets",
    "generate_mipmaps": "textures",
    "begin_pass": "textures",
    "end_pass": "targets",
    "set_states": "depth",
    "bind_program": "meshes",
    "bind_uniform": "transient",
    "bind_storage": "compute",
    "bind_texture": "sampling",
    "bind_image": "compute",
    "draw": "meshes",
    "draw_indirect": "meshes",
    "dispatch": "compute",
    "dispatch_indirect": "compute",
    "signal": "time",
    "completed": "time",
    "wait": "time",
    "begin_query": "queries",
    "end_query": "queries",
    "write_query": "time",
    "read_query": "queries",
    "begin_conditional": "queries",
    "end_conditional": "queries",
}
"""Which group must see that a method does nothing."""

UNSEEN = {
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
    failures = {name: find_failures(mute(name), group) for name, group in GROUPS.items()}
    failures[LATE] = find_failures(Late, GROUPS["wait"])
    print(json.dumps(failures))
