"""Lists of draws that the device makes itself (Deferred+, 1.3.1, Listing 1.3).

Each object has a mark. `IndirectDrawList.list_draws` gathers the draws of the objects marked VISIBLE and the
rows of those marked HIDDEN. The CPU sees neither: it draws both indirectly.

- The list is made by one pass of a counting sort: by part, then by the depth of the farthest corner in half
  octaves, near first. Within a half octave rows keep their order. So the same marks give the same list, and
  objects near the eye are drawn first, for the benefit of early depth tests.
- There are no atomics: each group counts and ranks the keys of its 64 rows in shared memory, one group
  computes the prefix sums, and each row is written to its position.
- Consecutive rows of one mesh, part and distance class are instances of one draw, up to the 64 rows of a group.
  Their indices follow the draw's base instance, so shaders notice nothing, and objects are drawn in the same
  order as one by one.
- Objects that are drawn with another program or other states (their winding, the faces to cull) are in a part
  of their own, because the device can't choose these: `DRAW_LISTS` parts for each shader that materials have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene import Scene
from renderer.scene.arrays import list_ranges
from renderer.shaders import DRAW_LISTS, MeshPart, ObjectPosition
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility.command_cache import clear
from renderer.visibility.gpu.occludees import DRAWN, GROUP, HIDDEN, VISIBLE, Occludee, Occludees
from renderer.visibility.scene_drawer import SceneArrays
from rhi import DRAW, Device, Encoder, IndirectDraws, Program, Readback
from rhi.errors.shared_caches import cache_once

_BUCKETS: Final = 31
"""The number of distance classes with `DRAW_LISTS` parts: up to 1/8 m, then a half octave each up to 4 km,
then all beyond. More parts have fewer and wider ones."""
_NO_KEY: Final = 2 * GROUP - 1
_INSTANCE: Final = 2 * GROUP  # instead of a key: the row is an instance of the draw of a row before
KEYS: Final = 2 * GROUP
"""Number of keys. Each of a group's lanes counts two of them."""
MAX_PARTS: Final = (KEYS - 2) // 2
"""The most parts of a list: each has two distance classes then."""


@cache_once
def with_parts(shader: type[sl.Shader], parts: int, *, has_instances: bool = True) -> type[sl.Shader]:
    """Return a shader of lists that have so many parts, and draws with several instances or with one each."""
    constants: dict[str, object] = {} if has_instances else {"has_instances": 0}
    if parts > DRAW_LISTS:
        constants |= {"parts": parts, "buckets": (KEYS - 2) // parts}
    if not constants:
        return shader
    name = f"{shader.__name__}{parts}{'' if has_instances else 'Single'}"
    return type(name, (shader,), {"__module__": __name__, **constants})


class DrawArguments(sl.Struct):
    """The arguments of an indexed indirect draw, laid out as `rhi.DRAW`."""

    count: sl.uint
    instances: sl.uint
    first: sl.uint
    base_vertex: int
    base_instance: sl.uint


class CountKeys(sl.Shader):
    """Computes each draw's key, its number of instances and its rank among the equal keys of its group, and counts
    each group's keys. A row that is an instance of the draw of a row before has no key."""

    work_group = (GROUP,)
    parts = DRAW_LISTS
    buckets = _BUCKETS
    has_instances = 1
    object_positions: sl.Storage[ObjectPosition]
    occludees: sl.Storage[Occludee]
    marks: sl.StorageRW[sl.uint]
    keys: sl.StorageRW[sl.uint]
    counts: sl.StorageRW[sl.uint]
    in_group = sl.shared(sl.uint, GROUP)
    meshes = sl.shared(sl.uint, GROUP)
    heads = sl.shared(sl.uint, GROUP)

    def compute(self) -> None:
        object_index = sl.global_id().x
        lane = sl.local_index()
        key = _NO_KEY
        mesh = 0
        if object_index < len(self.marks):
            mark = self.marks[object_index]
            if mark == sl.uint(VISIBLE):
                octaves = sl.log2(sl.max(self.occludees[object_index].depth, 0.125))
                key = sl.clamp(
                    int(sl.floor((octaves + 3.0) * (2.0 * self.buckets / _BUCKETS))), 0, self.buckets - 1
                )
                key += self.buckets * self.object_positions[object_index].draw_list
                mesh = self.object_positions[object_index].mesh
                self.marks[object_index] = sl.uint(DRAWN)
            elif mark == sl.uint(HIDDEN):
                key = self.parts * self.buckets
        self.in_group[lane] = sl.uint(key)
        self.meshes[lane] = sl.uint(mesh)
        sl.barrier()
        before = sl.max(lane - 1, 0)
        is_instance = (
            lane > 0
            and self.has_instances == 1
            and key < self.parts * self.buckets
            and self.in_group[before] == sl.uint(key)
            and self.meshes[before] == sl.uint(mesh)
        )
        self.heads[lane] = sl.uint(_INSTANCE if is_instance else key)
        sl.barrier()
        rank = 0
        instances = 1
        is_open = True
        count = sl.uint(0)
        count_beyond = sl.uint(0)
        for other in range(GROUP):
            other_key = self.heads[other]
            if other > lane:
                is_open = is_open and other_key == sl.uint(_INSTANCE)
                if is_open:
                    instances += 1
            if other_key == sl.uint(lane):
                count += 1
            if other_key == sl.uint(lane + GROUP):
                count_beyond += 1
            if other < lane and other_key == sl.uint(key):
                rank += 1
        if object_index < len(self.marks):
            packed = key + KEYS * (rank + GROUP * (instances - 1))
            self.keys[object_index] = sl.uint(_NO_KEY if is_instance else packed)
        self.counts[lane * sl.group_count().x + sl.group_id().x] = count
        self.counts[(lane + GROUP) * sl.group_count().x + sl.group_id().x] = count_beyond


class WriteDraws(sl.Shader):
    """Writes each draw and each hidden row to the position that the prefix sums give."""

    work_group = (GROUP,)
    parts = DRAW_LISTS
    buckets = _BUCKETS
    object_positions: sl.Storage[ObjectPosition]
    mesh_parts: sl.Storage[MeshPart]
    keys: sl.Storage[sl.uint]
    sums: sl.Storage[sl.uint]
    listed: sl.StorageRW[DrawArguments]
    hidden: sl.StorageRW[sl.uint]
    totals: sl.StorageRW[sl.uint]
    boxes: sl.StorageRW[DrawArguments]

    def compute(self) -> None:
        object_index = sl.global_id().x
        groups = sl.group_count().x
        hidden_key = self.parts * self.buckets
        hidden = self.sums[hidden_key * groups]
        if object_index == 0:
            for number in range(self.parts):
                begin = self.sums[number * self.buckets * groups]
                self.totals[number] = self.sums[(number + 1) * self.buckets * groups] - begin
            count = self.sums[_NO_KEY * groups] - hidden
            self.totals[self.parts] = count
            self.boxes[0].instances = count
        if object_index < len(self.keys):
            packed = int(self.keys[object_index])
            key = packed % KEYS
            sorted_index = self.sums[key * groups + sl.group_id().x] + sl.uint(packed // KEYS % GROUP)
            if key < hidden_key:
                number = key // self.buckets
                at = int(sorted_index - self.sums[number * self.buckets * groups]) + number * len(self.keys)
                part = self.mesh_parts[self.object_positions[object_index].mesh]
                self.listed[at] = DrawArguments(
                    count=part.count,
                    instances=sl.uint(1 + packed // (KEYS * GROUP)),
                    first=part.first,
                    base_vertex=part.base_vertex,
                    base_instance=sl.uint(object_index),
                )
            elif key == hidden_key:
                self.hidden[int(sorted_index - hidden)] = sl.uint(object_index)


def count_parts(scene: Scene) -> int:
    """Return the parts of a scene's lists: `DRAW_LISTS` for each of its shaders and for that of all
    others."""
    return DRAW_LISTS * (1 + len(scene.shaders))


class IndirectDrawList:
    """A list of draws that the device makes: a `DeviceDrawList`.

    Attributes:
        parts: the number of parts, at most `MAX_PARTS`.
        draws: (parts n,) of `rhi.DRAW`: part i, the objects whose `ObjectPosition.draw_list` is i, from n i
            on.
        totals: (parts + 1,) the numbers of draws of each part, and of hidden objects.
        hidden: (n,) rows of the hidden objects.
        box_draw: a draw of as many boxes.
        generation: how often the list was renewed.
    """

    def __init__(
        self,
        device: Device,
        occludees: Occludees,
        parts: int = DRAW_LISTS,
        *,
        has_instances: bool = True,
    ) -> None:
        """Create an empty list. Without `has_instances` each object is a draw of its own."""
        count = occludees.count
        self.parts = parts
        self.generation = 0
        self.draws = device.storage(DrawArguments, parts * count, label="listed draws")
        self.totals = device.storage(sl.uint, parts + 1, label="list counts")
        self.hidden = device.storage(sl.uint, count, label="hidden rows")
        self.box_draw = device.storage(DrawArguments, occludees.cube.draws(instances=0), label="box draw")
        self._device = device
        self._occludees = occludees
        self._keys = device.storage(sl.uint, count, label="keys")
        self._counts = device.storage(sl.uint, KEYS * occludees.groups, label="key counts")
        count_keys = with_parts(CountKeys, parts, has_instances=has_instances)
        self._count_keys: Program[...] = device.program(count_keys)
        self._add_counts = device.program(PrefixSum)
        self._write_draws: Program[...] = device.program(with_parts(WriteDraws, parts))

    def renew(self) -> None:
        """Begin another list: what was read of the one before is out of date."""
        self.generation += 1

    def list_draws(self, encoder: Encoder, arrays: SceneArrays) -> None:
        """List the draws of the objects marked VISIBLE, which marks them DRAWN, and the rows marked
        HIDDEN."""
        occludees = self._occludees
        if not self._device.capabilities.indirect_count:
            clear(encoder, self.draws)  # all are drawn then; those that aren't listed have no instance
        encoder.dispatch(
            self._count_keys,
            occludees.groups,
            object_positions=arrays.object_positions,
            occludees=occludees.boxes,
            marks=occludees.marks,
            keys=self._keys,
            counts=self._counts,
        )
        encoder.dispatch(self._add_counts, 1, counts=self._counts)
        encoder.dispatch(
            self._write_draws,
            occludees.groups,
            object_positions=arrays.object_positions,
            mesh_parts=arrays.mesh_parts,
            keys=self._keys,
            sums=self._counts,
            listed=self.draws,
            hidden=self.hidden,
            totals=self.totals,
            boxes=self.box_draw,
        )

    def arguments(self, part: int) -> IndirectDraws:
        """Return the draws of one part, for `device.draw_indirect`."""
        count = self._occludees.count
        counted = self._device.capabilities.indirect_count
        return IndirectDraws(
            self.draws,
            count,
            offset=part * count * DRAW.itemsize,
            count=self.totals if counted else None,
            count_offset=4 * part if counted else 0,
        )

    def read_object_indices(self) -> NDArray[np.int64]:
        """Return the indices of the listed objects, in the order of their draws. Waits for the device."""
        count = self._occludees.count
        sizes = self.totals.read().tolist()[:-1]
        return _object_indices(
            [self.draws.read(count * part, size) for part, size in enumerate(sizes) if size]
        )

    def read_object_indices_async(self) -> Callable[[], NDArray[np.int64]]:
        """Begin to read what `read_object_indices` returns, and return a function that waits for the device
        and returns it."""
        totals = self.totals.read_async()
        draws = self.draws.read_async()
        count = self._occludees.count

        def wait() -> NDArray[np.int64]:
            rows, sizes = draws.result(), totals.result().tolist()[:-1]
            return _object_indices(
                [rows[count * part : count * part + size] for part, size in enumerate(sizes)]
            )

        return wait

    def read_marks(self, first_object: int, count: int) -> Readback:
        """Begin to read the marks (`count`,) of the objects from row `first_object` on."""
        return self._occludees.marks.read_async(first_object, count)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (self.draws, self.totals, self.hidden, self.box_draw, self._keys, self._counts):
            resource.destroy()


def _object_indices(parts: list[NDArray[Any]]) -> NDArray[np.int64]:
    """Return the indices of the objects that parts of a list draw."""
    draws = np.concatenate([np.zeros(0, DrawArguments.dtype), *parts])
    return list_ranges(draws["base_instance"], draws["instances"])
