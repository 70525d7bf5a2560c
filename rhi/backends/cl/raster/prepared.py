"""What of a draw stays the same from frame to frame: tables of prepared draws."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.tables import DRAW, MAX_STREAMS

__rhi_internal__ = True


class PreparedDraws:
    """What of a draw stays the same from frame to frame: growing tables.

    Attributes: draws: of `DRAW`, without what is numbered batch by batch. streams: the addresses of each one's vertex
    streams, (n, MAX_STREAMS). arrays: each one's vertex array. seen: whether it was drawn since it was prepared or
    its vertices changed. version: changes when boxes do (rhi.backends.cl.raster.boxes), without which nothing changes
    that is drawn again.
    """

    def __init__(self) -> None:
        size = 256
        self.draws = np.zeros(size, DRAW)
        self.streams = np.zeros((size, MAX_STREAMS), np.uint64)
        self.arrays = np.zeros(size, np.int64)
        self.seen = np.zeros(size, bool)
        self.version = 0
        self._free: list[int] = list(range(size))
        self._left: list[int] = []

    def add(self) -> int:
        """A place that nobody uses."""
        if not self._free:
            size = len(self.draws)
            self.draws = np.concatenate([self.draws, np.zeros_like(self.draws)])
            self.streams = np.concatenate([self.streams, np.zeros_like(self.streams)])
            self.arrays = np.concatenate([self.arrays, np.zeros_like(self.arrays)])
            self.seen = np.concatenate([self.seen, np.zeros_like(self.seen)])
            self._free = list(range(size, 2 * size))
        return self._free.pop()

    def leave(self, place: int) -> None:
        """It may be used again once the draws gathered now are flushed."""
        self._left.append(place)

    def take(self, places: NDArray[np.int64]) -> NDArray[Any]:
        """A copy of these rows of `draws`. They are moved as plain words: NumPy moves structs field by field."""
        words = self.draws.view(np.uint64).reshape(len(self.draws), -1)
        return words.take(places, axis=0).view(DRAW).reshape(-1)

    def recycle(self) -> None:
        """No draw that was gathered needs what was left."""
        self._free += self._left
        self._left.clear()
