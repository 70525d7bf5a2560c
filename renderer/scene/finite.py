"""The check that numbers are finite, where users may write any number into arrays and fields.

A NaN in one light would be the colour of every pixel that it reaches, and one in a camera would hide the
scene, both without a word. So what may be assigned is checked when it is used, and refused before anything
else has happened.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from rhi.errors import Rule, describe_value, refuse
from rhi.errors.array_likes import to_real_array
from rhi.math.arguments import read_floats

LONGEST_TIME: Final = 1e12  # seconds: steps of a microsecond can be counted, and 0.1 ms be told apart


def check_finite(call: str, **values: ArrayLike) -> None:
    """Refuse values that aren't finite: `scene-not-finite`."""
    for name, value in values.items():
        if value.__class__ is float and isfinite(value):
            continue
        try:
            is_finite = np.logical_and.reduce(np.isfinite(to_real_array(value)), axis=None)
        except (TypeError, ValueError, OverflowError):  # no numbers, or too large ones
            is_finite = False
        if not is_finite:
            refuse(rules.NOT_FINITE, f"{call}: {name}", describe_value(value), "finite numbers")


def read_points(rule: Rule, call: str, points: ArrayLike) -> NDArray[np.float64]:
    """Return finite points (n, 3) as float64; refuse anything else by `rule`."""
    read = read_floats(call, points, 3, rule=rule)
    if read.ndim != 2 or not np.isfinite(read).all():
        refuse(rule, call, points, "finite points of shape (n, 3)")
    return read


def check_time(call: str, seconds: float) -> None:
    """Refuse a time that isn't finite (`scene-not-finite`), or too far from 0 to count steps to it
    (`animation-time`)."""
    if not (seconds.__class__ is float and isfinite(seconds)):
        check_finite(call, seconds=seconds)
        if np.ndim(seconds):
            refuse(rules.BAD_TIME, f"{call}: seconds", seconds, "a number")
    if abs(seconds) > LONGEST_TIME:
        refuse(rules.BAD_TIME, f"{call}: seconds", seconds, f"{-LONGEST_TIME:g} to {LONGEST_TIME:g}")


class FiniteArrays:
    """Remembers structured arrays and numbers that were checked, and checks them again when they have
    changed."""

    def __init__(self) -> None:
        self._checked: dict[str, bytes] = {}

    def check(
        self,
        call: str,
        arrays: Mapping[str, NDArray[Any]],
        check_more: Mapping[str, Callable[[str, NDArray[Any]], None]] = MappingProxyType({}),
    ) -> None:
        """Refuse arrays of numbers, or of structs of them, that aren't finite, by the name and row of the
        first.

        Args:
            check_more: by name, functions of the call and the array that refuse more.
        """
        for name, array in arrays.items():
            contents = array.tobytes()
            if self._checked.get(name) == contents:
                continue
            for field in array.dtype.names or ("",):
                part = array[field] if field else array
                if part.dtype.kind != "f" or np.isfinite(part).all():
                    continue
                row = int(np.flatnonzero(~np.isfinite(part).reshape(len(part), -1).all(1))[0])
                where = f"{name}[{row}]" + (f"[{field!r}]" if field else "")
                refuse(rules.NOT_FINITE, f"{call}: {where}", part[row], "finite numbers")
            if name in check_more:
                check_more[name](f"{call}: {name}", array)
            self._checked[name] = contents
