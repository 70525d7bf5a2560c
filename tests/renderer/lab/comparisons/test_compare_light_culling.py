"""`compare light-culling`: the rows, what they are compared with, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from frames import first_view_camera, make_boxes
from refusals import refused_rule

import rhi
from renderer.content import load_scene
from renderer.lab.comparisons.light_culling_comparison import (
    choose_lights,
    compare_light_culling,
    lit_cells,
    overlapping_cells,
    surface_ranges,
)
from renderer.lights.culling import SPHERE_TESTS, make_grid
from renderer.lights.culling.volumes import compute_light_volumes
from renderer.renderer import Renderer
from renderer.scene import Camera, Lights, Perspective, scaling, translation
from renderer.visibility import NoCulling
from tests.renderer.conftest import open_device

ROW = [
    "test",
    "cones",
    "depth_mask",
    "pre_filter",
    "lights",
    "pairs",
    "over_exact",
    "missed",
    "tests_made",
    "collect_ms",
    "draw_ms",
    "kernels",
]
HALL = "hall:columns=6,rows=2,flags=0,detail=3"


def compare(*arguments: str) -> list[dict[str, Any]]:
    small = ("--size", "200x120", "--rounds", "1", "--backend", "gl", "--json")
    report = read_report("compare", "light-culling", HALL, *small, *arguments)
    assert (report["size"], report["rounds"]) == ([200, 120], 1)
    rows: list[dict[str, Any]] = report["rows"]
    return rows


@pytest.fixture(scope="module")
def rows() -> list[dict[str, Any]]:
    arguments = ("--lights", "2,3", "--tests", "none,planes,exact", "--pre-filter", "both")
    with open_device("gl"):
        return compare(*arguments)


def test_each_test_has_a_row_for_each_number_of_lights(rows: list[dict[str, Any]]) -> None:
    assert [(row["lights"], row["test"], row["pre_filter"]) for row in rows] == [
        (count, test, on) for count in (2, 3) for test in ("none", "planes", "exact") for on in (True, False)
    ]
    assert all(list(row) == ROW for row in rows)


def test_no_test_misses_a_light(rows: list[dict[str, Any]]) -> None:
    assert [row["missed"] for row in rows] == [0] * len(rows)


def test_each_row_has_its_times(rows: list[dict[str, Any]]) -> None:
    assert all(row["collect_ms"] > 0.0 and row["draw_ms"] > 0.0 for row in rows)


@pytest.mark.parametrize("count", [2, 3])
def test_a_weaker_test_passes_more_pairs(rows: list[dict[str, Any]], count: int) -> None:
    by_test = {(row["test"], row["pre_filter"]): row for row in rows if row["lights"] == count}
    assert by_test["exact", True]["pairs"] == by_test["exact", False]["pairs"] > 0
    assert by_test["exact", True]["over_exact"] == pytest.approx(1.0, abs=0.01)
    assert by_test["planes", False]["pairs"] >= by_test["exact", False]["pairs"]
    assert by_test["none", False]["pairs"] == by_test["none", False]["tests_made"]


def test_tests_of_cones_and_the_depth_mask_drop_lights_that_light_no_pixel(gl: rhi.Device) -> None:
    """A near wall hides the left half of a far one. Of the lights one is at the far wall, one between the
    walls; one shines at the far wall, and one does so beside the view, into which the sphere around its cone
    reaches."""
    size = scaling((20, 40, 0.1))
    builder = make_boxes(translation((-10, 0, -2)) @ size, translation((0, 0, -40)) @ size)
    builder.lights.add_point((0, 0, -39), 2.0)
    builder.lights.add_point((0, 0, -20), 2.0)
    builder.lights.add_spot((0, 0, -38), (0, 0, -1), 4.0, 0.1, 0.3)
    camera = Camera.look_at((0, 0, 0), (0, 0, -1)).with_aspect(1.0)
    edge = 40.0 / camera.projection.matrix[0, 0]
    builder.lights.add_spot((edge + 1.5, 0, -38), (0, 0, -1), 4.0, 0.1, 0.2)
    scene = builder.build()
    with Renderer(gl, scene, size=(32, 32), visibility=NoCulling(scene)) as renderer:
        rows = compare_light_culling(
            renderer,
            camera,
            [4],
            ["exact"],
            tile=32,
            cones=["sphere", "tight"],
            depth_masks=[False, True],
            rounds=1,
        )
    assert [(row["cones"], row["depth_mask"], row["pairs"], row["missed"]) for row in rows] == [
        ("sphere", False, 4, 0),
        ("sphere", True, 3, 0),
        ("tight", False, 3, 0),
        ("tight", True, 2, 0),
    ]


@pytest.mark.usefixtures("gl")
def test_tests_of_cones_and_masks_are_named_on_the_command_line() -> None:
    rows = compare("--lights", "4", "--tests", "none", "--cones", "sphere,planes", "--depth-mask", "both")
    assert [(row["cones"], row["depth_mask"]) for row in rows] == [
        ("sphere", True),
        ("sphere", False),
        ("planes", True),
        ("planes", False),
    ]


def test_the_scene_has_its_own_lights_and_technique_afterwards(gl: rhi.Device) -> None:
    scene = load_scene(HALL)
    lights = scene.lights
    with Renderer(gl, scene, size=(64, 36), visibility=NoCulling(scene)) as renderer:
        technique = renderer.technique
        compare_light_culling(renderer, next(iter(scene.views.values())), [2], ["exact"], tile=16, rounds=1)
        assert scene.lights is lights
        assert renderer.technique is technique


def test_the_lights_of_a_pixel_are_those_whose_range_and_cone_contain_it() -> None:
    projection = Perspective(far=50.0)
    lights, camera = Lights(), Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection)
    grid = make_grid(projection, (4, 4), 2)
    depth = np.full((4, 4), (projection.matrix[2, 2] * -10.0 + projection.matrix[2, 3]) / 10.0, np.float32)
    depth[:2, :2] = 0.0
    lights.add_point((0, 0, -10), 100.0)
    lights.add_point((0, 0, -20), 9.9)
    lights.add_spot((-20, -20, -10), (1, 0, 0), 100.0, 0.1, 0.2)
    lights.add_spot((0, 0, -5), (0, 0, -1), 100.0, 0.1, 1.5)
    lights.add_spot((0, 0, -5), (0, 0, 1), 100.0, 0.1, 1.5)
    is_lit = lit_cells(grid, camera, lights, depth)
    assert is_lit.tolist() == [[False] * 5, *[[True, False, False, True, False]] * 3]


def test_a_light_that_is_left_out_is_missed(gl: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the device is given smaller ranges."""
    scene = load_scene(HALL)
    camera = next(iter(scene.views.values()))
    with Renderer(gl, scene, size=(200, 120), visibility=NoCulling(scene)) as renderer:
        (right,) = compare_light_culling(renderer, camera, [3], ["exact"], tile=16, rounds=1)
        monkeypatch.setattr(
            "renderer.lights.culling.uploads.compute_light_volumes",
            lambda *arguments: shrink(compute_light_volumes(*arguments)),
        )
        (wrong,) = compare_light_culling(renderer, camera, [3], ["exact"], tile=16, rounds=1)
    assert right["missed"] == 0
    assert wrong["missed"] == right["pairs"] - wrong["pairs"] > 0
    assert wrong["over_exact"] < right["over_exact"]


def shrink(volumes: Any) -> Any:
    volumes.spheres[:, 3] *= 0.8
    return volumes


def test_lights_are_selected_from_all_and_more_include_fewer() -> None:
    lights = Lights()
    for x in range(60):
        lights.add_point((x, 0.0, 0.0), 1.0)
    for x in range(40):
        lights.add_spot((x, 1.0, 0.0), (0, 1, 0), 1.0, 0.1, 0.2)
    few, more, everything = (choose_lights(lights, count) for count in (10, 50, 100))
    assert len(few) == 10
    assert len(few.point) > 2
    assert len(few.spot) > 2
    assert set(few.point["position"][:, 0]) <= set(more.point["position"][:, 0])
    assert (everything.point == lights.point).all()
    assert (everything.spot == lights.spot).all()
    assert refused_rule(lambda: choose_lights(lights, 101)) == "measure-too-few-lights"


def test_surfaces_of_tiles_are_those_of_their_pixels() -> None:
    projection = Perspective(far=50.0)
    grid = make_grid(projection, (5, 3), 2)
    z = np.arange(1.0, 16.0).reshape(3, 5)
    depth = (projection.matrix[2, 2] * -z + projection.matrix[2, 3]) / z
    depth[:2, :2] = 0.0
    near, far = surface_ranges(grid, depth)
    assert np.allclose(near, [[np.inf, 3, 5], [11, 13, 15]])
    assert np.allclose(far, [[-np.inf, 9, 10], [12, 14, 15]])


def test_lights_overlap_the_cells_of_every_slice_that_they_reach() -> None:
    projection = Perspective(far=50.0)
    lights, camera = Lights(), Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection)
    lights.add_point((0, 0, -10), 1.0)
    lights.add_point((0, 0, -40), 1.0)
    lights.add_spot((0, 0, 2), (0, 0, 1), 2.5, 0.1, 3.0)
    grid = make_grid(projection, (64, 64), 64, slices=4)
    depth = np.linspace(0.0001, 1.0, 64 * 64).reshape(64, 64)
    overlaps = overlapping_cells(grid, compute_light_volumes(lights, camera), depth)
    # Slices begin at 0.1, 0.47, 2.2 and 10.6 metres.
    assert overlaps.tolist() == [
        [False, False, True],
        [False, False, True],
        [True, False, False],
        [True, True, False],
    ]


def test_a_device_that_draws_nothing_has_no_surfaces(null: rhi.Device) -> None:
    scene = load_scene(HALL)
    with Renderer(null, scene, visibility=NoCulling(scene)) as renderer:
        arguments = renderer, first_view_camera(scene), [1], list(SPHERE_TESTS)
        assert refused_rule(lambda: compare_light_culling(*arguments, tile=8)) == "measure-no-rendering"
