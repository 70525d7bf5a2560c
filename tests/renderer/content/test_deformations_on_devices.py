"""Skins and morph targets computed on devices: as NumPy computes them, and only for what is drawn."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_documents import GltfDocument, make_morphing, make_skinned, rotation_quaternion
from nightly_reasons import ONLY_KERNELS
from test_hard_deformations import MORPHS, SKINS, TIMES, write_morph, write_skin

import rhi
from renderer.content import load_model
from renderer.renderer import Renderer
from renderer.scene import Camera, DeviceVertexSimulation, Scene
from renderer.scene.deformation import DeformableMesh, DeformationBuffers, Pose
from renderer.scene.meshes import make_geometry
from renderer.techniques import Deferred, Forward
from renderer.visibility import FrustumCulling
from rhi import Op
from rhi.backends.null import PROFILES

Array = np.ndarray[Any, Any]
STRIDE, TANGENT = 12, 8
AWAY = Camera.look_at((0.0, 2.0, 30.0), (0.0, 2.0, 60.0))
TOWARDS = Camera.look_at((0.0, 2.0, 12.0), (0.0, 2.0, 0.0))


def compute_both(device: rhi.Device, scene: Scene, seconds: float) -> tuple[Array, Array]:
    """The only object's vertices at a time: as NumPy has them, and (v, 12) as the device writes them."""
    simulator = scene.make_simulator()
    simulator.begin_frame(seconds)
    scene.refresh()
    (moved,) = simulator.advance(simulator.objects).deformed
    simulation = moved.simulation
    assert isinstance(simulation, DeviceVertexSimulation)
    expected = simulation.vertices(moved.members)
    with device.storage(float, STRIDE * len(expected)) as vertices:
        simulation.deform(device, moved.members, vertices, np.zeros(1, np.int64), STRIDE, TANGENT)
        written = vertices.read().reshape(-1, STRIDE).copy()
    simulation.release(device)
    return expected, written


def assert_alike(expected: Array, written: Array, normal_tolerance: float) -> None:
    """Positions differ by float32's rounding of the mesh's size, normals by that of directions."""
    size = max(float(np.abs(expected["position"]).max()), 1.0)
    assert np.isfinite(written).all()
    assert np.abs(expected["position"] - written[:, :3]).max() <= 2.0**-20 * size
    assert np.abs(expected["normal"] - written[:, 3:6]).max() <= normal_tolerance


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
def test_hard_skins_on_devices_are_those_of_numpy(device: rhi.Device, tmp_path: Path) -> None:
    for name, skin in SKINS.items():
        scene = load_model(write_skin(skin, tmp_path / "skin.glb", moves=True))
        # A joint that float32 flushes to 0 leaves normals as they are at rest.
        tolerance = 1.0 if "denormal scale" in name else 1e-5
        for seconds in TIMES:
            assert_alike(*compute_both(device, scene, seconds), tolerance)


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
def test_hard_morph_targets_on_devices_are_those_of_numpy(device: rhi.Device, tmp_path: Path) -> None:
    for name, (weights, shifts) in MORPHS.items():
        collapse = 1.0 if "undo" in name else 0.0
        scene = load_model(
            write_morph(tmp_path / "morph.glb", weights, shifts, moves=True, collapse=collapse)
        )
        for seconds in TIMES:
            assert_alike(*compute_both(device, scene, seconds), 1e-5)


def make_character(vertex_count: int, joint_count: int, target_count: int, *, far: float) -> DeformableMesh:
    """A random mesh with tangents, skin and targets, bound `far` metres away from its joints' space."""
    random = np.random.default_rng(vertex_count)
    directions = random.normal(size=(2, vertex_count, 3))
    directions /= np.linalg.norm(directions, axis=2, keepdims=True)
    tangents = np.concatenate([directions[0], random.choice([-1.0, 1.0], (vertex_count, 1))], axis=1)
    triangles = random.integers(0, vertex_count, 3 * vertex_count)
    positions = random.uniform(-1.0, 1.0, (vertex_count, 3)) + far
    geometry = make_geometry(positions, triangles, directions[1], tangent=tangents)
    offsets = random.uniform(-0.3, 0.3, (3, target_count, vertex_count, 3)).astype(np.float32)
    joints = random.integers(0, joint_count, (vertex_count, 4))
    weights = random.dirichlet([0.5] * 4, vertex_count)
    return DeformableMesh(geometry.vertices, *offsets, joints, weights)


def make_pose(mesh: DeformableMesh, joint_count: int, seed: int, *, far: float) -> Pose:
    """Random weights, some of them 0, and joints that turn, stretch and mirror about the mesh's middle."""
    random = np.random.default_rng(seed)
    weights = random.uniform(-1.0, 1.0, len(mesh.position_offsets))
    weights[::3] = 0.0
    matrices = np.tile(np.eye(4), (joint_count, 1, 1))
    for matrix in matrices:
        turn, _ = np.linalg.qr(random.normal(size=(3, 3)))
        turn[:, 0] *= random.choice([-1.0, 1.0])
        matrix[:3, :3] = turn * random.uniform(0.5, 1.5, 3)
        matrix[:3, 3] = random.uniform(-1.0, 1.0, 3) - matrix[:3, :3] @ np.full(3, far)
    return Pose(weights, matrices)


def compute_by_loops(mesh: DeformableMesh, pose: Pose) -> tuple[Array, Array, Array, Array]:
    """Positions, normals, tangents (v, 3) and signs (v,) in float64, vertex by vertex, as glTF says."""
    rows = []
    for number, vertex in enumerate(mesh.vertices):
        position, normal = (vertex[name].astype(np.float64) for name in ("position", "normal"))
        tangent, sign = vertex["tangent"][:3].astype(np.float64), float(vertex["tangent"][3])
        for weight, *offsets in zip(
            pose.weights, mesh.position_offsets, mesh.normal_offsets, mesh.tangent_offsets, strict=True
        ):
            position, normal, tangent = (
                value + weight * offset[number]
                for value, offset in zip((position, normal, tangent), offsets, strict=True)
            )
        assert mesh.joints is not None
        assert mesh.joint_weights is not None
        assert pose.matrices is not None
        mean = sum(
            weight * pose.matrices[joint]
            for joint, weight in zip(mesh.joints[number], mesh.joint_weights[number], strict=True)
        )
        position = mean[:3, :3] @ position + mean[:3, 3]
        volume = np.linalg.det(mean[:3, :3])
        normal = np.linalg.inv(mean[:3, :3]).T @ normal  # the sign stays where the matrix mirrors
        tangent = mean[:3, :3] @ tangent
        rows.append(
            (
                position,
                normal / np.linalg.norm(normal),
                tangent / np.linalg.norm(tangent),
                sign * np.sign(volume),
            )
        )
    positions, normals, tangents, signs = (np.array(column) for column in zip(*rows, strict=True))
    return positions, normals, tangents, signs


@pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("far", [0.0, 1024.0])
def test_characters_on_devices_are_those_of_loops_in_float64(device: rhi.Device, far: float) -> None:
    meshes = [make_character(count, 5, 7, far=far) for count in (2, 64, 65, 200)]
    poses = [make_pose(mesh, 5, seed, far=far) for seed, mesh in enumerate(meshes)]
    members = np.array([3, 0, 2])  # one of them isn't due
    begins = np.array([300, 7, 90])
    buffers = DeformationBuffers(device, meshes)
    with device.storage(float, STRIDE * 520) as vertices:
        vertices.write(np.full(STRIDE * 520, 99.0, np.float32))
        buffers.run(members, [poses[member] for member in members], vertices, begins, STRIDE, TANGENT)
        written = vertices.read().reshape(-1, STRIDE).copy()
    is_written = np.zeros(len(written), bool)
    for member, begin in zip(members, begins, strict=True):
        part = slice(begin, begin + len(meshes[member].vertices))
        is_written[part] = True
        positions, normals, tangents, signs = compute_by_loops(meshes[member], poses[member])
        assert np.abs(written[part, :3] - positions).max() < 3e-6  # the mesh's size, wherever it was bound
        # Means of joints that turn apart can be nearly flat: their normals are as exact as their thickness.
        assert np.quantile(np.abs(written[part, 3:6] - normals).max(axis=1), 0.95) < 1e-4
        assert np.quantile(np.abs(written[part, 8:11] - tangents).max(axis=1), 0.95) < 1e-4
        assert (written[part, 11] == signs).mean() > 0.98
    assert (written[~is_written] == 99.0).all()
    assert (written[is_written][:, 6:8] == 99.0).all()  # texture coordinates stay
    assert buffers.morphed_by_numpy == 0
    buffers.destroy()


def test_huge_weights_are_summed_by_numpy_and_the_mesh_at_rest_returns(gl: rhi.Device) -> None:
    mesh = make_character(70, 3, 2, far=0.0)
    mesh.position_offsets[1] = -mesh.position_offsets[0]
    mesh.normal_offsets[1] = -mesh.normal_offsets[0]
    mesh.tangent_offsets[1] = -mesh.tangent_offsets[0]
    matrices = np.tile(np.eye(4), (3, 1, 1))
    buffers = DeformationBuffers(gl, [mesh])
    with gl.storage(float, STRIDE * 70) as vertices:
        for weights, count in (((1e7, 1e7 + 1.0), 1), ((0.0, 0.0), 1), ((0.5, 0.25), 1), ((-1e8, -1e8), 2)):
            pose = Pose(np.array(weights), matrices)
            buffers.run(np.zeros(1, np.int64), [pose], vertices, np.zeros(1, np.int64), STRIDE, TANGENT)
            written = vertices.read().reshape(-1, STRIDE)[:, :3]
            expected = mesh.vertices["position"] + mesh.position_offsets[0] * (weights[0] - weights[1])
            assert np.abs(written - expected).max() < 1e-6
            assert buffers.morphed_by_numpy == count
    buffers.destroy()


def make_crowd(path: Path, count: int = 3) -> Scene:
    """Strips side by side, each with a skin of its own."""
    document = make_skinned()
    nodes, skins = document.values["nodes"], document.values["skins"]
    for number in range(1, count):
        first = len(nodes)
        nodes += [
            {"children": [first + 1], "translation": [2.0 * number, 0, 0]},
            {"children": [first + 2]},
            {"translation": [0, 2, 0]},
            {"mesh": 0, "skin": number},
        ]
        skins.append({**skins[0], "joints": [first + 1, first + 2]})
        turns = [rotation_quaternion(angle) for angle in (0, 60, 0)]
        document.animate(first + 2, "rotation", [0, 1, 2], turns, animation=0)
    return load_model(document.write(path))


@pytest.fixture
def crowd(tmp_path: Path) -> Scene:
    return make_crowd(tmp_path / "crowd.glb")


def open_renderer(device: rhi.Device, scene: Scene) -> Renderer:
    return Renderer(device, scene, size=(64, 36), visibility=FrustumCulling(scene))


def test_all_members_in_view_are_one_dispatch_and_those_out_of_view_are_none(
    null: rhi.Device, crowd: Scene
) -> None:
    with open_renderer(null, crowd) as renderer:
        renderer.render(TOWARDS, 0.1)
        counts = []
        for camera, seconds in ((TOWARDS, 0.2), (TOWARDS, 0.2), (AWAY, 0.3), (AWAY, 0.4), (AWAY, 0.5)):
            null.stream.clear()
            uploaded = null.statistics.upload_bytes
            renderer.render(camera, seconds)
            dispatches = len(null.stream.filter((Op.DISPATCH,)))
            counts.append((dispatches, null.statistics.upload_bytes - uploaded))
    assert [dispatches for dispatches, _ in counts[:2]] == [1, 0]  # nothing is computed twice
    assert [dispatches for dispatches, _ in counts[2:]] == [0, 0, 0]
    assert [uploaded for _, uploaded in counts[3:]] == [0, 0]


def test_a_frame_away_from_all_skins_is_that_of_meshes_that_stand_still(
    null: rhi.Device, crowd: Scene
) -> None:
    streams = []
    for is_simulated in (True, False):
        scene = deepcopy(crowd)
        if not is_simulated:
            scene.simulated = ()
        with open_renderer(null, scene) as renderer:
            renderer.render(AWAY, 0.0)
            null.stream.clear()
            creations = null.statistics.creations
            renderer.render(AWAY, 0.5)
            streams.append([command.op for command in null.stream])
            assert null.statistics.creations == creations
            null.stream.clear()
    assert streams[0] == streams[1]
    assert len(streams[0]) > 3


def test_a_device_without_compute_shaders_gets_the_vertices_of_numpy(crowd: Scene) -> None:
    profile = replace(PROFILES["everything"], compute=False)
    with rhi.create_device("null", profile=profile) as device, open_renderer(device, crowd) as renderer:
        renderer.render(TOWARDS, 0.1)
        uploaded = device.statistics.upload_bytes
        renderer.render(TOWARDS, 0.2)
        assert not device.stream.filter((Op.DISPATCH,))
        assert device.statistics.upload_bytes - uploaded >= 30 * crowd.meshes.vertices.itemsize


class OnNumpy:
    """A simulation that hides from devices how it computes vertices there."""

    def __init__(self, simulation: Any) -> None:
        self.catch_up = simulation.catch_up
        self.set_time, self.vertices = simulation.set_time, simulation.vertices

    def __deepcopy__(self, memo: object) -> OnNumpy:
        return self  # its only scene is drawn once


@pytest.mark.parametrize("technique", [Forward, Deferred])
def test_images_with_shadows_are_those_of_vertices_that_numpy_computes(
    gl: rhi.Device, crowd: Scene, technique: type[Forward | Deferred]
) -> None:
    plain = deepcopy(crowd)
    plain.simulated = tuple(
        replace(simulated, simulation=OnNumpy(simulated.simulation)) if len(simulated.objects) else simulated
        for simulated in plain.simulated
    )
    images = []
    for scene in (crowd, plain):
        scene.lights.add_directional((0.5, -1.0, -0.5))
        with Renderer(gl, scene, size=(96, 64), technique=technique()) as renderer:
            renderer.render(TOWARDS, 0.3)
            gl.stream.clear()
            images.append(renderer.render(TOWARDS, 0.7).image.read().astype(int))
            assert len(gl.stream.filter((Op.DISPATCH,))) == (1 if scene is crowd else 0)
    assert images[0].std() > 5.0
    assert np.abs(images[0] - images[1]).max() <= 1


def test_time_that_goes_back_leaves_nothing_behind(null: rhi.Device, crowd: Scene) -> None:
    with open_renderer(null, crowd) as renderer:
        counts = []
        for seconds in (0.1, 0.2, 0.1, 0.2, 0.1):
            renderer.render(TOWARDS, seconds)
            null.finish()
            created, destroyed = (len(null.stream.filter(op)) for op in (Op.CREATE_BUFFER, Op.DESTROY))
            counts.append(created - destroyed)
    assert counts[2] == counts[4]


def test_a_morphing_mesh_is_drawn_by_the_device(null: rhi.Device, tmp_path: Path) -> None:
    document: GltfDocument = make_morphing(normals=True)
    scene = load_model(document.write(tmp_path / "a.glb"))
    with open_renderer(null, scene) as renderer:
        null.stream.clear()
        renderer.render(TOWARDS, 0.5)
        assert len(null.stream.filter((Op.DISPATCH,))) == 1
