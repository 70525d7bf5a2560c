"""The kinds of arguments: what counts as a whole number, a number, a flag, a text, a choice, an array.

- A call checks its arguments where things are made, bound, copied, locked and passed, before any of them has an effect.
  Draws call nothing of this: they compare what they are given with what was checked before.
- A whole number is what Python accepts as an index: an `int` or one of NumPy's integers, also as an array without
  dimensions. A number may also be one of Python's or NumPy's floats, and is finite. A bool is neither, and a number is
  not a flag.
- What passes comes back as Python's own type, so that backends, recorded commands and traces meet no other.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from numbers import Real
from operator import index
from typing import Any, Final, NoReturn, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rhi.errors import Rule, refuse
from rhi.errors.rules import DEVICE_ARGUMENT

E = TypeVar("E", bound=enum.Enum)
T = TypeVar("T")
C = TypeVar("C", tuple[Any, ...], frozenset[Any])

_LARGEST: Final = 3.4028235e38
"""The largest 32-bit float, which bounds every number that a shader or a driver receives."""


class Arguments:
    """The arguments of one call. Each method returns an argument in its proper type, or refuses it by name.

    Attributes:
        call: the call, as its refusals show it.
        rule: the rule that a wrong argument breaks.
    """

    __slots__ = ("_refuse", "call", "rule")

    def __init__(self, call: str, refuse: Callable[..., NoReturn] = refuse, rule: Rule = DEVICE_ARGUMENT) -> None:
        """
        Args:
            refuse: raises the error: that of the device's `Core`, which keeps it beside the recorded commands, or by
                default `rhi.errors.refuse`.
        """
        self.call = call
        self.rule = rule
        self._refuse = refuse

    def fail(self, name: str, value: object, allowed: str, tip: str = "") -> NoReturn:
        """Refuse an argument."""
        self._refuse(self.rule, self.call, f"{name}={_show(value)}", allowed, tip)

    def whole(self, name: str, value: Any, least: int | None = None, most: int | None = None) -> int:
        """Return a whole number from `least` to `most` as an int."""
        number = as_whole(value)
        if number is None or (least is not None and number < least) or (most is not None and number > most):
            tip = "whole numbers come from `//`, int(…) or round(…)" if _is_real(value) else ""
            self.fail(name, value, "a whole number" + _bounds(least, most), tip)
        return number

    def whole_or_none(self, name: str, value: Any, least: int | None = None, most: int | None = None) -> int | None:
        """Return a whole number as an int, or None."""
        return None if value is None else self.whole(name, value, least, most)

    def number(self, name: str, value: Any, least: float | None = None, most: float | None = None) -> float:
        """Return a finite number from `least` to `most` as a float; a whole number stays an int."""
        number = _as_number(value)
        if (
            number is None
            or not -_LARGEST <= number <= _LARGEST  # false for NaN too
            or (least is not None and number < least)
            or (most is not None and number > most)
        ):
            self.fail(name, value, "a finite number" + _bounds(least, most))
        return number

    def color(self, name: str, value: Any) -> tuple[float, float, float, float]:
        """Return four finite numbers as a tuple. Whole numbers stay ints, for targets of integers."""
        parts = tuple(value) if isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, str) else ()
        numbers = tuple(map(_as_number, parts))
        if len(numbers) != 4 or not all(n is not None and -_LARGEST <= n <= _LARGEST for n in numbers):
            self.fail(name, value, "4 finite numbers: red, green, blue, alpha")
        return cast("tuple[float, float, float, float]", numbers)

    def flag(self, name: str, value: Any) -> bool:
        """Return a bool."""
        if value is True or value is False or isinstance(value, np.bool_):
            return bool(value)
        self.fail(name, value, "True or False")

    def text(self, name: str, value: Any) -> str:
        """Return a str."""
        if not isinstance(value, str):
            self.fail(name, value, "a str")
        return value

    def choice(self, name: str, value: Any, kind: type[E]) -> E:
        """Return a member of an enum."""
        if not isinstance(value, kind):
            self.fail(name, value, describe_choices(kind))
        return value

    def instance(self, name: str, value: Any, kind: type[T] | tuple[type[T], ...], allowed: str) -> T:
        """Return an object of one of these classes; `allowed` says which, and where they come from."""
        if not isinstance(value, kind):
            self.fail(name, value, allowed)
        return value

    def members(self, name: str, value: Any, collection: type[C], kind: type) -> C:
        """Return a tuple or frozenset of objects of one class; a bool is no int."""
        if not isinstance(value, collection) or not all(
            isinstance(each, kind) and not isinstance(each, bool) for each in value
        ):
            self.fail(name, value, f"a {collection.__name__} of {kind.__name__}")
        return value

    def array(self, name: str, value: Any) -> NDArray[Any]:
        """Return whatever NumPy makes an array of. Its dtype and shape are up to the caller."""
        try:
            return np.asarray(value)
        except (TypeError, ValueError, OverflowError) as error:
            self.fail(name, value, f"an array ({error})")


class Fields(Arguments):
    """The fields of a frozen dataclass that is being created. Each is checked, and kept in its proper type.

    It belongs into `__post_init__`: `Fields(self).wholes("x", "y", least=0)`.
    """

    __slots__ = ("_value",)

    def __init__(self, value: object, rule: Rule = DEVICE_ARGUMENT) -> None:
        super().__init__(type(value).__name__, rule=rule)
        self._value = value

    def wholes(self, *names: str, least: int | None = None, most: int | None = None) -> None:
        """Make these fields whole numbers."""
        for name in names:
            self._keep(name, self.whole(name, getattr(self._value, name), least, most))

    def wholes_or_none(self, *names: str, least: int | None = None, most: int | None = None) -> None:
        """Make these fields whole numbers, except those that are None."""
        self.wholes(*(name for name in names if getattr(self._value, name) is not None), least=least, most=most)

    def numbers(self, *names: str, least: float | None = None, most: float | None = None) -> None:
        """Make these fields finite numbers."""
        for name in names:
            self._keep(name, self.number(name, getattr(self._value, name), least, most))

    def flags(self, *names: str) -> None:
        """Make these fields bools."""
        for name in names:
            self._keep(name, self.flag(name, getattr(self._value, name)))

    def choices(self, kind: type[enum.Enum], *names: str) -> None:
        """Refuse those of these fields that are no members of an enum."""
        for name in names:
            self.choice(name, getattr(self._value, name), kind)

    def choices_or_none(self, kind: type[enum.Enum], *names: str) -> None:
        """Refuse those of these fields that are neither members of an enum nor None."""
        self.choices(kind, *(name for name in names if getattr(self._value, name) is not None))

    def colors(self, *names: str) -> None:
        """Make these fields tuples of four numbers."""
        for name in names:
            self._keep(name, self.color(name, getattr(self._value, name)))

    def _keep(self, name: str, value: object) -> None:
        object.__setattr__(self._value, name, value)  # its own __setattr__ refuses everything


def as_whole(value: Any) -> int | None:
    """Return a whole number as an int, None for anything else; a bool is none."""
    if value.__class__ is int:
        return value
    if isinstance(value, bool):
        return None
    try:
        return index(value)
    except TypeError:
        return None


def describe_choices(kind: type[enum.Enum]) -> str:
    """Return the members of an enum as a message shows them; of many, the first."""
    names = [f"{kind.__name__}.{member.name}" for member in kind]
    shown = ", ".join(names[:8])
    return shown if len(names) <= 8 else f"one of the {len(names)} members of {kind.__name__}: {shown}, …"


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _as_float(value: Any) -> float | None:
    """Return a number as a float, None for anything else; a bool is none."""
    if value.__class__ is float:
        return value
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def _as_number(value: Any) -> float | None:
    """Return a whole number as an int, another number as a float, None for anything else."""
    whole = as_whole(value)
    return _as_float(value) if whole is None else whole


def _bounds(least: float | None, most: float | None) -> str:
    if most is None:
        return "" if least is None else f", {least:g} or more"
    return f" up to {most:,}" if least is None else f" from {least:,} to {most:,}"


def _show(value: object) -> str:
    """Return a value's text for a message, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 120 else f"{text[:100]}… ({type(value).__name__})"
