"""Ring buffers for transient memory, which the CPU writes while the GPU still reads earlier parts (thesis
4.3.1).

- Positions only grow; the offset in the buffer is the position modulo the capacity (a power of two). Memory
  between `tail` and `head` may still be read by the GPU and is not allocated again.
- `mark(fence)`, at the end of a frame, frees everything allocated so far once that fence value has passed:
  `tail` advances.
- A request that doesn't fit, even after polling the fence, doubles the ring: a new buffer replaces the old
  one, which lives until the end of the frame. So a ring settles at the size that its frames need and never
  waits. Only at `limit` it waits for the oldest frame, and refuses a frame that needs more than that.
- Where writes are ordered (`SupportsOrderedWrites`), a frame's memory is free at its end, and the next frame
  begins at offset 0. So frames that draw the same have the same offsets, whatever values they write.
- An allocation never straddles the end of the buffer: it starts at the beginning of the buffer instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final, NoReturn

from typing_extensions import Buffer as BytesLike

from rhi.contract.backend import Backend
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id
from rhi.contract.interrupts import DeferredInterrupts
from rhi.device.core.timeline import Timeline
from rhi.errors.rules import TRANSIENT_SIZE

LIMIT: Final = 1 << 28


class Ring:
    """A ring buffer of transient memory.

    Attributes:
        buffer: id of the backend buffer that new allocations lie in; changes when the ring grows.
        capacity: size in bytes, a power of two.
        generation: number of times the ring has grown; bindings and vertex arrays of older generations are
            outdated.
    """

    __slots__ = (
        "_backend",
        "_check",
        "_head",
        "_marks",
        "_new_id",
        "_outgrown",
        "_restarts",
        "_tail",
        "_timeline",
        "buffer",
        "capacity",
        "generation",
        "label",
        "limit",
    )

    def __init__(
        self,
        backend: Backend,
        timeline: Timeline,
        new_id: Callable[[], Id],
        capacity: int,
        label: str,
        limit: int = LIMIT,
        check: Callable[[], None] = lambda: None,
        restarts: bool = False,
    ) -> None:
        """`check` is called before anything but a write reaches the backend. `restarts`: a frame's memory is free
        at its end."""
        self._backend = backend
        self._check = check
        self._restarts = restarts
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
        """Upload `size` bytes to the ring and return their offset in `buffer`, a multiple of `alignment`.

        Raises:
            ValidationError: `transient-size` if the frame needs more than the ring's limit.
        """
        capacity, offset = self.capacity, self._head & (self.capacity - 1)
        offset += -offset % alignment
        end = (self._head & -capacity) + offset + size
        if offset + size <= capacity and end - self._tail <= capacity and self.buffer:
            self._head = end  # as `allocate` does, without its frame
        else:
            offset = self.allocate(size, alignment)
        self._backend.write_buffer(self.buffer, offset, data)
        return offset

    def allocate(self, size: int, alignment: int) -> int:
        """Allocate `size` bytes and return their offset in `buffer`."""
        capacity, offset = self.capacity, self._head & (self.capacity - 1)
        offset += -offset % alignment
        end = (self._head & -capacity) + offset + size
        if offset + size <= capacity and end - self._tail <= capacity and self.buffer:
            self._head = end
            return offset
        if size > self.limit:
            self._refuse(size)
        while True:
            start = self._fit(size, alignment)
            if start + size - self._tail <= self.capacity and self.buffer:
                self._head = start + size
                return start & (self.capacity - 1)
            self._make_room(size, alignment)

    def mark(self, fence: int) -> None:
        """End the frame: everything allocated so far is free once `fence` has passed, or at once."""
        if self._outgrown:
            with DeferredInterrupts():
                while self._outgrown:
                    self._timeline.retire(self._outgrown.pop())
        if self._restarts:
            self._head = self._tail = 0
        elif self._head != (self._marks[-1][1] if self._marks else self._tail):
            self._marks.append((fence, self._head))

    @property
    def in_use(self) -> int:
        """Number of bytes that the GPU may still read, or that are skipped at the end of the buffer."""
        return self._head - self._tail

    def _fit(self, size: int, alignment: int) -> int:
        """Return the first position from `head` on where `size` aligned bytes don't straddle the buffer's
        end.

        Alignments need not be powers of two (the stride of a vertex is not), so the offset in the buffer is
        aligned, not the position.
        """
        base, offset = self._head & -self.capacity, self._head & (self.capacity - 1)
        offset += -offset % alignment
        if offset + size > self.capacity:
            base, offset = base + self.capacity, 0
        return base + offset

    def _make_room(self, size: int, alignment: int) -> None:
        """Free memory that the GPU no longer reads; if that is not enough, grow the ring, or wait at the
        limit."""
        self._check()
        self._release(self._timeline.completed)
        if self.buffer and self._fit(size, alignment) + size - self._tail <= self.capacity:
            return
        if not self.buffer or self.capacity < self.limit:
            self._grow(size)
            return
        if not self._marks:
            self._refuse(size)  # this frame has allocated all of it
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
            # An empty ring restarts at 0, so that a request as large as the ring always fits.
            self._head = self._tail = 0

    def _grow(self, size: int) -> None:
        capacity = self.capacity
        if self.buffer:
            capacity *= 2
        while capacity < size:
            capacity *= 2
        with DeferredInterrupts():
            buffer = self._new_id()
            descriptor = BufferDescriptor(capacity, BufferUsage.STREAM, self.label)
            self._backend.create_buffer(buffer, descriptor)
            self._timeline.memory.add(buffer, descriptor)
            if self.buffer:
                self._outgrown.append(self.buffer)
                self.generation += 1
            self.buffer, self.capacity = buffer, capacity
            self._head = self._tail = 0
            self._marks.clear()
