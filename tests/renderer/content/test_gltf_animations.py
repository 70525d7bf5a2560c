"""Animations of glTF files: their values, what is moved, and bounds that hold at all times."""

import numpy as np
import pytest
from gltf_documents import GltfDocument, rotation_quaternion
from hypothesis import given, settings
from hypothesis import strategies as st

from renderer.content import load_model
from renderer.content.gltf.tracks import CUBIC, LINEAR, ROTATION, SCALE, STEP, TRANSLATION, NodeMotion, Track
from renderer.scene.clips import Clips

REST = (np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), np.ones((1, 3)))


def animated(path, times, values, kind="LINEAR", nodes=None):
    document = GltfDocument(nodes=nodes or [{"mesh": 0}])
    document.mesh()
    document.animate(len(document.values["nodes"]) - 1, path, times, values, kind)
    return document


def position(scene, seconds, row=0):
    scene.update(seconds)
    return scene.nodes.world[row]


def left_out(scene):
    return {omission.what: omission.count for omission in scene.omissions}


@pytest.mark.parametrize(
    ("kind", "values", "expected"),
    [
        ("LINEAR", [[0, 0, 0], [4, 0, 0]], {0: 0, 0.5: 1, 1: 2, 1.5: 3, 2.5: 1}),
        ("STEP", [[0, 0, 0], [4, 0, 0]], {0: 0, 1: 0, 1.99: 0, 2.5: 0}),
        # Tangents of 0: smooth from 0 to 4.
        (
            "CUBICSPLINE",
            [[0] * 3, [0] * 3, [0] * 3, [0] * 3, [4, 0, 0], [0] * 3],
            {0: 0, 0.5: 0.625, 1: 2, 1.5: 3.375},
        ),
        # Tangents of 2 a second: straight.
        ("CUBICSPLINE", [[0] * 3, [0] * 3, [2, 0, 0], [2, 0, 0], [4, 0, 0], [0] * 3], {0.5: 1, 1: 2, 1.5: 3}),
    ],
)
def test_a_translation_follows_its_keys_and_begins_again(tmp_path, kind, values, expected):
    scene = load_model(animated("translation", [0, 2], values, kind).write(tmp_path / "a.glb"))
    for seconds, x in expected.items():
        assert position(scene, seconds)[0, 3] == pytest.approx(x), seconds


def test_before_its_first_key_a_track_has_the_first_value(tmp_path):
    scene = load_model(animated("translation", [1, 2], [[3, 0, 0], [5, 0, 0]]).write(tmp_path / "a.glb"))
    assert [position(scene, seconds)[0, 3] for seconds in (0, 0.5, 1, 1.5)] == [3, 3, 3, 4]


def test_a_rotation_takes_the_shorter_way_at_constant_speed(tmp_path):
    far = -rotation_quaternion(90)  # the same rotation, on the other side of the sphere
    scene = load_model(animated("rotation", [0, 3], [rotation_quaternion(0), far]).write(tmp_path / "a.glb"))
    for seconds, degrees in ((1, 30), (2, 60)):
        x, y = position(scene, seconds)[:2, 0]
        assert np.degrees(np.arctan2(y, x)) == pytest.approx(degrees, abs=1e-4)


def test_a_scale_and_a_rotation_keep_the_translation_of_the_node(tmp_path):
    document = animated(
        "scale", [0, 1], [[1, 1, 1], [3, 1, 1]], nodes=[{"mesh": 0, "translation": [7, 0, 0]}]
    )
    document.animate(0, "rotation", [0, 1], [rotation_quaternion(0), rotation_quaternion(90)])
    world = position(load_model(document.write(tmp_path / "a.glb")), 0.5)
    assert world[:3, 3].tolist() == [7, 0, 0]
    assert np.linalg.norm(world[:3, 0]) == pytest.approx(2.0)


def test_animations_of_different_nodes_are_played_together(tmp_path):
    document = animated("translation", [0, 1], [[0, 0, 0], [2, 0, 0]], nodes=[{"mesh": 0}, {"mesh": 0}])
    document.animate(0, "translation", [0, 4], [[0, 0, 0], [4, 0, 0]])
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert [position(scene, 2.5, row)[0, 3] for row in (0, 1)] == [2.5, 1.0]
    assert left_out(scene) == {}


@pytest.mark.parametrize(
    ("target", "what"),
    [
        ({"path": "pointer"}, "animations of something else than a node"),
        ({"node": 0, "path": "x"}, "animations of 'x'"),
    ],
)
def test_animation_channels_with_unsupported_targets_are_listed(tmp_path, target, what):
    document = animated("translation", [0, 1], [[0, 0, 0], [2, 0, 0]])
    document.animate(0, "translation", [0, 1], [[0, 0, 0], [2, 0, 0]], animation=0)
    document.values["animations"][0]["channels"][1]["target"] = target
    assert left_out(load_model(document.write(tmp_path / "a.glb"))) == {what: 1}


def test_only_visible_objects_are_animated_and_their_bounds_never_change(tmp_path):
    scene = load_model(animated("translation", [0, 1], [[0, 0, 0], [2, 0, 0]]).write(tmp_path / "a.glb"))
    assert scene.objects.simulated.tolist() == [True]
    assert scene.objects.lower[0] == pytest.approx([0, 0, 0], abs=1e-6)
    assert scene.objects.upper[0] == pytest.approx([3, 1, 0], abs=1e-6)


def test_bounds_of_a_rotation_are_those_of_the_box_that_it_sweeps(tmp_path):
    scene = load_model(
        animated("rotation", [0, 1], [rotation_quaternion(0), rotation_quaternion(90)]).write(
            tmp_path / "a.glb"
        )
    )
    # The corner (1, 1) goes from 45° to 135°, and (1, 0) to (0, 1).
    assert scene.objects.lower[0] == pytest.approx([-1, 0, 0], abs=0.15)
    assert scene.objects.upper[0] == pytest.approx([1, np.sqrt(2), 0], abs=0.15)


def test_bounds_hold_below_several_animated_nodes(tmp_path):
    nodes = [
        {"children": [1], "translation": [10, 0, 0], "rotation": rotation_quaternion(30).tolist()},
        {"children": [2]},
        {"children": [3], "scale": [2, 1, 1], "translation": [0, 1, 0]},
        {"mesh": 0},
    ]
    document = animated(
        "rotation", [0, 0.7], [rotation_quaternion(0, 0), rotation_quaternion(170, 0)], nodes=nodes
    )
    document.animate(
        1, "rotation", [0, 1, 2], [rotation_quaternion(0), rotation_quaternion(120), rotation_quaternion(200)]
    )
    document.animate(1, "translation", [0, 1.3], [[0, 0, 0], [0, 2, 1]])
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert scene.objects.boxes.node[0] == 0
    scene.check_bounds(np.linspace(0.0, 6.0, 61))


@pytest.mark.parametrize(
    "nodes", [[{"mesh": 0, "matrix": np.eye(4).ravel().tolist()}], [{"mesh": 0}]], ids=["matrix", "parts"]
)
def test_the_animation_of_a_node_with_a_matrix_is_listed(tmp_path, nodes):
    document = animated("translation", [0, 1], [[0, 0, 0], [2, 0, 0]], nodes=nodes)
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert left_out(scene) == ({"animations of nodes with a matrix": 1} if "matrix" in nodes[0] else {})


def make_track(rng, target, kind, keys, clip=0, spread=1.0):
    """Random values; rotations are `spread` around the same one."""
    size = 4 if target == ROTATION else 3
    values = rng.normal(size=(keys, 3, size) if kind == CUBIC else (keys, size))
    if target == ROTATION:
        values = 0.5 * (1.0 - spread) + spread * values
        middle = values[:, 1] if kind == CUBIC else values
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    times = np.cumsum(rng.uniform(0.1, 1.0, keys)) - 0.1
    return Track(target, kind, times, values, clip)


def make_clips(tracks, is_played=lambda clip: True):
    """A clip of its own for each track, a little longer than it."""
    clips = Clips()
    for number, track in enumerate(tracks):
        clips.add("", float(track.times[-1]) * 1.25, is_played=is_played(number))
    return clips


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.sampled_from([TRANSLATION, ROTATION, SCALE]), min_size=1, max_size=5),
    st.sampled_from([STEP, LINEAR, CUBIC]),
    st.integers(1, 5),
    st.booleans(),
    st.sampled_from([1.0, 0.2, 0.05]),
)
def test_no_point_of_a_box_ever_leaves_the_reach_of_its_motion(seed, targets, kind, keys, weighted, spread):
    rng = np.random.default_rng(seed)
    tracks = [make_track(rng, target, kind, keys, clip, spread) for clip, target in enumerate(targets)]
    clips = make_clips(tracks)
    motion = NodeMotion(tracks, np.zeros(len(tracks), np.int64), REST, clips)
    ends = np.sort(rng.normal(size=(2, 3)), axis=0)
    lower, upper = motion.reach(0, *ends)
    corners = np.array(
        [[ends[i, 0], ends[j, 1], ends[k, 2], 1] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    for seconds in np.concatenate([rng.uniform(0, 8, 40), *(track.times for track in tracks)]):
        for clip in range(len(tracks)):
            clips.change(clip, weight=max(rng.normal(), 0.0) if weighted else 1.0)
        motion.set_time(np.zeros(1, np.int64), float(seconds))
        points = corners @ motion.transforms(np.zeros(1, np.int64))[0].T
        assert (points[:, :3] >= lower).all()
        assert (points[:, :3] <= upper).all()


def test_tracks_of_many_nodes_are_found_by_one_search():
    rng = np.random.default_rng(5)
    tracks = [
        make_track(rng, TRANSLATION, LINEAR, int(keys), n) for n, keys in enumerate(rng.integers(1, 9, 50))
    ]
    rest = tuple(np.repeat(part, 50, axis=0) for part in REST)
    motion = NodeMotion(tracks, np.arange(50), rest, make_clips(tracks))
    motion.set_time(np.arange(50), 1.234)
    positions = motion.transforms(np.arange(50))[:, :3, 3]
    for track, position in zip(tracks, positions, strict=True):
        local = 1.234 % (track.times[-1] * 1.25)
        expected = [np.interp(local, track.times, track.values[:, axis]) for axis in range(3)]
        assert position == pytest.approx(expected, abs=1e-9)


def test_a_copy_of_a_motion_has_a_state_of_its_own():
    from copy import deepcopy

    track = Track(TRANSLATION, LINEAR, np.array([0.0, 1.0]), np.array([[0.0] * 3, [2.0, 0, 0]]), 0)
    motion = NodeMotion([track], np.zeros(1, np.int64), REST, make_clips([track]))
    other = deepcopy(motion)
    motion.set_time(np.zeros(1, np.int64), 0.5)
    assert [state.transforms(np.zeros(1, np.int64))[0, 0, 3] for state in (motion, other)] == [1.0, 0.0]


def test_the_reach_of_blended_rotations_follows_how_far_apart_they_are():
    """A mean of turns by up to 10° stays near them; one of turns to opposite sides may be any."""

    def find_lowest(*clips):
        """The least x and y of what the point (1, 0, 0) becomes, if each clip turns through some angles."""
        tracks = [
            Track(
                ROTATION,
                LINEAR,
                np.arange(len(angles)),
                np.array([rotation_quaternion(angle) for angle in angles]),
                clip,
            )
            for clip, angles in enumerate(clips)
        ]
        motion = NodeMotion(tracks, np.zeros(len(tracks), np.int64), REST, make_clips(tracks))
        return motion.reach(0, np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]))[0][:2]

    near = 2 * np.sin(np.radians(5))
    assert find_lowest([-10], [10]) == pytest.approx([1 - near, -near], abs=1e-5)
    assert find_lowest([-10, 10], [10, -10]) == pytest.approx([1 - near, -near], abs=1e-3)
    assert find_lowest([-100], [100]) == pytest.approx([-1, -1], abs=1e-5)
