"""What algorithms that run on the device have in common: two lists of draws a frame.

The first list is of what is likely to show, judged by the frame before. With its depth, what else shows is exact
knowledge, and is the second list. So whatever the first one misses, after a teleport everything, is drawn in the
same frame; what it has too much costs time and no pixel.

The CPU knows none of this. It submits the same commands whatever there is to see, and however many objects.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Final

from renderer import rules
from renderer.scene import Camera, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.gpu.draw_lists import IndirectDrawList
from renderer.visibility.gpu.occludees import FindOccludees, Occludees
from renderer.visibility.scene_pass import ScenePass
from rhi import Device, refuse

__rhi_internal__ = True


class DeviceCulling(ABC):
    """The frame of both algorithms; it is rendered outside of passes, and opens the renderer's itself.

    In the statistics, all that the device may draw counts as drawn; `FrameResult.visible` is what it drew.

    Attributes:
        first, second: the lists of the latest frame.
    """

    opens_pass: Final = True

    def __init__(self, scene: Scene, device: Device, find: type[FindOccludees]) -> None:
        if not (device.capabilities.compute and device.capabilities.draws):
            given = f"a {device.backend_name} device without them"
            refuse(rules.NO_COMPUTE, f"{type(self).__name__}(...)", given)
        self._device = device
        self._occludees = Occludees(device, len(scene.objects), find)
        self.first = IndirectDrawList(device, self._occludees)
        self.second = IndirectDrawList(device, self._occludees)

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw what showed before and shows now, in a renderer's pass."""
        device = self._device
        scene_pass.close()
        with device.event("likely"):
            self._mark_likely(camera, scene_pass)
            self.first.list_draws(scene_pass.arrays)
        scene_pass.draw_list(self.first)
        scene_pass.close()
        with device.event("missed"):
            self._mark_missed(camera, scene_pass)
            self.second.list_draws(scene_pass.arrays)
        scene_pass.draw_list(self.second)
        scene_pass.close()
        self._remember(camera, scene_pass)
        return self._count()

    @abstractmethod
    def _mark_likely(self, camera: Camera, scene_pass: ScenePass) -> None:
        """Find the boxes, and mark what is to be drawn first."""

    @abstractmethod
    def _mark_missed(self, camera: Camera, scene_pass: ScenePass) -> None:
        """Mark all that is not drawn yet and shows, given the depth of what is."""

    @abstractmethod
    def _remember(self, camera: Camera, scene_pass: ScenePass) -> None:
        """Keep what the next frame wants of this one."""

    def _count(self) -> VisibilityStatistics:
        count = self._occludees.count
        return VisibilityStatistics(objects=count, visible=count, batches=2, objects_tested=count)

    def destroy(self) -> None:
        """Give back what was made on the device."""
        for part in (self._occludees, self.first, self.second):
            part.destroy()
