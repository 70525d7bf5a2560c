"""The commands of the techniques that collect light in buffers, recorded by the null device."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from frames import (
    count_draws,
    first_view_camera,
    list_owned,
    list_passes,
    make_lit_boxes,
    open_renderer,
    record,
)

import rhi
from renderer import techniques
from renderer.content import load_scene
from renderer.scene import Perspective
from renderer.techniques import Deferred, Forward, ForwardMultipass, Inferred, LightPrePass, Technique
from rhi import DepthFunction, DepthWrite, Op

SIZE = (32, 16)
DEFERRED = [Deferred(), Deferred(stencil=True)]
PRE_PASS = [LightPrePass(), LightPrePass(stencil=True), LightPrePass(specular_channels=1)]
STORING = [Deferred, techniques.TiledDeferred, techniques.ClusteredDeferred]
ALL: list[Technique] = [*DEFERRED, *PRE_PASS, Inferred()]


boxes = partial(make_lit_boxes, boxes=2)
"""Makes two boxes in front of the eye, with local lights in view."""


@pytest.mark.parametrize("technique", DEFERRED)
def test_deferred_without_local_lights_draws_geometry_and_one_triangle(
    null: rhi.Device, technique: Technique
) -> None:
    assert list_passes(null, boxes(), technique) == ["geometry", "resolve"]
    assert count_draws(null, boxes(), technique) == (2, 2)


@pytest.mark.parametrize("technique", [LightPrePass(), LightPrePass(specular_channels=1), Inferred()])
def test_a_light_pre_pass_without_local_lights_is_forward_shading(
    null: rhi.Device, technique: Technique
) -> None:
    with rhi.create_device("null") as other:
        expected = record(other, boxes(), Forward())
        stream = record(null, boxes(), technique)
        assert [(c.op, c.values) for c in stream] == [(c.op, c.values) for c in expected]


def test_a_local_light_adds_its_pass_and_one_draw(null: rhi.Device) -> None:
    assert list_passes(null, boxes(1), Deferred()) == ["geometry", "point lights", "resolve"]
    assert count_draws(null, boxes(1), Deferred()) == (3, 3)
    assert list_passes(null, boxes(1), LightPrePass()) == ["normals", "point lights", "materials"]
    assert count_draws(null, boxes(1), LightPrePass()) == (3, 3)
    assert list_passes(null, boxes(1), Inferred()) == ["normals", "downscale", "point lights", "materials"]
    assert count_draws(null, boxes(1), Inferred()) == (4, 4)


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_local_lights_of_a_kind_are_one_draw_and_narrow_and_wide_spots_are_two(
    null: rhi.Device, technique: Technique
) -> None:
    assert count_draws(null, boxes(200), technique) == (3, 3)
    assert (
        count_draws(null, boxes(0, spots=5), technique)
        == count_draws(null, boxes(0, wide=5), technique)
        == (3, 3)
    )
    assert count_draws(null, boxes(0, spots=5, wide=3), technique) == (3, 4)
    assert count_draws(null, boxes(200, spots=5, wide=3), technique) == (4, 5)


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_one_draw_has_an_instance_for_each_local_light(null: rhi.Device, technique: Technique) -> None:
    _, volumes, _ = record(null, boxes(200), technique).draws()
    assert volumes["instances"] == 200


@pytest.mark.parametrize("technique", [Deferred(stencil=True), LightPrePass(stencil=True)])
def test_a_masked_local_light_is_drawn_twice(null: rhi.Device, technique: Technique) -> None:
    assert count_draws(null, boxes(7), technique) == (3, 2 + 2 * 7)
    stream = record(null, boxes(7), technique)
    marking, marked = stream.draws()[1:3]
    assert marking.states[rhi.CullMode] is rhi.CullMode.NONE
    assert set(marking.states[rhi.ColorWrite]) == {rhi.ColorWrite.OFF}
    assert marked.states[rhi.CullMode] is rhi.CullMode.FRONT
    assert marked.states[rhi.DepthTest] is rhi.DepthTest.OFF


@pytest.mark.parametrize(("scale", "size"), [(1.0, (32, 16)), (0.6, (20, 10)), (0.4, (13, 7))])
def test_inferred_light_is_collected_in_smaller_buffers(
    null: rhi.Device, scale: float, size: tuple[int, int]
) -> None:
    stream = record(null, boxes(1), Inferred(scale=scale), size=SIZE)
    sizes = [begin["descriptor"].size for begin in stream.filter(Op.BEGIN_PASS)]
    assert sizes == [SIZE, size, size, SIZE]


def test_a_local_light_that_a_far_plane_cuts_is_not_masked(null: rhi.Device) -> None:
    scene = boxes(7)
    near = scene.views["eye"].with_projection(Perspective(far=10.5))
    far = scene.views["eye"].with_projection(Perspective(far=100.0))
    assert len(record(null, scene, Deferred(stencil=True), near).draws()) == 3
    assert len(record(null, scene, Deferred(stencil=True), far).draws()) == 2 + 2 * 7


@pytest.mark.parametrize("technique", ALL)
def test_a_local_light_out_of_view_costs_nothing(null: rhi.Device, technique: Technique) -> None:
    scene, dark = boxes(0), boxes(0)
    scene.lights.add_point((0, 1, 40), 3.0)
    with rhi.create_device("null") as other:
        expected = record(other, dark, technique)
        assert [(c.op, c.values) for c in record(null, scene, technique)] == [
            (c.op, c.values) for c in expected
        ]


def test_the_second_pass_of_a_light_pre_pass_repeats_the_draws_of_the_first_and_keeps_its_depth(
    null: rhi.Device,
) -> None:
    first, _, second = record(null, boxes(1), LightPrePass()).draws()
    assert first["draws"] == second["draws"] == 32  # two, and draws of nothing
    assert second.states[DepthFunction] is DepthFunction.GREATER_EQUAL
    assert second.states[DepthWrite] is DepthWrite.OFF


@pytest.mark.parametrize(
    ("technique", "text", "lights", "bytes_per_pixel"),
    [
        (Forward(), "boxes", 1, 4 + 4),
        (Deferred(), "boxes", 0, 8 + 4 + 4 + 4),
        (Deferred(), "boxes", 1, 8 + 4 + 4 + 16 + 4),
        (Deferred(light_bits=16), "boxes", 1, 8 + 4 + 4 + 8 + 4),
        (Deferred(normal_bits=8), "boxes", 1, 4 + 4 + 4 + 16 + 4),
        (Deferred(), "city:blocks=4", 1, 8 + 8 + 4 + 16 + 4),
        (techniques.ClusteredDeferred(normal_bits=8), "city:blocks=4", 1, 4 + 8 + 4 + 4),
        (Deferred(stencil=True), "boxes", 1, 8 + 4 + 8 + 16 + 4),
        (LightPrePass(), "boxes", 0, 4 + 4),
        (LightPrePass(), "boxes", 1, 8 + 2 + 4 + 32 + 4),
        (LightPrePass(light_bits=16), "boxes", 1, 8 + 2 + 4 + 16 + 4),
        (LightPrePass(specular_channels=1), "boxes", 1, 8 + 2 + 4 + 16 + 4),
    ],
)
def test_a_pixel_takes_so_many_bytes(
    null: rhi.Device, technique: Technique, text: str, lights: int, bytes_per_pixel: int
) -> None:
    scene = boxes(lights) if text == "boxes" else load_scene(text)
    view = first_view_camera(scene)
    with open_renderer(null, scene, technique) as renderer:
        renderer.render(view)
        _, plan = renderer.plan(view)
    assert plan.count_bytes(SIZE) == bytes_per_pixel * SIZE[0] * SIZE[1]


@pytest.mark.parametrize("technique", [Deferred(), LightPrePass()])
def test_a_second_frame_uploads_the_rows_of_its_local_lights(null: rhi.Device, technique: Technique) -> None:
    scene = boxes(50)
    with open_renderer(null, scene, technique) as renderer:
        renderer.render(scene.views["eye"])
        again = renderer.render(scene.views["eye"]).statistics
    # Passes over the geometry are recorded with their draws.
    assert again.upload_bytes == 50 * np.dtype(np.int32).itemsize


@pytest.mark.parametrize(
    "make",
    [
        *(partial(Inferred, scale=scale) for scale in (0.0, -0.5, 1.001, float("nan"))),
        *(partial(LightPrePass, specular_channels=channels) for channels in (0, 2, 4)),
        *(
            partial(kind, light_bits=bits)
            for kind in (Deferred, LightPrePass, Inferred)
            for bits in (8, 24, 64)
        ),
        *(
            partial(kind, normal_bits=bits)
            for kind in (*STORING, techniques.TechniqueSettings)
            for bits in (7, 12, 24, 16.0)
        ),
        partial(ForwardMultipass, light_bits=16.0),
        partial(techniques.TechniqueSettings, light_bits=8),
    ],
)
def test_a_parameter_out_of_its_range_is_refused(make: Callable[[], Technique]) -> None:
    with pytest.raises(rhi.ValidationError, match="technique-parameter"):
        make()
    assert Inferred(scale=1e-3).scale == 1e-3


@pytest.mark.parametrize("technique", ALL)
def test_a_closed_renderer_destroys_all_that_it_created(null: rhi.Device, technique: Technique) -> None:
    scene = boxes(3, spots=2, wide=1)
    with open_renderer(null, scene, technique) as renderer:
        renderer.render(scene.views["eye"])
    created, left = list_owned(null)
    assert len(created) > 10
    assert left == []
