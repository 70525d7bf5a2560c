"""Random faults that no test can see, by kind, each with the reason: those of `undetectable_faults.txt`.

A fault is named by its file, the line that it changes and the change, so the list holds while lines move. One
whose line is gone is refused by a test.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

KINDS: Final = {
    "COST": "the same results; only time, memory or the number of kernels differs",
    "SAME": "the same value for all arguments that can occur",
    "GUARD": "a second guard: another check refuses the same",
    "WORDS": "the wording of a text for people",
    "LOOK": "a measure of how something looks, for which another number is as right",
    "DRIVER": "another driver would show it; the installed ones behave alike",
}
"""Why a fault can't be seen."""


class UndetectableFault(NamedTuple):
    """A fault that can't be seen: in the line `text` of `file`, `old` becomes `new`. `why` begins with its
    kind."""

    file: str
    text: str
    old: str
    new: str
    why: str


def _read() -> Iterator[UndetectableFault]:
    for part in Path(__file__).with_suffix(".txt").read_text(encoding="utf-8").split("\n\n")[1:]:
        file, text, change, why = (line.strip() for line in part.strip("\n").split("\n"))
        old, new = change.split(" → ")
        kind, reason = why.split(": ", 1)
        yield UndetectableFault(file, text, old, new, f"{KINDS[kind]}: {reason}")


UNDETECTABLE_FAULTS: Final = tuple(_read())


def explain(file: str, text: str, old: str, new: str) -> str:
    """Return why a fault can't be seen, "" if no reason is known."""
    return next((fault.why for fault in UNDETECTABLE_FAULTS if fault[:4] == (file, text, old, new)), "")
