"""Bounding boxes of the vertex attributes of repeated draws. Instances whose box is out of view aren't
transformed.

- kernels/vertex.cl documents how boxes are used. This module decides which prepared draws have one: those of
  programs whose positions can be bounded, with enough vertices, from their second draw on.
- A box is valid until a buffer with its vertices changes. Then all draws of the vertex array start without
  boxes again.
- The address of a box is stored with the prepared draw. It is odd while a batch has to measure the box, and
  then even.
- Tables made from prepared draws are out of date when `PreparedDraws.version` changes.
- docs/backends-cl-rasteriser.md, "Boxes before vertices", has the measured gain.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.memory.pools import Pool
from rhi.backends.cl.raster.draw_tables import PreparedDraws
from rhi.contract.descriptors import Id

_BOX_BYTES: Final = 32
_MIN_GROUPS: Final = 4  # of vertices; testing a box costs as much as transforming one
_TO_MEASURE: Final = 1  # flag in the address of a box
_NONE: Final = np.zeros(0, np.int64)


class AttributeBoxes:
    """The boxes of the prepared draws of one device."""

    def __init__(self, prepared: PreparedDraws, memory: Pool) -> None:
        self._prepared = prepared
        self._memory = memory
        self._address = 0
        self._readers: dict[Id, set[Id]] = {}  # the vertex arrays that read each buffer
        self._unmeasured = _NONE
        self._watched_arrays: set[Id] = set()  # vertex arrays with draws that were seen

    def watch(self, vertex_array: Id, buffers: Iterable[Id]) -> None:
        """Note that a vertex array reads these buffers."""
        for buffer in buffers:
            self._readers.setdefault(buffer, set()).add(vertex_array)

    def unwatch(self, vertex_array: Id) -> None:
        """Note that a vertex array is being destroyed."""
        self._watched_arrays.discard(vertex_array)
        for readers in self._readers.values():
            readers.discard(vertex_array)

    def forget(self, buffer: Id) -> None:
        """Note that a buffer is being destroyed."""
        self.change(buffer)
        self._readers.pop(buffer, None)

    def change(self, buffer: Id) -> None:
        """Drop the boxes that depend on a buffer, since its contents change."""
        readers = self._readers.get(buffer)
        if not readers or self._watched_arrays.isdisjoint(readers):
            return
        prepared = self._prepared
        for vertex_array in readers & self._watched_arrays:
            indices = np.flatnonzero(prepared.arrays == vertex_array)
            prepared.was_drawn[indices] = False
            if prepared.draws["box"][indices].any():
                prepared.draws["box"][indices] = 0
                prepared.version += 1
        self._watched_arrays -= readers

    def assign_boxes(self, prepared_indices: NDArray[np.int64], instances: NDArray[np.int64]) -> bool:
        """Note that prepared draws are drawn. Draws that were drawn before get boxes, which the batch
        measures.

        Args:
            prepared_indices: (n,) indices of the prepared draws.
            instances: (n,) their numbers of instances.

        Returns:
            Whether some of the draws should have a box that isn't measured yet.

        Raises:
            pyopencl.Error: out of memory.
        """
        prepared = self._prepared
        draws = prepared.draws
        without = (
            (draws["box"][prepared_indices] == 0)
            & (instances > 0)
            & (draws["primitive_groups"][prepared_indices] > 0)
        )
        missing = prepared_indices[without & (draws["vertex_groups"][prepared_indices] >= _MIN_GROUPS)]
        if not len(missing):
            return False
        self._watched_arrays.update(np.unique(prepared.arrays[missing]).tolist())
        unmeasured = missing[prepared.was_drawn[missing]]
        prepared.was_drawn[missing] = True
        if len(unmeasured):
            address = self._memory.reserve(_BOX_BYTES * len(draws))
            if address != self._address:  # the boxes at the old address are lost
                draws["box"], self._address = 0, address
            draws["box"][unmeasured] = address + _BOX_BYTES * unmeasured + _TO_MEASURE
            self._unmeasured = unmeasured
            prepared.version += 1
        return True

    @property
    def has_unmeasured(self) -> bool:
        """True if the batch has to measure boxes."""
        return len(self._unmeasured) > 0

    def mark_measured(self) -> None:
        """Note that the batch has measured the boxes."""
        if self.has_unmeasured:
            self._prepared.draws["box"][self._unmeasured] &= ~np.uint64(_TO_MEASURE)
            self._clear_unmeasured()

    def drop(self) -> None:
        """Drop the boxes that the batch was to measure, since it has failed."""
        if self.has_unmeasured:
            self._prepared.draws["box"][self._unmeasured] = 0
            self._clear_unmeasured()

    def _clear_unmeasured(self) -> None:
        self._unmeasured = _NONE
        self._prepared.version += 1
