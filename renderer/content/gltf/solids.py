"""Points and lines of glTF as small solids of triangles.

Every draw list, light volume, shadow map and occluder of the renderer consists of triangles, so points and
lines that are made of triangles when they are read are drawn, lit, culled and shadowed by all that is there.
A point becomes an octahedron, and a segment one that is pulled apart at its middle, from one end to the
other. Its tips reach beyond its ends, so bent lines have no gaps, and a segment without a length is a point.

glTF leaves the width to the program. Here it is in the space of the mesh, not in pixels, so that it is the
same in shadows and in both eyes: the radius is `_RADIUS` of the diagonal of the box around the primitive's
points. Where they are all at one place, it is `_POINT_RADIUS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from rhi.math.indexing import repeat_each

LINES: Final = 1
_STRIPS: Final = 3
_RADIUS: Final = 1.0 / 400.0
_POINT_RADIUS: Final = 0.01
_STEPS: Final = 2.0**-21  # of the largest coordinate: four steps of float32, so that no solid is flat


@dataclass(frozen=True, eq=False, slots=True)
class Solid:
    """The solid of a point or of a segment.

    Attributes:
        directions: (k, 3), where the vertices lie from their end; the first axis leads along the segment.
        ends: (k,), the end of each vertex: 0, or 1.
        faces: (f, 3), the triangles, counter-clockwise from outside.
    """

    directions: Floats
    ends: Indices
    faces: Indices

    @classmethod
    def make(cls, ends: int) -> Solid:
        """Create the solid of a point, with one end, or of a segment, with two."""
        ring = [[0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, -1]]
        directions = np.array([[-1, 0, 0], *ring * ends, [1, 0, 0]], np.float64)
        here = np.arange(1, 5)
        there = np.roll(here, -1)
        far = 4 * (ends - 1)
        tip = np.full(4, len(directions) - 1)
        faces = [[0 * here, there, here], [tip, here + far, there + far]]
        if far:
            faces += [[here, there, there + far], [here, there + far, here + far]]
        return cls(directions, repeat_each(np.arange(ends), len(directions) // ends), np.hstack(faces).T)

    @property
    def size(self) -> int:
        """The number of its vertices and indices."""
        return len(self.directions) + self.faces.size

    def make_vertices(
        self, positions: NDArray[np.float32], ends: NDArray[np.uint32]
    ) -> tuple[Indices, Indices, Floats, float]:
        """Return for solids with `ends` (s, 1 or 2), rows of `positions` (v, 3): the row of each of their
        vertices, (k * s,), their triangles (f * s, 3), which way each vertex lies from its row, (k * s, 3),
        and how far."""
        points = positions[ends].astype(np.float64)
        with np.errstate(invalid="ignore"):
            along = points[:, -1] - points[:, 0]
        length = np.linalg.norm(along, axis=1, keepdims=True)
        has_length = np.isfinite(length) & (length > 0.0)
        axis = np.where(has_length, along / np.where(has_length, length, 1.0), (1.0, 0.0, 0.0))
        aside = np.cross(axis, np.eye(3)[np.abs(axis).argmin(axis=1)])
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        frames = np.stack([axis, aside, np.cross(axis, aside)], axis=1)
        outward = (self.directions @ frames).reshape(-1, 3)
        first = len(self.directions) * np.arange(len(ends))[:, None, None]
        rows = ends[:, self.ends].reshape(-1).astype(np.int64)
        return rows, (self.faces + first).reshape(-1, 3), outward, _compute_radius(points.reshape(-1, 3))


POINT: Final = Solid.make(1)
SEGMENT: Final = Solid.make(2)


def list_ends(corners: NDArray[Any], mode: int) -> NDArray[Any]:
    """Return the points (n, 1), or the segments (n, 2) of lines, a loop or a strip, given its indices."""
    if mode < LINES:
        return corners[:, None]
    if mode == LINES:
        return corners[: len(corners) // 2 * 2].reshape(-1, 2)
    ends = np.stack([corners, np.roll(corners, -1)], axis=1)
    return ends[:-1] if mode == _STRIPS or len(ends) < 2 else ends


def _compute_radius(points: Floats) -> float:
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return _POINT_RADIUS
    extent = float(np.linalg.norm(np.ptp(finite, axis=0)))
    return max(_RADIUS * extent if extent else _POINT_RADIUS, _STEPS * float(np.abs(finite).max()))
