"""Reasons why an object is drawn: what the visibility algorithm knows about it."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility import (
    AutoCulling,
    NoCulling,
    TraversalOutcome,
    VisibilityAlgorithm,
    compute_traversal,
)
from renderer.visibility.boxes.volumes import Containment, classify

_OF_NODES: Final = {
    TraversalOutcome.OUTSIDE: "its node was outside the view",
    TraversalOutcome.HIDDEN: "nothing in its node was found visible",
    TraversalOutcome.QUERIED: "a query found something in its node visible",
    TraversalOutcome.VISIBLE: "its node was taken as visible without a query",
    TraversalOutcome.UNDECIDED: "the device decides about its node",
}


def explain_visible(algorithm: VisibilityAlgorithm, scene: Scene, camera: Camera, object_index: int) -> str:
    """Explain why the algorithm has drawn an object in the frame that `camera` has just seen."""
    if isinstance(algorithm, AutoCulling) and algorithm.latest is not None:
        return explain_visible(algorithm.latest, scene, camera, object_index)
    if isinstance(algorithm, NoCulling):
        return "everything is drawn"
    rows = np.array([object_index])
    side = classify(camera.frustum.planes, scene.objects.lower[rows], scene.objects.upper[rows])[0]
    where = "inside the view" if side == Containment.INSIDE else "across the edge of the view"
    traversal = compute_traversal(algorithm, scene, camera, rows)
    if traversal.is_of_nodes:
        lower, upper = scene.objects.lower[object_index], scene.objects.upper[object_index]
        holds = np.flatnonzero(((traversal.lower <= lower) & (traversal.upper >= upper)).all(axis=1))
        if len(holds):
            smallest = holds[np.argmin(np.prod(traversal.upper[holds] - traversal.lower[holds], axis=1))]
            return f"its box is {where}; {_OF_NODES[TraversalOutcome(traversal.outcome[smallest])]}"
    return f"its box is {where}"
