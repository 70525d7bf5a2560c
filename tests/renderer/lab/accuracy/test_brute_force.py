"""The choice is near the best of all combinations, each of which is drawn, compared and timed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise, product
from time import process_time
from typing import Any, Final

import numpy as np
import pytest
from busy_kit import busy_processes
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.lab.accuracy import (
    FRONT_PIXELS,
    ParetoPoint,
    SettingReport,
    SweepSetup,
    compute_pareto_front,
    sweep_setting,
)
from renderer.lab.accuracy.choice import CombinationBench, FrameError, combine, make_plain, order_by_speed
from renderer.lab.accuracy.race import SettingsTrial
from renderer.lab.accuracy.sweep import list_views
from renderer.settings import RenderSettings
from tests.renderer.conftest import open_device

SUN = {
    "scale": ("0.5", "0.75", "1.0", "2.0"),
    "fxaa": ("off", "on"),
    "shadow_size": ("256", "512", "1024", "2048"),
    "shadow_cascades": ("2", "3", "4"),
    "texture_filter": ("bilinear, no mip levels", "trilinear"),
}
LOCAL_LIGHTS = {
    **{setting: SUN[setting] for setting in ("scale", "fxaa", "texture_filter")},
    "local_shadow_size": ("64", "128", "256", "512"),
    "shadow_filter": ("hard", "hardware", "smooth"),
}
SCENES = {
    "city:blocks=2,shadows=1": SUN,
    "hall:columns=4,rows=2,shadows=1,lights=8": LOCAL_LIGHTS,
    "night:blocks=2,shadows=1,lights=8": SUN,
}
"""Scenes, and the values of 192 combinations for each: the hall has no sun."""
_ROUNDS = 6
_MORE = 1.1
"""Times the least error."""


def sweep_values(setup: SweepSetup, values: Mapping[str, Sequence[str]]) -> list[SettingReport]:
    """Sweep some values of quality settings."""
    sweeps = {setting: sweep_setting(setup, setting) for setting in values}
    return [
        replace(sweep, rows=tuple(row for row in sweep.rows if row.value in values[setting]))
        for setting, sweep in sweeps.items()
    ]


FEW: Final = {
    "city:blocks=2,shadows=1": {
        "shadow_size": ("256", "1024", "2048"),
        "texture_filter": ("bilinear, no mip levels", "trilinear"),
        "samples": ("1", "4"),
    },
    "hall:columns=4,rows=2,shadows=1,lights=8": {
        "scale": ("0.5", "1.0", "2.0"),
        "local_shadow_size": ("32", "64", "128"),
    },
    "night:blocks=2,shadows=1,lights=8": {
        "scale": ("0.5", "1.0", "2.0"),
        "shadow_size": ("256", "1024", "2048"),
    },
}


SEPARATED: Final = ("city:blocks=2,shadows=1", "night:blocks=2,shadows=1,lights=8")
"""Scenes in which values differ in time by more than noise. In the hall, sizes of shadow maps don't: its lights
stand still, and each map is drawn once."""


@contextmanager
def record_trials(trials: list[SettingsTrial]) -> Iterator[None]:
    """Append the trials of a search."""
    with pytest.MonkeyPatch.context() as patch:
        try_combination = CombinationBench.try_combination

        def try_and_record(
            bench: CombinationBench, *arguments: Any
        ) -> tuple[SettingsTrial, list[FrameError]]:
            trial, errors = try_combination(bench, *arguments)
            trials.append(trial)
            return trial, errors

        patch.setattr(CombinationBench, "try_combination", try_and_record)
        yield


def list_bounds(points: Sequence[ParetoPoint]) -> list[float]:
    """Bounds between the errors of a front, far from each of them."""
    errors = sorted({point.error for point in points})
    gaps = sorted(pairwise(errors), key=lambda pair: pair[0] - pair[1])[:2]
    return [0.5 * (low + high) for low, high in gaps] + [2.0 * errors[-1]]


@pytest.mark.nightly
@pytest.mark.parametrize("name", FEW)
def test_a_race_chooses_as_complete_comparisons_do_with_fewer_frames(name: str, gl: rhi.Device) -> None:
    setup = SweepSetup(name, backend="gl", size=(96, 54), views=3, rounds=7, traced_pixels=FRONT_PIXELS)
    reports = sweep_values(setup, FEW[name])
    trials: list[SettingsTrial] = []
    with record_trials(trials):
        raced = compute_pareto_front(setup, reports)
    complete = compute_pareto_front(setup, reports, races=False)
    if name in SEPARATED:
        assert any(len(trial.errors) < setup.views for trial in trials)
    for bound in list_bounds(complete):
        selected, expected = (
            order_by_speed([point for point in points if point.error <= bound])[0]
            for points in (raced, complete)
        )
        assert is_as_good(selected, expected), (selected, expected)


def is_as_good(point: ParetoPoint, expected: ParetoPoint) -> bool:
    """True for the same settings, and for others within the bound that are as fast up to what a race ignores and
    times are uncertain by: 95 % intervals are narrow on a quiet machine only."""
    return point.values == expected.values or point.low <= 1.05 * expected.high


def time_loop() -> float:
    """Return the seconds of processor time of a loop."""
    begin = process_time()
    for _ in range(3_000_000):
        pass
    return process_time() - begin


@pytest.mark.nightly
@pytest.mark.parametrize("name", FEW)
def test_a_choice_beside_busy_processes_is_that_of_a_quiet_machine(name: str, gl: rhi.Device) -> None:
    """Beside two processes that compute all the time. Between both choices the machine itself may become slower: times
    are compared in those of a loop."""
    setup = SweepSetup(name, backend="gl", size=(96, 54), views=3, rounds=7, traced_pixels=FRONT_PIXELS)
    fronts, loop_times = [], []
    for busy in (0, 2):
        before = time_loop()
        with busy_processes(busy):
            fronts.append(compute_pareto_front(setup, sweep_values(setup, FEW[name])))
        loop_times.append(0.5 * (before + time_loop()))
    for bound in list_bounds(fronts[0]):
        quiet, busy_choice = (
            order_by_speed([point for point in points if point.error <= bound])[0] for points in fronts
        )
        assert is_as_good(busy_choice, quiet), (busy_choice, quiet)
    most, busy_most = (
        next(point for point in points if point.error == min(other.error for other in points))
        for points in fronts
    )
    assert busy_most.values == most.values
    busy_time, quiet_time = (
        point.milliseconds / loop_time
        for point, loop_time in zip((busy_most, most), reversed(loop_times), strict=True)
    )
    assert busy_time == pytest.approx(quiet_time, rel=0.35)


def list_shortfalls(
    selected: Sequence[tuple[str, ...]],
    errors: Mapping[tuple[str, ...], float],
    times: Mapping[tuple[str, ...], NDArray[np.float64]],
) -> list[str]:
    """Budgets within which a combination is certainly to be had that is more accurate than each of `selected` that
    may be within them. Rounds bound what a time may be: all of them are within the budget of the former, one is
    for the latter."""
    shortfalls = []
    for budget in np.quantile([np.median(samples) for samples in times.values()], (0.25, 0.5, 0.75, 1.0)):
        within = [errors[combination] for combination, samples in times.items() if samples.max() <= budget]
        reached = [errors[combination] for combination in selected if times[combination].min() <= budget]
        if within and (not reached or min(reached) > _MORE * min(within)):
            shortfalls.append(
                f"{budget:.2f}: {min(reached, default=np.inf):.2f} levels, not {min(within):.2f}"
            )
    return shortfalls


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl"])
@pytest.mark.parametrize("name", SCENES)
def test_a_choice_is_as_accurate_as_any_combination_that_is_as_fast(name: str, backend: str) -> None:
    """Times are of the processor, in the median of all combinations' in the same round. The control leaves out the
    most accurate points of the front."""
    setup = SweepSetup(name, backend=backend, size=(96, 54), views=2, rounds=5, settings=RenderSettings())
    values = SCENES[name]
    with open_device(backend):
        pass
    reports = sweep_values(setup, values)
    front = compute_pareto_front(setup, reports)
    base, scene = make_plain(setup.settings), load_scene(setup.scene)
    everything = {
        combination: combine(base, dict(zip(values, combination, strict=True)))
        for combination in product(*values.values())
    }
    front_keys = [tuple(point.values[setting] for setting in values) for point in front]
    errors, times = {}, dict[tuple[str, ...], list[float]]()
    frames = list_views(scene, setup)
    with open_device(backend) as device, CombinationBench(device, scene, setup, list(values)) as bench:
        for turn in range(_ROUNDS):
            for combination, settings in everything.items():
                if not turn:
                    errors[combination] = max(error.total for error in bench.compare(settings, frames))
                renderer = bench.exchange(settings)
                bench.draw(renderer, settings, frames[0])
                began = process_time()
                for frame in frames[::-1]:
                    bench.draw(renderer, settings, frame)
                times.setdefault(combination, []).append(process_time() - began)
    by_round = np.array(list(times.values()))
    taken = dict(zip(times, by_round / np.median(by_round, axis=0), strict=True))
    assert len(everything) == 192
    least = min(errors.values())
    assert not list_shortfalls(front_keys, errors, taken)
    assert list_shortfalls([key for key in front_keys if errors[key] > 1.5 * least], errors, taken)
