"""The bench: renderers of one scene with different settings, and the truth that their pictures are judged by."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Self

import numpy as np

from renderer.lab.accuracy.float64 import decode_levels, encode_levels
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Scene, Shot, StereoRig
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device


class Bench:
    """Opens renderers of a scene, and closes them all at its end; one of them, at any size, draws the truth."""

    def __init__(
        self, device: Device, scene: Scene, size: tuple[int, int], truth: RenderSettings, scale: int = 1,
        rig: StereoRig | None = None,
    ) -> None:  # fmt: skip
        """`truth` and `scale`: the settings of what is true, and how many times as wide and high its picture is."""
        self.device, self.scene, self._size, self._rig = device, scene, size, rig
        self._truth, self._scale = limit_anisotropy(truth, device), scale
        self._opened = ExitStack()
        self._true: Renderer | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def open(self, settings: RenderSettings, scale: int = 1) -> Renderer:
        """Return a renderer with these settings."""
        width, height = self._size
        size = width * scale, height * scale
        return self._opened.enter_context(settings.open(self.device, self.scene, size, self._rig))

    def open_truth(self) -> None:
        """Open the renderer of the truth."""
        self._true = self.open(self._truth, self._scale)

    def draw(self, renderer: Renderer, settings: RenderSettings, shot: Shot) -> None:
        """Draw a shot, and wait for the device."""
        settings.render(renderer, shot)
        self.device.finish()

    def find_true(self, shot: Shot) -> Floats:
        """Return the true picture of a shot, of the size of all others."""
        assert self._true is not None
        return shrink_picture(read_picture(self._truth.render(self._true, shot)), self._scale)


def limit_anisotropy(settings: RenderSettings, device: Device) -> RenderSettings:
    """Return the settings of a truth with no more anisotropy than the device has."""
    most = min(settings.textures.anisotropy, device.capabilities.max_anisotropy)
    return settings.change("textures.anisotropy", most)


def read_picture(result: FrameResult) -> Floats:
    """Return the picture of a frame, of two eyes the second one's: (h, w, 3) in levels."""
    return np.asarray(result.pictures[-1].read()[..., :3], np.float64)


def shrink_picture(levels: Floats, scale: int) -> Floats:
    """Return a picture (h, w, 3) in which `scale` × `scale` pixels are one: the mean of their light, in levels."""
    if scale == 1:
        return levels
    height, width = (side // scale for side in levels.shape[:2])
    light = decode_levels(levels).reshape(height, scale, width, scale, 3).mean(axis=(1, 3))
    return encode_levels(light)
