"""The timeline of a device: one monotonically increasing fence, and deferred destruction (thesis 4.1.2,
3.10).

- `signal()` puts the next integer into the command stream; `completed` is the last one the GPU has reached.
  Locks, rings, queries, deferred destruction and frames in flight are all built on this one mechanism.
- `completed` asks the backend only while a signalled value is outstanding.
- Resources are destroyed when the GPU no longer uses them: `retire` records the fence value after which a
  resource is unused, and `collect` destroys those whose value has passed.
- A program that never signals would keep all of them. So a creation first signals if many wait for it
  (`make_room`).
- Finalizers `drop` resources that are no longer referenced, on any thread and between any two steps. Dropped
  resources wait in a queue until the device's thread retires them, before the next signal or creation.
- Objects that store something for a resource (a mesh stores a program's vertex array, a command buffer the
  ids it uses) register with `watch`, and drop it when the resource is retired.
"""

from __future__ import annotations

import threading
from collections import deque
from time import perf_counter
from typing import Final, Protocol
from weakref import WeakSet, ref

from rhi.contract.backend import FOREVER, Backend
from rhi.contract.descriptors import Id
from rhi.contract.interrupts import DeferredInterrupts
from rhi.device.core.memory_ledger import MemoryLedger
from rhi.device.core.refusals import NO_LOG, RefusalLog
from rhi.errors import DeviceError
from rhi.errors.call_sites import CallSite
from rhi.errors.rules import DEVICE_LOST, FENCE_VALUE

MAX_WAITING: Final = 256
"""Number of retired resources at which a creation signals the fence for them."""
MAX_WAITING_BYTES: Final = 1 << 26
"""Total size in bytes of retired resources at which a creation signals too."""
_ALL: Final[Id] = 0


class Watcher(Protocol):
    """An object that is notified of retired resources."""

    def note_retired(self, resource: Id) -> None:
        """Handle the retirement of a resource, which can't be used any more."""


class _Holder(ref[object]):
    """A weak reference to an object that holds resources, with their ids."""

    __slots__ = ("ids",)
    ids: list[Id]


class Timeline:
    """The fence of one device.

    Attributes:
        signalled: the last signalled value; 0 before the first.
        refusals: raises and keeps the errors of refused calls.
        living: by id, the sizes in bytes of the resources that exist and aren't retired, but for the device's
            own.
        memory: the buffers and textures on the backend.
        sites: by id, the line that created the resource, if lines are noted.
        waited: the seconds that the CPU has waited for the GPU since the last call of `present`.
    """

    __slots__ = (
        "_backend",
        "_completed",
        "_dropped",
        "_holders",
        "_last_flush",
        "_lock",
        "_retired",
        "_waiting",
        "_waiting_bytes",
        "_watchers",
        "living",
        "memory",
        "refusals",
        "signalled",
        "sites",
        "waited",
    )

    def __init__(self, backend: Backend, refusals: RefusalLog = NO_LOG) -> None:
        self._backend = backend
        self.refusals = refusals
        self.signalled = 0
        self.waited = 0.0  # seconds
        self._completed = 0
        self.living: dict[Id, int] = {}
        self.memory = MemoryLedger()
        self.sites: dict[Id, CallSite] = {}
        self._dropped: deque[Id | _Holder] = deque()
        self._holders: dict[int, _Holder] = {}
        self._retired: deque[tuple[int, Id]] = deque()
        self._waiting = self._waiting_bytes = 0  # retired since the last signal
        self._last_flush = 0  # the value that `make_room` signalled last
        self._watchers: dict[Id, WeakSet[Watcher]] = {_ALL: WeakSet()}
        self._lock = threading.RLock()  # the garbage collector may retire something while it is held

    def signal(self) -> int:
        """Put the next value into the command stream and return it."""
        if self._dropped:
            self._retire_dropped()
        value = self.signalled + 1
        self._backend.signal(value)
        self.signalled = value
        self._waiting = self._waiting_bytes = 0
        if not value % MAX_WAITING:  # a backend keeps each value until it is asked which ones have passed
            self._completed = self._backend.completed()
        return value

    @property
    def completed(self) -> int:
        """The last fence value that the GPU has reached; never blocks."""
        if self._completed != self.signalled:
            self._completed = self._backend.completed()
        return self._completed

    def wait(self, value: int, seconds: float | None = None) -> bool:
        """Block until the GPU has reached `value`, for at most `seconds` (None: no limit); return whether it
        has.

        Raises:
            ValidationError: `fence-value` for a value that was never signalled: the wait would never end.
            DeviceError: `device-lost` if, without a limit, the GPU has not reached it within an hour.
        """
        if not 0 <= value <= self.signalled:
            self.refusals.refuse(FENCE_VALUE, f"device.wait({value})", value, f"0 to {self.signalled}")
        if value <= self._completed or value <= self.completed:
            return True
        began = perf_counter()
        reached = self._backend.wait(value, FOREVER if seconds is None else seconds)
        self.waited += perf_counter() - began
        if reached:
            self._completed = max(self._completed, value)
        elif seconds is None:
            self.refusals.fail(
                DeviceError(DEVICE_LOST, f"device.wait({value})", f"no answer in {FOREVER:.0f} s")
            )
        return reached

    def retire(self, resource: Id) -> None:
        """Destroy `resource` once the GPU has executed everything submitted so far."""
        with DeferredInterrupts():  # all of it or none
            if resource in self._watchers or self._watchers[_ALL]:
                with self._lock:
                    watchers = [*self._watchers[_ALL], *self._watchers.pop(resource, ())]
                for watcher in watchers:  # first, so that what was made of a resource is destroyed before it
                    watcher.note_retired(resource)
            self._retired.append((self.signalled + 1, resource))
            self._waiting += 1
            self._waiting_bytes += self.living.pop(resource, 0)
            self.sites.pop(resource, None)

    def drop(self, resource: Id) -> None:
        """Queue a resource that nobody holds any more for `retire`. May be called by finalizers."""
        self._dropped.append(resource)

    def hold(self, holder: object, ids: list[Id]) -> None:
        """Drop the resources `ids` when the last reference to `holder` goes. No Python function runs then, so
        no interrupt can cut it off."""
        entry = _Holder(holder, self._dropped.append)
        entry.ids = ids
        self._holders[id(entry)] = entry

    def _retire_dropped(self) -> None:
        """Retire what was dropped since the last call, unless it was destroyed before."""
        with DeferredInterrupts():
            while self._dropped:
                dropped = self._dropped.popleft()
                if isinstance(dropped, _Holder):
                    del self._holders[id(dropped)]
                    self._dropped.extend(dropped.ids)
                elif dropped in self.living:
                    self.retire(dropped)

    def watch(self, watcher: Watcher, resource: Id = _ALL) -> None:
        """Notify `watcher` when `resource` is retired, or each resource, for as long as it lives. May be
        called from any thread."""
        with self._lock:
            self._watchers.setdefault(resource, WeakSet()).add(watcher)

    def collect(self) -> None:
        """Destroy the retired resources that the GPU no longer uses."""
        if not self._retired:
            return
        completed = self.completed
        while self._retired and self._retired[0][0] <= completed:
            with DeferredInterrupts():
                resource = self._retired.popleft()[1]
                self._backend.destroy(resource)
                if (entry := self.memory.entries.pop(resource, None)) is not None:
                    self.memory.total -= entry[1]

    @property
    def retired_bytes(self) -> int:
        """Bytes of what is destroyed as soon as the GPU has passed a value."""
        return sum(self.memory.size_of(resource) for _, resource in self._retired)

    def reclaim(self) -> bool:
        """Wait for the GPU, to destroy every retired resource; return whether there was any."""
        if not self._retired and not self._dropped:
            return False
        self.wait(self.signal())
        self.collect()
        return True

    def make_room(self) -> None:
        """Destroy retired resources if many were retired since the last signal; called before a creation.

        It waits for the previous batch, so that at most two batches exist.
        """
        if self._dropped:
            self._retire_dropped()
        if self._waiting >= MAX_WAITING or self._waiting_bytes >= MAX_WAITING_BYTES:
            value = self.signal()
            self.wait(self._last_flush)
            self._last_flush = value
            self.collect()
