"""Curves of error over time: where two are equally accurate, or equally fast."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.lab.accuracy.equal_error import Curve, Points, compare_curves


def make_curve(errors: list[float], seconds: list[float], noise: float = 0.0) -> Curve:
    """Make a curve of 400 pixels and 9 rounds, which have a factor of their own each."""
    rng = np.random.default_rng(1)
    pixels, rounds = rng.uniform(0.5, 1.5, (400, 1)), rng.uniform(0.8, 1.2, (9, 1))
    own = 1.0 + noise * np.random.default_rng(len(errors)).normal(size=(400, len(errors)))
    return Curve(
        pixels / pixels.mean() * np.array(errors) * own, rounds / np.median(rounds) * np.array(seconds)
    )


DEFAULT = make_curve([8.0, 4.0, 2.0], [1.0, 2.0, 8.0])


def test_a_curve_is_a_straight_line_of_logarithms_between_its_points() -> None:
    points = Points(np.array([8.0, 2.0]), np.array([1.0, 4.0]))
    assert points.time_at(4.0) == pytest.approx(2.0)
    assert points.error_at(2.0) == pytest.approx(4.0)


def test_an_error_or_a_time_below_a_curve_is_never_reached() -> None:
    points = Points(np.array([8.0, 2.0]), np.array([1.0, 4.0]))
    assert points.time_at(1.9) == points.error_at(0.9) == np.inf
    assert (points.time_at(2.0), points.error_at(1.0)) == pytest.approx((4.0, 8.0))


def test_beyond_a_curve_its_end_counts() -> None:
    points = Points(np.array([8.0, 2.0]), np.array([1.0, 4.0]))
    assert (points.time_at(9.0), points.error_at(5.0)) == (1.0, 2.0)


def test_points_that_another_beats_are_no_part_of_a_curve() -> None:
    points = Points(np.array([8.0, 9.0, 2.0]), np.array([1.0, 2.0, 4.0]))
    assert points.error_at(2.0) == pytest.approx(4.0)


def test_a_value_with_the_same_errors_in_half_the_time_takes_half_of_it() -> None:
    result = compare_curves(make_curve([8.0, 4.0, 2.0], [0.5, 1.0, 4.0]), DEFAULT, 1)
    assert (result.time.median, result.time.low, result.time.high) == pytest.approx((0.5, 0.5, 0.5))
    assert result.error.median == pytest.approx(2.0**-0.5)


def test_differences_between_pixels_and_between_rounds_widen_no_interval() -> None:
    paired = compare_curves(make_curve([6.0, 3.0, 1.5], [1.0, 2.0, 8.0]), DEFAULT, 1)
    noisy = compare_curves(make_curve([6.0, 3.0, 1.5], [1.0, 2.0, 8.0], 0.5), DEFAULT, 1)
    assert paired.error.high - paired.error.low < 1e-9
    assert noisy.error.high - noisy.error.low > 1e-3


def test_an_interval_tells_if_an_error_may_never_be_reached() -> None:
    result = compare_curves(make_curve([9.0, 4.05], [1.0, 2.0], 0.5), DEFAULT, 1)
    assert result.time.high == np.inf
