"""Occluders in depth on a device of their own: what they hide isn't drawn, and no pixel is lost.

The hard cases, which all algorithms share, are in `test_hard_cases`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from occlusion_scenes import (
    SIZE,
    WALL_POSITION,
    cameras,
    count_wrong_pixels,
    draw_with,
    make_boxes,
    make_camera,
    scenes,
    visible,
    walk,
)

import rhi
from renderer import visibility
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.visibility.gpu.occluder_depth import OccluderDepth
from renderer.visibility.software_depth import can_rasterise
from rhi import ValidationError

ORIGIN = (0.0, 0.0, 0.0)
FRONT = make_camera(ORIGIN, WALL_POSITION).with_aspect(SIZE[0] / SIZE[1])


@pytest.fixture(autouse=True)
def opencl() -> None:
    if not can_rasterise():
        pytest.skip("no OpenCL device here")


@pytest.fixture(scope="module")
def cl() -> Iterator[rhi.Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=8,detail=2")


def walled(*more: tuple[float, float, float], wall: float = 30.0) -> Scene:
    """Make a wall of a given width, and small boxes."""
    scene = make_boxes([WALL_POSITION, *more], [(wall, wall, 0.1)] + [(0.5, 0.5, 0.5)] * len(more))
    scene.objects.mesh[:] = 0
    return scene


def test_moving_objects_hide_where_they_are(device: rhi.Device) -> None:
    # Two walls that change places: the one that hides is the one in front now.
    scene = make_boxes(
        [(0.0, 0.0, -5.0), (0.0, 0.0, -9.0)], [(20.0, 20.0, 0.1), (4.0, 4.0, 0.1)],
        motion=lambda seconds: (0.0, 0.0, -8.0 * seconds), moving=(0,),
    )  # fmt: skip
    scene.objects.mesh[:] = 0
    algorithm = visibility.SoftwareDepth(scene)
    with Renderer(device, scene, size=SIZE) as renderer:
        drawn = [visible(draw_with(renderer, algorithm, FRONT, seconds)) for seconds in (0.0, 1.0, 0.0)]
    assert drawn == [{0}, {0, 1}, {0}]
    algorithm.destroy()


def test_objects_behind_a_wall_are_not_drawn_in_the_first_frame(device: rhi.Device) -> None:
    scene = walled(*((x, y, -9.0) for x in (-1, 0, 1) for y in (-1, 0, 1)), (0.0, 0.0, -3.0))
    algorithm = visibility.SoftwareDepth(scene)
    with Renderer(device, scene, size=SIZE) as renderer:
        assert visible(draw_with(renderer, algorithm, FRONT)) == {0, 10}
    algorithm.destroy()


def test_nothing_but_the_scenes_draw_reaches_the_renderers_device(null: rhi.Device) -> None:
    scene = walled((0.0, 0.0, -9.0), (0.0, 0.0, -3.0))
    streams = []
    for algorithm in (visibility.SoftwareDepth(scene), visibility.FrustumCulling(scene)):
        with Renderer(null, scene, size=SIZE) as renderer:
            draw_with(renderer, algorithm, FRONT)
            null.stream.clear()
            result = draw_with(renderer, algorithm, FRONT)
            streams.append([command.op for command in null.stream])
            if isinstance(algorithm, visibility.SoftwareDepth):
                assert visible(result) == {0, 2}
                assert result.statistics.queries == 0
        algorithm.destroy()
    assert streams[0] == streams[1]


@settings(max_examples=5)
@given(scenes(), st.lists(cameras(), min_size=1, max_size=3), st.integers(1, 8))
def test_whatever_occludes_no_pixel_is_lost(
    cl: rhi.Device, scene: Scene, eyes: list[Camera], occluders: int
) -> None:
    algorithm = visibility.SoftwareDepth(scene, None, visibility.VisibilitySettings(occluders=occluders))
    assert not any(count_wrong_pixels(cl, scene, algorithm, [(eye, 0.0) for eye in eyes]))
    algorithm.destroy()


@pytest.mark.parametrize(("pixels", "shows"), [(0.9, True), (2.1, False)])
def test_a_box_is_hidden_only_if_its_occluder_reaches_a_pixel_further(
    cl: rhi.Device, pixels: float, shows: bool
) -> None:
    # The wall ends at x = 0, between pixels; the box ends so many pixels before that, as the camera sees it.
    scene = make_boxes([(-10.0, 0.0, -5.0)], [(20.0, 40.0, 0.1)])
    camera = make_camera(ORIGIN, WALL_POSITION).with_aspect(2.0)
    depth = OccluderDepth(cl, scene, 1, 1)
    depth.render(camera, np.array([0]), (128, 64))
    metres = 9.9 * pixels * 2.0 / 128 / camera.projection.matrix[0, 0]
    centre, half = np.array([[-metres - 0.1, 0.0, -10.0]]), np.array([[0.1, 0.1, 0.1]])
    assert depth.test_boxes(centre, half).tolist() == [shows]
    depth.destroy()


@pytest.mark.parametrize(("texels", "shows"), [(8, False), (1, True)])
def test_a_box_compared_with_fewer_texels_shows_beside_the_edge_of_its_occluder(
    cl: rhi.Device, texels: int, shows: bool
) -> None:
    # Six pixels beyond a coarse texel's edge, the wall ends, and the box five pixels before that.
    scene = make_boxes([(-10.0, 0.0, -5.0)], [(20.0, 40.0, 0.1)])
    camera = make_camera(ORIGIN, WALL_POSITION).with_aspect(2.0)
    pixel = 2.0 / 128 / camera.projection.matrix[0, 0]  # in the width of a view at a metre
    camera = replace(camera, position=camera.position - np.array([4.95 * 6.0 * pixel, 0.0, 0.0]))
    depth = OccluderDepth(cl, scene, 1, 1, texels=texels)
    depth.render(camera, np.array([0]), (128, 64))
    centre = np.array([[9.9 * pixel - 0.1, 0.0, -10.0]])  # its end is one pixel right of the eye's middle
    assert depth.test_boxes(centre, np.full((1, 3), 0.1)).tolist() == [shows]
    depth.destroy()


@pytest.mark.parametrize(("pixels", "expected"), [(1, {0, 2, 3}), (8, {0, 2})])
def test_occluders_of_fewer_pixels_close_narrow_gaps(
    null: rhi.Device, pixels: int, expected: set[int]
) -> None:
    # The gap between the walls is one and a half pixels wide; those of a coarse image are 8 wide, and none is
    # in it.
    behind_the_eye, behind_the_gap = (0.0, 0.0, 9.0), (0.85, 0.0, -10.0)
    object_positions = [(-9.65, 0.0, -5.0), behind_the_eye, (10.5, 0.0, -5.0), behind_the_gap]
    scene = make_boxes(object_positions, [(20.0, 20.0, 0.02), (0.1,) * 3, (20.0, 20.0, 0.02), (0.5,) * 3])
    algorithm = visibility.SoftwareDepth(scene, None, visibility.VisibilitySettings(occluder_pixels=pixels))
    with Renderer(null, scene, size=SIZE) as renderer:
        assert visible(draw_with(renderer, algorithm, FRONT)) == expected
    algorithm.destroy()


@pytest.mark.parametrize(("distance", "shows"), [(4.9, True), (5.3, False)])
def test_a_box_in_front_of_the_wall_shows_and_one_behind_it_does_not(
    cl: rhi.Device, distance: float, shows: bool
) -> None:
    depth = OccluderDepth(cl, walled(), 1, 300)
    depth.render(FRONT, np.array([0]), SIZE)
    centre = np.tile([0.0, 0.0, -distance], (300, 1))
    assert depth.test_boxes(centre, np.full((300, 3), 0.1)).tolist() == [shows] * 300
    depth.render(FRONT, np.zeros(0, np.int64), SIZE)
    assert depth.test_boxes(centre, np.full((300, 3), 0.1)).all(), "nothing hides"
    assert depth.test_boxes(centre[:0], centre[:0]).tolist() == []
    depth.destroy()


def test_the_largest_occlude_near_first() -> None:
    scene = make_boxes(
        [(0.0, 0.0, -20.0), WALL_POSITION, (0.0, 0.0, -10.0), (1.0, 0.0, -4.0)],
        [(9.0,) * 3, (2.5,) * 3, (6.0,) * 3, (0.01,) * 3],
    )
    everything = np.arange(4)
    for occluders, expected in ((1, [2]), (2, [1, 2]), (4, [1, 2, 0])):
        algorithm = visibility.SoftwareDepth(scene, None, visibility.VisibilitySettings(occluders=occluders))
        assert algorithm.choose_occluders(FRONT, everything).tolist() == expected
        algorithm.destroy()


def test_simulated_objects_are_never_occluders() -> None:
    hall = load_scene("hall:columns=4,rows=2,flags=3,fountains=3")
    algorithm = visibility.SoftwareDepth(hall)
    sprays = np.concatenate([simulation.objects for simulation in hall.simulated])
    flags = hall.objects.dynamic_indices
    eye = hall.objects.lower[flags[0]]
    assert len(algorithm.choose_occluders(Camera.look_at(eye, eye + 1.0), flags)) == 0
    eye = hall.objects.lower[sprays[0]]
    assert len(algorithm.choose_occluders(Camera.look_at(eye, eye + 1.0), sprays)) == 0
    assert len(algorithm.choose_occluders(Camera.look_at(eye, eye + 1.0), np.arange(len(hall.objects)))) > 0
    algorithm.destroy()


def test_software_depth_gives_the_same_draws_to_a_device_that_draws_nothing(
    device: rhi.Device, null: rhi.Device, city: Scene
) -> None:
    algorithm, drawn = visibility.SoftwareDepth(city), []
    for each_device in (device, null):
        assert "software_depth" in visibility.list_algorithms(each_device)
        with Renderer(each_device, city, size=SIZE) as renderer:
            shots = walk(city, "ground", range(600, 640, 8))
            drawn.append([draw_with(renderer, algorithm, camera).visible.tolist() for camera, _ in shots])
    assert drawn[0] == drawn[1]
    algorithm.destroy()


def test_without_a_renderers_pass_it_refuses(null: rhi.Device) -> None:
    algorithm = visibility.make_visibility("software_depth", walled(), null)
    with pytest.raises(ValidationError, match=r"^\[visibility-no-renderer\]"):
        visibility.list_visible_objects(algorithm, FRONT)
    algorithm.destroy()


def test_on_a_walk_most_hidden_objects_are_not_drawn(cl: rhi.Device, city: Scene) -> None:
    algorithm, frustum, none = (
        visibility.SoftwareDepth(city),
        visibility.FrustumCulling(city),
        visibility.NoCulling(city),
    )
    counts = []
    with Renderer(cl, city, size=(320, 180)) as renderer:
        for camera, _ in walk(city, "ground", range(300, 320, 5)):
            counts.append(
                [len(draw_with(renderer, culling, camera).visible) for culling in (algorithm, frustum, none)]
            )
    total = np.sum(counts, axis=0)
    assert total[0] < 0.6 * total[1] < 0.6 * total[2]
    algorithm.destroy()
