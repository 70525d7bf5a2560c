"""Fixed time steps: a simulation takes equal ones at any frame rate, so it behaves the same on every machine.

steps = FixedSteps(120)
def draw():
    for _ in steps.advance():
        before, now = now, simulate(now, steps.seconds)
    show(before + (now - before) * steps.part)
"""

from __future__ import annotations

from time import perf_counter

from rhi.errors.arguments import ArgumentChecker
from rhi_screen.arguments import check_number


class FixedSteps:
    """Divides the time between frames into steps.

    Attributes:
        seconds: of a step.
        max_steps: how many steps a frame takes at most. Time beyond them is dropped: a simulation that is
            slower than the clock slows down, instead of taking longer and longer.
        part: the part of a step, from 0 to 1, that has passed since the last one.

    Examples:
        >>> steps = FixedSteps(60)
        >>> for _ in steps.advance():
        ...     pass  # a simulation's step of `steps.seconds`
    """

    def __init__(self, rate: float = 60.0, max_steps: int = 8) -> None:
        """
        Args:
            rate: steps a second.
            max_steps: the most steps of a frame.

        Raises:
            ValidationError: `device-argument` for a rate that isn't above 0, or fewer steps than 1.
        """
        self.seconds = 1.0 / check_number("FixedSteps", "rate", rate, above=0.0)
        check_number("FixedSteps", "rate", self.seconds, above=0.0)  # a rate next to 0 has no inverse
        self.max_steps = ArgumentChecker("FixedSteps").integer("max_steps", max_steps, 1)
        self.part = 0.0
        self._time: float | None = None

    def advance(self, seconds: float | None = None) -> range:
        """Return the numbers of the steps that have passed.

        Args:
            seconds: the time since the last call; None: as a clock says, 0 the first time.

        Raises:
            ValidationError: `device-argument` for a time that is negative or not finite.
        """
        if seconds is None:
            now = perf_counter()
            seconds, self._time = 0.0 if self._time is None else now - self._time, now
        seconds = check_number("FixedSteps.advance", "seconds", seconds, minimum=0.0)
        passed = self.part + seconds / self.seconds
        count = int(passed + 1e-9)  # 0.1 ten times is a second
        self.part = max(passed - count, 0.0)
        return range(min(count, self.max_steps))
