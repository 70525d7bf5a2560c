"""The hard cases of visibility, 1 to 21: each scene, drawn by every algorithm, must look as it does without culling.

`IMAGES` are scenes and cameras; every algorithm that a drawing device can run takes them all, and so does the
next one that is registered. On the null device, where an oracle says what shows, the algorithms that ask the device,
and those that run on it, take them on a GPU that is so many commands late, and `WALKS` with them, whose answers no
scene would give.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from occlusion_scenes import (
    DEVICE,
    HARD_CASES,
    OCCLUSION,
    ORIGIN,
    SIZE,
    WALL,
    Oracle,
    Shots,
    Uncut,
    cameras,
    count_wrong_pixels,
    delay_answers,
    draw_with,
    look,
    make_boxes,
    scenes,
    visible,
    walk,
)

import rhi
from renderer.content import load_scene
from renderer.measure.exact import ExactVisibility
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene
from renderer.visibility import ALGORITHMS, ChcPlusPlus, Settings, list_algorithms, make_visibility
from renderer.visibility.boxes.bounds import near_radius
from renderer.visibility.queries.chc_plus_plus import STAYS_HIDDEN, choose_size
from rhi import FixedQueue
from rhi.backends.null import CostModel, Simulation
from rhi.errors import ValidationError

NAMES = tuple(name for name in ALGORITHMS if name != "none")
NEVER = 10**9
LATENCIES = (0, 1, 20, NEVER)


@dataclass(frozen=True, eq=False)
class Case:
    """What is looked at, from where, frame by frame; `numbers` are those of the list of hard cases."""

    numbers: tuple[int, ...]
    scene: Callable[[], Scene]
    shots: Callable[[Scene], Shots]
    size: tuple[int, int] = SIZE


def still(camera: Camera) -> Callable[[Scene], Shots]:
    """Return this view, the opposite one, and this one again."""
    behind = Camera.look_at(camera.position, camera.position - camera.forward, projection=camera.projection)
    return lambda _: [(one, 0.0) for one in (camera, camera, behind, camera, camera)]


def boxes(places: object, sizes: object, **options: object) -> Callable[[], Scene]:
    return lambda: make_boxes(places, sizes, **options)


@cache
def city() -> Scene:
    return load_scene("city:blocks=8,detail=2")


def along(path: str, *frames: int) -> Callable[[Scene], Shots]:
    return lambda scene: walk(scene, path, frames)


def teleports(scene: Scene) -> Shots:
    return [
        (scene.paths[path].camera(frame), 0.0)
        for frame in (0, 900, 1799)
        for path in ("ground", "sky", "ground")
    ]


def fly_past(_: Scene) -> Shots:
    """Move forward past what was in view, so that it is behind the eye in the next frame."""
    return [
        (look((0.0, 0.0, z), (0.0, 0.0, z - 1.0), near=0.1), 0.0) for z in (8.0, 6.0, 1.0, -1.5, -6.0, 8.0)
    ]


def slide(scene: Scene) -> Shots:
    """Move sideways a little in each frame, so that hidden objects appear at an edge."""
    return [(look((x, 0.0, 0.0), (x, 0.0, -1.0), near=0.1), 0.0) for x in np.linspace(-0.4, 0.4, 9).tolist()]


LENS = Perspective(np.pi / 3, 16 / 9, near=0.1)

NUMBERS = {
    "camera 1.5 near from a corner, at 60°": (2,),
    "camera inside a box": (3,),
    "everything visible": (7,),
    "everything hidden but a wall": (7,),
    "boxes without thickness": (10,),
    "one object": (11,),
    "corner where w is 0": (13,),
    "corners where w is negative": (13,),
    "spheres that touch the near plane, to an ulp": (14,),
    "slit of a pixel": (16,),
    "two faces in one plane": (21,),
}

IMAGES = {
    title: Case(NUMBERS.get(title, ()), lambda scene=scene: scene, still(camera))
    for title, (scene, camera) in HARD_CASES.items()
} | {
    "teleports": Case((4,), city, teleports),
    "1023 by 767 pixels": Case((15, 20), city, along("ground", 600, 606), (1023, 767)),
    "sky through a hole in a wall": Case(
        (17,),
        boxes(
            [
                *((x, 0.0, -5.0) for x in (-5.2, 5.2)), *((0.0, y, -6.2) for y in (-5.2, 5.2)),
                (0.1, 0.15, -40.0), (9.0, 9.0, -60.0),
            ],
            [*[(10.0, 20.0, 1.0)] * 2, *[(10.0, 10.0, 1.0)] * 2, (1.0, 1.0, 1.0), (9.0, 9.0, 9.0)],
        ),
        slide,
    ),
    "box under a pixel": Case(
        (18,),
        boxes(
            [(0.01, 0.01, -30.0), (3.0, 0.0, -40.0), (0.4, 0.0, -8.0)],
            [(0.3, 0.3, 0.3), (0.2, 9.0, 0.2), (0.05, 0.05, 0.05)],
        ),
        slide,
    ),
    "what was seen is behind the camera": Case(
        (19,),
        boxes(
            [(0.8, 0.0, 4.0), (-1.0, 0.0, 0.0), (0.5, 0.0, -3.0), (0.0, 0.0, -12.0)],
            [*[(1.0, 1.0, 1.0)] * 3, (8.0, 8.0, 1.0)],
        ),
        fly_past,
    ),
    "one pixel": Case((20,), city, along("ground", 600, 608, 616), (1, 1)),
    "17 by 9 pixels": Case((20,), city, along("ground", 600, 608, 616), (17, 9)),
    "130 by 67 pixels": Case((20,), city, along("sky", 600, 608, 616), (130, 67)),
}  # fmt: skip


ELSEWHERE = {
    1: "test_a_multiquery_takes_as_many_nodes_as_it_should",
    5: "test_answers_that_come_late_change_no_image",
    6: "test_a_batch_larger_than_the_tree_changes_no_image",
    8: "test_a_threshold_loses_pixels_and_zero_none",
    9: "test_persistence_changes_no_image_and_flattens_spikes",
    12: "test_a_ring_of_n_takes_n",
}
"""Cases that are no scenes, and the tests below that hold them."""


def test_every_case_of_the_list_is_held() -> None:
    numbers = {number for case in IMAGES.values() for number in case.numbers}
    assert numbers | ELSEWHERE.keys() == set(range(1, 22))
    assert not numbers & ELSEWHERE.keys()
    assert all(callable(globals().get(name)) for name in ELSEWHERE.values())


def make_on(device: rhi.Device, name: str, scene: Scene) -> object:
    if name not in list_algorithms(device):
        pytest.skip(f"{name} doesn't run on {device.backend_name}")
    return make_visibility(name, scene, device)


@pytest.fixture(scope="module")
def uncut(drawing_device: rhi.Device) -> Iterator[Callable[[str], Uncut]]:
    """The frames of a case without culling."""

    @cache
    def find(title: str) -> Uncut:
        case = IMAGES[title]
        scene = case.scene()
        frames.append(Uncut(drawing_device, scene, case.shots(scene), case.size))
        return frames[-1]

    frames: list[Uncut] = []
    yield find
    for one in frames:
        one.destroy()


@pytest.mark.parametrize("title", IMAGES)
@pytest.mark.parametrize("name", NAMES)
def test_a_hard_case_looks_as_without_culling(
    drawing_device: rhi.Device, uncut: Callable[[str], Uncut], name: str, title: str
) -> None:
    case = uncut(title)
    algorithm = make_on(drawing_device, name, case.scene)
    assert case.count_wrong_pixels(algorithm) == [0] * len(case.shots)
    algorithm.destroy()


def test_the_cases_are_not_empty(uncut: Callable[[str], Uncut]) -> None:
    # The control: in every case some frame shows something, and losing it is seen.
    class Nothing:
        opens_pass = False

        def render(self, camera: Camera, scene_pass: object) -> None:
            return None

    for title in IMAGES:
        assert sum(uncut(title).count_wrong_pixels(Nothing())) > 0, title


@settings(max_examples=4)
@given(scenes(), st.lists(cameras(), min_size=2, max_size=4), st.integers(1, 6), st.integers(1, 4))
def test_random_scenes_from_random_places_look_as_without_culling(
    drawing_device: rhi.Device, scene: Scene, eyes: list[Camera], batch: int, persistence: int
) -> None:
    shots = [(camera, 0.0) for camera in (*eyes, eyes[-1], eyes[0])]
    algorithms = {
        name: make_visibility(name, scene, drawing_device)
        for name in list_algorithms(drawing_device)
        if name in NAMES
    }
    algorithms["small"] = ChcPlusPlus(scene, drawing_device, batch=batch, persistence=persistence)
    for name, algorithm in algorithms.items():
        assert count_wrong_pixels(drawing_device, scene, algorithm, shots) == [0] * len(shots), name
        algorithm.destroy()


# What is no scene


@pytest.mark.parametrize(("frames", "size"), [(1, 3), (2, 4), (3, 5), (4, 7), (5, 9), (15, 11)])
def test_a_multiquery_takes_as_many_nodes_as_it_should(frames: int, size: int) -> None:
    assert choose_size([STAYS_HIDDEN[frames]] * 40) == size
    assert choose_size([STAYS_HIDDEN[frames]]) == 1


@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("name", OCCLUSION)
def test_answers_that_come_late_change_no_image(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str, latency: int
) -> None:
    delay_answers(monkeypatch, latency)
    algorithm = make_on(drawing_device, name, city())
    shots = [*along("ground", 600, 604, 608)(city()), *teleports(city())[3:6]]
    assert count_wrong_pixels(drawing_device, city(), algorithm, shots) == [0] * len(shots)


def test_a_batch_larger_than_the_tree_changes_no_image(drawing_device: rhi.Device) -> None:
    algorithm = ChcPlusPlus(city(), drawing_device, batch=100_000)
    shots = along("ground", *range(800, 812, 2))(city())
    assert count_wrong_pixels(drawing_device, city(), algorithm, shots) == [0] * 6


@pytest.mark.parametrize("name", ["stop_and_wait", "chc", "chc_plus_plus"])
def test_a_threshold_loses_pixels_and_zero_none(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    delay_answers(monkeypatch, 0)
    shots = along("ground", *range(600, 624, 4))(city())
    wrong = {
        threshold: count_wrong_pixels(
            drawing_device,
            city(),
            make_visibility(name, city(), drawing_device, Settings(threshold=threshold)),
            shots,
        )
        for threshold in (0, 10)
    }
    assert wrong[0] == [0] * 6
    assert 0 < max(wrong[10]) < 0.1 * SIZE[0] * SIZE[1]


def test_persistence_changes_no_image_and_flattens_spikes(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    delay_answers(monkeypatch, 0)
    shots = along("ground", *range(800, 848, 2))(city())
    most = []
    for persistence in (1, 20):
        algorithm = ChcPlusPlus(city(), drawing_device, persistence=persistence)
        assert count_wrong_pixels(drawing_device, city(), algorithm, shots) == [0] * len(shots)
        with Renderer(drawing_device, city(), size=SIZE) as renderer:
            queries = [draw_with(renderer, algorithm, camera).statistics.queries for camera, _ in shots]
        most.append(max(queries[4:]))
    assert most[1] < most[0]


def test_a_ring_of_n_takes_n() -> None:
    ring: FixedQueue[int] = FixedQueue(3)
    for _ in range(4):  # round and round
        for value in range(3):
            ring.push(value)
        assert ring
        with pytest.raises(ValidationError):
            ring.push(3)
        assert [ring.pop() for _ in range(3)] == [0, 1, 2]
        assert not ring


# On the null device: what shows is drawn, however late the answers


def make_late(latency: int) -> rhi.Device:
    """Create a simulated GPU whose clock advances by one for each call; results are available `latency` calls later."""
    free = CostModel(command=0.0, vertex=0.0, pixel=0.0, byte=0.0, state_change=0.0, invocation=0.0)
    simulation = Simulation(free, call=1, submission_latency=latency, wake_latency=0, batch=1)
    return rhi.create_device("null", simulation=simulation)


def in_turns(*lists: Iterable[object]) -> list[object]:
    """All combinations with all latencies; of each but one is taken by day, another one than of its neighbours."""
    turns = len(LATENCIES)
    return [
        pytest.param(*case, latency, marks=() if (number + number // turns) % turns == turn else pytest.mark.nightly)
        for number, case in enumerate(itertools.product(*lists))
        for turn, latency in enumerate(LATENCIES)
    ]


@pytest.mark.parametrize(("title", "latency"), in_turns(IMAGES))
def test_on_a_late_gpu_a_hard_case_draws_what_is_seen(title: str, latency: int) -> None:
    case = IMAGES[title]
    scene = case.scene()
    shots = case.shots(scene)
    with rhi.create_device() as device:
        if not device.capabilities.renders:
            pytest.skip("no device here that draws")
        exact = ExactVisibility(device, scene, case.size)
        seen = [exact.find(camera) for camera, _ in shots]
    for name in (*OCCLUSION, *DEVICE):
        with make_late(latency) as device, Renderer(device, scene, size=case.size) as renderer:
            oracle = Oracle(device, scene, name)
            algorithm = make_visibility(name, scene, device)
            for (camera, seconds), rows in zip(shots, seen, strict=True):
                oracle.guessed, oracle.seen = oracle.seen, rows
                assert visible(draw_with(renderer, algorithm, camera, seconds)) >= rows, name


WALKS = {
    "teleports": (4, [(30.0, range(40)), (-30.0, range(10)), (30.0, (7,)), (-30.0, ()), (30.0, range(30, 40))]),
    "all visible, all hidden": (7, [(30.0, range(40)), (30.0, ()), (30.0, range(40)), (30.0, ())]),
    "one at a time": (11, [(30.0, (row,)) for row in range(0, 40, 5)]),
    "all new each frame": (5, [(30.0, range(row, 40, 4)) for row in (0, 1, 2, 3)]),
}  # fmt: skip


@pytest.mark.parametrize(("name", "title", "latency"), in_turns([*OCCLUSION, *DEVICE], WALKS))
def test_what_shows_is_drawn_whenever_the_answer_comes(name: str, title: str, latency: int) -> None:
    scene = _cloud()
    with make_late(latency) as device:
        oracle = Oracle(device, scene, name, guessed=set(range(0, 40, 3)))
        algorithm = make_visibility(name, scene, device)
        with Renderer(device, scene, size=(64, 36)) as renderer:
            for z, seen in WALKS[title][1]:
                camera = look((0.0, 0.0, z), ORIGIN, near=0.1)
                oracle.seen = set(seen)
                for _ in range(3):
                    assert visible(draw_with(renderer, algorithm, camera)) >= oracle.seen


@pytest.mark.parametrize(("name", "ulps", "latency"), in_turns([*OCCLUSION, *DEVICE], [-1, 0, 1]))
def test_what_may_be_cut_by_the_near_plane_is_drawn_whatever_the_answer(
    name: str, ulps: int, latency: int
) -> None:
    radius = near_radius(look(ORIGIN, WALL, fov=LENS.fov, near=0.1).with_aspect(64 / 36))
    inside = radius * (1.0 + ulps * 2.0**-52) - 1e-3  # padding pulls the near one of two over the radius
    scene = make_boxes([(0.0, 0.0, -inside - 0.5), (0.0, 0.0, -9.0)], [(1.0, 1.0, 1.0)] * 2)
    with make_late(latency) as device:
        Oracle(device, scene, name)  # sees nothing
        with Renderer(device, scene, size=(64, 36)) as renderer:
            camera = look(ORIGIN, WALL, fov=LENS.fov, near=0.1)
            algorithm = make_visibility(name, scene, device)
            assert all(0 in visible(draw_with(renderer, algorithm, camera)) for _ in range(3))


@cache
def _cloud() -> Scene:
    rng = np.random.default_rng(5)
    return make_boxes(rng.uniform(-6.0, 6.0, (40, 3)), rng.uniform(0.1, 0.8, (40, 3)))
