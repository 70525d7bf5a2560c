"""Memory for asynchronous reads: buffers that the GPU copies into and the CPU reads once a fence has passed.

- A read takes a buffer and gives it back when its bytes were fetched. Buffers are reused by size, so reads of
  the same size in each frame allocate nothing.
- At most `limit` bytes are allocated. A read beyond that first fetches the oldest results that nobody
  fetched, which waits for them.
- The memory of a result that was dropped without being fetched is reused once the GPU has written it.
"""

from __future__ import annotations

import weakref
from collections import deque
from collections.abc import Callable
from typing import Final, Protocol

from rhi.contract.backend import Backend
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id
from rhi.device.core.timeline import Timeline
from rhi.errors.named_tuples import NamedTuple

LIMIT: Final = 1 << 27
_PAGE: Final = 1 << 12
_MAX_FREE: Final = 4


class PendingRead(Protocol):
    """A read with its result in a buffer of the pool."""

    def fetch(self) -> None:
        """Wait for the result, copy it out of the buffer and give the buffer back."""


class _Lease(NamedTuple):
    """A buffer in use. The GPU has written it when the fence has reached `fence`."""

    size: int
    fence: int
    owner: weakref.ref[PendingRead]


class ReadbackPool:
    """The buffers of one device's asynchronous reads.

    Attributes:
        allocated: bytes of all buffers, those that are free included.
        limit: the largest value of `allocated`; one read that is larger gets its memory when it is alone.
    """

    __slots__ = ("_backend", "_dropped", "_free", "_leases", "_new_id", "_timeline", "allocated", "limit")

    def __init__(
        self, backend: Backend, timeline: Timeline, new_id: Callable[[], Id], limit: int = LIMIT
    ) -> None:
        self._backend = backend
        self._timeline = timeline
        self._new_id = new_id
        self._leases: dict[Id, _Lease] = {}  # the oldest first
        self._free: deque[tuple[Id, int]] = deque()
        self._dropped: deque[Id] = deque()  # the garbage collector may append from any thread
        self.allocated = 0
        self.limit = limit

    def take(self, owner: PendingRead, size: int) -> Id:
        """Return a buffer of at least `size` bytes for a copy that the next signalled fence value follows."""
        size = -(-size // _PAGE) * _PAGE
        self._collect_dropped()
        buffer = self._take_free(size)
        if not buffer:
            while self.allocated + size > self.limit and (self._free or self._leases):
                self._make_room()
            buffer = self._new_id()
            descriptor = BufferDescriptor(size, BufferUsage.READBACK, "readback")
            self._backend.create_buffer(buffer, descriptor)
            self._timeline.memory.add(buffer, descriptor)
            self.allocated += size
        dropped = self._dropped
        reference = weakref.ref(owner, lambda _: dropped.append(buffer))
        self._leases[buffer] = _Lease(size, self._timeline.signalled + 1, reference)
        return buffer

    def give_back(self, buffer: Id) -> None:
        """Make a buffer free, after the fence has passed the copy into it."""
        lease = self._leases.pop(buffer, None)
        if lease is not None:
            self._free.append((buffer, lease.size))
            if len(self._free) > _MAX_FREE:
                self._destroy_free()

    def _take_free(self, size: int) -> Id:
        for index, (buffer, capacity) in enumerate(self._free):
            if capacity == size:
                del self._free[index]
                return buffer
        return 0

    def _destroy_free(self) -> None:
        buffer, size = self._free.popleft()
        self.allocated -= size
        self._timeline.retire(buffer)

    def _collect_dropped(self) -> None:
        """Free the buffers of dropped results that the GPU has written."""
        for _ in range(len(self._dropped)):
            buffer = self._dropped.popleft()
            lease = self._leases.get(buffer)
            if lease is None:
                continue
            if lease.fence <= self._timeline.completed:
                self.give_back(buffer)
            else:
                self._dropped.append(buffer)

    def _make_room(self) -> None:
        """Release a free buffer or, if none is free, wait for the oldest read."""
        if self._free:
            self._destroy_free()
            return
        buffer, lease = next(iter(self._leases.items()))
        owner = lease.owner()
        if owner is not None:
            owner.fetch()
            return
        if lease.fence > self._timeline.signalled:  # the copy was refused by the backend
            self._timeline.signal()
        self._timeline.wait(lease.fence)
        self.give_back(buffer)
