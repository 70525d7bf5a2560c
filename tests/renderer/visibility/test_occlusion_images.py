"""Every algorithm gives the image that is drawn without culling, to the last pixel."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from occlusion_scenes import OCCLUSION, cameras, draw_with, make_boxes, scenes

import rhi
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene, load_scene
from renderer.visibility import Chc, ChcPlusPlus, NoCulling, StopAndWait, VisibilityAlgorithm, make_visibility

Shots = list[tuple[Camera, float]]
SIZE = (97, 55)


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=8,detail=2")


def count_wrong_pixels(
    device: rhi.Device,
    scene: Scene,
    algorithm: VisibilityAlgorithm,
    shots: Shots,
    size: tuple[int, int] = SIZE,
) -> list[int]:
    """Of each frame, against no culling."""
    none = NoCulling(scene)
    wrong = []
    with Renderer(device, scene, size=size) as renderer:
        for camera, seconds in shots:
            expected = draw_with(renderer, none, camera, seconds).image.read()
            given = draw_with(renderer, algorithm, camera, seconds).image.read()
            wrong.append(int((given != expected).any(2).sum()))
    return wrong


def walk(scene: Scene, path: str, frames: range) -> Shots:
    return [(scene.paths[path].camera(frame), frame / 60) for frame in frames]


@pytest.mark.parametrize("path", ["ground", "sky"])
@pytest.mark.parametrize("name", [*OCCLUSION, "auto"])
def test_a_walk_through_the_city_looks_as_without_culling(
    gl: rhi.Device, city: Scene, name: str, path: str
) -> None:
    algorithm = make_visibility(name, city, gl)
    assert count_wrong_pixels(gl, city, algorithm, walk(city, path, range(600, 648, 4))) == [0] * 12


@pytest.mark.parametrize("name", OCCLUSION)
def test_teleports_leave_no_trace(gl: rhi.Device, city: Scene, name: str) -> None:
    shots = [
        (city.paths[path].camera(frame), 0.0)
        for frame in (0, 900, 1799)
        for path in ("ground", "sky", "ground")
    ]
    assert count_wrong_pixels(gl, city, make_visibility(name, city, gl), shots) == [0] * 9


@pytest.mark.parametrize("name", OCCLUSION)
def test_moving_objects_are_seen_where_they_are(gl: rhi.Device, name: str) -> None:
    hall = load_scene("hall:columns=8,rows=2,flags=12")
    shots = [(hall.paths["ground"].camera(frame), frame / 6) for frame in range(300, 900, 60)]
    assert count_wrong_pixels(gl, hall, make_visibility(name, hall, gl), shots) == [0] * 10


@pytest.mark.parametrize("name", OCCLUSION)
def test_standard_depth_hides_the_same(gl: rhi.Device, city: Scene, name: str) -> None:
    lens = Perspective(near=0.2, far=2000.0, depth=Depth.STANDARD)
    shots = [(camera.with_projection(lens), s) for camera, s in walk(city, "ground", range(700, 716, 4))]
    assert count_wrong_pixels(gl, city, make_visibility(name, city, gl), shots) == [0] * 4


@pytest.mark.parametrize("size", [(1, 1), (17, 9), (130, 67)])
@pytest.mark.parametrize("name", OCCLUSION)
def test_any_size_of_image_will_do(gl: rhi.Device, city: Scene, name: str, size: tuple[int, int]) -> None:
    shots = walk(city, "ground", range(600, 632, 8))
    assert count_wrong_pixels(gl, city, make_visibility(name, city, gl), shots, size) == [0] * 4


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(scenes(), st.lists(cameras(), min_size=2, max_size=5), st.integers(1, 6), st.integers(1, 4))
def test_random_scenes_from_random_places_look_as_without_culling(
    gl: rhi.Device, scene: Scene, eyes: list[Camera], batch: int, persistence: int
) -> None:
    shots = [(camera, 0.0) for camera in (*eyes, eyes[-1], eyes[0])]
    algorithms = [make_visibility(name, scene, gl) for name in OCCLUSION]
    algorithms.append(ChcPlusPlus(scene, gl, batch=batch, persistence=persistence))
    for algorithm in algorithms:
        assert count_wrong_pixels(gl, scene, algorithm, shots) == [0] * len(shots), algorithm


@pytest.mark.parametrize("persistence", [1, 20])
def test_how_long_visibility_persists_changes_no_pixel(gl: rhi.Device, city: Scene, persistence: int) -> None:
    algorithm = ChcPlusPlus(city, gl, persistence=persistence)
    assert count_wrong_pixels(gl, city, algorithm, walk(city, "ground", range(800, 824, 2))) == [0] * 12


def test_a_batch_larger_than_the_tree_is_asked_for_at_the_end(gl: rhi.Device, city: Scene) -> None:
    algorithm = ChcPlusPlus(city, gl, batch=100_000)
    assert count_wrong_pixels(gl, city, algorithm, walk(city, "ground", range(800, 812, 2))) == [0] * 6


@pytest.mark.parametrize("make", [StopAndWait, Chc, ChcPlusPlus])
def test_a_threshold_of_ten_samples_loses_few_pixels_and_zero_none(
    gl: rhi.Device, city: Scene, make: Callable[..., VisibilityAlgorithm]
) -> None:
    shots = walk(city, "ground", range(600, 624, 4))
    assert count_wrong_pixels(gl, city, make(city, gl, threshold=0), shots) == [0] * 6
    wrong = count_wrong_pixels(gl, city, make(city, gl, threshold=10), shots)
    assert sum(wrong) > 0
    assert max(wrong) < 0.1 * SIZE[0] * SIZE[1]


def look(eye: object, aim: object, **lens: float) -> Camera:
    return Camera.look_at(eye, aim, projection=Perspective(**lens))


WALL = (0.0, 0.0, -5.0)
HARD_CASES = {
    "a camera 1.5 near away from a corner": (
        make_boxes([(0.0, 0.0, 0.0), (0.0, 0.0, -6.0)], [(2.0, 2.0, 2.0), (1.0, 1.0, 1.0)]),
        look((1.0 + 0.1, 1.0 + 0.1, 1.0 + 0.05), (-2.0, -2.0, -1.0), near=0.1),
    ),
    "a camera inside a box": (
        make_boxes([(0.0, 0.0, 0.0), (0.0, 0.0, -0.5)], [(4.0, 4.0, 4.0), (0.5, 0.5, 0.5)]),
        look((0.0, 0.0, 1.0), (0.0, 0.0, -1.0), near=0.1),
    ),
    "boxes without thickness": (
        make_boxes(
            [WALL, (1.0, 0.0, -6.0), (0.0, 3.0, -5.5)],
            [(3.0, 3.0, 0.0), (3.0, 0.0, 3.0), (0.0, 3.0, 3.0)],
        ),
        look((0.0, 0.0, 0.0), WALL),
    ),
    "a box smaller than a pixel": (
        make_boxes([(0.01, 0.01, -30.0), (3.0, 0.0, -40.0)], [(0.3, 0.3, 0.3), (0.2, 9.0, 0.2)]),
        look((0.0, 0.0, 0.0), WALL),
    ),
    "a slit of a pixel": (
        make_boxes(
            [(-5.03, 0.0, -5.0), (5.03, 0.0, -5.0), (0.0, 0.0, -20.0)],
            [(10.0, 9.0, 1.0), (10.0, 9.0, 1.0), (6.0, 6.0, 6.0)],
        ),
        look((0.0, 0.0, 0.0), WALL),
    ),
    "everything hidden but a wall": (
        make_boxes(
            [WALL, *((x, y, -9.0) for x in (-1, 0, 1) for y in (-1, 0, 1))],
            [(30.0, 30.0, 0.1)] + [(0.5, 0.5, 0.5)] * 9,
        ),
        look((0.0, 0.0, 0.0), WALL),
    ),
    "nothing hidden": (
        make_boxes([(x, y, -9.0) for x in (-2, 0, 2) for y in (-2, 0, 2)], [(0.9, 0.9, 0.9)] * 9),
        look((0.0, 0.0, 0.0), WALL),
    ),
    "a corner beside the eye, where w is 0": (
        make_boxes([(2.0, 0.0, 0.0), (0.0, 0.0, -4.0)], [(2.0, 2.0, 0.0), (1.0, 1.0, 1.0)]),
        look((0.0, 0.0, 0.0), WALL, fov=2.2, near=0.1),
    ),
    "a box that reaches behind the eye, where w is negative": (
        make_boxes([(3.0, 0.0, 0.0), (2.5, 0.0, -6.0)], [(2.0, 2.0, 30.0), (3.0, 1.0, 1.0)]),
        look((0.0, 0.0, 0.0), WALL, fov=2.2, near=0.1),
    ),
    "an object far from the world's origin": (
        make_boxes([(1e6, 0.0, -1e6), (1e6 + 0.3, 0.0, -1e6 - 3.0)], [(1.0, 1.0, 1.0), (1.0, 1.0, 1.0)]),
        look((1e6, 0.0, 5.0 - 1e6), (1e6, 0.0, -1e6)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", HARD_CASES)
@pytest.mark.parametrize("name", OCCLUSION)
def test_a_hard_case_looks_as_without_culling(gl: rhi.Device, name: str, case: str) -> None:
    scene, camera = HARD_CASES[case]
    turned = Camera.look_at(camera.position, camera.position - camera.forward, projection=camera.projection)
    shots = [(one, 0.0) for one in (camera, camera, turned, camera, camera)]
    assert count_wrong_pixels(gl, scene, make_visibility(name, scene, gl), shots) == [0] * 5


@pytest.mark.parametrize("name", OCCLUSION)
def test_the_larger_of_two_faces_in_one_plane_is_not_lost(gl: rhi.Device, name: str) -> None:
    # Of one colour: which of the two shows where both are is up to the order of draws.
    scene = make_boxes([(0.0, 0.0, -5.0), (0.0, 0.0, -5.0)], [(1.0, 1.0, 1.0), (4.0, 0.5, 1.0)])
    scene.materials["base_color"] = 0.5
    scene.objects.mesh[:] = 0
    shots = [(look((0.0, 0.0, 0.0), WALL), 0.0)] * 4
    assert count_wrong_pixels(gl, scene, make_visibility(name, scene, gl), shots) == [0] * 4


@pytest.mark.slow
def test_where_two_surfaces_tie_the_depth_is_the_same(gl: rhi.Device) -> None:
    # One pixel of this frame shows another of two surfaces at exactly one depth; none shows another depth.
    whole = load_scene("city")
    algorithm, none = ChcPlusPlus(whole, gl), NoCulling(whole)
    with Renderer(gl, whole, size=(960, 540)) as renderer:
        for frame in range(640, 650):
            camera = whole.paths["sky"].camera(frame)
            expected = draw_with(renderer, none, camera).depth.read()
            assert (draw_with(renderer, algorithm, camera).depth.read() == expected).all()


def test_pixels_are_compared(gl: rhi.Device, city: Scene) -> None:
    # The control: an algorithm that loses what it should not is seen to.
    class Lossy:
        def render(self, camera, draw):
            draw(np.arange(len(city.objects) // 2))

    assert count_wrong_pixels(gl, city, Lossy(), walk(city, "sky", range(600, 601)))[0] > 0
