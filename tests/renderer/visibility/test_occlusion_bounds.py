"""What makes box queries conservative: padding, and what is too near to be asked for."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renderer.scene import Camera, Depth, Orthographic, Perspective
from renderer.visibility.bounds import find_near, near_radius, pad_boxes

AHEAD = (0.0, 0.0, -1.0)


def look(lens: Perspective | Orthographic, eye: object = (0.0, 0.0, 0.0)) -> Camera:
    return Camera.look_at(eye, np.add(eye, AHEAD), projection=lens)


def is_near(camera: Camera, lower: object, upper: object) -> bool:
    low, high = np.array([lower], float), np.array([upper], float)
    return bool(find_near(camera, low, high, np.zeros(1))[0])


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize(("degrees", "ratio"), [(60.0, 1.54), (90.0, 2.27), (120.0, 3.67)])
def test_the_near_plane_s_corners_are_farther_than_near(degrees: float, ratio: float, depth: Depth) -> None:
    camera = look(Perspective(np.radians(degrees), 16 / 9, near=0.2, depth=depth))
    assert near_radius(camera) == pytest.approx(0.2 * ratio, rel=0.005)


def test_a_box_is_near_up_to_the_radius_and_not_beyond() -> None:
    camera = look(Perspective(near=0.1))
    radius = near_radius(camera)
    assert is_near(camera, (-1.0, -1.0, -2.0), (1.0, 1.0, -radius))
    assert not is_near(camera, (-1.0, -1.0, -2.0), (1.0, 1.0, -radius * 1.001))


def test_a_box_around_the_eye_is_near() -> None:
    assert is_near(look(Perspective()), (-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))


@pytest.mark.parametrize("depth", Depth)
def test_in_a_parallel_projection_what_the_near_plane_cuts_is_near(depth: Depth) -> None:
    camera = look(Orthographic(10.0, near=2.0, depth=depth))
    assert is_near(camera, (3.0, 3.0, -5.0), (4.0, 4.0, -1.9))
    assert not is_near(camera, (3.0, 3.0, -5.0), (4.0, 4.0, -2.1))


def test_what_is_too_far_for_float32_is_drawn_without_a_query() -> None:
    camera = look(Perspective())
    lower, upper = (
        np.array([[-1.0, -1.0, -1.1 * z] for z in (1e16, 1e14)]),
        np.array([[1.0, 1.0, -z] for z in (1e16, 1e14)]),
    )
    assert find_near(camera, *pad_boxes(camera, lower, upper)).tolist() == [True, False]


boxes = st.tuples(*[st.floats(-100.0, 100.0)] * 6)


@given(boxes, st.sampled_from([0.3, 1.0, 2.4]), st.sampled_from(Depth), st.booleans())
def test_a_padded_box_lies_inside_every_padded_box_around_it(
    corners: tuple[float, ...], fov: float, depth: Depth, parallel: bool
) -> None:
    lens = Orthographic(10.0, depth=depth) if parallel else Perspective(fov, depth=depth)
    camera = look(lens, (3.0, 4.0, 5.0))
    first = np.sort(np.array(corners).reshape(2, 3), axis=0)
    lower, upper = np.stack([first[0], first[0] - 1.0]), np.stack([first[1], first[1] + 2.0])
    low, high, _ = pad_boxes(camera, lower, upper)
    assert (low < lower).all()
    assert (high > upper).all()
    assert (low[1] <= low[0]).all()
    assert (high[1] >= high[0]).all()


@pytest.mark.parametrize("parallel", [False, True])
def test_padding_is_at_least_a_subpixel_and_at_most_a_pixel(parallel: bool) -> None:
    lens = Orthographic(20.0, near=0.0) if parallel else Perspective()
    camera = look(lens)
    point = np.array([[0.0, 0.0, -10.0]])
    _, upper, _ = pad_boxes(camera, point, point)
    clip = camera.view_projection @ [*(upper[0] * (1.0, 1.0, 0.0) + point[0] * (0.0, 0.0, 1.0)), 1.0]
    across = 0.5 * np.array([960, 540]) * clip[:2] / clip[3]
    assert (across > 2 / 256).all()
    assert (across < 1.0).all()


def test_bounds_of_any_size_stay_finite_or_near() -> None:
    camera = look(Perspective())
    lower, upper = np.full((1, 3), -1e300), np.full((1, 3), 1e300)
    assert find_near(camera, *pad_boxes(camera, lower, upper)).all()
