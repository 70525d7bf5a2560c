"""The fence and timestamps: markers in the queue, whose events are polled without blocking.

- A marker is done when everything before it is. PoCL completes one without a flush, other drivers need it.
- A fence value also ends the life of the staged copies before it.
- Timestamps are the markers' own times, by the device's clock, in nanoseconds.
"""

from __future__ import annotations

import time
from collections import deque
from contextlib import suppress
from typing import Final

import pyopencl as cl

from rhi.backends.cl.pools import Retired
from rhi.backends.cl.resources import Staging
from rhi.contract.backend import FOREVER
from rhi.contract.descriptors import Id, QueryKind
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_LOST

__rhi_internal__ = True

_POLLS: Final = 20  # of 0.5 us: to fall asleep and to be woken takes 10 to 20
_FIRST_NAP: Final = 20e-6
_LONGEST_NAP: Final = 1e-3


def is_done(event: cl.Event) -> bool:
    """Whether everything up to a marker is done; never waits.

    Raises:
        DeviceError: `device-lost` if a command before it failed.
    """
    status: int = event.command_execution_status
    if status < 0:
        raise DeviceError(DEVICE_LOST, "the command queue", f"a command failed with OpenCL's status {status}")
    return status == cl.command_execution_status.COMPLETE


class Fence:
    """The device's fence: a value that rises as the device gets done."""

    def __init__(self, queue: cl.CommandQueue, staging: Staging, retired: Retired) -> None:
        self._queue = queue
        self._staging = staging
        self._retired = retired
        self._pending: deque[tuple[int, cl.Event, list[object]]] = deque()
        self._value = 0

    def signal(self, value: int) -> None:
        kept = [*self._staging.clear(), *self._retired.take()]
        self._pending.append((value, cl.enqueue_marker(self._queue), kept))
        self._queue.flush()

    def poll(self) -> int:
        """The value reached; doesn't wait."""
        pending = self._pending
        while pending and is_done(pending[0][1]):
            self._value = pending.popleft()[0]
        return self._value

    def wait(self, value: int, seconds: float) -> bool:
        """Until `value` is reached, for at most `seconds`. A few polls come first, since small work is done by then.
        OpenCL's own wait wakes up soonest but knows no limit, so it does the waits that have none, and others nap."""
        for _ in range(_POLLS):
            if self.poll() >= value:
                return True
        if not self._pending or self._pending[-1][0] < value:
            return False  # nobody will ever signal it
        if seconds >= FOREVER:
            with suppress(cl.Error):  # of a command that failed; the poll says so
                next(event for signalled, event, _ in self._pending if signalled >= value).wait()
            return self.poll() >= value
        end = time.monotonic() + seconds
        nap = _FIRST_NAP
        while self.poll() < value:
            left = end - time.monotonic()
            if left <= 0:
                return False
            time.sleep(min(nap, left))
            nap = min(2 * nap, _LONGEST_NAP)
        return True


class Timestamps:
    """All timestamps of a device, by id."""

    def __init__(self, queue: cl.CommandQueue) -> None:
        self._queue = queue
        self._markers: dict[Id, cl.Event | None] = {}

    def create(self, query: Id, kind: QueryKind) -> None:
        self._markers[query] = None

    def destroy(self, query: Id) -> None:
        del self._markers[query]

    def write(self, query: Id) -> None:
        self._markers[query] = cl.enqueue_marker(self._queue)

    def read(self, query: Id) -> int | None:
        marker = self._markers[query]
        if marker is None:
            return None
        if not is_done(marker):
            self._queue.flush()
            return None
        return int(marker.profile.end)
