"""`compare techniques`: the rows, the scenes of each number of objects and lights, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import rhi
from renderer.cli import main
from renderer.content import load_scene
from renderer.lab.comparisons.technique_comparison import compare_techniques, vary_scene
from renderer.scene import Scene
from renderer.techniques import TECHNIQUES, Clustered, Deferred, Forward, ForwardMultipass
from rhi import ValidationError

ROW = [
    "technique",
    "objects",
    "lights",
    "milliseconds",
    "processor_milliseconds",
    "kernels",
    "light_evaluations",
    "bytes_per_pixel",
    "draws",
]
GRID = "grid:mesh=box"
SMALL = ("--size", "64x36", "--rounds", "1")


def list_scenes(objects: list[int], lights: list[int]) -> list[Scene]:
    return [load_scene(vary_scene(GRID, count, number)) for count in objects for number in lights]


def compare(capsys: pytest.CaptureFixture[str], scene: str, *arguments: str) -> list[dict[str, Any]]:
    assert main(["compare", "techniques", scene, *SMALL, *arguments, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["size"] == [64, 36]
    rows: list[dict[str, Any]] = report["rows"]
    return rows


def test_there_is_a_row_for_each_number_of_objects_and_lights_and_each_technique(
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = compare(capsys, GRID, "--objects", "1,4", "--lights", "2,8", "--backend", "null")
    assert [(row["objects"], row["lights"], row["technique"]) for row in rows] == [
        (objects, lights, name) for objects in (1, 4) for lights in (2, 8) for name in TECHNIQUES
    ]
    for row in rows:
        assert list(row) == ROW
        assert row["milliseconds"] > 0.0
        assert row["processor_milliseconds"] > 0.0
        assert row["light_evaluations"] is None
    of = {row["technique"]: row for row in rows}
    assert (of["forward"]["bytes_per_pixel"], of["forward"]["draws"]) == (8.0, 1)
    assert (of["deferred"]["bytes_per_pixel"], of["deferred"]["draws"]) == (36.0, 3)


def test_other_ways_of_a_technique_are_compared_beside_the_first(capsys: pytest.CaptureFixture[str]) -> None:
    names = "forward,forward_all_lights,deferred,deferred_stencil"
    rows = compare(
        capsys, GRID, "--objects", "9", "--lights", "6", "--techniques", names, "--backend", "null"
    )
    assert [row["technique"] for row in rows] == names.split(",")
    assert [row["draws"] for row in rows] == [1, 1, 3, 2 + 2 * 6]


def test_draws_are_those_of_the_stream(null: rhi.Device) -> None:
    """A masked light is two draws, besides those of geometry and of the image."""
    techniques = {"masked": Deferred(stencil=True), "at once": Deferred()}
    rows = compare_techniques(null, list_scenes([4], [1, 7]), techniques, (32, 16), rounds=1)
    assert [(row["technique"], row["lights"], row["draws"]) for row in rows] == [
        ("masked", 1, 4),
        ("at once", 1, 3),
        ("masked", 7, 16),
        ("at once", 7, 3),
    ]


def test_forward_looks_at_lights_of_objects_and_clusters_at_those_that_are_near(gl: rhi.Device) -> None:
    techniques = {"objects": Forward(), "pairs": ForwardMultipass(), "clusters": Clustered()}
    rows = list(compare_techniques(gl, list_scenes([64], [8, 64]), techniques, (64, 36), rounds=1))
    few, more = (
        {row["technique"]: row["light_evaluations"] or 0 for row in rows if row["lights"] == n}
        for n in (8, 64)
    )
    assert few["objects"] == few["pairs"] > 0  # boxes that don't hide each other
    assert more["objects"] > 4 * few["objects"]
    assert more["clusters"] > few["clusters"] > 0


def test_a_scene_is_compared_as_it_is_without_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    rows = compare(
        capsys, "hall:columns=6,rows=2,flags=0,detail=3", "--techniques", "deferred", "--backend", "null"
    )
    assert [(row["technique"], row["lights"]) for row in rows] == [("deferred", 10)]


@pytest.mark.parametrize(
    ("text", "objects", "lights", "varied"),
    [
        ("grid", 4, 2, "grid:count=4,lights=2"),
        ("grid:mesh=box", 4, None, "grid:mesh=box,count=4"),
        ("hall", None, 64, "hall:lights=64"),
        ("night:blocks=4", None, 8, "night:blocks=4,lights=8"),
        ("city", None, None, "city"),
        ("a.glb", None, None, "a.glb"),
        ("grid:count=9", None, None, "grid:count=9"),
    ],
)
def test_numbers_are_options_of_the_scene(
    text: str, objects: int | None, lights: int | None, varied: str
) -> None:
    assert vary_scene(text, objects, lights) == varied


@pytest.mark.parametrize(
    ("text", "objects", "lights", "allowed"),
    [
        ("city", None, 4, "hall, grid, night, bazaar, glass, yard"),
        ("hall", 4, None, "grid"),
        ("a.glb", 1, None, "grid"),
    ],
)
def test_a_scene_without_the_varied_number_is_refused_with_the_scenes_that_have_it(
    text: str, objects: int | None, lights: int | None, allowed: str
) -> None:
    with pytest.raises(ValidationError) as refused:
        vary_scene(text, objects, lights)
    assert refused.value.rule.id == "measure-fixed-scene"
    assert refused.value.allowed == allowed


def test_rows_are_a_table_and_a_chart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    chart = tmp_path / "techniques.png"
    numbers = ["--objects", "1,4", "--lights", "1,2", "--techniques", "forward,deferred"]
    assert (
        main(["compare", "techniques", GRID, *SMALL, *numbers, "--backend", "null", "--plot", str(chart)])
        == 0
    )
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:4] == ["technique", "objects", "lights", "ms"]
    assert [line.split()[0] for line in lines[2:-2]] == ["forward", "deferred"] * 4
    assert lines[-1].startswith("Measured on ")
    assert chart.read_bytes().startswith(b"\x89PNG")
