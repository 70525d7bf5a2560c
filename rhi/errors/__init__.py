"""Errors that help: what rule was broken, by which call, where in the user's file, and what to do.

- Every refusal names one `Rule`: a stable id, a sentence, a tip. The table of the core's rules is
  `rhi.errors.rules`, that of the shading language `rhi.shading.language.rules`; both add to `RULES` by being defined.
- An error names the *user's* line. Modules of this package carry `__rhi_internal__ = True` in their
  globals, and `find_user_frame` walks out past every frame so marked. The recorder uses the same mark,
  because looking a name up in a frame's globals is the cheapest way out of a package (40 ns a frame).
- Nothing here imports anything else of the package.
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
    """One thing that a caller may get wrong.

    Defining a rule adds it to `RULES`; an id can be used once.
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
    """Base of all errors of this package.

    Attributes:
        rule: the broken rule; `rule.id` is stable and what tests should compare.
        call: the refused call, as text.
        given, allowed: what was passed and what may be passed, as text; may be empty.
        site: the user's line, or None when no user frame was found.
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
        """So that an error comes back from another process as what it is."""
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
    """A call that the rules of the interface forbid; nothing of it was done."""


class ShaderError(RhiError, TypeError):
    """A shader that does not type-check or that a driver refuses."""


class DeviceError(RhiError, RuntimeError):
    """The device itself: a missing driver, out of memory, a lost device."""


def refuse(rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = "") -> NoReturn:
    """Raise a `ValidationError` for `rule` at the user's line."""
    raise ValidationError(rule, call, _as_text(given), _as_text(allowed), tip)


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else repr(value)


def find_user_frame(depth: int = 1) -> FrameType | None:
    """The innermost frame outside this package, searched from `depth` frames above the caller."""
    frame: FrameType | None = sys._getframe(depth)
    while frame is not None and MARK in frame.f_globals:
        frame = frame.f_back
    return frame


def find_call_site() -> CallSite | None:
    """The user's line that led here, or None when the whole stack is internal."""
    frame = find_user_frame(2)
    if frame is None:
        return None
    return CallSite(frame.f_code.co_filename, frame.f_lineno, frame.f_code.co_qualname)
