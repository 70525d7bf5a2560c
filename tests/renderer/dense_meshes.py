"""A dense mesh with borders, for tests of simplification."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from renderer.scene.meshes import MeshGeometry, list_grid_triangles, make_geometry


def make_grid(side: int, height: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> MeshGeometry:
    """Make a square of 2 m with side² points, each at a height."""
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, side), np.linspace(-1.0, 1.0, side))
    points = np.stack([x, height(x, z), z], axis=-1).reshape(-1, 3)
    return make_geometry(points, list_grid_triangles(side, side))
