"""`compare deferred-plus`: what its tables hold, and the image of the buffers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from PIL import Image

import rhi
from renderer.content import load_scene
from renderer.inspection.texture_images import color_indices
from renderer.lab.comparisons.deferred_plus_comparison import TECHNIQUES
from renderer.renderer import Renderer
from renderer.techniques import Clustered, Forward
from renderer.visibility import NoCulling, TwoPassCulling
from tests.renderer.conftest import open_device

SMALL = ["--size", "48x32", "--frames", "2", "--backend", "gl"]


@pytest.fixture(scope="module")
def image_and_report(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    path = tmp_path_factory.mktemp("deferred-plus") / "buffers.png"
    arguments = ["hall:lights=4", *SMALL, "--json", "--output", str(path)]
    with open_device("gl"):
        return path, read_report("compare", "deferred-plus", *arguments)


@pytest.fixture(scope="module")
def rows(image_and_report: tuple[Path, dict[str, Any]]) -> dict[tuple[str, bool], dict[str, Any]]:
    return {(row["technique"], row["culling"]): row for row in image_and_report[1]["rows"]}


@pytest.fixture(scope="module")
def culling(image_and_report: tuple[Path, dict[str, Any]]) -> dict[str, Any]:
    report: dict[str, Any] = image_and_report[1]["culling"]
    return report


def test_each_technique_has_a_row_with_culling_and_without(rows: dict[Any, dict[str, Any]]) -> None:
    assert set(rows) == {(name, is_culled) for name in TECHNIQUES for is_culled in (True, False)}
    assert all(row["wrong_pixels"] == 0 for row in rows.values())


def test_rows_have_the_steps_of_their_technique(rows: dict[Any, dict[str, Any]]) -> None:
    assert list(rows["deferred+", True]["steps"]) == ["geometry", "light lists", "shading"]
    assert "rectangles" in rows["deferred+, multi-pass", False]["steps"]
    assert {"bins", "resolve"} <= set(rows["deferred+, binned", True]["steps"])
    assert "depth" in rows["clustered forward, depth first", True]["steps"]


def test_instances_of_both_passes_of_culling_add_up(culling: dict[str, Any]) -> None:
    assert culling["instances"] >= culling["visible"] == culling["first"] + culling["second"] > 0
    assert culling["missed"] == pytest.approx(100.0 * culling["second"] / culling["instances"])
    assert culling["culled"] == pytest.approx(100.0 * (1.0 - culling["visible"] / culling["instances"]))


def test_each_step_of_culling_has_a_time(culling: dict[str, Any]) -> None:
    steps = [
        "likely: test boxes",
        "likely: list draws",
        "missed: test boxes",
        "missed: list draws",
        "remember",
    ]
    assert [name for name in steps if culling["steps"].get(name, 0.0) > 0.0] == steps


def test_the_image_shows_six_buffers(image_and_report: tuple[Path, dict[str, Any]]) -> None:
    with Image.open(image_and_report[0]) as image:
        assert image.size == (3 * 48, 2 * 32)


def test_commands_of_culling_are_timed_step_by_step(gl: rhi.Device) -> None:
    scene = load_scene("hall:lights=0")
    culling = TwoPassCulling(scene, gl)
    with Renderer(gl, scene, visibility=culling, size=(32, 32)) as renderer:
        for is_timed in (True, False, False, True):
            gl.timing = is_timed
            for _ in range(3):
                renderer.render(next(iter(scene.views.values())))
            gl.finish()
            names = [child.name for node in gl.timers for child in node.children] if is_timed else []
            assert names == (["likely", "missed", "remember"] if is_timed else [])
    gl.timing = False
    culling.destroy()


def test_depth_first_changes_no_pixel(gl: rhi.Device) -> None:
    scene = load_scene("hall:lights=8")
    camera = next(iter(scene.views.values()))
    images = []
    with Renderer(gl, scene, visibility=NoCulling(scene), size=(64, 48)) as renderer:
        for renderer.technique in (Forward(), Clustered(), Clustered(depth_first=True)):
            images.append(renderer.render(camera).image.read().astype(int))
        assert [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes] == [
            "depth",
            "light lists",
            "forward",
        ]
    assert (images[1] == images[2]).all()
    assert np.abs(images[0] - images[2]).max() <= 2


def test_neighbouring_materials_have_unlike_colors() -> None:
    colors = color_indices(np.arange(100))
    assert ((colors > 0.2) & (colors < 1.0)).all()
    assert np.abs(np.diff(colors, axis=0)).max(1).min() > 0.2
