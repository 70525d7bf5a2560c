"""Quads, which GL's core profile lacks. They are drawn as indexed triangles 0 1 2, 0 2 3 of each quad."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import moderngl
import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import IndexFormat

__rhi_internal__ = True

CORNERS: Final = np.array([0, 1, 2, 0, 2, 3], np.uint32)


class QuadIndices:
    """An index buffer shared by all quads without indices. A draw passes its first vertex as the base vertex."""

    def __init__(self, context: moderngl.Context, check_context: Callable[[], None]) -> None:
        """`check_context` raises if another context is current."""
        self._context = context
        self._check_context = check_context
        self._buffer: moderngl.Buffer | None = None
        self._capacity = 0

    def release(self) -> None:
        """Release the buffer."""
        if self._buffer is not None:
            self._buffer.release()
            self._buffer, self._capacity = None, 0

    def reserve(self, quads: int) -> int:
        """Return GL's name of a buffer with 32-bit indices for at least `quads` quads. Growth changes the name."""
        if self._buffer is None or quads > self._capacity:
            self._check_context()
            if self._buffer is not None:
                self._buffer.release()
            self._capacity = max(1024, 1 << (quads - 1).bit_length())
            firsts = 4 * np.arange(self._capacity, dtype=np.uint32)[:, None]
            self._buffer = self._context.buffer(firsts + CORNERS)
        return self._buffer.glo


def expand_indices(indices: bytes, index_format: IndexFormat) -> NDArray[np.generic]:
    """Return the triangle indices of indexed quads: an array (quads, 6)."""
    return np.ascontiguousarray(np.frombuffer(indices, index_format.dtype).reshape(-1, 4)[:, CORNERS])
