"""Images within a budget of memory, compared with frames that have all levels of all images.

A walk passes tiles whose images have a pattern in each level, so that a level that isn't there changes pixels. The
budget is less than a third of what all levels take, and no frame needs more.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.frame import TextureSettings
from renderer.lab.exam.case import CaseResult, Measures, check_early
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, Scene, SceneBuilder, StereoRig, TextureMap
from renderer.stereo import Stereo
from rhi import Device
from rhi.math import multiply, scaling, translation

_SIZE: Final = (72, 48)
_SIDE: Final = 64
_TILES: Final = 12
_MIB: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class StreamedWalk:
    """A walk past tiles: how it is drawn, the stretching of tiles, and whether normal maps and masks are among them."""

    technique: str = "forward"
    stretch: float = 1.0
    has_maps: bool = False
    has_masks: bool = False
    has_stereo: bool = False
    budget: float = 0.3


_WALKS: Final = {
    "drawn forward": StreamedWalk(),
    "materials after geometry, stretched": StreamedWalk("deferred_plus", 3.0),
    "with normal maps": StreamedWalk("clustered_deferred", has_maps=True, budget=0.4),
    "with a mask in each third tile": StreamedWalk(has_masks=True, budget=0.7),
    "two eyes": StreamedWalk("deferred", has_stereo=True),
}


def paint_pattern(seed: int) -> NDArray[np.uint8]:
    """Paint an opaque image of noise of all sizes, so that each of its levels has a pattern."""
    random, image = np.random.default_rng(seed), np.zeros((_SIDE, _SIDE, 4))
    side = 1
    while side <= _SIDE:
        image += np.kron(random.integers(0, 256, (side, side, 4)), np.ones((_SIDE // side, _SIDE // side, 1)))
        side *= 2
    image *= 2.0 / side.bit_length()
    image = np.clip(0.7 * image - 64.0, 0.0, 255.0)
    image[..., 3] = 255.0
    return image.astype(np.uint8)


def make_walk(walk: StreamedWalk) -> tuple[Scene, list[Camera]]:
    """Make a row of boxes with an image each, and cameras that pass them."""
    builder = SceneBuilder("walk")
    box = builder.add_mesh(BUILT_IN["box"](), "box")
    for number in range(_TILES):
        material: dict[str, Any] = {
            "texture": TextureMap(builder.add_image(paint_pattern(number)), scale=(2.0, 2.0))
        }
        if walk.has_maps and number % 2:
            normals = paint_pattern(100 + number)
            normals[..., 2] = 255
            material["normal_texture"] = TextureMap(builder.add_image(normals), scale=(2.0, 2.0))
        if walk.has_masks and not number % 3:
            material |= {"alpha_mode": AlphaMode.MASK, "alpha_cutoff": 0.5}
        size = (walk.stretch, 1.0, 1.0)
        node = builder.add_node(
            multiply(translation((0.3 * (number % 2), 0.0, -6.0 * number)), scaling(size))
        )
        builder.add_objects(node, box, builder.add_material(**material))
    builder.lights.sky = builder.lights.ground = (0.6, 0.6, 0.6)
    builder.lights.add_directional((-0.4, -0.6, -1.0), intensity=0.8)
    eyes = [(0.1, 0.6, 1.0 - 3.4 * step) for step in range(9)]
    return builder.build(), [Camera.look_at(eye, (0.1, 0.0, eye[2] - 4.0)) for eye in eyes]


def draw_walk(device: Device, walk: StreamedWalk, budget: float) -> tuple[list[NDArray[Any]], int, int]:
    """Draw a walk within a budget in bytes, 0 for none; return its images, the most levels that an image lost, and the
    most bytes of images."""
    scene, cameras = make_walk(walk)
    settings = TextureSettings(memory=budget / _MIB)
    images, lost, most = [], 0, 0
    with Renderer(device, scene, technique=walk.technique, size=_SIZE, textures=settings) as renderer:
        if walk.has_stereo:
            renderer.stereo = Stereo(StereoRig(0.1, 4.0), "color")
        for camera in cameras:
            images.append(renderer.render(camera).image.read())
            assert renderer.images is not None
            most = max(most, renderer.images.bytes)
            if renderer.images.stream is not None:
                lost = max(lost, renderer.images.stream.report.lost_levels)
    return images, lost, most


def measure_streaming(device: Device) -> CaseResult:
    """Draw the walks, and count the pixels that differ from those of all levels."""
    wrong: dict[str, int] = {}
    holds: dict[str, bool] = {}
    for name, walk in _WALKS.items():
        expected, _, full = draw_walk(device, walk, 0.0)
        images, lost, most = draw_walk(device, walk, walk.budget * full)
        wrong[f"wrong pixels, {name}"] = sum(
            int((image != other).any(axis=2).sum()) for image, other in zip(images, expected, strict=True)
        )
        holds[f"no level is lost, {name}"] = lost == 0
        holds[f"the budget holds, {name}"] = most <= walk.budget * full
        check_early(holds)
    short, lost, _ = draw_walk(device, _WALKS["drawn forward"], 1.0)
    plain, _, _ = draw_walk(device, _WALKS["drawn forward"], 0.0)
    holds["without memory levels are lost, and shown to be"] = lost > 0
    holds["levels that are lost change pixels"] = any(
        (a != b).any() for a, b in zip(short, plain, strict=True)
    )
    return CaseResult(float(sum(wrong.values())), wrong, holds)


MEASURES: Final[Measures] = {111: measure_streaming}
