"""Lights and views at nodes: where they are follows from the transforms above them, in float64."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import EYE, SIZE, make_boxes, open_renderer, read_colors
from gltf_documents import GltfDocument, rotation_quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from refusals import refused_rule

import rhi
from renderer.content import load_model, parse_camera, save_scene
from renderer.content.library import parse_path_frames
from renderer.frame.effects import Effect
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, translation
from renderer.viewer.camera_recording import ViewFollower
from renderer.viewer.scene_films import SceneFilm, list_frames, resolve_camera


def turn(degrees: float, axis: int = 1) -> np.ndarray:
    """A rotation (4, 4) about an axis."""
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(4)
    matrix[[first, second], [first, second]] = cosine
    matrix[second, first], matrix[first, second] = sine, -sine
    return matrix


def make_mast(motion: Any = None, bounds: Any = None) -> Scene:
    """A box before the eye, and on a dynamic node above it a spot light and a view."""
    builder = make_boxes((0, 0, 0))
    node = builder.add_node(translation((0.0, 2.0, 0.0)), dynamic=True, name="mast")
    spot = builder.lights.add_spot((0.0, 0.5, 0.0), (0.0, -1.0, 0.0), 9.0, 0.3, 0.6)
    builder.attach_lights("spot", spot, node)
    builder.views["ride"] = Camera.look_at((0.0, 1.0, 3.0), (0.0, 0.0, 0.0))
    builder.attach_view("ride", node)
    if motion is not None:
        builder.animate(node, motion, bounds)
    return builder.build()


def test_a_light_and_a_view_are_in_the_space_of_their_node() -> None:
    scene = make_mast()
    assert scene.lights.spot["position"].tolist() == [[0.0, 2.5, 0.0]]
    assert scene.views["ride"].position.tolist() == [0.0, 3.0, 3.0]
    assert scene.views["eye"].position.tolist() == EYE.position.tolist()


def test_they_move_with_their_node() -> None:
    scene = make_mast()
    scene.nodes.set_local(scene.nodes.find("mast"), translation((1.0, 0.0, 0.0)) @ turn(90.0, axis=2))
    scene.refresh()
    assert scene.lights.spot["position"][0] == pytest.approx([0.5, 0.0, 0.0])
    assert scene.lights.spot["direction"][0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-7)
    assert scene.views["ride"].position == pytest.approx([0.0, 0.0, 3.0])
    assert scene.views["ride"].rotation[1] == pytest.approx(
        turn(90.0, axis=2)[:3, :3] @ Camera.look_at((0.0, 1.0, 3.0), (0.0, 0.0, 0.0)).rotation[1]
    )


def test_lights_without_a_node_stay_where_they_are() -> None:
    builder = make_boxes((0, 0, 0))
    node = builder.add_node(dynamic=True)
    rows = builder.lights.add_points([(1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)], 5.0)
    builder.attach_lights("point", rows[1:2], node)
    scene = builder.build()
    scene.nodes.set_local(scene.nodes.index_of_id[node], translation((0, 7.0, 0)))
    scene.refresh()
    assert scene.lights.point["position"].tolist() == [[1, 0, 0], [2, 7, 0], [3, 0, 0]]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_positions_are_products_of_the_transforms_above(seed: int) -> None:
    rng = np.random.default_rng(seed)
    builder = make_boxes((0, 0, 0))
    parents, count = [-1], int(rng.integers(1, 9))
    locals_: list[np.ndarray] = []
    for number in range(count):
        matrix = np.eye(4)
        matrix[:3] = rng.normal(size=(3, 4)) * (1.0, 1.0, 1.0, 1e3)
        above = int(rng.integers(-1, number)) if number else -1
        parents.append(above)
        locals_.append(matrix)
    ids: list[int] = []
    for matrix, above in zip(locals_, parents[1:], strict=True):
        ids.append(builder.add_node(matrix, -1 if above < 0 else ids[above], dynamic=True))
    at = rng.integers(0, count, 5)
    positions, directions = rng.normal(size=(5, 3)) * 10.0, rng.normal(size=(5, 3))
    rows = builder.lights.add_spots(positions, directions, 7.0, 0.2, 0.5)
    directions = builder.lights.spot["direction"].astype(np.float64)
    builder.attach_lights("spot", rows, [ids[number] for number in at])
    sun = builder.lights.add_directional(directions[0])
    builder.attach_lights("directional", sun, ids[0])
    scene = builder.build()
    for number in rng.integers(0, count, 3):
        locals_[number] = locals_[number].copy()
        locals_[number][:3, 3] += rng.normal(size=3)
        scene.nodes.set_local(scene.nodes.index_of_id[ids[number]], locals_[number])
    scene.refresh()
    for light, number in enumerate(at):
        world, above = np.eye(4), int(number)
        while above >= 0:
            world, above = locals_[above] @ world, parents[1 + above]
        expected = world[:3, :3] @ positions[light] + world[:3, 3]
        size = max(float(np.abs(expected).max()), float(np.abs(world).max()))
        assert np.abs(scene.lights.spot["position"][light] - expected).max() <= 1e-12 * 100.0 * size
        ray = world[:3, :3] @ directions[light]
        assert scene.lights.spot["direction"][light] == pytest.approx(ray / np.linalg.norm(ray), abs=2e-6)
    ray = locals_[0][:3, :3] @ directions[0]
    assert scene.lights.directional["direction"][0] == pytest.approx(ray / np.linalg.norm(ray), abs=2e-6)


def test_a_scale_changes_neither_the_range_nor_the_projection() -> None:
    scene = make_mast()
    scene.nodes.set_local(scene.nodes.find("mast"), np.diag([2.0, 4.0, 8.0, 1.0]))
    scene.refresh()
    assert scene.lights.spot["range"].tolist() == [9.0]
    assert scene.lights.spot["position"].tolist() == [[0.0, 2.0, 0.0]]
    assert np.linalg.norm(scene.lights.spot["direction"][0]) == pytest.approx(1.0)
    rotation = scene.views["ride"].rotation
    assert rotation @ rotation.T == pytest.approx(np.eye(3))


def test_a_node_without_extent_leaves_directions_as_they_were() -> None:
    scene = make_mast()
    before = scene.views["ride"].rotation
    scene.nodes.set_local(scene.nodes.find("mast"), np.diag([0.0, 0.0, 0.0, 1.0]))
    scene.refresh()
    assert scene.lights.spot["direction"].tolist() == [[0.0, -1.0, 0.0]]
    assert (
        scene.lights.spot["position"].tolist() == scene.views["ride"].position[None].tolist() == [[0, 0, 0]]
    )
    assert scene.views["ride"].rotation.tolist() == before.tolist()


def test_a_node_with_a_light_is_animated_though_nothing_of_it_is_drawn() -> None:
    # Its bounds would otherwise let the node rest while it is out of view.
    def move(seconds: float) -> np.ndarray:
        return translation((seconds, 0.0, 0.0))[None]

    bounds = ((-1.0, -1.0, -1.0), (90.0, 9.0, 1.0))
    scene = make_mast(move, bounds)
    simulator = scene.make_simulator()
    simulator.begin_frame(3.0)
    scene.refresh()
    assert scene.lights.spot["position"].tolist() == [[3.0, 0.5, 0.0]]


def test_a_node_without_lights_rests_while_nothing_of_it_is_drawn() -> None:
    builder = make_boxes((0, 0, 0))
    node = builder.add_node(dynamic=True, name="still")
    builder.add_objects(node, 0, 0)
    builder.animate(node, lambda seconds: translation((seconds, 0, 0))[None], ((-1, -1, -1), (90, 1, 1)))
    scene = builder.build()
    scene.make_simulator().begin_frame(3.0)
    scene.refresh()
    assert scene.nodes.world[scene.nodes.find("still"), 0, 3] == 0.0


def test_lights_at_hidden_nodes_are_off_until_they_are_shown() -> None:
    scene = make_mast()
    mast = scene.nodes.find("mast")
    assert len(scene.lights.without_dark().spot) == 1
    before = scene.lights.snapshot
    scene.nodes.hide(mast)
    scene.refresh()
    assert len(scene.lights.without_dark().spot) == 0
    assert len(scene.lights.without_hidden().spot) == 0
    assert scene.lights.spot["intensity"].tolist() == [1.0]
    assert scene.lights.snapshot != before
    scene.nodes.show(mast)
    scene.refresh()
    assert scene.lights.without_hidden() is scene.lights
    assert len(scene.lights.without_dark().spot) == 1
    assert scene.lights.snapshot == before


def test_lights_added_or_removed_after_a_refresh_leave_hidden_ones_off() -> None:
    scene = make_mast()
    scene.nodes.hide(scene.nodes.find("mast"))
    scene.refresh()
    scene.lights.add_spot((0.0, 3.0, 0.0), (0.0, -1.0, 0.0), 5.0, 0.3, 0.6)
    for shining in (scene.lights.without_hidden(), scene.lights.without_dark()):
        assert shining.spot["range"].tolist() == [5.0]
    scene.lights.spot = scene.lights.spot[:0]
    for shining in (scene.lights.without_hidden(), scene.lights.without_dark()):
        assert len(shining.spot) == 0


def test_a_plan_counts_a_light_that_was_added_beside_a_hidden_one(null: rhi.Device) -> None:
    scene = make_mast()
    scene.nodes.hide(scene.nodes.find("mast"))
    with open_renderer(null, scene) as renderer:
        renderer.render(EYE)
        before, _ = renderer.plan(EYE)
        scene.lights.add_spot((0.0, 3.0, 0.0), (0.0, -1.0, 0.0), 5.0, 0.3, 0.6)
        after, _ = renderer.plan(EYE)
    assert Effect.SPOT_LIGHTS not in before.enabled
    assert after.counts[Effect.SPOT_LIGHTS] == 1


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_frame_shows_an_attached_light_as_one_in_the_world(device: rhi.Device) -> None:
    above = Camera.look_at((2.0, 4.0, 3.0), (0.0, 0.0, 0.0))  # sees the top, which is lit
    scene, fixed = make_mast(), make_boxes((0, 0, 0))
    fixed.lights.add_spot((0.4, 2.5, 0.3), (0.0, -1.0, 0.0), 9.0, 0.3, 0.6)
    dark = make_boxes((0, 0, 0)).build()
    with open_renderer(device, scene) as renderer:
        renderer.render(above)
        scene.nodes.set_local(scene.nodes.find("mast"), translation((0.4, 2.0, 0.3)))
        moved = read_colors(renderer.render(above))
        scene.nodes.hide(scene.nodes.find("mast"))
        hidden = read_colors(renderer.render(above))
    with open_renderer(device, fixed.build()) as renderer:
        expected = read_colors(renderer.render(above))
    with open_renderer(device, dark) as renderer:
        unlit = read_colors(renderer.render(above))
    assert (moved == expected).all()
    assert (hidden == unlit).all()
    assert (moved != hidden).any()


def test_lights_that_were_removed_stay_away() -> None:
    scene = make_mast()
    scene.lights.spot = scene.lights.spot[:0]
    del scene.views["ride"]
    scene.nodes.set_local(scene.nodes.find("mast"), np.eye(4))
    scene.refresh()
    assert len(scene.lights.spot) == 0
    assert list(scene.views) == ["eye"]


def attach_twice(builder: SceneBuilder, light: int, node: int) -> None:
    builder.attach_lights("point", light, node)
    builder.attach_lights("point", light, node)


@pytest.mark.parametrize(
    ("attach", "rule"),
    [
        (
            lambda builder, light, node: builder.attach_lights("torch", light, node),
            "scene-unknown-light-kind",
        ),
        (lambda builder, light, node: builder.attach_lights("point", light + 1, node), "scene-bad-index"),
        (lambda builder, light, node: builder.attach_lights("point", -1, node), "scene-bad-index"),
        (lambda builder, light, node: builder.attach_lights("point", light, node + 1), "scene-bad-index"),
        (lambda builder, light, node: builder.attach_lights("point", light, [node] * 2), "scene-bad-index"),
        (
            lambda builder, light, node: builder.attach_lights("point", [light] * 2, node),
            "scene-shared-light",
        ),
        (attach_twice, "scene-shared-light"),
        (lambda builder, light, node: builder.attach_view("nobody", node), "camera-unknown-name"),
        (lambda builder, light, node: builder.attach_view("eye", node + 1), "scene-bad-index"),
    ],
)
def test_a_wrong_argument_is_refused_and_nothing_is_attached(attach: Any, rule: str) -> None:
    builder = make_boxes((0, 0, 0))
    light, node = builder.lights.add_point((0, 3, 0), 5.0), builder.add_node(dynamic=True)
    assert refused_rule(lambda: attach(builder, light, node)) == rule
    scene = builder.build()
    expected = [node] if attach is attach_twice else []
    assert scene.attachments.nodes.tolist() == [scene.nodes.index_of_id[row] for row in expected]


# -- files ---------------------------------------------------------------------------------------------------


def make_moving_file() -> GltfDocument:
    """A triangle that moves along x for a second, with a light on it and a camera below that."""
    document = GltfDocument(
        nodes=[
            {"name": "cart", "mesh": 0, "children": [1, 2]},
            {"name": "mast", "translation": [0, 1, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"name": "driver", "translation": [0, 0, 4], "camera": 0},
            {"name": "still", "translation": [9, 0, 0], "extensions": {"KHR_lights_punctual": {"light": 0}}},
        ],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 90.0, "range": 8.0}]}},
        extensionsUsed=["KHR_lights_punctual"],
    )
    document.mesh()
    document.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    document.animate(0, "translation", [0, 1], [[0, 0, 0], [10, 0, 0]])
    document.animate(0, "rotation", [0, 1], [rotation_quaternion(0, 1), rotation_quaternion(90, 1)])
    return document


@pytest.fixture
def moving(tmp_path: Path) -> Scene:
    return load_model(make_moving_file().write(tmp_path / "moving.glb"))


def test_lights_and_cameras_of_a_file_move_with_their_nodes(moving: Scene) -> None:
    assert moving.omissions == ()
    assert moving.attachments.nodes.tolist() == [moving.nodes.find("mast"), moving.nodes.find("driver")]
    view = moving.view_at("driver", 0.5)
    still, moved = sorted(moving.lights.point["position"].tolist(), key=lambda point: point[1])
    assert still == [9.0, 0.0, 0.0]
    assert moved == pytest.approx([5.0, 1.0, 0.0])
    assert view.position == pytest.approx([5.0 + 4.0 * np.sqrt(0.5), 0.0, 4.0 * np.sqrt(0.5)], abs=1e-6)
    assert view.forward == pytest.approx([-np.sqrt(0.5), 0.0, -np.sqrt(0.5)], abs=1e-6)


def test_a_saved_scene_keeps_lights_and_views_at_nodes_in_their_order(tmp_path: Path) -> None:
    builder = make_boxes((0, 0, 0))
    node = builder.add_node(translation((1.0, 2.0, 3.0)) @ turn(30.0), dynamic=True, name="mast")
    rows = builder.lights.add_points([(1.0, 0, 0), (2.0, 0, 0), (3.0, 0, 0)], 5.0, intensity=[1.0, 2.0, 3.0])
    builder.attach_lights("point", rows[[0]], node)
    builder.lights.add_spot((0, 1, 0), (0, 0, 1), 4.0, 0.1, 0.2)
    builder.attach_lights("spot", 0, node)
    builder.views = {"ride": Camera.look_at((0, 0, 4), (0, 0, 0), projection=Perspective(1.0)), "eye": EYE}
    builder.attach_view("ride", node)
    scene = builder.build()
    save_scene(scene, tmp_path / "mast.glb")
    loaded = load_model(str(tmp_path / "mast.glb"))
    for each in (scene, loaded):
        each.nodes.set_local(each.nodes.find("mast"), translation((5.0, 0.0, 0.0)) @ turn(-20.0, axis=0))
        each.refresh()
    assert list(loaded.views) == list(scene.views)
    for name in scene.views:
        assert loaded.views[name].position == pytest.approx(scene.views[name].position)
        assert loaded.views[name].rotation == pytest.approx(scene.views[name].rotation)
    for kind in ("point", "spot"):
        saved, original = getattr(loaded.lights, kind), getattr(scene.lights, kind)
        assert saved["position"] == pytest.approx(original["position"])
        assert saved["intensity"] == pytest.approx(original["intensity"])
    assert loaded.lights.spot["direction"] == pytest.approx(scene.lights.spot["direction"], abs=1e-6)
    assert len(loaded.nodes) == len(scene.nodes)


# -- commands ------------------------------------------------------------------------------------------------


def test_frames_of_a_moving_view_are_as_of_their_times(moving: Scene) -> None:
    frames = parse_path_frames("driver", moving, range(0, 31, 15))
    assert [frame.camera.position[0] for frame in frames] == pytest.approx(
        [10 * t + 4 * np.sin(np.radians(90 * t)) for t in (0.0, 0.25, 0.5)], abs=1e-5
    )
    assert parse_camera("driver", moving, 15).position.tolist() == frames[1].camera.position.tolist()


def test_a_film_follows_a_moving_view(moving: Scene) -> None:
    camera = resolve_camera("driver", moving)
    film = SceneFilm(moving, camera, SIZE, backend="null")
    positions = [
        film.path_frame(number).camera.position[0] for number in list_frames(range(0, 60, 30), camera)
    ]
    assert positions == pytest.approx([0.0, 5.0 + 4.0 * np.sqrt(0.5)], abs=1e-5)
    assert refused_rule(lambda: list_frames(None, camera)) == "camera-frame-range"


def test_the_viewer_shows_a_moving_view_as_of_the_time_of_the_scene(moving: Scene) -> None:
    follower = ViewFollower(moving, "driver", 0.0)
    follower.advance(0.1, 0.5)
    assert follower.camera.position[0] == pytest.approx(5.0 + 4.0 * np.sqrt(0.5), abs=1e-5)
    assert not follower.is_over
    assert refused_rule(lambda: moving.view_at("nobody", 0.0)) == "camera-unknown-name"


def test_lights_and_views_at_nodes_travel_to_the_workers_of_a_film(moving: Scene) -> None:
    copied = pickle.loads(pickle.dumps(moving))
    assert copied.view_at("driver", 0.5).position.tolist() == moving.view_at("driver", 0.5).position.tolist()
    assert copied.lights.point["position"].tolist() == moving.lights.point["position"].tolist()
