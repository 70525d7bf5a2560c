"""Progress of loading: what readers of files tell whoever waits for them, and where they are stopped.

`report` does nothing unless a `ProgressReporter` watches the thread that calls it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

Reporter = Callable[[str, float], None]
"""Is told the current step, and the fraction of it that is done; it may raise an error to stop the step."""

_REPORTER: Final[ContextVar[Reporter | None]] = ContextVar("reporter", default=None)


@contextmanager
def watch_progress(reporter: Reporter) -> Iterator[None]:
    """Call `reporter` with each report of this thread within the block."""
    token = _REPORTER.set(reporter)
    try:
        yield
    finally:
        _REPORTER.reset(token)


def report(step: str, done: int = 0, total: int = 0) -> None:
    """Report that `done` of `total` parts of a step are done, to whoever watches this thread."""
    reporter = _REPORTER.get()
    if reporter is not None:
        reporter(step, done / total if total else 0.0)
