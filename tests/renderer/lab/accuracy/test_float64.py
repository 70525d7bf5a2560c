"""Images in float64: what devices draw is near them, and what is wrong is found."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.content import load_scene, parse_camera
from renderer.lab.accuracy.float64 import decode_levels, encode_levels, shade_in_float64
from renderer.lab.accuracy.image_errors import distances_from_depth
from renderer.lab.exam.scenes import make_views
from renderer.scene import Depth
from renderer.settings import RenderSettings
from rhi.shading import Precision
from tests.renderer.conftest import open_device

SETTINGS = RenderSettings().change_all({"technique.name": "forward", "algorithm": "frustum"})
MAX_ERROR = {"cl": 1.0, "gl": 5.0}
"""Levels that an image may be from float64: half a level is rounding, and llvmpipe's pow has few bits."""


@pytest.mark.parametrize("bias", [0.0, -1.25])
@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_exact_shading_is_within_a_level_of_float64_at_each_pixel(backend: str, bias: float) -> None:
    scene, size = load_scene("city:blocks=4"), (96, 54)
    settings = SETTINGS.change_all({"precision": Precision.EXACT, "textures.mip_bias": bias})
    with open_device(backend) as device, settings.open(device, scene, size) as renderer:
        camera = settings.adapt_camera(parse_camera("ground", scene, 600))
        exact = shade_in_float64(renderer, camera, 10.0)
        result = renderer.render(camera, 10.0)
        levels = result.image.read()[..., :3].astype(np.float64)
        away = distances_from_depth(camera, result.depth.read().astype(np.float64))
    seen = exact.objects >= 0
    assert seen.mean() > 0.5
    assert np.abs(levels - exact.levels).max(axis=2)[seen].max() <= MAX_ERROR[backend]
    assert (np.abs(away[seen] / exact.distances[seen] - 1.0) < 3e-4).all()
    moved = np.roll(levels, 1, axis=1)  # the next pixel's light is not within the bound
    assert np.abs(moved - exact.levels).max(axis=2)[seen].max() > MAX_ERROR[backend]


def test_levels_are_srgb_both_ways() -> None:
    levels = np.linspace(0.0, 255.0, 256)
    assert np.allclose(encode_levels(decode_levels(levels)), levels, atol=1e-3)
    assert np.isclose(decode_levels(np.array([188.0])), 0.5, atol=3e-3)


@pytest.mark.parametrize("direction", Depth)
def test_distances_are_those_that_depth_leads_back_to(direction: Depth) -> None:
    scene = load_scene("grid:count=1")
    camera = SETTINGS.change("depth", direction).adapt_camera(next(iter(scene.views.values())))
    point = np.array([1.0, 0.5, -7.0, 1.0])  # 7 m before the eye
    clip = camera.projection.matrix @ point
    assert np.isclose(distances_from_depth(camera, np.array(clip[2] / clip[3])), 7.0)


def test_distances_under_a_parallel_projection_are_along_the_view() -> None:
    scene, camera = make_views()["a parallel projection whose near plane cuts boxes"]
    with open_device("gl") as device, SETTINGS.open(device, scene, (48, 28)) as renderer:
        camera = SETTINGS.adapt_camera(camera)
        exact = shade_in_float64(renderer, camera)
        depth = renderer.render(camera).depth.read().astype(np.float64)
    seen = exact.objects >= 0
    assert seen.any()
    away = distances_from_depth(camera.with_aspect(48 / 28), depth)
    assert np.ptp(exact.distances[seen]) > 1.0
    assert np.allclose(away[seen], exact.distances[seen], atol=1e-4)
