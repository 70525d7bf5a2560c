"""Copies of data that the CPU wrote, kept until the device has read them.

Writes return before the device has executed them, so the caller's memory can't be read later. At most `_MAX_STAGED`
bytes in `_MOST_COPIES` are in flight at a time; a write that doesn't fit waits for the device instead.
"""

from __future__ import annotations

from typing import Final

import pyopencl as cl

_MAX_STAGED: Final = 1 << 24
_MOST_COPIES: Final = 1 << 13


class Staging:
    """Host copies of written data that commands in the queue may still read."""

    def __init__(self) -> None:
        self._events: list[cl.Event] = []  # of the writes; each event keeps its copy alive
        self._bytes = 0

    def has_room(self, size: int) -> bool:
        """Return whether a copy of `size` bytes fits. If not, the caller waits for its write and calls `clear`."""
        return self._bytes + size <= _MAX_STAGED and len(self._events) < _MOST_COPIES

    def add(self, event: cl.Event, size: int) -> None:
        """Keep the copy of a write of `size` bytes alive through the write's event."""
        self._events.append(event)
        self._bytes += size

    def clear(self) -> list[cl.Event]:
        """Remove all copies and return what keeps them alive, to be released once the device is past this point."""
        events, self._events, self._bytes = self._events, [], 0
        return events
