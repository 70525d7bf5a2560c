"""What each rung of the ladder adds to the time of a frame, and what is left of it once it is removed.

All renderers alternate in one process, and times are those of the processor in all threads, with 95 % intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Final

import rhi
from renderer.measure import Measurement, alternate
from renderer.measure.alternate import find_interval
from renderer.need.counting import Ascent, open_without, remove
from renderer.overlay import Overlay

__rhi_internal__ = True

_WARM: Final = 12
"""Frames that aren't timed: kernels are built and replaced by better ones."""


@dataclass(frozen=True, slots=True)
class Interval:
    """A median, and the limits between which it is with 95 % confidence."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Interval:
        """Return the median of what was sampled."""
        return cls(median(values), *find_interval(values))


@dataclass(frozen=True, slots=True)
class RungTime:
    """The processor's milliseconds in a frame with all rungs up to this one, and what this one adds."""

    frame: Interval
    added: Interval | None


def time_rungs(device: rhi.Device, numbers: Sequence[int], rounds: Iterable[int]) -> dict[int, RungTime]:
    """Time frames of the scenes of rungs, of which one is drawn after the other in each round.

    What a rung adds is its difference to the one before it in `numbers`.
    """
    with ExitStack() as made:
        ascents = {}
        for number in numbers:
            ascents[str(number)] = ascent = Ascent(device, number + 1)
            made.callback(ascent.destroy)
        times = _alternate(ascents, rounds)
    found: dict[int, RungTime] = {}
    last: Measurement | None = None
    for number in numbers:
        one = times[str(number)]
        added = None if last is None else _subtract(one, last)
        found[number] = RungTime(Interval.of(_in_milliseconds(one)), added)
        last = one
    return found


def time_removal(device: rhi.Device, number: int, rounds: Iterable[int]) -> Interval:
    """Return the time of a frame of a scene from which an effect was removed, as a multiple of that of one that never
    had it."""
    with ExitStack() as made:
        never = open_without(device, number)
        made.callback(never.destroy)
        removed = remove(device, number)
        made.callback(removed.destroy)
        times = _alternate({"never": never, "removed": removed}, rounds)
    one, other = times["removed"], times["never"]
    both = zip(one.processor_seconds, other.processor_seconds, strict=True)
    return Interval.of([a / b for a, b in both])


def _alternate(ascents: dict[str, Ascent], rounds: Iterable[int]) -> dict[str, Measurement]:
    """Time the next frames of all; each is drawn from the same place in every round."""

    def draw(ascent: Ascent, _: int) -> None:
        ascent.render()
        ascent.renderer.device.finish()

    def prepare(name: str) -> None:
        device = ascents[name].renderer.device
        if device.backend_name == "null":
            device.stream.clear()
        has_overlay = any(isinstance(layer, Overlay) for layer in ascents[name].renderer.layers)
        if device.timing != has_overlay and device.capabilities.timestamps:
            device.timing = has_overlay

    return alternate(
        {name: partial(draw, ascent) for name, ascent in ascents.items()}, rounds, warm_ups=_WARM, before=prepare
    )


def _in_milliseconds(one: Measurement) -> list[float]:
    return [1e3 * seconds for seconds in one.processor_seconds]


def _subtract(one: Measurement, other: Measurement) -> Interval:
    both = zip(_in_milliseconds(one), _in_milliseconds(other), strict=True)
    return Interval.of([a - b for a, b in both])
