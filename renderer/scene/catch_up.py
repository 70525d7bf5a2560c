"""Ways in which a simulation makes up for the time in which it wasn't drawn: three policies, each with a
bound on its cost.

- `Recompute`: the state is a function of the time. Nothing is missed.
- `Stepwise`: the state depends on its history, and missed steps are taken one by one. Steps beyond the bound
  wait for the next frames, so a member may be late, but each of its states is exact.
- `Leap`: missed steps beyond the bound are taken in one, of bounded error. A member is never late, but may be
  inexact.

The bound is on the steps that all members of a simulation take in a frame. If it isn't enough for all, the
members share it evenly, and what one doesn't need goes to the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from rhi.errors import refuse

_STEP_TOLERANCE: Final = 1e-6  # of a step: a time that rounding has put just before a step counts as the step
_RELATIVE_TOLERANCE: Final = (
    2.0**-51
)  # of the number, which after years is more: time, interval and ratio are rounded


class TimedSimulation(Protocol):
    """A simulation whose state is a function of the time."""

    def set_time(self, members: Indices, seconds: float) -> None:
        """Set the state of `members` (j,) to that of the time `seconds`, whatever it was before."""
        ...


class StepSimulation(Protocol):
    """A simulation that goes in steps of constant length.

    Attributes:
        interval: the length of a step in seconds.
    """

    interval: float

    def step(self, members: Indices, numbers: Indices) -> None:
        """Advance `members` (j,) by one `interval`, each to its step of `numbers` (j,), of which the first is
        1.

        The same steps must give the same state to the last bit, whatever other members take them.
        """
        ...


class LeapSimulation(StepSimulation, Protocol):
    """A stepped simulation that can also take many steps at once."""

    def leap(self, members: Indices, numbers: Indices, counts: Indices) -> None:
        """Advance `members` (j,) by `counts` (j,) intervals, each to its step of `numbers` (j,)."""
        ...


def count_steps(seconds: float, interval: float) -> float:
    """Return the number of whole steps in a time."""
    number = seconds / interval
    return float(int(number + max(_STEP_TOLERANCE, number * _RELATIVE_TOLERANCE)))


@dataclass(frozen=True, slots=True)
class Recompute:
    """The state is a function of the time: a `TimedSimulation`. After any absence it costs what any frame
    costs."""

    methods = ("set_time",)
    steps_per_frame = 0

    def returns_exactly(self, count: int) -> bool:
        """Return whether what returns is as if it had always been drawn: always."""
        return True

    def begin(self) -> float:
        """The state that a member has reached before its first frame: none."""
        return np.nan

    def target(self, simulation: TimedSimulation, seconds: float) -> float:
        """Return the time or the step that members must reach in a frame at `seconds`."""
        return seconds

    def advance(
        self, simulation: TimedSimulation, members: Indices, reached: Floats, target: float, budget: int
    ) -> tuple[Floats, int]:
        """Bring `members` (j,) to the time `target`; return what they have reached (j,) and the steps taken:
        none."""
        simulation.set_time(members, target)
        return np.full(len(members), target), 0


@dataclass(frozen=True, slots=True)
class Stepwise:
    """The state depends on its history: missed steps of a `StepSimulation` simulation are taken one by one.

    A member that needs more steps than it gets shows an earlier state until the next frames have brought the
    rest. When it has caught up, its state is, bit by bit, as if it had been stepped all the time.

    Attributes:
        steps_per_frame: the most steps that all members together take in a frame.
        memory: the number of steps after which an earlier state has no effect any more; None if it always has
            one. No member takes more after an absence.
    """

    steps_per_frame: int
    memory: int | None = None
    methods = ("step",)

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_SIMULATION)
        _check("Stepwise(steps_per_frame=...)", self.steps_per_frame)
        if self.memory is not None:
            _check("Stepwise(memory=...)", self.memory)

    def returns_exactly(self, count: int) -> bool:
        """Return whether `count` members that return at once are, in that frame, as if they had always been
        drawn: if a frame has steps enough for all that they remember."""
        return self.memory is not None and count * self.memory <= self.steps_per_frame

    def begin(self) -> float:
        """The step that a member has reached before its first frame: 0."""
        return 0.0

    def target(self, simulation: StepSimulation, seconds: float) -> float:
        """Return the number of the step that members are to reach in a frame at `seconds`."""
        return count_steps(seconds, simulation.interval)

    def advance(
        self, simulation: StepSimulation, members: Indices, reached: Floats, target: float, budget: int
    ) -> tuple[Floats, int]:
        """Bring `members` (j,) from their steps `reached` (j,) towards `target` in at most `budget` steps;
        return the steps that they have reached (j,), and how many were taken."""
        numbers = reached.astype(np.int64)
        if self.memory is not None:
            np.maximum(numbers, int(target) - self.memory, out=numbers)
        share = distribute_steps(int(target) - numbers, budget)
        return _take_steps(simulation, members, numbers, share), int(share.sum())


@dataclass(frozen=True, slots=True)
class Leap:
    """The state depends on its history, and many steps can be taken in one: a `LeapSimulation` simulation.

    A member that has missed more steps than it gets takes the first of them in one leap, and the rest one by
    one. It always shows the frame's time.

    Attributes:
        steps_per_frame: the most steps that all members together take in a frame. A leap is one more for its
            member.
        error: the most by which a member's state then differs from that of one that has taken all steps, in
            the unit that the simulation says.
    """

    steps_per_frame: int
    error: float
    methods = ("step", "leap")

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_SIMULATION)
        _check("Leap(steps_per_frame=...)", self.steps_per_frame)
        if not 0.0 <= self.error < np.inf:
            refuse(rules.BAD_SIMULATION, "Leap(error=...)", self.error, "a finite number, at least 0")

    def returns_exactly(self, count: int) -> bool:
        """Return whether what returns is as if it had always been drawn: not if it leaps."""
        return False

    def begin(self) -> float:
        """The step that a member has reached before its first frame: 0."""
        return 0.0

    def target(self, simulation: LeapSimulation, seconds: float) -> float:
        """Return the number of the step that members are to reach in a frame at `seconds`."""
        return count_steps(seconds, simulation.interval)

    def advance(
        self, simulation: LeapSimulation, members: Indices, reached: Floats, target: float, budget: int
    ) -> tuple[Floats, int]:
        """Bring `members` (j,) from their steps `reached` (j,) to `target`; return the steps that they have
        reached (j,), and how many were taken, a leap counting as one."""
        numbers = reached.astype(np.int64)
        missed = int(target) - numbers
        share = distribute_steps(missed, budget)
        far = np.flatnonzero(missed > share)
        if len(far):
            counts = missed[far] - share[far]
            numbers[far] += counts
            simulation.leap(members[far], numbers[far], counts)
        return _take_steps(simulation, members, numbers, share), int(share.sum()) + len(far)


CatchUp = Recompute | Stepwise | Leap
"""The policies."""


def distribute_steps(missed: Indices, budget: int) -> Indices:
    """Spread `budget` steps over members that have `missed` (j,) steps each; return how many each may take
    (j,).

    The smallest share is as large as possible, then the next one, and so on. What can't be divided goes to
    those that have missed the most, so that nobody waits forever.
    """
    if int(missed.sum()) <= budget:
        return missed.copy()
    ordered = np.sort(missed)
    others = len(missed) - np.arange(len(missed))  # each step of the level costs one for each of them
    below = np.cumsum(ordered) - ordered
    first = int(np.argmax(ordered * others + below > budget))
    level = (budget - int(below[first])) // int(others[first])
    share = np.minimum(missed, level)
    share[np.argsort(-missed, kind="stable")[: budget - int(share.sum())]] += 1
    return share


def _take_steps(simulation: StepSimulation, members: Indices, numbers: Indices, share: Indices) -> Floats:
    """Take `share` (j,) steps with `members` (j,) from `numbers` (j,) on; return the steps reached."""
    end = numbers + share
    while len(behind := np.flatnonzero(numbers < end)):
        numbers[behind] += 1
        simulation.step(members[behind], numbers[behind])
    return numbers.astype(np.float64)


def _check(call: str, value: int) -> None:
    if value < 1:
        refuse(rules.BAD_SIMULATION, call, value, "at least 1")
