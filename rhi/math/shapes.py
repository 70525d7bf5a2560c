"""Shapes as arrays for `device.mesh`: front faces are counter-clockwise, seen from outside."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from rhi.errors import refuse
from rhi.errors.arguments import to_integer
from rhi.errors.rules import DEVICE_ARGUMENT

_MAX_RINGS: Final = 180
"""The most rings whose vertices 16-bit indices reach: 181 · 361 of them."""


def make_cube() -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.uint16]]:
    """Return a cube: (24, 3) positions from -1 to 1, (24, 3) normals, (24, 2) texture coordinates and 36
    indices.

    Examples:
        >>> positions, normals, uvs, indices = make_cube()
        >>> positions.shape, indices.size
        ((24, 3), 36)
    """
    positions, normals = np.zeros((24, 3), np.float32), np.zeros((24, 3), np.float32)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float32)
    for face in range(6):
        axis, sign = face // 2, 1 if face % 2 else -1
        rows = slice(face * 4, face * 4 + 4)
        normals[rows, axis] = positions[rows, axis] = sign
        positions[rows, (axis + 1) % 3] = corners[:, 0] * sign
        positions[rows, (axis + 2) % 3] = corners[:, 1]
    uvs = np.tile((corners + 1) / 2, (6, 1)).astype(np.float32)
    indices = (np.arange(6)[:, None] * 4 + (0, 1, 2, 0, 2, 3)).ravel().astype(np.uint16)
    return positions, normals, uvs, indices


def make_sphere(rings: int = 24) -> tuple[NDArray[np.float32], NDArray[np.uint16]]:
    """Return a sphere: (n, 3) positions at a distance of 1, which are also its normals, and its indices.

    Args:
        rings: from pole to pole, 2 to 180; more vertices than 16-bit indices reach are refused.

    Raises:
        ValidationError: `device-argument` for another number of rings.
    """
    count = to_integer(rings)
    if count is None or not 2 <= count <= _MAX_RINGS:
        refuse(DEVICE_ARGUMENT, "make_sphere(rings=...)", rings, f"a whole number from 2 to {_MAX_RINGS}")
    rings = count
    v, u = np.mgrid[0 : rings + 1, 0 : 2 * rings + 1]
    theta, phi = v * np.pi / rings, u * np.pi / rings
    positions = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1)
    corner = (v[:-1, :-1] * (2 * rings + 1) + u[:-1, :-1]).reshape(-1, 1)
    indices = corner + np.array([0, 2 * rings + 1, 1, 1, 2 * rings + 1, 2 * rings + 2])
    return positions.reshape(-1, 3).astype(np.float32), indices.ravel().astype(np.uint16)
