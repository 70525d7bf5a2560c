"""Measurements: the order in which candidates alternate, and the results."""

from __future__ import annotations

import sys

import pytest

from renderer.inspection import FrameCost
from renderer.lab.measure import Measurement, alternate, format_rows, format_table
from renderer.renderer import FrameStatistics


def test_each_round_runs_everything_once_and_starts_with_the_next() -> None:
    order: list[tuple[str, int]] = []
    work = {name: lambda number, name=name: order.append((name, number)) for name in "abc"}
    alternate(work, range(3), warm_ups=0)
    assert order == [(n, i) for i, names in enumerate(("abc", "bca", "cab")) for n in names]


def test_warm_ups_are_not_timed() -> None:
    calls: list[int] = []
    times = alternate({"a": calls.append}, range(4), warm_ups=2)
    assert calls == [0, 0, 0, 1, 2, 3]
    assert len(times["a"].seconds) == 4


def test_processor_time_is_measured_beside_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([0.0, 1.0, 10.0, 13.0, 20.0, 22.0])
    monkeypatch.setattr(sys.modules["renderer.lab.measure.measurement"], "process_time", lambda: next(now))
    measurement = alternate({"a": lambda number: None}, range(3), warm_ups=0)["a"]
    assert measurement.processor_seconds == (1.0, 3.0, 2.0)
    assert measurement.processor_median == 2.0
    assert len(measurement.seconds) == 3


def test_each_run_is_got_ready_for() -> None:
    order: list[str] = []
    work = {name: lambda _, name=name: order.append(name) for name in "ab"}
    alternate(work, range(2), before=lambda name: order.append(f"before {name}"))
    assert order == [entry for name in "ababba" for entry in (f"before {name}", name)]


def test_a_ratio_is_the_median_of_the_rounds_ratios() -> None:
    # The second round was disturbed; its ratio is not.
    fast, slow = Measurement("fast", (1.0, 50.0, 1.0)), Measurement("slow", (2.0, 100.0, 2.2))
    assert slow.compare_to(fast).median == pytest.approx(2.0)
    assert slow.median == 2.2
    fast = Measurement("fast", (9.0, 9.0, 9.0), (1.0, 2.0, 30.0))
    slow = Measurement("slow", (9.0, 9.0, 9.0), (3.0, 6.0, 30.0))
    assert slow.compare_to(fast, processor=True).median == pytest.approx(3.0)


def test_a_summary_has_least_median_and_most_time_and_mean_counters() -> None:
    costs = [
        FrameCost(time, FrameStatistics(triangles, 1, 0, 5, 0, 10, 2, 3))
        for time, triangles in ((3.0, 10), (1.0, 20), (2.0, 31))
    ]
    summary = FrameCost.summarize(costs)
    assert summary["milliseconds"] == {"min": 1.0, "median": 2.0, "max": 3.0}
    assert summary["triangles"] == 20
    assert summary["draws"] == 1


def test_a_table_aligns_text_left_and_numbers_right() -> None:
    table = format_table(["name", "count", "ms"], [["a", 5, 1.5], ["long", 12345, 10.25]])
    assert table.splitlines() == [
        "name   count     ms",
        "----  ------  -----",
        "a          5   1.50",
        "long  12,345  10.25",
    ]


def test_rows_have_titles_and_words() -> None:
    rows = [
        {
            "name": "a",
            "processor_milliseconds": 1.5,
            "software_state_changes": 3,
            "is_masked": True,
            "lights": None,
        },
        {
            "name": "b",
            "processor_milliseconds": 2.5,
            "software_state_changes": 4,
            "is_masked": False,
            "lights": 1024,
        },
    ]
    titles = ["name", "processor ms", "software states", "is masked", "lights"]
    cells = [["a", 1.5, 3, "on", "-"], ["b", 2.5, 4, "off", 1024]]
    for markdown in (False, True):
        assert format_rows(rows, markdown=markdown) == format_table(titles, cells, markdown=markdown)
