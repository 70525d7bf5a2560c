"""Comparison of results: all texels at once, in float64, each tolerance with its reason.

A failure says how many values differ, by how much at worst, and shows the first few of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_SHOWN = 4
MARKS = {(True, True): "#", (True, False): "+", (False, True): "-", (False, False): "."}


def assert_same(actual: ArrayLike, expected: ArrayLike) -> None:
    """Assert that every value equals the expected one exactly; `expected` is broadcast to the shape of
    `actual`."""
    assert_near(actual, expected, 0.0, "exact")


def assert_near(actual: ArrayLike, expected: ArrayLike, tolerance: ArrayLike, reason: str) -> None:
    """Assert that every value is within an absolute `tolerance` of the expected one; `reason` explains it."""
    __tracebackhide__ = True
    got = np.asarray(actual)
    expected_values, allowed = _widen(expected, got.shape), _widen(tolerance, got.shape)
    values = _widen(got, got.shape)
    with np.errstate(invalid="ignore"):
        error = np.where(values == expected_values, 0.0, np.abs(values - expected_values))
    wrong = ~(error <= allowed)  # true for NaN too
    if not wrong.any():
        return
    indices = np.argwhere(wrong)
    worst = np.nan_to_num(error, nan=np.inf).max()
    lines = [f"{len(indices)} of {got.size} values differ by more than allowed ({reason}); worst {worst:g}"]
    lines += [
        f"  at {tuple(int(i) for i in index)}: got {got[tuple(index)]!r}, expected "
        f"{expected_values[tuple(index)]!r}"
        for index in indices[:MAX_SHOWN]
    ]
    raise AssertionError("\n".join(lines))


def _widen(values: ArrayLike, shape: tuple[int, ...]) -> NDArray[Any]:
    return np.broadcast_to(np.asarray(values).astype(np.float64), shape)


def assert_mask(actual: NDArray[Any], expected: NDArray[np.bool_]) -> None:
    """Assert that the nonzero texels of `actual` (height, width[, channels]) are exactly those of
    `expected`."""
    __tracebackhide__ = True
    drawn = np.asarray(actual.any(axis=-1) if actual.ndim == 3 else actual != 0)
    if np.array_equal(drawn, expected):
        return
    lines = [
        f"{int(drawn.sum())} texels drawn, {int(expected.sum())} expected ('#' both, '+' extra, '-' missing)"
    ]
    for got, expected_row in zip(drawn[:40], expected[:40], strict=True):
        lines.append("".join(MARKS[bool(g), bool(w)] for g, w in zip(got, expected_row, strict=True)))
    raise AssertionError("\n".join(lines))
