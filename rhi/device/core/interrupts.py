"""Interrupts (Ctrl-C) that wait until a step is complete.

Python raises `KeyboardInterrupt` between any two steps of a program. Most calls tolerate that: they change
Python's own state first or last, and an `except BaseException` undoes what they began. But creating a
resource takes two steps that belong together: the driver creates its object, and a table stores it. So an
interrupt between them is raised at the end (`DeferredInterrupts`), where the caller can still destroy the
resource (`Core.creation`).

- A second interrupt is raised at once: the first may be waiting for a driver that never returns.
- Handlers belong to the main thread. In other threads no interrupt is raised, and nothing is held.
"""

from __future__ import annotations

import threading
from _signal import SIGINT, getsignal, signal  # type: ignore[import-not-found]  # without enums, a tenth of the time
from collections.abc import Callable
from types import FrameType
from typing import Any, Final

_MAIN: Final = threading.main_thread()


class DeferredInterrupts:
    """A `with` block in which SIGINT waits; its handler is called at the end. Blocks may lie inside
    others."""

    __slots__ = ("_before", "_came")

    def __init__(self) -> None:
        self._before: Callable[[int, FrameType | None], Any] | None = None
        self._came: tuple[int, FrameType | None] | None = None

    def __enter__(self) -> None:
        if threading.current_thread() is not _MAIN:
            return
        before = getsignal(SIGINT)
        if callable(before) and getattr(before, "__func__", None) is not DeferredInterrupts._hold:
            try:
                self._before = before
                signal(SIGINT, self._hold)
            except BaseException:  # an interrupt came just before
                signal(SIGINT, before)
                raise

    def _hold(self, number: int, frame: FrameType | None) -> None:
        before = self._before
        if self._came is not None and before is not None:
            before(number, frame)
        self._came = number, frame

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        before = self._before
        if before is not None:
            signal(SIGINT, before)
            if self._came is not None:
                before(*self._came)
