"""What a technique is given for one frame, and the textures it draws to."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from renderer.frame.resources import SceneResources
from renderer.scene import Camera
from renderer.visibility import DrawObjects, Statistics, VisibilityAlgorithm
from rhi import Device, Format, Texture


class Targets:
    """The image (sRGB) and the depth buffer (32-bit float) of one size."""

    def __init__(self, device: Device, size: tuple[int, int]) -> None:
        self.color: Texture = device.texture(size, Format.RGBA8_SRGB, label="image")
        self.depth: Texture = device.texture(size, Format.D32F, label="depth")

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.color.size

    def destroy(self) -> None:
        """Give the targets back."""
        self.color.destroy()
        self.depth.destroy()


@dataclass(eq=False, slots=True)
class Frame:
    """One frame to draw, once.

    Attributes:
        camera: from where; its projection says which way depth runs.
        resources: the scene on the device, up to date for this camera.
        targets: what to draw to.
        visibility: what decides which objects are drawn.
        batches: rows of the objects drawn so far, as `visibility` found them.
        statistics: what finding them cost, once `draw_visible` has been called.
    """

    camera: Camera
    resources: SceneResources
    targets: Targets
    visibility: VisibilityAlgorithm
    batches: list[NDArray[np.int64]] = field(default_factory=list)
    statistics: Statistics | None = None

    def draw_visible(self, draw: DrawObjects) -> None:
        """Let `draw` have the visible objects, in as many batches as it takes to find them.

        Within a batch objects are ordered front to back by the depth of their boxes' centres: what is near
        hides what is drawn after it. Call it once, where the frame's depth is first drawn; queries of the
        visibility algorithm take place there.
        """
        objects = self.resources.scene.objects

        def draw_batch(rows: NDArray[np.int64]) -> None:
            self.batches.append(rows)
            centre = objects.lower[rows] + objects.upper[rows]
            draw(rows[np.argsort(centre @ self.camera.forward, kind="stable")])

        self.statistics = self.visibility.render(self.camera, draw_batch)

    @property
    def visible(self) -> NDArray[np.int64]:
        """Rows of all objects drawn so far."""
        return np.concatenate([np.zeros(0, np.int64), *self.batches])
