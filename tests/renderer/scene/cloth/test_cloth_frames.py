"""Cloths in frames: they take steps where they are seen or shade what is, and issue nothing elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from cloth_scenes import AWAY, BREEZE, look, make_scene, make_square
from nightly_reasons import FEWER_CASES

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Scene, SceneBuilder
from renderer.scene.cloth import ClothSimulation
from renderer.visibility import FrustumCulling, NoCulling, make_visibility
from rhi import Op
from rhi.backends.null import PROFILES

SIZE = (64, 36)
ONE = look((8.0, 2.0, 4.0), (8.0, 1.5, 0.0), 0.4)
"""A camera that sees the second of three cloths only."""


def open_renderer(device: rhi.Device, scene: Scene) -> Renderer:
    return Renderer(device, scene, size=SIZE, visibility=FrustumCulling(scene))


def count_dispatches(device: rhi.Device) -> int:
    count = len(device.stream.filter((Op.DISPATCH,)))
    device.stream.clear()
    return count


def test_only_visible_members_take_steps_in_a_single_dispatch(null: rhi.Device) -> None:
    scene = make_scene(3, gap=8.0)
    with open_renderer(null, scene) as renderer:
        null.stream.clear()
        counts = []
        frames = [("all", 0), (ONE, 1), (ONE, 2), (AWAY, 3), (AWAY, 4), (AWAY, 600), ("all", 601)]
        for camera, frame in frames:
            camera = scene.views[camera] if isinstance(camera, str) else camera
            counted = renderer.render(camera, frame / 60).statistics
            counts.append((count_dispatches(null), counted.simulation_steps, counted.skipped_simulations))
    assert counts == [
        (0, 0, 0),  # at the beginning cloths are as they were uploaded
        (1, 1, 2),  # of those seen last, only what is still in view is expected to be seen
        (1, 1, 2),
        (0, 0, 3),
        (0, 0, 3),
        (0, 0, 3),
        (1, 243, 0),  # one frame catches up: at most 240 steps, and a leap each
    ]


def test_cloths_that_are_simulated_while_hidden_take_each_frame_s_steps_and_no_more_when_they_return(
    null: rhi.Device,
) -> None:
    scene, counts = make_scene(3, gap=8.0), []
    with open_renderer(null, scene) as renderer:
        renderer.simulates_hidden = True
        for camera, frame in (
            (scene.views["all"], 0),
            (ONE, 1),
            (AWAY, 2),
            (AWAY, 600),
            (AWAY, 601),
            (ONE, 602),
        ):
            null.stream.clear()
            counted = renderer.render(camera, frame / 60).statistics
            counts.append((count_dispatches(null), counted.simulation_steps, counted.skipped_simulations))
    assert counts == [(0, 0, 0), (1, 3, 2), (1, 3, 3), (1, 243, 3), (1, 3, 3), (1, 3, 2)]


def test_a_cloth_whose_node_is_hidden_takes_no_step(null: rhi.Device) -> None:
    scene = make_scene(2)
    with open_renderer(null, scene) as renderer:
        renderer.simulates_hidden = True
        renderer.render(AWAY, 1 / 60)
        scene.nodes.hide(scene.objects.node[renderer.simulator.objects[:1]])
        assert renderer.render(AWAY, 2 / 60).statistics.simulation_steps == 1


def test_a_frame_away_from_all_cloths_is_that_of_a_scene_whose_cloths_have_no_simulation(
    null: rhi.Device,
) -> None:
    """But for a buffer of vertices of its own, nothing is created, uploaded or issued."""
    streams = []
    for is_simulated in (True, False):
        scene = make_scene(2)
        if not is_simulated:
            scene.simulated = ()
        with open_renderer(null, scene) as renderer:
            renderer.render(AWAY, 0.0)
            null.stream.clear()
            uploads, creations = null.statistics.upload_bytes, null.statistics.creations
            renderer.render(AWAY, 0.5)
            streams.append([command.op for command in null.stream])
            assert null.statistics.upload_bytes == uploads
            assert null.statistics.creations == creations
            null.stream.clear()
    assert streams[0] == streams[1]
    assert len(streams[0]) > 3


def test_long_absences_take_a_bounded_number_of_dispatches(null: rhi.Device) -> None:
    scene = make_scene(1, steps_per_frame=1000)
    with open_renderer(null, scene) as renderer:
        null.stream.clear()
        renderer.render(scene.views["all"], 1e8)
        assert 1 < count_dispatches(null) < 20
        renderer.render(scene.views["all"], 1e8 + 1.5 / 60)
        assert count_dispatches(null) == 1


def test_a_cloth_that_shows_unexpectedly_is_stepped_between_passes(gl: rhi.Device) -> None:
    scene = make_scene(3)
    algorithm = make_visibility("stop_and_wait", scene, gl)
    none = NoCulling(scene)
    with Renderer(gl, scene, size=SIZE, visibility=algorithm) as renderer:
        renderer.render(AWAY, 0.0)
        gl.stream.clear()
        image = renderer.render(scene.views["all"], 0.3).image.read()
        assert 1 < count_dispatches(gl) <= 3  # they were found one after another
        renderer.visibility = none
        assert np.array_equal(image, renderer.render(scene.views["all"], 0.3).image.read())
    algorithm.destroy()


def test_time_that_goes_back_begins_again_and_leaves_nothing_behind(null: rhi.Device) -> None:
    scene = make_scene(2)
    with open_renderer(null, scene) as renderer:
        counts = []
        for frame in (1, 2, 1, 2, 1):
            counted = renderer.render(scene.views["all"], frame / 60).statistics
            assert counted.simulation_steps == 2
            null.finish()
            created, destroyed = (len(null.stream.filter(op)) for op in (Op.CREATE_BUFFER, Op.DESTROY))
            counts.append(created - destroyed)
    assert len(set(counts)) == 1
    null.finish()
    assert len(null.stream.filter((Op.CREATE_BUFFER,))) > 14  # some were made again


def test_nothing_is_left_of_any_of_several_simulations(null: rhi.Device) -> None:
    builder = SceneBuilder("two kinds of cloth")
    for size in (1.0, 2.0):
        cloth_grid = make_square(size=size)
        mesh, node = builder.add_mesh(cloth_grid.make_mesh(), bounds=cloth_grid.bounds), builder.add_node()
        builder.simulate(
            builder.add_objects(node, mesh, builder.add_material()), ClothSimulation(1, cloth_grid, BREEZE)
        )
    scene = builder.build()
    with open_renderer(null, scene) as renderer:
        for frame in (1, 2, 1):
            renderer.render(scene.views["overview"], frame / 60)
        assert len(null.stream.filter(Op.DISPATCH)) == 6  # one for each simulation in each frame
    null.finish()
    created = null.stream.filter(
        Op.CREATE_BUFFER, where=lambda command: command.arguments["descriptor"].label.startswith("cloth")
    )
    destroyed = {command.arguments["resource"] for command in null.stream.filter(Op.DESTROY)}
    assert len(created) == 24  # six for each, made again when time went back
    assert {command.arguments["buffer"] for command in created} <= destroyed


def test_a_device_that_can_not_compute_gets_uploads(null: rhi.Device) -> None:
    scene = make_scene(1)
    profile = replace(PROFILES["everything"], compute=False)
    with rhi.create_device("null", profile=profile) as device, open_renderer(device, scene) as renderer:
        renderer.render(scene.views["all"], 0.0)
        device.stream.clear()
        counted = renderer.render(scene.views["all"], 1 / 60).statistics
        assert count_dispatches(device) == 0
        assert counted.simulation_steps == 1
        assert counted.upload_bytes >= 30 * scene.meshes.vertices.itemsize
    with open_renderer(null, scene) as renderer:  # the control: one that can
        for frame in (0, 1):
            renderer.render(scene.views["all"], frame / 60)
        counted = renderer.render(scene.views["all"], 2 / 60).statistics
        assert counted.upload_bytes < 10 * scene.meshes.vertices.itemsize


def test_each_simulator_has_cloths_of_its_own(null: rhi.Device) -> None:
    scene = make_scene(1)
    with open_renderer(null, scene) as renderer:
        simulator, other = renderer.simulator, scene.make_simulator()
        renderer.render(scene.views["all"], 1.0)
        renderer.simulator = other
        assert renderer.render(scene.views["all"], 0.5).statistics.simulation_steps == 30
        renderer.simulator = simulator
        null.stream.clear()
        assert renderer.render(scene.views["all"], 1.0).statistics.simulation_steps == 0
        assert count_dispatches(null) == 1  # its vertices were the other one's


@pytest.mark.nightly_cases("cl", reason=FEWER_CASES)
def test_frames_are_those_of_cloths_on_numpy(drawing_device: rhi.Device) -> None:
    """The same scene, whose simulation is hidden from the device, is uploaded."""
    scene, plain = make_scene(2), make_scene(2)

    class OnNumpy:
        def __init__(self, cloths: object) -> None:
            self.catch_up, self.interval = cloths.catch_up, cloths.interval
            self.step, self.leap, self.vertices = cloths.step, cloths.leap, cloths.vertices

    plain.simulated = tuple(
        replace(simulated, simulation=OnNumpy(simulated.simulation)) for simulated in plain.simulated
    )
    camera, frames = scene.views["all"], []
    for scene_again in (scene, plain):
        with Renderer(
            drawing_device, scene_again, size=(96, 54), visibility=NoCulling(scene_again)
        ) as renderer:
            for seconds in (0.0, 0.3):
                image = renderer.render(camera, seconds).image.read().astype(int)
                frames.append(image)
            vertices = renderer.simulator.read_vertices(1)
            assert vertices["position"][-1, 2] > 0.02  # it has moved
    assert np.abs(frames[1] - frames[3]).max() <= 24  # an edge may lie on a pixel's sample
    assert (np.abs(frames[1] - frames[3]) > 1).any(2).mean() < 0.002
    assert (frames[0] != frames[1]).any()


@pytest.mark.parametrize("casts", [True, False])
def test_a_shadow_follows_its_cloth_that_isn_t_in_view(gl: rhi.Device, casts: bool) -> None:
    scene = make_scene(1, shadows=True, cast=casts)
    camera = look((-0.5, 0.9, -0.9), (-0.45, 0.0, -0.95), 0.9)
    with open_renderer(gl, scene) as renderer:
        first, *_, last = (renderer.render(camera, seconds) for seconds in (0.0, 0.25, 0.5))
        assert 1 not in last.visible
        moved = renderer.simulator.read_vertices(1)["position"][:, 2].max() > 0.02
        assert last.statistics.simulation_steps == (15 if casts else 0)
        del first
        images = [renderer.render(camera, seconds).image.read() for seconds in (0.5, 0.75)]
    assert moved == casts
    assert (images[0] != images[1]).any() == casts


def test_a_hall_has_as_many_banners_as_are_asked_for(null: rhi.Device) -> None:
    hall = "hall:columns=2,rows=4,flags=0,lights=1"
    plain, scene = load_scene(hall), load_scene(f"{hall},cloths=6,detail=3")
    assert "cloths" not in plain.name
    assert scene.name == "hall:lights=1,cloths=6,columns=2,rows=4,flags=0,fountains=0,detail=3,seed=0"
    assert len(scene.make_simulator()) == 6
    rows = scene.simulated[0].objects
    boxes = np.stack([scene.objects.lower[rows], scene.objects.upper[rows]], 1)
    assert len(np.unique(boxes, axis=0)) == 6  # no two in one place
    with open_renderer(null, scene) as renderer:
        result = renderer.render(scene.views["banners"], 0.0)
        assert set(rows.tolist()) & set(result.visible.tolist())
    scene.check_bounds([0.1])
