"""The objects that a view has found hidden for some frames: those whose vertices are simulated rest there, and terrain
keeps its triangles.

An algorithm that draws what the CPU has chosen knows of each frame what it hides, and what rests is brought to the
frame's time right before its draw. With one that leaves the choice to the device, by lists or on conditions, the CPU
learns it later: answers are read without waiting, as soon as they are there. So what shows again is late by as many
frames as the answers are, and is drawn meanwhile as it was when it went to rest. As algorithms test boxes, which mostly
show before what is inside, that is rarely seen; and where the eye jumps, all counts as seen. What moves as a whole
doesn't rest here: the device tests its box where it stands, and it would never come out from behind a wall.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.visibility.boxes.volumes import find_in_view
from renderer.visibility.gpu.occludees import HIDDEN
from rhi import Readback

PATIENCE: Final = 8
"""The number of frames in a row in which something is hidden before it rests."""
_JUMP: Final = 0.1
"""The eye jumps if between two frames it turns by this angle, or moves by this share of an object's distance."""


class HiddenObjects:
    """Counts for how many frames objects have been hidden.

    Attributes:
        rests: (n,) bool, whether each object of the scene has been hidden for so long that it rests.
    """

    def __init__(self, scene: Scene, deformed: Rows) -> None:
        """`deformed` are the rows of the objects that stay where they are, and whose vertices are simulated."""
        self._scene = scene
        self._fields = np.array(sorted(scene.height_fields), np.int64)
        self._rows = np.union1d(deformed, self._fields)
        self._frames = np.zeros(len(self._rows), np.int64)
        self._camera: Camera | None = None
        self._answers: Readback | None = None
        self.rests = np.zeros(len(scene.objects), bool)

    def begin_frame(self, camera: Camera | None) -> None:
        """Take answers that are there, and find what rests in a frame of `camera`; nothing does without one."""
        if not len(self._rows):
            return
        last, self._camera = self._camera, camera
        if self._answers is not None and self._answers.done:
            self._count(self._answers.result()[self._rows - self._rows[0]] == HIDDEN)
            self._answers = None
        if camera is None or last is None:
            self._frames[:] = 0
        else:
            lower, upper = self._scene.objects.lower[self._rows], self._scene.objects.upper[self._rows]
            away = np.maximum(np.maximum(lower - camera.position, camera.position - upper), 0.0)
            moved = float(np.linalg.norm(camera.position - last.position))
            jumps = moved > _JUMP * np.linalg.norm(away, axis=1)
            self._frames[jumps | (camera.forward @ last.forward < np.cos(_JUMP))] = 0
        self.rests[self._rows] = self._frames >= PATIENCE

    @property
    def are_watched(self) -> bool:
        """Whether the frame that has begun asks for what it hides."""
        return len(self._rows) > 0 and self._camera is not None

    def note(self, drawn: Rows, conditional: Rows) -> None:
        """Count a frame that has drawn these objects, of which those on conditions were hidden before."""
        assert self._camera is not None
        fields = find_in_view(self._scene, self._camera, self._fields) if len(self._fields) else self._fields
        self._count(np.isin(self._rows, np.union1d(conditional, np.setdiff1d(fields, drawn))))

    def ask(self, read: Callable[[int, int], Readback]) -> None:
        """Ask the device what the frame has hidden, unless it is being asked. `read` begins to read the marks of so
        many objects from a row on."""
        if self._answers is None:
            first, last = self._rows[[0, -1]].tolist()
            self._answers = read(first, last - first + 1)

    def _count(self, hidden: NDArray[np.bool_]) -> None:
        self._frames = np.where(hidden, self._frames + 1, 0)
