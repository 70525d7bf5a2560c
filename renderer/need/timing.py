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
from renderer.frame import find_needs
from renderer.layers.overlay import Overlay
from renderer.measure import Measurement, alternate
from renderer.measure.alternate import find_interval
from renderer.need.counting import Ascent, open_without, remove
from renderer.need.ladder import move_eye

__rhi_internal__ = True

_WARM: Final = 12
"""Frames that aren't timed: kernels are built and replaced by better ones."""
_ASKED: Final = 20
"""How often a frame's needs are found for one measurement, which a clock can tell."""


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

    What a rung adds is its difference to the one before it on the ladder.
    """
    drawn = sorted({each for number in numbers for each in (number - 1, number) if each >= 0})
    with ExitStack() as made:
        ascents = {}
        for number in drawn:
            ascents[str(number)] = ascent = Ascent(device, number + 1)
            made.callback(ascent.destroy)
        times = _alternate(ascents, rounds)
    found: dict[int, RungTime] = {}
    for number in numbers:
        one, before = times[str(number)], times.get(str(number - 1))
        added = None if before is None else _subtract(one, before)
        found[number] = RungTime(Interval.of(_in_milliseconds(one)), added)
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


@dataclass(frozen=True, slots=True)
class Asking:
    """What it takes to find what a frame needs: microseconds, and the share of the frame's processor time."""

    microseconds: Interval
    share: Interval


def time_asking(device: rhi.Device, rounds: int) -> Asking:
    """Time how long a frame of the scene with nothing but a box takes to find that it needs no effect."""
    ascent = Ascent(device, 2)
    renderer, camera = ascent.renderer, move_eye(0).with_aspect(ascent.renderer.size[0] / ascent.renderer.size[1])

    def ask(_: int) -> None:
        for _turn in range(_ASKED):
            find_needs(ascent.scene, camera, reaches=renderer.resources.reaching)

    def draw(_: int) -> None:
        ascent.render()
        device.finish()

    def prepare(_: str) -> None:
        if device.backend_name == "null":
            device.stream.clear()

    times = alternate({"ask": ask, "frame": draw}, range(rounds), warm_ups=_WARM, before=prepare)
    ascent.destroy()
    asked = [seconds / _ASKED for seconds in times["ask"].processor_seconds]
    both = zip(asked, times["frame"].processor_seconds, strict=True)
    return Asking(Interval.of([1e6 * seconds for seconds in asked]), Interval.of([a / b for a, b in both]))
