"""Reasons why an object is drawn: what the visibility algorithm knows about it."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility import AutoCulling, NoCulling, VisibilityAlgorithm, WalkOutcome, find_walk
from renderer.visibility.boxes.volumes import Containment, classify

_OF_NODES: Final = {
    WalkOutcome.OUTSIDE: "its node was outside the view",
    WalkOutcome.HIDDEN: "nothing in its node was found visible",
    WalkOutcome.QUERIED: "a query found something in its node visible",
    WalkOutcome.VISIBLE: "its node was taken as visible without a query",
    WalkOutcome.UNDECIDED: "the device decides about its node",
}


def explain_drawn(algorithm: VisibilityAlgorithm, scene: Scene, camera: Camera, row: int) -> str:
    """Return why the algorithm has drawn an object in the frame that `camera` has just seen."""
    if isinstance(algorithm, AutoCulling) and algorithm.latest is not None:
        return explain_drawn(algorithm.latest, scene, camera, row)
    if isinstance(algorithm, NoCulling):
        return "everything is drawn"
    rows = np.array([row])
    side = classify(camera.frustum.planes, scene.objects.lower[rows], scene.objects.upper[rows])[0]
    where = "inside the view" if side == Containment.INSIDE else "across the edge of the view"
    walk = find_walk(algorithm, scene, camera, rows)
    if walk.of_nodes:
        lower, upper = scene.objects.lower[row], scene.objects.upper[row]
        holds = np.flatnonzero(((walk.lower <= lower) & (walk.upper >= upper)).all(axis=1))
        if len(holds):
            smallest = holds[np.argmin(np.prod(walk.upper[holds] - walk.lower[holds], axis=1))]
            return f"its box is {where}; {_OF_NODES[WalkOutcome(walk.outcome[smallest])]}"
    return f"its box is {where}"
