"""Combinations that race: which are dropped, when, and what the search keeps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest

from renderer.lab.accuracy.race import MIN_GAIN, SettingsTrial, is_surely_slower, search, select_front

VALUES = {"size": ("0.5", "1", "2", "4"), "filter": ("1", "2", "4"), "smooth": ("off", "on")}


def measure_together(values: dict[str, str]) -> tuple[float, float]:
    """The error and the time of quality settings that change the cost of others: sizes multiply, and
    smoothing helps only small images."""
    size, filters, smooth = float(values["size"]), float(values["filter"]), values["smooth"] == "on"
    error = (
        8.0 / size
        + 2.0 / filters
        + (1.0 if smooth and size > 1 else 0.0)
        - (3.0 if smooth and size <= 1 else 0.0)
    )
    return error, size * size * (1.0 + 0.5 * filters) + (0.2 if smooth else 0.0)


def make_trial(error: float, *seconds: float, name: str = "") -> SettingsTrial:
    return SettingsTrial({"size": name or f"{error:g}"}, (error,), np.array(seconds))


def try_all_views(values: dict[str, str], front: Sequence[SettingsTrial]) -> SettingsTrial:
    error, seconds = measure_together(values)
    return SettingsTrial(values, (error, 0.9 * error), np.full(8, seconds))


class Racer:
    """Draws the views of combinations until one of the front beats them, and counts them."""

    def __init__(self) -> None:
        self.views = 0

    def __call__(self, values: dict[str, str], front: Sequence[SettingsTrial]) -> SettingsTrial:
        whole = try_all_views(values, front)
        for count in (1, 2):
            self.views += 1
            trial = SettingsTrial(values, whole.errors[:count], whole.seconds[: 4 * count], count == 2)
            if any(other.beats(trial) for other in front):
                return SettingsTrial(values, trial.errors, trial.seconds, is_complete=False)
        return trial


START = {"size": "4", "filter": "4", "smooth": "off"}


def test_the_search_selects_the_same_settings_as_brute_force() -> None:
    front = [measure_together(trial.values) for trial in search(VALUES, [START], try_all_views)]
    everything = [try_all_views(dict(zip(VALUES, key, strict=True)), ()) for key in product(*VALUES.values())]
    points = [measure_together(trial.values) for trial in everything]
    gain = 1.0 - MIN_GAIN
    assert len(front) > 6
    for error, seconds in points:
        assert any(other <= error and gain * taken <= seconds for other, taken in front)
    for error, seconds in front:
        assert not any(other < error and taken < gain * seconds for other, taken in points)


def test_a_race_selects_the_same_settings_as_complete_comparisons_and_draws_fewer_views() -> None:
    racer = Racer()
    raced, complete = (search(VALUES, [START], measure) for measure in (racer, try_all_views))
    assert [trial.values for trial in raced] == [trial.values for trial in complete]
    assert racer.views < 2 * len(list(product(*VALUES.values())))


def test_a_search_ends_after_a_number_of_combinations() -> None:
    tried: list[tuple[str, ...]] = []

    def measure(values: dict[str, str], front: Sequence[SettingsTrial]) -> SettingsTrial:
        tried.append(tuple(values.values()))
        return try_all_views(values, front)

    search(VALUES, [START, START | {"size": "2"}], measure, max_tried=7)
    assert len(tried) == len(set(tried)) == 7


@pytest.mark.parametrize(("seconds", "is_slower"), [(0.99, True), (0.9, False), (1.2, True)])
def test_a_combination_must_save_more_than_the_least_gain(seconds: float, is_slower: bool) -> None:
    steady = np.full(12, 1.0)
    assert is_surely_slower(seconds * steady, steady) is is_slower


def test_noise_beats_no_combination() -> None:
    noisy = np.array([0.6, 1.5, 1.4, 0.7, 0.8, 1.6])
    assert not is_surely_slower(noisy, np.ones(6))
    assert is_surely_slower(np.full(6, float(np.median(noisy))), np.ones(6))


def test_few_frames_beat_only_much_slower_combinations() -> None:
    assert not is_surely_slower(np.array([1.05]), np.ones(1))
    assert is_surely_slower(np.array([1.3]), np.ones(1))


def test_a_disturbed_frame_decides_nothing() -> None:
    seconds = np.array([0.8, 0.8, 30.0, 0.8, 0.8, 0.8])
    assert not is_surely_slower(seconds, np.ones(6))


def test_a_less_accurate_combination_is_beaten_only_by_those_as_accurate_in_its_views_so_far() -> None:
    exact = SettingsTrial({}, (3.0, 1.0), np.ones(6))
    worse = SettingsTrial({}, (3.5,), np.full(3, 1.4), is_complete=False)
    unknown = SettingsTrial({}, (2.5,), np.full(3, 1.4), is_complete=False)  # may stay below 3
    assert exact.beats(worse)
    assert not exact.beats(unknown)


def test_combinations_without_difference_leave_one() -> None:
    alike = [make_trial(1.0, *[1.0] * 6, name=name) for name in ("a", "b")]
    assert [trial.values["size"] for trial in select_front(alike)] == ["a"]


def test_a_front_has_no_combination_that_another_beats() -> None:
    trials = [
        make_trial(error, *[seconds] * 6) for error, seconds in ((0, 9), (1, 9.5), (2, 5), (3, 4.99), (4, 1))
    ]
    assert [trial.error for trial in select_front(trials)] == [0, 2, 4]
