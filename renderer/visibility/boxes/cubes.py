"""The unit cube that boxes are drawn as, and the constants of the camera that sees it."""

from __future__ import annotations

from typing import Final

import numpy as np

from rhi import Device, Mesh
from rhi.shading import Struct, mat4, vec3

CORNERS: Final = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)

FACES: Final = np.array(
    [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)], np.uint16
)
"""The corners of each face, counter-clockwise seen from outside."""

TRIANGLES: Final = 12
"""Number of triangles of a box."""


class CubeCorner(Struct):
    """A vertex of the cube from -1 to 1."""

    position: vec3


class BoxCamera(Struct):
    """The matrix from positions relative to the eye to clip space."""

    relative_view_projection: mat4


def make_cube(device: Device) -> Mesh:
    """Create the mesh of a cube from -1 to 1, with vertices of `CubeCorner` and two triangles for each
    face."""
    triangles = np.ascontiguousarray(FACES[:, [0, 1, 2, 0, 2, 3]]).reshape(-1)
    return device.mesh({"position": CORNERS}, triangles, label="unit cube")
