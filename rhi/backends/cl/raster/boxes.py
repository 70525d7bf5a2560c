"""Boxes of what vertices' attributes lie between, for draws that come again: an instance out of view isn't transformed.

- What is done with them is told in kernels/vertex.cl. Here is decided which prepared draws have one: those of programs
  whose positions can be bounded, with enough vertices, from their second time on.
- A box holds until a buffer that the vertices come from changes; then all draws of the vertex array begin anew.
- Addresses of boxes stand in the table of prepared draws: odd while a batch is to measure them, then even. Tables that
  were made of prepared draws are out of date when its `version` changes.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.backends.cl.pools import Pool
from rhi.backends.cl.raster.prepared import PreparedDraws
from rhi.contract.descriptors import Id

__rhi_internal__ = True

_BOX_BYTES: Final = 32
_MIN_GROUPS: Final = 4  # of vertices; to look at a box costs as much as one
_TO_MEASURE: Final = 1  # beside an address in a draw
_NONE: Final = np.zeros(0, np.int64)


class Boxes:
    """The boxes of one device's prepared draws."""

    def __init__(self, prepared: PreparedDraws, memory: Pool) -> None:
        self._prepared = prepared
        self._memory = memory
        self._address = 0
        self._readers: dict[Id, set[Id]] = {}  # the vertex arrays that read a buffer
        self._chosen = _NONE
        self._held: set[Id] = set()  # vertex arrays some of whose draws were seen

    def watch(self, vertex_array: Id, buffers: Iterable[Id]) -> None:
        """A vertex array reads these buffers."""
        for buffer in buffers:
            self._readers.setdefault(buffer, set()).add(vertex_array)

    def unwatch(self, vertex_array: Id) -> None:
        """It is destroyed."""
        self._held.discard(vertex_array)
        for readers in self._readers.values():
            readers.discard(vertex_array)

    def forget(self, buffer: Id) -> None:
        """A buffer is destroyed."""
        self.change(buffer)
        self._readers.pop(buffer, None)

    def change(self, buffer: Id) -> None:
        """What a buffer holds changes."""
        readers = self._readers.get(buffer)
        if not readers or self._held.isdisjoint(readers):
            return
        prepared = self._prepared
        for vertex_array in readers & self._held:
            places = np.flatnonzero(prepared.arrays == vertex_array)
            prepared.seen[places] = False
            if prepared.draws["box"][places].any():
                prepared.draws["box"][places] = 0
                prepared.version += 1
        self._held -= readers

    def choose(self, places: NDArray[np.int64], instances: NDArray[np.int64]) -> bool:
        """Note that prepared draws are drawn so many times. Those that were before are told to be measured, and where
        their boxes will lie; gives whether some draws are still to have one.

        Raises:
            pyopencl.Error: out of memory.
        """
        prepared = self._prepared
        draws = prepared.draws
        without = (draws["box"][places] == 0) & (instances > 0) & (draws["primitive_groups"][places] > 0)
        missing = places[without & (draws["vertex_groups"][places] >= _MIN_GROUPS)]
        if not len(missing):
            return False
        self._held.update(np.unique(prepared.arrays[missing]).tolist())
        chosen = missing[prepared.seen[missing]]
        prepared.seen[missing] = True
        if len(chosen):
            address = self._memory.reserve(_BOX_BYTES * len(draws))
            if address != self._address:  # what lay elsewhere is lost
                draws["box"], self._address = 0, address
            draws["box"][chosen] = address + _BOX_BYTES * chosen + _TO_MEASURE
            self._chosen = chosen
            prepared.version += 1
        return True

    @property
    def chosen(self) -> bool:
        """Whether some of the draws at hand are to be measured."""
        return len(self._chosen) > 0

    def keep(self) -> None:
        """Those that were chosen are measured."""
        if self.chosen:
            self._prepared.draws["box"][self._chosen] &= ~np.uint64(_TO_MEASURE)
            self._forget_chosen()

    def drop(self) -> None:
        """Those that were chosen and not kept aren't measured: the batch has failed."""
        if self.chosen:
            self._prepared.draws["box"][self._chosen] = 0
            self._forget_chosen()

    def _forget_chosen(self) -> None:
        self._chosen = _NONE
        self._prepared.version += 1
