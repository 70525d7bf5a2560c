"""Techniques that light by cells, in frames whose lists are full: no picture lacks a light."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import EYE, draw, make_boxes, open_renderer, read_colors
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer.lights.culling.grid import LightGrid
from renderer.scene import Scene
from renderer.techniques import TECHNIQUES, AutoTechnique, ForwardPlus

BY_LISTS = ["forward_plus", "clustered", "clustered_deferred", "deferred_plus"]


LAMPS = np.array([0.0, 0.0, 6.0])


def make_crowded(points: int, spots: int) -> Scene:
    """Make a box and lamps each of which reaches every cell: the sum of all of them is not too bright."""
    builder, rng = make_boxes((0, 0, 0), (2, 1, -3)), np.random.default_rng(5)
    for place in rng.uniform(-3.0, 3.0, (points, 3)) + LAMPS:
        builder.lights.add_point(place, 60.0, color=(0.3, 0.2, 0.1), intensity=30.0 / (points + spots))
    for place in rng.uniform(-3.0, 3.0, (spots, 3)) + LAMPS:
        builder.lights.add_spot(
            place, (0, 0, -1), 60.0, 0.5, 1.5, color=(0.1, 0.2, 0.3), intensity=30.0 / (points + spots)
        )
    return builder.build()


@pytest.fixture
def grids(monkeypatch: pytest.MonkeyPatch) -> list[LightGrid]:
    """The grids that made lists."""
    found: list[LightGrid] = []
    prepare = LightGrid.prepare

    def note(self: LightGrid, *args: Any, **options: Any) -> list[Any]:
        found.append(self)
        return list(prepare(self, *args, **options))

    monkeypatch.setattr(LightGrid, "prepare", note)
    return found


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", BY_LISTS)
@pytest.mark.parametrize(("points", "spots"), [(300, 0), (0, 300), (170, 170)])
def test_the_first_picture_is_the_same_as_with_room_for_all(
    device: rhi.Device, grids: list[LightGrid], name: str, points: int, spots: int
) -> None:
    with open_renderer(device, make_crowded(points, spots), TECHNIQUES[name]()) as renderer:
        pictures = []
        for _ in range(5):
            pictures.append(read_colors(renderer.render(EYE)))
            device.finish()
        assert grids[-1].overflows > 0
        assert not grids[-1].read().full.any()
    assert np.ptp(pictures[-1]) > 50
    assert (pictures[0] == pictures[-1]).all()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", [*BY_LISTS, "tiled_deferred", "auto"])
def test_the_first_picture_after_growing_lacks_no_light(device: rhi.Device, name: str) -> None:
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
def test_the_lists_of_few_lamps_are_not_full(device: rhi.Device, grids: list[LightGrid]) -> None:
    draw(device, make_crowded(20, 20), ForwardPlus(), EYE, frames=5)
    assert grids[-1].overflows == 0
