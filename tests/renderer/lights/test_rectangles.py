"""The rectangles of lights on the screen, compared with points inside their volumes."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.light_kinds.spot import bound_cones
from renderer.lights.rectangles import bound_spheres
from renderer.scene import Camera, Depth, Orthographic, Perspective
from renderer.scene.arrays import Floats

PROJECTIONS = {
    "perspective": lambda depth: Perspective(near=0.3, depth=depth),
    "with a far plane": lambda depth: Perspective(fov=2.0, near=1.5, far=90.0, depth=depth),
    "orthographic": lambda depth: Orthographic(30.0, near=-4.0, depth=depth),
}


def project(camera: Camera, points: Floats) -> tuple[Floats, Floats]:
    """Return x and y of points in the image, and whether they are not nearer than the near plane."""
    clip = np.concatenate([points, np.ones((*points.shape[:-1], 1))], -1) @ camera.view_projection.T
    w = clip[..., 3:]
    depth = camera.projection.depth
    near = clip[..., 2] <= clip[..., 3] if depth is Depth.REVERSED else clip[..., 2] >= 0.0
    return clip[..., :2] / w, near & (w[..., 0] > 0.0)


@pytest.mark.parametrize("direction", list(Depth))
@pytest.mark.parametrize("projection", PROJECTIONS)
def test_a_rectangle_is_the_smallest_around_its_sphere(projection: str, direction: Depth) -> None:
    rng = np.random.default_rng(11)
    camera = Camera.look_at((5, 3, 2), (-4, 1, -9), projection=PROJECTIONS[projection](direction))
    centers = camera.position + rng.uniform(-25, 25, (300, 3))
    radii = rng.uniform(0.2, 22.0, 300)
    away = rng.normal(size=(300, 4000, 3))
    points = centers[:, None] + radii[:, None, None] * away / np.linalg.norm(away, axis=-1, keepdims=True)
    # Where the near plane cuts a sphere, the extremes are on the circle, which points on the surface miss.
    lengths = rng.uniform(0, 1, (300, 4000, 1)) ** (1 / 3)
    points = np.concatenate([points, centers[:, None] + (points - centers[:, None]) * lengths], 1)
    projected, seen = project(camera, points)
    rectangles = bound_spheres(camera, centers, radii)
    inside = (projected >= rectangles[:, None, :2]).all(-1) & (projected <= rectangles[:, None, 2:]).all(-1)
    on_screen = seen & (np.abs(projected) <= 1.0).all(-1)
    assert on_screen.any(1).sum() > 40
    assert inside[on_screen].all()
    whole = seen.all(1) & (np.abs(projected) <= 1.0).all((1, 2))  # not cut: the bound is close to the points
    if whole.any():
        low, high = projected[whole].min(1), projected[whole].max(1)
        size = rectangles[whole, 2:] - rectangles[whole, :2]
        assert ((high - low) >= 0.95 * size).all()
    if projection != "orthographic":
        nearer = ~seen.any(1)
        assert (rectangles[nearer, 2] - rectangles[nearer, 0] <= 0.2).all()


def test_a_sphere_behind_the_eye_has_no_area() -> None:
    camera = Camera.look_at((0, 0, 0), (0, 0, -1))
    rectangles = bound_spheres(camera, np.array([[0.0, 0, 5], [0, 0, -5]]), np.array([2.0, 2.0]))
    assert rectangles[0].tolist() == [0, 0, 0, 0]
    assert rectangles[1, 2] > rectangles[1, 0]


def test_a_sphere_around_the_eye_is_the_whole_image() -> None:
    camera = Camera.look_at((0, 0, 0), (0, 0, -1))
    assert bound_spheres(camera, np.zeros((1, 3)), np.array([2.0])).tolist() == [[-1, -1, 1, 1]]


def test_a_sphere_beside_the_eye_is_on_its_side_of_the_image() -> None:
    camera = Camera.look_at((0, 0, 0), (0, 0, -1))
    left, _, right, _ = bound_spheres(camera, np.array([[3.0, 0, 0]]), np.array([2.9]))[0]
    assert left > 0.0
    assert right == 1.0


@pytest.mark.parametrize("outer", [0.05, 0.6, 0.8, 1.2, 2.0, np.pi])
def test_the_sphere_of_a_spot_holds_its_light(outer: float) -> None:
    rng = np.random.default_rng(3)
    axis = np.array([0.36, 0.48, -0.8])
    away = rng.normal(size=(20000, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    lit = away[away @ axis >= np.cos(outer)] * rng.uniform(0, 7, (np.sum(away @ axis >= np.cos(outer)), 1))
    center, radius = bound_cones(np.ones((1, 3)), axis[None], np.array([7.0]), np.array([outer]))
    distance = np.linalg.norm(1.0 + lit - center, axis=1)
    assert len(lit) > 5
    assert distance.max() <= radius[0] * (1 + 1e-12)
    assert radius[0] <= 7.0
