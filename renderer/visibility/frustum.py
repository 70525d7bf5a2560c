"""Drawing without culling, and hierarchical view-frustum culling (thesis 6.1)."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.culling import BruteForceCuller, CullingCounts, HierarchyCuller, select_visible
from renderer.visibility.boxes.hierarchy import build_by_area
from renderer.visibility.scene_drawer import SceneDrawer
from rhi import Device

_MAX_BRUTE_FORCE: Final = 4096
"""So many boxes are tested one by one: that takes less time than traversing a hierarchy."""


class DevicelessCulling:
    """The base of algorithms that ask no device."""

    opens_pass: Final = True

    @staticmethod
    def find_missing_feature(_: Device) -> None:
        """Return None: every device can run it."""

    def destroy(self) -> None:
        """Do nothing: there are no resources on the device."""


class NoCulling(DevicelessCulling):
    """Draws all objects: the reference that other algorithms are measured against."""

    def __init__(self, scene: Scene, *_: object) -> None:
        """Neither a device nor settings are needed."""
        self._objects, self._rows = scene.objects, np.arange(len(scene.objects))

    def select(self, camera: Camera) -> tuple[Indices, VisibilityStatistics]:
        """Return every object that is shown (k,), and what finding them has cost."""
        object_indices = self._objects.select_shown(self._rows)
        return object_indices, VisibilityStatistics(
            len(self._rows), len(object_indices), is_frustum_only=True
        )

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw every object that is shown."""
        object_indices, statistics = self.select(camera)
        scene_drawer.draw_alone(object_indices)
        return statistics


class FrustumCulling(DevicelessCulling):
    """Draws the objects whose bounds are not outside the frustum.

    Objects with fixed bounds are in a hierarchy that is built once by surface area, unless they are few. The
    others are tested one by one: that takes less time than building a hierarchy over them. The result is the
    set that `boxes.culling.select_visible` gives for all objects."""

    def __init__(self, scene: Scene, *_: object) -> None:
        """Neither a device nor settings are needed."""
        self._scene = scene
        object_indices = scene.objects.fixed_indices
        lower, upper = scene.objects.lower[object_indices], scene.objects.upper[object_indices]
        is_small = len(object_indices) <= _MAX_BRUTE_FORCE
        self._static = (
            BruteForceCuller(lower, upper)
            if is_small
            else HierarchyCuller(build_by_area(lower, upper), lower, upper)
        )

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw the objects whose bounds are not outside the frustum."""
        visible, statistics = self.select(scene_drawer.widen(camera))
        if len(visible):
            scene_drawer.draw_alone(visible)
        return statistics

    def select(self, camera: Camera) -> tuple[Indices, VisibilityStatistics]:
        """Return the shown objects (k,), ascending, whose bounds are not outside the frustum of `camera`, and what
        finding them has cost."""
        objects, planes = self._scene.objects, camera.frustum.planes
        static, counts = self._static.select_visible(planes)
        visible = objects.fixed_indices[static]
        moving = objects.following_indices
        if len(moving):
            is_visible = select_visible(planes, objects.lower[moving], objects.upper[moving])
            visible = np.sort(np.concatenate([visible, moving[is_visible]]))
            counts = counts + CullingCounts(0, len(moving), len(moving) * len(planes))
        visible = objects.select_shown(visible)
        return visible, VisibilityStatistics(
            objects=len(objects.node),
            visible=len(visible),
            batches=int(len(visible) > 0),
            nodes_tested=counts.nodes,
            objects_tested=counts.objects,
            plane_tests=counts.planes,
            is_frustum_only=True,
        )
