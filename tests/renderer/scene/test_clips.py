"""Clips: when they play, what their weights are, and what several of them make of a node."""

import numpy as np
import pytest
from frames import SIZE, first_view_camera, open_renderer, read_colors
from gltf_documents import GltfDocument, make_morphing, make_skinned, rotation_quaternion
from hypothesis import given, settings
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from refusals import refused_rule

from renderer.content import load_model, save_scene
from renderer.content.gltf.tracks import slerp
from renderer.scene import Camera
from renderer.scene.clips import Clip, Clips
from rhi.errors import ValidationError


@pytest.fixture
def clip():
    """A clip of 2 s that loops from the scene's time 0 on."""
    clips = Clips()
    return Clip(clips, clips.add("walk", 2.0, is_played=True))


def load(tmp_path, *clips, nodes=None, name="a.glb"):
    """A scene whose clips have the channels (node, path, times, values)."""
    document = GltfDocument(nodes=nodes or [{"name": "body", "mesh": 0}, {"name": "hat", "mesh": 0}])
    document.mesh()
    for channels in clips:
        number = None
        for node, path, times, values in channels:
            number = document.animate(node, path, times, values, animation=number)
    return load_model(document.write(tmp_path / name))


def moves(node, distance, seconds=1.0):
    return node, "translation", [0, seconds], [[0, 0, 0], [distance, 0, 0]]


def x_at(scene, now, name="body"):
    scene.update(now)
    return scene.nodes.world[scene.nodes.find(name), 0, 3]


def test_a_clip_loops_from_when_it_is_played(clip):
    assert [clip.time_at(now) for now in (0.0, 1.5, 2.5)] == [0.0, 1.5, 0.5]
    clip.play(10.0, at=0.5)
    assert [clip.time_at(now) for now in (10.0, 11.0, 11.75)] == [0.5, 1.5, 0.25]


def test_a_clip_that_does_not_loop_stays_at_its_end(clip):
    clip.play(1.0, loops=False)
    assert [clip.time_at(now) for now in (0.0, 1.0, 2.0, 3.0, 9.0)] == [0.0, 0.0, 1.0, 2.0, 2.0]


def test_a_clip_runs_at_its_speed_forwards_backwards_or_stands_still(clip):
    clip.play(0.0, speed=3.0)
    assert clip.time_at(0.5) == 1.5
    clip.play(0.0, at=2.0, speed=-1.0, loops=False)
    assert [clip.time_at(now) for now in (0.5, 5.0)] == [1.5, 0.0]
    clip.play(0.0, at=1.25, speed=0.0)
    assert clip.time_at(7.0) == 1.25


def test_a_clip_is_sought_and_keeps_speed_and_weight(clip):
    clip.play(0.0, speed=0.5, weight=0.25)
    clip.seek(4.0, 1.0)
    assert (clip.time_at(5.0), clip.weight_at(5.0)) == (1.5, 0.25)


def test_a_weight_fades_and_another_fade_begins_where_it_is(clip):
    clip.stop(1.0, fade=2.0)
    assert [clip.weight_at(now) for now in (0.0, 1.0, 1.5, 3.0, 4.0)] == [1.0, 1.0, 0.75, 0.0, 0.0]
    clip.play(1.5, fade=1.0, weight=0.5)
    assert [clip.weight_at(now) for now in (1.5, 2.0, 2.5)] == [0.75, 0.625, 0.5]
    clip.stop(2.0)
    assert clip.weight_at(2.0) == 0.0


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"weight": -0.1}, "scene-bad-clip"),
        ({"weight": np.inf}, "scene-bad-clip"),
        ({"fade": -1.0}, "scene-bad-clip"),
        ({"at": np.nan}, "scene-not-finite"),
        ({"speed": np.inf}, "scene-not-finite"),
    ],
)
def test_a_bad_order_is_refused_and_changes_nothing(clip, values, rule):
    before = clip.clips._rows.copy()
    with pytest.raises(ValidationError, match=rule):
        clip.play(1.0, **values)
    assert refused_rule(lambda: clip.stop(1.0, fade=-1.0)) == "scene-bad-clip"
    assert refused_rule(lambda: clip.seek(1.0, np.inf)) == "scene-not-finite"
    assert clip.clips._rows.tobytes() == before.tobytes()
    assert clip.clips.version == 0
    clip.play(1.0, weight=0.0, fade=0.0)
    assert clip.clips.version > 0


def test_clips_have_the_names_of_their_file_and_know_their_nodes(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0, "children": [1]}, {"mesh": 0}])
    document.mesh()
    document.animate(1, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]])
    document.animate(0, "scale", [0, 3], [[1, 1, 1], [2, 2, 2]])
    document.animate(1, "rotation", [0, 1], [rotation_quaternion(0), rotation_quaternion(90)], animation=1)
    document.values["animations"][0]["name"] = document.values["animations"][1]["name"] = "wave"
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert list(scene.clips) == ["wave", "wave'"]
    assert [clip.nodes.tolist() for clip in scene.clips.values()] == [[1], [0, 1]]
    assert [clip.duration for clip in scene.clips.values()] == [1.0, 3.0]
    save_scene(scene, tmp_path / "b.glb")
    again = load_model(str(tmp_path / "b.glb")).clips
    assert {name: (clip.duration, clip.nodes.tolist()) for name, clip in again.items()} == {
        name: (clip.duration, clip.nodes.tolist()) for name, clip in scene.clips.items()
    }


def test_a_clip_that_shares_a_node_with_an_earlier_clip_waits_as_a_whole(tmp_path):
    scene = load(tmp_path, [moves(0, 2)], [moves(0, 8), moves(1, 4)], [moves(1, 6)])
    assert [clip.weight_at(0.0) for clip in scene.clips.values()] == [1.0, 0.0, 1.0]
    assert [x_at(scene, 0.5, name) for name in ("body", "hat")] == [1.0, 3.0]


def test_playing_alone_stops_only_clips_that_move_the_same_nodes(tmp_path):
    scene = load(tmp_path, [moves(0, 2)], [moves(0, 8)], [moves(1, 6)])
    scene.clips["animation 1"].play(0.0, alone=True)
    assert [clip.weight_at(0.0) for clip in scene.clips.values()] == [0.0, 1.0, 1.0]


def test_several_clips_make_the_mean_by_their_weights_and_none_the_rest(tmp_path):
    nodes = [{"name": "body", "mesh": 0, "translation": [7, 0, 0]}]
    scene = load(tmp_path, [moves(0, 2)], [moves(0, 8)], nodes=nodes)
    first, second = scene.clips.values()
    second.play(0.0, weight=3.0)
    assert x_at(scene, 0.5) == pytest.approx((1.0 * 1 + 3.0 * 4) / 4)
    first.play(0.0, weight=0.25)
    second.stop(0.0)
    assert x_at(scene, 0.5) == 1.0  # alone its weight doesn't matter
    first.stop(0.0)
    assert x_at(scene, 0.5) == 7.0


def test_a_fade_leads_from_one_clip_to_the_other(tmp_path):
    scene = load(tmp_path, [(0, "translation", [0, 1], [[2, 0, 0], [2, 0, 0]])], [moves(0, 8, 8.0)])
    scene.clips["animation 1"].play(1.0, fade=2.0, alone=True)
    expected = {1.0: 2.0, 1.5: 0.75 * 2 + 0.25 * 0.5, 2.0: 0.5 * 2 + 0.5 * 1, 3.0: 2.0, 5.0: 4.0}
    assert {now: x_at(scene, now) for now in expected} == pytest.approx(expected)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_blended_rotations_turn_the_shorter_way(tmp_path, sign):
    """A quaternion and its opposite are the same rotation. Half of 0° and half of 80° is 40°, by symmetry."""
    still = lambda quaternion: (0, "rotation", [0, 1], [quaternion, quaternion])  # noqa: E731
    scene = load(tmp_path, [still(rotation_quaternion(0))], [still(sign * rotation_quaternion(80))])
    scene.clips["animation 1"].play(0.0)
    scene.update(0.5)
    x, y = scene.nodes.world[0, :2, 0]
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(40.0, abs=1e-5)
    assert slerp(rotation_quaternion(0)[None], sign * rotation_quaternion(80)[None], np.array([0.5]))[
        0
    ] == pytest.approx(rotation_quaternion(40), abs=1e-6)


def test_morphs_and_bones_follow_their_clips(tmp_path):
    morphing = make_morphing()
    morphing.animate(0, "weights", [0, 1], [1, 1, 1, 1])
    scene = load_model(morphing.write(tmp_path / "m.glb"))
    simulator = scene.make_simulator()
    simulator.begin_frame(0.0)
    simulator.advance(simulator.objects)
    positions = [simulator.read_vertices(0)["position"][0].tolist()]
    scene.clips["animation 1"].play(0.0, alone=True)
    simulator.begin_frame(0.0)  # at the same time
    simulator.advance(simulator.objects)
    positions.append(simulator.read_vertices(0)["position"][0].tolist())
    assert positions == [[0, 0, 0], [4, 8, 0]]

    skinned = make_skinned()
    skinned.animate(2, "rotation", [0, 2], [rotation_quaternion(-90), rotation_quaternion(-90)])
    scene = load_model(skinned.write(tmp_path / "s.glb"))
    simulator = scene.make_simulator()
    for name, x in (("animation 0", -1.0), ("animation 1", 1.0)):
        scene.clips[name].play(0.0, alone=True)
        simulator.begin_frame(1.0)
        simulator.advance(simulator.objects)
        assert np.sign(simulator.read_vertices(0)["position"][-1, 0]) == x


@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_nothing_leaves_its_bounds_whatever_is_played(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    skinned = make_skinned()
    for node in (1, 2, 2):
        turns = [rotation_quaternion(degrees) for degrees in rng.uniform(-70, 70, 3)]
        skinned.animate(node, "rotation", [0, 0.5, 1.5], turns)
    scene = load_model(skinned.write(tmp_path_factory.mktemp("clips") / "s.glb"))
    simulator, now = scene.make_simulator(), 0.0
    for _ in range(12):
        clip = list(scene.clips.values())[rng.integers(len(scene.clips))]
        if rng.random() < 0.3:
            clip.stop(now, fade=rng.random())
        else:
            clip.play(now, at=rng.uniform(-3, 3), speed=rng.normal(), weight=rng.random(), fade=rng.random())
        for _ in range(3):
            now += 0.4 * rng.random()
            simulator.begin_frame(now)
            simulator.advance(simulator.objects)
            simulator.check_bounds(0)


def show(renderer, camera, seconds):
    """The image and the number of draws of a frame."""
    result = renderer.render(camera, seconds)
    return read_colors(result), result.statistics.draws


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("algorithm", ["frustum", "chc_plus_plus", "two_pass"])
def test_a_clip_is_drawn_as_if_its_file_had_no_other(tmp_path, device, algorithm):
    """It is played between two frames of the same time, and sought while nothing of it is in view."""
    swing = (0, "rotation", [0, 1], [rotation_quaternion(0), rotation_quaternion(120)])
    both = load(tmp_path, [moves(0, 2)], [swing, moves(1, -3)])
    single_clip = load(tmp_path, [swing, moves(1, -3)], name="b.glb")
    eye = first_view_camera(both).with_aspect(SIZE[0] / SIZE[1])
    away = Camera.look_at((0.0, 0.0, 90.0), (0.0, 0.0, 99.0)).with_aspect(SIZE[0] / SIZE[1])
    with open_renderer(device, both, visibility=algorithm) as renderer:
        before = read_colors(renderer.render(eye, 0.25))
        both.clips["animation 1"].play(0.0, alone=True)
        frames = [show(renderer, eye, 0.25)]
        hidden = renderer.render(away, 0.3).statistics
        both.clips["animation 1"].seek(0.35, 0.8)
        frames.append(show(renderer, eye, 0.4))
    assert (before != frames[0][0]).any()
    assert (hidden.draws, hidden.skipped_simulations) == (0, 2)
    with open_renderer(device, single_clip, visibility=algorithm) as renderer:
        for seconds, (image, draws) in zip((0.25, 0.85), frames, strict=True):
            expected = show(renderer, eye, seconds)
            assert (expected[0] == image).all()
            assert expected[1] == draws == 2
