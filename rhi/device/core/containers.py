"""A fixed-size stack and queue (thesis 6.5.2 and 6.5.3, Listings 6.3 to 6.5).

- Memory is allocated once; pushing and popping allocates nothing.
- Overflow and underflow are errors; no element is lost and no stale element is returned.
- The queue keeps a read position and a count, so that it can tell full from empty (the thesis's two indices
  can't). It wraps without a branch: positions only grow and are masked, since the memory is a power of two.
  (Listing 6.5 wraps at `dataSize` inclusive and so touches one element past its array, which a mask can't.)
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Generic, TypeVar

from rhi.errors import refuse
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.rules import CONTAINER_CAPACITY, CONTAINER_EMPTY, CONTAINER_FULL

T = TypeVar("T")
MAX_CAPACITY: Final = (1 << 31) - 1
"""The largest capacity."""


class FixedStack(Generic[T]):
    """A stack of at most `capacity` elements.

    `len` is the number of elements, `capacity` the largest possible number. (The thesis's `size()` is the
    capacity.)

    Raises:
        ValidationError: `container-capacity` for a capacity below 1.
    """

    __slots__ = ("_data", "_index", "capacity")

    def __init__(self, capacity: int) -> None:
        capacity = ArgumentChecker("FixedStack(capacity)", rule=CONTAINER_CAPACITY).integer(
            "capacity", capacity, 1, MAX_CAPACITY
        )
        self.capacity = capacity
        self._data: list[T | None] = [None] * capacity
        self._index = 0

    def push(self, value: T) -> None:
        """Push `value` onto the stack; `container-full` if it is full, which leaves it unchanged."""
        try:
            self._data[self._index] = value
        except IndexError:
            refuse(CONTAINER_FULL, "FixedStack.push", f"{self._index} elements", f"at most {self.capacity}")
        self._index += 1

    def pop(self) -> T:
        """Remove and return the top element; `container-empty` if there is none."""
        index = self._index - 1
        if index < 0:
            refuse(CONTAINER_EMPTY, "FixedStack.pop", "no element", "at least one")
        self._index = index
        value = self._data[index]
        self._data[index] = None
        return value  # type: ignore[return-value]  # every element below _index was pushed

    @property
    def top(self) -> T:
        """The element pushed last; `container-empty` if there is none."""
        if not self._index:
            refuse(CONTAINER_EMPTY, "FixedStack.top", "no element", "at least one")
        return self._data[self._index - 1]  # type: ignore[return-value]

    def __getitem__(self, index: int) -> T:
        """Return an element; 0 is the bottom."""
        return self._data[: self._index][index]  # type: ignore[return-value]

    def clear(self) -> None:
        """Remove all elements."""
        data = self._data
        for index in range(self._index):
            data[index] = None
        self._index = 0

    def __len__(self) -> int:
        return self._index

    def __iter__(self) -> Iterator[T]:
        """Iterate from the bottom to the top."""
        return iter(self._data[: self._index])  # type: ignore[arg-type]


class FixedQueue(Generic[T]):
    """A first-in first-out queue of at most `capacity` elements.

    All of the capacity can be used. The memory behind it is the next power of two.

    Raises:
        ValidationError: `container-capacity` for a capacity below 1.
    """

    __slots__ = ("_count", "_data", "_mask", "_read", "capacity")

    def __init__(self, capacity: int) -> None:
        capacity = ArgumentChecker("FixedQueue(capacity)", rule=CONTAINER_CAPACITY).integer(
            "capacity", capacity, 1, MAX_CAPACITY
        )
        self.capacity = capacity
        size = 1 << (capacity - 1).bit_length()
        self._mask = size - 1
        self._data: list[T | None] = [None] * size
        self._read = 0
        self._count = 0

    def push(self, value: T) -> None:
        """Append `value` at the back; `container-full` if the queue is full, which leaves it unchanged."""
        count = self._count
        if count == self.capacity:
            refuse(CONTAINER_FULL, "FixedQueue.push", f"{count} elements", f"at most {self.capacity}")
        self._data[(self._read + count) & self._mask] = value
        self._count = count + 1

    def pop(self) -> T:
        """Remove and return the front element; `container-empty` if there is none."""
        if not self._count:
            refuse(CONTAINER_EMPTY, "FixedQueue.pop", "no element", "at least one")
        index = self._read & self._mask
        value = self._data[index]
        self._data[index] = None
        self._read += 1
        self._count -= 1
        return value  # type: ignore[return-value]

    @property
    def front(self) -> T:
        """The element pushed first; `container-empty` if there is none."""
        if not self._count:
            refuse(CONTAINER_EMPTY, "FixedQueue.front", "no element", "at least one")
        return self._data[self._read & self._mask]  # type: ignore[return-value]

    @property
    def is_full(self) -> bool:
        """True if the next push would be refused."""
        return self._count == self.capacity

    def clear(self) -> None:
        """Remove all elements."""
        data, mask = self._data, self._mask
        for position in range(self._read, self._read + self._count):
            data[position & mask] = None
        self._read = self._count = 0

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[T]:
        """Iterate from the front to the back."""
        for position in range(self._read, self._read + self._count):
            yield self._data[position & self._mask]  # type: ignore[misc]
