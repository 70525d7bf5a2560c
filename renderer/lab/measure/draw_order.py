"""State changes between draws, as a device sees them: programs, materials and meshes (Russell, 6.3 and
6.7.2).

A renderer that draws objects one by one sets a program, a material and a mesh wherever they aren't those of
the object before, so it sorts objects by these. Here the materials and the meshes of a scene are tables, so
one draw takes all objects that need the same states, and their order is free. Both are counted: the first for
the objects of a frame in several orders, the second in the commands of the frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from renderer.frame.frame import sort_back_to_front
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from rhi import Command, Commands, Op

_BINDINGS: Final = (Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE)


@dataclass(frozen=True, slots=True)
class StateChanges:
    """The numbers of commands of a pass that change programs, bindings or meshes between draws.

    Attributes:
        meshes: how often a draw has other vertex and index buffers than the one before.
    """

    programs: int = 0
    bindings: int = 0
    meshes: int = 0
    states: int = 0


@dataclass(frozen=True, slots=True)
class DrawOrderRow:
    """Changes of program, material and mesh between objects that are drawn in one order."""

    order: str
    programs: int
    materials: int
    meshes: int
    draws: int


def count_changes(commands: Iterable[Command]) -> StateChanges:
    """Count the state changes between the draws of these commands."""
    ops, meshes = [], []
    for command in commands:
        ops.append(command.op)
        if command.op in (Op.DRAW, Op.DRAW_INDIRECT):
            meshes.append(command["vertex_array"])
    return StateChanges(
        programs=ops.count(Op.BIND_PROGRAM),
        bindings=sum(map(ops.count, _BINDINGS)),
        meshes=_count_runs(meshes),
        states=ops.count(Op.SET_STATES),
    )


def compare_orders(
    scene: Scene, camera: Camera, object_indices: Indices, draws: Commands
) -> list[DrawOrderRow]:
    """Count the state changes between objects `object_indices` (k,) drawn one by one, and between the draws
    that draw them all.

    One by one, each combination of features that a material may have is a program.
    """
    object_indices = sort_back_to_front(scene, camera, object_indices)[::-1]
    material, mesh = scene.objects.material[object_indices], scene.objects.mesh[object_indices]
    program = scene.material_kinds[material]
    orders = {
        "one by one, as listed": np.argsort(object_indices),
        "one by one, near first": np.arange(len(object_indices)),
        "one by one, sorted": np.lexsort((mesh, material, program)),
    }
    return [
        *(
            DrawOrderRow(
                name,
                _count_runs(program[order]),
                _count_runs(np.stack([program[order], material[order]], axis=1)),
                _count_runs(mesh[order]),
                len(object_indices),
            )
            for name, order in orders.items()
        ),
        DrawOrderRow(
            "as they are drawn",
            _count_runs([draw.program for draw in draws]),
            _count_runs([draw.bindings["materials"] for draw in draws if "materials" in draw.bindings]),
            _count_runs([draw["vertex_array"] for draw in draws]),
            len(draws),
        ),
    ]


def _count_runs(values: Sequence[Any] | np.ndarray[Any, Any]) -> int:
    """The number of runs of equal values."""
    if not len(values):
        return 0
    array = np.asarray(values).reshape(len(values), -1)
    return 1 + int((array[1:] != array[:-1]).any(axis=1).sum())
