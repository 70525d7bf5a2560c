"""Numbers that programs and events give to screens: refused if a program gave them, dropped if an event
did."""

from __future__ import annotations

from typing import Any, Final

from rhi.errors.arguments import ArgumentChecker

_LARGEST: Final = 1e9
"""Of notches, turns, parts of an image, seconds and pixels in one event."""


def check_number(
    call: str, name: str, value: Any, *, above: float | None = None, minimum: float | None = None
) -> float:
    """Return a finite number as a float; refuse anything else, and a number that isn't `above` a bound.

    Raises:
        ValidationError: `device-argument`.
    """
    check = ArgumentChecker(call)
    number = float(check.number(name, value, minimum))
    if above is not None and number <= above:
        check.fail(name, value, f"a finite number above {above:g}")
    return number


def are_gestures(*numbers: float) -> bool:
    """True if all of these numbers can be a person's: finite, and not absurdly large. Others are dropped."""
    return all(-_LARGEST <= number <= _LARGEST for number in numbers)  # false for NaN
