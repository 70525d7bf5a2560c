"""The last frame's depth as another camera sees it."""

from __future__ import annotations

import numpy as np
import pytest
from depth_textures import create_depth_texture
from test_depth_pyramid import reduce_once

import rhi
from renderer.scene import Camera, Depth, Orthographic, Perspective
from renderer.visibility.gpu.reprojection import ReprojectedDepth

SIZE = (41, 23)
PROJECTIONS = {
    Depth.REVERSED: Perspective(near=0.5),
    Depth.STANDARD: Perspective(near=0.5, far=200.0, depth=Depth.STANDARD),
}
FAR = {Depth.REVERSED: 0.0, Depth.STANDARD: 1.0}


def look(x: float = 0.0, z: float = 0.0, turn: float = 0.0, depth: Depth = Depth.REVERSED) -> Camera:
    """Create a camera at (x, 0, z) that looks along -z, rotated to the left by some radians."""
    projection = PROJECTIONS[depth].with_aspect(SIZE[0] / SIZE[1])
    return Camera.look_at((x, 0.0, z), (x - np.sin(turn), 0.0, z - np.cos(turn)), projection=projection)


def depth_at(camera: Camera, distance: float) -> float:
    """Return the depth at a distance in front of the camera."""
    clip = camera.projection.matrix @ (0.0, 0.0, -distance, 1.0)
    return float(clip[2] / clip[3])


def reproject(
    device: rhi.Device, depths: np.ndarray, last: Camera, now: Camera, size: tuple[int, int] | None = None
) -> np.ndarray:
    """Reproject the depths (h, w) of the camera `last` to the camera `now`."""
    reprojected = ReprojectedDepth(device)
    texture = create_depth_texture(device, depths)
    reprojected.aim(last, texture.size)
    reprojected.store(device, texture, last.projection.depth)
    reprojected.aim(now, size or texture.size)
    with reprojected.render_pass(device, now.projection.depth):
        pass
    assert reprojected._resources is not None
    result = reprojected._resources.target.read()
    reprojected.destroy()
    texture.destroy()
    return result


@pytest.mark.parametrize("direction", Depth)
@pytest.mark.parametrize("size", [(1, 1), (3, 2), (8, 8), (41, 23), (64, 33)])
def test_a_camera_that_stays_sees_the_farthest_of_each_block(
    device: rhi.Device, size: tuple[int, int], direction: Depth
) -> None:
    depths = np.random.default_rng(1).uniform(0.01, 0.9, size[::-1]).astype(np.float32)
    camera = look(depth=direction).with_aspect(size[0] / size[1])
    reprojected = reproject(device, depths, camera, camera)
    expected = reduce_once(depths, direction)
    assert reprojected.shape == expected.shape
    # The last texels' centres may lie outside the image: what can't be moved fills its own place.
    assert reprojected == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("direction", Depth)
def test_the_sky_stays_far(device: rhi.Device, direction: Depth) -> None:
    depths = np.full(SIZE[::-1], FAR[direction], np.float32)
    reprojected = reproject(device, depths, look(depth=direction), look(z=-3.0, turn=0.2, depth=direction))
    assert (reprojected == FAR[direction]).all()


@pytest.mark.parametrize("direction", Depth)
def test_a_wall_ahead_is_as_much_nearer_as_the_camera_has_come(device: rhi.Device, direction: Depth) -> None:
    last, now = look(depth=direction), look(z=-4.0, depth=direction)
    depths = np.full(SIZE[::-1], depth_at(last, 20.0), np.float32)
    reprojected = reproject(device, depths, last, now)
    assert reprojected == pytest.approx(np.full_like(reprojected, depth_at(now, 16.0)), rel=1e-4)


def test_a_pixel_goes_where_the_camera_now_sees_it(device: rhi.Device) -> None:
    last, now = look(), look(x=3.0)
    depths = np.zeros(SIZE[::-1], np.float32)
    depths[8:12, 20:24] = depth_at(last, 10.0)
    reprojected = reproject(device, depths, last, now)
    # 3 m to the side at 10 m: by so many of the 41 pixels' 10.25 texels.
    shift = 3.0 / 10.0 * last.projection.matrix[0, 0] * 0.5 * SIZE[0] / 4
    column = int((5.5 - shift) // 1)
    assert column == 4
    expected = np.zeros_like(reprojected)
    expected[2, column] = expected[2, 5] = depth_at(last, 10.0)  # and where it was, for nothing else is there
    assert reprojected == pytest.approx(expected, rel=1e-5)


def test_a_wall_that_one_passes_is_no_nearer_than_it_is(device: rhi.Device) -> None:
    # At each pixel it is as far as before, though each of its points has come a metre nearer. Points written
    # where they were seen before, too, would hide the wall; in the holes, one texel in seven here, they are.
    width = 1600
    projection = Perspective(near=0.5, aspect=width / 16)
    last, now = (
        Camera.look_at((0.0, 0.0, z), (0.0, 0.0, z - 1.0), projection=projection) for z in (0.0, -1.0)
    )

    def distances(x: np.ndarray) -> np.ndarray:
        return 8.0 / np.maximum(np.abs(x), 0.01)

    x = (np.arange(width) + 0.5) / width * 2.0 - 1.0
    depths = np.broadcast_to((0.5 / distances(x)).astype(np.float32), (16, width))
    reprojected = reproject(device, depths, last, now)[2]
    at = (np.arange(width // 4) + 0.5) * 4 / width * 2.0 - 1.0
    beside = (np.abs(at) > 0.4) & (np.abs(at) < 0.9)
    away = 0.5 / reprojected[beside] - distances(at[beside])
    assert (np.abs(away) < 0.4).mean() > 0.8
    assert away.min() > -1.1


@pytest.mark.parametrize("direction", Depth)
@pytest.mark.parametrize("way", [-20.3, -30.0])
def test_reprojected_depth_behind_the_eye_or_before_the_near_plane_is_unchanged(
    device: rhi.Device, direction: Depth, way: float
) -> None:
    last, now = look(depth=direction), look(z=way, depth=direction)
    depths = np.full(SIZE[::-1], depth_at(last, 20.0), np.float32)
    reprojected = reproject(device, depths, last, now)
    assert reprojected == pytest.approx(np.full_like(reprojected, depth_at(last, 20.0)), rel=1e-5)
    assert np.isfinite(reprojected).all()


@pytest.mark.parametrize("turn", [0.5 * np.pi, np.pi])
def test_turning_away_leaves_finite_depths(device: rhi.Device, turn: float) -> None:
    depths = np.random.default_rng(2).uniform(0.001, 1.0, SIZE[::-1]).astype(np.float32)
    reprojected = reproject(device, depths, look(), look(turn=float(turn)))
    assert np.isfinite(reprojected).all()
    assert ((reprojected >= 0.0) & (reprojected <= 1.0)).all()


def test_a_parallel_projection_is_reprojected_too(device: rhi.Device) -> None:
    projection = Orthographic(10.0, aspect=SIZE[0] / SIZE[1], near=0.0, far=50.0)
    last = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=projection)
    now = Camera.look_at((0.0, 0.0, -5.0), (0.0, 0.0, -6.0), projection=projection)
    depths = np.full(SIZE[::-1], 0.5, np.float32)
    reprojected = reproject(device, depths, last, now)
    assert reprojected == pytest.approx(np.full_like(reprojected, 0.6), rel=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (41, 23), (64, 36), (63, 34), (5, 8)])
def test_reprojected_points_land_on_the_texels_of_their_pixels(
    null: rhi.Device, size: tuple[int, int]
) -> None:
    camera = look().with_aspect(size[0] / size[1])
    points = np.random.default_rng(3).uniform((-4, -3, -20), (4, 3, -2), (50, 3))
    points = np.append(points, np.ones((50, 1)), axis=1)
    reprojected = ReprojectedDepth(null)
    matrix, _ = reprojected.aim(camera, size)
    with reprojected.render_pass(null, camera.projection.depth):
        pass
    assert reprojected._resources is not None

    def land(matrix: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        clip = points @ matrix.T
        return (clip[:, :2] / clip[:, 3:] * (1.0, -1.0) + 1.0) * 0.5 * size

    pixels = land(camera.relative_view_projection, size)
    assert land(matrix, reprojected._resources.target.size) == pytest.approx(pixels / 4, rel=1e-4, abs=1e-4)
    reprojected.destroy()


@pytest.mark.parametrize("change", ["size", "direction", "first"])
def test_without_a_frame_before_everything_is_far(device: rhi.Device, change: str) -> None:
    depths = np.full(SIZE[::-1], 0.4, np.float32)
    if change == "size":
        assert (reproject(device, depths, look(), look(), size=(20, 20)) == 0.0).all()
    elif change == "direction":
        assert (reproject(device, depths, look(), look(depth=Depth.STANDARD)) == 1.0).all()
    else:
        reprojected = ReprojectedDepth(device)
        reprojected.aim(look(), SIZE)
        with reprojected.render_pass(device, Depth.REVERSED):
            pass
        assert reprojected._resources is not None
        assert (reprojected._resources.target.read() == 0.0).all()
        reprojected.destroy()


def test_far_from_the_worlds_origin_it_is_as_exact(device: rhi.Device) -> None:
    depths = np.full(SIZE[::-1], 0.05, np.float32)
    here, there = (reproject(device, depths, look(x=x), look(x=x + 0.25, z=-0.125)) for x in (0.0, 2.0**26))
    assert (here == there).all()
