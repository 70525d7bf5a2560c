"""The reference ray tracer's rays meet what each triangle alone says that they meet."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.lab.measure.ray_tracer.triangle_tree import TriangleTree


def intersect_one_by_one(corners: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> dict[int, float]:
    """Return the distance of each triangle that a ray meets, by solving for it."""
    nearest = {}
    for row, (a, b, c) in enumerate(corners):
        matrix = np.stack([b - a, c - a, -direction], axis=1)
        if abs(np.linalg.det(matrix)) > 1e-12:
            second, third, distance = np.linalg.solve(matrix, origin - a)
            if min(second, third, 1.0 - second - third, distance) >= 0.0:
                nearest[row] = distance
    return nearest


@pytest.mark.parametrize("count", [1, 4, 5, 33, 300])
def test_rays_meet_the_triangles_that_each_of_them_says(count: int) -> None:
    rng = np.random.default_rng(count)
    corners = rng.uniform(-1, 1, (count, 1, 3)) + rng.normal(size=(count, 3, 3)) * 0.3
    origins = rng.uniform(-2, 2, (60, 3))
    directions = corners[rng.integers(0, count, 60)].mean(axis=1) - origins + rng.normal(size=(60, 3)) * 0.02
    directions[:10, 0] = 0.0  # along the sides of boxes
    directions[10:13] = np.eye(3)
    hits = TriangleTree(corners).intersect(origins, directions, np.zeros(60), np.full(60, np.inf))
    met = 0
    for ray in range(60):
        mine = hits.take(hits.ray == ray)
        want = intersect_one_by_one(corners, origins[ray], directions[ray])
        assert dict(zip(mine.triangle.tolist(), mine.distance.tolist(), strict=True)) == pytest.approx(want)
        met += len(want)
    assert met > 20


def test_neighbouring_rays_meet_the_triangles_that_each_of_them_meets_alone() -> None:
    """They descend the tree as bundles, from origins beside each other and in about the same direction."""
    rng = np.random.default_rng(5)
    corners = rng.uniform(-1, 1, (300, 1, 3)) + rng.normal(size=(300, 3, 3)) * 0.1
    across = np.abs(np.arange(320) * 0.06 % 3.6 - 1.8) - 0.9  # there and back, in short steps
    origins = np.stack([np.full(320, -3.0), across - 0.9, np.linspace(-1.5, 0.3, 320)], axis=1)
    directions = np.array([1.0, 0.3, 0.2]) + rng.normal(size=(320, 3)) * 0.005
    tree, first, last = TriangleTree(corners), np.zeros(320), np.full(320, np.inf)
    hits = tree.intersect(origins, directions, first, last)
    pairs = set(zip(hits.ray.tolist(), hits.triangle.tolist(), strict=True))
    alone = set()
    for ray in range(320):
        single = tree.intersect(*(array[ray : ray + 1] for array in (origins, directions, first, last)))
        alone |= {(ray, triangle) for triangle in single.triangle.tolist()}
    assert len(pairs) > 100
    assert pairs == alone


@pytest.mark.parametrize("moved", [0.0, 0.2, 3.0])
def test_hits_are_the_same_in_the_order_of_another_tree(moved: float) -> None:
    rng = np.random.default_rng(7)
    corners = rng.uniform(-1, 1, (300, 1, 3)) + rng.normal(size=(300, 3, 3)) * 0.3
    order = TriangleTree(corners).order
    corners += moved * rng.normal(size=(300, 1, 3))
    origins = rng.uniform(-2, 2, (80, 3))
    rays = (
        origins,
        corners[rng.integers(0, 300, 80)].mean(axis=1) - origins,
        np.zeros(80),
        np.full(80, np.inf),
    )
    hits = [tree.intersect(*rays) for tree in (TriangleTree(corners), TriangleTree(corners, order))]
    sets = [
        set(zip(*(getattr(each, name).tolist() for name in each.__slots__), strict=True)) for each in hits
    ]
    assert len(sets[0]) > 100
    assert sets[0] == sets[1]


def test_a_ray_begins_and_ends_at_its_distances() -> None:
    triangles = np.array([[(-1.0, -1.0, z), (3.0, -1.0, z), (-1.0, 3.0, z)] for z in (-1.0, -2.0, -3.0)])
    tree, ahead = TriangleTree(triangles), np.array([(0.0, 0.0, -1.0)])
    for first, last, met in ((0.0, 9.0, 3), (1.5, 9.0, 2), (0.0, 2.5, 2), (2.0, 2.0, 1), (3.1, 9.0, 0)):
        hits = tree.intersect(np.zeros((1, 3)), ahead, np.array([first]), np.array([last]))
        assert len(hits.ray) == met


def test_no_ray_falls_between_two_triangles_of_a_grid() -> None:
    x, y = np.meshgrid(np.arange(9.0) * 0.3, np.arange(9.0) * 0.7)
    points = np.stack([x, y, np.sin(x + y)], axis=2).reshape(-1, 3)
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).reshape(-1)
    triangles = np.concatenate([np.stack([a, a + 1, a + 10], 1), np.stack([a, a + 10, a + 9], 1)])
    shares = np.random.default_rng(0).uniform(size=(2000, 1))
    edges = points[triangles[:, [0, 1, 1, 2]]].reshape(-1, 2, 3)  # inner ones, and some at the border
    sampled_edges = edges[np.random.default_rng(1).integers(0, len(edges), 2000)]
    targets = sampled_edges[:, 0] * (1.0 - shares) + sampled_edges[:, 1] * shares
    eye = np.array((1.0, 2.0, 9.0))
    inside = (targets[:, 0] > 0.01) & (targets[:, 0] < 2.39) & (targets[:, 1] > 0.01) & (targets[:, 1] < 5.59)
    count = int(inside.sum())
    rays = np.full((count, 3), eye), targets[inside] - eye
    hits = TriangleTree(points[triangles]).intersect(*rays, np.zeros(count), np.full(count, 2.0))
    assert len(np.unique(hits.ray)) == count > 1000
