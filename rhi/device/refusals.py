"""Refused calls, kept with the commands: a recording device notes each call of it that ended in an error of this
package before it became a command.

The errors say when they are made (`rhi.errors.listen`). Whose call it was is found on the stack: the outermost frame
of this package is the method that the user called, and its object belongs to a device. What a backend raises is noted
with its command (`Command.failure`), not here.
"""

from __future__ import annotations

from operator import attrgetter
from types import FrameType
from typing import Final

from rhi.commands.recorder import CommandMethods, Recorder
from rhi.device.core.core import Core
from rhi.errors import MARK, RhiError

__rhi_internal__ = True

_CORES: Final = tuple(
    attrgetter(path)
    for path in ("core", "_core", "owner.core", "_owner.core", "data.core", "buffer.core", "_program.core")
)
"""How the objects that users hold lead to their core."""


class RefusalLog:
    """One device's: writes into the stream of its recorder."""

    __slots__ = ("__weakref__", "_core", "_recorder")

    def __init__(self, core: Core, recorder: Recorder) -> None:
        self._core = core
        self._recorder = recorder

    def note_error(self, error: RhiError, frame: FrameType | None) -> None:
        """An error was made in `frame`; keep it if it ends a call of this device."""
        outermost = None
        while frame is not None and MARK in frame.f_globals:
            if isinstance(frame.f_locals.get("self"), CommandMethods):
                return  # a command's
            outermost, frame = frame, frame.f_back
        if outermost is not None and not self._recorder.is_paused and self._is_ours(outermost):
            self._recorder.stream.note_refusal(error)

    def _is_ours(self, frame: FrameType) -> bool:
        """Whether a method of something of this device runs in the frame."""
        core = self._core
        if frame.f_locals.get("_core") is core:  # a generated draw function
            return True
        called = frame.f_locals.get("self")
        if getattr(called, "_cache", None) is core.states:  # a scope of states
            return True
        for find in _CORES:
            try:
                found = find(called)
            except AttributeError:
                continue
            if found is core or getattr(found, "device", None) is core:  # or that of a command buffer
                return True
        return False
