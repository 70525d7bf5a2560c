"""The objects that a view has found hidden for some frames: their vertex simulations are paused, and terrain
keeps its triangles.

An algorithm whose draws the CPU chooses knows in each frame what it hides, and a paused simulation is brought
to the frame's time right before its draw. With one that leaves the choice to the device, by lists or on
conditions, the CPU learns it later: results are read without waiting, as soon as they are there. So an object
that shows again is late by as many frames as the results are, and is drawn meanwhile as it was when it was
paused. As algorithms test boxes, which mostly show before what is inside, that is rarely visible; and where
the eye jumps, everything counts as visible. The motion of whole nodes is never paused here: the device tests
an object's box where it stands, and it would never come out from behind a wall.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.boxes.volumes import select_in_view
from renderer.visibility.gpu.occludees import HIDDEN
from rhi import Readback

PATIENCE: Final = 8
"""The number of frames in a row in which something is hidden before its simulation is paused."""
_JUMP: Final = 0.1
"""The eye jumps if between two frames it turns by this angle, or moves by this share of an object's
distance."""


class HiddenObjects:
    """Counts for how many frames each object has been hidden.

    Attributes:
        paused: (n,) bool, whether each object of the scene has been hidden so long that its simulation is
            paused.
    """

    def __init__(self, scene: Scene, deformed: Indices) -> None:
        """`deformed` are the indices of the objects that don't move as a whole, but whose vertices are
        simulated."""
        self._scene = scene
        self._fields = np.array(sorted(scene.tessellated), np.int64)
        self._object_indices = np.union1d(deformed, self._fields)
        self._frames = np.zeros(len(self._object_indices), np.int64)
        self._camera: Camera | None = None
        self._answers: Readback | None = None
        self.paused = np.zeros(len(scene.objects), bool)

    def begin_frame(self, camera: Camera | None) -> None:
        """Process query results that have arrived, and decide which objects pause in a frame of `camera`;
        None pauses none."""
        if not len(self._object_indices):
            return
        last, self._camera = self._camera, camera
        if self._answers is not None and self._answers.done:
            self._count(self._answers.result()[self._object_indices - self._object_indices[0]] == HIDDEN)
            self._answers = None
        if camera is None or last is None:
            self._frames[:] = 0
        else:
            lower, upper = (
                self._scene.objects.lower[self._object_indices],
                self._scene.objects.upper[self._object_indices],
            )
            away = np.maximum(np.maximum(lower - camera.position, camera.position - upper), 0.0)
            moved = float(np.linalg.norm(camera.position - last.position))
            jumps = moved > _JUMP * np.linalg.norm(away, axis=1)
            self._frames[jumps | (camera.forward @ last.forward < np.cos(_JUMP))] = 0
        self.paused[self._object_indices] = self._frames >= PATIENCE

    @property
    def is_tracking(self) -> bool:
        """True if this frame records what it hides."""
        return len(self._object_indices) > 0 and self._camera is not None

    def record_frame(self, drawn: Indices, conditional: Indices) -> None:
        """Count a frame that drew the objects `drawn`; the `conditional` ones among them were hidden
        before."""
        assert self._camera is not None
        fields = (
            select_in_view(self._scene, self._camera, self._fields) if len(self._fields) else self._fields
        )
        self._count(np.isin(self._object_indices, np.union1d(conditional, np.setdiff1d(fields, drawn))))

    def request_marks(self, read: Callable[[int, int], Readback]) -> None:
        """Request from the device what the frame has hidden, unless a request is pending. `read` starts
        reading marks: the first object's index and their number."""
        if self._answers is None:
            first, last = self._object_indices[[0, -1]].tolist()
            self._answers = read(first, last - first + 1)

    def _count(self, hidden: NDArray[np.bool_]) -> None:
        self._frames = np.where(hidden, self._frames + 1, 0)
