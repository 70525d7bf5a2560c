"""Ring memory: transient bytes that the CPU writes while the GPU still reads earlier ones (thesis 4.3.1).

- Positions only grow; a place in the buffer is a position modulo the capacity (a power of two). What lies
  between `tail` and `head` may still be read by the GPU and is never given out again.
- `mark(fence)`, at the end of a frame, says that everything given out so far is free once that fence has
  passed; `tail` follows.
- A request that doesn't fit, even after looking at the fences, doubles the ring: a new buffer takes over and
  the old one lives to the end of the frame. So a ring settles at the size that its frames need and never
  waits. Only at `limit` it waits for the oldest frame, and refuses what a single frame can't have.
- A request never straddles the end of the buffer: it starts at the next turn instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NoReturn

from typing_extensions import Buffer as BytesLike

from rhi.contract.backend import Backend
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id
from rhi.device.core.timeline import Timeline
from rhi.errors.rules import TRANSIENT_SIZE

__rhi_internal__ = True

LIMIT: Final = 1 << 28


class Ring:
    """Transient memory of one device.

    Attributes:
        buffer: the backend buffer that new places lie in; changes when the ring grows.
        capacity: bytes, a power of two.
        generation: how often the ring has grown; what was bound or built on an older one is out of date.
    """

    __slots__ = ("_backend", "_head", "_marks", "_new_id", "_outgrown", "_tail", "_timeline", "buffer", "capacity",
                 "generation", "label", "limit")  # fmt: skip

    def __init__(
        self, backend: Backend, timeline: Timeline, new_id: Callable[[], Id], capacity: int, label: str,
        limit: int = LIMIT,
    ) -> None:  # fmt: skip
        self._backend = backend
        self._timeline = timeline
        self._new_id = new_id
        self._head = self._tail = 0
        self._marks: deque[tuple[int, int]] = deque()
        self._outgrown: list[Id] = []
        self.capacity = 1 << (max(capacity, 256) - 1).bit_length()
        self.limit = 1 << (max(limit, self.capacity) - 1).bit_length()
        self.label = label
        self.generation = 0
        self.buffer: Id = 0

    def write(self, data: BytesLike, size: int, alignment: int) -> int:
        """Put `size` bytes into the ring; returns their offset in `buffer`, a multiple of `alignment`.

        Raises:
            ValidationError: `transient-size` if the frame needs more than the ring's limit.
        """
        offset = self.allocate(size, alignment)
        self._backend.write_buffer(self.buffer, offset, data)
        return offset

    def allocate(self, size: int, alignment: int) -> int:
        """The offset of `size` free bytes in `buffer`."""
        if size > self.limit:
            self._refuse(size)
        while True:
            start = self._fit(size, alignment)
            if start + size - self._tail <= self.capacity and self.buffer:
                self._head = start + size
                return start & (self.capacity - 1)
            self._make_room(size, alignment)

    def mark(self, fence: int) -> None:
        """The frame ends: what was given out so far is free once `fence` has passed."""
        for buffer in self._outgrown:
            self._timeline.retire(buffer)
        self._outgrown.clear()
        if self._head != (self._marks[-1][1] if self._marks else self._tail):
            self._marks.append((fence, self._head))

    @property
    def in_use(self) -> int:
        """Bytes that the GPU may still read, or that lie unused before the end of a turn."""
        return self._head - self._tail

    def _fit(self, size: int, alignment: int) -> int:
        """The position at or after `head` where `size` aligned bytes don't straddle the buffer's end.

        Alignments needn't be powers of two (a vertex's stride isn't), so it is the place in the buffer, not
        the position, that is aligned.
        """
        turn, place = self._head & -self.capacity, self._head & (self.capacity - 1)
        place += -place % alignment
        if place + size > self.capacity:
            turn, place = turn + self.capacity, 0
        return turn + place

    def _make_room(self, size: int, alignment: int) -> None:
        """Free what the GPU is done with; if that isn't enough grow, or at the limit wait."""
        self._release(self._timeline.completed)
        if self.buffer and self._fit(size, alignment) + size - self._tail <= self.capacity:
            return
        if not self.buffer or self.capacity < self.limit:
            self._grow(size)
            return
        if not self._marks:
            self._refuse(size)  # all of it was given out in this frame
        self._timeline.wait(self._marks[0][0])
        self._release(self._marks[0][0])

    def _refuse(self, size: int) -> NoReturn:
        given = f"{size} bytes more, {self.in_use} in use"
        self._timeline.refusals.refuse(
            TRANSIENT_SIZE, f"{self.label} memory", given, f"at most {self.limit} a frame"
        )

    def _release(self, completed: int) -> None:
        marks = self._marks
        while marks and marks[0][0] <= completed:
            self._tail = marks.popleft()[1]
        if self._tail == self._head:
            # An empty ring starts over, so that a request as large as the ring fits whatever came before.
            self._head = self._tail = 0

    def _grow(self, size: int) -> None:
        capacity = self.capacity
        if self.buffer:
            capacity *= 2
        while capacity < size:
            capacity *= 2
        buffer = self._new_id()
        self._backend.create_buffer(buffer, BufferDescriptor(capacity, BufferUsage.STREAM, self.label))
        if self.buffer:
            self._outgrown.append(self.buffer)
            self.generation += 1
        self.buffer, self.capacity = buffer, capacity
        self._head = self._tail = 0
        self._marks.clear()
