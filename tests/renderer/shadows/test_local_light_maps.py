"""The maps of point and spot lights: their cameras, their widths, and the shadows that casters may throw."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from renderer.light_kinds import point, spot
from renderer.lights.object_lists import list_lights
from renderer.scene import Camera, Lights
from renderer.shadows import local_light_maps

DIRECTIONS = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: float(np.linalg.norm(v)) > 0.1)


def make_spot(outer: float, direction: tuple[float, float, float] = (0, -1, 0)) -> object:
    lights = Lights()
    lights.add_spot((1, 2, 3), direction, 10.0, 0.5 * outer, outer)
    return lights.spot[0]


@given(DIRECTIONS, DIRECTIONS)
def test_quaternions_turn_as_their_matrices(direction: tuple[float, ...], vector: tuple[float, ...]) -> None:
    axes, v = Camera.look_at((0, 0, 0), direction).rotation, np.array(vector)
    *xyz, w = local_light_maps.quaternion_from_axes(axes)
    turned = v + 2 * np.cross(xyz, np.cross(xyz, v) + w * v)
    assert np.allclose(turned, axes @ v, atol=1e-12)


@pytest.mark.parametrize("face", range(6))
def test_quaternions_of_cube_faces_are_of_length_1(face: int) -> None:
    assert np.linalg.norm(
        local_light_maps.quaternion_from_axes(local_light_maps.FACES[face])
    ) == pytest.approx(1.0)


@given(DIRECTIONS)
def test_each_direction_is_in_the_middle_of_one_face(direction: tuple[float, ...]) -> None:
    v = np.array(direction)
    axis = int(np.abs(v).argmax())
    x, y, z = local_light_maps.FACES[2 * axis + (v[axis] < 0)] @ v
    assert -z >= abs(x) - 1e-12
    assert -z >= abs(y) - 1e-12


@pytest.mark.parametrize(
    ("outer", "count"), [(0.0017, 1), (0.5, 1), (np.pi / 3, 1), (1.06, 6), (2.0, 6), (np.pi, 6)]
)
def test_wide_spot_lights_have_the_faces_of_a_cube(outer: float, count: int) -> None:
    light = make_spot(outer)
    assert local_light_maps.is_cube(spot.KIND, light) == (count == 6)
    assert len(local_light_maps.map_cameras(spot.KIND, light, 64)) == count


@pytest.mark.parametrize("size", [1, 2, 4, 16, 512])
@pytest.mark.parametrize("outer", [0.0017, 0.5, np.pi / 3])
def test_a_map_holds_the_cone_of_its_light_and_a_border(outer: float, size: int) -> None:
    light = make_spot(outer, (0.3, -0.8, 0.1))
    (camera,) = local_light_maps.map_cameras(spot.KIND, light, size)
    around = np.linspace(0, 2 * np.pi, 40)
    rim = np.stack([np.tan(outer) * np.cos(around), np.tan(outer) * np.sin(around), -np.ones(40)], 1)
    clip = camera.projection.matrix @ np.concatenate([rim, np.ones((40, 1))], 1).T
    texels = np.abs(clip[:2] / clip[3]).max() * size / 2
    assert texels <= size / 2 - min(3, (size - 1) // 4) + 1e-9
    assert texels == pytest.approx(
        np.tan(outer) * local_light_maps.texels_per_tangent(spot.KIND, light, size)
    )


def test_a_light_that_lights_more_of_the_screen_has_wider_maps() -> None:
    lights = Lights()
    lights.add_points([(0, 0, -5), (0, 0, -50), (0, 0, 100)], 2.0)
    near, far, behind = local_light_maps.compute_map_widths(
        point.KIND, [Camera.look_at((0, 0, 0), (0, 0, -1))], (960, 540), lights.point
    )
    assert near > 8 * far > 0.0
    assert behind < 2.0


def test_a_map_keeps_its_width_near_the_limit() -> None:
    assert local_light_maps.choose_width(100.0, None, 16, 512) == 128
    assert local_light_maps.choose_width(140.0, 128, 16, 512) == 128
    assert local_light_maps.choose_width(170.0, 128, 16, 512) == 256
    assert local_light_maps.choose_width(60.0, 128, 16, 512) == 128
    assert local_light_maps.choose_width(50.0, 128, 16, 512) == 64
    assert local_light_maps.choose_width(1.0, None, 16, 512) == 16
    assert local_light_maps.choose_width(9000.0, None, 16, 512) == 512


def test_the_largest_maps_are_halved_until_all_have_room() -> None:
    widths, counts = {"a": 512, "b": 512, "c": 64}, {"a": 6, "b": 1, "c": 6}
    assert local_light_maps.shrink(widths, counts, 1 << 24, 16) == widths
    assert local_light_maps.shrink(widths, counts, 1 << 20, 16) == {"a": 256, "b": 256, "c": 64}
    room = 6 * 512**2 + 256**2 + 6 * 64**2
    assert local_light_maps.shrink(widths, counts, room, 16) == {
        "a": 512,
        "b": 256,
        "c": 64,
    }  # the last of the largest
    assert local_light_maps.shrink(widths, counts, room - 1, 16) == {"a": 256, "b": 256, "c": 64}
    assert local_light_maps.shrink(widths, counts, 1, 16) == {"a": 16, "b": 16, "c": 16}


@given(st.integers(0, 10_000))
def test_shadow_boxes_hold_the_shadows_within_reach(seed: int) -> None:
    random = np.random.default_rng(seed)
    lower = random.uniform(-4, 4, (1, 3))
    upper = lower + random.uniform(0, 3, (1, 3))
    light, reach = random.uniform(-4, 4, 3), 8.0
    low, high = local_light_maps.shadow_boxes(lower, upper, light[None], np.array([reach]))
    for inside in random.uniform(lower[0], upper[0], (20, 3)):
        behind = light + (inside - light) * random.uniform(1.0, 5.0)
        if np.linalg.norm(behind - light) < reach:
            assert (low[0] <= behind + 1e-9).all()
            assert (behind <= high[0] + 1e-9).all()


def test_boxes_are_listed_for_each_light() -> None:
    corners = np.array([(0.0, 0, 0), (5, 0, 0), (10, 0, 0)])
    lights = np.array([(0.5, 0, 0), (100, 0, 0), (7.0, 0, 0)])
    listed = local_light_maps.pair_by_light(
        *list_lights(corners, corners + 1, lights, np.array([1.0, 1.0, 4.0])), 3
    )
    assert [boxes.tolist() for boxes in listed] == [[0], [], [1, 2]]
