"""Primitive assembly on the host: each draw becomes a list of points, lines or triangles.

- Lists are used as they are: kernels read consecutive vertices, or the index buffer itself. Strips, fans and
  quads, and lists with restarts, become lists of 32-bit indices. NumPy computes them once and caches them.
  Without indices one list serves all draws of a topology, with the draw's first vertex as its base.
- The range of vertices that a draw references is computed beforehand, so that each vertex is transformed
  once. For that the host keeps a copy of every index buffer (read back once, then updated with what the CPU
  writes) and scans a draw's indices: about a nanosecond each, and a triangle takes some 40 to draw. Results
  are kept until the buffer changes.
- Once a shader may have written a buffer, its contents are unknown. Lists don't need them: their vertices
  are then transformed once per index. For strips, fans and quads the buffer is read back, which waits, and so
  it is for lists once a copy or clear has written it, since that may bring restarts.
- The restart index ends a primitive of any topology (`rhi.contract.topology`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Buffer as BytesLike

from rhi.contract.descriptors import Id, Primitive
from rhi.contract.formats import IndexFormat
from rhi.contract.topology import CORNERS, LISTS, list_primitives

T = TypeVar("T")
_Indices: TypeAlias = "NDArray[Any]"
_ListKey: TypeAlias = tuple[Primitive, IndexFormat, int, int]

_NO_RESTART: Final = -1
_MAX_SCANNED: Final = 1 << 16  # indices of many draws that are scanned at once
_MAX_ASSEMBLIES: Final = 4096
_MAX_LISTED: Final = 1 << 22  # indices, in the lists kept for one buffer
_MIN_PATTERN: Final = 1024


@dataclass(frozen=True, slots=True)
class Assembly(Generic[T]):
    """The primitives of a draw, as a list of vertices.

    Vertex k of the list (0 ≤ k < count) is vertex `start + k`, or with `indexed` the one that index `start +
    k` references. `base` is added to it, and the draw's own base vertex.

    Attributes:
        corners: vertices per primitive: 1, 2 or 3.
        count: vertices in the list, a multiple of `corners`.
        indexed: whether the list is indexed.
        memory: the uint32 index list made here; with `indexed`, None means the draw's own index buffer.
        lowest, highest: the range of referenced vertices, before any base is added; None if the host doesn't
            know it.
    """

    corners: int
    count: int
    start: int
    base: int = 0
    indexed: bool = False
    memory: T | None = None
    lowest: int | None = None
    highest: int | None = None


class _IndexBufferState(Generic[T]):
    """The known contents of one index buffer, and the results computed from them."""

    def __init__(self, size: int) -> None:
        self.size = size
        self.bytes: NDArray[np.uint8] | None = None
        self.device_wrote = False
        self.assemblies: dict[_ListKey, Assembly[T]] = {}
        self.listed = 0  # indices in the lists that were made for `assemblies`

    def write(self, offset: int, source: NDArray[np.uint8]) -> None:
        """Apply a write of the CPU to the copy."""
        self.forget_lists()
        if self.bytes is not None:
            self.bytes[offset : offset + len(source)] = source

    def forget(self, shader_wrote: bool) -> None:
        """Drop contents that the device may have changed."""
        self.forget_lists()
        self.bytes, self.device_wrote = None, shader_wrote

    def forget_lists(self) -> None:
        self.assemblies.clear()
        self.listed = 0


class Assembler(Generic[T]):
    """Assembles the draws of one device. `T` is the type of an index list in device memory."""

    def __init__(
        self, read: Callable[[Id, int, int], bytes], upload: Callable[[NDArray[np.uint32]], T]
    ) -> None:
        """`read` returns bytes of a buffer, given an offset and a size; `upload` copies an index list to the
        device."""
        self._read = read
        self._upload = upload
        self._buffers: dict[Id, _IndexBufferState[T]] = {}
        self._patterns: dict[Primitive, tuple[int, T]] = {}

    def watch(self, buffer: Id, size: int) -> None:
        """Watch a buffer that holds indices. The assembler must be notified of all its changes from now
        on."""
        self._buffers.setdefault(buffer, _IndexBufferState(size))

    def write(self, buffer: Id, offset: int, data: BytesLike) -> None:
        """Note that the CPU writes a buffer, watched or not."""
        contents = self._buffers.get(buffer)
        if contents is not None:
            contents.write(offset, np.frombuffer(memoryview(data), np.uint8))

    def change(self, buffer: Id, shader_wrote: bool = False) -> None:
        """Note that the device may write a buffer, watched or not: by a copy, a clear, or stores of a
        shader."""
        contents = self._buffers.get(buffer)
        if contents is not None:
            contents.forget(shader_wrote)

    def forget(self, buffer: Id) -> None:
        """Note that a buffer, watched or not, is being destroyed."""
        self._buffers.pop(buffer, None)

    def assemble(
        self,
        primitive: Primitive,
        first: int,
        count: int,
        buffer: Id = 0,
        format: IndexFormat = IndexFormat.UINT32,
    ) -> Assembly[T]:
        """Return the primitives of `count` vertices from `first` on, or of indices with `buffer`, which is
        watched.

        Indices beyond the buffer's end are left out.
        """
        if not buffer:
            return self._assemble_vertices(primitive, first, count)
        contents = self._buffers[buffer]
        count = min(count, contents.size // format.size - first)
        corners = CORNERS[primitive]
        if count <= 0:
            return Assembly(corners, 0, 0)
        whole = count - count % corners
        if contents.bytes is None:
            if contents.device_wrote and primitive in LISTS:
                return Assembly(corners, whole, first, indexed=True)
            contents.bytes = np.frombuffer(bytearray(self._read(buffer, 0, contents.size)), np.uint8)
        key = primitive, format, first, count
        assembly = contents.assemblies.get(key)
        if assembly is None:
            if len(contents.assemblies) >= _MAX_ASSEMBLIES or contents.listed >= _MAX_LISTED:
                contents.forget_lists()
            assembly = contents.assemblies[key] = self._assemble_indices(contents, *key)
            contents.listed += 0 if assembly.memory is None else assembly.count
        return assembly

    def compute_index_ranges(
        self, firsts: NDArray[np.int64], counts: NDArray[np.int64], buffer: Id, format: IndexFormat
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
        """Return the lowest and the highest index of each range of a watched index buffer.

        None if the ranges lie too far apart for one scan, or can't be used as they are: one is empty, ends
        beyond the buffer or has a restart, or the device may have written the buffer."""
        contents = self._buffers[buffer]
        begin, end = int(firsts.min()), int((firsts + counts).max())
        if contents.device_wrote or end > contents.size // format.size:
            return None
        if end - begin > _MAX_SCANNED or not counts.all():
            return None
        if contents.bytes is None:
            contents.bytes = np.frombuffer(bytearray(self._read(buffer, 0, contents.size)), np.uint8)
        indices = np.append(_view(contents.bytes, format)[begin:end], format.dtype.type(0))
        bounds = (np.stack([firsts, firsts + counts], axis=1) - begin).reshape(-1)
        lows = np.minimum.reduceat(indices, bounds)[::2].astype(np.int64)
        highs = np.maximum.reduceat(indices, bounds)[::2].astype(np.int64)
        return None if highs.max() == 256**format.size - 1 else (lows, highs)

    def _assemble_vertices(self, primitive: Primitive, first: int, count: int) -> Assembly[T]:
        corners = CORNERS[primitive]
        if primitive in LISTS:
            whole = count - count % corners
            return Assembly(corners, whole, first, 0, False, None, first, first + whole - 1)
        listed = _list_size(primitive, count)
        capacity, memory = self._patterns.get(primitive, (0, None))
        if memory is None or capacity < count:
            capacity = max(_MIN_PATTERN, 1 << (count - 1).bit_length())
            memory = self._upload(list_primitives(primitive, np.arange(capacity), _NO_RESTART))
            self._patterns[primitive] = capacity, memory
        return Assembly(corners, listed, 0, first, True, memory, 0, count - 1)

    def _assemble_indices(
        self,
        contents: _IndexBufferState[T],
        primitive: Primitive,
        format: IndexFormat,
        first: int,
        count: int,
    ) -> Assembly[T]:
        assert contents.bytes is not None
        corners = CORNERS[primitive]
        indices = _view(contents.bytes, format)[first : first + count]
        low, high = int(indices.min()), int(indices.max())
        if primitive in LISTS and high != format.restart:
            return Assembly(corners, count - count % corners, first, 0, True, None, low, high)
        listed = list_primitives(primitive, indices, format.restart)
        if not len(listed):
            return Assembly(corners, 0, 0)
        low, high = int(listed.min()), int(listed.max())
        return Assembly(corners, len(listed), 0, 0, True, self._upload(listed), low, high)


def _list_size(primitive: Primitive, count: int) -> int:
    """Return the length of the list that `count` vertices of a strip, fan or quads become."""
    if primitive is Primitive.QUADS:
        return count // 4 * 6
    corners = CORNERS[primitive]
    return max(0, count - corners + 1) * corners


def _view(data: NDArray[np.uint8], format: IndexFormat) -> _Indices:
    whole = len(data) // format.size * format.size
    view: _Indices = data[:whole].view(format.dtype)
    return view
