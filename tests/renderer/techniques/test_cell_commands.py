"""The commands of the techniques that light tiles and clusters, recorded by the null device."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from frames import make_lit_boxes, open_renderer

import rhi
from renderer.lab.measure.plan_report import describe_plan
from renderer.techniques import (
    Clustered,
    ClusteredDeferred,
    DeferredPlus,
    ForwardPlus,
    Technique,
    TiledDeferred,
)
from renderer.techniques.parts.light_list_reader import CLUSTERS
from rhi import Op

SIZE = (64, 32)
PASSES: dict[str, tuple[Callable[[], Technique], list[str], dict[str, tuple[int, int]]]] = {
    "forward_plus": (ForwardPlus, ["forward"], {"depth": (0, 1), "light lists": (4, 0), "forward": (0, 1)}),
    "clustered": (Clustered, ["forward"], {"light lists": (3, 0), "forward": (0, 1)}),
    "tiled_deferred": (
        TiledDeferred,
        ["geometry", "resolve"],
        {"geometry": (0, 1), "tiles": (1, 0), "resolve": (0, 1)},
    ),
    "clustered_deferred": (
        ClusteredDeferred,
        ["geometry", "resolve"],
        {"geometry": (0, 1), "light lists": (3, 0), "resolve": (0, 1)},
    ),
    "deferred_plus": (
        DeferredPlus,
        ["geometry", "shading"],
        {"geometry": (0, 1), "light lists": (3, 0), "shading": (0, 1)},
    ),
    "deferred_plus, tiles": (
        lambda: DeferredPlus(tiled=True),
        ["geometry", "shading"],
        {"geometry": (0, 1), "light lists": (4, 0), "shading": (0, 1)},
    ),
    "deferred_plus, multi-pass": (
        lambda: DeferredPlus(multi_pass=True),
        ["geometry", "material ids", "rectangles", "shading"],
        {
            "geometry": (0, 1),
            "light lists": (3, 0),
            "material ids": (0, 1),
            "rectangles": (1, 0),
            "shading": (0, 1),
        },
    ),
}
"""Techniques, the passes of a scene without local lights, and of one with them, with their dispatches and
draws."""


@pytest.mark.parametrize("name", PASSES)
@pytest.mark.parametrize(("points", "spots"), [(0, 0), (1, 0), (0, 1), (3, 2)])
def test_lights_to_list_bring_their_passes_and_none_bring_none(name: str, points: int, spots: int) -> None:
    make, without, listed = PASSES[name]
    scene = make_lit_boxes(points, spots)
    report = describe_plan(scene, make(), scene.views["eye"], SIZE)
    assert [measured.name for measured in report.passes] == (list(listed) if points + spots else without)


@pytest.mark.parametrize("name", PASSES)
def test_lists_take_a_few_dispatches_and_objects_a_draw_however_many_lights_there_are(name: str) -> None:
    make, _, listed = PASSES[name]
    for points, spots in ((1, 0), (3, 2), (100, 0)):
        scene = make_lit_boxes(points, spots)
        report = describe_plan(scene, make(), scene.views["eye"], SIZE)
        assert [(measured.dispatches, measured.draws) for measured in report.passes] == list(listed.values())


@pytest.mark.parametrize("name", PASSES)
@pytest.mark.parametrize(("points", "spots"), [(1, 0), (0, 1)])
def test_a_kind_of_light_that_a_scene_lacks_is_not_bound(
    null: rhi.Device, name: str, points: int, spots: int
) -> None:
    make, _, _ = PASSES[name]
    scene = make_lit_boxes(points, spots)
    with open_renderer(null, scene, make(), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        labels = [c["descriptor"].label for c in null.stream.filter(Op.CREATE_BUFFER)]
    assert ("point lights" in labels, "spot lights" in labels) == (bool(points), bool(spots))


def test_clusters_have_room_for_64_lights_each_at_first(null: rhi.Device) -> None:
    scene = make_lit_boxes(1)
    with open_renderer(null, scene, Clustered(), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        grid = renderer._view.workspace(CLUSTERS)
        assert grid.capacity == 64 * grid.cells
