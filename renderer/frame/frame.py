"""The state of one frame that a technique is given, and the textures it draws to."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field

from renderer.frame.passes import Drawn, TechniquePass
from renderer.frame.resources import SceneResources
from renderer.scene import Camera
from renderer.visibility import VisibilityAlgorithm, VisibilityStatistics
from rhi import Device, Format, Texture


class Targets:
    """The targets of a frame, of one size: an image (sRGB) and a depth buffer (32-bit float)."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        with ExitStack() as made:  # creates both or neither
            self.color: Texture = made.enter_context(device.texture(size, Format.RGBA8_SRGB, label="image"))
            self.depth: Texture = made.enter_context(device.texture(size, Format.D32F, label="depth"))
            made.pop_all()

    @property
    def size(self) -> tuple[int, int]:
        """The size (width, height) of both targets in pixels."""
        return self.color.size

    def destroy(self) -> None:
        """Destroy both textures."""
        self.color.destroy()
        self.depth.destroy()


@dataclass(eq=False, slots=True)
class Frame:
    """One frame, to be drawn once.

    Attributes:
        camera: the camera; its projection gives the direction of depth.
        resources: the scene on the device, up to date for this camera.
        targets: the textures to draw to.
        visibility: the algorithm that decides which objects are drawn.
        drawn: the objects drawn, after `draw_visible`.
        statistics: the cost of finding them, after `draw_visible`.
    """

    camera: Camera
    resources: SceneResources
    targets: Targets
    visibility: VisibilityAlgorithm
    drawn: Drawn = field(init=False)
    statistics: VisibilityStatistics | None = None

    def __post_init__(self) -> None:
        self.drawn = Drawn(self.resources.scene)

    def draw_visible(self, scene_pass: TechniquePass) -> None:
        """Draw the visible objects in a pass, in as many batches as the visibility algorithm finds them.

        Call it once, where the frame's depth is first drawn; the visibility algorithm issues its own commands there.
        """
        self.drawn = scene_pass.drawn
        with scene_pass:
            if not self.visibility.opens_pass:
                scene_pass.open()
            self.statistics = self.visibility.render(self.camera, scene_pass)
            if not scene_pass.was_opened:  # nothing was drawn: the targets are cleared all the same
                scene_pass.open()
