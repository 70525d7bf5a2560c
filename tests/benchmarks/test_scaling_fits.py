"""Exponents, costs of one more and crossings of `benchmarks/scaling.py`, on times that are known."""

from __future__ import annotations

import math
import runpy
from pathlib import Path
from typing import Any, Final

import pytest

SCALING: Final = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks/scaling.py"))


def rows_of(times: dict[int, float]) -> list[dict[str, Any]]:
    return [{"n": n, "ms": ms} for n, ms in times.items()]


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0])
def test_the_exponent_of_a_power_is_found(exponent: float) -> None:
    slope, one_more = SCALING["fit"](rows_of({n: 3.0 * n**exponent for n in (10, 100, 1_000, 10_000)}))
    assert slope == pytest.approx(exponent, abs=1e-9)
    assert one_more == pytest.approx(1e3 * 3.0 * exponent * 10_000 ** (exponent - 1.0), rel=1e-9, abs=1e-9)


def test_only_the_larger_half_is_fitted() -> None:
    slope, _ = SCALING["fit"](rows_of({1: 5.0, 10: 5.0, 100: 10.0, 1_000: 100.0}))
    assert slope == pytest.approx(1.0)


@pytest.mark.parametrize(("sizes", "is_fitted"), [([100], False), ([100, 200], True)])
def test_a_fit_needs_two_sizes(sizes: list[int], is_fitted: bool) -> None:
    slope, one_more = SCALING["fit"](rows_of({n: 2.0 * n for n in sizes}))
    assert math.isnan(slope) is not is_fitted
    assert math.isnan(one_more) is not is_fitted


def test_two_powers_cross_where_they_are_equal() -> None:
    sizes = (1, 10, 100, 1_000)
    times = {"linear": {n: 1.0 * n for n in sizes}, "constant": dict.fromkeys(sizes, 50.0)}
    ((at, before, after),) = SCALING["list_crossings"](times)
    assert at == pytest.approx(50.0)
    assert (before, after) == ("linear", "constant")


def test_three_variants_take_over_in_turn_between_two_sizes() -> None:
    times = {"steep": {1: 1.0, 10_000: 1e8}, "flat": {1: 1e4, 10_000: 1e4}, "middle": {1: 10.0, 10_000: 1e5}}
    crossings = SCALING["list_crossings"](times)
    assert [(before, after) for _, before, after in crossings] == [("steep", "middle"), ("middle", "flat")]
    assert [at for at, *_ in crossings] == pytest.approx([10.0, 1_000.0])


def test_a_variant_that_is_never_the_fastest_crosses_nothing() -> None:
    times = {"slow": {1: 2.0, 10: 20.0}, "fast": {1: 1.0, 10: 10.0}}
    assert SCALING["list_crossings"](times) == []


def test_a_variant_takes_part_up_to_the_last_size_it_is_measured_at() -> None:
    times = {"short": {1: 1.0, 10: 1.0}, "long": {1: 2.0, 10: 2.0, 100: 2.0}}
    assert SCALING["list_crossings"](times) == []
