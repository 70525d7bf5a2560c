"""Skins and morph targets of glTF files: where vertices are at a time, and bounds that hold at all times."""

import os
from pathlib import Path

import numpy as np
import pytest
from gltf_documents import STRIP, TRIANGLE, UP, make_morphing, make_skinned, rotation_quaternion

from renderer.content import load_model
from rhi.errors import ValidationError

MODELS = Path(os.environ.get("RHI_TEST_MODELS", "/usr/share/assimp/models")) / "glTF2"


def vertices_at(scene, seconds):
    simulator = scene.make_simulator()
    simulator.begin_frame(seconds)
    scene.refresh()
    ((deformed,),) = [simulator.advance(simulator.objects).deformed]
    vertices = deformed.simulation.vertices(deformed.members)
    world = scene.nodes.world[scene.objects.node[deformed.object_indices[0]]]
    return vertices["position"] @ world[:3, :3].T + world[:3, 3], vertices["normal"]


@pytest.mark.parametrize("root", [None, {"translation": [7, 0, 0], "scale": [2, 2, 2]}])
def test_a_skin_moves_each_vertex_to_the_mean_of_where_its_joints_take_it(tmp_path, root):
    scene = load_model(make_skinned(root=root).write(tmp_path / "a.glb"))
    assert scene.omissions == ()
    for seconds, degrees in ((0.0, 0.0), (1.0, 90.0), (1.5, 45.0)):
        sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
        x, y = STRIP[:, 0], STRIP[:, 1] - 2
        bent = np.stack([cosine * x - sine * y, sine * x + cosine * y + 2, 0 * x], 1)
        share = (STRIP[:, 1] / 4)[:, None]
        expected = (1 - share) * STRIP + share * bent
        if root:
            expected = 2 * expected + (7, 0, 0)
        position, normal = vertices_at(scene, seconds)
        assert position == pytest.approx(expected, abs=1e-5)
        assert normal == pytest.approx(UP, abs=1e-6)


@pytest.mark.parametrize("kind", ["u1", "u2"])
def test_weights_of_joints_may_be_normalised_integers(tmp_path, kind):
    document = make_skinned()
    expected, _ = vertices_at(load_model(document.write(tmp_path / "a.glb")), 1.0)
    share = np.clip(STRIP[:, 1:2] / 4, 0, 1)
    whole = np.round(np.hstack([1 - share, share, 0 * share, 0 * share]) * np.iinfo(kind).max).astype(kind)
    attributes = document.values["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = document.accessor(whole, normalized=True)
    positions, _ = vertices_at(load_model(document.write(tmp_path / "b.glb")), 1.0)
    assert positions == pytest.approx(expected, abs=0.02 if kind == "u1" else 1e-4)


def test_a_skin_is_simulated_where_it_is_drawn_and_never_leaves_its_bounds(tmp_path):
    scene = load_model(make_skinned(root={"translation": [7, 0, 0]}).write(tmp_path / "a.glb"))
    assert scene.objects.simulated.tolist() == [True]
    assert scene.nodes.names[scene.objects.node[0]] == "hip"  # the nearest above both joints; it never moves
    scene.check_bounds(np.linspace(0.0, 4.0, 41))
    size = scene.objects.upper[0] - scene.objects.lower[0]
    assert (size < 10.0).all()  # and they are not much larger than what it sweeps


def test_a_skin_whose_joints_stand_still_is_a_mesh_like_any_other(tmp_path):
    document = make_skinned(moves=False)
    document.values["nodes"][2]["rotation"] = rotation_quaternion(90).tolist()
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert scene.simulated == ()
    last = scene.meshes.vertices["position"][-1]
    assert last[:3] == pytest.approx([-2, 3, 0], abs=1e-5)  # (1, 4, 0) turned about (0, 2, 0)


def test_weights_of_targets_follow_their_track(tmp_path):
    scene = load_model(make_morphing().write(tmp_path / "a.glb"))
    for seconds, shift in ((0.0, (0, 0, 5)), (0.5, (2, 2, 5)), (1.0, (4, 4, 5)), (1.5, (2, 6, 5))):
        position, _ = vertices_at(scene, seconds)
        assert position == pytest.approx(TRIANGLE + np.array(shift), abs=1e-5)
    assert scene.objects.lower[0] == pytest.approx([0, 0, 5], abs=1e-3)
    assert scene.objects.upper[0] == pytest.approx([5, 9, 5], abs=1e-3)
    scene.check_bounds(np.linspace(0.0, 4.0, 41))


def test_normals_of_targets_are_added(tmp_path):
    document = make_morphing(normals=True)
    _, normal = vertices_at(load_model(document.write(tmp_path / "a.glb")), 1.0)
    assert normal == pytest.approx(np.tile([[1, 0, 0]], (3, 1)), abs=1e-6)


def test_weights_without_a_track_make_a_mesh_like_any_other(tmp_path):
    scene = load_model(make_morphing(track=False).write(tmp_path / "a.glb"))
    assert scene.simulated == ()
    drawn = scene.meshes.geometry(int(scene.objects.mesh[0])).vertices["position"]
    assert drawn == pytest.approx(TRIANGLE + np.array([1, 0, 0]))


def test_weights_of_zero_share_the_mesh(tmp_path):
    scene = load_model(make_morphing(track=False, weights=(0, 0)).write(tmp_path / "a.glb"))
    assert len(scene.meshes) == 1


def test_a_morphing_mesh_below_an_animated_node_keeps_to_its_bounds(tmp_path):
    document = make_morphing()
    document.animate(0, "rotation", [0, 1.3], [rotation_quaternion(0, 0), rotation_quaternion(150, 0)])
    scene = load_model(document.write(tmp_path / "a.glb"))
    scene.check_bounds(np.linspace(0.0, 5.0, 51))


@pytest.mark.parametrize(
    ("change", "location"),
    [
        (lambda values: values["skins"][0].update(joints=[]), "skins[0].joints"),
        (lambda values: values["skins"][0].update(joints=[1]), "meshes[0].primitives[0].attributes.JOINTS_0"),
        (lambda values: values["skins"][0].update(joints=[1, 2, 3]), "accessors["),
        (lambda values: values["nodes"][3].update(skin=1), "nodes[3].skin"),
    ],
)
def test_broken_skins_are_refused(tmp_path, change, location):
    document = make_skinned()
    change(document.values)
    with pytest.raises(ValidationError) as error:
        load_model(document.write(tmp_path / "bad.glb"))
    assert f"bad.glb: {location}" in error.value.given


def test_targets_that_do_not_fit_their_weights_are_refused(tmp_path):
    document = make_morphing(track=False)
    document.values["meshes"][0]["weights"] = [1.0]
    with pytest.raises(ValidationError, match=r"meshes\[0\]\.weights"):
        load_model(document.write(tmp_path / "bad.glb"))


@pytest.mark.skipif(not MODELS.is_dir(), reason=f"there is no {MODELS}: install assimp-testmodels")
@pytest.mark.parametrize(
    "name",
    ["simple_skin/simple_skin.gltf", "glTF-Sample-Models/AnimatedMorphCube-glTF/AnimatedMorphCube.gltf"],
)
def test_files_of_others_keep_to_their_bounds(name):
    scene = load_model(str(MODELS / name))
    assert scene.objects.simulated.all()
    scene.check_bounds(np.linspace(0.0, 6.0, 61))
