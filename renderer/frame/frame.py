"""What a technique is given for one frame, and the textures it draws to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.frame.resources import SceneResources
from renderer.scene import Camera
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
        self.color.destroy()
        self.depth.destroy()


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One frame to draw.

    Attributes:
        camera: from where; its projection says which way depth runs.
        visible: (k,) rows of the objects to draw, in any order.
        resources: the scene on the device, up to date for this camera.
        targets: what to draw to.
    """

    camera: Camera
    visible: NDArray[np.int64]
    resources: SceneResources
    targets: Targets

    def sort_front_to_back(self) -> NDArray[np.int64]:
        """`visible` by the depth of the boxes' centres: what is near hides what is drawn after it."""
        objects = self.resources.scene.objects
        centre = objects.lower[self.visible] + objects.upper[self.visible]
        order = np.argsort(centre @ self.camera.forward, kind="stable")
        return np.asarray(self.visible[order])

    def make_draws(self, rows: NDArray[np.int64]) -> NDArray[Any]:
        """The draws (k,) of `rhi.DRAW` of objects, whose rows are what `instance_index()` gives."""
        return np.asarray(self.resources.draws[rows])
