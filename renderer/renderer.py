"""The renderer: draws a scene frame by frame with a technique and a visibility algorithm."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from renderer.frame import Drawn, Frame, Layer, SceneResources, Targets
from renderer.scene import Camera, Scene, Simulator
from renderer.techniques import Forward, Technique
from renderer.visibility import VisibilityAlgorithm, VisibilityStatistics, make_visibility
from rhi import Device, Texture

_COUNTERS: Final = ("queries", "software_state_changes", "hardware_state_changes", "upload_bytes")
"""The device's counters that are part of a frame's statistics."""


@dataclass(frozen=True, slots=True)
class FrameStatistics:
    """The cost of one frame, without its layers.

    Attributes:
        triangles: number of triangles of the objects drawn.
        draws: number of objects drawn; one call may draw many.
        queries: number of occlusion queries.
        software_state_changes, hardware_state_changes: states set by scopes, and values sent to the device; with
            layers these include setting back what the last frame's layers changed.
        upload_bytes: bytes written to the device.
        simulation_steps: steps taken by the simulations of drawn objects, counted for each member.
        skipped_simulations: number of simulated or animated objects that weren't drawn.
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
    """A submitted frame.

    `image` and `depth` are overwritten by the next frame. `visibility` is the cost of finding the visible objects,
    None if the technique didn't do so. Where the device decides what is drawn, the first use of `visible` or
    `statistics` waits for the device; they can be read until the next frame.
    """

    image: Texture
    depth: Texture
    visibility: VisibilityStatistics | None
    _drawn: Drawn
    _counters: dict[str, int]

    @property
    def visible(self) -> NDArray[np.int64]:
        """The rows of the objects drawn."""
        return self._drawn.rows

    @cached_property
    def statistics(self) -> FrameStatistics:
        """The cost of the frame."""
        drawn = self._drawn
        return FrameStatistics(triangles=drawn.triangles, draws=len(drawn.rows), **self._counters)


class Renderer:
    """Draws one scene on one device.

    The attributes `technique` and `visibility` may be exchanged between any two frames, and `layers`, which are drawn
    over each frame in their order, changed.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        technique: Technique | None = None,
        visibility: VisibilityAlgorithm | None = None,
        size: tuple[int, int] = (960, 540),
        validation: bool = False,
    ) -> None:
        """Create the targets and upload the scene.

        Args:
            technique: how the scene is drawn; forward shading by default.
            visibility: an algorithm made for `scene`; by default `auto`, which measures which one is the fastest.
            size: (width, height) of the image in pixels.
            validation: whether to check samples of what is simulated: each batch has one object whose vertices must be
                inside its bounds (`scene-left-bounds`).
        """
        self.device = device
        self.scene = scene
        self.technique: Technique = technique or Forward()
        self.layers: list[Layer] = []
        self._own: list[VisibilityAlgorithm] = []
        if visibility is None:
            visibility = make_visibility("auto", scene, device)
            self._own.append(visibility)
        self.visibility: VisibilityAlgorithm = visibility
        self._targets = Targets(device, size)
        try:
            self._resources = SceneResources(device, scene)
            self._validation = self.simulator.validation = validation
        except BaseException:
            self._targets.destroy()
            raise

    @property
    def size(self) -> tuple[int, int]:
        """The (width, height) of the image in pixels; setting it creates new targets."""
        return self._targets.size

    @size.setter
    def size(self, size: tuple[int, int]) -> None:
        if size != self.size:
            targets = Targets(self.device, size)
            self._targets.destroy()
            self._targets = targets

    @property
    def simulator(self) -> Simulator:
        """Runs the simulations of what is drawn.

        It may be exchanged for another one of the same scene (`Scene.make_simulator`), whose members may have taken
        other steps.
        """
        return self._resources.simulator

    @simulator.setter
    def simulator(self, simulator: Simulator) -> None:
        simulator.validation = self._validation
        self._resources.simulator = simulator

    def render(self, camera: Camera, seconds: float = 0.0) -> FrameResult:
        """Draw the scene at the time `seconds` as `camera` sees it, with the image's aspect. Doesn't wait for the
        GPU."""
        device = self.device
        width, height = self.size
        camera = camera.with_aspect(width / height)
        before = device.statistics
        self.scene.seconds = seconds
        expected = self.simulator.drawn
        self.simulator.begin_frame(seconds)
        self.scene.refresh()
        self._resources.update(camera)
        self._resources.expect(camera, expected)
        frame = Frame(camera, self._resources, self._targets, self.visibility)
        self.technique.render(device, frame)
        after = device.statistics
        for layer in self.layers:
            layer.render(device, frame)
        device.present(self._targets.color)
        counters = {name: getattr(after, name) - getattr(before, name) for name in _COUNTERS}
        counters["simulation_steps"] = self.simulator.steps
        counters["skipped_simulations"] = len(self.simulator) - self.simulator.seen
        return FrameResult(self._targets.color, self._targets.depth, frame.statistics, frame.drawn, counters)

    def destroy(self) -> None:
        """Destroy all resources on the device, except those of layers and of a visibility algorithm that was passed
        in."""
        for visibility in self._own:
            visibility.destroy()
        self._own.clear()
        self._targets.destroy()
        self._resources.destroy()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()
