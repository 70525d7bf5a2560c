"""The kinds of arguments: what counts as a whole number, a number, a flag, a text, a choice, an array.

- Calls that create, bind, copy or lock check their arguments before any effect. Draws call nothing of this:
  they compare arguments by identity with those that were checked before.
- A whole number is what Python accepts as an index: an `int` or one of NumPy's integers, also as an array
  without dimensions. A number may also be one of Python's or NumPy's floats, and is finite. A bool is
  neither, and a number is not a flag.
- Checked values are returned as Python's own types, so that backends, recorded commands and traces meet no
  others.
- Byte order belongs to an array, not to a device's memory, which is little-endian. Every array that comes in
  passes `ArgumentChecker.array` or `to_little_endian`, which convert the other order. So no call meets it.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from numbers import Real
from operator import index
from typing import Any, Final, NoReturn, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rhi.errors import Rule, describe_value, refuse
from rhi.errors.array_likes import is_masked, to_array
from rhi.errors.choices import suggest_members
from rhi.errors.rules import DEVICE_ARGUMENT

E = TypeVar("E", bound=enum.Enum)
T = TypeVar("T")
C = TypeVar("C", tuple[Any, ...], frozenset[Any])

_LARGEST: Final = 3.4028235e38
"""The largest 32-bit float, which bounds every number that a shader or a driver receives."""


class ArgumentChecker:
    """The arguments of one call. Each method returns an argument in its proper type, or refuses it by name.

    Attributes:
        call: the call, as its refusals show it.
        rule: the rule that a wrong argument breaks.
    """

    __slots__ = ("_refuse", "call", "rule")

    def __init__(
        self, call: str, refuse: Callable[..., NoReturn] = refuse, rule: Rule = DEVICE_ARGUMENT
    ) -> None:
        """
        Args:
            refuse: raises the error. A device passes its `Core.refuse`, which also records the error; the
                default is `rhi.errors.refuse`.
        """
        self.call = call
        self.rule = rule
        self._refuse = refuse

    def fail(self, name: str, value: object, allowed: str, tip: str = "") -> NoReturn:
        """Refuse an argument."""
        self._refuse(self.rule, self.call, f"{name}={_show(value)}", allowed, tip)

    def integer(self, name: str, value: Any, minimum: int | None = None, maximum: int | None = None) -> int:
        """Return a whole number from `minimum` to `maximum` as an int."""
        number = to_integer(value)
        if (
            number is None
            or (minimum is not None and number < minimum)
            or (maximum is not None and number > maximum)
        ):
            tip = "whole numbers come from `//`, int(…) or round(…)" if _is_real(value) else ""
            self.fail(name, value, "a whole number" + _bounds(minimum, maximum), tip)
        return number

    def integer_or_none(
        self, name: str, value: Any, minimum: int | None = None, maximum: int | None = None
    ) -> int | None:
        """Return a whole number as an int, or None."""
        return None if value is None else self.integer(name, value, minimum, maximum)

    def number(
        self, name: str, value: Any, minimum: float | None = None, maximum: float | None = None
    ) -> float:
        """Return a finite number from `minimum` to `maximum` as a float; a whole number stays an int."""
        number = _as_number(value)
        if (
            number is None
            or not -_LARGEST <= number <= _LARGEST  # false for NaN too
            or (minimum is not None and number < minimum)
            or (maximum is not None and number > maximum)
        ):
            self.fail(name, value, "a finite number" + _bounds(minimum, maximum))
        return number

    def color(self, name: str, value: Any) -> tuple[float, float, float, float]:
        """Return four finite numbers as a tuple. Whole numbers stay ints, for targets of integers."""
        is_ordered = isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes))
        is_ordered = is_ordered and not is_masked(value)
        parts = tuple(value) if is_ordered else ()
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
        """Return a str that drivers can be given: lone surrogates have no encoding."""
        if not isinstance(value, str):
            self.fail(name, value, "a str")
        if not value.isascii() and any("\ud800" <= character <= "\udfff" for character in value):
            self.fail(name, value, "a str without lone surrogates")
        return value

    def choice(self, name: str, value: Any, kind: type[E]) -> E:
        """Return a member of an enum."""
        if not isinstance(value, kind):
            tip = suggest_members(value, kind) if isinstance(value, str) else ""
            self.fail(name, value, describe_choices(kind), tip)
        return value

    def instance(self, name: str, value: Any, kind: type[T] | tuple[type[T], ...], allowed: str) -> T:
        """Return an object of one of these classes; `allowed` describes them in the error."""
        if not isinstance(value, kind):
            self.fail(name, value, allowed)
        return value

    def members(self, name: str, value: Any, collection: type[C], kind: type) -> C:
        """Return a tuple or frozenset of objects of one class; a bool is no int."""
        if not isinstance(value, collection) or not all(
            isinstance(member, kind) and not isinstance(member, bool) for member in value
        ):
            self.fail(name, value, f"a {collection.__name__} of {kind.__name__}")
        return value

    def array(self, name: str, value: Any) -> NDArray[Any]:
        """Return an array-like as a little-endian array. The caller checks its dtype and shape."""
        try:
            return to_little_endian(to_array(value))
        except (TypeError, ValueError) as error:
            self.fail(name, value, f"an array ({error})")


class FieldChecker(ArgumentChecker):
    """The fields of a frozen dataclass that is being created. Each is checked, and kept in its proper type.

    Use it in `__post_init__`: `FieldChecker(self).integers("x", "y", minimum=0)`.
    """

    __slots__ = ("_value",)

    def __init__(self, value: object, rule: Rule = DEVICE_ARGUMENT) -> None:
        super().__init__(type(value).__name__, rule=rule)
        self._value = value

    def integers(self, *names: str, minimum: int | None = None, maximum: int | None = None) -> None:
        """Make these fields whole numbers."""
        for name in names:
            self._set_field(name, self.integer(name, getattr(self._value, name), minimum, maximum))

    def integers_or_none(self, *names: str, minimum: int | None = None, maximum: int | None = None) -> None:
        """Make these fields whole numbers, except those that are None."""
        self.integers(
            *(name for name in names if getattr(self._value, name) is not None),
            minimum=minimum,
            maximum=maximum,
        )

    def numbers(self, *names: str, minimum: float | None = None, maximum: float | None = None) -> None:
        """Make these fields finite numbers."""
        for name in names:
            self._set_field(name, self.number(name, getattr(self._value, name), minimum, maximum))

    def flags(self, *names: str) -> None:
        """Make these fields bools."""
        for name in names:
            self._set_field(name, self.flag(name, getattr(self._value, name)))

    def choices(self, kind: type[enum.Enum], *names: str) -> None:
        """Refuse fields that are no members of an enum."""
        for name in names:
            self.choice(name, getattr(self._value, name), kind)

    def choices_or_none(self, kind: type[enum.Enum], *names: str) -> None:
        """Refuse fields that are neither members of an enum nor None."""
        self.choices(kind, *(name for name in names if getattr(self._value, name) is not None))

    def colors(self, *names: str) -> None:
        """Make these fields tuples of four numbers."""
        for name in names:
            self._set_field(name, self.color(name, getattr(self._value, name)))

    def _set_field(self, name: str, value: object) -> None:
        object.__setattr__(self._value, name, value)  # its own __setattr__ refuses everything


def to_integer(value: Any) -> int | None:
    """Return a whole number as an int, None for anything else; a bool is none."""
    if value.__class__ is int:
        return value
    if isinstance(value, bool | np.bool_) or is_masked(value):  # NumPy 1 takes its own bools as integers
        return None
    try:
        return index(value)
    except TypeError:
        return None


def to_little_endian(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array whose numbers are little-endian: itself, or a converted copy.

    Fields keep their offsets; bytes between fields become 0.
    """
    dtype = _reordered(array.dtype)
    if dtype is None:
        return array
    converted = np.zeros(array.shape, dtype)
    converted[...] = array
    return converted


def little_endian(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return a dtype with little-endian numbers, also in its fields and subarrays."""
    ordered = _reordered(dtype)
    return dtype if ordered is None else ordered


@lru_cache(maxsize=1024)
def _reordered(dtype: np.dtype[Any]) -> np.dtype[Any] | None:
    """Return a dtype as little-endian, or None if it is already."""
    ordered = dtype.newbyteorder("<")
    return None if ordered == dtype else ordered


def describe_choices(kind: type[enum.Enum]) -> str:
    """Text of an enum's members for a message; of a long enum, the first eight."""
    names = [f"{kind.__name__}.{member.name}" for member in kind]
    listed = ", ".join(names[:8])
    return listed if len(names) <= 8 else f"one of the {len(names)} members of {kind.__name__}: {listed}, …"


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
    except (OverflowError, TypeError):  # too large; a time span, which NumPy counts among the integers
        return None


def _as_number(value: Any) -> float | None:
    """Return a whole number as an int, another number as a float, None for anything else."""
    integer = to_integer(value)
    return _as_float(value) if integer is None else integer


def _bounds(minimum: float | None, maximum: float | None) -> str:
    if maximum is None:
        return "" if minimum is None else f", {minimum:g} or more"
    return f" up to {maximum:,}" if minimum is None else f" from {minimum:,} to {maximum:,}"


def _show(value: object) -> str:
    """Return a value's text for a message, cut where it is long."""
    text = describe_value(value)
    return text if len(text) <= 120 else f"{text[:100]}… ({type(value).__name__})"
