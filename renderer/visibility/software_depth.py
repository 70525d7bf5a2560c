"""Occlusion culling with a second device as software rasteriser (thesis 8.2).

1. Of the objects in the frustum, those that look largest to the camera are drawn, with depth only, on a
   device of the algorithm's own, at the image's size or a whole part of it. It is an OpenCL device: on a CPU,
   a rasteriser in software.
2. The boxes of all objects in the frustum are tested against that depth in one batch (`OccluderDepth`). What
   isn't behind it is drawn.

The renderer's device is not queried, and none of its states change. Nothing is remembered from frame to
frame.
"""

from __future__ import annotations

import time
from functools import cache
from typing import Final

import numpy as np

import rhi
from renderer.scene import AlphaMode, Camera, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.algorithm import VisibilityStatistics, list_visible_objects
from renderer.visibility.boxes.bounds import near_mask, pad_boxes, squared_distances
from renderer.visibility.frustum import FrustumCulling
from renderer.visibility.gpu.occluder_depth import OccluderDepth
from renderer.visibility.scene_drawer import SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device

BACKEND: Final = "cl"
"""The backend of the device that occluders are drawn on."""
_SMALLEST: Final = 0.005
"""The least solid angle of an occluder in steradians, roughly: 0.5 % of a view of 60°."""


@cache
def can_rasterise() -> bool:
    """Return whether there is a device to draw occluders on."""
    try:
        with rhi.create_device(BACKEND) as device:
            return device.capabilities.draws and device.capabilities.compute
    except rhi.DeviceError:
        return False


class SoftwareDepth:
    """Draws the objects that aren't behind the largest objects in view."""

    opens_pass: Final = True

    def __init__(
        self, scene: Scene, _: Device | None = None, settings: VisibilitySettings = DEFAULTS
    ) -> None:
        """Occluders are drawn on a device of the algorithm's own. Raises `DeviceError` where there is no
        OpenCL device."""
        self._scene = scene
        self._frustum = FrustumCulling(scene)
        self._limit = min(settings.occluders, len(scene.objects))
        self._device = rhi.create_device(BACKEND)
        self._pixels = settings.occluder_pixels
        self._depth = OccluderDepth(
            self._device, scene, self._limit, len(scene.objects), texels=settings.pyramid_texels
        )

    @staticmethod
    def find_missing_feature(_: Device) -> str | None:
        """Name the feature that the machine lacks to draw occluders; the device itself needs nothing."""
        return None if can_rasterise() else "a device on the CPU that draws and computes"

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw the visible objects in one batch. The depth target of the pass gives the size of the image."""
        pixels = self._pixels
        width, height = scene_drawer.depth.size
        size = -(-width // pixels), -(-height // pixels)
        object_indices = list_visible_objects(self._frustum, camera)
        occluders = self.choose_occluders(camera, object_indices)
        self._depth.render(camera, occluders, size)

        objects = self._scene.objects
        lower, upper, far = pad_boxes(
            camera, objects.lower[object_indices], objects.upper[object_indices], (width, height)
        )
        visible_mask = near_mask(camera, lower, upper, far)
        tested = np.flatnonzero(~visible_mask)
        lower, upper = lower[tested], upper[tested]
        begin = time.perf_counter()
        visible_mask[tested] = self._depth.test_boxes(
            0.5 * (lower + upper) - camera.position, 0.5 * (upper - lower)
        )
        stalled = time.perf_counter() - begin
        visible = object_indices[visible_mask]
        if len(visible):
            scene_drawer.draw_alone(visible)
        return VisibilityStatistics(
            objects=len(objects),
            visible=len(visible),
            batches=int(len(visible) > 0),
            objects_tested=len(tested),
            stalled_milliseconds=1e3 * stalled,
        )

    def choose_occluders(self, camera: Camera, object_indices: Indices) -> Indices:
        """Return those of the objects `object_indices` (k,) with the largest surface over squared distance,
        near ones first."""
        objects = self._scene.objects
        # Simulated objects are where the renderer has last drawn them, the triangles of tessellated surfaces aren't
        # those that it draws, and others than opaque ones hide only a part.
        is_opaque = self._scene.materials["alpha_mode"][objects.material[object_indices]] == AlphaMode.OPAQUE
        is_fixed = ~(
            objects.simulated[object_indices] | np.isin(object_indices, list(self._scene.tessellated))
        )
        object_indices = object_indices[is_opaque & is_fixed]
        lower, upper = objects.lower[object_indices], objects.upper[object_indices]
        extent = np.minimum(upper - lower, 1e100)
        surface = (extent * np.roll(extent, 1, axis=1)).sum(axis=1)
        middle = 0.5 * (lower + upper)
        distance = np.maximum(squared_distances(camera.position, middle, middle), 1e-30)
        angle = surface / distance
        largest = np.argsort(-angle, kind="stable")[: self._limit]
        largest = largest[angle[largest] > _SMALLEST]
        order = np.argsort(distance[largest], kind="stable")
        return np.asarray(object_indices[largest[order]])

    def destroy(self) -> None:
        """Close the device."""
        self._depth.destroy()
        self._device.close()
