"""STREAM buffers, which the CPU writes without synchronisation: uses of their bytes, and the vertices that
draws read."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Collection, Mapping, Sequence
from operator import itemgetter
from types import CodeType
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Id, Primitive, VertexArrayDescriptor

CommandUse: TypeAlias = tuple[int, CodeType | None, int, int]
"""A call that uses resources, for hazards: its number in the order of the calls, its site (code and
instruction offset) and its op. It is a plain tuple because one is created for each draw."""


_begin_of: Final = itemgetter(0)
_end_of: Final = itemgetter(1)


class StreamMemory:
    """The uses of a buffer that the CPU writes without order. They are sorted into pages, so that a write
    checks only few.

    Attributes:
        written: (begin, end) of the latest write, in bytes.
    """

    __slots__ = ("_pages", "_shift", "_written_ranges", "written")

    def __init__(self, size: int) -> None:
        self._pages: dict[int, list[tuple[int, int, CommandUse]]] = {}
        self._shift = max(8, size.bit_length() - 10)
        self._written_ranges: list[tuple[int, int]] = []  # disjoint, sorted, with gaps between them
        self.written = (0, 0)

    def write(self, begin: int, end: int) -> bool:
        """Note a write by the CPU, of at least one byte.

        Returns:
            Whether it comes round to some of these bytes: they were written before, and others since.
        """
        in_place = begin < self.written[1] and self.written[0] < end
        self.written = (begin, end)
        ranges = self._written_ranges
        first = bisect_left(ranges, begin, key=_end_of)
        last = bisect_right(ranges, end, key=_begin_of)
        touched = ranges[first:last]  # overlapping or adjacent
        overlaps = any(span[0] < end and begin < span[1] for span in touched)
        if touched:
            begin, end = min(begin, touched[0][0]), max(end, touched[-1][1])
        ranges[first:last] = [(begin, end)]
        return overlaps and not in_place

    def use(self, begin: int, end: int, use: CommandUse, completed: int) -> None:
        """Add a use of these bytes. Earlier uses by commands up to number `completed` are done and may be
        dropped."""
        for page in range(begin >> self._shift, (max(end, begin + 1) - 1 >> self._shift) + 1):
            uses = self._pages.setdefault(page, [])
            if uses and uses[-1][0] == begin and uses[-1][1] == end:
                uses[-1] = (begin, end, use)
                continue
            if len(uses) >= 64:
                uses[:] = [earlier_use for earlier_use in uses if earlier_use[2][0] > completed]
            uses.append((begin, end, use))

    def find_use(self, begin: int, end: int, completed: int) -> tuple[int, int, CommandUse] | None:
        """Return the latest use of any of these bytes by a command after number `completed`, None if there is
        none."""
        latest: tuple[int, int, CommandUse] | None = None
        for page in range(begin >> self._shift, (end - 1 >> self._shift) + 1):
            for use in self._pages.get(page, ()):
                meets = use[0] < end and begin < use[1] and use[2][0] > completed
                if meets and (latest is None or use[2][0] > latest[2][0]):
                    latest = use
        return latest


_STRIPS: Final = frozenset({Primitive.LINE_STRIP, Primitive.TRIANGLE_STRIP, Primitive.TRIANGLE_FAN})


def vertex_ranges(
    array: VertexArrayDescriptor,
    primitive: Primitive,
    draws: Sequence[tuple[int, ...]],
    streamed: Collection[Id],
    memory: Mapping[Id, NDArray[np.uint8]],
) -> list[tuple[Id, int, int]]:
    """Return the ranges of vertex memory that draws read.

    Args:
        draws: (count, instances, first, base vertex, base instance) of each draw.
        streamed: the buffers to consider.
        memory: the present contents of the buffers, for indices.

    Returns:
        (buffer, begin, end) in bytes, for each draw and vertex stream.
    """
    ranges = []
    streams = [stream for stream in array.streams if stream.buffer in streamed]
    for count, instances, first, base_vertex, base_instance in draws:
        if not count or not instances:
            continue
        vertices: tuple[int, int] | None = (first, first + count)
        if array.index_buffer and any(not stream.per_instance for stream in streams):
            vertices = _indexed_range(array, primitive, first, count, base_vertex, memory)
        for stream in streams:
            span = (base_instance, base_instance + instances) if stream.per_instance else vertices
            if span is not None:
                begin, end = (stream.offset + index * stream.stride for index in span)
                ranges.append((stream.buffer, begin, end))
    return ranges


def _indexed_range(
    array: VertexArrayDescriptor,
    primitive: Primitive,
    first: int,
    count: int,
    base: int,
    memory: Mapping[Id, NDArray[np.uint8]],
) -> tuple[int, int] | None:
    """Return the first and one past the last vertex that indices refer to, None if they only restart
    strips."""
    form, data = array.index_format, memory.get(array.index_buffer)
    if data is None:  # destroyed, which is reported as another hazard
        return None
    indices = data[first * form.size : (first + count) * form.size].view(form.dtype).astype(np.int64)
    if primitive in _STRIPS:
        indices = indices[indices != 256**form.size - 1]
    if not len(indices):
        return None
    return int(indices.min()) + base, int(indices.max()) + base + 1
