"""A case of the exam: something that goes wrong easily, the reference that says what is right, and by how much a device
may be off. What a case is about stands in the catalogue, `cases.toml`; what measures it, in `MEASURES` of a module.

A case measures and never judges: `measure` draws or computes on a device and returns what it has found. Its error is
compared with the tolerance in one place (`Case.judge`), for the command line and for the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi import Capabilities, Device

DRAWS, COMPUTES, NOTHING = "draws", "computes", "no device"
"""What cases ask of a device."""
Picture = NDArray[Any]
"""An image (height, width, 4) uint8 of sRGB colours, or errors (height, width) of another type, shown by brightness."""


@dataclass(frozen=True, slots=True)
class Found:
    """The findings of a case on a device.

    Attributes:
        error: how far the device is off the reference, in the case's unit. What isn't a number fails.
        numbers: what a reader looks at, by name; the parts that the error is made of come first.
        holds: what must be true besides, by its statement: mostly that the case would notice an error.
        pictures: makes the case's pictures, by title; called only if somebody wants to see them.
    """

    error: float
    numbers: Mapping[str, object] = field(default_factory=dict)
    holds: Mapping[str, bool] = field(default_factory=dict)
    pictures: Callable[[], Mapping[str, Picture]] = dict


Measures = Mapping[int, Callable[[Device], Found]]
"""What finds the errors of cases on a device, by the cases' numbers."""


def find_largest(*errors: float) -> float:
    """Return the largest error, NaN if one is NaN: where `max` would pass over it."""
    return float(np.max(errors))


@dataclass(frozen=True, slots=True)
class Case:
    """A hard case.

    Attributes:
        number: by which it is asked for; those up to 51 are known from the literature on the techniques.
        about: what is hard, in a few words.
        reference: what the device is compared with.
        tolerance: the greatest error that passes, in `unit`. why: the reason why it may be that large, and no larger.
        measure: finds the error on a device.
        needs: names of the capabilities without which the case doesn't apply.
        is_long: whether it takes so long that it is left out unless it is asked for.
    """

    number: int
    about: str
    reference: str
    tolerance: float
    unit: str
    why: str
    measure: Callable[[Device], Found]
    needs: tuple[str, ...] = ()
    is_long: bool = False

    @property
    def asks(self) -> str:
        """What the case asks of a device: that it draws, or computes, or nothing."""
        return DRAWS if "renders" in self.needs else COMPUTES if self.needs else NOTHING

    def find_lack(self, can: Capabilities) -> str | None:
        """Return the first capability that the case needs and a device lacks, or None."""
        return next((name for name in self.needs if not getattr(can, name)), None)

    def judge(self, found: Found) -> bool:
        """Return whether a device has passed."""
        return found.error <= self.tolerance and all(found.holds.values())
