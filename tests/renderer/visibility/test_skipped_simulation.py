"""Objects that a visibility algorithm doesn't draw aren't simulated, and no image differs because of it."""

from __future__ import annotations

import json

import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from occlusion_scenes import WAITING, Oracle, draw_with, require_algorithm

import rhi
from renderer.cli import main
from renderer.content import load_scene
from renderer.lab.exam.scenes import leave, make_flag
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.visibility import ALGORITHMS, FrustumCulling, NoCulling, make_visibility

HALL = "hall:columns=18,rows=2,flags=0,fountains=12"


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene(HALL)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.nightly_cases("gl-software_depth", reason=FEWER_CASES)
@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name != "none"])
def test_skipped_fountains_come_back_as_if_they_had_been_simulated(
    drawing_device: rhi.Device, hall: Scene, name: str
) -> None:
    require_algorithm(drawing_device, name)
    path = hall.paths["ground"]
    algorithm, none = make_visibility(name, hall, drawing_device), NoCulling(hall)
    skipped = steps = 0
    with (
        Renderer(drawing_device, hall, size=(97, 55)) as everything,
        Renderer(drawing_device, hall, size=(97, 55)) as renderer,
    ):
        for frame in (0, 3, 6, 400, 403, 1600, 900, 903, 0, 1):  # forth, on, and back to the beginning
            camera, seconds = path.camera(frame), (frame % 1000) / 60
            expected = draw_with(everything, none, camera, seconds)
            result = draw_with(renderer, algorithm, camera, seconds)
            assert (result.image.read() == expected.image.read()).all(), frame
            skipped += result.statistics.skipped_simulations
            steps += result.statistics.simulation_steps
            assert expected.statistics.skipped_simulations == 0
        assert (expected.image.read() != draw_with(everything, none, camera, 3.0).image.read()).any()
    assert skipped > 0
    assert steps > 0


@pytest.mark.parametrize("name", [*WAITING, "conditional"])
def test_simulations_that_an_algorithm_does_not_draw_take_no_step(
    null: rhi.Device, hall: Scene, name: str
) -> None:
    oracle = Oracle(null, hall, name)
    algorithm = make_visibility(name, hall, null)
    camera = hall.views["overview"]
    with Renderer(null, hall, size=(64, 36)) as renderer:
        renderer.animation_lag = 0.0
        sprays = renderer.simulator.objects.tolist()
        oracle.visible_objects = set(sprays[:2])
        for frame in range(1, 8):
            result = draw_with(renderer, algorithm, camera, frame / 60)
            drawn = set(sprays) & set(result.visible.tolist())
            assert result.statistics.skipped_simulations == len(sprays) - len(drawn)
        if name != "conditional":  # which can't know
            assert drawn == oracle.visible_objects
            assert result.statistics.simulation_steps == 2
        oracle.visible_objects = set(sprays)
        returned = draw_with(renderer, algorithm, camera, 8 / 60).statistics
        if name != "conditional":
            assert returned.skipped_simulations == 0
            assert returned.simulation_steps == 2 + (len(sprays) - 2) * 8


@pytest.mark.parametrize(("count", "steps"), [(22, 0), (23, 23)])
def test_only_simulations_that_an_absence_would_change_run_while_hidden(
    null: rhi.Device, count: int, steps: int
) -> None:
    """Of 22 fountains each can take the 90 steps that it remembers in the frame in which all return."""
    scene = load_scene(f"hall:columns=18,rows=2,flags=4,fountains={count}")
    away = Camera.look_at((0.0, 500.0, 0.0), (0.0, 1000.0, 0.0))
    taken = {}
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 36)) as renderer:
        renderer.animation_lag = 0.0
        for renderer.simulates_hidden in (False, True):
            renderer.simulator = scene.make_simulator()
            for frame in (0, 1):
                counted = renderer.render(away, frame / 60).statistics
            taken[renderer.simulates_hidden] = counted.simulation_steps
    assert taken == {False: 0, True: steps}


@pytest.mark.parametrize(("name", "hidden"), [("frustum", slice(15, 27)), ("stop_and_wait", slice(4, 27))])
def test_a_suspended_flag_comes_back_otherwise_than_one_that_took_its_steps(
    gl: rhi.Device, name: str, hidden: slice
) -> None:
    """The control of exam 77: by default nothing is stepped unseen, and a frame makes up for at most 240
    steps."""
    scene, films = make_flag(), []
    for is_simulated in (False, True):
        algorithm = make_visibility(name, scene, gl)
        with Renderer(gl, scene, size=(97, 55), visibility=algorithm) as renderer:
            renderer.simulates_hidden = is_simulated
            frames = (renderer.render(*shot) for shot in leave(scene))
            films.append([(frame.image.read(), frame.statistics.simulation_steps) for frame in frames])
        algorithm.destroy()
    rested, always = ([steps for _, steps in film] for film in films)
    assert always == [0, *[30] * 29]
    assert set(rested[hidden]) == {0}
    assert max(rested) == rested[27] == 241
    differs = [bool((frame != other).any()) for (frame, _), (other, _) in zip(*films, strict=True)]
    assert differs == [*[False] * 27, *[True] * 3]


def test_only_visible_simulations_are_uploaded(null: rhi.Device, hall: Scene) -> None:
    away = Camera.look_at((0.0, 500.0, 0.0), (0.0, 1000.0, 0.0))
    with Renderer(null, hall, visibility=FrustumCulling(hall), size=(64, 36)) as renderer:
        renderer.render(away, 0.0)
        result = renderer.render(away, 1.0)
        assert result.statistics.upload_bytes == 0
        assert result.statistics.skipped_simulations == len(renderer.simulator) == 12
        visible_objects = renderer.render(hall.views["overview"], 1.0).statistics
        again = renderer.render(hall.views["overview"], 1.0).statistics
    spray = hall.meshes.vertices.itemsize * 1080
    assert (
        visible_objects.upload_bytes - again.upload_bytes
        >= (12 - visible_objects.skipped_simulations) * spray
    )
    assert again.simulation_steps == 0


def test_a_scene_without_simulations_counts_none(null: rhi.Device) -> None:
    scene = load_scene("grid:count=4")
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 36)) as renderer:
        counted = renderer.render(scene.views["overview"], 5.0).statistics
    assert (counted.simulation_steps, counted.skipped_simulations) == (0, 0)


@pytest.mark.usefixtures("gl")
def test_compare_counts_them_for_each_algorithm_by_itself(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["compare", "visibility", HALL, "--size", "160x90", "--frames", "4", "--backend", "gl"]
    assert main([*command, "--algorithms", "none,frustum,stop_and_wait", "--json"]) == 0
    rows = {row["algorithm"]: row for row in json.loads(capsys.readouterr().out)["rows"]}
    assert rows["none"]["skipped_simulations"] == 0
    assert rows["none"]["simulation_steps"] == 12  # one of each fountain, each frame
    assert 0 < rows["frustum"]["skipped_simulations"] < rows["stop_and_wait"]["skipped_simulations"]
    assert rows["stop_and_wait"]["simulation_steps"] < rows["frustum"]["simulation_steps"] < 12
    assert all(row["wrong_pixels"] == 0 for row in rows.values())
    assert main([*command, "--algorithms", "none"]) == 0
    assert "skipped simulations" in capsys.readouterr().out.splitlines()[0]
