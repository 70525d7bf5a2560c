"""Whatever culls, images are those without culling, to the last pixel: each situation with each algorithm.

The hard cases, which the exam measures on every device, are in `renderer.lab.exam.scenes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from itertools import cycle

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import DEVICE, look, mirrored_boxes, need_algorithm

import rhi
from renderer import visibility
from renderer.content import load_scene
from renderer.lab.exam.scenes import CullingImage, Shots, Uncut, along, make_city, walk
from renderer.lab.exam.visibility import NAMES
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene

PAIRS = [*(("gl", name) for name in NAMES), *(("cl", name) for name in (*DEVICE, "software_depth"))]
STANDARD = Perspective(near=0.2, far=2000.0, depth=Depth.STANDARD)
LENSES = (Perspective(near=0.1), Perspective(fov=0.3), Orthographic(60.0, far=900.0), Perspective(fov=2.2, far=500.0))


def through(path: str, frames: Iterable[int], *lenses: Perspective | Orthographic | None) -> Callable[[Scene], Shots]:
    """Return a function that finds the cameras of these frames, with lenses in turn; None is the path's own."""
    return lambda scene: [
        (camera.with_projection(lens) if lens else camera, seconds)
        for (camera, seconds), lens in zip(walk(scene, path, frames), cycle(lenses), strict=False)
    ]


def around(_: Scene) -> Shots:
    eyes = [(12.0, 3.0, 4.0), (-9.0, -8.0, 2.0), (0.0, 0.0, 1.0)]
    return [(look(eye, (0.0, 0.0, 0.0)), 0.0) for eye in eyes for _ in range(2)]


def hall(options: str, frames: range, per_second: int) -> CullingImage:
    return CullingImage(
        0, lambda: load_scene(f"hall:columns=8,rows=2,{options}"),
        lambda scene: [(scene.paths["ground"].camera(frame), frame / per_second) for frame in frames],
    )  # fmt: skip


PATHS = {
    "all along the ground": CullingImage(0, make_city, along("ground", 0, 450, 900, 1350, 1799)),
    "all along the sky": CullingImage(0, make_city, along("sky", 0, 450, 900, 1350, 1799)),
    "a walk": CullingImage(0, make_city, along("ground", *range(600, 648, 4))),
    "a flight": CullingImage(0, make_city, along("sky", *range(600, 648, 4))),
}
MOTIONS = {
    "what moves": hall("flags=12", range(300, 900, 60), 6),
    "what is simulated": hall("flags=2,fountains=4", range(300, 900, 100), 60),
}
PROJECTIONS = {
    "standard depth": CullingImage(0, make_city, through("ground", range(700, 724, 4), STANDARD)),
    "depth that turns round": CullingImage(0, make_city, through("ground", range(700, 724, 4), None, STANDARD)),
    "another lens in each frame": CullingImage(0, make_city, through("sky", range(700, 708), *LENSES)),
}
TURNED = {
    "mirrored and skewed objects": CullingImage(0, lambda: mirrored_boxes(two_sides=False), around),
    "backs of two sides, mirrored or not": CullingImage(0, lambda: mirrored_boxes(two_sides=True), around),
}
SIZES = {
    f"{size} pixels, {'standard' if lens else 'reversed'} depth": CullingImage(
        0, make_city, through("ground", range(600, 632, 8), lens), size
    )
    for size in ((1, 1), (2, 3), (63, 34), (257, 31)) for lens in (None, STANDARD)
}  # fmt: skip
SITUATIONS = PATHS | MOTIONS | PROJECTIONS | TURNED | SIZES

NIGHTLY = {
    f"the whole city from the {path}": CullingImage(
        0, lambda: load_scene("city"), along(path, *range(0, 1800, 75)), (160, 90)
    )
    for path in ("ground", "sky")
}


BY_DAY = [(PATHS, 2, 4), (MOTIONS, 2, 2), (PROJECTIONS, 3, 3), (TURNED, 1, 2), (SIZES, 2, 4)]
"""Situations, and of how many each algorithm has one by day, on gl and on cl: another than its neighbours. So gl has
each situation with a third of the algorithms at least, and each algorithm with each size and each depth. On cl, where
only the device's part may differ, an algorithm has one situation of each kind, and two sizes."""


def in_turns() -> list[object]:
    """All situations with all algorithms: those of the day, and the others nightly."""
    cases: list[object] = []
    for turn, (backend, name) in enumerate(PAIRS):
        for situations, *steps in BY_DAY:
            step = steps[backend == "cl"]
            for number, situation in enumerate(situations):
                marks = () if (number + number // 2 + turn) % step == 0 else pytest.mark.nightly
                cases.append(pytest.param(backend, name, situation, marks=marks))
        cases += [pytest.param(backend, name, situation, marks=pytest.mark.nightly) for situation in NIGHTLY]
    return cases


@pytest.fixture(scope="module")
def uncut(device: rhi.Device) -> Iterator[Callable[[str], Uncut]]:
    """The frames of a situation without culling, drawn once for all algorithms of a device."""
    drawn: dict[str, Uncut] = {}

    def draw(situation: str) -> Uncut:
        image = (SITUATIONS | NIGHTLY)[situation]
        if situation not in drawn:
            made = Uncut(device, scene := image.scene(), image.shots(scene), image.size)
            drawn[situation] = opened.enter_context(made)
        return drawn[situation]

    with ExitStack() as opened:
        yield draw


@pytest.mark.nightly_cases(
    "cl-*-what is simulated", "cl-*-all along *", "cl-*-backs of two sides*", "cl-*standard depth", reason=ONLY_KERNELS
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
@pytest.mark.parametrize(("device", "name", "situation"), in_turns(), indirect=["device"])
def test_it_looks_as_without_culling(
    device: rhi.Device, uncut: Callable[[str], Uncut], name: str, situation: str
) -> None:
    need_algorithm(device, name)
    expected = uncut(situation)
    assert expected.try_algorithm(name) == [0] * len(expected.shots)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_pictures_that_are_compared_show_something(device: rhi.Device, uncut: Callable[[str], Uncut]) -> None:
    blank = {
        situation
        for situation, image in SITUATIONS.items()
        if image.size > (2, 3) and not all(np.ptp(frame[..., :3]) > 60 for frame in uncut(situation).frames)
    }
    assert blank == set()


def test_a_lost_object_is_seen(gl: rhi.Device) -> None:
    # The control: one of the objects in view is left out.
    city = make_city()

    class LeaveOut:
        opens_pass = False

        def render(self, camera: Camera, scene_pass: visibility.ScenePass) -> visibility.VisibilityStatistics:
            some = visibility.CallbackPass(lambda rows: scene_pass.draw(rows[1:]))
            return visibility.FrustumCulling(city).render(camera, some)

    with Uncut(gl, city, [(city.views["overview"], 0.0)], (160, 90)) as uncut:
        assert uncut.count_wrong_pixels(visibility.FrustumCulling(city)) == [0]
        assert uncut.count_wrong_pixels(LeaveOut()) > [0]
