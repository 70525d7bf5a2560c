"""Keeps the host's handlers of fatal signals, such as those of `faulthandler`.

LLVM in PoCL installs handlers of its own when devices are first listed. They remove its temporary files, and
restore what was there too late: after an abort, the process ends without the host's last words.
"""

from __future__ import annotations

import ctypes
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

_FATAL: Final = tuple(
    getattr(signal, name)
    for name in ("SIGABRT", "SIGSEGV", "SIGBUS", "SIGILL", "SIGFPE")
    if hasattr(signal, name)
)
_ACTION_BYTES: Final = 512
"""More than the C structure `sigaction` has on any system."""


@contextmanager
def keep_fault_handlers() -> Iterator[None]:
    """Restore the handlers of fatal signals at the end of the block, where the host had set any."""
    sigaction = getattr(ctypes.CDLL(None), "sigaction", None) if hasattr(signal, "SIGBUS") else None
    if sigaction is None:  # another system; PoCL isn't there
        yield
        return
    handlers = {}
    for number in _FATAL:
        handler = ctypes.create_string_buffer(_ACTION_BYTES)
        if sigaction(int(number), None, handler) == 0 and any(handler.raw):  # zeros are the default action
            handlers[number] = handler
    try:
        yield
    finally:
        for number, handler in handlers.items():
            sigaction(int(number), handler, None)
