"""Waits for the device that leave the event loop to other tasks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from typing import Any, Final

_FIRST_PAUSE: Final = 0.0002  # seconds
_LONGEST_PAUSE: Final = 0.002


def pause_until(is_done: Callable[[], bool]) -> Generator[Any]:
    """Pause beside other tasks of asyncio until a condition holds. Without its loop, return at once."""
    asyncio = sys.modules.get("asyncio")  # which runs no loop if nobody has imported it
    if getattr(asyncio, "_get_running_loop", lambda: None)() is not None:
        assert asyncio is not None
        pause = 0.0
        while not is_done():
            yield from asyncio.sleep(pause).__await__()
            pause = min(pause + _FIRST_PAUSE, _LONGEST_PAUSE)
