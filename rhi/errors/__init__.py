"""Errors that help: which rule was broken, by which call, on which line of the user's program, and what to do.

- Every error names one `Rule`: a stable id, a sentence, a tip. `rhi.errors.rules` is the table of the interface's
  rules, `rhi.shading.language.rules` that of the shading language. Defining a rule adds it to `RULES`.
- An error names the *user's* line. `mark_library` decides which frames are the library's own: those of the files of
  `rhi`, `rhi_screen` and `renderer`, and of `contextlib`, through which users enter scopes. They get a mark,
  `__rhi_internal__`, among the globals of their module, once for each: to look up a name there is the cheapest way to
  leave a package (40 ns a frame), and the recorder does so too. A port has the mark in its own modules.
- This module imports nothing else of the package.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from types import CodeType, FrameType
from typing import Any, Final, NoReturn

MARK: Final = "__rhi_internal__"
"""The name among a module's globals that says that its frames are the library's, not the user's."""

_FOLDER: Final = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_PACKAGES: Final = ("rhi", "rhi_screen", "renderer")
_OWN: Final = tuple(os.path.join(_FOLDER, name, "") for name in _PACKAGES)
_KIT: Final = os.path.join(_FOLDER, "rhi", "conformance", "")
"""The conformance kit uses the interface as its users do."""
_SHOWN: Final = 10
"""The most errors of a shader whose text is shown."""
_START: Final = "<frozen runpy>"
"""The outermost file of `python -m`: where the search for the user's line ends without one."""

MARKED: Final = [0]
"""The number of imported modules when the library's were marked last."""
vars(contextlib)[MARK] = True  # its frames stand between the user's line and a scope that an exit stack enters

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
    """A shader that doesn't type-check, or that the driver refuses.

    Attributes:
        others: the other errors of the same shader, in the order in which they were found; its text shows them too.
    """

    others: tuple[ShaderError, ...] = ()

    def __reduce__(self) -> tuple[Any, ...]:
        return *super().__reduce__(), {"others": self.others}

    def __str__(self) -> str:
        shown = [self._describe(), *map(str, self.others[: _SHOWN - 1])]
        if len(self.others) >= _SHOWN:
            shown.append(f"and {len(self.others) + 1 - _SHOWN} more errors")
        return "\n".join(shown)


class ShaderErrors:
    """Collects the errors of a shader, so that one exception says all of them."""

    def __init__(self, errors: Iterable[ShaderError] = ()) -> None:
        self.found: dict[tuple[str, str], ShaderError] = {}
        """The errors by rule and place: a function that two stages call is wrong once."""
        for error in errors:
            self.add(error)

    def add(self, error: ShaderError) -> None:
        """Keep an error and those that it comes with."""
        for one in (error, *error.others):
            self.found.setdefault((one.rule.id, one.call), one)

    @contextlib.contextmanager
    def collect(self) -> Iterator[None]:
        """Keep an error that is raised inside; what follows it in the block is left out."""
        try:
            yield
        except ShaderError as error:
            self.add(error.with_traceback(None))

    def check(self) -> None:
        """Raise what was found."""
        if self.found:
            first, *others = self.found.values()
            first.others = tuple(others)
            for one in others:
                one.others = ()
            raise first


class ShaderWarning(UserWarning):
    """Something in a shader that may be a mistake, such as a binding that it never reads; it works all the same."""


class DeviceError(RhiError, RuntimeError):
    """A fault of the device itself: a missing driver, no memory left, a lost device."""


def refuse(rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = "") -> NoReturn:
    """Raise a `ValidationError` for `rule` at the user's line.

    It has no context: Python errors on the way to it say nothing that it doesn't say.
    """
    raise ValidationError(rule, call, _as_text(given), _as_text(allowed), tip) from None


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else repr(value)


def mark_library() -> None:
    """Mark the library's modules among those that were imported since the last call.

    A file of the library that the user runs as a program is the user's, but for `__main__.py`.
    """
    if len(sys.modules) == MARKED[0]:
        return
    MARKED[0] = len(sys.modules)
    for name, module in list(sys.modules.items()):
        if name == "__main__" or name.partition(".")[0] in _PACKAGES:  # others may load when they are asked anything
            scope = getattr(module, "__dict__", {})
            file = scope.get("__file__") or ""
            is_program = scope.get("__name__") == "__main__" and os.path.basename(file) != "__main__.py"
            if file.startswith(_OWN) and not file.startswith(_KIT) and not is_program:
                scope[MARK] = True


def find_user_frame(depth: int = 1) -> FrameType | None:
    """Return the innermost frame outside this package, starting `depth` frames above the caller."""
    mark_library()
    frame: FrameType | None = sys._getframe(depth)
    while frame is not None and MARK in frame.f_globals:
        frame = frame.f_back
    return frame


def find_call_site() -> CallSite | None:
    """Return the user's line that led to this call, or None if the whole stack is internal."""
    frame = find_user_frame(2)
    return None if frame is None else make_call_site(frame.f_code, frame.f_lineno)


def make_call_site(code: CodeType, line: int) -> CallSite | None:
    """Return the call site at a line of a code object; None if `python -m` started the library itself there."""
    return None if code.co_filename == _START else CallSite(code.co_filename, line, code.co_qualname)
