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

    def __init__(self, device: Device, meshes: NDArray[np.int32]) -> None:
        self.meshes = meshes.copy()
        self._object_meshes = MirroredArray(device, int, "meshes of objects")
        self._entries = MirroredArray(device, ListEntry, "list entries")
        self._begins = MirroredArray(device, uint, "instance sets")
        self._is_current = False

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
        self, groups: NDArray[np.int32]
    ) -> tuple[StorageBuffer[int], StorageBuffer[ListEntry], StorageBuffer[uint]]:
        """Return the buffers `object_meshes`, `list_entries` and `set_begins` of `SceneArrays`, given the number (n,)
        of the program and states that draw each object."""
        if not self._is_current:
            entries, begins = make_instance_sets(self.meshes, groups)
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
