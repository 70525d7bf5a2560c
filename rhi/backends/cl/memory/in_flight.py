"""Memory in flight: what commands in the queue may still use, kept until the device has executed them.

- Writes return before the device has executed them, so the caller's memory can't be read later, and a copy is
  kept. At most `_MAX_STAGED` bytes in `_MAX_COPIES` are in flight at a time; a write that doesn't fit waits
  for the device.
- Scratch memory that was replaced by a larger piece, and index lists that no draw needs any more.
- Buffers and textures that are destroyed while something of them may be in flight. Their memory is host
  memory, which OpenCL doesn't keep alive.
"""

from __future__ import annotations

from typing import Final

import pyopencl as cl

_MAX_STAGED: Final = 1 << 24
_MAX_COPIES: Final = 1 << 13


class InFlight:
    """Memory that commands of one queue may still use."""

    def __init__(self) -> None:
        self._retained: list[object] = []
        self._bytes = 0

    def has_room(self, size: int) -> bool:
        """Return whether a copy of `size` bytes fits. If not, the caller waits for its write and calls
        `take`."""
        return self._bytes + size <= _MAX_STAGED and len(self._retained) < _MAX_COPIES

    def add(self, memory: object, size: int = 0) -> None:
        """Keep memory, or an event that keeps it; `size`: the bytes of a copy."""
        self._retained.append(memory)
        self._bytes += size

    def release(self, memory: cl.Buffer) -> None:
        """Release the memory of a destroyed resource, which no command uses but those that write it."""
        if self._retained:
            self._retained.append(memory)
        else:
            memory.release()

    def take(self) -> list[object]:
        """Remove and return everything, to be released once the device is past this point."""
        objects, self._retained, self._bytes = self._retained, [], 0
        return objects
