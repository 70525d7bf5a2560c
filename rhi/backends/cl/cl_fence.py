"""The fence and timestamp queries: markers in the queue, whose events are polled without blocking.

- A marker is complete when all commands before it are. PoCL completes it without a flush, other drivers need
  one.
- When the device reaches a fence value, the memory kept for the commands before it is released; when the CPU
  has waited for the whole queue, all of them.
- A timestamp is the completion time of its marker on the device's clock, in nanoseconds. OpenCL also reports,
  on the same clock, when the CPU enqueued the marker.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from typing import Final

import pyopencl as cl

from rhi.backends.cl.memory.in_flight import InFlight
from rhi.contract.backend import FOREVER
from rhi.contract.descriptors import Id, QueryKind
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_LOST

_POLLS: Final = 20  # of 0.5 µs each; to sleep and be woken takes 10 to 20
_FIRST_PAUSE: Final = 20e-6
_LONGEST_PAUSE: Final = 1e-3


def is_done(event: cl.Event) -> bool:
    """Return whether all commands up to a marker are complete, without waiting.

    Raises:
        DeviceError: `device-lost` if a command before the marker failed.
    """
    status: int = event.command_execution_status
    if status < 0:
        raise DeviceError(DEVICE_LOST, "the command queue", f"a command failed with OpenCL's status {status}")
    return status == cl.command_execution_status.COMPLETE


class Fence:
    """The device's fence: a value that rises as the device completes work."""

    def __init__(self, queue: cl.CommandQueue, in_flight: InFlight) -> None:
        self._queue = queue
        self._in_flight = in_flight
        self._pending: deque[tuple[int, cl.Event, list[object]]] = deque()
        self._value = 0

    def signal(self, value: int) -> None:
        self._pending.append((value, cl.enqueue_marker(self._queue), self._in_flight.take()))
        self._queue.flush()

    def release(self) -> None:
        """Release all memory kept for commands, since a blocking read has waited for all of them."""
        self._in_flight.take()

    def poll(self) -> int:
        """Return the value that the device has reached, without waiting."""
        pending = self._pending
        while pending and is_done(pending[0][1]):
            self._value = pending.popleft()[0]
        return self._value

    def wait(self, value: int, seconds: float) -> bool:
        """Wait until `value` is reached or `seconds` have passed; return whether it was reached.

        The first polls catch small work. OpenCL's own wait returns soonest but has no timeout, so it serves
        waits without one; waits with a timeout sleep between polls.
        """
        for _ in range(_POLLS):
            if self.poll() >= value:
                return True
        if not self._pending or self._pending[-1][0] < value:
            return False  # it was never signalled
        if seconds >= FOREVER:
            with suppress(cl.Error):  # a command failed; the poll reports it
                next(event for signalled, event, _ in self._pending if signalled >= value).wait()
            return self.poll() >= value
        end = time.monotonic() + seconds
        pause = _FIRST_PAUSE
        while self.poll() < value:
            left = end - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(pause, left))
            pause = min(2 * pause, _LONGEST_PAUSE)
        return True


class Timestamps:
    """The timestamp queries of a device, by id."""

    def __init__(self, queue: cl.CommandQueue) -> None:
        self._queue = queue
        self._markers: dict[Id, cl.Event | None] = {}

    def create(self, query: Id, kind: QueryKind) -> None:
        self._markers[query] = None

    def destroy(self, query: Id) -> None:
        del self._markers[query]

    def write(self, query: Id) -> None:
        self._markers[query] = cl.enqueue_marker(self._queue)

    def read_issue_time(self, query: Id) -> int | None:
        """Return when the CPU enqueued a timestamp, on the device's clock in ns; None until it is
        available."""
        marker = self._markers[query]
        return None if marker is None or self.read(query) is None else int(marker.profile.queued)

    def read(self, query: Id) -> int | None:
        marker = self._markers[query]
        if marker is None:
            return None
        if not is_done(marker):
            self._queue.flush()
            return None
        return int(marker.profile.end)
