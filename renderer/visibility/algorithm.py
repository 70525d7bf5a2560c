"""What a visibility algorithm is: it decides what is drawn, and draws it.

An algorithm is one object, made for one scene, with one method. It hands the technique batches of objects
through a function, as soon as it knows them to be visible. Culling against the frustum calls it once;
algorithms that ask the GPU (stop-and-wait, CHC, CHC++) call it many times, with occlusion queries of their
own in between, on the same device and in the order in which they are to happen. What such an algorithm
needs beyond the scene, the device above all, it gets when it is made; so all stay exchangeable at run time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera

__rhi_internal__ = True

DrawObjects = Callable[[NDArray[np.int64]], None]
"""Draws the objects with these rows (k,), now, before anything that is issued later."""


@dataclass(frozen=True, slots=True)
class Statistics:
    """What one frame cost.

    Attributes:
        objects: how many there are; visible: how many were drawn; batches: in how many calls.
        nodes_tested, objects_tested: boxes of either kind that were tested against planes.
        plane_tests: (box, plane) pairs.
        queries: occlusion queries issued.
        box_draws, boxes: draws of bounding boxes inside queries, and how many boxes; they are no objects.
        stalled_milliseconds: how long the CPU waited for answers.
    """

    objects: int
    visible: int
    batches: int = 1
    nodes_tested: int = 0
    objects_tested: int = 0
    plane_tests: int = 0
    queries: int = 0
    box_draws: int = 0
    boxes: int = 0
    stalled_milliseconds: float = 0.0


class VisibilityAlgorithm(Protocol):
    """Decides which objects of its scene a camera sees."""

    def render(self, camera: Camera, draw: DrawObjects) -> Statistics:
        """Draw all that `camera` may see, each object once, in one batch or several.

        The scene must be up to date (`Scene.update`). The rows of a batch are ascending. An object that
        is not drawn covers no pixel; one that is drawn may cover none.
        """
        ...

    def destroy(self) -> None:
        """Give back what was made on the device."""
        ...


def find_visible_objects(algorithm: VisibilityAlgorithm, camera: Camera) -> NDArray[np.int64]:
    """The rows, ascending, of all objects that `algorithm` would draw; for tools and tests."""
    batches: list[NDArray[np.int64]] = [np.zeros(0, np.int64)]
    algorithm.render(camera, batches.append)
    return np.sort(np.concatenate(batches))
