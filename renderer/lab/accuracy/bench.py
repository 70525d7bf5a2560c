"""The bench: renderers of one scene with different settings, and the reference that their images are compared
with.

The reference ray tracer renders a few thousand pixels, spread evenly: enough for a mean, and about as
fast at any image size.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Final, Self

import numpy as np

from renderer.lab.accuracy.float64 import decode_levels, encode_levels
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, PathFrame, Scene, StereoRig
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter
from renderer.stereo import eye_image_size
from rhi import Device

TRACED_PIXELS: Final = 6000
"""About how many pixels of an image are traced for the errors of a single quality setting."""
_TRACER_VERSION: Final = 2
"""Part of the name of a stored image. Raise it with any change of what the ray tracer renders."""


class Bench:
    """Opens renderers of a scene and destroys them at its end; one of them may render the reference, at any
    size."""

    def __init__(
        self,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        reference: RenderSettings,
        scale: int = 1,
        rig: StereoRig | None = None,
        rays: int = 0,
        traced_pixels: int = TRACED_PIXELS,
    ) -> None:
        """Open a bench. `reference` are the reference's settings, `scale` is how many times as wide and high
        it is. With `rays` along each side of a pixel, the reference ray tracer renders about `traced_pixels`
        of it instead."""
        self.device, self.scene, self._size, self._rig = device, scene, size, rig
        self._reference_settings, self._scale = limit_anisotropy(reference, device), scale
        self._opened = ExitStack()
        self._reference_renderer: Renderer | None = None
        self._ray_tracer: tuple[str, RayTracer] | None = None  # with the state of the scene that it renders
        self._rays, self._traced_pixels = rays, traced_pixels

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.close()

    def open(self, settings: RenderSettings, scale: int = 1, scene: Scene | None = None) -> Renderer:
        """Open a renderer with these settings, of another scene if one is passed."""
        width, height = self._size
        size = width * scale, height * scale
        return self._opened.enter_context(settings.open(self.device, scene or self.scene, size, self._rig))

    def draw(self, renderer: Renderer, settings: RenderSettings, path_frame: PathFrame) -> None:
        """Draw a frame, and wait for the device."""
        settings.render(renderer, path_frame)
        self.device.finish()

    def render_reference(self, path_frame: PathFrame) -> Floats:
        """The reference image of a frame, at the size of all others; NaN in pixels that weren't traced."""
        if self._rays:
            return self._trace_reference(path_frame)
        self._reference_renderer = self._reference_renderer or self.open(
            self._reference_settings, self._scale
        )
        return downsample_image(
            read_image_levels(self._reference_settings.render(self._reference_renderer, path_frame)),
            self._scale,
        )

    def _trace_reference(self, path_frame: PathFrame) -> Floats:
        """The ray-traced image of a frame, in stereo the second eye's. Traced once per process."""
        size = self._size
        camera = self._reference_settings.adapt_camera(path_frame.camera).with_aspect(size[0] / size[1])
        if self._rig is not None:
            camera = self._rig.place_eyes(camera)[1]  # squeezed into an image of half the width
            size = eye_image_size("side_by_side", size)
        if self.scene.simulated:
            self.scene.update(path_frame.seconds)
        has_penumbras = self._reference_settings.shadows.filter is ShadowFilter.PCSS
        every = max(1, round(np.sqrt(size[0] * size[1] / self._traced_pixels)))
        state = f"{_describe_scene(self.scene)} {has_penumbras}"
        key = f"{_describe_view(state, camera, size, self._rays)} {every}"
        if key not in _TRACED:

            def trace() -> Floats:
                # Most of the time of a small image goes into the order of the triangles, which views share.
                former, tracer = self._ray_tracer or ("", None)
                if tracer is None or former != state:
                    tracer = RayTracer(self.scene, has_penumbras=has_penumbras, earlier=tracer)
                    self._ray_tracer = state, tracer
                return tracer.draw(camera, size, self._rays, every)

            _TRACED[key] = _load_or_trace(key, trace)
        return _TRACED[key]


_TRACED: Final[dict[str, Floats]] = {}
"""Ray-traced images of this process, by a hash of all that they depend on."""
_FOLDERS: Final[list[Path]] = []
"""Folders that store ray-traced images; the last one is used."""


@contextmanager
def keep_references(folder: Path | None) -> Iterator[None]:
    """Store the ray-traced images of this process in a folder, and read those that it has; None stores none."""
    if folder is None:
        yield
        return
    _FOLDERS.append(folder)
    try:
        yield
    finally:
        _FOLDERS.pop()


def _load_or_trace(key: str, trace: Callable[[], Floats]) -> Floats:
    """The ray-traced image of a key: read from the folder, or traced and stored there."""
    if not _FOLDERS:
        return trace()
    name = sha256(f"{key} {_TRACER_VERSION}".encode()).hexdigest()[:24]
    path = _FOLDERS[-1] / f"reference-{name}.npy"
    try:
        return np.asarray(np.load(path, allow_pickle=False), np.float64)
    except (OSError, ValueError, EOFError):  # missing or damaged
        image = trace()
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.part")
    with beside.open("wb") as file:
        np.save(file, image)
    beside.replace(path)
    return image


def _describe_view(state: str, camera: Camera, size: tuple[int, int], rays: int) -> str:
    """A hash of all that a ray-traced image of a scene in this state depends on."""
    digest = sha256(repr((state, camera.projection, size, rays)).encode())
    for array in (camera.position, camera.rotation):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _describe_scene(scene: Scene) -> str:
    """A hash of all of a scene that a ray-traced image depends on."""
    lights, meshes, objects = scene.lights.without_hidden(), scene.meshes, scene.objects
    arrays = (
        scene.materials,
        scene.textures,
        scene.nodes.world,
        meshes.vertices,
        meshes.indices,
        objects.node,
        objects.mesh,
        objects.material,
        objects.casts_shadow,
        lights.directional,
        lights.point,
        lights.spot,
        *scene.images,
        *(() if scene.environment is None else (scene.environment.image,)),
    )
    air = lights.sky, lights.ground, scene.background, scene.haze, scene.fog
    screen = scene.ambient_occlusion, scene.depth_of_field, repr(scene.environment)
    others = (*air, *screen, scene.samplers)
    digest = sha256(repr(others).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def can_ray_trace(scene: Scene) -> bool:
    """True if the reference ray tracer supports all of a scene: no bloom, no simulated meshes, no materials
    with shaders of their own."""
    return (
        scene.bloom is None
        and not scene.shaders
        and not any(len(simulated.objects) for simulated in scene.simulated)
    )


def limit_anisotropy(settings: RenderSettings, device: Device) -> RenderSettings:
    """The reference's settings, with no more anisotropy than the device has."""
    most = min(settings.textures.anisotropy, device.capabilities.max_anisotropy)
    return settings.change("textures.anisotropy", most)


def read_image_levels(result: FrameResult) -> Floats:
    """The image of a frame, in stereo the second eye's: (h, w, 3) in levels."""
    return np.asarray(result.eye_images[-1].read()[..., :3], np.float64)


def downsample_image(levels: Floats, scale: int) -> Floats:
    """The image (h, w, 3) with `scale` × `scale` pixels averaged into one, as light; in levels."""
    if scale == 1:
        return levels
    height, width = (side // scale for side in levels.shape[:2])
    light = decode_levels(levels).reshape(height, scale, width, scale, 3).mean(axis=(1, 3))
    return encode_levels(light)
