"""Several samples per pixel where lights are listed for cells: pixels against all lights of the scene, and
commands."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
import pytest
from frames import count_draws, draw, draw_each, list_passes, make_boxes, make_lit_boxes, max_difference
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import rhi
import rhi.shading as sl
from renderer.content import load_scene
from renderer.frame import Blending
from renderer.scene import scaling, translation
from renderer.techniques import (
    TECHNIQUES,
    Clustered,
    ClusteredDeferred,
    DeferredPlus,
    Forward,
    ForwardPlus,
    LightIndexed,
    Technique,
    TechniqueSettings,
    TiledDeferred,
    deferred_by_cells,
    deferred_plus,
)
from renderer.techniques.parts import deferred_lighting, frame_bindings, variants
from renderer.techniques.parts.scene_shader import ForwardShader

SIZE = (96, 64)
DEFERRED: tuple[Callable[[int], Technique], ...] = (TiledDeferred, ClusteredDeferred, DeferredPlus)
CELLS = (ForwardPlus, Clustered, partial(Clustered, depth_first=True), *DEFERRED)
LISTED = (*CELLS, LightIndexed)


@pytest.mark.nightly_cases("cl-2", "cl-4", reason=FEWER_CASES)
@pytest.mark.parametrize("samples", [2, 4, 8])
def test_the_lists_of_cells_lack_no_light_of_any_sample(drawing_device: rhi.Device, samples: int) -> None:
    if samples not in drawing_device.capabilities.sample_counts:
        pytest.skip(f"sample_counts is {drawing_device.capabilities.sample_counts}")
    scene = load_scene("hall:lights=64,columns=6,flags=2")
    techniques = Forward(), Forward(samples, all_lights=True), *(make(samples) for make in CELLS)
    camera = scene.paths["ground"].camera(100)
    one_sample, expected, *drawn = draw_each(drawing_device, scene, *techniques, camera=camera, size=SIZE)
    assert (np.abs(expected - one_sample).max(-1) > 8).sum() > 100  # at edges
    assert [max_difference(image, expected) <= 1 for image in drawn] == [True] * len(CELLS)


@pytest.mark.nightly_cases("cl", reason=FEWER_CASES)
def test_a_wire_between_pixel_centres_is_lit_by_a_light_that_reaches_nothing_else(
    drawing_device: rhi.Device,
) -> None:
    """A wire between two columns of centres, of which depth of one sample knows nothing, and a light beside
    it."""
    wall = translation((0, 0, -20)) @ scaling((60, 40, 1))
    builder = make_boxes(scaling((0.1, 20, 0.1)), wall, base_color=(1, 1, 1), specular_color=(0, 0, 0))
    builder.lights.add_point((0.3, 0, 1), 3.0, (1, 1, 1), 4.0)
    techniques = Forward(), Forward(4), *(make(4) for make in LISTED)
    one_sample, expected, *drawn = draw_each(drawing_device, builder.build(), *techniques, size=SIZE)
    middle = np.s_[SIZE[1] // 2, SIZE[0] // 2 - 1 : SIZE[0] // 2 + 1]
    assert (one_sample == one_sample[:1, :1]).all()
    assert (expected[middle][..., :3] - one_sample[middle][..., :3] > 20).all()
    assert [max_difference(image, expected) <= 1 for image in drawn] == [True] * len(LISTED)


@pytest.mark.parametrize(
    ("make", "listed"),
    [
        (ForwardPlus, ["depth", "light lists", "depth samples", "forward", "resolve"]),
        (Clustered, ["depth", "light lists", "forward", "resolve"]),
        (
            partial(Clustered, depth_first=True),
            ["depth", "light lists", "depth samples", "forward", "resolve"],
        ),
        (TiledDeferred, ["depth", "geometry", "tiles", "resolve"]),
        (ClusteredDeferred, ["depth", "geometry", "light lists", "resolve"]),
        (DeferredPlus, ["depth", "geometry", "light lists", "shading"]),
    ],
)
def test_geometry_is_drawn_once_for_culling_and_as_often_as_the_technique_says_with_all_samples(
    null: rhi.Device, make: Callable[[int], Technique], listed: list[str]
) -> None:
    scene, dark = make_lit_boxes(points=2), make_lit_boxes()
    assert list_passes(null, scene, make(4)) == listed
    not_drawn = ["light lists", "tiles", *(["resolve"] if "forward" in listed else [])]
    drawn = sum(name not in not_drawn for name in listed)
    assert count_draws(null, scene, make(4)) == (drawn, drawn)
    light_passes = ("light lists", "tiles", "depth samples")
    assert list_passes(null, dark, make(4)) == [name for name in listed if name not in light_passes]
    assert len(list_passes(null, scene, make(1))) < len(listed)


@pytest.mark.nightly_cases("cl", reason=FEWER_CASES)
def test_indices_of_lights_hold_for_all_samples_of_a_pixel(drawing_device: rhi.Device) -> None:
    """Pixels with more than 8 lights have the lists of their objects, as in forward shading."""
    scene = load_scene("hall:lights=64,columns=6,flags=2")
    camera = scene.paths["ground"].camera(100)
    techniques = Forward(), Forward(4), LightIndexed(4)
    one_sample, expected, drawn = draw_each(drawing_device, scene, *techniques, camera=camera, size=SIZE)
    assert (np.abs(expected - one_sample).max(-1) > 8).sum() > 100  # at edges
    assert max_difference(drawn, expected) <= 1


def test_indices_of_lights_take_one_draw_beside_those_of_the_scene(null: rhi.Device) -> None:
    scene, dark = make_lit_boxes(points=2), make_lit_boxes()
    passes = ["depth", "light indices", "depth samples", "forward", "resolve"]
    assert list_passes(null, scene, LightIndexed(4)) == passes
    assert count_draws(null, scene, LightIndexed(4)) == (4, 4)
    assert list_passes(null, dark, LightIndexed(4)) == ["depth", "forward", "resolve"]


@pytest.mark.parametrize("name", TECHNIQUES)
def test_settings_refuse_samples_that_a_technique_lacks(null: rhi.Device, name: str) -> None:
    assert TechniqueSettings(name).samples == 1
    if name in (
        "forward",
        "light_indexed",
        "forward_plus",
        "clustered",
        "tiled_deferred",
        "clustered_deferred",
        "deferred_plus",
    ):
        technique = TechniqueSettings(name, samples=4).make(load_scene("grid:count=1"), null)
        assert (technique.name, vars(technique)["samples"]) == (name, 4)
        return
    with pytest.raises(rhi.ValidationError, match="technique-one-sample"):
        TechniqueSettings(name, samples=4)


class CountedColors(sl.Shader):
    """Counts the surfaces that are shaded."""

    shaded: sl.StorageRW[sl.uint]

    def finish(self, color: sl.vec3, position: sl.vec3) -> sl.vec4:
        sl.atomic_add(self.shaded[0], sl.uint(1))
        return super().finish(color, position)  # type: ignore[misc, no-any-return]


def test_pixels_inside_a_triangle_are_shaded_once(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forward shading runs a fragment for each surface of a pixel; none of these is hidden."""
    builder = make_boxes(scaling((5, 5, 5)), base_color=(1, 1, 1))
    builder.lights.add_point((0, 8, 8), 30.0)
    scene, counts = builder.build(), []
    for owner in (deferred_by_cells.SampledTiles, deferred_lighting.SampleMean):
        counting = type(owner.__name__, (CountedColors, owner), {"__module__": __name__})
        for module in (deferred_by_cells, deferred_lighting, deferred_plus):
            monkeypatch.setattr(module, owner.__name__, counting, raising=False)
    with drawing_device.storage(sl.uint, 1) as shaded:
        monkeypatch.setitem(frame_bindings.BINDINGS, "shaded", lambda bindings: shaded)
        monkeypatch.setattr(Forward, "lighting", variants.Lighting(bases=(CountedColors, ForwardShader)))
        for technique in (Forward(4), *(make(4) for make in DEFERRED)):
            shaded.write(np.zeros(1, np.uint32))
            seen = draw(drawing_device, scene, technique, size=SIZE)
            counts.append(int(shaded.read()[0]))
    forward, *deferred = counts
    pixels = int((seen != seen[0, 0]).any(-1).sum())
    assert deferred == [deferred[0]] * len(DEFERRED)
    # Where samples of two surfaces alternate, one of them is shaded again.
    assert 500 < pixels <= deferred[0] <= 1.05 * forward < 1.3 * pixels


AIR: Final = "night:lights=64,blocks=8,fog=0.02,bloom=0.3"
THINGS: Final = "bazaar:instances=300,materials=20,meshes=10,lights=16"


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", [AIR, THINGS, "glass"])
def test_sky_textures_and_weighted_surfaces_are_those_of_forward_shading(
    drawing_device: rhi.Device, name: str
) -> None:
    scene = load_scene(name)
    techniques = Forward(4, all_lights=True), *(make(4) for make in DEFERRED)
    camera = next(iter(scene.paths.values())).camera(100)
    expected, *drawn = draw_each(
        drawing_device, scene, *techniques, camera=camera, size=SIZE, blending=Blending.WEIGHTED
    )
    assert np.ptp(expected[..., :3]) > 50
    # A buffer that rounds how texture coordinates change may choose another mip level; without levels 1 is
    # the most.
    assert [max_difference(image, expected) <= 8 for image in drawn] == [True] * len(DEFERRED)
    assert all(np.mean(np.abs(image - expected).max(-1) > 3) < 1e-3 for image in drawn)
