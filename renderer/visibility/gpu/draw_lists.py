"""Lists of draws that the device makes itself (Deferred+, 1.3.1, Listing 1.3).

Each object has a mark. `IndirectDrawList.list_draws` gathers the draws of the objects marked VISIBLE and the rows of
those marked HIDDEN. The CPU sees neither: it draws both indirectly.

- The list is made by one pass of a counting sort: by winding, then by the depth of the farthest corner in half
  octaves, near first. Within a half octave rows keep their order. So the same marks give the same list, and objects
  near the eye are drawn first, for the benefit of early depth tests.
- There are no atomics: each group counts its 64 keys and ranks them in shared memory, one group computes the prefix
  sums, and each row is written to its position.
- Each winding has a part of its own, because the front face is a render state, which the device can't choose.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.shaders import MeshPart, ObjectPosition
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility.gpu.occludees import DRAWN, GROUP, HIDDEN, VISIBLE, Occludee, Occludees
from renderer.visibility.repeated import clear
from renderer.visibility.scene_pass import SceneArrays
from rhi import DRAW, Device, Encoder, IndirectDraws
from rhi.shading import (
    Shader,
    Storage,
    StorageRW,
    Struct,
    barrier,
    clamp,
    floor,
    global_id,
    group_count,
    group_id,
    local_index,
    log2,
    max,
    shared,
    uint,
)

__rhi_internal__ = True

_BUCKETS: Final = 31
"""Number of distance classes: up to 1/8 m, then a half octave each up to 4 km, then all beyond."""
_HIDDEN_KEY: Final = 2 * _BUCKETS
_NO_KEY: Final = 63


class DrawArguments(Struct):
    """The arguments of an indexed indirect draw, laid out as `rhi.DRAW`."""

    count: uint
    instances: uint
    first: uint
    base_vertex: int
    base_instance: uint


class ListCounts(Struct):
    """The numbers of draws of objects that aren't mirrored, of draws of mirrored ones, and of hidden rows."""

    plain: uint
    mirrored: uint
    hidden: uint


class CountKeys(Shader):
    """Computes each row's key and its rank among the equal keys of its group, and counts each group's keys."""

    work_group = (GROUP,)
    places: Storage[ObjectPosition]
    occludees: Storage[Occludee]
    marks: StorageRW[uint]
    keys: StorageRW[uint]
    counts: StorageRW[uint]
    in_group = shared(uint, GROUP)

    def compute(self) -> None:
        row = global_id().x
        lane = local_index()
        key = _NO_KEY
        if row < len(self.marks):
            mark = self.marks[row]
            if mark == uint(VISIBLE):
                octaves = log2(max(self.occludees[row].depth, 0.125))
                key = clamp(int(floor(2.0 * octaves)) + 6, 0, _BUCKETS - 1)
                key += _BUCKETS * self.places[row].draw_list
                self.marks[row] = uint(DRAWN)
            elif mark == uint(HIDDEN):
                key = _HIDDEN_KEY
        self.in_group[lane] = uint(key)
        barrier()
        rank = 0
        count = uint(0)
        for other in range(GROUP):
            if self.in_group[other] == uint(lane):
                count += 1
            if other < lane and self.in_group[other] == uint(key):
                rank += 1
        if row < len(self.marks):
            self.keys[row] = uint(key + GROUP * rank)
        self.counts[lane * group_count().x + group_id().x] = count


class WriteDraws(Shader):
    """Writes each visible row's draw and each hidden row to the position that the prefix sums give."""

    work_group = (GROUP,)
    places: Storage[ObjectPosition]
    parts: Storage[MeshPart]
    keys: Storage[uint]
    sums: Storage[uint]
    listed: StorageRW[DrawArguments]
    hidden: StorageRW[uint]
    totals: StorageRW[ListCounts]
    boxes: StorageRW[DrawArguments]

    def compute(self) -> None:
        row = global_id().x
        groups = group_count().x
        mirrored = self.sums[_BUCKETS * groups]
        hidden = self.sums[_HIDDEN_KEY * groups]
        if row == 0:
            count = self.sums[_NO_KEY * groups] - hidden
            self.totals[0] = ListCounts(plain=mirrored, mirrored=hidden - mirrored, hidden=count)
            self.boxes[0].instances = count
        if row < len(self.keys):
            packed = int(self.keys[row])
            key = packed % GROUP
            place = self.sums[key * groups + group_id().x] + uint(packed // GROUP)
            if key < _HIDDEN_KEY:
                at = int(place) if key < _BUCKETS else int(place - mirrored) + len(self.keys)
                part = self.parts[self.places[row].mesh]
                self.listed[at] = DrawArguments(
                    count=part.count,
                    instances=uint(1),
                    first=part.first,
                    base_vertex=part.base_vertex,
                    base_instance=uint(row),
                )
            elif key == _HIDDEN_KEY:
                self.hidden[int(place - hidden)] = uint(row)


class IndirectDrawList:
    """A list of draws that the device makes: a `DeviceList`.

    Attributes:
        draws: (2 n,) of `rhi.DRAW`: from 0 on the objects that aren't mirrored, from n on those that are.
        totals: (1,) of `ListCounts`.
        hidden: (n,) rows of the hidden objects. box_draw: a draw of as many boxes.
        generation: how often the list was renewed.
    """

    def __init__(self, device: Device, occludees: Occludees) -> None:
        count = occludees.count
        self.generation = 0
        self.draws = device.storage(DrawArguments, 2 * count, label="listed draws")
        self.totals = device.storage(ListCounts, 1, label="list counts")
        self.hidden = device.storage(uint, count, label="hidden rows")
        self.box_draw = device.storage(DrawArguments, occludees.cube.draws(instances=0), label="box draw")
        self._device = device
        self._occludees = occludees
        self._keys = device.storage(uint, count, label="keys")
        self._counts = device.storage(uint, GROUP * occludees.groups, label="key counts")
        self._count_keys = device.program(CountKeys)
        self._add_counts = device.program(PrefixSum)
        self._write_draws = device.program(WriteDraws)

    def renew(self) -> None:
        """Begin another list: what was read of the one before is out of date."""
        self.generation += 1

    def list_draws(self, encoder: Encoder, arrays: SceneArrays) -> None:
        """List the draws of the objects marked VISIBLE, which marks them DRAWN, and the rows marked HIDDEN."""
        occludees = self._occludees
        if not self._device.capabilities.indirect_count:
            clear(encoder, self.draws)  # all are drawn then; those that aren't listed have no instance
        encoder.dispatch(
            self._count_keys,
            occludees.groups,
            places=arrays.places,
            occludees=occludees.boxes,
            marks=occludees.marks,
            keys=self._keys,
            counts=self._counts,
        )
        encoder.dispatch(self._add_counts, 1, counts=self._counts)
        encoder.dispatch(
            self._write_draws,
            occludees.groups,
            places=arrays.places,
            parts=arrays.parts,
            keys=self._keys,
            sums=self._counts,
            listed=self.draws,
            hidden=self.hidden,
            totals=self.totals,
            boxes=self.box_draw,
        )

    def arguments(self, *, mirrored: bool) -> IndirectDraws:
        """Return the draws of one winding, for `device.draw_indirect`."""
        count, size = self._occludees.count, DRAW.itemsize
        counted = self._device.capabilities.indirect_count
        return IndirectDraws(
            self.draws,
            count,
            offset=count * size if mirrored else 0,
            count=self.totals if counted else None,
            count_offset=4 if mirrored and counted else 0,
        )

    def read_rows(self) -> NDArray[np.int64]:
        """Return the rows of the listed objects, in the order of their draws. Waits for the device."""
        plain, mirrored = _count_windings(self.totals.read())
        return _find_rows(self.draws.read(0, plain), self.draws.read(self._occludees.count, mirrored))

    def read_rows_async(self) -> Callable[[], NDArray[np.int64]]:
        """Begin to read what `read_rows` returns, and return a function that returns it. That waits for the device."""
        totals, draws, count = self.totals.read_async(), self.draws.read_async(), self._occludees.count

        def wait() -> NDArray[np.int64]:
            plain, mirrored = _count_windings(totals.result())
            rows = draws.result()
            return _find_rows(rows[:plain], rows[count : count + mirrored])

        return wait

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.draws, self.totals, self.hidden, self.box_draw, self._keys, self._counts):
            resource.destroy()


def _count_windings(totals: NDArray[Any]) -> tuple[int, int]:
    """Return the numbers of listed objects that aren't mirrored and that are."""
    return int(totals[0]["plain"]), int(totals[0]["mirrored"])


def _find_rows(*parts: NDArray[Any]) -> NDArray[np.int64]:
    """Return the rows of the objects that parts of a list draw."""
    return np.concatenate([part["base_instance"].astype(np.int64) for part in parts])
