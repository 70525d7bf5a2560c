"""The way from pixels to positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.scene import Camera, Depth, Orthographic, Perspective, Projection
from renderer.scene.arrays import Floats
from renderer.shaders.pixels import depth_to_nearness, nearness_to_distance, pixel_position
from rhi.shading import evaluate

SIZE = (97, 55)


@dataclass(frozen=True)
class OffAxis:
    """A projection whose axis isn't in the middle of the image."""

    depth: Depth = Depth.REVERSED

    @property
    def matrix(self) -> Floats:
        m = Perspective(depth=self.depth).matrix.copy()
        m[0, 2], m[1, 2] = 0.4, -0.7
        return m

    def with_aspect(self, aspect: float) -> OffAxis:
        return self


PROJECTIONS = {
    "perspective": lambda depth: Perspective(depth=depth),
    "with a far plane": lambda depth: Perspective(near=0.5, far=2000.0, depth=depth),
    "orthographic": lambda depth: Orthographic(30.0, near=-5.0, far=500.0, depth=depth),
    "off-axis": lambda depth: OffAxis(depth),
}


def project(projection: Projection, positions: Floats) -> tuple[Camera, Floats, Floats]:
    """Return a camera, positions relative to it, and their pixels and depths (n, 3), of `positions` in view
    space."""
    camera = Camera.look_at((3e6, 7.0, -5e6), (3e6 + 2.0, 5.0, -5e6 - 9.0), projection=projection)
    relative = positions @ camera.rotation
    clip = np.concatenate([positions, np.ones((len(positions), 1))], 1) @ projection.matrix.T
    ndc = clip[:, :3] / clip[:, 3:]
    pixels = np.stack([(0.5 + 0.5 * ndc[:, 0]) * SIZE[0], (0.5 - 0.5 * ndc[:, 1]) * SIZE[1], ndc[:, 2]], 1)
    return camera, relative, pixels


@pytest.mark.parametrize("direction", list(Depth))
@pytest.mark.parametrize("projection_name", PROJECTIONS)
def test_a_pixel_and_its_depth_lead_back_to_the_position(projection_name: str, direction: Depth) -> None:
    rng = np.random.default_rng(5)
    positions = rng.uniform((-8, -8, -200), (8, 8, -1), (200, 3))
    camera, relative, pixels = project(PROJECTIONS[projection_name](direction), positions)
    rays = compute_pixel_rays(camera, SIZE)
    depth = pixels[:, 2].astype(np.float32)  # as a target holds it
    nearness = evaluate(depth_to_nearness, rays, depth, dtype=np.float32)
    distance = evaluate(nearness_to_distance, rays, nearness, dtype=np.float32)
    results = evaluate(pixel_position, rays, pixels[:, :2], distance, dtype=np.float32)
    # A step of standard depth near 1 is 6e-8, which at 200 m and a near plane of 0.1 m is 24 mm.
    exact = direction is Depth.REVERSED
    assert np.abs(results - relative).max() < (1e-3 if exact else 0.05)


@pytest.mark.parametrize(("direction", "far"), [(Depth.REVERSED, 0.0), (Depth.STANDARD, 1.0)])
def test_only_the_farthest_depth_has_no_nearness(direction: Depth, far: float) -> None:
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), projection=Perspective(depth=direction))
    rays = compute_pixel_rays(camera, SIZE)
    before = np.nextafter(np.float32(far), np.float32(0.5))
    assert evaluate(depth_to_nearness, rays, np.float32(far), dtype=np.float32) == 0.0
    assert evaluate(depth_to_nearness, rays, before, dtype=np.float32) > 0.0


@pytest.mark.parametrize("direction", list(Depth))
@pytest.mark.parametrize("projection_name", PROJECTIONS)
def test_a_position_follows_from_the_pixel_and_the_distance(projection_name: str, direction: Depth) -> None:
    size = (60, 40)
    projection = PROJECTIONS[projection_name](direction)
    camera = Camera.look_at((1e6, 50, -2e6), (1e6 + 3, 48, -2e6 + 5), projection=projection)
    rays = compute_pixel_rays(camera, size)
    random = np.random.default_rng(2)
    pixels, distances = random.uniform(0, size, (500, 2)), random.uniform(1.0, 300.0, 500)
    positions = evaluate(pixel_position, rays, pixels, distances, dtype=np.float64)
    assert positions @ np.array(rays.forward) == pytest.approx(distances, rel=1e-6)
    matrix = camera.projection.matrix @ np.block(
        [[camera.rotation, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]]
    )
    clip = np.concatenate([positions, np.ones((500, 1))], 1) @ matrix.T
    x, y = clip[:, 0] / clip[:, 3], clip[:, 1] / clip[:, 3]
    assert (0.5 + 0.5 * x) * size[0] == pytest.approx(pixels[:, 0], abs=2e-4)
    assert (0.5 - 0.5 * y) * size[1] == pytest.approx(pixels[:, 1], abs=2e-4)


@pytest.mark.parametrize(
    ("projection_name", "far"),
    [("perspective", 3.4e38), ("with a far plane", 2000.0), ("orthographic", 500.0)],
)
def test_the_far_plane_is_as_far_as_the_projection_says(projection_name: str, far: float) -> None:
    projection = PROJECTIONS[projection_name](Depth.REVERSED)
    camera = Camera.look_at((1e6, 50, -2e6), (1e6 + 3, 48, -2e6 + 5), projection=projection)
    assert compute_pixel_rays(camera, (60, 40)).far == pytest.approx(far, rel=1e-3)
