"""Frames for tests: small scenes of boxes, and the pictures, commands and passes of a frame."""

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
from renderer.visibility import find_obstacle, make_visibility

SIZE = (48, 32)
EYE = Camera.look_at((0, 0, 10), (0, 0, 0))


def make_boxes(*places: Any, name: str = "boxes", **material: Any) -> SceneBuilder:
    """Make a box at each of these positions (3,) or transforms (4, 4), all of one material, before `EYE`."""
    builder = SceneBuilder(name)
    mesh, row = builder.add_mesh(BUILT_IN["box"]()), builder.add_material(**material)
    for place in places:
        transform = translation(place) if np.ndim(place) == 1 else place
        builder.add_objects(builder.add_node(transform), mesh, row)
    builder.views["eye"] = EYE
    return builder


def make_lit_boxes(points: int = 0, spots: int = 0, *, wide: int = 0, boxes: int = 1) -> Scene:
    """Make boxes in one place before `EYE`, and lamps above them: point lights, spot lights, and wide ones."""
    builder = make_boxes(*[(0, 0, 0)] * boxes)
    for number in range(points):
        builder.lights.add_point((0.01 * number, 1.5, 0), 3.0)
    for outer, count in ((0.5, spots), (2.0, wide)):
        for number in range(count):
            builder.lights.add_spot((0.01 * number, 2, 0), (0, -1, 0), 3.0, 0.2, outer)
    return builder.build()


@contextmanager
def open_renderer(
    device: rhi.Device, scene: Scene, technique: Technique | None = None,
    *, visibility: str = "none", size: tuple[int, int] = SIZE, **options: Any,
) -> Iterator[Renderer]:  # fmt: skip
    """Yield a renderer that finds visible objects by this algorithm, and destroy both."""
    algorithm = make_visibility(visibility, scene, device)
    with Renderer(device, scene, technique=technique, visibility=algorithm, size=size, **options) as renderer:
        yield renderer
    algorithm.destroy()


def need_algorithm(device: rhi.Device, name: str) -> None:
    """Skip the test if the device can't run this visibility algorithm."""
    if (obstacle := find_obstacle(name, device)) is not None:
        pytest.skip(obstacle)


def forget_variants() -> None:
    """Let shaders be made again: what is patched takes effect, or none any more."""
    variants.combine.cache_clear()
    variants.choose_variant.cache_clear()


def find_eye(scene: Scene) -> Camera:
    """Return the camera of a scene's first view."""
    return next(iter(scene.views.values()))


def read_colors(result: FrameResult) -> NDArray[Any]:
    """Return the picture (h, w, 3) of a frame, 0…255, as numbers that may be subtracted."""
    return result.image.read()[..., :3].astype(int)


def draw(
    device: rhi.Device, scene: Scene, technique: Technique | None = None, camera: Camera | None = None,
    *, frames: int = 1, **options: Any,
) -> NDArray[Any]:  # fmt: skip
    """Return the picture (h, w, 3) of the scene's first view, or as another camera sees it, after some frames."""
    with open_renderer(device, scene, technique, **options) as renderer:
        for _ in range(frames):
            result = renderer.render(camera or find_eye(scene))
        return read_colors(result)


def draw_each(
    device: rhi.Device, scene: Scene, *techniques: Technique, camera: Camera | None = None, **options: Any
) -> list[NDArray[Any]]:
    """Return the image (h, w, 4) of each technique, 0…255, drawn by one renderer."""
    images = []
    with open_renderer(device, scene, **options) as renderer:
        for renderer.technique in techniques:
            images.append(renderer.render(camera or find_eye(scene)).image.read().astype(int))
    return images


def find_difference(one: NDArray[Any], other: NDArray[Any]) -> int:
    """Return how far two pictures are apart where they are farthest."""
    return int(np.abs(one - other).max())


def record(
    device: rhi.Device, scene: Scene, technique: Technique | None = None, camera: Camera | None = None,
    *, frames: int = 2, **options: Any,
) -> rhi.CommandStream:  # fmt: skip
    """Return the commands of the last of some frames, of the second as a rule; nothing is destroyed afterwards."""
    algorithm = make_visibility(options.pop("visibility", "none"), scene, device)
    given = {"technique": technique, "visibility": algorithm, "size": SIZE, **options}
    renderer = Renderer(device, scene, **given)
    for _ in range(frames):
        device.stream.clear()
        renderer.render(camera or find_eye(scene))
    return device.stream


def count_draws(device: rhi.Device, scene: Scene, *given: Any, **options: Any) -> tuple[int, int]:
    """Return the number of render passes and of draw calls in a frame."""
    stream = record(device, scene, *given, **options)
    return len(stream.filter(rhi.Op.BEGIN_PASS)), len(stream.draws())


def list_owned(device: rhi.Device) -> tuple[list[rhi.Command], list[rhi.Command]]:
    """Return the commands that made textures, buffers and vertex arrays, without the device's own streams, and those of
    them whose object is still there."""
    device.finish()
    made = device.stream.filter(
        (rhi.Op.CREATE_TEXTURE, rhi.Op.CREATE_BUFFER, rhi.Op.CREATE_VERTEX_ARRAY),
        where=lambda c: c.failure is None and getattr(c["descriptor"], "usage", None) is not rhi.BufferUsage.STREAM,
    )
    gone = {command.values[0] for command in device.stream.filter(rhi.Op.DESTROY)}
    return [*made], [command for command in made if command.values[0] not in gone]


def list_passes(device: rhi.Device, scene: Scene, technique: Technique) -> list[str]:
    """Return the names of a frame's passes."""
    with open_renderer(device, scene, technique) as renderer:
        renderer.render(find_eye(scene))
        return [one.name for one in renderer.plan(find_eye(scene))[1].passes]
