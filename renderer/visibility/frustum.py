"""Drawing without culling, and hierarchical view-frustum culling (thesis 6.1)."""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.culling import AllBoxes, Culler, CullingCounts, find_visible
from renderer.visibility.boxes.hierarchy import build_by_area
from renderer.visibility.scene_pass import ScenePass
from rhi import Device

_FEW: Final = 4096
"""So many boxes are tested one by one: that takes less time than traversing a hierarchy."""


class DevicelessCulling:
    """The base of algorithms that ask no device."""

    opens_pass: Final = True

    @staticmethod
    def find_obstacle(_: Device) -> None:
        """Find none: every device can run it."""

    def destroy(self) -> None:
        """Do nothing: there are no resources on the device."""


class NoCulling(DevicelessCulling):
    """Draws all objects: the reference that other algorithms are measured against."""

    def __init__(self, scene: Scene, *_: object) -> None:
        """Neither a device nor settings are needed."""
        self._objects, self._rows = scene.objects, np.arange(len(scene.objects))

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw every object that is shown."""
        rows = self._objects.find_shown(self._rows)
        scene_pass.draw_alone(rows)
        return VisibilityStatistics(len(self._rows), len(rows), by_frustum=True)


class FrustumCulling(DevicelessCulling):
    """Draws the objects whose bounds are not outside the frustum.

    Objects with fixed bounds are in a hierarchy that is built once by surface area, unless they are few. The others are
    tested one by one: that takes less time than building a hierarchy over them. The result is the set that
    `boxes.culling.find_visible` gives for all objects.
    """

    def __init__(self, scene: Scene, *_: object) -> None:
        """Neither a device nor settings are needed."""
        self._scene = scene
        rows = scene.objects.fixed_rows
        lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
        few = len(rows) <= _FEW
        self._static = AllBoxes(lower, upper) if few else Culler(build_by_area(lower, upper), lower, upper)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw the objects whose bounds are not outside the frustum."""
        objects = self._scene.objects
        planes = scene_pass.widen(camera).frustum.planes
        static, counts = self._static.find_visible(planes)
        visible = objects.fixed_rows.take(static)
        moving = objects.following_rows
        if len(moving):
            shown = find_visible(planes, objects.lower[moving], objects.upper[moving])
            visible = np.sort(np.concatenate([visible, moving[shown]]))
            counts = counts + CullingCounts(0, len(moving), len(moving) * len(planes))
        visible = objects.find_shown(visible)
        if len(visible):
            scene_pass.draw_alone(visible)
        return VisibilityStatistics(
            objects=len(objects),
            visible=len(visible),
            batches=int(len(visible) > 0),
            nodes_tested=counts.nodes,
            objects_tested=counts.objects,
            plane_tests=counts.planes,
            by_frustum=True,
        )
