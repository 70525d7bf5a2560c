"""Comparing times: one round runs everything once, so that whatever disturbs a machine disturbs all alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from statistics import median
from time import perf_counter


@dataclass(frozen=True, slots=True)
class Measurement:
    """The times of one of the things compared, in seconds, round by round."""

    name: str
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Seconds."""
        return median(self.seconds)

    def ratio_to(self, other: Measurement) -> float:
        """The median over the rounds of this time to the other's of the same round."""
        return median(a / b for a, b in zip(self.seconds, other.seconds, strict=True))


def alternate(
    work: Mapping[str, Callable[[int], object]], rounds: Iterable[int], warm_ups: int = 1,
    before: Callable[[str], object] = lambda name: None,
) -> dict[str, Measurement]:  # fmt: skip
    """Time each of `work` once a round; each round starts with the next of them.

    Args:
        work: what to time, by name; called with the round's number. It must wait for what it starts.
        rounds: the rounds' numbers, at least one: a `range`, or a progress bar around one.
        warm_ups: how often all are run before, untimed, with the number 0.
        before: what is done untimed before each run, given its name.
    """
    names = list(work)
    for _ in range(warm_ups):
        for name in names:
            before(name)
            work[name](0)
    times: dict[str, list[float]] = {name: [] for name in names}
    for turn, number in enumerate(rounds):
        start = turn % len(names)
        for name in names[start:] + names[:start]:
            before(name)
            began = perf_counter()
            work[name](number)
            times[name].append(perf_counter() - began)
    return {name: Measurement(name, tuple(seconds)) for name, seconds in times.items()}
