"""The instance sets of a scene on a device: objects of one mesh that are drawn by one program with the same states.

Lists of draws that the device makes have a draw for each of them (`renderer.visibility.gpu.draw_lists`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from renderer.frame.mirrors import MirroredArray
from renderer.shaders import ListEntry
from renderer.visibility.gpu.draw_lists import make_instance_sets
from rhi import Device, StorageBuffer
from rhi.shading import uint


class InstanceSets:
    """Buffers of instance sets, written when they are first needed after a change.

    Attributes:
        meshes: the mesh (n,) of each object, as of the last `follow`.
    """

    def __init__(
        self,
        device: Device,
        meshes: NDArray[np.int32],
        level_begins: NDArray[np.int64],
        meshlet_begins: NDArray[np.int64] | None = None,
    ) -> None:
        """`level_begins` and `meshlet_begins` are those of `Meshes`; without the latter, meshes are drawn whole."""
        self.meshes = meshes.copy()
        self._level_begins = level_begins
        self._meshlet_begins = meshlet_begins
        self._object_meshes = MirroredArray(device, int, "meshes of objects")
        self._entries = MirroredArray(device, ListEntry, "list entries")
        self._begins = MirroredArray(device, uint, "instance sets")
        self._is_current = self._has_levels = False

    def follow(self, meshes: NDArray[np.int32]) -> bool:
        """Take other meshes (n,) of the objects; return whether any has changed."""
        if np.array_equal(meshes, self.meshes):
            return False
        self.meshes = meshes.copy()
        self._is_current = False
        return True

    def forget(self) -> None:
        """Note that objects may be drawn by other programs or with other states."""
        self._is_current = False

    def update(
        self, groups: NDArray[np.int32], *, has_levels: bool = True
    ) -> tuple[StorageBuffer[int], StorageBuffer[ListEntry], StorageBuffer[uint]]:
        """Return the buffers `object_meshes`, `list_entries` and `set_begins` of `SceneArrays`, given the number (n,)
        of the program and states that draw each object. Without `has_levels` there are no sets of levels of detail."""
        if not self._is_current or has_levels != self._has_levels:
            self._has_levels = has_levels
            level_begins = self._level_begins if has_levels else None
            first = len(self._level_begins) - 1 + int(self._level_begins[-1])
            entries, begins = make_instance_sets(
                self.meshes, groups, level_begins, self._meshlet_begins, first
            )
            self._object_meshes.write(self.meshes)
            self._entries.write(entries)
            self._begins.write(begins)
            self._is_current = True
        buffers = self._object_meshes.buffer, self._entries.buffer, self._begins.buffer
        meshes, listed, begun = buffers
        assert meshes is not None, "a scene has at least one object"
        assert listed is not None
        assert begun is not None
        return meshes, listed, begun

    def destroy(self) -> None:
        """Destroy the buffers."""
        for mirrored in (self._object_meshes, self._entries, self._begins):
            mirrored.destroy()
