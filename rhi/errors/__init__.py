"""Errors that help: which rule was broken, by which call, on which line of the user's program, and what to do.

- Every error names one `Rule`: a stable id, a sentence, a tip. `rhi.errors.rules` is the table of the interface's
  rules, `rhi.shading.language.rules` that of the shading language. Defining a rule adds it to `RULES`.
- An error names the *user's* line. Modules of this package have `__rhi_internal__ = True` among their globals, and
  `find_user_frame` skips all frames with this mark. The recorder uses the same mark: to look up a name in the globals
  of a frame is the cheapest way to leave a package (40 ns a frame).
- This module imports nothing else of the package.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, Final, NoReturn

__rhi_internal__ = True

MARK: Final = "__rhi_internal__"

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


@dataclass(frozen=True, slots=True)
class CallSite:
    """A line of the user's program."""

    file: str
    line: int
    function: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


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
    """A shader that doesn't type-check, or that the driver refuses."""


class DeviceError(RhiError, RuntimeError):
    """A fault of the device itself: a missing driver, no memory left, a lost device."""


def refuse(rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = "") -> NoReturn:
    """Raise a `ValidationError` for `rule` at the user's line.

    It has no context: Python errors on the way to it say nothing that it doesn't say.
    """
    raise ValidationError(rule, call, _as_text(given), _as_text(allowed), tip) from None


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else repr(value)


def find_user_frame(depth: int = 1) -> FrameType | None:
    """Return the innermost frame outside this package, starting `depth` frames above the caller."""
    frame: FrameType | None = sys._getframe(depth)
    while frame is not None and MARK in frame.f_globals:
        frame = frame.f_back
    return frame


def find_call_site() -> CallSite | None:
    """Return the user's line that led to this call, or None if the whole stack is internal."""
    frame = find_user_frame(2)
    if frame is None:
        return None
    return CallSite(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_qualname)
