"""Times of several candidates: each round runs all once, so that disturbances of the machine affect all
alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time
from typing import Final

import numpy as np

from renderer.scene.arrays import Floats

_RESAMPLES: Final = 2000


@dataclass(frozen=True, slots=True)
class Measurement:
    """The times of one candidate in seconds, round by round: by the clock, and processor time of all threads,
    which other programs disturb less."""

    name: str
    seconds: tuple[float, ...]
    processor_seconds: tuple[float, ...] = ()

    @property
    def median(self) -> float:
        """The median time in seconds."""
        return median(self.seconds)

    @property
    def processor_median(self) -> float:
        """The median processor time in seconds."""
        return median(self.processor_seconds)

    def in_milliseconds(self) -> Floats:
        """The milliseconds of processor time, round by round."""
        return 1e3 * np.array(self.processor_seconds)

    def compare_to(self, other: Measurement, *, processor: bool = False) -> Interval:
        """The ratio of this time to the other's in the same round: the median over the rounds."""
        own_seconds, base = ((m.processor_seconds if processor else m.seconds) for m in (self, other))
        return Interval.of(np.divide(own_seconds, base))


@dataclass(frozen=True, slots=True)
class Interval:
    """A median with its 95 % confidence limits."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Floats) -> Interval:
        """The median of samples with its limits.

        The limits are a bootstrap: the medians of samples drawn from the sample itself, with replacement. The
        same values have the same limits.
        """
        drawn = np.random.default_rng(0).choice(values, (_RESAMPLES, len(values)))
        return cls(float(np.median(values)), *np.quantile(np.median(drawn, axis=1), (0.025, 0.975)).tolist())


def alternate(
    work: Mapping[str, Callable[[int], object]],
    rounds: Iterable[int],
    warm_ups: int = 1,
    before: Callable[[str], object] = lambda name: None,
    after: Callable[[str], object] = lambda name: None,
) -> dict[str, Measurement]:
    """Time each entry of `work` once per round; each round starts with the next one.

    Args:
        work: the functions to time, by name; called with the round's number. They must wait for what they
            start.
        rounds: the rounds' numbers, at least one: a `range`, or a progress bar around one.
        warm_ups: how often all are run beforehand, untimed, with the number 0.
        before: called before each run with its name, untimed.
        after: called after each run that is timed.
    """
    names = list(work)
    for _ in range(warm_ups):
        for name in names:
            before(name)
            work[name](0)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    for turn, number in enumerate(rounds):
        start = turn % len(names)
        for name in names[start:] + names[:start]:
            before(name)
            processor, began = process_time(), perf_counter()
            work[name](number)
            times[name].append((perf_counter() - began, process_time() - processor))
            after(name)
    return {name: Measurement(name, *zip(*samples, strict=True)) for name, samples in times.items()}
