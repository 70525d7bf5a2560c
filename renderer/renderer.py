"""The renderer: a scene, a technique and a visibility algorithm on a device, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Drawn, Frame, SceneResources, Targets
from renderer.scene import Camera, Scene, Simulator
from renderer.techniques import Forward, Technique
from renderer.visibility import VisibilityAlgorithm, VisibilityStatistics, make_visibility
from rhi import Device, Texture

_COUNTERS: Final = ("queries", "software_state_changes", "hardware_state_changes", "upload_bytes")
"""Of the device, that frames are measured by."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """What one frame cost.

    Attributes:
        triangles: of the objects drawn.
        draws: objects drawn; one call may draw many.
        queries: occlusion queries.
        software_state_changes, hardware_state_changes: states set by scopes, and values sent to the device.
        upload_bytes: memory written to the device.
        simulation_steps: steps that simulations of objects drawn took, each of each object.
        skipped_simulations: simulations of objects that weren't drawn, and took none.
    """

    triangles: int
    draws: int
    queries: int
    software_state_changes: int
    hardware_state_changes: int
    upload_bytes: int
    simulation_steps: int
    skipped_simulations: int


@dataclass(frozen=True, eq=False)
class FrameResult:
    """A frame that was submitted: `image` and `depth` are drawn to again by the next one; `visibility` is what
    finding the visible objects cost (None if the technique asked for none).

    Where the device decides what is drawn, `visible` and `statistics` wait for it when they are first asked for, and
    can be asked for until the next frame.
    """

    image: Texture
    depth: Texture
    visibility: VisibilityStatistics | None
    _drawn: Drawn
    _counters: dict[str, int]

    @property
    def visible(self) -> NDArray[np.int64]:
        """Rows of the objects drawn."""
        return self._drawn.rows

    @cached_property
    def statistics(self) -> FrameStatistics:
        """What the frame cost."""
        drawn = self._drawn
        return FrameStatistics(triangles=drawn.triangles, draws=len(drawn.rows), **self._counters)


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
        """`size` is (width, height) in pixels. Without more, shading is forward, and visibility `auto`, which
        measures what is fastest. `visibility` must have been made for `scene`."""
        self.device = device
        self.scene = scene
        self.technique: Technique = technique or Forward()
        self._own: list[VisibilityAlgorithm] = []
        if visibility is None:
            visibility = make_visibility("auto", scene, device)
            self._own.append(visibility)
        self.visibility: VisibilityAlgorithm = visibility
        self._targets = Targets(device, size)
        try:
            self._resources = SceneResources(device, scene)
        except BaseException:
            self._targets.destroy()
            raise

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

    @property
    def simulator(self) -> Simulator:
        """Steps what is simulated and drawn. Another one of the same scene may have gone other ways to the same
        time: `Simulator(scene.simulated, len(scene.objects))`."""
        return self._resources.simulator

    @simulator.setter
    def simulator(self, simulator: Simulator) -> None:
        self._resources.simulator = simulator

    def render(self, camera: Camera, seconds: float = 0.0) -> FrameResult:
        """Draw the scene at `seconds` as `camera` sees it, with the image's aspect. Doesn't wait for the GPU."""
        device = self.device
        width, height = self.size
        camera = camera.with_aspect(width / height)
        before = device.statistics
        self.scene.update(seconds)
        self.simulator.begin_frame(seconds)
        self._resources.update(camera)
        frame = Frame(camera, self._resources, self._targets, self.visibility)
        self.technique.render(device, frame)
        device.present(self._targets.color)
        after = device.statistics
        counters = {name: getattr(after, name) - getattr(before, name) for name in _COUNTERS}
        counters["simulation_steps"] = self.simulator.steps
        counters["skipped_simulations"] = len(self.simulator) - self.simulator.seen
        return FrameResult(self._targets.color, self._targets.depth, frame.statistics, frame.drawn, counters)

    def destroy(self) -> None:
        """Give back everything made on the device; not a visibility algorithm that was given."""
        for visibility in self._own:
            visibility.destroy()
        self._own.clear()
        self._targets.destroy()
        self._resources.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
