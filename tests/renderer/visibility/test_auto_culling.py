"""The algorithm that measures others and takes the fastest."""

from __future__ import annotations

import time

import pytest

import rhi
from renderer.scene import Camera, Scene, load_scene
from renderer.visibility import AutoCulling, NoCulling, Statistics

COSTS = {"slow": 0.03, "fast": 0.0, "middling": 0.015}


class Sleeper:
    """Takes its time to draw everything."""

    def __init__(self, scene: Scene, name: str, log: list[str]) -> None:
        self.none = NoCulling(scene)
        self.name, self.log, self.seconds = name, log, COSTS[name]
        self.visible = 100

    def render(self, camera, draw):
        self.log.append(self.name)
        time.sleep(self.seconds)
        self.none.render(camera, draw)
        return Statistics(100, self.visible)


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=4")


@pytest.fixture
def log() -> list[str]:
    return []


@pytest.fixture
def auto(null: rhi.Device, city: Scene, log: list[str]) -> AutoCulling:
    return AutoCulling(city, null, frames=3, candidates={name: Sleeper(city, name, log) for name in COSTS})


def look(x: float = 0.0, dx: float = 0.0, dz: float = -1.0) -> Camera:
    return Camera.look_at((x, 2.0, 0.0), (x + dx, 2.0, dz))


def render(auto: AutoCulling, camera: Camera, count: int) -> list[Statistics]:
    return [auto.render(camera, lambda rows: None) for _ in range(count)]


def test_each_is_tried_and_the_fastest_stays(auto: AutoCulling, log: list[str]) -> None:
    assert auto.is_trying
    tried = render(auto, look(), 9)
    assert log == ["slow"] * 3 + ["fast"] * 3 + ["middling"] * 3
    assert not auto.is_trying
    assert auto.chosen == "fast"
    stays = render(auto, look(), 10)
    assert log[9:] == ["fast"] * 10
    assert (
        min(one.stalled_milliseconds for one in tried) > 0.0 == max(one.stalled_milliseconds for one in stays)
    )


def test_the_first_half_of_a_trial_is_not_counted(auto: AutoCulling) -> None:
    render(auto, look(), 3)
    auto.candidates["fast"].seconds = 0.02
    render(auto, look(), 1)
    auto.candidates["fast"].seconds = 0.001
    render(auto, look(), 2)
    auto.candidates["middling"].seconds = 0.0  # only at first
    render(auto, look(), 1)
    auto.candidates["middling"].seconds = 0.02
    render(auto, look(), 2)
    assert auto.chosen == "fast"


@pytest.mark.parametrize(("camera", "tries"), [
    (look(0.5), False), (look(1000.0), True), (look(dx=0.9), False), (look(dx=1.1), True), (look(dz=1.0), True),
])  # fmt: skip
def test_another_view_is_another_trial(auto: AutoCulling, camera: Camera, tries: bool) -> None:
    render(auto, look(), 12)
    render(auto, camera, 1)
    assert auto.is_trying is tries


@pytest.mark.parametrize(("drawn", "tries"), [(149, False), (151, True), (67, False), (66, True), (0, True)])
def test_a_number_of_objects_that_changes_by_half_is_another_trial(
    auto: AutoCulling, drawn: int, tries: bool
) -> None:
    render(auto, look(), 12)
    auto.candidates["fast"].visible = drawn
    render(auto, look(), 1)
    assert auto.is_trying is tries


def test_the_choice_follows_what_is_fastest_now(auto: AutoCulling) -> None:
    render(auto, look(), 9)
    auto.candidates["fast"].seconds, auto.candidates["slow"].seconds = 0.03, 0.0
    render(auto, look(1000.0), 9)
    assert auto.chosen == "slow"


def test_a_device_that_answers_no_queries_has_one_candidate(null: rhi.Device, city: Scene) -> None:
    auto = AutoCulling(city, null)
    assert list(auto.candidates) == ["frustum"]
    render(auto, look(), 2)
    assert not auto.is_trying


def test_a_device_that_answers_queries_has_three(gl: rhi.Device, city: Scene) -> None:
    assert list(AutoCulling(city, gl).candidates) == ["frustum", "chc", "chc_plus_plus"]
