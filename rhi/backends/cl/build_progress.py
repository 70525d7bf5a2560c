"""The line that says what a program waits for, while the calling thread builds kernels.

- The wait is the time in which the calling thread builds a program that isn't in the cache, or in which a kernel that
  is launched for the first time hasn't ended: PoCL generates its machine code then.
- A thread watches it, so that the line appears during the wait and not behind it. The thread ends `IDLE` seconds after
  the last build. A start with a full cache never begins it.
- After `LONG_WAIT` seconds a terminal gets a bar of tqdm, if that is installed, which vanishes at the end. Otherwise
  the logger `rhi.kernels` warns, which Python shows on standard error without any configuration; then again after each
  four times as long.
- Nothing is shown if the logger doesn't let warnings pass. With handlers of its own it gets warnings and no bar.
"""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from time import perf_counter
from typing import Any, Final

import pyopencl as cl

LOGGER: Final = logging.getLogger("rhi.kernels")
LONG_WAIT: Final = 1.0
"""Seconds of builds in the calling thread after which a line says what it waits for."""
IDLE: Final = 0.5
"""Seconds without a build after which the bar vanishes and the watching thread ends."""
_STEP: Final = 0.05  # seconds between two looks
_LONGER: Final = 4.0  # after as many times the wait, the next warning


class BuildProgress:
    """The time that the calling thread waits for kernels, and the line that says so.

    Attributes:
        waited: seconds so far.
    """

    def __init__(self, count: Callable[[], tuple[int, int]], waited: float = 0.0) -> None:
        """
        Args:
            count: counts the kernels that are built, and those whose build has begun or is queued.
            waited: seconds of earlier builds.
        """
        self._count = count
        self._lock = threading.Lock()
        self._building: list[str] = []  # what the calling threads build
        self._launched: cl.Event | None = None  # the latest first launch of a kernel
        self._latest = ""
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()
        self._next_warning = LONG_WAIT
        self._bar: Any = None
        self.waited = waited

    @contextmanager
    def waiting(self, label: str) -> Iterator[None]:
        """Count the time of the body as a wait for the kernels that `label` names."""
        with self._lock:
            self._building.append(label)
            self._latest = label
            if self._thread is None and not self._closed.is_set():
                thread = threading.Thread(target=self._watch, name="rhi kernels' progress", daemon=True)
                with suppress(RuntimeError):  # no more threads, or Python is shutting down
                    thread.start()
                    self._thread = thread
        try:
            yield
        finally:
            with self._lock:
                self._building.remove(label)

    def note_launch(self, label: str, event: cl.Event) -> None:
        """Count the time until a kernel's first launch has ended as a wait, since it may be compiled first."""
        if self._thread is not None:
            self._latest, self._launched = label, event

    def close(self) -> None:
        """End the thread and the bar."""
        self._closed.set()
        thread = self._thread
        if thread is not None:
            thread.join()

    def _is_busy(self) -> bool:
        if self._building:
            return True
        event = self._launched
        if event is None:
            return False
        with suppress(cl.Error):
            status: Any = event.get_info(cl.event_info.COMMAND_EXECUTION_STATUS)
            if status > 0:  # it hasn't ended
                return True
        self._launched = None
        return False

    def _watch(self) -> None:
        """Add up the wait and report it, until nothing has been built for a while."""
        before, idle = perf_counter(), 0.0
        while not self._closed.wait(_STEP):
            now = perf_counter()
            seconds, before = now - before, now
            if self._is_busy():
                idle = 0.0
                self.add(seconds)
                continue
            idle += seconds
            with self._lock:
                if idle >= IDLE and not self._building:
                    self._thread = None
                    break
        self._hide()

    def add(self, seconds: float) -> None:
        """Add `seconds` to the wait, and report it if that was long."""
        self.waited += seconds
        if self.waited < LONG_WAIT or not LOGGER.isEnabledFor(logging.WARNING):
            return
        if self._bar is None and not LOGGER.hasHandlers():
            self._bar = _open_bar()
        if self._bar is not None:
            self._bar.n, self._bar.total = self._count()
            self._bar.set_postfix_str(self._latest)  # which draws the bar
        elif self.waited >= self._next_warning:
            while self.waited >= self._next_warning:
                self._next_warning *= _LONGER
            LOGGER.warning(
                "OpenCL kernels are being built: %d of %d so far, now %s; the program has waited %.1f s. They are kept "
                "on disk, so that the next start doesn't wait",
                *self._count(),
                self._latest,
                self.waited,
            )

    def _hide(self) -> None:
        if self._bar is not None:
            self._bar.close()
        self._bar = None


def _open_bar() -> Any:
    """Return a bar of tqdm on standard error; None if that isn't a terminal, or tqdm isn't installed."""
    stream = sys.stderr
    if stream is None or not stream.isatty():
        return None
    try:
        from tqdm import tqdm  # optional
    except ImportError:
        return None

    class Bar(tqdm):  # type: ignore[misc]
        monitor_interval = 0  # no thread of its own

    return Bar(desc="OpenCL kernels", unit=" kernels", total=0, file=stream, leave=False)
