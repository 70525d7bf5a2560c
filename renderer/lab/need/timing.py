"""Times that each rung of the ladder adds to a frame, and that are left once it is removed.

All renderers alternate in one process, and times are those of the processor in all threads, with 95 % intervals.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import Final

import rhi
from renderer.frame import SeenFeatures, find_needs
from renderer.lab.comparison import forget_commands
from renderer.lab.measure import Measurement, alternate
from renderer.lab.measure.alternate import Interval
from renderer.lab.need.counting import Ascent, open_without, remove
from renderer.lab.need.ladder import move_eye
from renderer.layers.overlay import Overlay

_WARM: Final = 12
"""Frames that aren't timed: kernels are built and replaced by better ones."""
_ASKED: Final = 20
"""The number of times that a frame's needs are found for one measurement, which a clock can tell."""


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
        times = {int(name): time.in_milliseconds() for name, time in _alternate(ascents, rounds).items()}
    added = {number: times[number] - times[number - 1] for number in numbers if number - 1 in times}
    return {
        number: RungTime(Interval.of(times[number]), Interval.of(added[number]) if number in added else None)
        for number in numbers
    }


def time_removal(device: rhi.Device, number: int, rounds: Iterable[int]) -> Interval:
    """Return the time of a frame of a scene from which an effect was removed, as a multiple of that of one that never
    had it."""
    with ExitStack() as made:
        never = open_without(device, number)
        made.callback(never.destroy)
        removed = remove(device, number)
        made.callback(removed.destroy)
        times = _alternate({"never": never, "removed": removed}, rounds)
    return Interval.of(times["removed"].in_milliseconds() / times["never"].in_milliseconds())


def _alternate(ascents: dict[str, Ascent], rounds: Iterable[int]) -> dict[str, Measurement]:
    """Time the next frames of all; each is drawn from the same place in every round."""

    def draw(ascent: Ascent, _: int) -> None:
        ascent.render()
        ascent.renderer.device.finish()

    def prepare(name: str) -> None:
        device = ascents[name].renderer.device
        forget_commands(device)
        has_overlay = any(isinstance(layer, Overlay) for layer in ascents[name].renderer.layers)
        if device.timing != has_overlay and device.capabilities.timestamps:
            device.timing = has_overlay

    return alternate(
        {name: partial(draw, ascent) for name, ascent in ascents.items()}, rounds, warm_ups=_WARM, before=prepare
    )


@dataclass(frozen=True, slots=True)
class Asking:
    """The cost of finding what a frame needs: microseconds, and the share of the frame's processor time."""

    microseconds: Interval
    share: Interval


def time_asking(device: rhi.Device, rounds: int) -> Asking:
    """Time how long a frame of the scene with nothing but a box takes to find that it needs no effect, as before."""
    ascent = Ascent(device, 2)
    renderer, camera = ascent.renderer, move_eye(0).with_aspect(ascent.renderer.size[0] / ascent.renderer.size[1])
    features, last = SeenFeatures(ascent.scene), None

    def ask(_: int) -> None:
        nonlocal last
        for _turn in range(_ASKED):
            seen = features.settle(camera)
            last = find_needs(ascent.scene, camera, reaches=renderer.resources.reaching, seen=seen, last=last)

    def draw(_: int) -> None:
        ascent.render()
        device.finish()

    times = alternate(
        {"ask": ask, "frame": draw}, range(rounds), warm_ups=_WARM, before=lambda _: forget_commands(device)
    )
    ascent.destroy()
    asked, drawn = times["ask"].in_milliseconds() / _ASKED, times["frame"].in_milliseconds()
    return Asking(Interval.of(1e3 * asked), Interval.of(asked / drawn))
