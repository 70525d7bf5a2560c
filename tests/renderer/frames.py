"""Frames for tests: small scenes of boxes, and the images, commands and passes of a frame."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.techniques import Technique
from renderer.techniques.parts import variants
from renderer.visibility import find_missing_feature, make_visibility

SIZE = (48, 32)
EYE = Camera.look_at((0, 0, 10), (0, 0, 0))


def make_boxes(*transforms: Any, name: str = "boxes", **material: Any) -> SceneBuilder:
    """Make a box at each of these positions (3,) or transforms (4, 4), all of one material, before `EYE`."""
    builder = SceneBuilder(name)
    mesh, row = builder.add_mesh(BUILT_IN["box"]()), builder.add_material(**material)
    for position in transforms:
        transform = translation(position) if np.ndim(position) == 1 else position
        builder.add_objects(builder.add_node(transform), mesh, row)
    builder.views["eye"] = EYE
    return builder


def make_lit_boxes(points: int = 0, spots: int = 0, *, wide: int = 0, boxes: int = 1) -> Scene:
    """Make boxes in one place before `EYE`, and local lights above them: point lights, spot lights, and wide
    ones."""
    builder = make_boxes(*[(0, 0, 0)] * boxes)
    for number in range(points):
        builder.lights.add_point((0.01 * number, 1.5, 0), 3.0)
    for outer, count in ((0.5, spots), (2.0, wide)):
        for number in range(count):
            builder.lights.add_spot((0.01 * number, 2, 0), (0, -1, 0), 3.0, 0.2, outer)
    return builder.build()


@contextmanager
def open_renderer(
    device: rhi.Device,
    scene: Scene,
    technique: Technique | None = None,
    *,
    visibility: str = "none",
    size: tuple[int, int] = SIZE,
    **options: Any,
) -> Iterator[Renderer]:
    """Yield a renderer that finds visible objects by this algorithm, and destroy both."""
    algorithm = make_visibility(visibility, scene, device)
    with Renderer(device, scene, technique=technique, visibility=algorithm, size=size, **options) as renderer:
        yield renderer
    algorithm.destroy()


def require_algorithm(device: rhi.Device, name: str) -> None:
    """Skip the test if the device can't run this visibility algorithm."""
    if (obstacle := find_missing_feature(name, device)) is not None:
        pytest.skip(obstacle)


def forget_variants() -> None:
    """Clear the cached shaders, so that patches take effect, or end."""
    variants.combine.cache_clear()
    variants.cached_shader_variant.cache_clear()


def first_view_camera(scene: Scene) -> Camera:
    """Return the camera of a scene's first view."""
    return next(iter(scene.views.values()))


def read_colors(result: FrameResult) -> NDArray[Any]:
    """Return the image (h, w, 3) of a frame, 0…255, as numbers that may be subtracted."""
    return result.image.read()[..., :3].astype(int)


def draw(
    device: rhi.Device,
    scene: Scene,
    technique: Technique | None = None,
    camera: Camera | None = None,
    *,
    frames: int = 1,
    **options: Any,
) -> NDArray[Any]:
    """Return the image (h, w, 3) of the scene's first view, or as another camera sees it, after some
    frames."""
    with open_renderer(device, scene, technique, **options) as renderer:
        for _ in range(frames):
            result = renderer.render(camera or first_view_camera(scene))
        return read_colors(result)


def draw_each(
    device: rhi.Device, scene: Scene, *techniques: Technique, camera: Camera | None = None, **options: Any
) -> list[NDArray[Any]]:
    """Return the image (h, w, 4) of each technique, 0…255, drawn by one renderer."""
    images = []
    with open_renderer(device, scene, **options) as renderer:
        for renderer.technique in techniques:
            images.append(renderer.render(camera or first_view_camera(scene)).image.read().astype(int))
    return images


def max_difference(first: NDArray[Any], second: NDArray[Any]) -> int:
    """Return the largest difference of two images."""
    return int(np.abs(first - second).max())


def record(
    device: rhi.Device,
    scene: Scene,
    technique: Technique | None = None,
    camera: Camera | None = None,
    *,
    frames: int = 2,
    **options: Any,
) -> rhi.CommandStream:
    """Return the commands of the last of some frames, of the second as a rule; nothing is destroyed
    afterwards."""
    algorithm = make_visibility(options.pop("visibility", "none"), scene, device)
    arguments = {"technique": technique, "visibility": algorithm, "size": SIZE, **options}
    renderer = Renderer(device, scene, **arguments)
    for _ in range(frames):
        device.stream.clear()
        renderer.render(camera or first_view_camera(scene))
    return device.stream


def count_draws(device: rhi.Device, scene: Scene, *arguments: Any, **options: Any) -> tuple[int, int]:
    """Return the number of render passes and of draw calls in a frame."""
    stream = record(device, scene, *arguments, **options)
    return len(stream.filter(rhi.Op.BEGIN_PASS)), len(stream.draws())


def list_owned(device: rhi.Device) -> tuple[list[rhi.Command], list[rhi.Command]]:
    """Return the commands that made textures, buffers and vertex arrays, without the device's own streams,
    and those of them whose object is still there."""
    device.finish()
    creations = device.stream.filter(
        (rhi.Op.CREATE_TEXTURE, rhi.Op.CREATE_BUFFER, rhi.Op.CREATE_VERTEX_ARRAY),
        where=lambda c: (
            c.failure is None and getattr(c["descriptor"], "usage", None) is not rhi.BufferUsage.STREAM
        ),
    )
    gone = {command.values[0] for command in device.stream.filter(rhi.Op.DESTROY)}
    return [*creations], [command for command in creations if command.values[0] not in gone]


def list_passes(device: rhi.Device, scene: Scene, technique: Technique) -> list[str]:
    """Return the names of a frame's passes."""
    with open_renderer(device, scene, technique) as renderer:
        renderer.render(first_view_camera(scene))
        return [frame_pass.name for frame_pass in renderer.plan(first_view_camera(scene))[1].passes]
