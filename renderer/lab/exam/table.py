"""The cases of the exam, by number: those of the catalogue `cases.toml`, each with what measures it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from renderer import rules
from renderer.lab.exam import absolute, encodings, inputs, lights, limits, places, plans, seams, shadows, stereo
from renderer.lab.exam import visibility as culling
from renderer.lab.exam.case import Case
from rhi import refuse

_SUBJECTS: Final = (culling, lights, encodings, places, stereo, shadows, plans, inputs, limits, absolute, seams)
MEASURES: Final = {number: measure for subject in _SUBJECTS for number, measure in subject.MEASURES.items()}


def _read_cases() -> Iterator[Case]:
    groups = tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))
    for group in groups.values():
        shared = {name: value for name, value in group.items() if not isinstance(value, dict)}
        for number in group.keys() - shared.keys():
            given: dict[str, Any] = {"needs": (), **shared, **group[number]}
            given["needs"] = tuple(given["needs"])
            yield Case(int(number), measure=MEASURES[int(number)], **given)


CASES: Final[dict[int, Case]] = {case.number: case for case in sorted(_read_cases(), key=lambda case: case.number)}
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
