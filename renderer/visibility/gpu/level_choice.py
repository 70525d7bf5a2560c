"""The levels of detail that the device's lists of draws have: chosen once a view, for both of its lists."""

from __future__ import annotations

from renderer.visibility.detail import GROUP, ChooseLevels
from renderer.visibility.scene_drawer import SceneArrays
from rhi import Device, Encoder


class LevelChoice:
    """The choice of each object's level.

    Attributes:
        drawn_parts: (n,) the index in `SceneArrays.mesh_parts` of what each object is drawn as.
    """

    def __init__(self, device: Device, count: int) -> None:
        self.drawn_parts = device.storage(int, count, label="drawn parts")
        self._program = device.program(ChooseLevels)

    def choose(self, encoder: Encoder, arrays: SceneArrays) -> None:
        """Choose the levels within `arrays.detail`, which isn't None."""
        assert arrays.detail is not None
        encoder.dispatch(
            self._program,
            -(-self.drawn_parts.count // GROUP),
            detail=arrays.detail,
            objects=arrays.objects,
            object_positions=arrays.object_positions,
            object_meshes=arrays.object_meshes,
            mesh_parts=arrays.mesh_parts,
            drawn_parts=self.drawn_parts,
        )

    def destroy(self) -> None:
        """Destroy the buffer on the device."""
        self.drawn_parts.destroy()
