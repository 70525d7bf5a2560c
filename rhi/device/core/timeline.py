"""The timeline of a device: one monotonically increasing fence, and deferred destruction (thesis 4.1.2, 3.10).

- `signal()` puts the next integer into the command stream; `completed` is the last one the GPU has reached.
  Locks, rings, queries, deferred destruction and frames in flight are all built on this one mechanism.
- `completed` asks the backend only while a signalled value is outstanding.
- Resources are destroyed when the GPU no longer uses them: `retire` records the fence value after which a resource is
  unused, and `collect` destroys those whose value has passed. Objects that keep ids of resources for later, such as
  command buffers, register with `watch`.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Protocol
from weakref import WeakSet

from rhi.contract.backend import FOREVER, Backend
from rhi.contract.descriptors import Id
from rhi.device.core.refusals import NO_LOG, RefusalLog
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_LOST, FENCE_VALUE

__rhi_internal__ = True


class Watcher(Protocol):
    """An object that is notified of retired resources."""

    def note_retired(self, resource: Id) -> None:
        """Handle the retirement of a resource, which can't be used any more."""


class Timeline:
    """The fence of one device.

    Attributes:
        signalled: the last signalled value; 0 before the first.
        refusals: raises and keeps the errors of refused calls.
    """

    __slots__ = ("_backend", "_completed", "_lock", "_retired", "_watchers", "refusals", "signalled")

    def __init__(self, backend: Backend, refusals: RefusalLog = NO_LOG) -> None:
        self._backend = backend
        self.refusals = refusals
        self.signalled = 0
        self._completed = 0
        self._retired: deque[tuple[int, Id]] = deque()
        self._watchers: WeakSet[Watcher] = WeakSet()
        self._lock = threading.RLock()  # the garbage collector may retire something while it is held

    def signal(self) -> int:
        """Put the next value into the command stream and return it."""
        value = self.signalled + 1
        self._backend.signal(value)
        self.signalled = value
        return value

    @property
    def completed(self) -> int:
        """The last fence value that the GPU has reached; never blocks."""
        if self._completed != self.signalled:
            self._completed = self._backend.completed()
        return self._completed

    def wait(self, value: int, seconds: float | None = None) -> bool:
        """Block until the GPU has reached `value`, for at most `seconds` (None: no limit); return whether it has.

        Raises:
            ValidationError: `fence-value` for a value that was never signalled: the wait would never end.
            DeviceError: `device-lost` if, without a limit, the GPU has not reached it within an hour.
        """
        if not 0 <= value <= self.signalled:
            self.refusals.refuse(FENCE_VALUE, f"device.wait({value})", value, f"0 to {self.signalled}")
        if value <= self._completed or value <= self.completed:
            return True
        reached = self._backend.wait(value, FOREVER if seconds is None else seconds)
        if reached:
            self._completed = max(self._completed, value)
        elif seconds is None:
            self.refusals.fail(
                DeviceError(DEVICE_LOST, f"device.wait({value})", f"no answer in {FOREVER:.0f} s")
            )
        return reached

    def retire(self, resource: Id) -> None:
        """Destroy `resource` once the GPU has executed everything submitted so far."""
        self._retired.append((self.signalled + 1, resource))
        if self._watchers:
            with self._lock:
                watchers = list(self._watchers)
            for watcher in watchers:
                watcher.note_retired(resource)

    def watch(self, watcher: Watcher) -> None:
        """Notify `watcher` of each retired resource, for as long as it lives. May be called from any thread."""
        with self._lock:
            self._watchers.add(watcher)

    def collect(self) -> None:
        """Destroy the retired resources that the GPU no longer uses."""
        if not self._retired:
            return
        completed = self.completed
        while self._retired and self._retired[0][0] <= completed:
            self._backend.destroy(self._retired.popleft()[1])
