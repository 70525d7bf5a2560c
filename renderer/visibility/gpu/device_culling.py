"""The common part of algorithms that run on the device: two lists of draws per frame.

The first list holds what is likely to be visible, as far as the last frame shows. With the depth of those
objects it is known exactly what else is visible; that is the second list. So whatever the first list misses,
which after a teleport is everything, is drawn in the same frame. What it holds too much costs time, and
changes no pixel.

The CPU knows none of this. It submits the same commands whatever is visible, and however many objects there
are: they are recorded once, and a frame writes its constants and submits them. While the device takes
timestamps they are issued one by one, and so the steps are timed."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar, Final

from renderer import rules
from renderer.scene import Camera, Depth, Scene
from renderer.visibility.algorithm import VisibilityStatistics
from renderer.visibility.command_cache import CommandCache
from renderer.visibility.gpu.draw_lists import IndirectDrawList, count_parts
from renderer.visibility.gpu.level_choice import LevelChoice
from renderer.visibility.gpu.meshlet_culling import MeshletCulling
from renderer.visibility.gpu.occludees import ComputeOccludees, Occludees
from renderer.visibility.gpu.proxies import ProxyOccludees
from renderer.visibility.scene_drawer import SceneArrays, SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from rhi import Device, Encoder, refuse


class DeviceCulling(ABC):
    """Base class of the algorithms that run on the device; it opens and closes the scene pass itself.

    In the statistics, all that the device may draw counts as drawn; `FrameResult.visible` is what it drew.

    Attributes:
        first, second: the lists of the latest frame.
        level_choice: the levels of detail of the latest frame that had any; None if no mesh has any.
        meshlets: the states of meshlets; None if no mesh is cut, or settings say that they are drawn whole.
        has_instances: whether the visible objects of a mesh are instances of one draw.
    """

    opens_pass: Final = True
    has_instances: ClassVar[bool] = True

    def __init__(
        self,
        scene: Scene,
        device: Device,
        occludee_shader: type[ComputeOccludees],
        settings: VisibilitySettings = DEFAULTS,
        proxy_planes: int = 0,
    ) -> None:
        """`occludee_shader` computes the boxes; of `proxy_planes` are the polytopes that are tested in their place."""
        if not (device.capabilities.compute and device.capabilities.draws):
            lacking = f"a {device.backend_name} device that lacks them"
            refuse(rules.NO_COMPUTE, f"{type(self).__name__}(...)", lacking)
        self._device = device
        if proxy_planes:
            self._occludees: Occludees = ProxyOccludees(device, scene, proxy_planes, occludee_shader)
        else:
            self._occludees = Occludees(device, len(scene.objects), occludee_shader)
        parts = count_parts(scene)
        self.first, self.second = (
            IndirectDrawList(device, self._occludees, parts, has_instances=self.has_instances)
            for _ in range(2)
        )
        self.level_choice = (
            LevelChoice(device, len(scene.objects)) if len(scene.meshes.level_ranges) else None
        )
        self.meshlets: MeshletCulling | None = None
        if settings.meshlets and len(scene.meshes.meshlet_ranges):
            self.meshlets = MeshletCulling(device)
        self._repeated = CommandCache(device, "culling")

    @staticmethod
    def find_missing_feature(device: Device) -> str | None:
        """Name the feature that a device lacks to cull and draw by itself."""
        can = device.capabilities
        return None if can.renders and can.compute else "compute shaders and draws that run"

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw the objects that were likely to be visible, then those that the depth shows to be visible."""
        scene_drawer.close()
        size = scene_drawer.depth.size
        self._occludees.aim(camera, size)
        aim = self._aim(camera, size)
        direction = camera.projection.depth
        meshlet_arrays = None if self.meshlets is None else scene_drawer.meshlet_arrays
        meshlets = None if meshlet_arrays is None else self.meshlets
        arrays = meshlet_arrays or scene_drawer.arrays
        key = (*scene_drawer.key, arrays, scene_drawer.depth, direction, *aim)
        for draws in (self.first, self.second):
            draws.renew()
            scene_drawer.begin_list(draws)

        levels = None if arrays.detail is None else self.level_choice
        drawn_parts = None if levels is None else levels.drawn_parts

        def issue(encoder: Encoder) -> None:
            with encoder.event("likely"):
                self._mark_likely(encoder, direction, scene_drawer)
                if levels is not None:
                    with encoder.event("choose levels"):
                        levels.choose(encoder, arrays)
                if meshlets is not None:
                    with encoder.event("cull meshlets"):
                        meshlets.cull(encoder, arrays, self._occludees, drawn_parts)
                with encoder.event("list draws"):
                    self.first.list_draws(encoder, arrays, drawn_parts, meshlets)
            scene_drawer.draw_list(encoder, self.first, first=True)
            with encoder.event("missed"):
                self._mark_missed(encoder, direction, scene_drawer)
                if meshlets is not None:
                    with encoder.event("cull meshlets"):
                        self._reveal_meshlets(encoder, direction, scene_drawer, arrays)
                with encoder.event("list draws"):
                    self.second.list_draws(encoder, arrays, drawn_parts, meshlets)
            scene_drawer.draw_list(encoder, self.second, first=False)
            with encoder.event("remember"):
                self._remember(encoder, direction, scene_drawer)

        if self._device.timing:
            issue(self._device)  # of recorded commands, events take no timestamps
        else:
            self._repeated.execute(key, issue)
        return self._count()

    def count_polytopes(self) -> int:
        """Return the number of objects of the last frame that were tested as polytopes. Waits for the device."""
        occludees = self._occludees
        return occludees.count_polytopes() if isinstance(occludees, ProxyOccludees) else 0

    @abstractmethod
    def _aim(self, camera: Camera, size: tuple[int, int]) -> tuple[object, ...]:
        """Write the constants of a frame, and return what its commands depend on besides the size and the
        direction of depth."""

    @abstractmethod
    def _mark_likely(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        """Find the boxes, and mark the objects of the first list."""

    @abstractmethod
    def _mark_missed(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        """Mark the objects of the second list: visible given the depth of the first list, and not yet
        drawn."""

    @abstractmethod
    def _reveal_meshlets(
        self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer, arrays: SceneArrays
    ) -> None:
        """Show the meshlets of the second list, of which `arrays` has the entries."""

    @abstractmethod
    def _remember(self, encoder: Encoder, direction: Depth, scene_drawer: SceneDrawer) -> None:
        """Keep what the next frame needs of this one."""

    def _count(self) -> VisibilityStatistics:
        count = self._occludees.count
        return VisibilityStatistics(objects=count, visible=count, batches=2, objects_tested=count)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._repeated.forget()
        for part in (self._occludees, self.first, self.second):
            part.destroy()
        for more in (self.level_choice, self.meshlets):
            if more is not None:
                more.destroy()
