"""The latest values of something that is measured once a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class History:
    """The latest `capacity` values; the memory is allocated once."""

    def __init__(self, capacity: int) -> None:
        self._values = np.zeros(2 * capacity)  # each value twice, so that the latest lie side by side
        self._capacity = capacity
        self._count = 0

    def add(self, value: float) -> None:
        """Add a value, which replaces the oldest one if there is no room."""
        slot = self._count % self._capacity
        self._values[slot] = self._values[slot + self._capacity] = value
        self._count += 1

    @property
    def values(self) -> NDArray[np.float64]:
        """The values, oldest first. The array is overwritten by later ones."""
        count = min(self._count, self._capacity)
        end = (self._count - 1) % self._capacity + 1 + self._capacity
        return self._values[end - count : end]
