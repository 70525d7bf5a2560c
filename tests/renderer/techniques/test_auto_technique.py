"""The technique that measures others and uses the fastest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from frames import EYE, make_lit_boxes, open_renderer

import rhi
from renderer.content import load_scene
from renderer.frame import Frame, FrameEffects, collect_frame_effects
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.techniques import AutoTechnique, ClusteredDeferred, Forward, FxaaTechnique, TiledDeferred
from renderer.techniques.auto import CANDIDATES, MIN_TRIAL_LIGHTS, list_candidates
from renderer.visibility import NoCulling
from rhi import Op

SIZE = (32, 16)


class Clock:
    """A clock that shows only the time that techniques have taken."""

    now = 0.0


class Slow:
    """A technique that takes a set time, by this clock."""

    def __init__(self, technique: Forward | ClusteredDeferred, seconds: float, log: list[str]) -> None:
        self.technique, self.seconds, self.log = technique, seconds, log

    @property
    def name(self) -> str:
        return self.technique.name

    def declare(self, effects: FrameEffects):
        def run(draw: Callable[[Frame], None]) -> Callable[[Frame], None]:
            def taking_time(frame: Frame) -> None:
                self.log.append(self.name)
                Clock.now += self.seconds
                draw(frame)

            return taking_time

        first, *others = self.technique.declare(effects)
        return (replace(first, run=run(first.run)), *others)


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("renderer.renderer.perf_counter", lambda: Clock.now)


@pytest.fixture
def log() -> list[str]:
    return []


box = partial(make_lit_boxes, 3)


CandidateSelector = Callable[..., tuple[AutoTechnique, Renderer]]


@pytest.fixture
def on_trial(
    null: rhi.Device, log: list[str], monkeypatch: pytest.MonkeyPatch
) -> Iterator[CandidateSelector]:
    """Makes a technique whose two candidates take these seconds, and a renderer: its device tries both,
    though it draws nothing."""
    monkeypatch.setattr(
        "renderer.techniques.auto.list_candidates", lambda device, effects, names: (list(names), "")
    )
    with ExitStack() as opened:

        def make(
            forward: float, clustered: float, scene: Scene | None = None
        ) -> tuple[AutoTechnique, Renderer]:
            factories = {
                "forward": lambda: Slow(Forward(), forward, log),
                "clustered_deferred": lambda: Slow(ClusteredDeferred(), clustered, log),
            }
            drawn_scene = scene or box()
            auto = AutoTechnique(drawn_scene, null, factories, frames=4, idle=0)
            return auto, opened.enter_context(open_renderer(null, drawn_scene, auto, size=SIZE))

        yield make


@pytest.mark.parametrize(
    ("forward", "clustered", "current_name"), [(0.02, 0.01, "clustered_deferred"), (0.01, 0.02, "forward")]
)
def test_each_is_tried_and_the_fastest_stays(
    log: list[str], on_trial: CandidateSelector, forward: float, clustered: float, current_name: str
) -> None:
    auto, drawn = on_trial(forward, clustered)
    drawn.render(EYE)
    assert auto.is_trying
    assert drawn.is_trying
    assert auto.reason == "forward, clustered_deferred are being tried"
    while drawn.is_trying:
        drawn.render(EYE)
    tried = 3 if forward < clustered else 4  # what is hopelessly slow is given up
    assert log == ["forward"] * 5 + ["clustered_deferred"] * tried
    assert auto.current_name == current_name
    log.clear()
    for _ in range(6):
        drawn.render(EYE)
    assert log == [current_name] * 6
    assert auto.reason.startswith("the fastest in this view, 10.0 ms a frame; ")
    assert auto.reason.endswith(" 20.0")


def test_the_passes_are_those_of_the_technique_in_use(log: list[str], on_trial: CandidateSelector) -> None:
    auto, drawn = on_trial(0.02, 0.01)
    names = []
    for _ in range(9):
        drawn.render(EYE)
        names.append(log[-1])
        _, plan = drawn.plan(EYE)
        uses = [frame_pass.name for frame_pass in plan.passes]
        assert uses == (
            ["forward"] if auto.current_name == "forward" else ["geometry", "light lists", "resolve"]
        )
    assert names == ["forward"] * 5 + ["clustered_deferred"] * 4


@pytest.mark.parametrize(
    ("change", "tries"),
    [
        (lambda scene, drawn: None, False),
        (lambda scene, drawn: setattr(drawn, "size", (16, 16)), True),
        (lambda scene, drawn: scene.lights.add_point((0, 1.5, 0), 3.0), False),
        (lambda scene, drawn: [scene.lights.add_point((0, 1.5, 0), 3.0) for _ in range(10)], True),
    ],
)
def test_another_size_or_many_more_lights_are_another_trial(
    on_trial: CandidateSelector, change, tries: bool
) -> None:
    scene = box()
    auto, drawn = on_trial(0.01, 0.02, scene)
    for _ in range(12):
        drawn.render(EYE)
    assert not auto.is_trying
    change(scene, drawn)
    drawn.render(EYE)
    assert auto.is_trying is tries


@pytest.mark.parametrize(("camera", "tries"), [
    (Camera.look_at((0, 0, 10.1), (0, 0, 0)), False), (Camera.look_at((0, 0, 12), (0, 0, 0)), True),
    (Camera.look_at((0, 0, 10), (5, 0, 0)), False), (Camera.look_at((0, 0, 10), (11, 0, 0)), True),
])  # fmt: skip
def test_another_view_is_another_trial(on_trial: CandidateSelector, camera: Camera, tries: bool) -> None:
    auto, drawn = on_trial(0.01, 0.02)
    for _ in range(12):
        drawn.render(EYE)
    drawn.render(camera)
    assert auto.is_trying is tries


def test_techniques_are_not_exchanged_while_visibility_is_on_trial(
    log: list[str], on_trial: CandidateSelector, monkeypatch: pytest.MonkeyPatch
) -> None:
    auto, drawn = on_trial(0.02, 0.01)
    monkeypatch.setattr(Renderer, "_is_trying_visibility", True)
    for _ in range(9):
        drawn.render(EYE)
    assert log == ["forward"] * 9
    monkeypatch.setattr(Renderer, "_is_trying_visibility", False)
    for _ in range(8):
        drawn.render(EYE)
    assert auto.current_name == "clustered_deferred"


def test_exchanges_leave_nothing_behind(
    null: rhi.Device, log: list[str], on_trial: CandidateSelector
) -> None:
    _, drawn = on_trial(0.01, 0.012)

    def count() -> int:
        created = len(null.stream.filter((Op.CREATE_TEXTURE, Op.CREATE_BUFFER)))
        return created - len(null.stream.filter(Op.DESTROY))

    alive = []
    for turn in range(6):
        drawn.render(Camera.look_at((0, 0, 10 + 2 * turn), (0, 0, 0)))
        while drawn.is_trying:
            drawn.render(Camera.look_at((0, 0, 10 + 2 * turn), (0, 0, 0)))
        null.finish()
        alive.append(count())
    assert log.count("clustered_deferred") >= 4 * len(alive)
    assert alive[1:] == alive[1:2] * (len(alive) - 1)


def needs_of(lights: int) -> FrameEffects:
    return collect_frame_effects(make_lit_boxes(lights), EYE)


def test_a_device_that_draws_nothing_has_one_candidate_and_waits_for_nothing(
    null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert list_candidates(null, needs_of(99), CANDIDATES)[0] == ["forward"]
    scene = box()
    auto = AutoTechnique(scene, null)
    monkeypatch.setattr(null, "finish", lambda: pytest.fail("waited"))
    renderer = Renderer(null, scene, technique=auto, visibility=NoCulling(scene), size=SIZE)
    for _ in range(3):
        renderer.render(EYE)
    assert not renderer.is_trying
    assert (auto.current_name, auto.reason) == (
        "forward",
        "a null device draws nothing that could be measured",
    )


class Device:
    """The members of a device that `list_candidates` reads."""

    def __init__(self, backend: str, name: str, *, compute: bool = True) -> None:
        self.backend_name = backend
        self.capabilities = rhi.Capabilities(backend, name, "", compute=compute)


FORWARD, CLUSTERS, TILES = (technique.name for technique in (Forward, ClusteredDeferred, TiledDeferred))


@pytest.mark.parametrize(
    ("device", "lights", "expected"),
    [
        (Device("gl", "a GPU"), 1, [FORWARD, CLUSTERS, TILES]),
        (Device("gl", "a GPU"), 0, [FORWARD, CLUSTERS]),
        (Device("gl", "llvmpipe (LLVM 15)"), 99, [FORWARD, CLUSTERS]),
        (Device("gl", "a GPU", compute=False), 99, [FORWARD]),
        (Device("cl", "a CPU"), MIN_TRIAL_LIGHTS, [FORWARD, CLUSTERS, TILES]),
        (Device("cl", "a CPU"), MIN_TRIAL_LIGHTS - 1, [FORWARD]),
    ],
)
def test_the_device_and_the_lights_in_view_select_the_candidates(
    device: rhi.Device, lights: int, expected: list[str]
) -> None:
    assert list_candidates(device, needs_of(lights), CANDIDATES)[0] == expected


def test_candidates_that_were_tried_once_stay_when_there_are_fewer_lights(
    on_trial: CandidateSelector, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[str]] = [["forward"], ["forward", "clustered_deferred"], ["forward"], ["forward"]]
    monkeypatch.setattr("renderer.techniques.auto.list_candidates", lambda *_: (seen.pop(0), "few"))
    auto, drawn = on_trial(0.02, 0.01)
    names = []
    while seen:
        drawn.render(EYE)
        names.append(auto.names)
    assert names == [("forward",), *[("forward", "clustered_deferred")] * 3]


def test_images_of_a_trial_are_alike_with_and_without_fxaa(gl: rhi.Device) -> None:
    scene = load_scene("hall:columns=6,rows=2,flags=0,detail=3,lights=40")
    camera = next(iter(scene.views.values()))
    factories = {name: (lambda make=make: FxaaTechnique(make())) for name, make in CANDIDATES.items()}
    for technique, auto in (
        (Forward(), AutoTechnique(scene, gl, idle=0)),
        (FxaaTechnique(Forward()), AutoTechnique(scene, gl, factories)),
    ):
        with open_renderer(gl, scene, technique, size=(96, 64)) as renderer:
            expected = renderer.render(camera).image.read().astype(int)
            renderer.technique = auto
            used = set()
            renderer.render(camera)
            while renderer.is_trying:
                used.add(auto.current_name)
                image = renderer.render(camera).image.read().astype(int)
                assert np.abs(image - expected).max() <= 2
        assert {"forward", "clustered_deferred"} <= used


def test_visibility_and_technique_are_tried_one_after_the_other(gl: rhi.Device) -> None:
    scene = box()
    with open_renderer(gl, scene, AutoTechnique(scene, gl), visibility="auto", size=SIZE) as renderer:
        order = []
        renderer.render(EYE)
        while renderer.is_trying:
            order.append("visibility" if renderer._is_trying_visibility else "technique")
            renderer.render(EYE)
    assert order == sorted(order, reverse=True)
    assert set(order) == {"visibility", "technique"}
