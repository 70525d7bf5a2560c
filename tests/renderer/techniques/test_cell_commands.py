"""The commands of the techniques that light tiles and clusters, recorded by the null device."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from frames import make_lit_boxes, open_renderer

import rhi
from renderer.lab.measure.plans import describe_plan
from renderer.techniques import Clustered, ClusteredDeferred, DeferredPlus, ForwardPlus, Technique, TiledDeferred
from renderer.techniques.parts.cell_lists import CLUSTERS
from rhi import Op

SIZE = (64, 32)
PASSES: dict[str, tuple[Callable[[], Technique], list[str], list[str]]] = {
    "forward_plus": (ForwardPlus, ["forward"], ["depth", "light lists", "forward"]),
    "clustered": (Clustered, ["forward"], ["light lists", "forward"]),
    "tiled_deferred": (TiledDeferred, ["geometry", "resolve"], ["geometry", "tiles", "resolve"]),
    "clustered_deferred": (
        ClusteredDeferred,
        ["geometry", "resolve"],
        ["geometry", "light lists", "resolve"],
    ),
    "deferred_plus": (DeferredPlus, ["geometry", "shading"], ["geometry", "light lists", "shading"]),
    "deferred_plus, multi-pass": (
        lambda: DeferredPlus(multi_pass=True),
        ["geometry", "material ids", "rectangles", "shading"],
        ["geometry", "light lists", "material ids", "rectangles", "shading"],
    ),
}


@pytest.mark.parametrize("name", PASSES)
@pytest.mark.parametrize(("points", "spots"), [(0, 0), (1, 0), (0, 1), (3, 2)])
def test_lights_to_list_bring_their_passes_and_none_bring_none(name: str, points: int, spots: int) -> None:
    make, without, listed = PASSES[name]
    scene = make_lit_boxes(points, spots)
    report = describe_plan(scene, make(), scene.views["eye"], SIZE)
    assert [one.name for one in report.passes] == (listed if points + spots else without)


@pytest.mark.parametrize(
    ("name", "dispatches"),
    [
        ("forward_plus", [0, 4, 0]),
        ("clustered", [3, 0]),
        ("tiled_deferred", [0, 1, 0]),
        ("clustered_deferred", [0, 3, 0]),
        ("deferred_plus", [0, 3, 0]),
        ("deferred_plus, multi-pass", [0, 3, 0, 1, 0]),
    ],
)
def test_lists_take_a_few_dispatches_however_many_lights_there_are(name: str, dispatches: list[int]) -> None:
    make, _, _ = PASSES[name]
    for points in (1, 100):
        scene = make_lit_boxes(points)
        report = describe_plan(scene, make(), scene.views["eye"], SIZE)
        assert [one.dispatches for one in report.passes] == dispatches


@pytest.mark.parametrize("name", PASSES)
@pytest.mark.parametrize(("points", "spots"), [(1, 0), (0, 1)])
def test_a_kind_of_light_that_a_scene_lacks_is_not_bound(null: rhi.Device, name: str, points: int, spots: int) -> None:
    make, _, _ = PASSES[name]
    scene = make_lit_boxes(points, spots)
    with open_renderer(null, scene, make(), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        labels = [c["descriptor"].label for c in null.stream.filter(Op.CREATE_BUFFER)]
    assert ("point lights" in labels, "spot lights" in labels) == (bool(points), bool(spots))


def test_a_geometry_pass_is_drawn_once(null: rhi.Device) -> None:
    scene = make_lit_boxes(3, 2)
    counts = {}
    for name, (make, _, _) in PASSES.items():
        report = describe_plan(scene, make(), scene.views["eye"], SIZE)
        counts[name] = [one.draws for one in report.passes]
    assert counts == {
        "forward_plus": [1, 0, 1],
        "clustered": [0, 1],
        "tiled_deferred": [1, 0, 1],
        "clustered_deferred": [1, 0, 1],
        "deferred_plus": [1, 0, 1],
        "deferred_plus, multi-pass": [1, 0, 1, 0, 1],
    }


def test_clusters_have_room_for_64_lights_each_at_first(null: rhi.Device) -> None:
    scene = make_lit_boxes(1)
    with open_renderer(null, scene, Clustered(), size=SIZE) as renderer:
        renderer.render(scene.views["eye"])
        grid = renderer._view.workspace(CLUSTERS)
        assert grid.capacity == 64 * grid.cells
