"""No culling, and hierarchical view-frustum culling (thesis 6.1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import DrawObjects, Statistics
from renderer.visibility.boxes.culling import Counts, Culler
from renderer.visibility.boxes.hierarchy import Floats, Rows, build_by_area, build_by_median
from renderer.visibility.boxes.volumes import Fit, Side, classify, fit_aligned, fit_oriented, fit_spheres

__rhi_internal__ = True


class NoCulling:
    """Draws everything: what the others are measured against."""

    def __init__(self, scene: Scene) -> None:
        self._rows: Rows = np.arange(len(scene.objects))

    def render(self, camera: Camera, draw: DrawObjects) -> Statistics:
        """Draw every object."""
        draw(self._rows)
        return Statistics(len(self._rows), len(self._rows))

    def destroy(self) -> None:
        """Nothing was made on the device."""


class FrustumCulling:
    """Draws the objects whose bounds are not outside the frustum.

    Static objects are in a hierarchy built once by surface area, dynamic ones in one built each frame at
    medians. The set is the one that `culling.find_visible` gives for all objects.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        rows = scene.objects.static_rows
        lower, upper = scene.objects.lower[rows], scene.objects.upper[rows]
        self.hierarchy = build_by_area(lower, upper)
        self._static = Culler(self.hierarchy, lower, upper)

    def render(self, camera: Camera, draw: DrawObjects) -> Statistics:
        """Draw the objects whose bounds meet the frustum."""
        objects = self._scene.objects
        planes = camera.frustum.planes
        static, counts = self._static.find_visible(planes)
        visible = objects.static_rows.take(static)
        if len(objects.dynamic_rows):
            moving, more = self._find_moving(planes)
            visible = np.sort(np.concatenate([visible, objects.dynamic_rows.take(moving)]))
            counts = counts + more
        if len(visible):
            draw(visible)
        return Statistics(
            objects=len(objects),
            visible=len(visible),
            batches=int(len(visible) > 0),
            nodes_tested=counts.nodes,
            objects_tested=counts.objects,
            plane_tests=counts.planes,
        )

    def destroy(self) -> None:
        """Nothing was made on the device."""

    def _find_moving(self, planes: Floats) -> tuple[Rows, Counts]:
        rows = self._scene.objects.dynamic_rows
        lower, upper = self._scene.objects.lower[rows], self._scene.objects.upper[rows]
        return Culler(build_by_median(lower, upper, leaf_size=16), lower, upper).find_visible(planes)


class VolumeCulling:
    """Draws the objects of which no bounding volume is outside the frustum: each kind of volume for all objects at
    once. The more kinds, the fewer objects."""

    def __init__(self, scene: Scene, fits: Sequence[Fit] = (fit_aligned, fit_oriented, fit_spheres)) -> None:
        """`fits` make the volumes, one kind or several."""
        self._scene = scene
        self._fits = tuple(fits)
        self._static = [fit(scene, scene.objects.static_rows) for fit in fits]

    def render(self, camera: Camera, draw: DrawObjects) -> Statistics:
        """Draw the objects that may meet the frustum."""
        objects, planes = self._scene.objects, camera.frustum.planes
        seen = np.ones(len(objects), bool)
        for fit, static in zip(self._fits, self._static, strict=True):
            seen[objects.static_rows] &= classify(planes, static) != Side.OUTSIDE
            if len(objects.dynamic_rows):
                moving = fit(self._scene, objects.dynamic_rows)
                seen[objects.dynamic_rows] &= classify(planes, moving) != Side.OUTSIDE
        visible = np.flatnonzero(seen)
        if len(visible):
            draw(visible)
        tested = len(objects) * len(self._fits)
        return Statistics(
            objects=len(objects),
            visible=len(visible),
            batches=int(len(visible) > 0),
            objects_tested=tested,
            plane_tests=tested * len(planes),
        )

    def destroy(self) -> None:
        """Nothing was made on the device."""
