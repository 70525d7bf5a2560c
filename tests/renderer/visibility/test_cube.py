"""The unit cube that boxes are drawn as."""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

import numpy as np

from renderer.visibility.boxes.cubes import TRIANGLES, make_cube
from rhi import Device


class MeshArguments:
    """Stands for a device; keeps the vertices and indices of the mesh that it is asked for."""

    def mesh(self, vertices: dict[str, Any], indices: Any, label: str) -> None:
        self.corners, self.triangles = vertices["position"], indices.reshape(-1, 3)


def test_the_cube_is_closed_and_seen_from_outside_counter_clockwise() -> None:
    arguments = MeshArguments()
    make_cube(cast("Device", arguments))
    a, b, c = (arguments.corners[arguments.triangles[:, column]] for column in range(3))
    normals = np.cross(b - a, c - a)
    assert len(normals) == TRIANGLES
    np.testing.assert_array_equal(np.linalg.norm(normals, axis=1), 4.0)  # half a face of 2 × 2, twice
    assert ((normals * (a + b + c)).sum(axis=1) > 0).all()
    edges = Counter(
        (int(triangle[i]), int(triangle[(i + 1) % 3])) for triangle in arguments.triangles for i in range(3)
    )
    assert set(edges.values()) == {1}
    assert set(edges) == {(end, start) for start, end in edges}
