"""Hard skins and morph targets: joints that coincide or collapse, weights of any sum and size, and targets that
cancel, against the formulas of glTF in float64."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_documents import CORNERS, STRIP, TRIANGLE, UP, GltfDocument, rotation_quaternion

from renderer.content import load_model
from renderer.scene import Scene
from rhi.errors import ValidationError

Array = np.ndarray[Any, Any]
SLANTED = np.tile(np.float32([[0.6, 0.0, 0.8]]), (len(STRIP), 1))
TIMES = (0.0, 0.5, 1.0)


@dataclass(frozen=True)
class Skin:
    """A strip of two joints: the second hangs on the first, and turns by 90° within a second.

    Attributes:
        weights: (10, 4), as the file has them.
        joints: (10, 4), indices into `chain`.
        scales: (2, 3) of the joints; the second is multiplied by `final` at 1 s.
        binds: scales of the inverse bind matrices.
        chain: the nodes that the skin lists.
    """

    weights: Array
    joints: Array = field(default_factory=lambda: np.tile(np.uint8([[0, 1, 0, 0]]), (len(STRIP), 1)))
    scales: tuple[tuple[float, float, float], tuple[float, float, float]] = ((1, 1, 1), (1, 1, 1))
    final: tuple[float, float, float] = (1, 1, 1)
    binds: tuple[float, float] = (1.0, 1.0)
    offset: float = 2.0
    chain: tuple[int, ...] = (0, 1)


def share(first: float = 1.0, second: float = 1.0) -> Array:
    """Weights that go from the first joint to the second along the strip, each multiplied."""
    part = STRIP[:, 1] / 4
    with np.errstate(all="ignore"):
        return np.stack([first * (1 - part), second * part, 0 * part, 0 * part], 1).astype(np.float32)


def in_four(values: tuple[float, ...]) -> Array:
    """The same four weights for each vertex."""
    return np.tile(np.float32([values]), (len(STRIP), 1))


def joints_of(*indices: int) -> Array:
    """The same four joints for each vertex."""
    return np.tile(np.uint8([indices]), (len(STRIP), 1))


SKINS = {
    "plain": Skin(share()),
    "joints at one position": Skin(share(), offset=0.0),
    "the same joint four times": Skin(in_four((0.25,) * 4), joints_of(1, 1, 1, 1)),
    "the same joint twice with others": Skin(in_four((0.25,) * 4), joints_of(1, 0, 1, 0)),
    "a node listed twice": Skin(in_four((0.25,) * 4), joints_of(0, 1, 2, 2), chain=(0, 1, 1)),
    "a joint of scale zero": Skin(share(), scales=((1, 1, 1), (0, 0, 0))),
    "a joint flat along x": Skin(share(), scales=((1, 1, 1), (0, 1, 1))),
    "a joint flat along z": Skin(share(), scales=((1, 1, 1), (1, 1, 0))),
    "a joint that shrinks to nothing": Skin(share(), final=(0, 0, 0)),
    "a joint of denormal scale": Skin(share(), scales=((1, 1, 1), (1e-40, 1e-40, 1e-40))),
    "a mirrored joint": Skin(share(), scales=((1, 1, 1), (-1, 1, 1))),
    "tiny joints with huge binds": Skin(share(), scales=((1e-18,) * 3, (1, 1, 1)), binds=(1e18, 1e18)),
    "huge joints with tiny binds": Skin(share(), scales=((1e18,) * 3, (1, 1, 1)), binds=(1e-18, 1e-18)),
    "stretched joints": Skin(share(), scales=((1, 1, 1), (8, 0.125, 1))),
    "weights that sum to a half": Skin(share(0.5, 0.5)),
    "weights that sum to two": Skin(share(2, 2)),
    "weights that sum to 1e-3": Skin(share(1e-3, 1e-3)),
    "weights that sum to 1e-30": Skin(share(1e-30, 1e-30)),
    "weights that sum to 1e30": Skin(share(1e30, 1e30)),
    "weights near the largest float": Skin(in_four((3e38,) * 4), joints_of(0, 1, 0, 1)),
    "denormal weights": Skin(share(1e-40, 1e-40)),
    "weights of uneven sums": Skin(share(0.3, 4.0)),
    "a denormal weight beside one": Skin(in_four((1.0, 1e-42, 0, 0))),
}


def write_skin(skin: Skin, path: Path, *, moves: bool) -> str:
    """Write a file with this skin; without motion at the joints' rest."""
    document = GltfDocument(
        nodes=[
            {"name": "hip", "children": [1], "scale": list(skin.scales[0])},
            {"name": "knee", "translation": [0, skin.offset, 0], "scale": list(skin.scales[1])},
            {"name": "mesh", "mesh": 0, "skin": 0},
        ]
    )
    document.mesh(STRIP, CORNERS.ravel(), NORMAL=SLANTED, JOINTS_0=skin.joints, WEIGHTS_0=skin.weights)
    binds = make_binds(skin).astype(np.float32).transpose(0, 2, 1).reshape(-1, 16)
    document.add("skins", joints=list(skin.chain), inverseBindMatrices=document.accessor(binds))
    if moves:
        turns = [rotation_quaternion(degrees) for degrees in (0, 90, 90)]
        number = document.animate(1, "rotation", [0, 1, 2], turns)
        if skin.final != (1, 1, 1):
            scales = [skin.scales[1], skin.final, skin.final]
            document.animate(1, "scale", [0, 1, 2], scales, animation=number)
    return document.write(path)


def make_binds(skin: Skin) -> Array:
    """The inverse bind matrices (k, 4, 4)."""
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = -skin.offset
    binds[0, :3] *= skin.binds[0]
    binds[1, :3] *= skin.binds[1]
    return binds[list(skin.chain)]


def reference_skin(skin: Skin, seconds: float) -> tuple[Array, Array, Array]:
    """Positions (10, 3), normals (10, 3) of length 1 and which of them are defined, by the mean of joints."""
    angle = np.radians(90 * seconds)
    turned = np.eye(4)
    turned[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    scale = np.float64(skin.scales[1])
    if skin.final != (1, 1, 1):
        scale = scale + (np.float64(skin.final) - scale) * seconds
    scales = [np.diag([*skin.scales[0], 1.0]), np.diag([*scale, 1.0])]
    moved = np.eye(4)
    moved[1, 3] = skin.offset
    worlds = [scales[0], scales[0] @ moved @ turned @ scales[1]]
    matrices = np.stack(
        [worlds[node] @ bind for node, bind in zip(skin.chain, make_binds(skin), strict=True)]
    )
    weights = skin.weights.astype(np.float64)
    weights /= weights.sum(axis=1, keepdims=True)
    mean = np.einsum("nk,nkij->nij", weights, matrices[skin.joints])
    positions = np.einsum("nij,nj->ni", mean[:, :3, :3], STRIP.astype(np.float64)) + mean[:, :3, 3]
    cofactors = np.stack([np.cross(mean[:, (i + 1) % 3, :3], mean[:, (i + 2) % 3, :3]) for i in range(3)], 1)
    normals = np.einsum("nij,nj->ni", cofactors, SLANTED.astype(np.float64))
    sizes = np.linalg.norm(mean[:, :3, :3], axis=(1, 2))
    is_mirrored = np.linalg.det(mean[:, :3, :3]) < -1e-9 * sizes**3  # what is flat has no sign
    normals *= np.where(is_mirrored, -1.0, 1.0)[:, None]
    lengths = np.linalg.norm(normals, axis=1)
    is_defined = lengths > 1e-9 * np.maximum(sizes, 1e-300) ** 2
    return positions, normals / np.where(is_defined, lengths, 1.0)[:, None], is_defined


def read_vertices(scene: Scene, seconds: float) -> tuple[Array, Array]:
    """World positions and normals of the only object at a time."""
    simulator = scene.make_simulator()
    simulator.begin_frame(seconds)
    scene.refresh()
    deformed = simulator.advance(simulator.objects).deformed
    if deformed:
        (moved,) = deformed
        vertices = moved.simulation.vertices(moved.members)
        row = moved.object_indices[0]
    else:
        row = 0
        vertices = scene.meshes.geometry(int(scene.objects.mesh[0])).vertices
    world = scene.nodes.world[scene.objects.node[row]]
    normals = vertices["normal"] @ np.linalg.inv(world[:3, :3])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return vertices["position"] @ world[:3, :3].T + world[:3, 3], normals / np.where(lengths > 0, lengths, 1)


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
@pytest.mark.parametrize("name", SKINS)
def test_hard_skins_are_means_of_their_joints(tmp_path: Path, name: str, moves: bool) -> None:
    skin = SKINS[name]
    scene = load_model(write_skin(skin, tmp_path / "skin.glb", moves=moves))
    assert (scene.simulated != ()) == moves
    for seconds in TIMES if moves else (0.0,):
        positions, normals = read_vertices(scene, seconds)
        expected, directions, is_defined = reference_skin(skin, seconds)
        assert positions == pytest.approx(expected, abs=1e-5)
        assert normals[is_defined] == pytest.approx(directions[is_defined], abs=1e-4)
        assert np.isfinite(normals).all()
        assert (np.linalg.norm(normals, axis=1) > 0.99).all()  # a direction even where none is defined
    if moves:
        assert scene.check_bounds(np.linspace(0.0, 2.0, 21)) is None


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
def test_vertices_without_weights_follow_their_first_joint(tmp_path: Path, moves: bool) -> None:
    skin = Skin(in_four((0.0,) * 4), joints_of(1, 0, 0, 0))
    scene = load_model(write_skin(skin, tmp_path / "skin.glb", moves=moves))
    for seconds in TIMES if moves else (0.0,):
        positions, _ = read_vertices(scene, seconds)
        expected, _, _ = reference_skin(Skin(in_four((1.0, 0, 0, 0)), skin.joints), seconds)
        assert positions == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("top", [1, 3, 100])
def test_integer_weights_of_any_sum_are_means(tmp_path: Path, kind: Any, top: int) -> None:
    weights = np.round(share(top, top)).astype(kind)
    weights[weights.sum(axis=1) == 0, 0] = 1
    skin = Skin(weights)
    path = tmp_path / "skin.glb"
    document = GltfDocument(
        nodes=[
            {"children": [1]},
            {"translation": [0, 2, 0], "rotation": rotation_quaternion(90).tolist()},
            {"mesh": 0, "skin": 0},
        ]
    )
    document.mesh(STRIP, CORNERS.ravel(), NORMAL=SLANTED, JOINTS_0=skin.joints)
    attributes = document.values["meshes"][0]["primitives"][0]["attributes"]
    attributes["WEIGHTS_0"] = document.accessor(weights, normalized=True)
    binds = make_binds(skin).astype(np.float32).transpose(0, 2, 1).reshape(-1, 16)
    document.add("skins", joints=[0, 1], inverseBindMatrices=document.accessor(binds))
    positions, _ = read_vertices(load_model(document.write(path)), 0.0)
    expected, _, _ = reference_skin(skin, 1.0)
    assert positions == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
def test_weights_below_zero_count_as_zero(tmp_path: Path, moves: bool) -> None:
    weights = share()
    weights[:, 2:] = -0.25
    scene = load_model(write_skin(Skin(weights), tmp_path / "skin.glb", moves=moves))
    positions, _ = read_vertices(scene, 0.5 if moves else 0.0)
    assert positions == pytest.approx(reference_skin(Skin(share()), 0.5 if moves else 0.0)[0], abs=1e-5)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_without_number_are_refused(tmp_path: Path, value: float) -> None:
    weights = share()
    weights[3, 1] = value
    with pytest.raises(ValidationError, match="WEIGHTS_0"):
        load_model(write_skin(Skin(weights), tmp_path / "skin.glb", moves=True))


Targets = tuple[tuple[float, float, float], ...]
MORPHS: dict[str, tuple[tuple[float, ...], Targets]] = {
    "plain": ((0.5, 0.25), ((4, 0, 0), (0, 8, 0))),
    "huge weights that cancel": ((1e6, -1e6), ((0.1, 0.3, 0), (0.1, 0.3, 0))),
    "huge weights that nearly cancel": ((1e6, -1e6), ((0.1, 0.3, 0), (0.1, 0.300001, 0))),
    "three weights that cancel": ((1e7, 1.0, -1e7), ((0.3, 0, 0), (1, 2, 0), (0.3, 0, 0))),
    "weights of 1e9 that cancel": ((1e9, 1.0, -1e9), ((0.3, 0, 0), (1, 2, 0), (0.3, 0, 0))),
    "huge weights of tiny targets": ((9e29,), ((2e-30, 1e-30, 0),)),
    "huge weights of denormal targets": ((9e29,), ((2e-40, 1e-40, 0),)),
    "tiny weights of huge targets": ((1e-30,), ((9e29, 5e29, 0),)),
    "denormal weights of huge targets": ((1e-40,), ((9e29, 5e29, 0),)),
    "denormal weights": ((1e-40, 1.0), ((1, 1, 1), (0, 0, 2))),
    "weights below zero": ((-3.0,), ((0.5, 0.25, 0),)),
    "targets that undo the mesh": ((-1.0,), ((0, 0, 0),)),
}


def write_morph(
    path: Path, weights: tuple[float, ...], shifts: Targets, *, moves: bool, collapse: float = 0.0
) -> str:
    """Write a triangle with a target for each shift, plus `collapse` of the triangle itself."""
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(NORMAL=UP[:3])
    targets = [
        {"POSITION": document.accessor(np.float32(np.tile(shift, (3, 1)) + collapse * TRIANGLE))}
        for shift in shifts
    ]
    mesh = document.values["meshes"][0]
    mesh["primitives"][0]["targets"] = targets
    mesh["weights"] = list(weights)
    if moves:
        later = [0.5 * weight for weight in weights]
        document.animate(0, "weights", [0, 1, 2], [*weights, *later, *later])
    return document.write(path)


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
@pytest.mark.parametrize("name", MORPHS)
def test_hard_morph_targets_are_sums(tmp_path: Path, name: str, moves: bool) -> None:
    weights, shifts = MORPHS[name]
    collapse = 1.0 if "undo" in name else 0.0
    scene = load_model(write_morph(tmp_path / "morph.glb", weights, shifts, moves=moves, collapse=collapse))
    for seconds in TIMES if moves else (0.0,):
        stored = np.float32(weights).astype(np.float64) if moves else np.float64(weights)
        later = np.float32([0.5 * weight for weight in weights]).astype(np.float64) if moves else stored
        now = stored + (later - stored) * seconds
        moved = sum(
            weight * np.float32(np.tile(shift, (3, 1)) + collapse * TRIANGLE).astype(np.float64)
            for weight, shift in zip(now, shifts, strict=True)
        )
        positions, normals = read_vertices(scene, seconds)
        assert positions == pytest.approx(TRIANGLE + moved, abs=2e-6, rel=1e-6)
        assert (np.linalg.norm(normals, axis=1) > 0.99).all()
    if moves:
        assert scene.check_bounds(np.linspace(0.0, 2.0, 21)) is None


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
def test_normals_that_targets_cancel_are_those_at_rest(tmp_path: Path, moves: bool) -> None:
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(NORMAL=UP[:3])
    target = {
        "POSITION": document.accessor(np.zeros((3, 3), np.float32)),
        "NORMAL": document.accessor(-UP[:3]),
    }
    mesh = document.values["meshes"][0]
    mesh["primitives"][0]["targets"], mesh["weights"] = [target], [1.0]
    if moves:
        document.animate(0, "weights", [0, 1], [1.0, 2.0])
    scene = load_model(document.write(tmp_path / "a.glb"))
    _, normals = read_vertices(scene, 0.0)
    assert normals == pytest.approx(UP[:3], abs=1e-6)


@pytest.mark.parametrize("moves", [True, False], ids=["moving", "still"])
@pytest.mark.parametrize(
    ("weights", "shifts"),
    [
        ((1e300,), ((1, 0, 0),)),
        ((1e30,), ((1e30, 0, 0),)),
        ((float("nan"),), ((1, 0, 0),)),
        ((float("inf"),), ((1, 0, 0),)),
    ],
    ids=["weights", "targets", "nan", "infinite"],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_morphs_beyond_single_floats_are_refused(
    tmp_path: Path, weights: tuple[float, ...], shifts: Targets, moves: bool
) -> None:
    with pytest.raises(ValidationError):
        load_model(write_morph(tmp_path / "morph.glb", weights, shifts, moves=moves))
