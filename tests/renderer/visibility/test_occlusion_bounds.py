"""Conservative box queries: padding, and objects too near for a query."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from occlusion_scenes import make_boxes

from renderer.content.shapes import box
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene, SceneBuilder, rotation
from renderer.visibility.boxes.bounds import (
    QueryBoxes,
    compute_query_boxes,
    near_mask,
    near_radius,
    pad_boxes,
    pad_rotated,
)
from renderer.visibility.boxes.volumes import TightestBoxes, compute_rotated_boxes

AHEAD = (0.0, 0.0, -1.0)


def look(projection: Perspective | Orthographic, eye: object = (0.0, 0.0, 0.0)) -> Camera:
    return Camera.look_at(eye, np.add(eye, AHEAD), projection=projection)


def is_near(camera: Camera, lower: object, upper: object) -> bool:
    low, high = np.array([lower], float), np.array([upper], float)
    return bool(near_mask(camera, low, high, np.zeros(1))[0])


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
def test_in_a_parallel_projection_boxes_cut_by_the_near_plane_are_near(depth: Depth) -> None:
    camera = look(Orthographic(10.0, near=2.0, depth=depth))
    assert is_near(camera, (3.0, 3.0, -5.0), (4.0, 4.0, -1.9))
    assert not is_near(camera, (3.0, 3.0, -5.0), (4.0, 4.0, -2.1))


def test_boxes_too_far_for_float32_are_drawn_without_a_query() -> None:
    camera = look(Perspective())
    lower, upper = (
        np.array([[-1.0, -1.0, -1.1 * z] for z in (1e16, 1e14)]),
        np.array([[1.0, 1.0, -z] for z in (1e16, 1e14)]),
    )
    assert near_mask(camera, *pad_boxes(camera, lower, upper)).tolist() == [True, False]


boxes = st.tuples(*[st.floats(-100.0, 100.0)] * 6)


@given(boxes, st.sampled_from([0.3, 1.0, 2.4]), st.sampled_from(Depth), st.booleans())
def test_a_padded_box_lies_inside_every_padded_box_around_it(
    corners: tuple[float, ...], fov: float, depth: Depth, parallel: bool
) -> None:
    projection = Orthographic(10.0, depth=depth) if parallel else Perspective(fov, depth=depth)
    camera = look(projection, (3.0, 4.0, 5.0))
    first = np.sort(np.array(corners).reshape(2, 3), axis=0)
    lower, upper = np.stack([first[0], first[0] - 1.0]), np.stack([first[1], first[1] + 2.0])
    low, high, _ = pad_boxes(camera, lower, upper)
    assert (low < lower).all()
    assert (high > upper).all()
    assert (low[1] <= low[0]).all()
    assert (high[1] >= high[0]).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 1000), (3, 2), (15, 15), (16, 9), (960, 540)], ids=str)
@pytest.mark.parametrize("parallel", [False, True])
def test_padding_is_a_subpixel_in_images_of_any_size(parallel: bool, size: tuple[int, int]) -> None:
    projection = Orthographic(20.0, near=0.0) if parallel else Perspective()
    camera = look(projection)
    point = np.array([[0.0, 0.0, -10.0]])
    _, upper, _ = pad_boxes(camera, point, point, size)
    clip = camera.view_projection @ [*(upper[0] * (1.0, 1.0, 0.0) + point[0] * (0.0, 0.0, 1.0)), 1.0]
    assert (0.5 * np.array(size) * clip[:2] / clip[3] > 0.999 / 256).all()
    usual = pad_boxes(camera, point, point)[1]
    assert (upper >= usual).all()
    assert (upper > usual).all() or min(size) > 8
    assert (upper == usual).all() or min(size) < 16


@pytest.mark.parametrize("parallel", [False, True])
def test_padding_is_at_least_a_subpixel_and_at_most_a_pixel(parallel: bool) -> None:
    projection = Orthographic(20.0, near=0.0) if parallel else Perspective()
    camera = look(projection)
    point = np.array([[0.0, 0.0, -10.0]])
    _, upper, _ = pad_boxes(camera, point, point)
    clip = camera.view_projection @ [*(upper[0] * (1.0, 1.0, 0.0) + point[0] * (0.0, 0.0, 1.0)), 1.0]
    across = 0.5 * np.array([960, 540]) * clip[:2] / clip[3]
    assert (across > 2 / 256).all()
    assert (across < 1.0).all()


TURN = rotation((0, 1, 0), np.pi / 4)


def beam(position: tuple[float, float, float]) -> Scene:
    """Make a long box across the axes, whose oriented box is much smaller than the aligned one."""
    return make_boxes([position], [(0.2, 0.2, 10.0)], rotations=TURN[None])


def test_only_boxes_that_are_smaller_turned_are_turned() -> None:
    object_positions, sizes = np.zeros((4, 3)), np.array([(1.0, 1.0, 4.0)] * 3 + [(1.0, 0.0, 4.0)])
    turns = np.stack([np.eye(4), TURN, rotation((0, 1, 0), np.pi / 2), TURN])
    scene = make_boxes(object_positions, sizes, rotations=turns)
    turned = compute_rotated_boxes(scene, np.arange(4))
    assert turned.object_indices.tolist() == [1, 3]  # not those along the axes; a flat one, too
    assert turned.half == pytest.approx(0.5 * sizes[[1, 3]], abs=1e-6)
    assert np.linalg.det(turned.axes) == pytest.approx([1.0, 1.0])


def test_a_sheared_object_keeps_its_aligned_box() -> None:
    shear = TURN.copy()
    shear[0, 1] = 0.3
    assert not len(
        compute_rotated_boxes(
            make_boxes([(0, 0, 0)], [(1.0, 1.0, 9.0)], rotations=shear[None]), np.arange(1)
        ).object_indices
    )


def test_a_mirrored_object_s_box_is_right_handed() -> None:
    scene = make_boxes([(0, 0, 0)], [(-0.2, 0.2, 9.0)], rotations=TURN[None])
    assert np.linalg.det(compute_rotated_boxes(scene, np.arange(1)).axes) == pytest.approx([1.0])


def test_boxes_of_a_turning_node_turn_with_it() -> None:
    builder = SceneBuilder("turning")
    node = builder.add_node(dynamic=True)
    builder.add_objects(node, builder.add_mesh(box()), builder.add_material())
    builder.animate(node, lambda seconds: rotation((0, 1, 0), np.array([seconds])))
    scene = builder.build()
    tightest = TightestBoxes(scene)
    assert len(tightest.collect().object_indices) == 0
    scene.update(0.7)
    assert tightest.collect().axes[0] == pytest.approx(rotation((0, 1, 0), 0.7)[:3, :3].T)
    scene.update(0.0)
    assert len(tightest.collect().object_indices) == 0


def see(scene: Scene, camera: Camera) -> QueryBoxes:
    turned = compute_rotated_boxes(scene, np.arange(len(scene.objects)))
    return compute_query_boxes(
        camera, scene.objects.lower, scene.objects.upper, turned, turned.object_indices
    )


def test_a_turned_box_holds_every_corner_of_its_object_and_is_smaller() -> None:
    scene = beam((1.0, 2.0, -20.0))
    boxes = see(scene, look(Perspective()))
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * (0.2, 0.2, 10.0) @ TURN[:3, :3].T
    axes = np.stack([boxes.x[0], boxes.y[0], np.cross(boxes.x[0], boxes.y[0])])
    away = np.abs((corners + np.array([1.0, 2.0, -20.0]) - boxes.centre[0]) @ axes.T)
    assert (away < boxes.half[0]).all()
    assert boxes.half.prod() < 0.05 * (0.5 * (scene.objects.upper - scene.objects.lower)).prod()


@pytest.mark.parametrize("projection", [Perspective(near=0.1), Orthographic(10.0, near=0.1)])
def test_a_turned_box_is_near_where_the_near_plane_may_cut_it(projection: object) -> None:
    camera = look(projection)
    assert see(beam((-3.5, 0.0, -3.5)), camera).near.tolist() == [True]  # one end is at the eye
    away = see(beam((-4.5, 0.0, -4.5)), camera)
    assert away.near.tolist() == [False]
    assert away.x[0] != pytest.approx((1.0, 0.0, 0.0))


def test_an_eye_in_the_aligned_box_and_not_in_the_turned_one_asks_for_that() -> None:
    beside = see(beam((3.4, 0.0, -3.4)), look(Perspective(near=0.1)))
    assert beside.near.tolist() == [False]
    assert beside.x[0] != pytest.approx((1.0, 0.0, 0.0))


def test_the_aligned_box_is_queried_where_only_the_turned_box_is_near() -> None:
    # The box of a turned ball has corners that the ball's aligned bounds lack, if its mesh's are the tighter
    # ones.
    scene = make_boxes([(0.0, 0.0, 0.0)], [(2.0, 2.0, 2.0)], rotations=TURN[None])
    lower, upper = np.full((1, 3), -1.0), np.full((1, 3), 1.0)
    camera = look(Perspective(near=0.01), (1.38, 0.0, 0.0))
    turned = compute_rotated_boxes(scene, np.arange(1))
    assert pad_rotated(camera, turned)[1].tolist() == [True]
    boxes = compute_query_boxes(camera, lower, upper, turned, turned.object_indices)
    assert boxes.near.tolist() == [False]
    assert boxes.x[0].tolist() == [1.0, 0.0, 0.0]
    assert boxes.half[0] == pytest.approx([1.0] * 3, abs=0.01)


def test_bounds_of_any_size_stay_finite_or_near() -> None:
    camera = look(Perspective())
    lower, upper = np.full((1, 3), -1e300), np.full((1, 3), 1e300)
    assert near_mask(camera, *pad_boxes(camera, lower, upper)).all()
