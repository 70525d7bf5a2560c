"""Prepared draws: tables of what stays the same of a draw from frame to frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.raster.tables import DRAW_STRUCT, MAX_STREAMS

__rhi_internal__ = True


class PreparedDraws:
    """The prepared draws of one device: tables that grow, with a row for each.

    Attributes:
        draws: (n,) of `DRAW_STRUCT`, without the fields that are numbered batch by batch.
        streams: (n, MAX_STREAMS) addresses of the vertex streams.
        arrays: (n,) ids of the vertex arrays.
        seen: (n,) whether the draw was drawn since it was prepared or its vertices changed.
        version: changes whenever boxes do (rhi.backends.cl.raster.boxes). As long as it stays, rows that are in use
            don't change.
    """

    def __init__(self) -> None:
        size = 256
        self.draws = np.zeros(size, DRAW_STRUCT)
        self.streams = np.zeros((size, MAX_STREAMS), np.uint64)
        self.arrays = np.zeros(size, np.int64)
        self.seen = np.zeros(size, bool)
        self.version = 0
        self._free: list[int] = list(range(size))
        self._released: list[int] = []  # still referenced by gathered draws

    def add(self) -> int:
        """Return a free row's number."""
        if not self._free:
            size = len(self.draws)
            self.draws = np.concatenate([self.draws, np.zeros_like(self.draws)])
            self.streams = np.concatenate([self.streams, np.zeros_like(self.streams)])
            self.arrays = np.concatenate([self.arrays, np.zeros_like(self.arrays)])
            self.seen = np.concatenate([self.seen, np.zeros_like(self.seen)])
            self._free = list(range(size, 2 * size))
        return self._free.pop()

    def release(self, number: int) -> None:
        """Free a row once the draws gathered so far are flushed."""
        self._released.append(number)

    def take(self, numbers: NDArray[np.int64]) -> NDArray[Any]:
        """Return a copy of rows of `draws`. They are copied as plain words: NumPy copies structs field by field."""
        words = self.draws.view(np.uint64).reshape(len(self.draws), -1)
        return words.take(numbers, axis=0).view(DRAW_STRUCT).reshape(-1)

    def recycle(self) -> None:
        """Free the released rows, since the gathered draws have been flushed."""
        self._free += self._released
        self._released.clear()


class DrawSlot:
    """A row of the prepared draws; released together with its holder.

    Attributes:
        memory: the index list that the row refers to, kept alive here.
    """

    __slots__ = ("_release", "memory", "number")

    def __init__(self, prepared: PreparedDraws) -> None:
        self.number = prepared.add()
        self.memory: object = None
        self._release = prepared.release

    def __del__(self) -> None:
        self._release(self.number)
