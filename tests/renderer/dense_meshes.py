"""Dense meshes without seams, for tests of simplification and of levels of detail."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from renderer.scene.meshes import MeshGeometry, list_grid_triangles, make_geometry


def make_bumpy_sphere(side: int = 32, height: float = 0.1, seed: int = 0) -> MeshGeometry:
    """Make a unit sphere of about side² triangles, whose radii differ by up to `height`."""
    rings = side // 2 - 1
    around = 2.0 * np.pi * np.arange(side) / side
    down = np.pi * np.arange(1, rings + 1)[:, None] / (rings + 1)
    ring = np.stack(
        np.broadcast_arrays(np.sin(down) * np.cos(around), np.cos(down), -np.sin(down) * np.sin(around))
    )
    points = np.concatenate([[[0.0, 1.0, 0.0]], ring.reshape(3, -1).T, [[0.0, -1.0, 0.0]]])
    waves = np.random.default_rng(seed).normal(0.0, 3.0, (3, 3))
    points *= 1.0 + height * np.sin(points @ waves).prod(axis=1, keepdims=True)
    triangles = []
    for column in range(side):
        ahead = (column + 1) % side
        triangles.append((0, 1 + column, 1 + ahead))
        for row in range(rings - 1):
            a, b = 1 + row * side + column, 1 + row * side + ahead
            triangles += [(a, a + side, b + side), (a, b + side, b)]
        last = 1 + (rings - 1) * side
        triangles.append((last + side, last + ahead, last + column))
    return make_geometry(points, triangles)


def make_grid(side: int, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> MeshGeometry:
    """Make a square of 2 m with side² points, each at a height."""
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, side), np.linspace(-1.0, 1.0, side))
    points = np.stack([x, height(x, z), z], axis=-1).reshape(-1, 3)
    return make_geometry(points, list_grid_triangles(side, side))
