"""Lists of draws that the device makes itself (Deferred+, 1.3.1, Listings 1.3 and 1.4).

Each object has a mark. `IndirectDrawList.list_draws` gathers the objects marked VISIBLE and the indices of those
marked HIDDEN. The CPU sees neither: it draws both indirectly.

- The objects of one mesh that are drawn by one program with the same states are an instance set, and all visible
  ones are one draw with that many instances. The sets are ranges of `SceneArrays.list_entries`.
- A prefix sum over the marks, in the order of the entries, is where each visible object goes. Its element of
  `objects` and of `object_positions` is copied to there, so a draw's instances are neighbours, and the shaders that
  draw them are those of any other pass. What needs an object's index reads `ObjectPosition.object_index`.
- The draws are made by one pass of a counting sort: by part, then by the depth of the farthest corner of the first
  object in half octaves, near first. Within a half octave sets keep their order. So the same marks give the same
  list, and what is near the eye is mostly drawn first, for the benefit of early depth tests.
- There are no atomics: each group counts and ranks the keys of its 64 sets in shared memory, one group computes the
  prefix sums, and each draw is written to its position.
- An object whose mesh has levels of detail has an entry for the mesh and one for each level, in sets of their own. It
  goes to the one that `LevelChoice` has chosen: so there is one draw for each level that any object is drawn as.
- An object whose mesh is cut into meshlets has an entry for each of them in place of that for the mesh. Those that
  `MeshletCulling` has found visible are listed, and the objects of one meshlet are one draw.
- Objects that are drawn with another program or other states (their winding, the faces to cull) are in a part of
  their own, because the device can't choose these: `DRAW_LISTS` parts for each shader that materials have.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene import Scene
from renderer.scene.arrays import list_ranges
from renderer.shaders import DRAW_LISTS, ListEntry, MeshPart, Object, ObjectPosition
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility.command_cache import clear
from renderer.visibility.gpu.meshlet_culling import MeshletCulling
from renderer.visibility.gpu.occludees import DRAWN, GROUP, HIDDEN, VISIBLE, Occludee, Occludees
from renderer.visibility.scene_drawer import SceneArrays
from rhi import DRAW, Device, Encoder, IndirectDraws, Program, Readback, StorageBuffer
from rhi.errors.shared_caches import cache_once
from rhi.math.indexing import repeat_each

_BUCKETS: Final = 31
"""The number of distance classes with `DRAW_LISTS` parts: up to 1/8 m, then a half octave each up to 4 km,
then all beyond. More parts have fewer and wider ones."""
_NO_KEY: Final = 2 * GROUP - 1
KEYS: Final = 2 * GROUP
"""Number of keys. Each of a group's lanes counts two of them."""
MAX_PARTS: Final = (KEYS - 2) // 2
"""The most parts of a list: each has two distance classes then."""


@cache_once
def with_parts(shader: type[sl.Shader], parts: int) -> type[sl.Shader]:
    """Return a shader of lists that have so many parts."""
    if parts <= DRAW_LISTS:
        return shader
    constants = {"parts": parts, "buckets": (KEYS - 2) // parts}
    return type(f"{shader.__name__}{parts}", (shader,), {"__module__": __name__, **constants})


class DrawArguments(sl.Struct):
    """The arguments of an indexed indirect draw, laid out as `rhi.DRAW`."""

    count: sl.uint
    instances: sl.uint
    first: sl.uint
    base_vertex: int
    base_instance: sl.uint


class CountMarks(sl.Shader):
    """Counts 1 for each entry whose object is marked VISIBLE, and behind those 1 for each object marked HIDDEN."""

    work_group = (GROUP,)
    entries: sl.Storage[ListEntry]
    marks: sl.Storage[sl.uint]
    counts: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index < len(self.entries):
            entry = self.entries[index]
            is_visible = self.marks[entry.object] == sl.uint(VISIBLE) and self.is_drawn(entry)
            self.counts[index] = sl.uint(1) if is_visible else sl.uint(0)
            if index == 0:
                self.counts[len(self.entries) + len(self.marks)] = sl.uint(0)
        if index < len(self.marks):
            is_hidden = self.marks[index] == sl.uint(HIDDEN)
            self.counts[len(self.entries) + index] = sl.uint(1) if is_hidden else sl.uint(0)

    def is_drawn(self, entry: ListEntry) -> bool:
        return True


class CountLevels(CountMarks):
    """Counts as `CountMarks` those entries that have the mesh part that their object is drawn as."""

    drawn_parts: sl.Storage[int]

    def is_drawn(self, entry: ListEntry) -> bool:
        return self.drawn_parts[entry.object] == entry.mesh_part


class WriteObjects(sl.Shader):
    """Writes each visible object and the index of each hidden one to the position that the prefix sums give, and
    marks the visible ones DRAWN."""

    work_group = (GROUP,)
    entries: sl.Storage[ListEntry]
    objects: sl.Storage[Object]
    object_positions: sl.Storage[ObjectPosition]
    sums: sl.Storage[sl.uint]
    marks: sl.StorageRW[sl.uint]
    listed_objects: sl.StorageRW[Object]
    listed_positions: sl.StorageRW[ObjectPosition]
    hidden: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        if index < len(self.entries):
            at = self.sums[index]
            if self.sums[index + 1] > at:
                object_index = self.entries[index].object
                self.listed_objects[at] = self.objects[object_index]
                self.listed_positions[at] = self.object_positions[object_index]
                self.marks[object_index] = sl.uint(DRAWN)
        if index < len(self.marks):
            behind = len(self.entries) + index
            begin = self.sums[len(self.entries)]
            if self.sums[behind + 1] > self.sums[behind]:
                self.hidden[self.sums[behind] - begin] = sl.uint(index)


class CountKeys(sl.Shader):
    """Computes the key of each instance set that has a visible object, and its rank among the equal keys of its
    group, and counts each group's keys; and writes the number of hidden objects as that of the boxes that are
    drawn."""

    work_group = (GROUP,)
    parts = DRAW_LISTS
    buckets = _BUCKETS
    set_begins: sl.Storage[sl.uint]
    sums: sl.Storage[sl.uint]
    listed_positions: sl.Storage[ObjectPosition]
    occludees: sl.Storage[Occludee]
    keys: sl.StorageRW[sl.uint]
    counts: sl.StorageRW[sl.uint]
    boxes: sl.StorageRW[DrawArguments]
    in_group = sl.shared(sl.uint, GROUP)

    def compute(self) -> None:
        index = sl.global_id().x
        lane = sl.local_index()
        key = _NO_KEY
        if index < len(self.set_begins) - 1:
            first = self.sums[self.set_begins[index]]
            if self.sums[self.set_begins[index + 1]] > first:
                position = self.listed_positions[first]
                depth = self.occludees[position.object_index].depth
                octaves = sl.log2(sl.max(depth, 0.125))
                key = sl.clamp(
                    int(sl.floor((octaves + 3.0) * (2.0 * self.buckets / _BUCKETS))), 0, self.buckets - 1
                )
                key += self.buckets * position.draw_list
        if index == 0:
            last = len(self.sums) - 1
            self.boxes[0].instances = self.sums[last] - self.sums[last - len(self.occludees)]
        self.in_group[lane] = sl.uint(key)
        sl.barrier()
        rank = 0
        count = sl.uint(0)
        count_beyond = sl.uint(0)
        for other in range(GROUP):
            other_key = self.in_group[other]
            if other_key == sl.uint(lane):
                count += 1
            if other_key == sl.uint(lane + GROUP):
                count_beyond += 1
            if other < lane and other_key == sl.uint(key):
                rank += 1
        if index < len(self.set_begins) - 1:
            self.keys[index] = sl.uint(key + KEYS * rank)
        self.counts[lane * sl.group_count().x + sl.group_id().x] = count
        self.counts[(lane + GROUP) * sl.group_count().x + sl.group_id().x] = count_beyond


class WriteDraws(sl.Shader):
    """Writes the draw of each instance set to the position that the prefix sums of keys give, and what there is of
    each part."""

    work_group = (GROUP,)
    parts = DRAW_LISTS
    buckets = _BUCKETS
    mesh_parts: sl.Storage[MeshPart]
    entries: sl.Storage[ListEntry]
    set_begins: sl.Storage[sl.uint]
    sums: sl.Storage[sl.uint]
    keys: sl.Storage[sl.uint]
    key_sums: sl.Storage[sl.uint]
    listed: sl.StorageRW[DrawArguments]
    totals: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        index = sl.global_id().x
        groups = sl.group_count().x
        if index == 0:
            for number in range(self.parts):
                begin = self.key_sums[number * self.buckets * groups]
                self.totals[number] = self.key_sums[(number + 1) * self.buckets * groups] - begin
            self.totals[self.parts] = self.sums[len(self.sums) - 1] - self.sums[len(self.entries)]
        if index < len(self.set_begins) - 1:
            packed = int(self.keys[index])
            key = packed % KEYS
            if key < self.parts * self.buckets:
                number = key // self.buckets
                sorted_index = self.key_sums[key * groups + sl.group_id().x] + sl.uint(packed // KEYS)
                room = len(self.listed) // self.parts
                at = int(sorted_index - self.key_sums[number * self.buckets * groups]) + number * room
                begin = self.set_begins[index]
                first = self.sums[begin]
                part = self.mesh_parts[self.entries[begin].mesh_part]
                self.listed[at] = DrawArguments(
                    count=part.count,
                    instances=self.sums[self.set_begins[index + 1]] - first,
                    first=part.first,
                    base_vertex=part.base_vertex,
                    base_instance=first,
                )


def count_parts(scene: Scene) -> int:
    """Return the parts of a scene's lists: `DRAW_LISTS` for each of its shaders and for that of all
    others."""
    return DRAW_LISTS * (1 + len(scene.shaders))


class IndirectDrawList:
    """A list of draws that the device makes: a `DeviceDrawList`.

    Attributes:
        parts: the number of parts, at most `MAX_PARTS`.
        draws: (parts n,) of `rhi.DRAW`: part i, the objects whose `ObjectPosition.draw_list` is i, from n i
            on. n is the number of objects, or with meshlets that of entries.
        totals: (parts + 1,) the numbers of draws of each part, and of hidden objects.
        objects, object_positions: (n,) copies of the elements of the visible objects, in the order of the
            instances.
        hidden: (n,) indices of the hidden objects.
        box_draw: a draw of as many boxes, or of what is tested in their place.
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
        self.totals = device.storage(sl.uint, parts + 1, label="list counts")
        self.hidden = device.storage(sl.uint, count, label="hidden objects")
        self.box_draw = device.storage(DrawArguments, occludees.mesh.draws(instances=0), label="box draw")
        self._device = device
        self._occludees = occludees
        self._has_instances = has_instances
        self._set_count = count  # of the last list
        self._make_room(count)
        self._make_counts(count)
        self._count_marks = device.program(CountMarks)
        self._add_counts = device.program(PrefixSum)
        self._write_objects = device.program(WriteObjects)
        self._count_keys: Program[...] = device.program(with_parts(CountKeys, parts))
        self._write_draws: Program[...] = device.program(with_parts(WriteDraws, parts))

    def _make_room(self, room: int) -> None:
        """Create what is listed of so many entries: of each object one, or all of its meshlets."""
        device, self._room = self._device, room
        self.draws = device.storage(DrawArguments, self.parts * room, label="listed draws")
        self.objects = device.storage(Object, room, label="listed objects")
        self.object_positions = device.storage(ObjectPosition, room, label="listed positions")

    def _make_counts(self, entries: int) -> None:
        """Create what is counted and ranked of so many entries."""
        device = self._device
        self._entries = entries
        self._singles: StorageBuffer[sl.uint] | None = None  # the beginnings of sets of one object
        if not self._has_instances:
            begins = np.arange(entries + 1, dtype=np.uint32)
            self._singles = device.storage(sl.uint, begins, label="single objects")
        self._counts = device.storage(sl.uint, entries + self._occludees.count + 1, label="mark counts")
        self._keys = device.storage(sl.uint, entries, label="keys")
        self._key_counts = device.storage(sl.uint, KEYS * -(-entries // GROUP), label="key counts")

    def _destroy_counts(self) -> None:
        for resource in (self._counts, self._keys, self._key_counts, self._singles):
            if resource is not None:
                resource.destroy()

    def renew(self) -> None:
        """Begin another list: what was read of the one before is out of date."""
        self.generation += 1

    def list_draws(
        self,
        encoder: Encoder,
        arrays: SceneArrays,
        drawn_parts: StorageBuffer[int] | None = None,
        meshlets: MeshletCulling | None = None,
    ) -> None:
        """List the draws of the objects marked VISIBLE, which marks them DRAWN, and the indices of those marked
        HIDDEN. Objects are drawn as `drawn_parts` (n,), or as their meshes without; with `meshlets`, those are
        listed that are visible."""
        occludees = self._occludees
        room = occludees.count if meshlets is None else arrays.list_entries.count
        if room != self._room:
            for listed in (self.draws, self.objects, self.object_positions):
                listed.destroy()
            self._make_room(room)
        if arrays.list_entries.count != self._entries:  # levels of detail, or other meshes with others
            self._destroy_counts()
            self._make_counts(arrays.list_entries.count)
        groups = -(-self._entries // GROUP)
        count_marks: Program[...] = self._count_marks
        levels = {}
        if drawn_parts is not None:
            count_marks, levels = self._device.program(CountLevels), {"drawn_parts": drawn_parts}
        set_begins = arrays.set_begins if self._singles is None else self._singles
        self._set_count = set_begins.count - 1
        set_groups = -(-self._set_count // GROUP)
        if not self._device.capabilities.indirect_count:
            clear(encoder, self.draws)  # all are drawn then; those that aren't listed have no instance
        if meshlets is not None:
            meshlets.count(encoder, occludees, self._counts)
        else:
            encoder.dispatch(
                count_marks,
                groups,
                entries=arrays.list_entries,
                marks=occludees.marks,
                counts=self._counts,
                **levels,
            )
        encoder.dispatch(self._add_counts, 1, counts=self._counts)
        encoder.dispatch(
            self._write_objects,
            groups,
            entries=arrays.list_entries,
            objects=arrays.objects,
            object_positions=arrays.object_positions,
            sums=self._counts,
            marks=occludees.marks,
            listed_objects=self.objects,
            listed_positions=self.object_positions,
            hidden=self.hidden,
        )
        encoder.dispatch(
            self._count_keys,
            set_groups,
            set_begins=set_begins,
            sums=self._counts,
            listed_positions=self.object_positions,
            occludees=occludees.boxes,
            keys=self._keys,
            counts=self._key_counts,
            boxes=self.box_draw,
        )
        encoder.dispatch(self._add_counts, 1, counts=self._key_counts)
        encoder.dispatch(
            self._write_draws,
            set_groups,
            mesh_parts=arrays.mesh_parts,
            entries=arrays.list_entries,
            set_begins=set_begins,
            sums=self._counts,
            keys=self._keys,
            key_sums=self._key_counts,
            listed=self.draws,
            totals=self.totals,
        )

    def arguments(self, part: int) -> IndirectDraws:
        """Return the draws of one part, for `device.draw_indirect`."""
        counted = self._device.capabilities.indirect_count
        return IndirectDraws(
            self.draws,
            min(self._set_count, self._room),
            offset=part * self._room * DRAW.itemsize,
            count=self.totals if counted else None,
            count_offset=4 * part if counted else 0,
        )

    def read_object_indices(self) -> NDArray[np.int64]:
        """Return the indices of the listed objects, in the order of their draws: that of an object once for each
        listed meshlet. Waits for the device."""
        return self.read_object_indices_async()()

    def read_object_indices_async(self) -> Callable[[], NDArray[np.int64]]:
        """Begin to read what `read_object_indices` returns, and return a function that waits for the device
        and returns it."""
        totals, draws = self.totals.read_async(), self.draws.read_async()
        positions = self.object_positions.read_async()
        count = self._room

        def wait() -> NDArray[np.int64]:
            rows, sizes = draws.result(), totals.result().tolist()[:-1]
            parts = [rows[count * part : count * part + size] for part, size in enumerate(sizes)]
            listed = np.concatenate([np.zeros(0, DrawArguments.dtype), *parts])
            instances = list_ranges(listed["base_instance"], listed["instances"])
            object_indices: NDArray[np.int64] = positions.result()["object_index"][instances].astype(np.int64)
            return object_indices

        return wait

    def read_marks(self, first_object: int, count: int) -> Readback:
        """Begin to read the marks (`count`,) of the objects from `first_object` on."""
        return self._occludees.marks.read_async(first_object, count)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for resource in (
            self.draws,
            self.totals,
            self.objects,
            self.object_positions,
            self.hidden,
            self.box_draw,
        ):
            resource.destroy()
        self._destroy_counts()


def make_instance_sets(
    meshes: NDArray[np.int32],
    groups: NDArray[np.int32],
    level_begins: NDArray[np.int64] | None = None,
    meshlet_begins: NDArray[np.int64] | None = None,
    first_meshlet: int = 0,
) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """Return the entries of a scene's lists, as `ListEntry`, and where in them each instance set begins and the last
    one ends, (sets + 1,). There is an entry for each object, and one for each level of detail of its mesh; of a mesh
    that is cut, there is one for each meshlet in place of that for the object.

    Args:
        meshes: the mesh (n,) of each object.
        groups: the number (n,) of the program and states that draw each object.
        level_begins: where the levels of each mesh begin among all (`Meshes.level_begins`); None without levels.
        meshlet_begins: where its meshlets begin, likewise; None if meshes are drawn whole.
        first_meshlet: the mesh part of the first of all meshlets.
    """
    objects, parts = np.arange(len(meshes)), meshes.astype(np.int64)
    if level_begins is not None and level_begins[-1]:
        objects, parts = _expand(meshes, parts, level_begins, len(level_begins) - 1)
    if meshlet_begins is not None:
        cut, meshlets = _expand(meshes, np.full(len(meshes), -1), meshlet_begins, first_meshlet)
        is_whole = (np.diff(meshlet_begins)[meshes[objects]] == 0) | (parts != meshes[objects])
        objects = np.concatenate([objects[is_whole], cut[meshlets >= 0]])
        parts = np.concatenate([parts[is_whole], meshlets[meshlets >= 0]])
    order = np.lexsort((parts, meshes[objects], groups[objects]))
    objects, parts = objects[order], parts[order]
    entries = np.zeros(len(order), ListEntry.dtype)
    entries["object"], entries["mesh_part"] = objects, parts
    is_first = np.diff(parts, prepend=-1) | np.diff(groups[objects], prepend=-1)
    return entries, np.append(np.flatnonzero(is_first), len(order)).astype(np.uint32)


def _expand(
    meshes: NDArray[np.int32], parts: NDArray[np.int64], begins: NDArray[np.int64], first_part: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the objects and mesh parts of entries: that of each object, and those from `begins` of its mesh to the
    next, the first of all being `first_part`."""
    counts = 1 + np.diff(begins)[meshes]
    objects = repeat_each(np.arange(len(meshes)), counts)
    number = np.arange(len(objects)) - repeat_each(np.cumsum(counts) - counts, counts)
    return objects, np.where(number > 0, first_part + begins[meshes[objects]] + number - 1, parts[objects])
