"""The algorithm that measures others and uses the fastest."""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial

import pytest

import rhi
from renderer import visibility
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Scene

COSTS = {"slow": 0.012, "fast": 0.008, "middling": 0.0105}


class Clock:
    """A clock that shows only the time that the candidates have taken."""

    now = 0.0


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("renderer.visibility.auto.perf_counter", lambda: Clock.now)


class Sleeper:
    """Draws everything, and takes a set time for it."""

    opens_pass = False

    def __init__(self, scene: Scene, name: str, log: list[str]) -> None:
        self.none = visibility.NoCulling(scene)
        self.name, self.log, self.seconds = name, log, COSTS[name]
        self.visible = 100

    def render(self, camera, scene_drawer):
        self.log.append(self.name)
        Clock.now += self.seconds
        self.none.render(camera, scene_drawer)
        return visibility.VisibilityStatistics(100, self.visible)

    def destroy(self):
        self.log.append(f"{self.name} destroyed")


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=4")


@pytest.fixture
def log() -> list[str]:
    return []


@pytest.fixture
def auto(null: rhi.Device, city: Scene, log: list[str]) -> visibility.AutoCulling:
    return make_auto(null, city, log)


def make_auto(device: rhi.Device, scene: Scene, log: list[str], idle: int = 0) -> visibility.AutoCulling:
    auto = visibility.AutoCulling(
        scene, device, {name: partial(Sleeper, scene, name, log) for name in COSTS}, frames=4, idle=idle
    )
    auto.candidates.update({name: Sleeper(scene, name, log) for name in COSTS})  # for tests to change
    return auto


def look(x: float = 0.0, dx: float = 0.0, dz: float = -1.0) -> Camera:
    return Camera.look_at((x, 2.0, 0.0), (x + dx, 2.0, dz))


def render(auto: visibility.AutoCulling, camera: Camera, count: int) -> list[visibility.VisibilityStatistics]:
    return [auto.render(camera, visibility.CallbackDrawer(lambda rows: None)) for _ in range(count)]


def test_each_is_tried_and_the_fastest_stays(auto: visibility.AutoCulling, log: list[str]) -> None:
    assert auto.is_trying
    tried = render(auto, look(), 12)
    assert log == ["slow"] * 4 + ["fast"] * 4 + ["middling"] * 4
    assert not auto.is_trying
    assert auto.current_name == "fast"
    stays = render(auto, look(), 10)
    assert log[12:] == ["fast"] * 10
    assert len(tried) + len(stays) == len(log)


def test_nothing_is_tried_while_code_is_being_built(
    null: rhi.Device, city: Scene, log: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither what candidates need, nor else: the first is drawn with until then, and isn't waited for."""
    future: Future[None] = Future()
    directions: list[Depth] = []

    def prepare(depth: Depth) -> rhi.Preparation:
        directions.append(depth)
        return rhi.Preparation([future])

    factories = {name: partial(Sleeper, city, name, log) for name in COSTS}
    auto = visibility.AutoCulling(city, null, factories, frames=4, prepare=prepare)
    assert {result.stalled_milliseconds for result in render(auto, look(), 2)} == {0.0}
    monkeypatch.setattr(rhi.Device, "is_building", True)
    render(auto, look(), 1)
    assert directions == []  # what draws the frames is optimised first
    monkeypatch.setattr(rhi.Device, "is_building", False)
    render(auto, look(), 1)
    assert not auto.is_trying
    monkeypatch.setattr(rhi.Device, "is_building", True)
    future.set_result(None)
    render(auto, look(), 2)
    assert log == ["slow"] * 6
    assert (directions, list(auto.candidates)) == ([Depth.REVERSED], ["slow"])
    monkeypatch.setattr(rhi.Device, "is_building", False)
    assert auto.is_trying
    render(auto, look(), 12)
    assert log[6:] == ["slow"] * 4 + ["fast"] * 4 + ["middling"] * 4
    assert auto.current_name == "fast"


def test_waiting_at_the_end_of_a_frame_on_trial_counts_as_stalled(
    null: rhi.Device, auto: visibility.AutoCulling, monkeypatch: pytest.MonkeyPatch
) -> None:
    def finish() -> None:
        Clock.now += 0.004

    auto.candidates["middling"].seconds = 0.0125
    monkeypatch.setattr(null, "finish", finish)
    assert {round(result.stalled_milliseconds, 6) for result in render(auto, look(), 12)} == {4.0}
    assert {result.stalled_milliseconds for result in render(auto, look(), 3)} == {0.0}


def test_the_first_two_frames_of_a_trial_are_not_counted(auto: visibility.AutoCulling) -> None:
    render(auto, look(), 4)
    auto.candidates["fast"].seconds = 0.02
    render(auto, look(), 2)
    auto.candidates["fast"].seconds = 0.001
    render(auto, look(), 2)
    auto.candidates["middling"].seconds = 0.0  # only at first
    render(auto, look(), 2)
    auto.candidates["middling"].seconds = 0.02
    render(auto, look(), 2)
    assert auto.current_name == "fast"


def test_a_much_slower_algorithm_is_not_tried_any_further(
    auto: visibility.AutoCulling, log: list[str]
) -> None:
    auto.candidates["middling"].seconds = 0.05
    render(auto, look(), 20)
    assert log == ["slow"] * 4 + ["fast"] * 4 + ["middling"] * 3 + ["fast"] * 9


def test_the_two_fastest_are_tried_again_when_they_are_close(
    auto: visibility.AutoCulling, log: list[str]
) -> None:
    auto.candidates["middling"].seconds = 0.0085
    auto.candidates["fast"].seconds = 0.009  # while the machine does something else
    render(auto, look(), 12)
    assert auto.is_trying
    auto.candidates["fast"].seconds = 0.008
    render(auto, look(), 9)
    assert log[12:] == ["middling"] * 4 + ["fast"] * 5
    assert auto.current_name == "fast"
    assert not auto.is_trying


def test_after_a_trial_there_is_none_for_a_while_and_longer_each_time(
    null: rhi.Device, city: Scene, log: list[str]
) -> None:
    auto = make_auto(null, city, log, idle=6)
    idle_frames = []
    for turn in range(6):
        while auto.is_trying:
            render(auto, look(), 1)
        log.clear()
        x = 1000.0 * (turn + 1)
        while not auto.is_trying:
            render(auto, look(x), 1)
            x += 1.0
        idle_frames.append(log.index("slow") if "slow" in log else len(log))
    assert idle_frames == [6, 12, 24, 48, 48, 48]


def test_a_choice_that_changed_is_soon_looked_at_again(null: rhi.Device, city: Scene, log: list[str]) -> None:
    auto = make_auto(null, city, log, idle=6)
    for turn in range(3):
        while auto.is_trying:
            render(auto, look(1000.0 * turn), 1)
        render(auto, look(1000.0 * (turn + 1)), 60)
    auto.candidates["slow"].seconds = 0.0
    while auto.is_trying or auto.current_name != "slow":
        render(auto, look(9000.0), 1)
    assert auto._trial._idle == 6


@pytest.mark.parametrize(
    ("camera", "tries"),
    [
        (look(0.5), False),
        (look(1000.0), True),
        (look(dx=0.9), False),
        (look(dx=1.1), True),
        (look(dz=1.0), True),
    ],
)
def test_another_view_is_another_trial(auto: visibility.AutoCulling, camera: Camera, tries: bool) -> None:
    render(auto, look(), 13)
    render(auto, camera, 1)
    assert auto.is_trying is tries


@pytest.mark.parametrize(("drawn", "tries"), [(149, False), (151, True), (67, False), (66, True), (0, True)])
def test_a_number_of_objects_that_changes_by_half_is_another_trial(
    auto: visibility.AutoCulling, drawn: int, tries: bool
) -> None:
    render(auto, look(), 13)
    auto.candidates["fast"].visible = drawn
    render(auto, look(), 1)
    assert auto.is_trying is tries


def test_the_choice_follows_the_algorithm_that_is_fastest_now(auto: visibility.AutoCulling) -> None:
    render(auto, look(), 12)
    auto.candidates["fast"].seconds, auto.candidates["slow"].seconds = 0.03, 0.0
    render(auto, look(1000.0), 12)
    assert auto.current_name == "slow"


def test_a_device_without_queries_has_one_candidate(null: rhi.Device, city: Scene) -> None:
    auto = visibility.make_visibility("auto", city, null)
    assert auto.names == ("frustum",)
    render(auto, look(), 2)
    assert not auto.is_trying


def test_a_candidate_is_created_when_first_tried_and_destroyed_at_the_end(
    null: rhi.Device, city: Scene, log: list[str]
) -> None:
    auto = visibility.AutoCulling(
        city, null, {name: partial(Sleeper, city, name, log) for name in COSTS}, frames=4
    )
    created = [list(auto.candidates)]
    for _ in range(3):
        render(auto, look(), 4)
        created.append(list(auto.candidates))
    assert created == [[], ["slow"], ["slow", "fast"], ["slow", "fast", "middling"]]
    auto.destroy()
    assert log[-3:] == ["slow destroyed", "fast destroyed", "middling destroyed"]


def test_a_device_that_answers_queries_has_all_but_cl_those_that_ask_none(
    drawing_device: rhi.Device, city: Scene
) -> None:
    names = visibility.make_visibility("auto", city, drawing_device).names
    if drawing_device.backend_name == "cl":
        assert names == ("frustum", "none", "depth_pyramid")
    else:
        possible = visibility.list_algorithms(drawing_device)
        assert names == tuple(name for name in visibility.AUTO_CANDIDATES if name in possible)


def test_auto_is_the_renderer_s_default(gl: rhi.Device, city: Scene) -> None:
    with Renderer(gl, city, size=(64, 36)) as renderer:
        assert isinstance(renderer.visibility, visibility.AutoCulling)
