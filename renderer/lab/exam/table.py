"""The cases of the exam, by number."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from renderer import rules
from renderer.lab.exam import absolute, encodings, inputs, lights, limits, places, plans, shadows, stereo, visibility
from renderer.lab.exam.case import Case
from rhi import refuse

_SUBJECTS: Final = (visibility, lights, encodings, places, stereo, shadows, plans, inputs, limits, absolute)
CASES: Final[dict[int, Case]] = {
    case.number: case
    for case in sorted((case for subject in _SUBJECTS for case in subject.CASES), key=lambda case: case.number)
}
"""All cases, in the order of their numbers."""


def find_cases(numbers: Sequence[int], *, are_long: bool = False) -> list[Case]:
    """Return the cases with these numbers, or all of them if there is no number; those that take long only if they are
    named, or `are_long`."""
    for number in numbers:
        if number not in CASES:
            refuse(rules.UNKNOWN_CASE, f"find_cases([{number}])", number, f"1 to {max(CASES)}")
    if numbers:
        return [CASES[number] for number in numbers]
    return [case for case in CASES.values() if are_long or not case.is_long]
