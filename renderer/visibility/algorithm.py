"""The protocol of visibility algorithms: an algorithm decides which objects are drawn, and has them drawn.

An algorithm is one object, made for one scene, with one method. It draws batches of objects in a technique's
pass, as soon as it knows them to be visible. Frustum culling draws one batch. Algorithms that use occlusion
queries (stop-and-wait, CHC, CHC++) draw many, with queries of their own in between, on the same device and in
the order in which they are to be executed. Whatever else an algorithm needs, above all the device, its
constructor takes, so all algorithms can be exchanged at run time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Protocol, cast

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.scene_drawer import CallbackDrawer, SceneDrawer
from renderer.visibility.settings import VisibilitySettings
from rhi import Device


@dataclass(frozen=True, slots=True)
class VisibilityStatistics:
    """The cost of finding the visible objects of one frame.

    Attributes:
        objects: number of objects in the scene.
        visible: number of objects drawn.
        batches: number of batches.
        nodes_tested, objects_tested: boxes of nodes and of objects that were tested against planes.
        plane_tests: number of (box, plane) pairs tested.
        queries: number of occlusion queries issued.
        box_draws, boxes: draws of bounding boxes inside queries, and the number of boxes drawn; not objects.
        stalled_milliseconds: how long the CPU waited for query results.
        is_frustum_only: whether only the frustum of `SceneDrawer.widen` decided, so that the objects are
            those of all eyes.
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
    is_frustum_only: bool = False


class VisibilityAlgorithm(Protocol):
    """Decides which objects of its scene a camera sees, and draws them."""

    @property
    def opens_pass(self) -> bool:
        """True if the algorithm opens the pass itself. Otherwise the pass must be open when `render` is
        called."""
        ...

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw all that `camera` may see, each object once, in one batch or several.

        The scene must be up to date (`Scene.update`). The rows of a batch are ascending. An object that
        is not drawn covers no pixel; one that is drawn may cover none.
        """
        ...

    def destroy(self) -> None:
        """Destroy the algorithm's resources on the device."""
        ...


class SelectingAlgorithm(Protocol):
    """An algorithm that selects all objects of a frame before any is drawn."""

    def select(self, camera: Camera) -> tuple[Indices, VisibilityStatistics] | None:
        """Return the indices (k,), ascending, of the objects that `render` would draw, and their cost; None if this
        frame has to be rendered, since its objects are found otherwise."""
        ...


def to_selecting(algorithm: VisibilityAlgorithm | None) -> SelectingAlgorithm | None:
    """Return an algorithm whose `render` draws what its `select` returns; None for others, among them one whose class
    or caller has replaced `render` alone."""
    if algorithm is None or "render" in getattr(algorithm, "__dict__", ()):
        return None
    if not _renders_selection(algorithm.__class__):
        return None
    return cast(SelectingAlgorithm, algorithm)


@cache
def _renders_selection(kind: type[VisibilityAlgorithm]) -> bool:
    owner = next((base for base in kind.__mro__ if "render" in vars(base)), object)
    return "select" in vars(owner)


class ListedAlgorithm(VisibilityAlgorithm, Protocol):
    """An algorithm that can be chosen by name: it takes its settings whole, and says what it needs of a
    device."""

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings, /) -> None: ...

    @staticmethod
    def find_missing_feature(device: Device) -> str | None:
        """Name the feature that a device lacks for the algorithm, in a few words, or None if it can."""
        ...


def list_visible_objects(algorithm: VisibilityAlgorithm, camera: Camera) -> Indices:
    """Return the indices (k,), ascending, of all objects that `algorithm` would draw; for tools and tests."""
    batches: list[Indices] = [np.zeros(0, np.int64)]
    algorithm.render(camera, CallbackDrawer(batches.append))
    return np.sort(np.concatenate(batches))
