"""Quads, which GL's core profile lacks. They are drawn as indexed triangles 0 1 2, 0 2 3 of each quad.

Quads without indices share one index buffer. The indices of others are read back, which waits for the GPU,
and expanded once: the result is cached until a command changes them. Changes of mapped memory, and of buffers
that shaders may write, can't be observed; draws from such a buffer expand their indices each time. Where the
restart index is among them, quads begin anywhere: each range of a draw is then expanded for itself.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import moderngl
import numpy as np
from numpy.typing import NDArray

from rhi.backends.gl.gl_buffers import Buffers
from rhi.contract.descriptors import Id, Primitive
from rhi.contract.formats import IndexFormat
from rhi.contract.topology import list_primitives

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
        self._expanded: dict[Id, dict[tuple[object, ...], moderngl.Buffer]] = {}
        self._latest: moderngl.Buffer | None = None  # of the latest draw whose indices can't be cached

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

    def expand(self, buffer: Id, form: IndexFormat, first: int, count: int) -> tuple[int, int, int]:
        """Return the triangle indices of indexed quads: GL's name of a buffer, the byte at which they begin,
        and how many there are.

        The name is valid until the next call, or until `buffer` changes.

        Args:
            first: the first index of `count`, of which the last ones may be no whole quad.
        """
        corner = first % 4  # where the first quad of all begins
        cached = self._expanded.get(buffer, {})
        expanded = cached.get((form, corner)) or cached.get((form, first, count))
        if expanded is None:
            self._check_context()
            if self._latest is not None:
                self._latest.release()
                self._latest = None
            if not self._buffers.watch(buffer, self._forget):
                corners = self._read(buffer, form, first, count)
                self._latest = self._context.buffer(corners) if corners.size else None
                return (self._latest.glo if self._latest is not None else 0), 0, corners.size
            size = self._buffers.objects[buffer].size // form.size
            key: tuple[object, ...] = form, corner
            corners = self._read(buffer, form, corner, (size - corner) // 4 * 4)
            if corners.size != (size - corner) // 4 * 6:  # with restarts, quads begin anywhere
                key, corners = (form, first, count), self._read(buffer, form, first, count)
            expanded = self._context.buffer(corners) if corners.size else None
            if expanded is None:
                return 0, 0, 0
            self._expanded.setdefault(buffer, {})[key] = expanded
            cached = self._expanded[buffer]
        if (form, corner) in cached:
            return expanded.glo, first // 4 * 6 * form.size, count // 4 * 6
        return expanded.glo, 0, expanded.size // form.size

    def _read(self, buffer: Id, form: IndexFormat, first: int, count: int) -> NDArray[np.generic]:
        return expand_indices(self._buffers.read(buffer, first * form.size, count * form.size), form)

    def _forget(self, buffer: Id) -> None:
        for expanded in self._expanded.pop(buffer, {}).values():
            expanded.release()

    def reserve(self, quads: int) -> int:
        """Return GL's name of a buffer with 32-bit indices for at least `quads` quads without indices, whose
        first vertex is the draw's base vertex. Growth changes the name."""
        if self._buffer is None or quads > self._capacity:
            self._check_context()
            capacity = max(1024, 1 << (quads - 1).bit_length())
            firsts = 4 * np.arange(capacity, dtype=np.uint32)[:, None]
            old, self._buffer = self._buffer, self._context.buffer(firsts + CORNERS)
            self._capacity = capacity
            if old is not None:
                old.release()
        return self._buffer.glo


def expand_indices(indices: bytes, index_format: IndexFormat) -> NDArray[np.generic]:
    """Return the triangle indices (n,) of indexed quads. The largest index restarts."""
    values = np.frombuffer(indices, index_format.dtype)
    if values.size and values.max() == index_format.restart:
        return list_primitives(Primitive.QUADS, values, index_format.restart).astype(index_format.dtype)
    whole = values[: values.size // 4 * 4].reshape(-1, 4)
    return np.ascontiguousarray(whole[:, CORNERS]).reshape(-1)
