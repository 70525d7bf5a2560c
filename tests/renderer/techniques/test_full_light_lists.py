"""Techniques that light by cells, in frames whose lists are full: no image lacks a light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import EYE, draw, make_boxes, open_renderer, read_colors
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.lights.culling.light_lists import LightLists
from renderer.scene import Scene
from renderer.techniques import TECHNIQUES, AutoTechnique, ForwardPlus

BY_LISTS = ["forward_plus", "clustered", "clustered_deferred", "deferred_plus"]


LIGHTS = np.array([0.0, 0.0, 6.0])


def make_crowded(points: int, spots: int) -> Scene:
    """Make a box and local lights each of which reaches every cell: the sum of all of them is not too
    bright."""
    builder, rng = make_boxes((0, 0, 0), (2, 1, -3)), np.random.default_rng(5)
    for position in rng.uniform(-3.0, 3.0, (points, 3)) + LIGHTS:
        builder.lights.add_point(position, 60.0, color=(0.3, 0.2, 0.1), intensity=30.0 / (points + spots))
    for position in rng.uniform(-3.0, 3.0, (spots, 3)) + LIGHTS:
        builder.lights.add_spot(
            position, (0, 0, -1), 60.0, 0.5, 1.5, color=(0.1, 0.2, 0.3), intensity=30.0 / (points + spots)
        )
    return builder.build()


@pytest.fixture
def grids(monkeypatch: pytest.MonkeyPatch) -> list[LightLists]:
    """The grids that made lists."""
    lists: list[LightLists] = []
    prepare = LightLists.prepare

    def note(self: LightLists, *args: Any, **options: Any) -> list[Any]:
        lists.append(self)
        return list(prepare(self, *args, **options))

    monkeypatch.setattr(LightLists, "prepare", note)
    return lists


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", BY_LISTS)
@pytest.mark.parametrize(("points", "spots"), [(300, 0), (0, 300), (170, 170)])
def test_the_first_image_is_the_same_as_with_room_for_all(
    device: rhi.Device, grids: list[LightLists], name: str, points: int, spots: int
) -> None:
    with open_renderer(device, make_crowded(points, spots), TECHNIQUES[name]()) as renderer:
        images = []
        for _ in range(5):
            images.append(read_colors(renderer.render(EYE)))
            device.finish()
        assert grids[-1].overflows > 0
        assert not grids[-1].read().full.any()
    assert np.ptp(images[-1]) > 50
    assert (images[0] == images[-1]).all()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", [*BY_LISTS, "tiled_deferred", "auto"])
def test_the_first_image_after_growing_lacks_no_light(device: rhi.Device, name: str) -> None:
    scene, size = make_crowded(40, 40), (160, 96)
    expected = draw(device, scene, TECHNIQUES["forward"](), EYE, size=size)
    technique = AutoTechnique(scene, device) if name == "auto" else TECHNIQUES[name]()
    with open_renderer(device, scene, technique, size=(16, 16)) as renderer:
        for _ in range(3):
            renderer.render(EYE)
            device.finish()
        renderer.size = size
        grown = read_colors(renderer.render(EYE))
    assert np.abs(grown - expected).max() <= 2


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_the_lists_of_few_local_lights_are_not_full(device: rhi.Device, grids: list[LightLists]) -> None:
    draw(device, make_crowded(20, 20), ForwardPlus(), EYE, frames=5)
    assert grids[-1].overflows == 0
