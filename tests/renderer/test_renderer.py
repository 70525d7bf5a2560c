"""The renderer, frame by frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import list_owned

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene
from renderer.settings import RenderSettings
from renderer.shaders import ViewConstants
from renderer.visibility import FrustumCulling, NoCulling, make_visibility
from rhi import Op
from rhi.backends.null import Faults

TIMELINE = {Op.SIGNAL, Op.WAIT}
"""What depends on how fast the GPU is."""


def commands(device: rhi.Device, scene: Scene, cameras: list[Camera]) -> list[tuple[Op, tuple[Any, ...]]]:
    scene.update(0.0)
    with Renderer(device, scene, visibility=FrustumCulling(scene), size=(64, 36)) as renderer:
        for number, camera in enumerate(cameras):
            renderer.render(camera, number / 60)
        return [(command.op, command.values) for command in device.stream if command.op not in TIMELINE]


@pytest.mark.parametrize("text", ["city:blocks=6", "hall:columns=6,flags=4", "grid:count=9"])
def test_gl_and_null_get_the_same_commands(gl: rhi.Device, null: rhi.Device, text: str) -> None:
    scene = load_scene(text)
    cameras = [scene.paths["ground"].camera(frame) for frame in (0, 600, 600)]
    assert commands(gl, scene, cameras) == commands(null, scene, cameras)


def test_other_cameras_get_other_commands(null: rhi.Device, city: Scene) -> None:
    # The control: the comparison above sees what a camera changes.
    paths = city.paths
    with rhi.create_device("null") as other:
        ground = commands(null, city, [paths["ground"].camera(0)])
        assert ground != commands(other, city, [paths["ground"].camera(1)])


def test_a_second_frame_from_the_same_eye_uploads_nothing(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city, size=(64, 36)) as renderer:
        camera = city.paths["ground"].camera(0)
        first, second = (renderer.render(camera).statistics for _ in range(2))
    assert first.upload_bytes > second.upload_bytes
    assert second.upload_bytes == 0


def test_a_moved_eye_uploads_the_view_and_nothing_for_objects(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city, size=(64, 36)) as renderer:
        camera = city.paths["ground"].camera(0)
        renderer.render(camera)
        lights = 32 * len(city.lights.point) + 64 * len(city.lights.spot)
        view = ViewConstants.uniform_dtype.itemsize
        elsewhere = replace(camera, position=camera.position + np.array([1.0, 2.0, 3.0]))
        moved = renderer.render(elsewhere).statistics
    draws = -(-moved.draws // 32) * 32  # the rest are of nothing
    assert moved.upload_bytes == view + lights + draws * rhi.DRAW.itemsize


def test_moving_objects_are_uploaded_and_the_others_are_not(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=12,rows=4,flags=1")
    with Renderer(null, scene, size=(64, 36)) as renderer:
        camera = scene.paths["ground"].camera(0)
        renderer.render(camera, 0.0)
        still = renderer.render(camera, 0.0).statistics
        moving = renderer.render(camera, 0.5).statistics
    assert still.upload_bytes == 0
    most = (112 + 32) * len(scene.objects.dynamic_indices)
    assert 0 < moving.upload_bytes <= most


def test_animated_objects_advance_in_steps_of_animation_step(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=6,flags=2")
    camera = scene.paths["ground"].camera(0)
    with Renderer(null, scene, size=(64, 36)) as renderer:
        assert renderer.animation_step == 0.0
        renderer.animation_step = 0.1
        renderer.render(camera, 0.0)
        frames = []
        for frame in (1, 5, 6, 11, 12):
            uploads = renderer.render(camera, frame / 60).statistics.upload_bytes
            frames.append((uploads > 0, round(60 * scene.seconds, 9)))
        renderer.animation_step = 0.0
        renderer.render(camera, 13 / 60)
    assert frames == [(False, 0.0), (False, 0.0), (True, 6.0), (False, 6.0), (True, 12.0)]
    assert scene.seconds == 13 / 60


def test_distant_objects_are_neither_simulated_nor_uploaded(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=6,flags=2,fountains=2,cloths=2")
    with Renderer(null, scene, size=(640, 360), visibility=NoCulling(scene)) as renderer:
        costs = {}
        for distance, lag in ((30.0, 0.5), (6000.0, 0.5), (6000.0, 0.0)):
            renderer.animation_lag = lag
            renderer.simulator = scene.make_simulator()
            camera = Camera.look_at((0.0, 2.0, distance), (0.0, 2.0, 0.0), projection=Perspective(far=1e5))
            for frame in range(4):
                cost = renderer.render(camera, frame / 60).statistics
            costs[distance, lag] = cost.simulation_steps, cost.upload_bytes > 0
    assert costs == {(30.0, 0.5): (4, True), (6000.0, 0.5): (0, False), (6000.0, 0.0): (4, True)}


@pytest.mark.parametrize(("name", "default"), [("animation_step", 0.0), ("animation_lag", 0.5)])
def test_a_step_of_animation_and_its_lag_are_finite(
    null: rhi.Device, city: Scene, name: str, default: float
) -> None:
    with Renderer(null, city, size=(64, 36)) as renderer:
        for value in (-1e-9, float("inf"), float("nan")):
            with pytest.raises(rhi.ValidationError, match=name.replace("_", "-")):
                setattr(renderer, name, value)
            with pytest.raises(rhi.ValidationError, match=name.replace("_", "-")):
                RenderSettings(**{name: value})
        assert getattr(renderer, name) == getattr(RenderSettings(), name) == default


def test_two_renderers_of_one_scene_both_upload_moved_objects(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=6,flags=2")
    camera = scene.paths["ground"].camera(0)
    with Renderer(null, scene) as first, Renderer(null, scene) as second:
        for renderer in (first, second):
            renderer.render(camera, 0.0)
        uploads = [renderer.render(camera, 0.5).statistics.upload_bytes for renderer in (first, second)]
    assert uploads[0] == uploads[1]


def test_statistics_count_objects_as_draws_and_their_triangles(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city, visibility=NoCulling(city)) as renderer:
        everything = renderer.render(city.views["overview"])
        renderer.visibility = FrustumCulling(city)
        seen = renderer.render(city.views["street"])
    assert everything.statistics.draws == len(city.objects)
    assert everything.statistics.triangles == city.triangle_count
    assert seen.statistics.draws == len(seen.visible) < len(city.objects)
    assert seen.statistics.triangles == city.count_triangles(seen.visible)


@pytest.mark.parametrize(("depth", "changes"), [(Depth.REVERSED, 1), (Depth.STANDARD, 1)])
def test_only_states_that_are_not_the_default_change_and_only_in_the_first_frame(
    null: rhi.Device, city: Scene, depth: Depth, changes: int
) -> None:
    camera = city.views["overview"].with_projection(Perspective(depth=depth))
    with Renderer(null, city) as renderer:
        first, second = (renderer.render(camera).statistics for _ in range(2))
    assert (first.hardware_state_changes, second.hardware_state_changes) == (changes, 0)
    assert first.software_state_changes == second.software_state_changes == 5


def test_the_image_is_lit_and_has_the_size_asked_for(gl: rhi.Device, city: Scene) -> None:
    with Renderer(gl, city, size=(96, 54)) as renderer:
        image = renderer.render(city.paths["ground"].camera(0)).image.read()
    assert image.shape == (54, 96, 4)
    assert image[:, :, :3].std() > 20
    sky = (image == image[0, 48]).all(2)
    assert sky[:18].mean() > 0.1  # above
    assert not sky[-18:].any()


def test_a_new_size_gives_new_images(gl: rhi.Device, city: Scene) -> None:
    with Renderer(gl, city, size=(96, 54)) as renderer:
        before = renderer.render(city.views["overview"]).image
        renderer.size = (32, 48)
        after = renderer.render(city.views["overview"]).image
        assert before.destroyed
        assert after.read().shape == (48, 32, 4)


def test_a_size_that_is_refused_leaves_the_renderer_as_it_was(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city, size=(64, 36)) as renderer:
        with pytest.raises(rhi.ValidationError, match=r"^\[texture-size\]"):
            renderer.size = (0, 36)
        assert renderer.size == (64, 36)
        assert renderer.render(city.views["overview"]).image.size == (64, 36)


def test_all_resources_are_released(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city) as renderer:
        renderer.render(city.views["overview"])
    created, left = list_owned(null)
    assert len(created) > 5
    assert left == []


@pytest.mark.parametrize("failing", range(20))
def test_a_renderer_that_cannot_be_made_leaves_nothing(city: Scene, failing: int) -> None:
    """This holds for every resource whose creation fails for lack of memory."""
    with rhi.create_device("null", faults=Faults(memory=failing)) as device:
        with pytest.raises(rhi.DeviceError), Renderer(device, city) as renderer:
            renderer.render(city.views["overview"])
        assert list_owned(device)[1] == []


def queries_left(device: rhi.Device) -> int:
    """Count the occlusion queries that were created and not destroyed."""
    device.finish()
    created = {command.values[0] for command in device.stream.filter(Op.CREATE_QUERY)}
    return len(created - {command.values[0] for command in device.stream.filter(Op.DESTROY)})


def test_an_algorithm_is_made_for_its_name(null: rhi.Device, city: Scene) -> None:
    with Renderer(null, city, visibility="frustum", size=(64, 36)) as renderer:
        assert isinstance(renderer.visibility, FrustumCulling)
    with pytest.raises(rhi.ValidationError, match="frustum") as caught:
        Renderer(null, city, visibility="frustrum", size=(64, 36))
    assert caught.value.rule.id == "visibility-unknown-name"


def test_a_renderer_destroys_its_own_algorithm_and_not_one_passed_in(gl: rhi.Device, city: Scene) -> None:
    cameras = [city.paths["ground"].camera(frame) for frame in range(12)]
    with Renderer(gl, city, size=(64, 36)) as renderer:  # auto, which tries one that asks
        for camera in cameras:
            renderer.render(camera)
        assert queries_left(gl) > 0
    assert queries_left(gl) == 0
    algorithm = make_visibility("chc_plus_plus", city, gl)
    with Renderer(gl, city, visibility=algorithm, size=(64, 36)) as renderer:
        renderer.render(cameras[0])
    assert queries_left(gl) > 0
    algorithm.destroy()
    assert queries_left(gl) == 0
