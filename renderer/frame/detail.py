"""Levels of detail: which simplified version of its mesh an object is drawn as.

A level's error bounds its distance from the mesh. Seen from a distance, it is fewer pixels than a limit: so the image
of the level is nowhere farther than that from the mesh's. The coarsest level within the limit is drawn. A change of
levels moves no edge by more than twice the limit, so there is no hysteresis.

- With perspective, a point that is moved by e at a distance d from the eye, e < d, moves on the image plane by at most
  f e / (d - e) / cos²: f is the focal length in pixels, and the cosine that of the angle to the image's corner.
- The distance is that of the object's bounding box from the eye, so a turn of the camera changes no level.
- An object's transform stretches an error by at most the square root of the largest row sum of AᵀA, A being its linear
  part: exact for rotations and uniform scales.
- All passes of a frame, and both eyes, have the same limit, and so the same levels. Shadow maps have limits of their
  own: those of their cameras, in texels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices
from rhi.math import is_parallel
from rhi.math.indexing import repeat_each

_STEPS: Final = 256.0
"""Limits are rounded down to such parts of a power of two, so that offsets of samples don't change them."""


@dataclass(frozen=True, eq=False, slots=True)
class DetailLimit:
    """The largest error, in metres, that an object at a distance may have: `constant` + `slope` times the distance.

    Attributes:
        eyes: (e, 3) positions, the nearest of which counts.
    """

    eyes: Floats
    constant: float
    slope: float

    @classmethod
    def compute(cls, cameras: Sequence[Camera], size: tuple[int, int], pixels: float) -> DetailLimit | None:
        """Return the limit of images of this size whose errors are at most so many pixels, None for no error."""
        if not pixels > 0.0:
            return None
        constants, slopes = [], []
        for camera in cameras:
            matrix = camera.projection.matrix
            scale = 0.5 * max(abs(matrix[0, 0]) * size[0], abs(matrix[1, 1]) * size[1])
            if is_parallel(camera.projection):
                constants.append(pixels / scale)
                slopes.append(0.0)
                continue
            tangents = [(1.0 + abs(matrix[axis, 2])) / abs(matrix[axis, axis]) for axis in (0, 1)]
            angle = pixels / (scale * (1.0 + tangents[0] ** 2 + tangents[1] ** 2))
            constants.append(0.0)
            slopes.append(angle / (1.0 + angle))
        eyes = np.array([camera.position for camera in cameras])
        return cls(eyes, _round_down(min(constants)), _round_down(min(slopes)))

    def allow(self, lower: Floats, upper: Floats) -> Floats:
        """Return the largest errors (k,) of objects with these bounds (k, 3)."""
        away = np.maximum(np.maximum(lower - self.eyes[:, None], self.eyes[:, None] - upper), 0.0)
        distances = np.sqrt((away * away).sum(axis=-1)).min(axis=0)
        errors: Floats = self.constant + self.slope * distances
        return errors


def _round_down(value: float) -> float:
    mantissa, exponent = np.frexp(value)
    return float(np.ldexp(np.floor(mantissa * _STEPS) / _STEPS, exponent))


class DetailLevels:
    """The draws of the levels of a scene's objects, behind those of the meshes themselves.

    Attributes:
        index_begin: where the indices of levels begin in the buffer of all indices.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self.index_begin = len(scene.meshes.indices)
        self._first: Indices = np.zeros(0, np.int64)  # by object, the row of its first level
        self._counts: Indices = np.zeros(0, np.int64)  # by object, how many levels there are

    def list_draws(self, draws: NDArray[Any]) -> NDArray[Any]:
        """Return the draws (n,) of all objects, and behind them those of their levels."""
        meshes, mesh = self._scene.meshes, self._scene.objects.mesh
        begins = meshes.level_begins
        self._counts = begins[mesh + 1] - begins[mesh]
        self._first = len(draws) + np.cumsum(self._counts) - self._counts
        rows = draws[repeat_each(np.arange(len(draws)), self._counts)]
        behind = np.arange(len(rows)) - repeat_each(self._first - len(draws), self._counts)
        ranges = meshes.level_ranges[repeat_each(begins[mesh], self._counts) + behind]
        rows["first"] = ranges["first_index"] + self.index_begin
        rows["count"] = ranges["index_count"]
        return np.concatenate([draws, rows])

    def select(self, object_indices: Indices, limit: DetailLimit) -> Indices:
        """Return the draws (k,) of objects (k,): those of the coarsest levels within the limit."""
        has_levels = self._counts[object_indices] > 0
        if not has_levels.any():
            return object_indices
        scene = self._scene
        indices = object_indices[has_levels]
        linear = scene.nodes.world[scene.objects.node[indices]][:, :3, :3]
        gram = linear.transpose(0, 2, 1) @ linear
        stretch = np.sqrt(np.abs(gram).sum(axis=2).max(axis=1))
        allowed = limit.allow(scene.objects.lower[indices], scene.objects.upper[indices])
        errors = scene.meshes.level_errors[scene.objects.mesh[indices]]
        levels = (errors * stretch[:, None] <= allowed[:, None]).sum(axis=1)
        rows = object_indices.copy()
        rows[has_levels] = np.where(levels > 0, self._first[indices] + levels - 1, indices)
        return rows
