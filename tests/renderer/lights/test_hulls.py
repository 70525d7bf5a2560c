"""Bodies that enclose spheres and cones."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.lights.hulls import make_cone, make_sphere
from renderer.scene.arrays import Floats

RANDOM = np.random.default_rng(5)
DIRECTIONS = (lambda v: v / np.linalg.norm(v, axis=1)[:, None])(RANDOM.normal(size=(4000, 3)))


def planes(corners: Floats, triangles: np.ndarray) -> tuple[Floats, Floats]:
    """Return the outward unit normals (t, 3) and distances (t,) of the faces' planes."""
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals, (normals * a).sum(1)


@pytest.mark.parametrize(
    "hull", [make_sphere(), make_cone(), make_cone(3)], ids=["sphere", "cone", "of 3 sides"]
)
def test_a_body_is_closed_and_convex_and_turned_outward(hull: tuple[Floats, np.ndarray]) -> None:
    corners, triangles = hull
    edges = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)])
    assert sorted(map(tuple, edges)) == sorted(map(tuple, edges[:, ::-1]))  # each once in both directions
    assert len(set(map(tuple, edges))) == len(edges)
    normals, distances = planes(corners, triangles)
    assert (corners @ normals.T <= distances + 1e-12).all()
    assert (normals @ corners.mean(0) * 0 + distances > normals @ corners.mean(0)).all()


def test_the_sphere_is_inside_its_body_and_touches_it() -> None:
    normals, distances = planes(*make_sphere())
    assert (distances + 1e-12 >= DIRECTIONS @ normals.T).all()
    assert distances.min() == pytest.approx(1.0)
    assert np.linalg.norm(make_sphere()[0], axis=1).max() < 1.1


@pytest.mark.parametrize("sides", [3, 4, 10])
def test_the_cone_is_inside_its_body(sides: int) -> None:
    normals, distances = planes(*make_cone(sides))
    turn, height = RANDOM.uniform(0, 2 * np.pi, 2000), RANDOM.uniform(0, 1, 2000)
    side = np.stack([height * np.cos(turn), height * np.sin(turn), height], 1)
    assert (side @ normals.T <= distances + 1e-12).all()
    wider = side * (1.2, 1.2, 1.0)  # the control
    assert sides != 10 or not (wider @ normals.T <= distances + 1e-12).all()
