"""Refused calls of one device: the errors are raised, and recorded beside the device's commands.

The front end checks each call before a backend sees it. A call that fails a check never becomes a command, so
the check itself adds the error to the recorded stream (`CommandStream.refusals`). Errors that a backend
raises belong to their command (`Command.failure`) and are not kept here.
"""

from __future__ import annotations

from typing import Final, NoReturn

from rhi.commands.recorder import Recorder
from rhi.contract.backend import Backend
from rhi.errors import RhiError, Rule, refuse


class RefusalLog:
    """Raises the errors of one device's front end, keeping each in the device's command stream.

    Nothing is kept if the backend is not a `Recorder`, or while the recorder is paused. As a context manager
    it keeps an error raised in its block by code that knows no device, such as the shader compiler.
    """

    __slots__ = ("_recorder",)

    def __init__(self, backend: Backend | None = None) -> None:
        self._recorder = backend if isinstance(backend, Recorder) else None

    def refuse(
        self, rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = ""
    ) -> NoReturn:
        """Raise a `ValidationError` for `rule` at the user's line."""
        with self:
            refuse(rule, call, given, allowed, tip)

    def fail(self, error: RhiError) -> NoReturn:
        """Keep `error` and raise it."""
        self.note(error)
        raise error

    def note(self, error: RhiError) -> None:
        """Keep `error`, which ends a call of this device before it became a command."""
        recorder = self._recorder
        if recorder is not None and not recorder.is_paused:
            recorder.stream.note_refusal(error)

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, RhiError):
            self.note(error)


NO_LOG: Final = RefusalLog()
"""A log for code that is used without a device: it records nothing."""
