"""A case of the exam: something that goes wrong easily, a reference, and the largest error that passes.

The catalogue `cases.toml` describes cases; `MEASURES` of a module has the function that measures each. A case
measures and never decides: `measure` draws or computes on a device and returns a `CaseResult`. Its error is
compared with the tolerance in one function (`Case.passes`), for the command line and for the tests.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi import Capabilities, Device

DRAWS, COMPUTES, NOTHING = "draws", "computes", "no device"
"""How cases use a device."""
CaseImage = NDArray[Any]
"""An image (height, width, 4) uint8 of sRGB colours, or errors (height, width) of another type, shown by
brightness."""


@dataclass(frozen=True, slots=True)
class CaseResult:
    """The result of a case on a device.

    Attributes:
        error: the device's error against the reference, in the case's unit. NaN fails.
        numbers: figures for a reader, by name; the parts that the error is made of come first.
        holds: further conditions, by their statement: mostly that the case would notice an error.
        images: makes the case's images, by title; called only if somebody wants to see them.
    """

    error: float
    numbers: Mapping[str, object] = field(default_factory=dict)
    holds: Mapping[str, bool] = field(default_factory=dict)
    images: Callable[[], Mapping[str, CaseImage]] = dict


Measures = Mapping[int, Callable[[Device], CaseResult]]
"""Functions that measure cases on a device, by the cases' numbers."""


_STOPS: Final[ContextVar[bool]] = ContextVar("whether a case stops at its first failure", default=False)


class FirstFailureError(Exception):
    """A condition of a case doesn't hold, and nobody asks for its other figures."""


@contextmanager
def stop_at_first_failure() -> Iterator[None]:
    """End cases inside the context at their first condition that doesn't hold: whatever they would measure
    next, they fail."""
    before = _STOPS.set(True)
    try:
        yield
    finally:
        _STOPS.reset(before)


def check_early(holds: Mapping[str, bool]) -> None:
    """Check conditions without which a case fails; call it where a case has much to measure after them.

    Raises:
        FirstFailureError: one isn't true, inside `stop_at_first_failure`.
    """
    if _STOPS.get() and not all(holds.values()):
        raise FirstFailureError(
            ", ".join(description for description, is_true in holds.items() if not is_true)
        )


def largest_error(*errors: float) -> float:
    """The largest error; NaN if any is NaN, which `max` would ignore."""
    return float(np.max(errors))


@dataclass(frozen=True, slots=True)
class Case:
    """A hard case.

    Attributes:
        number: selects the case; those up to 51 are known from the literature on the techniques.
        description: what is hard, in a few words.
        reference: what the device is compared with.
        tolerance: the greatest error that passes, in `unit`.
        why: the reason why it may be that large, and no larger.
        measure: measures the error on a device.
        requires: names of the capabilities without which the case doesn't apply.
        is_long: whether it takes so long that it only runs if it is named.
    """

    number: int
    description: str
    reference: str
    tolerance: float
    unit: str
    why: str
    measure: Callable[[Device], CaseResult]
    requires: tuple[str, ...] = ()
    is_long: bool = False

    @property
    def device_use(self) -> str:
        """The use that the case makes of a device: it draws, or computes, or doesn't use it."""
        return DRAWS if "renders" in self.requires else COMPUTES if self.requires else NOTHING

    def find_missing_capability(self, can: Capabilities) -> str | None:
        """The first capability that the case needs and a device lacks, or None."""
        return next((name for name in self.requires if not getattr(can, name)), None)

    def passes(self, result: CaseResult) -> bool:
        """True if a result passes."""
        return result.error <= self.tolerance and all(result.holds.values())
