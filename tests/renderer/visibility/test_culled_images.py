"""Whatever culls, images are those without culling, to the last pixel: each scenario with each algorithm.

The hard cases, which the exam measures on every device, are in `renderer.lab.exam.scenes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from itertools import cycle

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import DEVICE, make_camera, mirrored_boxes, require_algorithm

import rhi
from renderer import visibility
from renderer.content import load_scene
from renderer.lab.exam.scenes import CullingScenario, Shots, UnculledFrames, along, make_city, walk
from renderer.lab.exam.visibility_cases import NAMES
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene

PAIRS = [*(("gl", name) for name in NAMES), *(("cl", name) for name in (*DEVICE, "software_depth"))]
STANDARD = Perspective(near=0.2, far=2000.0, depth=Depth.STANDARD)
CAMERA_PROJECTIONS = (
    Perspective(near=0.1),
    Perspective(fov=0.3),
    Orthographic(60.0, far=900.0),
    Perspective(fov=2.2, far=500.0),
)


def through(
    path: str, frames: Iterable[int], *projections: Perspective | Orthographic | None
) -> Callable[[Scene], Shots]:
    """Return a function that finds the cameras of these frames, with projections in turn; None is the path's
    own."""
    return lambda scene: [
        (camera.with_projection(projection) if projection else camera, seconds)
        for (camera, seconds), projection in zip(walk(scene, path, frames), cycle(projections), strict=False)
    ]


def around(_: Scene) -> Shots:
    eyes = [(12.0, 3.0, 4.0), (-9.0, -8.0, 2.0), (0.0, 0.0, 1.0)]
    return [(make_camera(eye, (0.0, 0.0, 0.0)), 0.0) for eye in eyes for _ in range(2)]


def hall(options: str, frames: range, per_second: int) -> CullingScenario:
    return CullingScenario(
        0,
        lambda: load_scene(f"hall:columns=8,rows=2,{options}"),
        lambda scene: [(scene.paths["ground"].camera(frame), frame / per_second) for frame in frames],
    )


PATHS = {
    "all along the ground": CullingScenario(0, make_city, along("ground", 0, 450, 900, 1350, 1799)),
    "all along the sky": CullingScenario(0, make_city, along("sky", 0, 450, 900, 1350, 1799)),
    "a walk": CullingScenario(0, make_city, along("ground", *range(600, 648, 4))),
    "a flight": CullingScenario(0, make_city, along("sky", *range(600, 648, 4))),
}
MOTIONS = {
    "what moves": hall("flags=12", range(300, 900, 60), 6),
    "what is simulated": hall("flags=2,fountains=4", range(300, 900, 100), 60),
}
PROJECTIONS = {
    "standard depth": CullingScenario(0, make_city, through("ground", range(700, 724, 4), STANDARD)),
    "depth that turns round": CullingScenario(
        0, make_city, through("ground", range(700, 724, 4), None, STANDARD)
    ),
    "another projection in each frame": CullingScenario(
        0, make_city, through("sky", range(700, 708), *CAMERA_PROJECTIONS)
    ),
}
TURNED = {
    "mirrored and skewed objects": CullingScenario(0, lambda: mirrored_boxes(two_sides=False), around),
    "backs of two sides, mirrored or not": CullingScenario(0, lambda: mirrored_boxes(two_sides=True), around),
}
SIZES = {
    f"{size} pixels, {'standard' if projection else 'reversed'} depth": CullingScenario(
        0, make_city, through("ground", range(600, 632, 8), projection), size
    )
    for size in ((1, 1), (2, 3), (63, 34), (257, 31))
    for projection in (None, STANDARD)
}
SCENARIOS = PATHS | MOTIONS | PROJECTIONS | TURNED | SIZES

NIGHTLY = {
    f"the whole city from the {path}": CullingScenario(
        0, lambda: load_scene("city"), along(path, *range(0, 1800, 75)), (160, 90)
    )
    for path in ("ground", "sky")
}


DEFAULT_RUN = [(PATHS, 2, 4), (MOTIONS, 2, 2), (PROJECTIONS, 3, 3), (TURNED, 1, 2), (SIZES, 2, 4)]
"""Scenarios, and of how many each algorithm has one in the default run, on gl and on cl: another than its
neighbours. So gl has each scenario with a third of the algorithms at least, and each algorithm with each size
and each depth. On cl, where only the device's part may differ, an algorithm has one scenario of each kind,
and two sizes."""


def parametrize_algorithms() -> list[object]:
    """All scenarios with all algorithms: those of the day, and the others nightly."""
    cases: list[object] = []
    for turn, (backend, name) in enumerate(PAIRS):
        for scenarios, *steps in DEFAULT_RUN:
            step = steps[backend == "cl"]
            for number, scenario_name in enumerate(scenarios):
                marks = () if (number + number // 2 + turn) % step == 0 else pytest.mark.nightly
                cases.append(pytest.param(backend, name, scenario_name, marks=marks))
        cases += [
            pytest.param(backend, name, scenario_name, marks=pytest.mark.nightly) for scenario_name in NIGHTLY
        ]
    return cases


@pytest.fixture(scope="module")
def uncut(device: rhi.Device) -> Iterator[Callable[[str], UnculledFrames]]:
    """The frames of a scenario without culling, drawn once for all algorithms of a device."""
    drawn: dict[str, UnculledFrames] = {}

    def draw(scenario_name: str) -> UnculledFrames:
        scenario = (SCENARIOS | NIGHTLY)[scenario_name]
        if scenario_name not in drawn:
            frames = UnculledFrames(device, scene := scenario.scene(), scenario.shots(scene), scenario.size)
            drawn[scenario_name] = opened.enter_context(frames)
        return drawn[scenario_name]

    with ExitStack() as opened:
        yield draw


@pytest.mark.nightly_cases(
    "cl-*-what is simulated",
    "cl-*-all along *",
    "cl-*-backs of two sides*",
    "cl-*standard depth",
    reason=ONLY_KERNELS,
)
@pytest.mark.nightly_cases(
    "gl-*-a flight",
    "gl-*-all along the sky",
    "gl-auto-*pixels*",
    "gl-chc-*pixels*",
    "gl-conditional-*pixels*",
    "gl-frustum-*pixels*",
    "gl-software_depth-*pixels*",
    "gl-stop_and_wait-*pixels*",
    "cl-software_depth-*pixels*",
    "gl-auto-*",
    "gl-chc_plus_plus-* pixels, standard depth",
    "gl-conditional-what moves",
    "gl-depth_pyramid-* pixels, standard depth",
    "gl-frustum-what moves",
    "gl-two_pass-* pixels, standard depth",
    "cl-two_pass-what moves",
    "cl-two_pass-mirrored*",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize(("device", "name", "scenario_name"), parametrize_algorithms(), indirect=["device"])
def test_it_looks_as_without_culling(
    device: rhi.Device, uncut: Callable[[str], UnculledFrames], name: str, scenario_name: str
) -> None:
    require_algorithm(device, name)
    expected = uncut(scenario_name)
    assert expected.try_algorithm(name) == [0] * len(expected.shots)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_compared_images_show_something(device: rhi.Device, uncut: Callable[[str], UnculledFrames]) -> None:
    blank = {
        scenario_name
        for scenario_name, scenario in SCENARIOS.items()
        if scenario.size > (2, 3)
        and not all(np.ptp(frame[..., :3]) > 60 for frame in uncut(scenario_name).frames)
    }
    assert blank == set()


def test_a_lost_object_is_seen(gl: rhi.Device) -> None:
    # The control: one of the objects in view is left out.
    city = make_city()

    class LeaveOut:
        opens_pass = False

        def render(
            self, camera: Camera, scene_drawer: visibility.SceneDrawer
        ) -> visibility.VisibilityStatistics:
            all_but_first = visibility.CallbackDrawer(lambda rows: scene_drawer.draw(rows[1:]))
            return visibility.FrustumCulling(city).render(camera, all_but_first)

    with UnculledFrames(gl, city, [(city.views["overview"], 0.0)], (160, 90)) as uncut:
        assert uncut.count_wrong_pixels(visibility.FrustumCulling(city)) == [0]
        assert uncut.count_wrong_pixels(LeaveOut()) > [0]
