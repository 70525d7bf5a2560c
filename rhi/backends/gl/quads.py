"""Quads, which GL's core profile lacks. They are drawn as indexed triangles 0 1 2, 0 2 3 of each quad.

Quads without indices share one index buffer. The indices of others are read back, which waits for the GPU,
and expanded once: the result is kept until a command changes them. Changes of mapped memory, and of buffers
that shaders may write, can't be observed; draws from such a buffer expand their indices each time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import moderngl
import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl.gl_buffers import Buffers
from rhi.contract.descriptors import Id
from rhi.contract.formats import IndexFormat

CORNERS: Final = np.array([0, 1, 2, 0, 2, 3], np.uint32)


class QuadIndices:
    """The index buffers with which quads are drawn as triangles."""

    def __init__(
        self, context: moderngl.Context, buffers: Buffers, check_context: Callable[[], None]
    ) -> None:
        """`check_context` raises if another context is current."""
        self._context = context
        self._buffers = buffers
        self._check_context = check_context
        self._buffer: moderngl.Buffer | None = None
        self._capacity = 0
        self._expanded: dict[Id, dict[tuple[IndexFormat, int], moderngl.Buffer]] = {}
        self._latest: moderngl.Buffer | None = None  # of the latest draw whose indices can't be kept

    def release(self) -> None:
        """Release all buffers."""
        if self._buffer is not None:
            self._buffer.release()
            self._buffer, self._capacity = None, 0
        if self._latest is not None:
            self._latest.release()
            self._latest = None
        for buffer in list(self._expanded):
            self._forget(buffer)

    def expand(self, buffer: Id, form: IndexFormat, first: int, quads: int) -> tuple[int, int]:
        """Return GL's name of a buffer with the triangle indices of indexed quads, and the byte at which they
        begin.

        The name is valid until the next call, or until `buffer` changes.

        Args:
            first: the first index of `quads` quads.
        """
        corner = first % 4  # where the first quad of all begins
        expanded = self._expanded.get(buffer, {}).get((form, corner))
        if expanded is None:
            self._check_context()
            if self._latest is not None:
                self._latest.release()
                self._latest = None
            if not self._buffers.watch(buffer, self._forget):
                data = self._buffers.read(buffer, first * form.size, 4 * quads * form.size)
                self._latest = self._context.buffer(expand_indices(data, form))
                return self._latest.glo, 0
            whole = (self._buffers.objects[buffer].size // form.size - corner) // 4
            data = self._buffers.read(buffer, corner * form.size, 4 * whole * form.size)
            expanded = self._context.buffer(expand_indices(data, form))
            self._expanded.setdefault(buffer, {})[form, corner] = expanded
        return expanded.glo, first // 4 * CORNERS.size * form.size

    def _forget(self, buffer: Id) -> None:
        for expanded in self._expanded.pop(buffer, {}).values():
            expanded.release()

    def reserve(self, quads: int) -> int:
        """Return GL's name of a buffer with 32-bit indices for at least `quads` quads without indices, whose
        first vertex is the draw's base vertex. Growth changes the name."""
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
