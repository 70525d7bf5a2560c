"""Call sites: the line of the user's program that led to a call, past the frames of the library.

- A frame is the library's own if its module has the mark `__rhi_internal__` among its globals. To look up a
  name there is the cheapest way past a frame (40 ns); the recorder does so for each command.
- `mark_library` sets the mark in the modules of `rhi`, `rhi_screen` and `renderer`, once for each.
  `contextlib` has it too, since users enter scopes through it. A backend in another package sets it in its
  own modules.
- This module imports nothing else of `rhi`.
"""

from __future__ import annotations

import contextlib
import os
import sys
from dataclasses import field
from types import CodeType, FrameType
from typing import Final

from rhi.errors.data_classes import dataclass

MARK: Final = "__rhi_internal__"
"""The name among a module's globals that says that its frames are the library's, not the user's."""

_FOLDER: Final = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
_PACKAGES: Final = ("rhi", "rhi_screen", "renderer")
_OWN: Final = tuple(os.path.join(_FOLDER, name, "") for name in _PACKAGES)
_KIT: Final = os.path.join(_FOLDER, "rhi", "conformance", "")
"""The conformance kit uses the interface as its users do."""
_START: Final = "<frozen runpy>"
"""The outermost file of `python -m`. A search for the user's line that ends here has found none."""

MARKED: Final = [0]
"""The number of imported modules when the library's were marked last."""
vars(contextlib)[MARK] = (
    True  # its frames stand between the user's line and a scope that an exit stack enters
)


@dataclass(frozen=True, slots=True)
class CallSite:
    """A line of the user's program."""

    file: str
    line: int
    function: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"


def mark_library() -> None:
    """Mark the library's modules among those that were imported since the last call.

    A file of the library that the user runs as a program is the user's, but for `__main__.py`.
    """
    count = len(sys.modules)
    if count == MARKED[0]:
        return
    for name, module in list(sys.modules.items()):
        # Attributes of other packages' modules aren't read: that may import more of a lazy module.
        if name == "__main__" or name.partition(".")[0] in _PACKAGES:
            scope = getattr(module, "__dict__", {})
            file = scope.get("__file__") or ""
            is_program = scope.get("__name__") == "__main__" and os.path.basename(file) != "__main__.py"
            if file.startswith(_OWN) and not file.startswith(_KIT) and not is_program:
                scope[MARK] = True
    MARKED[0] = count  # at the end: other threads look for their lines meanwhile


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
    """Return the call site at a line of a code object; None if `python -m` started the library itself
    there."""
    return None if code.co_filename == _START else CallSite(code.co_filename, line, code.co_qualname)
