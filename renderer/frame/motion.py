"""The motion of objects from the last frame to this one: their last transforms, and the last vertices of those that
are deformed.

Where an object that stands still was in the last frame follows from depth and the two cameras. For what moves by
itself, `SceneMotion` copies at the beginning of each frame what may change in it: transforms on the CPU, and vertices
on the device, before simulations overwrite them. Objects that can't move aren't looked at.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame.mirrors import join_runs
from renderer.frame.resources import SceneResources
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.shaders.structs import Object, ObjectPosition
from rhi import Device, StorageBuffer

UNDEFORMED: Final = 0x7FFFFFFF
"""The `vertex_shift` of an object whose vertices stay as they are."""


class MovedObject(sl.Struct):
    """An object that has moved: its index, and its transform in the last frame (`high` + `low` is its position).

    Vertex i was, in the last frame, the one of number i + `vertex_shift` of those that were copied.
    """

    linear: sl.mat3
    high: sl.vec3
    vertex_shift: int
    low: sl.vec3
    object_index: int


def list_movable(scene: Scene) -> Indices:
    """The indices of the objects that may move by themselves: by their nodes, or by simulations."""
    simulated = [simulated.objects for simulated in scene.simulated]
    return np.unique(
        np.concatenate([scene.objects.following_indices, scene.objects.simulated_indices, *simulated])
    ).astype(np.int64)


class SceneMotion:
    """Keeps the last transforms and vertices of a scene's objects that may move.

    Attributes:
        vertices: the floats of the last vertices of deformed objects; None if there are none.
        stride: the number of floats of a vertex.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._movable: Indices | None = None
        self._deformed: Indices = np.zeros(0, np.int64)  # ascending by their first vertices
        self._begins: Indices = np.zeros(0, np.int64)
        self._sizes: Indices = np.zeros(0, np.int64)
        self._first: Indices = np.zeros(0, np.int64)  # by deformed object: its first vertex among the copies
        self._shift: Indices = np.zeros(0, np.int64)  # by object
        self.vertices: StorageBuffer[float] | None = None
        self.stride = 1
        self._last_states: NDArray[np.float64] = np.zeros(0)
        self._last_objects: NDArray[Any] = np.zeros(0, Object.dtype)
        self._last_positions: NDArray[Any] = np.zeros(0, ObjectPosition.dtype)

    def begin_frame(self, resources: SceneResources) -> None:
        """Copy what the frame may change. Must be called before the scene is updated or simulated, outside of
        passes."""
        if self._movable is None:
            self._movable = list_movable(resources.scene)
            self._prepare_vertices(resources)
        movable = self._movable
        if not len(movable):
            return
        objects, positions, states = resources.object_states
        self._last_objects, self._last_positions = objects[movable], positions[movable]
        if len(self._deformed):
            self._copy_vertices(resources, states[self._deformed])
            self._last_states = states[self._deformed].copy()

    def _prepare_vertices(self, resources: SceneResources) -> None:
        """Create room for the vertices of deformed objects."""
        scene = resources.scene
        parts = [simulated.objects for simulated in scene.simulated if len(simulated.objects)]
        if not parts:
            return
        deformed = np.unique(np.concatenate(parts)).astype(np.int64)
        begins = scene.meshes.ranges["base_vertex"][scene.objects.mesh[deformed]].astype(np.int64)
        order = np.argsort(begins, kind="stable")
        self._deformed, self._begins = deformed[order], begins[order]
        self._sizes = scene.meshes.vertex_counts[scene.objects.mesh[self._deformed]].astype(np.int64)
        self._first = np.concatenate([[0], np.cumsum(self._sizes)[:-1]]).astype(np.int64)
        self._shift = np.full(len(scene.objects), UNDEFORMED, np.int64)
        self._shift[self._deformed] = self._first - self._begins
        self.stride = scene.meshes.vertices.itemsize // 4
        count = int(self._sizes.sum()) * self.stride
        self.vertices = self._device.storage(float, count, label="last vertices")
        self._last_states = np.full(len(self._deformed), np.nan)

    def _copy_vertices(self, resources: SceneResources, states: NDArray[np.float64]) -> None:
        """Copy the vertices of the objects whose states differ from those of the copies, adjacent ones together."""
        changed = np.flatnonzero(states != self._last_states)
        source, target = resources.mesh.vertices, self.vertices
        assert source is not None
        assert target is not None
        first = 0
        for begin, end in join_runs(self._begins[changed], self._sizes[changed]):
            at = self._first[changed[first]]
            size = (end - begin) * self.stride * 4
            source.copy_to(
                target, size=size, offset=begin * self.stride * 4, target_offset=int(at) * self.stride * 4
            )
            first = int(np.searchsorted(self._begins[changed], end))

    def collect_moved(self, resources: SceneResources, camera: Camera) -> NDArray[Any]:
        """The opaque objects in view that have moved since the last frame: (k,) of `MovedObject`, ascending by
        group. Tessellated surfaces that move aren't among them."""
        movable = self._movable
        if movable is None or not len(movable):
            return np.zeros(0, MovedObject.dtype)
        objects, positions, states = resources.object_states
        has_moved = (objects["linear"][movable] != self._last_objects["linear"]).any((1, 2))
        for name in ("high", "low"):
            has_moved |= (positions[name][movable] != self._last_positions[name]).any(1)
        if len(self._deformed):
            deformed = self._deformed[states[self._deformed] != self._last_states]
            has_moved |= np.isin(movable, deformed)
        has_moved &= ~resources.is_transparent[movable]
        has_moved &= ~np.isin(movable, resources.tessellated_indices)
        moved = np.flatnonzero(has_moved)
        if len(moved):
            moved = moved[np.isin(movable[moved], resources.select_in_view(camera, movable[moved]))]
        object_indices = movable[moved]
        order = np.argsort(resources.group[object_indices], kind="stable")
        moved, object_indices = moved[order], object_indices[order]
        rows = np.zeros(len(moved), MovedObject.dtype)
        rows["linear"] = self._last_objects["linear"][moved]
        rows["high"], rows["low"] = self._last_positions["high"][moved], self._last_positions["low"][moved]
        rows["object_index"] = object_indices
        rows["vertex_shift"] = self._shift[object_indices] if len(self._shift) else UNDEFORMED
        return rows

    def release(self) -> None:
        """Destroy the copies; the next `begin_frame` creates them again."""
        self.destroy()

    def destroy(self) -> None:
        """Destroy the copies."""
        if self.vertices is not None:
            self.vertices.destroy()
            self.vertices = None
        self._movable = None
