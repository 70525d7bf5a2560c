"""Culling on the device (`depth_pyramid`, `two_pass`): the images are those of no culling, to the last pixel.

The hard cases, which all algorithms share, are in `test_hard_cases`."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import occlusion_scenes
import pytest
from frames import list_owned
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES
from occlusion_scenes import DEVICE, ORIGIN, SIZE, Oracle, draw_with, make_boxes, make_camera, visible, walk

import rhi
from renderer import visibility
from renderer.content import BUILT_IN, load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene, SceneBuilder, translation
from renderer.visibility.gpu.depth_pyramid import prepare_depth_pyramid
from rhi import Op, ValidationError
from rhi.backends.null import Activity, Lane, SimulatedBackend, Simulation

STANDARD = Perspective(near=0.2, far=2000.0, depth=Depth.STANDARD)


def make(name: str, scene: Scene, device: rhi.Device) -> visibility.DeviceCulling:
    algorithm = visibility.make_visibility(name, scene, device)
    assert isinstance(algorithm, visibility.DeviceCulling)
    return algorithm


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=8,detail=2")


@cache
def whole_city() -> Scene:
    return load_scene("city")


@pytest.mark.nightly_cases("*-sky-3", reason=FEWER_CASES)
@pytest.mark.slow
@pytest.mark.parametrize("frames", [3, pytest.param(10, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("path", ["ground", "sky"])
@pytest.mark.parametrize("name", DEVICE)
def test_a_walk_through_the_whole_city_loses_no_depth(
    gl: rhi.Device, name: str, path: str, frames: int
) -> None:
    # Its pixels of exactly equal depth show the surface drawn first, so it is the depth that is compared.
    whole = whole_city()
    algorithm, none = make(name, whole, gl), visibility.NoCulling(whole)
    with Renderer(gl, whole, size=(480, 270)) as renderer:
        for frame in range(640, 640 + 2 * frames, 2):
            camera = whole.paths[path].camera(frame)
            expected = draw_with(renderer, none, camera).depth.read()
            assert (draw_with(renderer, algorithm, camera).depth.read() == expected).all()


@pytest.mark.parametrize("name", DEVICE)
def test_an_image_of_another_size_leaves_no_trace(device: rhi.Device, city: Scene, name: str) -> None:
    algorithm, none = make(name, city, device), visibility.NoCulling(city)
    with Renderer(device, city, size=(64, 36)) as renderer:
        for size in ((64, 36), (97, 55), (33, 70), (64, 36)):
            renderer.size = size
            for camera, seconds in walk(city, "ground", range(600, 604, 2)):
                expected = draw_with(renderer, none, camera, seconds).image.read()
                assert (draw_with(renderer, algorithm, camera, seconds).image.read() == expected).all()


@settings(max_examples=5)
@given(occlusion_scenes.scenes(), occlusion_scenes.cameras(), st.integers(0, 2**32 - 1))
def test_random_walks_among_random_boxes_look_as_without_culling(
    device: rhi.Device, scene: Scene, eye: Camera, seed: int
) -> None:
    # Steps as small as a frame's: the last frame's depth is worth something.
    rng, shots = np.random.default_rng(seed), []
    position, aim, step = eye.position, eye.position + 5.0 * eye.forward, rng.normal(0.0, 0.2, (2, 3))
    for _ in range(6):
        shots.append((Camera.look_at(position, aim, projection=eye.projection), 0.0))
        position, aim = position + step[0], aim + step[1]
    with occlusion_scenes.UnculledFrames(device, scene, shots) as uncut:
        assert [uncut.try_algorithm(name) for name in DEVICE] == [[0] * 6] * 2


@pytest.mark.parametrize("name", DEVICE)
def test_objects_behind_a_wall_are_not_drawn(device: rhi.Device, name: str) -> None:
    object_positions = [
        occlusion_scenes.WALL_POSITION,
        *((x, y, -9.0) for x in (-1, 0, 1) for y in (-1, 0, 1)),
        (0.0, 0.0, 9.0),
    ]
    scene = make_boxes(object_positions, [(30.0, 30.0, 0.1)] + [(0.5, 0.5, 0.5)] * 10)
    algorithm = make(name, scene, device)
    with Renderer(device, scene, size=SIZE) as renderer:
        drawn = [
            visible(
                draw_with(renderer, algorithm, make_camera((0.0, 0.0, 0.0), occlusion_scenes.WALL_POSITION))
            )
            for _ in range(3)
        ]
    assert drawn[2] == {0}
    assert drawn[0] > {0}, "at first nothing is known"
    assert 10 not in drawn[0], "behind the eye"


@pytest.mark.parametrize("name", DEVICE)
def test_a_visible_object_that_the_first_list_misses_is_on_the_second(device: rhi.Device, name: str) -> None:
    near, far = (0.0, 0.0, -5.0), (0.0, 0.0, -9.0)
    scene = make_boxes([near, far], [(30.0, 30.0, 0.1), (0.5, 0.5, 0.5)])
    algorithm = make(name, scene, device)
    behind = make_camera((0.0, 0.0, -20.0), far)
    with Renderer(device, scene, size=SIZE) as renderer:
        for _ in range(3):
            draw_with(renderer, algorithm, make_camera((0.0, 0.0, 0.0), near)).visible  # noqa: B018
        assert algorithm.second.read_object_indices().tolist() == []
        assert visible(draw_with(renderer, algorithm, behind)) == {0, 1}
        lists = [drawn.read_object_indices().tolist() for drawn in (algorithm.first, algorithm.second)]
    assert 1 in lists[1]
    assert sorted(lists[0] + lists[1]) == [0, 1]


@pytest.mark.parametrize("name", DEVICE)
def test_the_commands_and_uploads_of_the_cpu_do_not_depend_on_the_number_of_objects(
    null: rhi.Device, name: str
) -> None:
    def commands(count: int) -> list[Op]:
        rng = np.random.default_rng(count)
        scene = make_boxes(rng.uniform(-8.0, 8.0, (count, 3)), rng.uniform(0.1, 2.0, (count, 3)))
        algorithm = make(name, scene, null)
        with Renderer(null, scene, size=SIZE) as renderer:
            for eye in (5.0, 6.0, 7.0):  # the first ones make programs
                null.stream.clear()
                null.reset_statistics()
                draw_with(renderer, algorithm, make_camera((0.0, 0.0, eye), (0.0, 0.0, 0.0)))
        uploads.append(null.statistics.upload_bytes)
        recorded = [command.op for command in null.stream]
        algorithm.destroy()  # else its resources end in whatever frame garbage is collected
        return recorded

    uploads: list[int] = []
    assert commands(10) == commands(3000)
    assert uploads[0] == uploads[1] < 2000


@settings(max_examples=8)
@given(st.lists(st.tuples(st.sets(st.integers(0, 59)), st.sets(st.integers(0, 59))), min_size=2, max_size=5))
def test_the_lists_follow_from_the_visible_and_the_guessed_objects(
    null: rhi.Device, frames: list[tuple[set[int], set[int]]]
) -> None:
    scene, camera = occlusion_scenes.make_cloud(), make_camera((0.0, 0.0, 30.0), ORIGIN, near=0.1)
    with Renderer(null, scene, size=(64, 36)) as renderer:
        for name in DEVICE:
            algorithm, oracle = make(name, scene, null), Oracle(null, scene, name)
            seen: set[int] = set()
            for now, guessed in frames:
                likely = guessed if name == "two_pass" else seen
                oracle.visible_objects, oracle.guessed = seen, _ = now, guessed
                drawn = visible(draw_with(renderer, algorithm, camera))
                first, second = (
                    set(draw_list.read_object_indices().tolist())
                    for draw_list in (algorithm.first, algorithm.second)
                )
                assert (first, second) == (likely, seen - likely), name
                assert drawn == likely | seen
            algorithm.destroy()


@pytest.mark.parametrize("name", DEVICE)
def test_the_gpu_draws_the_listed_objects_and_the_cpu_never_waits(name: str) -> None:
    simulation = Simulation(submission_latency=10**8)
    scene, camera = occlusion_scenes.make_cloud(), make_camera((0.0, 0.0, 30.0), ORIGIN, near=0.1)
    with rhi.create_device("null", simulation=simulation) as device, Renderer(device, scene) as renderer:
        gpu = device.backend_as(SimulatedBackend)
        oracle = Oracle(device, scene, name, guessed={1, 2}, visible_objects={2, 40, 59})
        algorithm = make(name, scene, device)
        draw_with(renderer, algorithm, camera)
        draw_with(renderer, algorithm, camera)
        assert gpu.timeline.total(Lane.CPU, Activity.STALLED) == 0
        assert oracle.executed == [], "the GPU is late"
        device.finish()
        lists = [
            sorted(draws.read_object_indices().tolist()) for draws in (algorithm.first, algorithm.second)
        ]
        assert lists == ([[1, 2], [40, 59]] if name == "two_pass" else [[2, 40, 59], []])
        instances = sorted([*range(len(lists[0])), *range(len(lists[1]))])
        assert sorted(oracle.executed[-len(instances) :]) == instances
        assert gpu.hazards == ()


@pytest.mark.parametrize("name", DEVICE)
def test_near_objects_are_drawn_first(null: rhi.Device, name: str) -> None:
    object_positions = [(0.0, 0.0, z) for z in (-10.0, 20.0, 14.0, 18.0, 6.0)]  # an octave apart
    builder = SceneBuilder("boxes")
    material = builder.add_material()
    for position in object_positions:  # each with a mesh of its own, and so with a draw
        node = builder.add_node(translation(position))
        builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), material)
    scene = builder.build()
    oracle = Oracle(null, scene, name, visible_objects=set(range(5)))
    with Renderer(null, scene, size=SIZE) as renderer:
        draw_with(renderer, make(name, scene, null), make_camera((0.0, 0.0, 22.0), ORIGIN, near=0.1))
        null.finish()
    assert oracle.executed == [1, 3, 2, 4, 0]


@pytest.mark.parametrize("name", DEVICE)
def test_a_pass_without_a_device_is_refused(null: rhi.Device, city: Scene, name: str) -> None:
    with pytest.raises(ValidationError, match=r"^\[visibility-no-renderer\]"):
        visibility.list_visible_objects(make(name, city, null), city.views["overview"])


@pytest.mark.parametrize("name", DEVICE)
def test_the_list_of_drawn_objects_is_readable_until_the_next_frame(
    device: rhi.Device, city: Scene, name: str
) -> None:
    algorithm, camera = make(name, city, device), city.paths["ground"].camera(700)
    with Renderer(device, city, size=SIZE) as renderer:
        first = draw_with(renderer, algorithm, camera)
        result = draw_with(renderer, algorithm, camera)
        rows = result.visible
        assert result.statistics.draws == len(rows) > 0
        assert result.statistics.triangles == city.count_triangles(rows)
        draw_with(renderer, algorithm, camera)
        assert result.visible is rows
        with pytest.raises(ValidationError, match=r"^\[visibility-stale-list\]"):
            first.statistics  # noqa: B018


@pytest.mark.parametrize("name", DEVICE)
def test_a_device_without_compute_is_refused(monkeypatch: pytest.MonkeyPatch, name: str, city: Scene) -> None:
    with rhi.create_device("null", profile="gl-3.3") as old:
        assert not old.capabilities.compute
        with pytest.raises(ValidationError, match=r"^\[visibility-no-compute\]"):
            make(name, city, old)


def test_devices_that_draw_and_compute_list_them(gl: rhi.Device, null: rhi.Device) -> None:
    assert set(DEVICE) <= set(visibility.list_algorithms(gl))
    assert not set(DEVICE) & set(visibility.list_algorithms(null))


@pytest.mark.parametrize("name", DEVICE)
def test_all_resources_are_released(null: rhi.Device, city: Scene, name: str) -> None:
    with Renderer(null, city, size=SIZE) as renderer:
        null.stream.clear()
        algorithm = make(name, city, null)
        for size in (SIZE, (40, 30)):
            renderer.size = size
            draw_with(renderer, algorithm, city.views["overview"])
        created, _ = list_owned(null)
        algorithm.destroy()
    assert len(created) > 8
    assert list_owned(null)[1] == []


@pytest.mark.parametrize("projection", [None, STANDARD])
def test_all_that_a_depth_pyramid_dispatches_is_prepared(
    null: rhi.Device, city: Scene, projection: Perspective | None
) -> None:
    """No program is created in the first frame that it culls."""
    camera = (
        city.views["overview"]
        if projection is None
        else replace(city.views["overview"], projection=projection)
    )
    with Renderer(null, city, size=SIZE) as renderer:
        draw_with(renderer, visibility.FrustumCulling(city), camera)
        prepare_depth_pyramid(city, null, camera.projection.depth)
        null.stream.clear()
        draw_with(renderer, make("depth_pyramid", city, null), camera)
    ops = [command.op for command in null.stream]
    assert Op.CREATE_PROGRAM not in ops
    assert ops.count(Op.DISPATCH) > 7


@pytest.mark.parametrize("name", DEVICE)
def test_without_a_counted_indirect_draw_the_others_are_of_no_instance(
    gl: rhi.Device, city: Scene, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gl._core, "capabilities", replace(gl.capabilities, indirect_count=False))
    shots = walk(city, "ground", range(600, 612, 4))
    algorithm = make(name, city, gl)
    assert occlusion_scenes.count_wrong_pixels(gl, city, algorithm, shots) == [0] * 3
    for drawn in (algorithm.first, algorithm.second):
        assert drawn.draws.read()["instances"].sum() == len(drawn.read_object_indices())


@pytest.mark.parametrize("name", DEVICE)
def test_it_can_be_a_candidate_of_auto(device: rhi.Device, city: Scene, name: str) -> None:
    factories = {"frustum": lambda: visibility.FrustumCulling(city), name: lambda: make(name, city, device)}
    auto = visibility.AutoCulling(city, device, factories, frames=3, idle=1)
    assert (
        occlusion_scenes.count_wrong_pixels(device, city, auto, walk(city, "ground", range(600, 616, 2)))
        == [0] * 8
    )


@pytest.mark.parametrize("name", DEVICE)
def test_a_frame_that_was_broken_off_does_not_disturb_the_next(
    device: rhi.Device, city: Scene, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    algorithm, (shot, *shots) = make(name, city, device), walk(city, "ground", range(600, 612, 4))

    def fail(*_: object) -> None:
        raise RuntimeError("no")

    with Renderer(device, city, size=SIZE) as renderer, monkeypatch.context() as broken:
        broken.setattr(algorithm.second, "list_draws", fail)
        with pytest.raises(RuntimeError):
            draw_with(renderer, algorithm, shot[0])
    assert occlusion_scenes.count_wrong_pixels(device, city, algorithm, shots) == [0] * 2
