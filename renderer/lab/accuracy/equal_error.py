"""Equal error and equal time: two values of a setting are compared where they are equally accurate, or equally
fast, as papers on sampling do (Bitterli and others, Spatiotemporal reservoir resampling for real-time ray
tracing with dynamic direct lighting, 2020).

Each value is drawn at several image scales, which trade its error for its time: a curve. Between its points a
curve is a straight line of logarithms. Intervals are a bootstrap over pixels and rounds, drawn alike for both
curves: what a pixel or a round has in itself cancels out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer.lab.measure.measurement import Interval
from renderer.scene.arrays import Floats, Indices

_RESAMPLES: Final = 500


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """A value of a setting at several scales.

    Attributes:
        errors: of each pixel at each scale, (pixels, scales), in levels.
        seconds: of each round at each scale, (rounds, scales).
    """

    errors: Floats
    seconds: Floats

    def average(self, pixels: Indices | slice = slice(None), rounds: Indices | slice = slice(None)) -> Points:
        """The mean errors and median times of a sample."""
        return Points(self.errors[pixels].mean(axis=0), np.median(self.seconds[rounds], axis=0))


@dataclass(frozen=True, eq=False, slots=True)
class Points:
    """Errors and times of a curve at each scale, both (scales,)."""

    errors: Floats
    seconds: Floats

    def time_at(self, error: float) -> float:
        """The least time in which the curve has this error; infinite if it never has."""
        errors, seconds = self._envelope()
        if error < errors[-1]:
            return float("inf")
        if error >= errors[0]:
            return float(seconds[0])
        return _interpolate(error, errors[::-1], seconds[::-1])

    def error_at(self, time: float) -> float:
        """The least error that the curve has within this time; infinite if all of it takes longer."""
        errors, seconds = self._envelope()
        if time < seconds[0]:
            return float("inf")
        if time >= seconds[-1]:
            return float(errors[-1])
        return _interpolate(time, seconds, errors)

    def _envelope(self) -> tuple[Floats, Floats]:
        """The points that no other point of the curve beats: rising times, falling errors."""
        order = np.lexsort([self.errors, self.seconds])
        errors, seconds = self.errors[order], self.seconds[order]
        is_better = np.concatenate([[True], errors[1:] < np.minimum.accumulate(errors)[:-1]])
        return errors[is_better], seconds[is_better]


def _interpolate(position: float, positions: Floats, values: Floats) -> float:
    least = 1e-12
    logs = np.interp(
        np.log(max(position, least)), np.log(np.maximum(positions, least)), np.log(np.maximum(values, least))
    )
    return float(np.exp(logs))


@dataclass(frozen=True, slots=True)
class EqualComparison:
    """A value compared with the default at the scale of the image.

    Attributes:
        time: the time with the default's error, as a ratio to the default's.
        error: the error in the default's time, as a ratio to the default's.
    """

    time: Interval
    error: Interval


def compare_curves(curve: Curve, default: Curve, scale: int) -> EqualComparison:
    """Compare a curve with the default's point at the scale of this number. Both have the same pixels and
    rounds."""
    rng = np.random.default_rng(0)
    pixel_count, round_count = len(curve.errors), len(curve.seconds)
    ratios = [_compare(curve.average(), default.average(), scale)]
    for _ in range(_RESAMPLES):
        pixels = rng.integers(0, pixel_count, pixel_count)
        rounds = rng.integers(0, round_count, round_count)
        ratios.append(_compare(curve.average(pixels, rounds), default.average(pixels, rounds), scale))
    low, high = np.quantile(ratios[1:], (0.025, 0.975), axis=0, method="nearest")
    times, errors = zip(ratios[0], low.tolist(), high.tolist(), strict=True)
    return EqualComparison(Interval(*times), Interval(*errors))


def _compare(points: Points, default: Points, scale: int) -> tuple[float, float]:
    error, time = float(default.errors[scale]), float(default.seconds[scale])
    return points.time_at(error) / time, points.error_at(time) / error
