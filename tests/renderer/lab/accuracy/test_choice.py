"""Settings that are chosen: steps along the quality settings, the front, the check, and the files that keep
them."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_reports import read_report
from nightly_reasons import CHEAPER_TEST

import rhi
from renderer.cli import main
from renderer.cli.accuracy import describe_left_out, load_values_in_use
from renderer.cli.output import OutputError
from renderer.content import load_scene
from renderer.lab.accuracy import (
    ParetoPoint,
    SettingReport,
    SweepJob,
    SweepSetup,
    ValueRow,
    bench,
    choice,
    choose,
    compute_pareto_front,
    jobs,
    keep_references,
    load_or_compute_pareto_front,
    run_jobs,
    sweep_setting,
)
from renderer.lab.accuracy.choice import (
    CombinationBench,
    FrameError,
    expect_error,
    expect_least,
    list_held_out,
    mark_best,
    order_by_speed,
    select_effective_reports,
)
from renderer.lab.accuracy.jobs import list_jobs, load_sample, order_jobs, save_sample
from renderer.lab.accuracy.quality_settings import RAY_TRACED
from renderer.lab.accuracy.race import SettingsTrial
from renderer.lab.accuracy.sweep import SettingSample, SweepShard, ValueSample, list_views
from renderer.lab.measure.disturbance import Instant
from renderer.lab.measure.measurement import Interval
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.scene import PathFrame
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter
from rhi import ValidationError
from rhi_screen.executors import SerialExecutor, make_executor
from tests.renderer.conftest import open_device

SETUP = SweepSetup("city:blocks=2,shadows=1", backend="gl", size=(48, 28), views=2, rounds=2)


def make_report(setting: str, *rows: tuple[str, float, float]) -> SettingReport:
    """Make a report of values with a mean error and a time."""
    value_rows = [
        ValueRow(
            setting,
            value,
            False,
            "levels",
            2.0 * error,
            error,
            None,
            1.0,
            time,
            time,
            time,
            1.0,
            time,
            time,
            time,
        )
        for value, error, time in rows
    ]
    return SettingReport(setting, "gl", "a device", tuple(value_rows))


def make_point(error: float, milliseconds: float) -> ParetoPoint:
    """Make a point whose most accurate settings take 1 ms."""
    return ParetoPoint({}, RenderSettings(), error, error, milliseconds, *(milliseconds,) * 3)


def test_each_step_saves_the_most_time_for_its_error() -> None:
    reports = {
        "shadow_size": make_report("shadow_size", ("512", 4.0, 0.4), ("1024", 1.0, 0.5), ("2048", 0.0, 1.0)),
        "fxaa": make_report("fxaa", ("off", 3.0, 0.9), ("on", 2.0, 1.0)),
        "precision": make_report(
            "precision", ("fast", 0.5, 1.1), ("exact", 0.0, 1.0)
        ),  # not faster: never taken
    }
    steps = [(step["shadow_size"], step["fxaa"], step["precision"]) for step in choice.list_steps(reports)]
    assert steps == [
        ("2048", "on", "exact"),
        ("1024", "on", "exact"),
        ("1024", "off", "exact"),
        ("512", "off", "exact"),
    ]


def test_flicker_orders_texture_filters_as_an_eye_does() -> None:
    """The figures are those of a walk through a city, at 240 × 135 and with FXAA."""
    report = make_report("texture_filter", ("bilinear, no mip levels", 3.63, 0.79), ("trilinear", 5.07, 0.83))
    rows = tuple(
        replace(row, flicker=flicker) for row, flicker in zip(report.rows, (3.13, 2.45), strict=True)
    )
    reports = {"texture_filter": replace(report, rows=rows)}
    assert choice.list_steps(reports)[0] == {"texture_filter": "trilinear"}
    assert choice.list_steps(reports, 0.0)[0] == {"texture_filter": "bilinear, no mip levels"}


def test_textures_without_mip_levels_flicker_in_motion(gl: rhi.Device) -> None:
    setup = replace(SETUP, size=(96, 54), views=1)
    scene = load_scene(setup.scene)
    frames = list_views(scene, setup)
    filters = ("bilinear, no mip levels", "trilinear")
    errors = {}
    for weight in (3.0, 0.0):
        bench_setup = replace(setup, flicker_weight=weight)
        with CombinationBench(gl, scene, bench_setup, ["texture_filter"], 400) as bench:
            for name in filters:
                settings = choice.combine(choice.make_plain(setup.settings), {"texture_filter": name})
                (errors[name, weight],) = bench.compare(settings, frames)
                assert len(bench.references) == (2 if weight else 1)  # nothing else is traced
    flickers = [errors[name, 3.0].flicker for name in filters]
    assert flickers[0] > 1.2 * flickers[1] > 0.0
    for name in filters:
        moving, still = errors[name, 3.0], errors[name, 0.0]
        assert moving.total == pytest.approx(moving.still + 3.0 * moving.flicker)
        assert (still.flicker, still.total) == (0.0, still.still)
        assert still.still == pytest.approx(moving.still)


def test_the_pareto_front_has_the_points_that_no_point_dominates() -> None:
    measured = ((0.0, 9.0), (1.0, 9.5), (1.0, 5.0), (2.0, 5.0), (3.0, 1.0))
    points = mark_best([make_point(error, milliseconds) for error, milliseconds in measured])
    assert [point.is_best for point in points] == [True, False, True, False, True]


def test_only_settings_that_change_an_image_of_the_scene_are_combined() -> None:
    names = ("precision", "shadow_size", "inferred_scale", "second_eye", "query_batch", "normal_bits")
    reports = [make_report(name, ("a", 1.0, 1.0)) for name in names]
    lit, dark = load_scene("city:blocks=2,shadows=1"), load_scene("city:blocks=2")
    assert set(select_effective_reports(lit, RenderSettings(), reports)) == {"precision", "shadow_size"}
    assert set(select_effective_reports(dark, RenderSettings(), reports)) == {"precision"}
    inferred = RenderSettings().change("technique.name", "inferred")
    assert set(select_effective_reports(dark, inferred, reports)) == {"inferred_scale"}


def test_the_common_reference_has_the_settings_that_each_reference_requires() -> None:
    reference, scale = choice.combine_references(RenderSettings(), ["precision", "samples", "shadow_filter"])
    assert (reference.shadows.cascade_size, reference.shadows.filter) == (2048, ShadowFilter.SMOOTH)
    assert (reference.precision.value, reference.technique.samples, scale) == ("exact", 1, 4)


def test_combinations_are_compared_with_the_ray_tracer_and_not_with_the_device(null: rhi.Device) -> None:
    scene = load_scene(SETUP.scene)
    with CombinationBench(null, scene, SETUP, ["fxaa"]) as bench:
        (error,) = bench.compare(RenderSettings(algorithm="none"), list_views(scene, SETUP)[:1])
    assert error.still > 50.0  # its image is black


def test_held_out_views_differ_from_the_views_of_the_front() -> None:
    scene = load_scene("city:blocks=2")
    front_views = list_views(scene, SETUP)
    checks = list_held_out(scene, SETUP, 10, front_views)
    others = list_held_out(scene, SETUP, 20, [*front_views, *checks])
    numbers = [{frame.number for frame in frames} for frames in (front_views, checks, others)]
    assert [len(frames) for frames in numbers] == [2, 10, 20]
    assert len(set().union(*numbers)) == 32
    still = replace(SETUP, camera="street")
    assert [frame.number for frame in list_held_out(scene, still, 20, list_views(scene, still))] == [0]


def test_more_is_expected_of_other_views_than_the_mean() -> None:
    assert expect_error([1.0, 2.0, 3.0]) == pytest.approx(2.0 + 4.0)
    assert expect_error([2.0] * 9) == 2.0
    assert expect_error([0.0] * 999 + [9.0]) == 9.0  # the greatest is known to be possible
    assert expect_error([4.0]) == 4.0


@pytest.mark.parametrize("seed", range(20))
def test_the_first_errors_bound_the_expected_error(seed: int) -> None:
    """Brute force over the other errors: equal ones, on a grid, and random ones."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 12))
    errors = rng.gamma(2.0, 3.0, int(rng.integers(1, count + 1))).tolist()
    others = count - len(errors)
    least = expect_least(errors, count)
    equal = min(expect_error(errors + [other] * others) for other in np.linspace(0.0, max(errors), 2000))
    mixed = min(expect_error(errors + rng.gamma(2.0, 3.0, others).tolist()) for _ in range(200))
    assert least <= mixed + 1e-9
    assert equal - 0.02 <= least <= equal + 1e-9


def test_a_check_ends_once_errors_differ_too_much(monkeypatch: pytest.MonkeyPatch) -> None:
    """No view is beyond the bound, and the mean with its margin is, whatever the last views show."""
    errors_by_view = [3.0, 0.1, 3.0, 0.1, 3.0, 0.1, 3.0, 0.1, 3.0, 0.1]
    drawn: list[int] = []

    def draw_views(_: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> Any:
        for error, frame in zip(errors_by_view, frames, strict=True):
            drawn.append(frame.number)
            yield still_errors([error])[0], [1e-3]

    bench_type = make_bench(lambda *_: [])
    bench_type.draw_views = draw_views
    monkeypatch.setattr(choice, "CombinationBench", bench_type)
    with pytest.raises(ValidationError, match="expected from the views of the check"):
        choose(replace(SETUP, backend="null"), [make_point(1.0, 1.0)], max_error=4.0)
    assert expect_error(errors_by_view) > 4.0
    assert 1 < len(drawn) < 10


@pytest.mark.parametrize(("noise", "rounds"), [(0.001, 1), (0.4, 8)])
def test_times_that_are_known_well_enough_are_measured_no_more(
    monkeypatch: pytest.MonkeyPatch, noise: float, rounds: int
) -> None:
    rng = np.random.default_rng(1)
    drawn = Counter[str]()

    class Drawer:
        _rounds = range(16)
        exchange = staticmethod(lambda settings: None)

        def draw(self, _: object, settings: Any, frame: object) -> None:
            drawn[settings] += 1
            clock[0] += (0.02 if settings == "fast" else 0.04) * float(np.exp(noise * rng.normal()))

    clock = [0.0]
    monkeypatch.setattr(choice.Instant, "now", staticmethod(lambda: Instant(clock[0], clock[0], 0.0)))
    trials = [
        SettingsTrial({"a": name}, (error,), np.full(6, seconds) * np.exp(noise * rng.normal(size=6)))
        for name, error, seconds in (("best", 0.5, 0.04), ("fast", 1.0, 0.02))
    ]
    times = CombinationBench.time(Drawer(), trials, ["best", "fast"], [0, 1], lambda rounds: rounds)  # type: ignore[arg-type, list-item]
    assert [len(series) for series in times] == [2 * rounds, 2 * rounds]


def make_bench(compare: Callable[..., Any], **methods: Callable[..., Any]) -> type[Any]:
    """Make a bench that says what it would measure."""
    nothing = {"__init__": lambda *_: None, "__enter__": lambda self: self, "__exit__": lambda *_: None}

    def draw_views(self: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> Any:
        for error in compare(self, settings, frames):
            yield error, [1e-3]

    return type("SaidBench", (), nothing | methods | {"compare": compare, "draw_views": draw_views})


def still_errors(errors: Iterable[float]) -> list[FrameError]:
    """Errors of frames that don't flicker."""
    return [FrameError(error, 0.0, error) for error in errors]


def test_a_choice_keeps_its_bound_with_a_margin(monkeypatch: pytest.MonkeyPatch) -> None:
    cheap, dear = mark_best([make_point(1.0, 1.0), make_point(0.5, 2.0)])
    drawn: list[int] = []

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        drawn.extend(frame.number for frame in frames)
        spread = 1.0 if settings is cheap.settings else 0.1
        return still_errors(1.0 + spread * (number % 2) for number in range(len(frames)))

    monkeypatch.setattr(choice, "CombinationBench", make_bench(compare))
    checked = choose(replace(SETUP, backend="null"), [cheap, dear], max_error=3.0)
    assert (checked.point, checked.rejected, checked.error, checked.held_out_error) == (dear, 1, 1.1, 1.1)
    assert (checked.views, checked.held_out_views) == (10, 20)
    assert len(drawn) == 10 + 10 + 20
    assert len(set(drawn)) == 30
    checked = choose(replace(SETUP, backend="null"), [cheap, dear], max_error=4.0)
    assert (checked.point, checked.rejected) == (cheap, 0)
    assert checked.expected == pytest.approx(1.5 + 4.0 * np.std([1.0, 2.0] * 5, ddof=1))


@pytest.mark.parametrize(("slower", "expected"), [(0.0, 1), (0.1, 0)])
def test_a_time_budget_is_met_if_the_median_frame_of_a_walk_meets_it(
    slower: float, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    points = [replace(make_point(error, ms), low=0.5 * ms) for error, ms in ((2.0, 8.0), (1.0, 18.0))]

    def walk(_: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> list[Instant]:
        times = np.where(np.arange(len(frames)) < 3, 20.0, 5.0)
        taken = times if settings is points[0].settings else 2.0 * times + slower
        return [Instant(2e-3 * float(ms), 1e-3, 1e-3) for ms in taken]  # threads waited half of the time

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        return still_errors([1.0] * len(frames))

    bench_type = make_bench(compare, walk=walk)
    monkeypatch.setattr(choice, "CombinationBench", bench_type)
    checked = choose(
        replace(SETUP, backend="null"), points, budget_ms=10.0
    )  # 18 ms may be 9, by their interval
    assert (checked.point, checked.rejected, checked.over_budget) == (points[expected], 1 - expected, 0.3)
    with pytest.raises(rhi.ValidationError, match="5 ms, the median of 10 frames of a walk"):
        choose(replace(SETUP, backend="null"), points, budget_ms=4.5)


def test_a_check_ends_at_the_first_view_beyond_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next settings begin with the view in which the ones before failed."""
    cheap, dear = mark_best([make_point(1.0, 1.0), make_point(0.5, 2.0)])
    drawn: list[int] = []

    def draw_views(_: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> Any:
        for number, frame in enumerate(frames):
            drawn.append(frame.number)
            yield still_errors([9.0 if settings is cheap.settings and number == 3 else 1.0])[0], [1e-3]

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        return still_errors([1.0] * len(frames))

    bench_type = make_bench(compare)
    bench_type.draw_views = draw_views
    monkeypatch.setattr(choice, "CombinationBench", bench_type)
    checked = choose(replace(SETUP, backend="null"), [cheap, dear], max_error=4.0)
    assert (checked.point, checked.rejected) == (dear, 1)
    assert len(drawn) == 4 + 10
    assert drawn[4] == drawn[3]


IN_USE = {"fxaa": "on"}


@pytest.mark.parametrize(
    ("ratio", "is_kept"),
    [
        ((0.97, 0.9, 1.02), True),
        ((1.1, 1.05, 1.2), True),
        ((0.94, 0.93, 0.96), True),  # surely faster, but perhaps by less than 5 %
        ((0.9, 0.85, 0.95), False),
    ],
)
def test_settings_in_use_are_left_for_surely_faster_ones(
    ratio: tuple[float, float, float], is_kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    used, faster = replace(make_point(0.5, 2.0), values=IN_USE), make_point(0.6, 1.5)
    faster = replace(faster, settings=RenderSettings().change("scale", 0.5))

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        return still_errors([1.0] * len(frames))

    def compare_times(_: object, settings: RenderSettings, other: RenderSettings, *_more: object) -> Interval:
        assert (settings, other) == (faster.settings, used.settings)
        return Interval(*ratio)

    monkeypatch.setattr(choice, "CombinationBench", make_bench(compare, compare_times=compare_times))
    null_setup = replace(SETUP, backend="null")
    assert choose(null_setup, [used, faster], max_error=4.0).point is faster
    checked = choose(null_setup, [used, faster], max_error=4.0, values_in_use=IN_USE)
    assert (checked.point is used, checked.is_kept) == (is_kept, is_kept)
    assert choose(null_setup, [used, faster], max_error=4.0, values_in_use={"fxaa": "off"}).point is faster


@pytest.mark.parametrize(
    ("used_ms", "other_ms", "other_error", "is_kept"),
    [
        ((11.0, 9.0), (8.0, 9.0), 1.1, True),  # it may be within the budget
        ((11.0, 12.0), (8.0, 9.0), 1.1, False),  # it surely isn't
        ((8.0, 9.0), (8.0, 9.0), 0.9, False),  # surely within it, and more accurate
        ((8.0, 9.0), (9.0, 11.0), 0.9, True),  # maybe within it
        ((8.0, 9.0), (8.0, 9.0), 1.0, True),  # as accurate
        ((8.0, 9.0), (8.0, 9.0), 0.96, True),  # as accurate up to what counts as equal
    ],
)
def test_settings_in_use_are_left_for_others_that_keep_the_budget_more_surely(
    used_ms: tuple[float, float],
    other_ms: tuple[float, float],
    other_error: float,
    is_kept: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half of the frames take the first time, and half the second."""
    used = replace(make_point(1.0, 5.0), values=IN_USE)
    other = replace(make_point(other_error, 5.0), settings=RenderSettings().change("scale", 0.5))

    def walk(_: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> list[Instant]:
        times = used_ms if settings is used.settings else other_ms
        return [Instant(1e-3 * times[number % 2], 1e-3, 0.0) for number in range(len(frames))]

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        return still_errors([1.0 if settings is used.settings else other_error] * len(frames))

    monkeypatch.setattr(choice, "CombinationBench", make_bench(compare, walk=walk))
    checked = choose(replace(SETUP, backend="null"), [used, other], budget_ms=10.0, values_in_use=IN_USE)
    assert (checked.point is used, checked.is_kept) == (is_kept, is_kept)


def test_settings_in_use_that_may_keep_a_budget_are_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    used = replace(make_point(1.0, 12.0), values=IN_USE)

    def walk(_: object, settings: RenderSettings, frames: Sequence[PathFrame]) -> list[Instant]:
        return [Instant(1e-3 * (9.0 if number % 2 else 12.0), 1e-3, 0.0) for number in range(len(frames))]

    def compare(_: object, settings: RenderSettings, frames: Sequence[PathFrame], **_more: bool) -> Any:
        return still_errors([1.0] * len(frames))

    monkeypatch.setattr(choice, "CombinationBench", make_bench(compare, walk=walk))
    null_setup = replace(SETUP, backend="null")
    assert choose(null_setup, [used], budget_ms=10.0, values_in_use=IN_USE).is_kept
    for budget_ms, values_in_use in ((10.0, None), (8.0, IN_USE)):
        with pytest.raises(rhi.ValidationError, match="accuracy-out-of-reach"):
            choose(null_setup, [used], budget_ms=budget_ms, values_in_use=values_in_use)


def test_of_values_that_show_the_same_the_first_and_the_default_are_combined() -> None:
    report = make_report(
        "local_shadow_size", ("32", 3.0, 0.5), *((value, 1.0, 1.0) for value in ("64", "128", "256", "512"))
    )
    rows = tuple(replace(row, is_default=row.value == "256") for row in report.rows)

    def list_values(report: SettingReport, values_in_use: str | None = None) -> list[str]:
        return [row.value for row in choice.omit_equal_values(report, values_in_use).rows]

    assert list_values(replace(report, rows=rows)) == ["32", "64", "256"]
    assert list_values(report) == ["32", "64", "512"]
    assert list_values(report, "128") == ["32", "64", "128", "512"]
    flickering = tuple(replace(row, flicker=float(number)) for number, row in enumerate(rows))
    assert len(list_values(replace(report, rows=flickering))) == 5


def test_settings_in_use_of_other_quality_settings_are_refused() -> None:
    reports = {"fxaa": make_report("fxaa", ("off", 2.0, 0.5), ("on", 1.0, 1.0))}
    choice.check_values_in_use(None, reports)
    choice.check_values_in_use({"fxaa": "on"}, reports)
    for values in ({}, {"fxaa": "maybe"}, {"fxaa": "on", "scale": "1.0"}, {"scale": "1.0"}):
        with pytest.raises(rhi.ValidationError, match="accuracy-other-settings"):
            choice.check_values_in_use(values, reports)


def test_the_combination_in_use_is_timed_though_others_beat_it(gl: rhi.Device) -> None:
    setup = replace(SETUP, rounds=1, size=(24, 14), views=1, traced_pixels=200)
    reports = [sweep_setting(setup, "fxaa"), sweep_setting(setup, "scale")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(choice, "FRONT_PIXELS", 200)
        points = compute_pareto_front(setup, reports, values_in_use={"fxaa": "on", "scale": "0.25"})
    assert {"fxaa": "on", "scale": "0.25"} in [point.values for point in points]
    assert all(point.milliseconds > 0.0 for point in points)


@pytest.mark.parametrize(("fxaa", "computed"), [("on", [None]), ("off", [None, "off"])])
def test_a_second_choice_reads_the_first_front_if_it_has_the_settings_in_use(
    fxaa: str, computed: list[str | None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reports = [make_report("fxaa", ("off", 2.0, 0.5), ("on", 1.0, 1.0))]
    calls: list[str | None] = []

    def compute(*_: object, values_in_use: dict[str, str] | None) -> list[ParetoPoint]:
        calls.append(values_in_use["fxaa"] if values_in_use else None)
        values = ["on"] if values_in_use is None else ["on", values_in_use["fxaa"]]
        return [
            replace(make_point(1.0, 2.0), values={"fxaa": value}, settings=combine_fxaa(value))
            for value in values
        ]

    def combine_fxaa(value: str) -> RenderSettings:
        return choice.combine(choice.make_plain(SETUP.settings), {"fxaa": value})

    monkeypatch.setattr(jobs, "compute_pareto_front", compute)
    first = load_or_compute_pareto_front(SETUP, reports, tmp_path)
    second = [
        load_or_compute_pareto_front(SETUP, reports, tmp_path, values_in_use={"fxaa": fxaa}) for _ in range(2)
    ]
    assert calls == computed
    assert second[0] == second[1]
    assert (second[0] == first) == (fxaa == "on")


@pytest.mark.parametrize(
    ("text", "is_bounded", "message"),
    [
        ('{"values": {"fxaa": "on"}}', False, "without --budget-ms or --max-error"),
        ("{}", True, "settings.json of a choice"),
        ('{"values": 3}', True, "settings.json of a choice"),
        ("no JSON", True, "settings.json of a choice"),
    ],
)
def test_a_file_without_a_choice_is_refused(
    text: str, is_bounded: bool, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "settings.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OutputError, match=message):
        load_values_in_use(path, is_bounded=is_bounded)
    path.write_text('{"values": {"fxaa": "on"}}', encoding="utf-8")
    assert load_values_in_use(path, is_bounded=True) == {"fxaa": "on"}
    assert load_values_in_use(None, is_bounded=False) is None


def test_of_equally_fast_settings_the_most_accurate_are_first() -> None:
    slow, fast, exact = make_point(0.5, 2.0), make_point(3.0, 1.0), make_point(2.0, 1.04)
    assert order_by_speed([slow, fast, exact]) == [exact, fast, slow]
    assert order_by_speed([slow, fast, replace(exact, ratio=1.06)])[0] is fast


def test_references_are_read_from_their_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(SETUP.scene)
    frame = list_views(scene, SETUP)[0]
    images = []
    for folder in (tmp_path, tmp_path, tmp_path / "other", None):
        bench._TRACED.clear()  # as in another process
        with (
            open_device("null") as device,
            CombinationBench(device, scene, SETUP, ["fxaa"], 60) as combinations,
            keep_references(folder),
        ):
            images.append(combinations.render_reference(frame))
        if folder is tmp_path and len(images) == 1:
            (stored,) = tmp_path.glob("reference-*.npy")
            np.save(stored, images[0] + 1.0)
    for image, added in zip(images, (0.0, 1.0, 0.0, 0.0), strict=True):
        np.testing.assert_array_equal(image, images[0] + added)


def test_views_share_a_ray_tracer_until_the_scene_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(SETUP.scene)
    frames = list_views(scene, SETUP)
    built: list[RayTracer] = []

    def build(*arguments: Any, **settings: bool) -> RayTracer:
        built.append(RayTracer(*arguments, **settings))
        return built[-1]

    monkeypatch.setattr(bench, "RayTracer", build)
    bench._TRACED.clear()
    with open_device("null") as device, CombinationBench(device, scene, SETUP, ["fxaa"], 60) as combinations:
        first, second = (combinations.render_reference(frame) for frame in frames)
        assert len(built) == 1
        scene.lights.directional["intensity"] *= 0.5
        darker = combinations.render_reference(frames[0])
        assert len(built) == 2
        scene.lights.directional["intensity"] *= 2.0
        combinations.render_reference(frames[0])
    assert len(built) == 2  # the first image is stored
    camera = frames[1].camera.with_aspect(SETUP.size[0] / SETUP.size[1])
    every = max(1, round(np.sqrt(SETUP.size[0] * SETUP.size[1] / 60)))
    traced = RayTracer(scene).draw(camera, SETUP.size, RAY_TRACED.rays, every)
    np.testing.assert_array_equal(second, traced)
    assert np.nanmean(darker) < np.nanmean(first)


def test_damaged_references_are_traced_again(tmp_path: Path) -> None:
    scene = load_scene(SETUP.scene)
    frame = list_views(scene, SETUP)[0]
    images = []
    for _ in range(2):
        bench._TRACED.clear()
        with (
            open_device("null") as device,
            CombinationBench(device, scene, SETUP, ["fxaa"], 60) as combinations,
            keep_references(tmp_path),
        ):
            images.append(combinations.render_reference(frame))
        (stored,) = tmp_path.glob("reference-*.npy")
        size = stored.stat().st_size
        stored.write_bytes(stored.read_bytes()[:-9])
    np.testing.assert_array_equal(*images)
    assert size == stored.stat().st_size + 9  # it was whole again


def test_settings_that_were_auto_become_auto_again() -> None:
    original = RenderSettings()
    plain = choice.make_plain(original).change("technique.samples", 4)
    left = choice.leave_to_trials(plain, original)
    assert (left.technique.name, left.algorithm, left.technique.samples) == ("auto", "auto", 4)
    assert choice.leave_to_trials(plain, plain) == plain


def test_a_bound_that_no_settings_keep_is_refused() -> None:
    points = mark_best([make_point(1.0, 9.0), make_point(2.0, 5.0)])
    with pytest.raises(rhi.ValidationError, match=r"5 ms.*1 levels"):
        choose(SETUP, points, budget_ms=4.0)
    with pytest.raises(rhi.ValidationError, match="accuracy-out-of-reach"):
        choose(SETUP, points, max_error=0.5)


def make_sample(job: SweepJob) -> SettingSample:
    """Make what a share may have found for one value."""
    view = (2.0 * (1 + job.shard.number), 2)
    value = ValueSample((view,), view[0], (job.shard.number, 1, 2), "", (0.5, 0.25), (0.125, 0.5))
    return SettingSample(job.setting, "gl", "a device", {"b": "no b"}, {"a": value}, (3.0, 1.5))


class CrashingExecutor(SerialExecutor):
    """Runs a number of jobs, and then ends as a process does that is killed."""

    def __init__(self, count: int, ran: list[SweepJob]) -> None:
        self.count, self.ran = count, ran

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.ran) == self.count:
            raise KeyboardInterrupt
        self.ran.append(args[0])
        return super().submit(make_sample, *args)


def test_a_sweep_goes_on_where_it_was_interrupted(tmp_path: Path) -> None:
    jobs = list_jobs(SETUP, ("fxaa", "samples", "precision"))
    first, second, third = list[SweepJob](), list[SweepJob](), list[SweepJob]()
    with pytest.raises(KeyboardInterrupt):
        run_jobs(jobs, CrashingExecutor(2, first), tmp_path)
    reports = run_jobs(jobs, CrashingExecutor(9, second), tmp_path)
    assert (len(jobs), len(first), len(second)) == (6, 2, 4)
    assert {*first, *second} == {*jobs}
    assert [report.setting for report in reports] == ["fxaa", "samples", "precision"]
    assert [(row.mean_error, row.max_error, row.worst) for row in reports[0].rows] == [(1.5, 4.0, (1, 1, 2))]
    damaged = tmp_path / f"{jobs[1].key}.json"
    damaged.write_text(damaged.read_text(encoding="utf-8")[:-9], encoding="utf-8")
    assert run_jobs(jobs, CrashingExecutor(9, third), tmp_path) == reports
    assert third == [jobs[1]]
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json"] * 6


def test_the_longest_jobs_are_handed_out_first(tmp_path: Path) -> None:
    ran = list[SweepJob]()
    jobs = list_jobs(
        replace(SETUP, views=1), ("tangent_packing", "precision", "query_persistence", "shadow_size")
    )
    run_jobs(jobs, CrashingExecutor(9, ran), tmp_path)
    assert [job.setting for job in ran] == [
        "shadow_size",
        "query_persistence",
        "precision",
        "tangent_packing",
    ]
    assert ran == order_jobs(jobs)


def test_the_name_of_a_job_has_all_that_its_result_depends_on() -> None:
    job = SweepJob(SETUP, "fxaa")
    assert job.key == SweepJob(replace(SETUP), "fxaa").key
    others = [
        SweepJob(SETUP, "samples"),
        SweepJob(SETUP, "fxaa", SweepShard(0, 2)),
        SweepJob(SETUP, "fxaa", SweepShard(1, 2)),
        SweepJob(replace(SETUP, rounds=3), "fxaa"),
        SweepJob(replace(SETUP, settings=RenderSettings().change("shadows.cascades", 2)), "fxaa"),
    ]
    assert len({job.key, *(changed_job.key for changed_job in others)}) == 6


def test_a_job_that_fails_leaves_the_results_of_others(tmp_path: Path) -> None:
    jobs = [SweepJob(replace(SETUP, scene="nothing"), "fxaa"), SweepJob(SETUP, "blending")]
    with (
        open_device("gl"),
        make_executor("threads:1") as executor,
        pytest.raises(rhi.ValidationError, match="scene"),
    ):
        run_jobs(jobs, executor, tmp_path)
    assert [path.stem for path in tmp_path.iterdir()] == [jobs[1].key]


def test_results_of_a_job_are_read_as_they_were_written(tmp_path: Path) -> None:
    sample = make_sample(SweepJob(SETUP, "fxaa"))
    save_sample(tmp_path / "r.json", sample)
    assert load_sample(tmp_path / "r.json") == sample
    assert load_sample(tmp_path / "other.json") is None


SMALL_CITY = ["city:blocks=2", "--backend", "gl", "--size", "48x28"]
SWEEP = ["accuracy", *SMALL_CITY, "--views", "2", "--rounds", "2", "--output", "out", "--json"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder in which the command has measured two quality settings, and what it has printed."""
    folder = tmp_path_factory.mktemp("swept")
    measured = ["--quality-setting", "texture_filter", "--quality-setting", "fxaa", "--plot", "charts.png"]
    with open_device("gl"), chdir(folder):
        return folder, read_report(*SWEEP, *measured, "--max-error", "200")


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_command_measures_the_named_quality_settings(swept: tuple[Path, dict[str, Any]]) -> None:
    assert [setting["setting"] for setting in swept[1]["quality_settings"]] == ["texture_filter", "fxaa"]


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_command_checks_its_choice_and_measures_it_along_other_views(
    swept: tuple[Path, dict[str, Any]],
) -> None:
    chosen_point = swept[1]["choice"]
    assert 0.0 < chosen_point["checked_error"] <= chosen_point["expected_error"] <= 200.0
    assert chosen_point["held_out_error"] > 0.0
    assert chosen_point["held_out_views"] == 20


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_command_chooses_the_fastest_point_of_the_front(swept: tuple[Path, dict[str, Any]]) -> None:
    report = swept[1]
    fastest = min(point["ratio"] for point in report["pareto_front"])
    assert report["choice"]["ratio"] <= 1.05 * fastest


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_page_holds_its_images(swept: tuple[Path, dict[str, Any]]) -> None:
    page = (swept[0] / "out/report.html").read_text(encoding="utf-8")
    # Two charts, and the worst pixels of two quality settings.
    assert page.count("data:image/png;base64,") >= 4
    assert 'src="http' not in page


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_command_writes_charts_and_images(swept: tuple[Path, dict[str, Any]]) -> None:
    assert (swept[0] / "charts.png").stat().st_size > 1000
    assert (swept[0] / "out/images/images.png").is_file()


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_the_written_settings_are_those_of_the_choice(swept: tuple[Path, dict[str, Any]]) -> None:
    settings = RenderSettings.load(swept[0] / "out/settings.json")
    assert settings.technique.fxaa is (swept[1]["choice"]["values"]["fxaa"] == "on")


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("arguments", "technique"), [([], "forward"), (["--technique", "deferred"], "deferred")]
)
def test_render_reads_the_written_settings_and_arguments_override_them(
    swept: tuple[Path, dict[str, Any]],
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    technique: str,
) -> None:
    with chdir(swept[0]):
        render = ["render", *SMALL_CITY, "--settings", "out/settings.json", "--output", "a.png", "--json"]
        assert main([*render, *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["technique"] == technique


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_a_budget_out_of_reach_removes_earlier_settings_and_shows_measurements(
    swept: tuple[Path, dict[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = shutil.copytree(swept[0], tmp_path / "again")
    (folder / "out/accuracy.json").unlink()
    with chdir(folder), pytest.raises(SystemExit):
        main([*SWEEP, "--quality-setting", "fxaa", "--budget-ms", "1e-3"])
    captured = capsys.readouterr()
    assert "0.001 ms (allowed: " in captured.err
    assert "accuracy-out-of-reach" in captured.err
    assert json.loads(captured.out)["choice"] is None
    assert "removed out/settings.json" in captured.err  # it doesn't answer this question
    assert not (folder / "out/settings.json").exists()
    assert (folder / "out/accuracy.json").is_file()


def test_existing_settings_files_are_not_overwritten_without_asking(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    RenderSettings().save(Path("settings.json"))
    sweep = ["accuracy", "city:blocks=2", "--backend", "null", "--size", "16x16", "--quality-setting", "fxaa"]
    with pytest.raises(SystemExit):
        main(sweep)  # null draws nothing: no quality setting is left
    assert Path("settings.json").exists()
    with pytest.raises(SystemExit):
        main([*sweep, "--budget-ms", "9", "--settings", "settings.json"])
    assert "copy the file and pass the copy" in capsys.readouterr().err
    assert Path("settings.json").exists()
    with pytest.raises(SystemExit):
        main([*sweep, "--budget-ms", "9"])
    assert not Path("settings.json").exists()


def test_the_reason_for_omitted_values_is_stated_once_for_all_of_them() -> None:
    none = SettingReport(
        "blending", "gl", "a device", (), dict.fromkeys(("weighted", "sorted"), "the scene lacks glass")
    )
    partial_report = replace(make_report("samples", ("1", 1.0, 1.0)), left_out={"2": "no 2", "8": "no 8"})
    lines = ["blending: the scene lacks glass", "samples: 2: no 2", "samples: 8: no 8"]
    assert describe_left_out([none, partial_report, make_report("fxaa", ("off", 1.0, 1.0))]) == lines


@pytest.mark.nightly
@pytest.mark.usefixtures("gl")
def test_a_sweep_that_was_killed_does_nothing_twice(tmp_path: Path) -> None:
    quality_settings = ("fxaa", "depth", "texture_filter", "second_eye")
    command = [
        sys.executable,
        "-m",
        "renderer",
        "accuracy",
        "city:blocks=2",
        "--backend",
        "gl",
        "--size",
        "32x18",
    ]
    command += ["--views", "1", "--rounds", "2", "--output", str(tmp_path)]
    command += [text for setting in quality_settings for text in ("--quality-setting", setting)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    while not list(tmp_path.glob("jobs/*.json")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    finished = {path: path.stat().st_mtime_ns for path in tmp_path.glob("jobs/*.json")}
    assert 1 <= len(finished) < len(quality_settings)
    assert not (tmp_path / "accuracy.json").exists()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    report = json.loads((tmp_path / "accuracy.json").read_text(encoding="utf-8"))
    assert [entry["setting"] for entry in report["quality_settings"]] == list(quality_settings)
