"""Occlusion culling by a rasteriser beside the renderer's device (thesis 8.2).

1. Of the objects in the frustum, the largest ones as the camera sees them are drawn in depth on a device of the
   algorithm's own, which is OpenCL's: on a CPU, a rasteriser in software.
2. The boxes of all are tested against that depth in one batch (`OccluderDepth`), and what isn't behind it is drawn.

The renderer's device is asked nothing, and no state of it changes. Nothing is remembered: each frame stands alone.
"""

from __future__ import annotations

import time
from functools import cache
from typing import Final

import numpy as np

import rhi
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.visibility.algorithm import VisibilityStatistics, find_visible_objects
from renderer.visibility.boxes.bounds import find_near, pad_boxes, squared_distances
from renderer.visibility.frustum import FrustumCulling
from renderer.visibility.gpu.occluder_depth import OccluderDepth
from renderer.visibility.scene_pass import ScenePass

__rhi_internal__ = True

BACKEND: Final = "cl"
"""Of the device that occluders are drawn on."""
OCCLUDERS: Final = 64
_SMALLEST: Final = 0.005
"""Steradians, about, that an occluder covers; 0.5 % of a view of 60°."""


@cache
def can_rasterise() -> bool:
    """Whether there is a device to draw occluders on."""
    try:
        with rhi.create_device(BACKEND) as device:
            return device.capabilities.draws and device.capabilities.compute
    except rhi.DeviceError:
        return False


class SoftwareDepth:
    """Draws what isn't behind the largest objects in view."""

    opens_pass: Final = False

    def __init__(self, scene: Scene, *, occluders: int = OCCLUDERS) -> None:
        """At most `occluders` are drawn in depth. Raises `DeviceError` where there is no OpenCL."""
        self._scene = scene
        self._frustum = FrustumCulling(scene)
        self._limit = min(occluders, len(scene.objects))
        self._can_occlude = np.ones(len(scene.objects), bool)
        for one in scene.simulated:  # their vertices are the renderer's
            self._can_occlude[one.objects] = False
        self._device = rhi.create_device(BACKEND)
        self._depth = OccluderDepth(self._device, scene, self._limit, len(scene.objects))

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what shows, in one batch, in a renderer's pass, which says how large the image is."""
        size = scene_pass.depth.size
        rows = find_visible_objects(self._frustum, camera)
        chosen = self.choose_occluders(camera, rows)
        self._depth.render(camera, chosen, size)

        objects = self._scene.objects
        lower, upper, far = pad_boxes(camera, objects.lower[rows], objects.upper[rows])
        shown = find_near(camera, lower, upper, far)
        asked = np.flatnonzero(~shown)
        lower, upper = lower[asked], upper[asked]
        begin = time.perf_counter()
        shown[asked] = self._depth.find_shown(0.5 * (lower + upper) - camera.position, 0.5 * (upper - lower))
        stalled = time.perf_counter() - begin
        visible = rows[shown]
        if len(visible):
            scene_pass.draw(visible)
        return VisibilityStatistics(
            objects=len(objects),
            visible=len(visible),
            batches=int(len(visible) > 0),
            objects_tested=len(asked),
            stalled_milliseconds=1e3 * stalled,
        )

    def choose_occluders(self, camera: Camera, rows: Rows) -> Rows:
        """Of the objects `rows` (k,), the largest by surface over squared distance, near first."""
        rows = rows[self._can_occlude[rows]]
        lower, upper = self._scene.objects.lower[rows], self._scene.objects.upper[rows]
        extent = np.minimum(upper - lower, 1e100)
        surface = (extent * np.roll(extent, 1, axis=1)).sum(axis=1)
        middle = 0.5 * (lower + upper)
        distance = np.maximum(squared_distances(camera.position, middle, middle), 1e-30)
        angle = surface / distance
        largest = np.argsort(-angle, kind="stable")[: self._limit]
        largest = largest[angle[largest] > _SMALLEST]
        order = np.argsort(distance[largest], kind="stable")
        return np.asarray(rows[largest[order]])

    def destroy(self) -> None:
        """Give back the device."""
        self._depth.destroy()
        self._device.close()
