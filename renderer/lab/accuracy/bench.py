"""The bench: renderers of one scene with different settings, and the truth that their pictures are judged by.

The judge looks at some thousand pixels of a picture, spread evenly: a mean needs no more, and so it takes about as
long for each size.
"""

from __future__ import annotations

from contextlib import ExitStack
from hashlib import sha256
from typing import Final, Self

import numpy as np

from renderer.lab.accuracy.float64 import decode_levels, encode_levels
from renderer.lab.measure.judge import Judge
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, Shot, StereoRig
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from renderer.stereo import fit_picture
from rhi import Device


class Bench:
    """Opens renderers of a scene, and closes them all at its end; one of them, at any size, draws the truth."""

    def __init__(
        self, device: Device, scene: Scene, size: tuple[int, int], truth: RenderSettings, scale: int = 1,
        rig: StereoRig | None = None, rays: int = 0,
    ) -> None:  # fmt: skip
        """`truth` and `scale`: the settings of what is true, and how many times as wide and high its picture is. With
        `rays` along each side of a pixel, the judge draws it instead."""
        self.device, self.scene, self._size, self._rig = device, scene, size, rig
        self._truth, self._scale = limit_anisotropy(truth, device), scale
        self._opened = ExitStack()
        self._true: Renderer | None = None
        self._rays = rays

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def open(self, settings: RenderSettings, scale: int = 1, scene: Scene | None = None) -> Renderer:
        """Return a renderer with these settings, of another scene if one is given."""
        width, height = self._size
        size = width * scale, height * scale
        return self._opened.enter_context(settings.open(self.device, scene or self.scene, size, self._rig))

    def draw(self, renderer: Renderer, settings: RenderSettings, shot: Shot) -> None:
        """Draw a shot, and wait for the device."""
        settings.render(renderer, shot)
        self.device.finish()

    def find_true(self, shot: Shot) -> Floats:
        """Return the true picture of a shot, of the size of all others; NaN where the judge doesn't look."""
        if self._rays:
            return self._judge(shot)
        self._true = self._true or self.open(self._truth, self._scale)
        return shrink_picture(read_picture(self._truth.render(self._true, shot)), self._scale)

    def _judge(self, shot: Shot) -> Floats:
        """Return what the judge sees of a shot, of two eyes the second one. It isn't drawn twice in a process."""
        size = self._size
        camera = self._truth.aim(shot.camera).with_aspect(size[0] / size[1])
        if self._rig is not None:
            camera = self._rig.place_eyes(camera)[1]  # which is squeezed in a picture of half the width
            size = fit_picture("side_by_side", size)
        if self.scene.simulated:
            self.scene.update(shot.seconds)
        key = _describe_view(self.scene, camera, size, self._rays)
        if key not in _JUDGED:
            every = max(1, round(np.sqrt(size[0] * size[1] / _LOOKED_AT)))
            _JUDGED[key] = Judge(self.scene).draw(camera, size, self._rays, every)
        return _JUDGED[key]


_LOOKED_AT: Final = 6000
"""About how many pixels of a picture the judge looks at."""
_JUDGED: Final[dict[str, Floats]] = {}
"""What the judge has seen in this process, by all that it depends on."""


def _describe_view(scene: Scene, camera: Camera, size: tuple[int, int], rays: int) -> str:
    """Return a hash of all that a picture of the judge depends on."""
    lights, meshes, objects = scene.lights, scene.meshes, scene.objects
    arrays = (
        scene.materials, scene.textures, scene.nodes.world, meshes.vertices, meshes.indices, objects.node, objects.mesh,
        objects.material, objects.casts_shadow, lights.directional, lights.point, lights.spot, *scene.images,
        camera.position, camera.rotation,
    )  # fmt: skip
    air = lights.sky, lights.ground, scene.background, scene.haze, scene.fog
    others = (*air, scene.samplers, camera.projection, size, rays)
    found = sha256(repr(others).encode())
    for array in arrays:
        found.update(np.ascontiguousarray(array).tobytes())
    return found.hexdigest()


def can_judge(scene: Scene) -> bool:
    """Return whether rays can follow all that a scene shows: it doesn't glow, no meshes are simulated, and materials
    have no shaders of their own."""
    return scene.glow is None and not scene.shaders and not any(len(one.objects) for one in scene.simulated)


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
