"""Images of a few pixels show the same with each algorithm as without culling: there a fraction of a pixel, by which
rasterising moves vertices, is a large part of the view."""

from __future__ import annotations

import numpy as np
import pytest
from nightly_reasons import COVERED_ON_GL
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling, translation
from renderer.techniques import Forward
from renderer.visibility import ALGORITHMS, find_missing_feature
from rhi.math import multiply
from tests.renderer.conftest import open_device

EYE = Camera.look_at((0.3, 2.0, 6.0), (0.0, 0.8, 0.0))
FRAMES = 5
"""Answers to the first queries are used from the third frame on."""
BOXES = (
    ((0.0, -0.5, 0.0), (8.0, 1.0, 8.0), (1.0, 0.0, 0.0)),
    ((0.0, 2.0, -4.0), (8.0, 4.0, 0.5), (0.0, 1.0, 0.0)),
    ((0.0, 0.6, 1.0), (0.4, 0.4, 0.4), (0.0, 0.0, 1.0)),
)
"""Position, size and colour of a floor, a wall and a small box."""


def make_scene() -> Scene:
    builder = SceneBuilder("small images")
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    mesh = builder.add_mesh(BUILT_IN["box"]())
    for position, size, color in BOXES:
        material = builder.add_material(base_color=(0.0, 0.0, 0.0, 1.0), emissive=color)
        node = builder.add_node(multiply(translation(position), scaling(size)))
        builder.add_objects(node, mesh, material)
    return builder.build()


def draw(device: rhi.Device, algorithm: str, size: tuple[int, int], samples: int) -> NDArray[np.uint8]:
    """Draw frames of a standing camera, and return their images (frames, h, w, 3)."""
    camera = EYE.with_aspect(size[0] / size[1])
    technique = Forward(samples=samples)
    with Renderer(device, make_scene(), size=size, technique=technique, visibility=algorithm) as renderer:
        return np.stack([renderer.render(camera).image.read()[..., :3] for _ in range(FRAMES)])


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=COVERED_ON_GL)
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("size", [(1, 1), (1, 40), (5, 3)], ids=str)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_each_algorithm_shows_all_that_few_pixels_show(
    backend: str, size: tuple[int, int], samples: int
) -> None:
    with open_device(backend) as device:
        expected = draw(device, "none", size, samples)
        for algorithm in ALGORITHMS:
            if find_missing_feature(algorithm, device) is None and algorithm != "none":
                images = draw(device, algorithm, size, samples)
                assert np.array_equal(images, expected), algorithm
    assert (expected == expected[0]).all()
    assert expected.max() > 60, "control: an object is visible"
