"""Signals whose handlers wait until a step is complete.

Python runs the handlers of signals between any two steps of a program: Ctrl-C raises `KeyboardInterrupt`
there, the alarm of a timeout or a request to terminate whatever their handlers raise. Most calls tolerate
that: they change Python's own state first or last, and an `except BaseException` undoes what they began. Two
kinds of steps don't:

- Creating a resource takes two steps that belong together: the driver creates its object, and a table stores
  it. So do the begin and the end of a driver's pass. `DeferredInterrupts` raises after them, where the caller
  can still undo the whole (`Core.creation`). A second Ctrl-C is raised at once: the first may be waiting for
  a driver that never returns.
- Libraries that call Python from C may end the process when a handler raises inside them.
  `DeferredSignals` lets none of them run there.

Handlers belong to the main thread. In other threads nothing is raised, and nothing is held.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # without enums, a tenth of the time
from _signal import getsignal, signal
from collections.abc import Callable
from threading import current_thread, main_thread
from types import FrameType
from typing import Any, Final

_MAIN: Final = main_thread()
_INTERRUPT: Final = int(_signal.SIGINT)
_TERMINATE, _ALARM, _HANG_UP, _USER, _SECOND_USER = (
    int(getattr(_signal, name, _INTERRUPT)) for name in ("SIGTERM", "SIGALRM", "SIGHUP", "SIGUSR1", "SIGUSR2")
)
_USUAL: Final = (_INTERRUPT, _TERMINATE, _ALARM, _HANG_UP, _USER, _SECOND_USER)
"""The signals whose handlers usually raise. To look at all 62 would double the time of a block."""
_ALL: Final = tuple(sorted(map(int, _signal.valid_signals())))

Handler = Callable[[int, FrameType | None], Any]


class DeferredInterrupts:
    """A `with` block in which the usual signals wait; their handlers are called at the end, in order. Blocks
    may lie inside others. A signal that comes a second time doesn't wait."""

    __slots__ = ("_came", "_handlers")

    def __init__(self) -> None:
        self._handlers: tuple[tuple[int, Handler], ...] = ()
        self._came: list[tuple[int, FrameType | None]] | None = None

    def __enter__(self) -> None:
        if current_thread() is not _MAIN:
            return
        self._handlers = self._select()
        hold = self._hold
        try:
            for number, _ in self._handlers:
                signal(number, hold)
        except BaseException:  # a signal came just before
            self.__exit__(None, None, None)
            raise

    def _select(self) -> tuple[tuple[int, Handler], ...]:
        """Return the signals to hold, with their handlers: those of Python that aren't another block's."""
        global _latest
        handlers = (  # a loop would take four times as long
            getsignal(_INTERRUPT),
            getsignal(_TERMINATE),
            getsignal(_ALARM),
            getsignal(_HANG_UP),
            getsignal(_USER),
            getsignal(_SECOND_USER),
        )
        if getattr(handlers[0], "__func__", None) is DeferredInterrupts._hold:
            return ()  # the block around this one holds them
        latest = _latest
        if handlers == latest[0]:
            return latest[1]
        pairs = dict(zip(_USUAL, handlers, strict=True)).items()
        selected = tuple((number, handler) for number, handler in pairs if _is_foreign(handler))
        _latest = handlers, selected
        return selected

    def _hold(self, number: int, frame: FrameType | None) -> None:
        came = self._came
        if came is None:
            came = self._came = []
        elif self._raises_at_once(number, came):
            dict(self._handlers)[number](number, frame)
        came.append((number, frame))

    def _raises_at_once(self, number: int, came: list[tuple[int, FrameType | None]]) -> bool:
        return any(number == earlier for earlier, _ in came)

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        try:
            for number, handler in self._handlers:
                signal(number, handler)
            if self._came:
                self._call_handlers(self._came)
        except (
            BaseException
        ):  # of a handler, perhaps of a signal that came just now: the others have their turn
            self.__exit__(None, None, None)
            raise

    def _call_handlers(self, came: list[tuple[int, FrameType | None]]) -> None:
        """Call the handlers of all signals that came, and forget each just before. No variable holds what they
        raise: such a cycle would keep the interrupted frames alive, and with them memory that drivers were
        given."""
        while came:
            number, frame = came[0]
            del came[0]
            dict(self._handlers)[number](number, frame)


class DeferredSignals(DeferredInterrupts):
    """A `with` block in which all signals wait, however often they come: for calls of libraries that a
    raising handler would break."""

    __slots__ = ()

    def _select(self) -> tuple[tuple[int, Handler], ...]:
        pairs = ((number, getsignal(number)) for number in _ALL)
        return tuple((number, handler) for number, handler in pairs if callable(handler))

    def _raises_at_once(self, number: int, came: list[tuple[int, FrameType | None]]) -> bool:
        return False


def _is_foreign(handler: object) -> bool:
    """True if a handler is one of Python that isn't another block's."""
    return callable(handler) and getattr(handler, "__func__", None) is not DeferredInterrupts._hold


_latest: tuple[tuple[object, ...], tuple[tuple[int, Handler], ...]] = ((), ())
"""The handlers that the latest block met, and those of them that it held."""
