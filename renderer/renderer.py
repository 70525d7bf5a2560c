"""The renderer: a scene, a technique and a visibility algorithm on a device, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Frame, SceneResources, Targets
from renderer.scene import Camera, Scene
from renderer.techniques import Forward, Technique
from renderer.visibility import FrustumCulling, Statistics, VisibilityAlgorithm
from rhi import Device, Texture


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """What one frame cost.

    Attributes:
        triangles: of the objects drawn.
        draws: objects drawn; one call may draw many.
        queries: occlusion queries.
        software_state_changes, hardware_state_changes: states set by scopes, and values sent to the device.
        upload_bytes: memory written to the device.
    """

    triangles: int
    draws: int
    queries: int
    software_state_changes: int
    hardware_state_changes: int
    upload_bytes: int


@dataclass(frozen=True, eq=False, slots=True)
class FrameResult:
    """A frame that was submitted: `image` and `depth` are drawn to again by the next one; `visible` are rows of
    objects, and `visibility` is what finding them cost (None if the technique asked for none)."""

    image: Texture
    depth: Texture
    statistics: FrameStatistics
    visible: NDArray[np.int64]
    visibility: Statistics | None


class Renderer:
    """Draws one scene on one device.

    `technique` and `visibility` are attributes: exchange them between any two frames.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        technique: Technique | None = None,
        visibility: VisibilityAlgorithm | None = None,
        size: tuple[int, int] = (960, 540),
    ) -> None:
        """`size` is (width, height) in pixels. Without more, shading is forward, and what is outside the view
        frustum is culled. `visibility` must have been made for `scene`."""
        self.device = device
        self.scene = scene
        self.technique: Technique = technique or Forward()
        self.visibility: VisibilityAlgorithm = visibility or FrustumCulling(scene)
        self._targets = Targets(device, size)
        self._resources = SceneResources(device, scene)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the image; setting it makes new targets."""
        return self._targets.size

    @size.setter
    def size(self, size: tuple[int, int]) -> None:
        if size != self.size:
            targets = Targets(self.device, size)
            self._targets.destroy()
            self._targets = targets

    def render(self, camera: Camera, seconds: float = 0.0) -> FrameResult:
        """Draw the scene at `seconds` as `camera` sees it, with the image's aspect. Doesn't wait for the GPU."""
        device = self.device
        width, height = self.size
        camera = camera.with_aspect(width / height)
        before = device.statistics
        self.scene.update(seconds)
        self._resources.update(camera)
        frame = Frame(camera, self._resources, self._targets, self.visibility)
        self.technique.render(device, frame)
        device.present(self._targets.color)
        visible = frame.visible
        after = device.statistics
        statistics = FrameStatistics(
            triangles=self.scene.count_triangles(visible),
            draws=len(visible),
            queries=after.queries - before.queries,
            software_state_changes=after.software_state_changes - before.software_state_changes,
            hardware_state_changes=after.hardware_state_changes - before.hardware_state_changes,
            upload_bytes=after.upload_bytes - before.upload_bytes,
        )
        return FrameResult(self._targets.color, self._targets.depth, statistics, visible, frame.statistics)

    def destroy(self) -> None:
        """Give back everything made on the device."""
        self._targets.destroy()
        self._resources.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
