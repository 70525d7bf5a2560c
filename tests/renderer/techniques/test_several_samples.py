"""Several samples per pixel where lights are listed for cells: pixels against all lights of the scene, and commands."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from frames import count_draws, draw_each, find_difference, list_passes, make_boxes, make_lit_boxes

import rhi
from renderer.content import load_scene
from renderer.scene import scaling, translation
from renderer.techniques import TECHNIQUES, Clustered, Forward, ForwardPlus, Technique, TechniqueSettings

SIZE = (96, 64)
LISTED: tuple[Callable[[int], Technique], ...] = (ForwardPlus, Clustered, partial(Clustered, depth_first=True))


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_the_lists_of_cells_lack_no_light_of_any_sample(drawing_device: rhi.Device, samples: int) -> None:
    if samples not in drawing_device.capabilities.sample_counts:
        pytest.skip(f"sample_counts is {drawing_device.capabilities.sample_counts}")
    scene = load_scene("hall:lights=64,columns=6,flags=2")
    techniques = Forward(), Forward(samples, all_lights=True), *(make(samples) for make in LISTED)
    camera = scene.paths["ground"].camera(100)
    one, wanted, *drawn = draw_each(drawing_device, scene, *techniques, camera=camera, size=SIZE)
    assert (np.abs(wanted - one).max(-1) > 8).sum() > 100  # at edges
    assert [find_difference(picture, wanted) <= 1 for picture in drawn] == [True] * len(LISTED)


def test_what_covers_no_centre_is_lit_by_what_reaches_nothing_else(drawing_device: rhi.Device) -> None:
    """A wire between two columns of centres, of which depth of one sample knows nothing, and a lamp beside it."""
    wall = translation((0, 0, -20)) @ scaling((60, 40, 1))
    builder = make_boxes(scaling((0.1, 20, 0.1)), wall, base_color=(1, 1, 1), specular_color=(0, 0, 0))
    builder.lights.add_point((0.3, 0, 1), 3.0, (1, 1, 1), 4.0)
    techniques = Forward(), Forward(4), *(make(4) for make in LISTED)
    one, wanted, *drawn = draw_each(drawing_device, builder.build(), *techniques, size=SIZE)
    middle = np.s_[SIZE[1] // 2, SIZE[0] // 2 - 1 : SIZE[0] // 2 + 1]
    assert (one == one[:1, :1]).all()
    assert (wanted[middle][..., :3] - one[middle][..., :3] > 20).all()
    assert [find_difference(picture, wanted) <= 1 for picture in drawn] == [True] * len(LISTED)


@pytest.mark.parametrize(
    ("make", "listed"),
    [
        (ForwardPlus, ["depth", "light lists", "depth samples", "forward", "resolve"]),
        (Clustered, ["depth", "light lists", "forward", "resolve"]),
        (partial(Clustered, depth_first=True), ["depth", "light lists", "depth samples", "forward", "resolve"]),
    ],
)
def test_geometry_is_drawn_once_for_culling_and_as_often_as_the_technique_says_with_all_samples(
    null: rhi.Device, make: Callable[[int], Technique], listed: list[str]
) -> None:
    scene, dark = make_lit_boxes(points=2), make_lit_boxes()
    assert list_passes(null, scene, make(4)) == listed
    drawn = len(listed) - len(["light lists", "resolve"])
    assert count_draws(null, scene, make(4)) == (drawn, drawn)
    assert list_passes(null, dark, make(4)) == ["depth", "forward", "resolve"]
    assert "resolve" not in list_passes(null, scene, make(1))


@pytest.mark.parametrize("name", TECHNIQUES)
def test_settings_refuse_samples_that_a_technique_lacks(null: rhi.Device, name: str) -> None:
    assert TechniqueSettings(name).samples == 1
    if name in ("forward", "forward_plus", "clustered"):
        made = TechniqueSettings(name, samples=4).make(load_scene("grid:count=1"), null)
        assert (made.name, vars(made)["samples"]) == (name, 4)
        return
    with pytest.raises(rhi.ValidationError, match="technique-one-sample"):
        TechniqueSettings(name, samples=4)
