"""Comparisons: who runs when, what ratios are to, and what is printed."""

from __future__ import annotations

import json
import os
import time as clock
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.content import load_scene
from renderer.lab import comparison
from renderer.lab.comparison import (
    Frames,
    Record,
    Subject,
    average,
    compare,
    interval,
    median_of,
    rate,
    ratio,
    time,
)
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, PathFrame
from tests.renderer.conftest import open_device, run_with_quick_kernels

COLUMNS: dict[str, comparison.Column] = {"ratio": ratio(), "speed": ratio(inverse=True)}


@pytest.fixture
def ticks(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Clocks that only go on when they are told to; called, it lets seconds pass."""
    now = [0.0]
    for name in ("perf_counter", "process_time"):
        monkeypatch.setattr(import_module("renderer.lab.measure.measurement"), name, lambda: now[0])

    def pass_by(seconds: float) -> None:
        now[0] += seconds

    return pass_by


def test_work_before_a_run_and_between_rounds_is_not_timed(ticks: Callable[[float], None]) -> None:
    def rounds() -> Iterator[int]:
        for number in range(3):
            ticks(100.0)
            yield number
            ticks(100.0)

    def count() -> Mapping[str, int]:
        ticks(100.0)
        return {}

    subject = Subject({}, lambda _: ticks(2.0), before=lambda: ticks(100.0), count=count)
    assert compare([subject], {"ms": time()}, rounds()) == [{"ms": 2000.0}]


def test_ratios_are_to_the_first_subject_with_the_same_cells(ticks: Callable[[float], None]) -> None:
    taken = {("x", 1): 1.0, ("x", 2): 3.0, ("y", 1): 5.0, ("y", 2): 20.0}
    subjects = [
        Subject({"scene": scene, "way": way}, lambda _, seconds=seconds: ticks(seconds))
        for (scene, way), seconds in taken.items()
    ]
    rows = compare(subjects, COLUMNS, range(2), group_by=("scene",))
    assert [(row["ratio"], row["speed"]) for row in rows] == [
        (1.0, 1.0),
        (3.0, 0.333),
        (1.0, 1.0),
        (4.0, 0.25),
    ]
    assert [row["ratio"] for row in compare(subjects, COLUMNS, range(2))] == [1.0, 3.0, 5.0, 20.0]


def test_a_ratio_is_the_median_of_rounds_and_no_quotient_of_medians(ticks: Callable[[float], None]) -> None:
    base, other = (1.0, 10.0, 100.0), (100.0, 20.0, 2.0)
    subjects = [Subject({}, lambda number, of=of: ticks(of[number])) for of in (base, other)]
    columns = {"ms": time(1.0), "ratio": ratio(), "interval": interval(), "per second": rate(40.0)}
    row = compare(subjects, columns, range(3), warm_ups=0)[1]
    assert row["ratio"] == 2.0
    assert row["interval"][0] <= 2.0 <= row["interval"][1]
    assert (row["ms"], row["per second"]) == (20.0, 2.0)
    uneven = [
        Subject({}, lambda number, of=of: ticks(of[number])) for of in ((1.0, 2.0, 9.0), (3.0, 1.0, 9.0))
    ]
    assert compare(uneven, {"ratio": ratio()}, range(3), warm_ups=0)[1]["ratio"] == 1.0  # medians are 2 and 3


def test_a_ratio_of_counts_is_the_median_of_rounds_too() -> None:
    """As of clocks that a subject has of its own; a quotient of medians would be 1.5, and one of means 1."""
    now: list[int] = []
    subjects = [
        Subject({}, now.append, count=lambda of=of: {"seconds": of[now[-1]]})
        for of in ((1.0, 2.0, 9.0), (3.0, 1.0, 8.0), (1.0, 2.0, 9.0))
    ]
    columns = {"seconds": median_of(), "ratio": comparison.count_ratio("seconds")}
    rows = compare(subjects, columns, range(3), warm_ups=0)
    assert [(row["seconds"], row["ratio"]) for row in rows] == [(2.0, 1.0), (3.0, 0.889), (2.0, 1.0)]


def test_counts_are_those_of_timed_runs_and_cells_have_their_order() -> None:
    done: list[int] = []

    def count() -> Mapping[str, int]:
        return {"calls": done[-1]}

    subject = Subject({"name": "a"}, done.append, count=count, summarize=lambda: {"all": len(done)})
    rows = compare([subject], {"calls": average()}, (2, 6), warm_ups=3)
    assert rows == [{"name": "a", "calls": 4, "all": 5}]
    assert list(rows[0]) == ["name", "calls", "all"]
    assert compare([subject], {"calls": comparison.max_size}, (2, 6))[0]["calls"] == 6


Run = Callable[..., Any]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs a benchmark that has these rows, by these arguments, and returns what it prints; RHI_KERNELS is
    what it was at the end."""

    def run(rows: Iterable[Record], *arguments: str, asked: str | None = None, **options_of_run: Any) -> Any:
        monkeypatch.setattr("sys.argv", ["some.py", *arguments])
        monkeypatch.setenv("RHI_KERNELS", asked or "")
        if asked is None:
            monkeypatch.delenv("RHI_KERNELS")
        run_benchmark("Says what it is.", [options.rounds("rounds")], lambda _: rows, **options_of_run)
        return capsys.readouterr()

    return run


@pytest.mark.parametrize("form", ["", "--json", "--markdown"])
def test_a_benchmark_prints_its_rows(form: str, run: Run) -> None:
    rows = compare([Subject({"name": "a"}, clock.sleep)], {"ratio": ratio()}, [0])
    out = run(rows, "--rounds", "1", *form.split()).out
    if form == "--json":
        assert json.loads(out)["rows"] == [{"name": "a", "ratio": 1.0}]
    else:
        parts = out.splitlines()
        assert [
            part.strip(" |").split() for part in (parts[0].replace("|", " "), parts[2].replace("|", " "))
        ] == [
            ["name", "ratio"],
            ["a", "1.00"],
        ]


@pytest.mark.parametrize(
    ("asked", "keywords", "ran"),
    [(None, {}, "optimised"), ("quick", {}, "quick"), (None, {"kernels": ""}, "")],
    ids=["as a long run has them", "as was asked for", "as a first run has them"],
)
def test_a_benchmark_runs_the_kernels_of_a_long_run_or_others_on_demand(
    asked: str | None, keywords: dict[str, str], ran: str, run: Run
) -> None:
    run([{"a": 1}], asked=asked, **keywords)
    assert os.environ["RHI_KERNELS"] == ran


def test_rows_with_other_columns_are_another_table(run: Run) -> None:
    rows = [{"a": 1}, {"a": 2}, {"b": 3, "c": 4}]
    *tables, machine = run(rows, "--markdown").out.split("\n\n")
    assert tables == ["| a |\n| --- |\n| 1 |\n| 2 |", "| b | c |\n| --- | --- |\n| 3 | 4 |"]
    assert machine.startswith("Measured on ")
    assert json.loads(run(rows, "--json").out)["rows"] == rows


class SlowlyBetter:
    """A device whose backend runs quick kernels until `good` runs were done."""

    backend_name = "cl"

    def __init__(self, good: int) -> None:
        self.good, self.runs, self.quick_work = good, 0, 0

    def backend_as(self, kind: type) -> Any:
        return self

    def run(self, _: int) -> None:
        self.runs += 1
        self.quick_work += self.runs <= self.good


@pytest.mark.parametrize(
    ("good", "expected"), [(0, "optimised"), (2, "optimised"), (3, "quick, then optimised"), (9, "quick")]
)
def test_kernels_are_those_of_the_timed_rounds(good: int, expected: str | None) -> None:
    device: Any = SlowlyBetter(good)
    rows = compare([Subject({}, device.run, device=device)], {}, range(3), warm_ups=2)
    assert rows == [{"kernels": expected}]


def test_a_device_without_quick_kernels_says_nothing_of_them() -> None:
    with rhi.create_device("null") as device:
        assert compare([Subject({}, lambda _: None, device=device)], {}, [0]) == [{"kernels": None}]
        assert compare([Subject({}, lambda _: None)], {}, [0]) == [{}]  # nor does one that says no device


def test_frames_say_their_device_and_draw_their_shots_in_turn() -> None:
    scene = load_scene("grid:count=1")
    path_frames = [PathFrame(number, next(iter(scene.views.values()))) for number in (30, 90)]
    seconds: list[float] = []

    class Timed(Renderer):
        def render(self, camera: Camera, seconds_: float = 0.0) -> FrameResult:
            seconds.append(seconds_)
            return super().render(camera, seconds_)

    with rhi.create_device("null") as device, Timed(device, scene, size=(8, 8)) as renderer:
        draw = Frames(renderer, *path_frames)
        (row,) = compare([Subject({}, draw, count=draw.count)], {"draws": average()}, range(3), warm_ups=0)
    assert seconds == [0.5, 1.5, 0.5]
    assert row == {"draws": 1, "kernels": None}


def test_a_device_that_records_keeps_the_commands_of_the_latest_run_only() -> None:
    with rhi.create_device("null") as device:
        lengths: list[int] = []

        def run(_: int) -> None:
            device.buffer(4)
            device.finish()
            lengths.append(len(device.stream))

        compare([Subject({}, run, device=device)], {}, range(4))
        assert lengths == lengths[:1] * 5
        run(0)
        assert lengths[-1] > lengths[0]  # nobody else forgets them


@pytest.mark.nightly_cases(
    "techniques grid --techniques forward --rounds 1 --size 32x18", reason=CHEAPER_TEST
)
@pytest.mark.parametrize(
    "command",
    [
        "techniques grid --techniques forward --rounds 1 --size 32x18",
        "stereo grid --stereo grey --frames 1 --sizes 32x18",
        "visibility grid --algorithms none --frames 1 --size 32x18",
        pytest.param(
            "deferred-plus grid:count=1,lights=0 --frames 1 --size 32x18", marks=pytest.mark.nightly
        ),
    ],
)
def test_each_comparison_says_which_kernels_cl_ran(command: str, tmp_path: Path) -> None:
    with open_device("cl"):  # or the test is skipped
        pass
    ran = run_with_quick_kernels(tmp_path, *command.split(), "--backend", "cl", "--json")
    assert {row["kernels"] for row in json.loads(ran.stdout)["rows"]} == {"quick"}
    assert "RHI_KERNELS=optimised" in ran.stderr


@pytest.mark.parametrize(
    ("ran", "is_noted"), [("quick", True), ("quick, then optimised", True), ("optimised", False)]
)
def test_figures_that_a_long_run_has_not_are_noted(ran: str, is_noted: bool, run: Run) -> None:
    stderr = run([{"a": 1}, {"a": 1, "kernels": ran}, {"a": 2, "kernels": None}]).err
    assert ("quick kernels ran" in stderr) is is_noted
