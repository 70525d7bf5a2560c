"""The walk of an algorithm in its last frame, node by node, for debug pictures.

An algorithm that walks a hierarchy of the CPU tells what became of each node that it reached (`WalksNodes`). All is
read from what it remembers anyway, and only when asked for. For the other algorithms `find_walk` shows objects: those
in the frustum that were drawn, those that weren't, and those outside.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Rows
from renderer.visibility.algorithm import VisibilityAlgorithm
from renderer.visibility.boxes.culling import find_visible
from renderer.visibility.boxes.forest import OUTSIDE, Forest


class WalkOutcome(IntEnum):
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


class CullingWalk(NamedTuple):
    """The nodes or objects that an algorithm has dealt with in a frame.

    Attributes:
        of_nodes: whether they are nodes of a hierarchy; otherwise they are objects.
        lower, upper: (k, 3) their bounds.
        outcome: (k,) of `WalkOutcome`.
    """

    of_nodes: bool
    lower: Floats
    upper: Floats
    outcome: NDArray[np.uint8]


@runtime_checkable
class WalksNodes(Protocol):
    """An algorithm that walks a hierarchy on the CPU."""

    def walk(self) -> CullingWalk | None:
        """Return the nodes that the last `render` reached; None if it walked no hierarchy."""
        ...


def find_walk(algorithm: VisibilityAlgorithm, scene: Scene, camera: Camera, drawn: Rows | None) -> CullingWalk:
    """Return what `algorithm` did in the frame that `camera` has just seen.

    `drawn` are the rows of the objects drawn, None if only the device knows them.
    """
    walk = algorithm.walk() if isinstance(algorithm, WalksNodes) else None
    if walk is not None:
        return walk
    lower, upper = scene.objects.lower, scene.objects.upper
    inside = find_visible(camera.frustum.planes, lower, upper) & scene.objects.shown
    seen = np.full(len(lower), WalkOutcome.UNDECIDED, np.uint8)
    if drawn is not None:
        seen[:] = WalkOutcome.HIDDEN
        seen[drawn] = WalkOutcome.VISIBLE
        inside[drawn] = True
    return CullingWalk(False, lower, upper, np.where(inside, seen, np.uint8(WalkOutcome.OUTSIDE)))


def walk_forest(forest: Forest, visited: NDArray[np.bool_], visible: bytearray, asked: bytearray) -> CullingWalk:
    """Return the walk through a forest's nodes (m).

    Args:
        visited: the nodes that were reached and aren't outside.
        visible: the nodes in which something is visible. asked: those for which a query was issued.

    A node outside the frustum was reached if its parent was opened; of a parent in which nothing was found, it shows
    only beside a sibling that was visited.
    """
    parent = np.array(forest.parent)
    has_parent = parent >= 0
    found = visited & (np.frombuffer(visible, np.uint8) != 0)
    opened = found.copy()
    opened[parent[visited & has_parent]] = True
    outside = (np.frombuffer(forest.status, np.uint8) == OUTSIDE) & (~has_parent | opened[parent])
    outcome = np.where(np.frombuffer(asked, np.uint8), WalkOutcome.QUERIED, WalkOutcome.VISIBLE)
    outcome = np.where(outside, WalkOutcome.OUTSIDE, np.where(found, outcome, WalkOutcome.HIDDEN))
    rows = np.flatnonzero(visited | outside)
    return CullingWalk(True, forest.lower[rows], forest.upper[rows], outcome[rows].astype(np.uint8))
