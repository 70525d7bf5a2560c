"""The traversal of an algorithm in its last frame, node by node, for debug images.

An algorithm that walks a hierarchy of the CPU tells what became of each node that it reached
(`TraversalSource`). All is read from what it remembers anyway, and only when asked for. For the other
algorithms `compute_traversal` shows objects: those in the frustum that were drawn, those that weren't, and
those outside.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.visibility.algorithm import VisibilityAlgorithm
from renderer.visibility.boxes.culling import select_visible
from renderer.visibility.boxes.forest import OUTSIDE, Forest


class TraversalOutcome(IntEnum):
    """The fate of a node or an object in a frame."""

    OUTSIDE = 0
    """It was reached and culled, because it is outside the frustum."""
    HIDDEN = 1
    """Nothing in it was found visible."""
    QUERIED = 2
    """A query was issued for it, and as far as is known something in it is visible."""
    VISIBLE = 3
    """Something in it is taken as visible without a query in this frame."""
    UNDECIDED = 4
    """It is inside the frustum; the device decides whether it is drawn."""


class CullingTraversal(NamedTuple):
    """The nodes or objects that an algorithm has dealt with in a frame.

    Attributes:
        is_of_nodes: whether they are nodes of a hierarchy; otherwise they are objects.
        lower, upper: (k, 3) their bounds.
        outcome: (k,) of `TraversalOutcome`.
    """

    is_of_nodes: bool
    lower: Floats
    upper: Floats
    outcome: NDArray[np.uint8]


@runtime_checkable
class TraversalSource(Protocol):
    """An algorithm that walks a hierarchy on the CPU."""

    def traversal(self) -> CullingTraversal | None:
        """Return the nodes that the last `render` reached; None if it walked no hierarchy."""
        ...


def compute_traversal(
    algorithm: VisibilityAlgorithm, scene: Scene, camera: Camera, drawn: Indices | None
) -> CullingTraversal:
    """The traversal of `algorithm` in the frame that `camera` has just seen.

    `drawn` are the indices of the objects drawn, None if only the device knows them.
    """
    traversal = algorithm.traversal() if isinstance(algorithm, TraversalSource) else None
    if traversal is not None:
        return traversal
    lower, upper = scene.objects.lower, scene.objects.upper
    inside = select_visible(camera.frustum.planes, lower, upper) & scene.objects.is_shown
    outcomes = np.full(len(lower), TraversalOutcome.UNDECIDED, np.uint8)
    if drawn is not None:
        outcomes[:] = TraversalOutcome.HIDDEN
        outcomes[drawn] = TraversalOutcome.VISIBLE
        inside[drawn] = True
    return CullingTraversal(
        False, lower, upper, np.where(inside, outcomes, np.uint8(TraversalOutcome.OUTSIDE))
    )


def forest_traversal(
    forest: Forest, visited: NDArray[np.bool_], visible: bytearray, queried: bytearray
) -> CullingTraversal:
    """Return the traversal of a forest's nodes (m,).

    Args:
        visited: the nodes that were reached and aren't outside.
        visible: the nodes in which something is visible. asked: those for which a query was issued.

    A node outside the frustum was reached if its parent was opened; of a parent in which nothing was found,
    it shows only beside a sibling that was visited.
    """
    parent = np.array(forest.parent)
    has_parent = parent >= 0
    is_visible = visited & (np.frombuffer(visible, np.uint8) != 0)
    opened = is_visible.copy()
    opened[parent[visited & has_parent]] = True
    outside = (np.frombuffer(forest.status, np.uint8) == OUTSIDE) & (~has_parent | opened[parent])
    outcome = np.where(np.frombuffer(queried, np.uint8), TraversalOutcome.QUERIED, TraversalOutcome.VISIBLE)
    outcome = np.where(
        outside, TraversalOutcome.OUTSIDE, np.where(is_visible, outcome, TraversalOutcome.HIDDEN)
    )
    rows = np.flatnonzero(visited | outside)
    return CullingTraversal(True, forest.lower[rows], forest.upper[rows], outcome[rows].astype(np.uint8))
