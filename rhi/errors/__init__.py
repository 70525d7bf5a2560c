"""Errors: they name the broken rule, the call, the line of the user's program, and a tip.

- Every error names one `Rule`: a stable id, a sentence, a tip. `rhi.errors.rules` is the table of the
  interface's rules, `rhi.shading.language.rules` that of the shading language. Defining a rule adds it to
  `RULES`.
- An error names the line of the user's program that made the call (`rhi.errors.call_sites`).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from typing import Any, Final, NoReturn

from rhi.errors.call_sites import CallSite, find_call_site
from rhi.errors.data_classes import dataclass

_MAX_SHOWN_ERRORS: Final = 10
"""Largest number of errors in the text of a `ShaderError`."""

RULES: Final[dict[str, Rule]] = {}
"""Every rule by its id, in the order of definition."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule that a call can break: a stable id, a sentence that states the fault, and a tip.

    Defining a rule adds it to `RULES`. Each id can be used only once.
    """

    id: str
    sentence: str
    tip: str = ""

    def __post_init__(self) -> None:
        if self.id in RULES:
            raise ValueError(f"rule id {self.id!r} is already taken")
        RULES[self.id] = self


class RhiError(Exception):
    """Base class of all errors of this package.

    Attributes:
        rule: the broken rule. Tests should compare `rule.id`, which is stable.
        call: the refused call, as text.
        given, allowed: the value that was passed and the values that are allowed, as text; may be empty.
        site: the user's line, or None if the whole stack is internal.
    """

    def __init__(
        self,
        rule: Rule,
        call: str,
        given: str = "",
        allowed: str = "",
        tip: str = "",
        site: CallSite | None = None,
    ) -> None:
        self.rule = rule
        self.call = call
        self.given = given
        self.allowed = allowed
        self.tip = tip or rule.tip
        self.site = site if site is not None else find_call_site()
        super().__init__(self._describe())

    def __reduce__(self) -> tuple[Any, ...]:
        """Support pickling, so that an error keeps its type and parts when it comes from another process."""
        return type(self), (self.rule, self.call, self.given, self.allowed, self.tip, self.site)

    def _describe(self) -> str:
        rows = [
            ("call", self.call),
            ("given", self.given),
            ("allowed", self.allowed),
            ("at", str(self.site) if self.site is not None else ""),
            ("tip", self.tip),
        ]
        lines = [f"[{self.rule.id}] {self.rule.sentence}"]
        for name, text in rows:
            if text:
                indented = text.replace("\n", "\n" + " " * 11)
                lines.append(f"  {name + ':':<8} {indented}")
        return "\n".join(lines)


class ValidationError(RhiError, ValueError):
    """A call that breaks a rule of the interface. It had no effect."""


class ShaderError(RhiError, TypeError):
    """A shader that doesn't type-check, or that the driver refuses.

    Attributes:
        others: the other errors of the same shader, in the order in which they were found; its text shows
            them too.
    """

    others: tuple[ShaderError, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return *super().__reduce__(), {"others": self.others}

    def __str__(self) -> str:
        parts = [self._describe(), *map(str, self.others[: _MAX_SHOWN_ERRORS - 1])]
        if len(self.others) >= _MAX_SHOWN_ERRORS:
            parts.append(f"and {len(self.others) + 1 - _MAX_SHOWN_ERRORS} more errors")
        return "\n".join(parts)


class ShaderErrors:
    """The errors of a shader, collected so that one exception names all of them."""

    def __init__(self, errors: Iterable[ShaderError] = ()) -> None:
        # By rule and call: a function that two stages call is wrong once.
        self._errors: dict[tuple[str, str], ShaderError] = {}
        for error in errors:
            self.add(error)

    def __bool__(self) -> bool:
        return bool(self._errors)

    def add(self, error: ShaderError) -> None:
        """Add an error and its `others`."""
        for single in (error, *error.others):
            self._errors.setdefault((single.rule.id, single.call), single)

    @contextlib.contextmanager
    def collect(self) -> Iterator[None]:
        """Add an error that is raised inside the block, and leave the block."""
        try:
            yield
        except ShaderError as error:
            self.add(error.with_traceback(None))

    def check(self) -> None:
        """Raise the first error, if there are any, with the others in its `others`."""
        if self._errors:
            first, *others = self._errors.values()
            first.others = tuple(others)
            for other in others:
                other.others = ()
            raise first


class ShaderWarning(UserWarning):
    """A warning about a shader that works but may have a mistake, such as a binding that it never reads."""


class DeviceError(RhiError, RuntimeError):
    """A fault of the device itself: a missing driver, no memory left, a lost device."""


def refuse(rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = "") -> NoReturn:
    """Raise a `ValidationError` for `rule` at the user's line.

    It is raised without a context, since the Python error that led to it adds no information.
    """
    raise ValidationError(rule, call, _as_text(given), _as_text(allowed), tip) from None


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else describe_value(value)


def describe_value(value: object) -> str:
    """Return the `repr` of a value for a message; its type's name if it has none, as integers of 5,000
    digits."""
    try:
        return repr(value)
    except Exception:
        return f"a value of type {type(value).__name__}"
