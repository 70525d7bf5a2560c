"""Comparison of times: each round runs all candidates once, so that disturbances of the machine affect all alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from time import perf_counter, process_time
from typing import Final

import numpy as np

_RESAMPLES: Final = 2000


@dataclass(frozen=True, slots=True)
class Measurement:
    """The times of one candidate in seconds, round by round: by the clock, and those of the processor in all threads,
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

    def ratio_to(self, other: Measurement) -> float:
        """Return the median over the rounds of the ratio of this time to the other's in the same round."""
        return median(a / b for a, b in zip(self.seconds, other.seconds, strict=True))

    def processor_ratio_to(self, other: Measurement) -> float:
        """Return the median over the rounds of the ratio of processor times in the same round."""
        both = zip(self.processor_seconds, other.processor_seconds, strict=True)
        return median(a / b for a, b in both)

    def ratio_interval(self, other: Measurement) -> tuple[float, float]:
        """Return the limits between which `ratio_to` is with 95 % confidence."""
        return find_interval([a / b for a, b in zip(self.seconds, other.seconds, strict=True)])

    def processor_ratio_interval(self, other: Measurement) -> tuple[float, float]:
        """Return the limits between which `processor_ratio_to` is with 95 % confidence."""
        both = zip(self.processor_seconds, other.processor_seconds, strict=True)
        return find_interval([a / b for a, b in both])


def find_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the limits between which the median of what was sampled is with 95 % confidence.

    It is a bootstrap: the medians of samples drawn from the sample itself, with replacement. The same values have the
    same limits.
    """
    drawn = np.random.default_rng(0).choice(np.asarray(values), (_RESAMPLES, len(values)))
    low, high = np.quantile(np.median(drawn, axis=1), (0.025, 0.975)).tolist()
    return low, high


def alternate(
    work: Mapping[str, Callable[[int], object]], rounds: Iterable[int], warm_ups: int = 1,
    before: Callable[[str], object] = lambda name: None,
) -> dict[str, Measurement]:  # fmt: skip
    """Time each entry of `work` once per round; each round starts with another one.

    Args:
        work: the functions to time, by name; called with the round's number. They must wait for what they start.
        rounds: the rounds' numbers, at least one: a `range`, or a progress bar around one.
        warm_ups: how often all are run beforehand, untimed, with the number 0.
        before: called before each run with its name, untimed.
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
    return {name: Measurement(name, *zip(*some, strict=True)) for name, some in times.items()}
