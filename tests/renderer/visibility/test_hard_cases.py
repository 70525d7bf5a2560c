"""The hard cases of visibility, beyond what the exam measures: its images show something, random scenes look
as without culling, and on a null device that is so many commands late, what is seen is drawn.

On the null device, where an oracle says what shows, the algorithms that ask the device, and those that run on
it, take the exam's images on a GPU whose answers come late, and `WALKS` with them, whose answers no scene
would give."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import cache

import numpy as np
import occlusion_scenes
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import (
    DEVICE,
    OCCLUSION,
    ORIGIN,
    WALL_POSITION,
    Oracle,
    UnculledFrames,
    draw_with,
    make_boxes,
    make_camera,
    visible,
)

import rhi
from renderer.lab.exam.scenes import CULLING_SCENARIOS
from renderer.lab.exam.visibility_cases import LATENCIES, NAMES
from renderer.lab.measure.exact_visibility import ExactVisibility
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene
from renderer.visibility import ChcPlusPlus, VisibilitySettings, list_algorithms, make_visibility
from renderer.visibility.boxes.bounds import near_radius
from rhi.backends.null import CostModel, Simulation

PROJECTION = Perspective(np.pi / 3, 16 / 9, near=0.1)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_the_images_are_not_empty(drawing_device: rhi.Device) -> None:
    # The control: in every image some frame shows something, and losing it is seen.
    class Nothing:
        opens_pass = False

        def render(self, camera: Camera, scene_drawer: object) -> None:
            return None

    for title, image in CULLING_SCENARIOS.items():
        scene = image.scene()
        with UnculledFrames(drawing_device, scene, image.shots(scene), image.size) as uncut:
            assert sum(uncut.count_wrong_pixels(Nothing())) > 0, title


@settings(max_examples=4)
@given(
    occlusion_scenes.scenes(),
    st.lists(occlusion_scenes.cameras(), min_size=2, max_size=4),
    st.integers(1, 6),
    st.integers(1, 4),
)
def test_random_scenes_from_random_positions_look_as_without_culling(
    drawing_device: rhi.Device, scene: Scene, eyes: list[Camera], batch: int, persistence: int
) -> None:
    shots = [(camera, 0.0) for camera in (*eyes, eyes[-1], eyes[0])]
    algorithms = {
        name: make_visibility(name, scene, drawing_device)
        for name in list_algorithms(drawing_device)
        if name in NAMES
    }
    algorithms["small"] = ChcPlusPlus(
        scene, drawing_device, VisibilitySettings(batch=batch, persistence=persistence)
    )
    for name, algorithm in algorithms.items():
        assert occlusion_scenes.count_wrong_pixels(drawing_device, scene, algorithm, shots) == [0] * len(
            shots
        ), name
        algorithm.destroy()


# On the null device: what shows is drawn, however late the answers


def make_late(latency: int) -> rhi.Device:
    """Create a simulated GPU whose clock advances by one for each call; results are available `latency` calls
    later."""
    free = CostModel(command=0.0, vertex=0.0, pixel=0.0, byte=0.0, state_change=0.0, invocation=0.0)
    simulation = Simulation(free, call=1, submission_latency=latency, wake_latency=0, batch=1)
    return rhi.create_device("null", simulation=simulation)


def interleave(*lists: Iterable[object]) -> list[object]:
    """All combinations with all latencies; of each but one is taken in the default run, another one than of
    its neighbours."""
    turns = len(LATENCIES)
    return [
        pytest.param(
            *case, latency, marks=() if (number + number // turns) % turns == turn else pytest.mark.nightly
        )
        for number, case in enumerate(itertools.product(*lists))
        for turn, latency in enumerate(LATENCIES)
    ]


@pytest.mark.nightly_cases("*-1", "*-20", reason=FEWER_CASES)
@pytest.mark.parametrize(("title", "latency"), interleave(CULLING_SCENARIOS))
def test_on_a_late_gpu_a_hard_case_draws_all_visible_objects(title: str, latency: int) -> None:
    case = CULLING_SCENARIOS[title]
    scene = case.scene()
    shots = case.shots(scene)
    with rhi.create_device() as device:
        if not device.capabilities.renders:
            pytest.skip("no device here that draws")
        exact = ExactVisibility(device, scene, case.size)
        visible_objects = [exact.visible_objects(camera) for camera, _ in shots]
    for name in (*OCCLUSION, *DEVICE):
        with make_late(latency) as device, Renderer(device, scene, size=case.size) as renderer:
            oracle = Oracle(device, scene, name)
            algorithm = make_visibility(name, scene, device)
            for (camera, seconds), rows in zip(shots, visible_objects, strict=True):
                oracle.guessed, oracle.visible_objects = oracle.visible_objects, rows
                assert visible(draw_with(renderer, algorithm, camera, seconds)) >= rows, name


WALKS = {
    "teleports": (4, [(30.0, range(40)), (-30.0, range(10)), (30.0, (7,)), (-30.0, ()), (30.0, range(30, 40))]),
    "all visible, all hidden": (7, [(30.0, range(40)), (30.0, ()), (30.0, range(40)), (30.0, ())]),
    "one at a time": (11, [(30.0, (row,)) for row in range(0, 40, 5)]),
    "all new each frame": (5, [(30.0, range(row, 40, 4)) for row in (0, 1, 2, 3)]),
}  # fmt: skip


@pytest.mark.parametrize(("name", "title", "latency"), interleave([*OCCLUSION, *DEVICE], WALKS))
def test_visible_objects_are_drawn_however_late_query_results_arrive(
    name: str, title: str, latency: int
) -> None:
    scene = _cloud()
    with make_late(latency) as device:
        oracle = Oracle(device, scene, name, guessed=set(range(0, 40, 3)))
        algorithm = make_visibility(name, scene, device)
        with Renderer(device, scene, size=(64, 36)) as renderer:
            for z, visible_objects in WALKS[title][1]:
                camera = make_camera((0.0, 0.0, z), ORIGIN, near=0.1)
                oracle.visible_objects = set(visible_objects)
                for _ in range(3):
                    assert visible(draw_with(renderer, algorithm, camera)) >= oracle.visible_objects


@pytest.mark.parametrize(("name", "ulps", "latency"), interleave([*OCCLUSION, *DEVICE], [-1, 0, 1]))
def test_an_object_that_the_near_plane_may_cut_is_drawn_whatever_its_query_counts(
    name: str, ulps: int, latency: int
) -> None:
    radius = near_radius(
        make_camera(ORIGIN, WALL_POSITION, fov=PROJECTION.fov, near=0.1).with_aspect(64 / 36)
    )
    inside = radius * (1.0 + ulps * 2.0**-52) - 1e-3  # padding pulls the near one of two over the radius
    scene = make_boxes([(0.0, 0.0, -inside - 0.5), (0.0, 0.0, -9.0)], [(1.0, 1.0, 1.0)] * 2)
    with make_late(latency) as device:
        Oracle(device, scene, name)  # sees nothing
        with Renderer(device, scene, size=(64, 36)) as renderer:
            camera = make_camera(ORIGIN, WALL_POSITION, fov=PROJECTION.fov, near=0.1)
            algorithm = make_visibility(name, scene, device)
            assert all(0 in visible(draw_with(renderer, algorithm, camera)) for _ in range(3))


@cache
def _cloud() -> Scene:
    rng = np.random.default_rng(5)
    return make_boxes(rng.uniform(-6.0, 6.0, (40, 3)), rng.uniform(0.1, 0.8, (40, 3)))
