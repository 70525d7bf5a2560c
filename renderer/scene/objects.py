"""The objects of a scene as arrays, and the boxes that hold them.

An object's box is given in the space of a node. For most objects that is the box of their mesh, at their own
node, and it follows them. For a simulated object it is the box that the simulation never leaves, at the first
node above all that the simulation moves. So that box is where the object may be, at any time and wherever it
is drawn last.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import Meshes
from renderer.scene.nodes import Nodes
from rhi.math import transform_bounds


@dataclass(frozen=True, eq=False, slots=True)
class ObjectBoxes:
    """Boxes, one for each object: `lower` and `upper` (n, 3) in the space of `node` (n,), -1 for the
    world."""

    node: Indices
    lower: Floats
    upper: Floats

    def transforms(self, nodes: Nodes, rows: Indices) -> Floats:
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
        is_shown: (n,) bool, whether the object's node isn't hidden, kept up to date by `Scene.update`.
        casts_shadow: (n,) bool, whether the object casts shadows.
        simulated: (n,) bool, whether the object is simulated where it is drawn, and only there. Its vertices
            and its transform may be those of an earlier time; its bounds hold at all times.
        boxes: what `lower` and `upper` are computed from.
        static_indices, dynamic_indices, simulated_indices: int64, the rows of such objects, ascending.
        fixed_indices, following_indices: int64, indices of the objects whose world bounds never change, and
            of those whose bounds may follow a node, ascending. What is simulated in one place is dynamic and
            has fixed bounds.
    """

    node: NDArray[np.int32]
    mesh: NDArray[np.int32]
    material: NDArray[np.int32]
    lower: Floats
    upper: Floats
    dynamic: NDArray[np.bool_]
    is_shown: NDArray[np.bool_]
    casts_shadow: NDArray[np.bool_]
    simulated: NDArray[np.bool_]
    boxes: ObjectBoxes
    static_indices: Indices
    dynamic_indices: Indices
    simulated_indices: Indices
    fixed_indices: Indices
    following_indices: Indices

    def __len__(self) -> int:
        return len(self.node)

    def select_shown(self, indices: Indices) -> Indices:
        """Return the shown objects among `indices` (k,); the same array if all objects of the scene are
        shown."""
        return indices if 0 not in self.is_shown.tobytes() else indices[self.is_shown[indices]]

    def refresh_bounds(self, nodes: Nodes, indices: Indices) -> None:
        """Compute the world bounds of `indices` (k,) again."""
        boxes = self.boxes
        bounds = transform_bounds(
            boxes.transforms(nodes, indices), boxes.lower[indices], boxes.upper[indices]
        )
        self.lower[indices], self.upper[indices] = bounds


def make_objects(
    nodes: Nodes,
    meshes: Meshes,
    columns: tuple[Indices, Indices, Indices, Indices],
    deformed: Indices,
    animated: Indices,
    bounds: tuple[Floats, Floats],
) -> Objects:
    """Make the objects of a scene, with bounds as of now.

    Args:
        columns: for each object the rows (n,) of its node, its mesh and its material, and whether it casts
            shadows.
        deformed: the indices of the objects whose vertices are simulated.
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
        here, ancestor = rows[hit], number[at[hit]]
        nearest[here] = np.where(nearest[here] < 0, ancestor, nearest[here])
        anchor[here] = nodes.parents[at[hit]]
        is_bounded[here] &= ~np.isnan(lower[ancestor, 0])
        above = nodes.parents[at].astype(np.int64)
        rows, at = rows[above >= 0], above[above >= 0]
    declared = np.flatnonzero((nearest >= 0) & is_bounded)
    boxes = ObjectBoxes(node.astype(np.int64), meshes.lower[mesh], meshes.upper[mesh])
    boxes.node[declared] = anchor[declared]
    boxes.lower[declared], boxes.upper[declared] = lower[nearest[declared]], upper[nearest[declared]]
    at, end = node[declared], anchor[declared]
    while len(at):  # one level upwards, to what is in the space of the anchor
        nodes.keeps_parent[at] = True
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
        is_shown=np.ones(len(node), bool),
        casts_shadow=casts_shadow != 0,
        simulated=simulated,
        boxes=boxes,
        static_indices=np.flatnonzero(~dynamic),
        dynamic_indices=np.flatnonzero(dynamic),
        simulated_indices=np.flatnonzero(simulated),
        fixed_indices=np.flatnonzero(~follows),
        following_indices=np.flatnonzero(follows),
    )
    objects.refresh_bounds(nodes, np.arange(len(node)))
    return objects
