"""Two-pass occlusion culling (Deferred+, 1.3.1).

1. The last frame's depth is reprojected to this frame's camera, at a quarter of the resolution. Boxes are drawn
   against it; a fragment that passes the depth test marks its object, which is drawn.
2. The boxes of all other objects are drawn against the resulting depth, at full resolution. Objects that are marked
   now were wrongly hidden, and are drawn too.
"""

from __future__ import annotations

from dataclasses import replace

from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.occludees import FindOccludees
from renderer.visibility.gpu.reprojection import ReprojectedDepth
from renderer.visibility.scene_pass import ScenePass
from rhi import Device

__rhi_internal__ = True


class TwoPassCulling(DeviceCulling):
    """Draws what the last frame's depth doesn't hide, then what this frame's depth doesn't hide."""

    def __init__(self, scene: Scene, device: Device) -> None:
        super().__init__(scene, device, FindOccludees)
        self._reprojected = ReprojectedDepth(device)

    def _mark_likely(self, camera: Camera, scene_pass: ScenePass) -> None:
        self._occludees.find(camera, scene_pass.arrays)
        with self._reprojected.render_pass(camera, scene_pass.depth.size) as matrix:
            self._occludees.mark_all(matrix, camera.projection.depth)

    def _mark_missed(self, camera: Camera, scene_pass: ScenePass) -> None:
        with self._device.render_pass(depth=scene_pass.depth):
            self._occludees.mark_listed(
                camera.relative_view_projection,
                camera.projection.depth,
                self.first.hidden,
                self.first.box_draw,
            )

    def _remember(self, camera: Camera, scene_pass: ScenePass) -> None:
        self._reprojected.remember(camera, scene_pass.depth)

    def _count(self) -> VisibilityStatistics:
        count = self._occludees.count
        return replace(super()._count(), box_draws=2, boxes=2 * count)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        super().destroy()
        self._reprojected.destroy()
