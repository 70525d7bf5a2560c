"""Cameras: depth conventions, frustum planes, extreme values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from rhi.errors import ValidationError
from rhi.math import (
    Camera,
    Depth,
    FrustumPlane,
    Orthographic,
    Perspective,
    look_at,
    orbit,
    orthographic,
    perspective,
)


def clip_depth(projection, distance):
    clip = projection.matrix @ (0.0, 0.0, -distance, 1.0)
    return clip[2] / clip[3]


@pytest.mark.parametrize(
    "projection",
    [
        Perspective(near=0.5, far=80.0),
        Orthographic(height=4.0, near=-3.0, far=9.0),
        Perspective(near=1e-3, far=1e7),
    ],
)
def test_reversed_depth_is_one_at_near_and_zero_at_far(projection):
    assert clip_depth(projection, projection.near) == pytest.approx(1.0, abs=1e-12)
    assert clip_depth(projection, projection.far) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    "projection",
    [
        Perspective(near=0.5, far=80.0, depth=Depth.STANDARD),
        Orthographic(height=4.0, near=-3.0, far=9.0, depth=Depth.STANDARD),
    ],
)
def test_standard_depth_is_zero_at_near_and_one_at_far(projection):
    assert clip_depth(projection, projection.near) == pytest.approx(0.0, abs=1e-12)
    assert clip_depth(projection, projection.far) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("depth", list(Depth))
def test_an_infinite_far_plane_is_approached_and_has_no_plane(depth):
    projection = Perspective(near=0.25, depth=depth)
    assert clip_depth(projection, 0.25) == (1.0 if depth is Depth.REVERSED else 0.0)
    assert clip_depth(projection, 1e12) == pytest.approx(0.0 if depth is Depth.REVERSED else 1.0, abs=1e-11)
    assert len(Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection).frustum.planes) == 5
    far = Camera.look_at((0, 0, 0), (0, 0, -1), projection=Perspective(near=0.25, far=9.0, depth=depth))
    assert len(far.frustum.planes) == 6


def test_view_space_looks_along_minus_z_with_y_up():
    camera = Camera.look_at((10.0, 2.0, 3.0), (10.0, 2.0, -5.0))
    assert np.allclose(camera.view @ (10.0, 2.0, -5.0, 1.0), (0.0, 0.0, -8.0, 1.0))
    assert np.allclose(camera.view @ (11.0, 4.0, 3.0, 1.0), (1.0, 2.0, 0.0, 1.0))
    assert np.allclose(camera.forward, (0.0, 0.0, -1.0))


@pytest.mark.parametrize("target", [(0, 5, 0), (0, -5, 0), (1e-12, 5, 0)])
def test_looking_along_up_gives_a_rotation(target):
    rotation = Camera.look_at((0, 0, 0), target).rotation
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.linalg.det(rotation) == pytest.approx(1.0)


@st.composite
def views(draw):
    numbers = st.floats(-1e3, 1e3)
    eye = [draw(numbers) for _ in range(3)]
    forward = np.array([draw(st.floats(-1, 1)) for _ in range(3)])
    forward = forward if np.linalg.norm(forward) > 0.01 else np.array([1.0, 0.0, 0.0])
    depth = draw(st.sampled_from(list(Depth)))
    if draw(st.booleans()):
        far = draw(st.sampled_from([np.inf, 50.0]))
        projection = Perspective(draw(st.floats(0.1, 2.5)), draw(st.floats(0.3, 3.0)), 0.5, far, depth)
    else:
        projection = Orthographic(draw(st.floats(0.1, 50.0)), 1.5, -2.0, 40.0, depth)
    return Camera.look_at(eye, np.array(eye) + forward, projection=projection)


@given(camera=views(), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=80)
def test_frustum_planes_hold_exactly_the_points_in_clip_space(camera, seed):
    points = camera.position + np.random.default_rng(seed).normal(size=(200, 3)) * 30.0
    planes = camera.frustum.planes
    assert np.allclose(np.linalg.norm(planes[:, :3], axis=1), 1.0)
    distance = (points @ planes[:, :3].T + planes[:, 3]).min(1)
    clip = np.concatenate([points, np.ones((200, 1))], 1) @ camera.view_projection.T
    x, y, z, w = clip.T
    inside = (np.abs(x) <= w) & (np.abs(y) <= w) & (z >= 0.0) & (z <= w)
    clear = np.abs(distance) > 1e-6
    assert (inside == (distance >= 0.0))[clear].all()


def test_the_planes_come_in_the_order_of_their_names():
    projection = Perspective(fov=np.pi / 2, aspect=1.0, near=1.0, far=9.0)
    planes = Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection).frustum.planes
    r = np.sqrt(0.5)
    assert np.allclose(planes[FrustumPlane.LEFT], (r, 0, -r, 0))
    assert np.allclose(planes[FrustumPlane.RIGHT], (-r, 0, -r, 0))
    assert np.allclose(planes[FrustumPlane.BOTTOM], (0, r, -r, 0))
    assert np.allclose(planes[FrustumPlane.TOP], (0, -r, -r, 0))
    assert np.allclose(planes[FrustumPlane.NEAR], (0, 0, -1, -1))
    assert np.allclose(planes[FrustumPlane.FAR], (0, 0, 1, 9))


def test_a_frustum_far_from_the_origin_is_as_exact_as_near_it():
    eye = np.array([1e6, 0.0, 1e6])
    camera = Camera.look_at(eye, eye + np.eye(3)[0], projection=Perspective(near=0.1, far=100.0))
    at_origin = Camera.look_at((0, 0, 0), (1.0, 0.0, 0.0), projection=Perspective(near=0.1, far=100.0))
    moved = camera.frustum.planes
    assert np.allclose(moved[:, :3] @ eye + moved[:, 3], at_origin.frustum.planes[:, 3], atol=1e-8)
    assert np.array_equal(camera.relative_view_projection, at_origin.relative_view_projection)


def test_a_frustum_from_a_whole_matrix_equals_the_cameras():
    camera = Camera.look_at((3.0, 4.0, 5.0), (0.0, 1.0, 0.0), projection=Perspective(far=60.0))
    assert np.allclose(rhi.math.Frustum.from_matrix(camera.view_projection).planes, camera.frustum.planes)


def test_another_aspect_changes_the_width_only():
    camera = Camera.look_at((0, 0, 0), (0, 0, -1))
    wide = camera.with_aspect(2.0).projection.matrix
    narrow = camera.with_aspect(1.0).projection.matrix
    assert wide[0, 0] == pytest.approx(0.5 * narrow[0, 0])
    assert wide[1, 1] == narrow[1, 1]


@pytest.mark.parametrize(
    "make",
    [
        lambda: Perspective(fov=0.0),
        lambda: Perspective(fov=np.pi),
        lambda: Perspective(near=0.0),
        lambda: Perspective(near=1.0, far=1.0),
        lambda: Perspective(aspect=np.inf),
        lambda: Perspective(fov=np.nan),
        lambda: Orthographic(height=0.0),
        lambda: Orthographic(height=1.0, far=np.inf),
        lambda: Orthographic(height=1.0, near=2.0, far=2.0),
        lambda: Camera.look_at((0, 0, 0), (0, 0, 0)),
        lambda: Camera.look_at((0, np.nan, 0), (0, 0, 1)),
        lambda: Camera.look_at((0, 0, 0), (0, 0, 1), up=(0, 0, 0)),
    ],
)
def test_values_out_of_range_are_refused(make):
    with pytest.raises(ValidationError, match=r"^\[camera-bad-value\]"):
        make()


def test_values_at_the_edge_of_their_range_are_taken():
    Perspective(fov=3.14, near=1e-6, far=np.inf)
    Perspective(near=1.0, far=np.nextafter(1.0, 2.0))
    Orthographic(height=1e-6, near=0.0)


# -- the functions, against points in space whose images are known -------------------------------------------


@given(
    fov=st.floats(0.05, 3.0),
    aspect=st.floats(0.2, 5.0),
    near=st.floats(1e-3, 10.0),
    depth=st.sampled_from(list(Depth)),
)
@settings(max_examples=40)
def test_a_perspective_shows_the_corners_of_its_near_plane_in_those_of_the_image(fov, aspect, near, depth):
    y = near * np.tan(fov / 2)
    clip = perspective(fov, aspect, near, near * 50, depth) @ (aspect * y, -y, -near, 1.0)
    nearest, farthest = (1.0, 0.0) if depth is Depth.REVERSED else (0.0, 1.0)
    assert np.allclose(clip[:3] / clip[3], (1.0, -1.0, nearest), atol=1e-9)
    clip = perspective(fov, aspect, near, near * 50, depth) @ (0.0, 0.0, -near * 50, 1.0)
    assert np.allclose(clip[:3] / clip[3], (0.0, 0.0, farthest), atol=1e-9)


def test_pixels_of_a_plane_image_begin_in_its_top_left_corner():
    matrix = orthographic(0.0, 640.0, 480.0, 0.0)
    assert np.allclose(matrix @ (0.0, 0.0, 0.0, 1.0), (-1.0, 1.0, 0.5, 1.0))
    assert np.allclose(matrix @ (640.0, 480.0, 1.0, 1.0), (1.0, -1.0, 1.0, 1.0)), "+Z is nearer"
    assert np.allclose(orthographic(-2, 4, 1, 3, 0.5, 7, Depth.STANDARD) @ (4.0, 3.0, -7.0, 1.0), 1.0)


def test_a_projection_s_matrix_equals_that_of_its_function():
    assert np.array_equal(perspective(0.7, 1.5, 0.2, 90.0), Perspective(0.7, 1.5, 0.2, 90.0).matrix)
    assert np.array_equal(orthographic(-3, 3, -2, 2, 1.0, 9.0), Orthographic(4.0, 1.5, 1.0, 9.0).matrix)


@pytest.mark.parametrize("yaw", [0.0, 0.6, -2.5])
@pytest.mark.parametrize("pitch", [-np.pi / 2, -0.4, 0.0, 1.2, np.pi / 2])
def test_an_orbit_sees_its_target_ahead_from_the_side_of_its_angles(yaw, pitch):
    target = np.array((3.0, -1.0, 2.0))
    view = orbit(target, 5.0, yaw, pitch)
    assert np.allclose(view @ (*target, 1.0), (0.0, 0.0, -5.0, 1.0))
    eye = target + 5.0 * np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    assert np.allclose(view @ (*eye, 1.0), (0.0, 0.0, 0.0, 1.0))
    if abs(pitch) < 1.5:
        assert np.allclose(view, look_at(eye, target))


@pytest.mark.parametrize(
    "make",
    [
        lambda: perspective(np.pi, 1.0),
        lambda: perspective(1.0, 1.0, near=0.0),
        lambda: orthographic(1.0, 1.0, 0.0, 1.0),
        lambda: orthographic(0.0, np.inf, 0.0, 1.0),
        lambda: orthographic(0.0, 1.0, 0.0, 1.0, 2.0, 2.0),
        lambda: orbit((0, 0, 0), 0.0),
        lambda: look_at((1, 2, 3), (1, 2, 3)),
    ],
)
def test_functions_refuse_values_out_of_range(make):
    with pytest.raises(ValidationError, match=r"^\[camera-bad-value\]") as error:
        make()
    assert error.value.site.file == __file__


def test_degrees_are_recognised():
    with pytest.raises(ValidationError, match=r"np\.radians"):
        perspective(60.0, 1.0)


def test_the_module_is_there_without_an_import_of_its_own():
    assert rhi.math.perspective is perspective
    assert not hasattr(rhi, "maths")


@pytest.mark.parametrize(
    "name", ["right", "forward", "view", "view_projection", "relative_view_projection", "frustum"]
)
def test_matrices_and_vectors_of_a_camera_are_computed_once_and_read_only(name):
    camera = Camera.look_at((1.0, 2.0, 3.0), (4.0, 5.0, 7.0))
    value = getattr(camera, name)
    assert getattr(camera, name) is value
    with pytest.raises(ValueError, match="read-only"):
        getattr(value, "planes", value)[0] = 1.0


def test_matrices_that_functions_return_can_be_written_to():
    for matrix in (look_at((0, 0, 1), (0, 0, 0)), orbit((0, 0, 0), 1.0), perspective(1.0, 1.0)):
        matrix[0, 0] = 2.0


def test_the_same_aspect_gives_the_same_camera():
    camera = Camera.look_at((1.0, 2.0, 3.0), (4.0, 5.0, 7.0), projection=Perspective(aspect=1.5))
    assert camera.with_aspect(1.5) is camera
    assert camera.with_aspect(1.6) is not camera
