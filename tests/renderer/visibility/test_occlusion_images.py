"""Every algorithm gives the image that is drawn without culling, to the last pixel."""

from __future__ import annotations

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from occlusion_scenes import SIZE, WAITING, count_wrong_pixels, draw_with, make_boxes, make_camera

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Scene, rotation
from renderer.visibility import ChcPlusPlus, NoCulling, make_visibility


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=8,detail=2")


@pytest.mark.parametrize("name", WAITING)
def test_a_beam_whose_aligned_box_shows_and_whose_own_is_hidden_is_not_drawn(
    gl: rhi.Device, name: str
) -> None:
    # Behind a wall that leans as the beam does, and covers it but for the corners of its aligned box.
    object_positions, sizes = [(0.0, 0.0, -20.0), (0.5, 0.0, -20.5)], [(0.2, 6.0, 12.0), (0.2, 2.0, 8.0)]
    scene = make_boxes(object_positions, sizes, rotations=rotation((0, 1, 0), np.full(2, np.pi / 4)))
    scene.objects.mesh[:] = 0
    camera = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
    algorithm = make_visibility(name, scene, gl)
    assert count_wrong_pixels(gl, scene, algorithm, [(camera, 0.0)] * 30) == [0] * 30
    with Renderer(gl, scene, size=SIZE) as renderer:
        assert draw_with(renderer, algorithm, camera).visible.tolist() == [0]


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.slow
@pytest.mark.parametrize(
    "frames", [range(640, 650, 3), pytest.param(range(640, 700), marks=pytest.mark.nightly)]
)
def test_where_two_surfaces_tie_the_depth_is_the_same(gl: rhi.Device, frames: range) -> None:
    # Of two surfaces at exactly one depth either may show; another depth may not.
    whole = load_scene("city")
    algorithm, none = ChcPlusPlus(whole, gl), NoCulling(whole)
    with Renderer(gl, whole, size=(960, 540)) as renderer:
        for frame in frames:
            camera = whole.paths["sky"].camera(frame)
            expected = draw_with(renderer, none, camera).depth.read()
            assert (draw_with(renderer, algorithm, camera).depth.read() == expected).all()
