"""The fence: a queue of GL sync objects, of which only the oldest are polled."""

from __future__ import annotations

from collections import deque
from typing import Final

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints

_NANOSECONDS: Final = 1_000_000_000
_SIGNALED: Final = (enums.ALREADY_SIGNALED, enums.CONDITION_SATISFIED)


class Fence:
    """The device's fence: a value that increases as the GPU completes work."""

    def __init__(self, gl: EntryPoints) -> None:
        self._gl = gl
        self._pending: deque[tuple[int, int | None]] = deque()
        self._value = 0

    @property
    def is_idle(self) -> bool:
        """True if no signal is pending, as of the last `poll`."""
        return not self._pending

    def signal(self, value: int) -> None:
        self._pending.append((value, self._gl.FenceSync(enums.SYNC_GPU_COMMANDS_COMPLETE, 0)))
        self._gl.Flush()

    def poll(self) -> int:
        """Return the value reached, without waiting."""
        pending = self._pending
        while pending and self._is_signaled(pending[0][1], 0):
            self._value, sync = pending.popleft()
            self._gl.DeleteSync(sync)
        return self._value

    def wait(self, value: int, seconds: float) -> bool:
        """Wait until `value` is reached, for at most `seconds`. Return whether it was."""
        if self.poll() >= value:
            return True
        timeout = max(0, min(int(seconds * _NANOSECONDS), (1 << 63) - 1))
        for signaled, sync in self._pending:
            if signaled >= value:
                return self._is_signaled(sync, timeout) and self.poll() >= value
        return False  # no signal of this value is pending

    def release(self) -> None:
        """Delete the objects of all signals."""
        while self._pending:
            self._gl.DeleteSync(self._pending.popleft()[1])

    def _is_signaled(self, sync: int | None, timeout: int) -> bool:
        flags = enums.SYNC_FLUSH_COMMANDS_BIT if timeout else 0
        return self._gl.ClientWaitSync(sync, flags, timeout) in _SIGNALED
