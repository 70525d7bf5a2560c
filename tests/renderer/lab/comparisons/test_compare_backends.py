"""`compare backends`: the rows, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from renderer.cli import main
from renderer.content import load_scene, parse_camera_path
from renderer.lab.comparisons.backend_comparison import compare_backends
from renderer.lab.measure.backend_passes import PASSES, BackendPasses
from tests.renderer.conftest import run_with_quick_kernels

SCENE = "city:blocks=6"
ONE_ROW = f"compare backends {SCENE} --passes depth --rounds 1 --backends gl --size 32x32".split()


def compare(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    small = ("--size", "96x64", "--rounds", "2", "--backends", "gl", "--json")
    assert main(["compare", "backends", SCENE, *small, *arguments]) == 0
    report: dict[str, Any] = json.loads(capsys.readouterr().out)
    return report


def test_each_pass_has_a_row_for_each_backend(capsys: pytest.CaptureFixture[str]) -> None:
    report = compare(capsys, "--passes", ",".join(PASSES))
    assert [row["pass"] for row in report["rows"]] == list(PASSES)
    for row in report["rows"]:
        assert set(row) == {"pass", "backend", "milliseconds", "ratio_to_gl", "kernels"}
        assert row["backend"] == "gl"
        assert row["milliseconds"] > 0.0
        assert row["ratio_to_gl"] == 1.0
    assert report["size"] == [96, 64]
    assert report["triangles"] > 1000
    assert list(report["devices"]) == ["gl"]


def test_each_backend_is_compared_with_gl(capsys: pytest.CaptureFixture[str]) -> None:
    report = compare(capsys, "--passes", "depth,queries", "--backends", "cl")
    rows = [(row["pass"], row["backend"]) for row in report["rows"]]
    assert rows == [("depth", "gl"), ("depth", "cl"), ("queries", "gl"), ("queries", "cl")]
    assert all(row["ratio_to_gl"] == 1.0 for row in report["rows"] if row["backend"] == "gl")
    assert all(row["ratio_to_gl"] > 0.0 for row in report["rows"])
    assert list(report["devices"]) == ["gl", "cl"]


def test_rows_of_backends_are_a_table_and_a_chart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chart = tmp_path / "backends.png"
    assert main([*ONE_ROW, "--plot", str(chart)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["pass", "backend", "ms", "ratio", "to", "gl", "kernels"]
    assert lines[2].split()[:2] == ["depth", "gl"]
    assert chart.read_bytes().startswith(b"\x89PNG")


def test_the_depth_pass_draws_the_depth_that_the_lit_pass_draws() -> None:
    scene = load_scene(SCENE)
    camera = parse_camera_path("sky", scene).camera(900)
    with rhi.create_device("gl") as device:
        passes = BackendPasses(device, scene, camera, (96, 64))
        depths = []
        for name in ("depth", "lit", "textured"):
            passes.work(name)(0)
            depths.append(passes.targets.depth.read())
        assert (depths[0] > 0).sum() > 1000
        np.testing.assert_array_equal(depths[0], depths[1])
        np.testing.assert_array_equal(depths[0], depths[2])
        passes.destroy()


def test_queries_count_samples_of_visible_boxes_only() -> None:
    scene = load_scene(SCENE)
    camera = parse_camera_path("ground", scene).camera(900)
    with rhi.create_device("gl") as device:
        passes = BackendPasses(device, scene, camera, (96, 64))
        passes.work("queries")(0)
        answers = passes.count_boxes()
        assert answers == passes.wait_for_boxes()
        assert 0 < sum(count > 0 for count in answers) < len(answers)
        passes.destroy()


def test_rounds_are_those_asked_for() -> None:
    scene = load_scene(SCENE)
    camera = parse_camera_path("ground", scene).camera(0)
    asked: list[str] = []

    def rounds(name: str) -> Sequence[int]:
        asked.append(name)
        return range(1)

    rows = list(compare_backends(scene, camera, ["gl"], ["queries", "depth"], (32, 32), rounds, {}))
    assert asked == ["queries", "depth"]
    assert [row["pass"] for row in rows] == asked


@pytest.mark.parametrize(
    "mode", ["quick", pytest.param("optimised", marks=pytest.mark.nightly)]
)  # in the default run `test_cl_builds`
def test_a_row_says_which_kernels_ran(
    mode: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if mode == "quick":
        options = ("--size", "96x64", "--rounds", "2", "--passes", "depth", "--backends", "gl,cl", "--json")
        rows = json.loads(run_with_quick_kernels(tmp_path, "backends", SCENE, *options).stdout)["rows"]
    else:
        monkeypatch.setenv("RHI_KERNELS", mode)
        rows = compare(capsys, "--passes", "depth", "--backends", "cl")["rows"]
    assert [row["kernels"] for row in rows] == [None, mode]


def test_rows_of_backends_are_markdown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*ONE_ROW, "--markdown"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "| pass | backend | ms | ratio to gl | kernels |"
    assert lines[2].startswith("| depth | gl |")
    assert lines[2].endswith("| 1.00 | - |")
