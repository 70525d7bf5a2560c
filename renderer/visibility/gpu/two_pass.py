"""Two-pass occlusion culling (Deferred+, 1.3.1).

1. The last frame's depth is reprojected to this frame's camera, at a quarter of the resolution. Boxes are
   drawn against it; a fragment that passes the depth test marks its object, which is drawn.
2. The boxes of all other objects are drawn against the resulting depth, at full resolution. Objects that are
   marked now were wrongly hidden, and are drawn too.

`VisibilitySettings(proxy_planes=…)` draws polytopes in place of boxes (`proxies`).
"""

from __future__ import annotations

import numpy as np

from renderer.scene import Camera, Depth, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.boxes.cubes import BoxCamera
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.occludees import ComputeOccludees
from renderer.visibility.gpu.reprojection import ReprojectedDepth
from renderer.visibility.scene_drawer import SceneArrays, SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device, Encoder


class TwoPassCulling(DeviceCulling):
    """Draws what the last frame's depth doesn't hide, then what this frame's depth doesn't hide."""

    def __init__(self, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS) -> None:
        super().__init__(scene, device, ComputeOccludees, settings, settings.proxy_planes)
        self._reprojected = ReprojectedDepth(device)
        self._reprojected_camera = device.uniform(BoxCamera(relative_view_projection=np.eye(4)))
        self._camera = device.uniform(BoxCamera(relative_view_projection=np.eye(4)))

    @staticmethod
    def find_missing_feature(device: Device) -> str | None:
        """Name the feature that a device lacks: also early depth tests, without which hidden boxes mark their
        objects."""
        return DeviceCulling.find_missing_feature(device) or (
            None if device.capabilities.early_depth else "early depth tests"
        )

    def _aim(self, camera: Camera, size: tuple[int, int]) -> tuple[object, ...]:
        matrix, key = self._reprojected.aim(camera, size)
        self._reprojected_camera.write(BoxCamera(relative_view_projection=matrix))
        self._camera.write(BoxCamera(relative_view_projection=camera.relative_view_projection))
        return key

    def _mark_likely(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        with encoder.event("compute boxes"):
            self._occludees.compute_boxes(encoder, scene_drawer.arrays)
        with encoder.event("test boxes"), self._reprojected.render_pass(encoder, direction):
            self._occludees.mark_all(encoder, self._reprojected_camera, direction)

    def _mark_missed(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        with encoder.event("test boxes"), encoder.render_pass(depth=scene_drawer.depth):
            self._occludees.mark_listed(
                encoder, self._camera, direction, self.first.hidden, self.first.box_draw
            )

    def _reveal_meshlets(
        self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer, arrays: SceneArrays
    ) -> None:
        assert self.meshlets is not None
        boxes, seen = self.meshlets.pick(encoder, arrays, self._occludees)
        with encoder.render_pass(depth=scene_drawer.depth):
            self._occludees.mark_boxes(encoder, self._camera, direction, boxes, seen)
        self.meshlets.show(encoder)

    def _remember(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        self._reprojected.store(encoder, scene_drawer.depth, direction)

    def _count(self) -> VisibilityStatistics:
        count = self._occludees.count
        return VisibilityStatistics(
            objects=count, visible=count, batches=2, objects_tested=count, box_draws=2, boxes=2 * count
        )

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        super().destroy()
        for part in (self._reprojected, self._reprojected_camera, self._camera):
            part.destroy()
