"""Light volumes: meshes of few triangles that enclose a sphere or a cone."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats


def make_sphere() -> tuple[Floats, NDArray[np.uint32]]:
    """Return corners (42, 3) and triangles (80, 3), counter-clockwise from outside, of a mesh that encloses
    the unit sphere: an icosahedron with each face split into four."""
    golden = (1.0 + 5.0**0.5) / 2.0
    twelve = [(s, t * golden, 0.0) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    corners = [np.roll(corner, turn) for turn in range(3) for corner in twelve]
    vertices = [corner / np.linalg.norm(corner) for corner in corners]
    triangles = []
    for a in range(12):
        for b in range(a + 1, 12):
            for c in range(b + 1, 12):
                if all(vertices[i] @ vertices[j] > 0.4 for i, j in ((a, b), (b, c), (c, a))):  # neighbours
                    normal = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
                    outward = normal @ vertices[a] > 0.0
                    triangles.append((a, b, c) if outward else (a, c, b))
    middles: dict[tuple[int, int], int] = {}

    def split(a: int, b: int) -> int:
        key = (min(a, b), max(a, b))
        if key not in middles:
            middle = vertices[a] + vertices[b]
            vertices.append(middle / np.linalg.norm(middle))
            middles[key] = len(vertices) - 1
        return middles[key]

    faces = []
    for a, b, c in triangles:
        ab, bc, ca = split(a, b), split(b, c), split(c, a)
        faces += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    array, indices = np.array(vertices), np.array(faces, np.uint32)
    first, second, third = (array[indices[:, i]] for i in range(3))
    normals = np.cross(second - first, third - first)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return array / (normals * first).sum(1).min(), indices


def make_cone(sides: int = 10) -> tuple[Floats, NDArray[np.uint32]]:
    """Return corners (sides + 1, 3) and triangles, counter-clockwise from outside, of a pyramid that encloses
    the cone from the origin around z whose base has radius 1 at z = 1."""
    turn = np.arange(sides) * (2.0 * np.pi / sides)
    ring = np.stack([np.cos(turn), np.sin(turn), np.full(sides, np.cos(np.pi / sides))], 1)
    corners = np.concatenate([np.zeros((1, 3)), ring / np.cos(np.pi / sides)])
    numbers = np.arange(sides)
    sloping = np.stack([np.zeros(sides, int), (numbers + 1) % sides + 1, numbers + 1], 1)
    base = np.stack([np.ones(sides - 2, int), numbers[1:-1] + 1, numbers[2:] + 1], 1)
    return corners, np.concatenate([sloping, base]).astype(np.uint32)
