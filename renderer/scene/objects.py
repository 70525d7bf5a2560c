"""The objects of a scene as arrays, and the boxes that hold them.

An object's box is given in the space of a node. For most objects that is the box of their mesh, at their own node, and
it follows them. For a simulated object it is the box that the simulation never leaves, at the first node above all that
the simulation moves. So that box is where the object may be, at any time and wherever it is drawn last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Rows
from renderer.scene.meshes import Meshes
from renderer.scene.nodes import Nodes
from rhi.math import transform_bounds


@dataclass(frozen=True, eq=False, slots=True)
class Boxes:
    """Boxes, one for each object: `lower` and `upper` (n, 3) in the space of `node` (n,), -1 for the world."""

    node: Rows
    lower: Floats
    upper: Floats

    def place(self, nodes: Nodes, rows: Rows) -> Floats:
        """Return the transforms (k, 4, 4) from the spaces of the boxes `rows` (k,) to the world."""
        node = self.node[rows]
        world = nodes.world[node]
        world[node < 0] = np.eye(4)
        return world


@dataclass(frozen=True, eq=False, slots=True)
class Objects:
    """The objects of a scene, one row each.

    Attributes:
        node, mesh, material: (n,) int32, rows of nodes, meshes and materials.
        lower, upper: (n, 3) float64, world bounds, kept up to date by `Scene.update`.
        dynamic: (n,) bool, whether the object's node can move.
        shown: (n,) bool, whether the object's node isn't hidden, kept up to date by `Scene.update`.
        casts_shadow: (n,) bool, whether the object casts shadows.
        simulated: (n,) bool, whether the object is simulated where it is drawn, and only there. Its vertices and its
            transform may be those of an earlier time; its bounds hold at all times.
        boxes: what `lower` and `upper` are computed from.
        static_rows, dynamic_rows, simulated_rows: int64, the rows of such objects, ascending.
        fixed_rows, following_rows: int64, the rows of the objects whose world bounds never change, and of those whose
            bounds may follow a node, ascending. What is simulated in one place is dynamic and has fixed bounds.
    """

    node: NDArray[np.int32]
    mesh: NDArray[np.int32]
    material: NDArray[np.int32]
    lower: Floats
    upper: Floats
    dynamic: NDArray[np.bool_]
    shown: NDArray[np.bool_]
    casts_shadow: NDArray[np.bool_]
    simulated: NDArray[np.bool_]
    boxes: Boxes
    static_rows: Rows
    dynamic_rows: Rows
    simulated_rows: Rows
    fixed_rows: Rows
    following_rows: Rows

    def __len__(self) -> int:
        return len(self.node)

    def find_shown(self, rows: Rows) -> Rows:
        """Return those of the objects `rows` (k,) that are shown; the same array if all objects of the scene are."""
        return rows if self.shown.all() else rows[self.shown[rows]]

    def refresh_bounds(self, nodes: Nodes, rows: Rows) -> None:
        """Compute the world bounds of `rows` (k,) again."""
        boxes = self.boxes
        found = transform_bounds(boxes.place(nodes, rows), boxes.lower[rows], boxes.upper[rows])
        self.lower[rows], self.upper[rows] = found


def make_objects(
    nodes: Nodes,
    meshes: Meshes,
    columns: tuple[Rows, Rows, Rows, Rows],
    deformed: Rows,
    animated: Rows,
    bounds: tuple[Floats, Floats],
) -> Objects:
    """Make the objects of a scene, with bounds as of now.

    Args:
        columns: for each object the rows (n,) of its node, its mesh and its material, and whether it casts shadows.
        deformed: the rows of the objects whose vertices are simulated.
        animated: the rows (k,) of the animated nodes.
        bounds: the lower and upper corners (k, 3) of their boxes; NaN where there is none.
    """
    node, mesh, material, casts_shadow = columns
    lower, upper = bounds
    number = np.full(len(nodes), -1, np.int64)
    number[animated] = np.arange(len(animated))
    nearest, anchor = np.full(len(node), -1, np.int64), node.astype(np.int64)
    is_bounded = np.ones(len(node), bool)
    rows, at = np.arange(len(node)), anchor.copy()
    while len(rows):  # one level upwards
        hit = number[at] >= 0
        here, found = rows[hit], number[at[hit]]
        nearest[here] = np.where(nearest[here] < 0, found, nearest[here])
        anchor[here] = nodes.parents[at[hit]]
        is_bounded[here] &= ~np.isnan(lower[found, 0])
        above = nodes.parents[at].astype(np.int64)
        rows, at = rows[above >= 0], above[above >= 0]
    declared = np.flatnonzero((nearest >= 0) & is_bounded)
    boxes = Boxes(node.astype(np.int64), meshes.lower[mesh], meshes.upper[mesh])
    boxes.node[declared] = anchor[declared]
    boxes.lower[declared], boxes.upper[declared] = lower[nearest[declared]], upper[nearest[declared]]
    at, end = node[declared], anchor[declared]
    while len(at):  # one level upwards, to what is in the space of the anchor
        nodes.bound[at] = True
        above = nodes.parents[at].astype(np.int64)
        at, end = above[above != end], end[above != end]

    dynamic, simulated = nodes.dynamic[node], np.zeros(len(node), bool)
    simulated[deformed] = simulated[declared] = True
    follows = (boxes.node >= 0) & nodes.dynamic[boxes.node]
    objects = Objects(
        node=node.astype(np.int32),
        mesh=mesh.astype(np.int32),
        material=material.astype(np.int32),
        lower=np.zeros((len(node), 3)),
        upper=np.zeros((len(node), 3)),
        dynamic=dynamic,
        shown=np.ones(len(node), bool),
        casts_shadow=casts_shadow != 0,
        simulated=simulated,
        boxes=boxes,
        static_rows=np.flatnonzero(~dynamic),
        dynamic_rows=np.flatnonzero(dynamic),
        simulated_rows=np.flatnonzero(simulated),
        fixed_rows=np.flatnonzero(~follows),
        following_rows=np.flatnonzero(follows),
    )
    objects.refresh_bounds(nodes, np.arange(len(node)))
    return objects
