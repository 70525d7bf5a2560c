"""The latest values of something that is measured once a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


class History:
    """The latest `room` values; the memory is allocated once."""

    def __init__(self, room: int) -> None:
        self._values = np.zeros(2 * room)  # each value twice, so that the latest lie side by side
        self._room = room
        self._count = 0

    def add(self, value: float) -> None:
        """Add a value, which replaces the oldest one if there is no room."""
        place = self._count % self._room
        self._values[place] = self._values[place + self._room] = value
        self._count += 1

    @property
    def values(self) -> NDArray[np.float64]:
        """The values, oldest first. The array is overwritten by later ones."""
        count = min(self._count, self._room)
        end = (self._count - 1) % self._room + 1 + self._room
        return self._values[end - count : end]
