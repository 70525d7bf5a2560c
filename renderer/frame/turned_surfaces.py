"""Surfaces of which a view sees nothing but the backs, which aren't drawn: water from below.

A simulation that states `HeightSimulation.max_slopes` moves the heights of a surface over the x and z of its
object. No triangle of it is steeper, so a point far enough below sees all of them from behind. Then nothing of
the surface is drawn or simulated, whatever its waves are. A bound on slopes is needed, since being below isn't
enough: a flat ray leaves a steep wave at its back, and meets the front of the next.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Orthographic, Scene
from renderer.scene.simulation import HeightSimulation

_MARGIN: Final = 1.01
"""Slopes on the device are rounded, and so are corners of triangles that are seen edge on."""


class TurnedSurfaces:
    """Finds the surfaces of a scene that show a view only their backs.

    Attributes:
        object_indices: (k,) the objects that may, ascending; mostly none.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        slopes: dict[int, NDArray[np.float64]] = {}
        for simulated in scene.simulated:
            if isinstance(simulated.simulation, HeightSimulation):
                slopes |= dict.fromkeys(simulated.objects.tolist(), simulated.simulation.max_slopes)
        self.object_indices: NDArray[np.int64] = np.array(sorted(slopes), np.int64)
        self._slopes = slopes

    def select_facing(self, camera: Camera, object_indices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the objects `object_indices` (k,) without those of which this eye sees only backs."""
        if not len(self.object_indices):
            return object_indices
        candidates = np.intersect1d(object_indices, self.object_indices)
        turned = [row for row in candidates.tolist() if self._is_turned(row, camera)]
        return object_indices[~np.isin(object_indices, turned)] if turned else object_indices

    def _is_turned(self, row: int, camera: Camera) -> bool:
        objects, nodes = self._scene.objects, self._scene.nodes
        boxes, node = objects.boxes, int(objects.node[row])
        if self._scene.materials["double_sided"][objects.material[row]] or boxes.node[row] != node:
            return False  # within declared bounds: its transform may be that of an earlier time
        world = nodes.world[node]
        if not abs(np.linalg.det(world[:3, :3])) > 0.0:
            return False
        inverse, slopes = np.linalg.inv(world), _MARGIN * self._slopes[row]
        if isinstance(camera.projection, Orthographic):
            forward = inverse[:3, :3] @ camera.forward
            return bool(forward[1] > slopes @ np.abs(forward[::2]))
        eye = inverse[:3, :3] @ camera.position + inverse[:3, 3]
        lower, upper = boxes.lower[row], boxes.upper[row]
        below = float(lower[1] - eye[1])  # at least so far
        away = np.maximum(np.abs(eye - lower), np.abs(eye - upper))[::2]
        return bool(below > slopes @ away)
