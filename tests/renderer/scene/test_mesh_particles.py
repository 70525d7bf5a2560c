"""Particles with materials: positions against float64, the same pixels as objects, and no work where nobody looks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from refusals import refused_rule

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.lab.exam.particle_cases import CardSimulation, face_eye, make_poses
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.scene.arrays import Floats
from renderer.scene.particles import Emitter, EmitterSimulation, make_quad
from renderer.shadows import ShadowSettings
from renderer.techniques import TECHNIQUES
from rhi import Op
from rhi.math import multiply, rotation

SIZE = (96, 64)
EYE = Camera.look_at((0.3, 1.2, 3.4), (0.0, 0.0, 0.0), projection=Perspective(0.9, 1.5))
BEHIND = Camera.look_at((0.3, 1.2, 3.4), (0.0, 2.0, 9.0), projection=Perspective(0.9, 1.5))
QUAD = make_quad(1.0, 0.7)
EXACT = sorted(set(TECHNIQUES) - {"inferred"})  # which shades pixels by the light of their neighbours


def make_scene(
    *,
    as_objects: bool,
    faces_eye: bool = False,
    camera: Camera = EYE,
    local: Floats | None = None,
    **values: Any,
) -> Scene:
    """Make particles above a floor, in a light that casts shadows; or an object for each particle."""
    builder, poses = SceneBuilder("cards"), make_poses(faces_eye=faces_eye)
    material = builder.add_material(**{"base_color": (0.7, 0.5, 0.3), "double_sided": True, **values})
    if as_objects:
        turns = np.array([rotation(axis, angle) for axis, angle in zip(poses.axis, poses.angle, strict=True)])
        if faces_eye:
            turns = multiply(face_eye(poses.position, camera), turns)
        sizes = scaling(poses.size[:, None] * np.ones(3))
        nodes = builder.add_nodes(multiply(multiply(translation(poses.position), turns), sizes))
        builder.add_objects(nodes, builder.add_mesh(QUAD), material)
    else:
        simulation = CardSimulation(poses, QUAD, faces_eye=faces_eye)
        mesh = builder.add_mesh(simulation.make_mesh(), bounds=(np.full(3, -2.0), np.full(3, 2.0)))
        builder.simulate(builder.add_objects(builder.add_node(local), mesh, material), simulation)
    floor = builder.add_node(translation((0.0, -1.6, 0.0)) @ scaling((8.0, 0.2, 8.0)))
    builder.add_objects(floor, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    builder.lights.add_directional((0.4, -1.0, -0.5), casts_shadow=True)
    builder.lights.add_point((0.5, 1.5, 1.5), 8.0, intensity=2.0)
    return builder.build()


def draw(device: rhi.Device, scene: Scene, technique: str = "forward", camera: Camera = EYE) -> Any:
    with open_renderer(device, scene, TECHNIQUES[technique](), visibility="none", size=SIZE) as renderer:
        return renderer.render(camera, 0.5).image.read()[..., :3].astype(np.int64)


MATERIALS: dict[str, dict[str, Any]] = {
    "opaque": {},
    "blended": {"base_color": (0.7, 0.5, 0.3, 0.5), "alpha_mode": AlphaMode.BLEND},
    "metal": {"metallic": 0.8, "roughness": 0.4},
}


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", EXACT)
@pytest.mark.parametrize("material", MATERIALS)
def test_particles_look_like_objects_in_all_techniques(
    drawing_device: rhi.Device, technique: str, material: str
) -> None:
    """With their shadows; pixels of edges may round to the other side."""
    values = MATERIALS[material]
    particles, objects = (
        draw(drawing_device, make_scene(as_objects=as_objects, faces_eye=True, **values), technique)
        for as_objects in (False, True)
    )
    off = np.abs(particles - objects).max(axis=2)
    assert (off > 2).mean() < 0.004
    without = make_scene(as_objects=True, faces_eye=True, **values)
    without.nodes.hide(without.objects.node[without.objects.material == 0])
    assert (np.abs(particles - draw(drawing_device, without, technique)) > 8).any(axis=2).mean() > 0.1


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("faces_eye", [False, True])
def test_vertices_are_those_of_matrices_in_float64(device: rhi.Device, faces_eye: bool) -> None:
    turned = translation((0.4, -0.2, 0.1)) @ rotation((0, 1, 0), 0.7) @ scaling((1.5, 1.5, 1.5))
    scene = make_scene(as_objects=False, faces_eye=faces_eye, local=turned)
    with open_renderer(device, scene, TECHNIQUES["forward"](), visibility="none", size=SIZE) as renderer:
        renderer.render(EYE, 0.5)
        buffer = renderer.resources.mesh.vertices
        assert buffer is not None
        vertices = buffer.read(0, 4 * 24).reshape(24, 4)
    poses = make_poses(faces_eye=faces_eye)
    eye = np.linalg.inv(turned) @ (*EYE.position, 1.0)
    turns = np.array([rotation(axis, angle) for axis, angle in zip(poses.axis, poses.angle, strict=True)])
    if faces_eye:
        turns = multiply(face_eye(poses.position, Camera(eye[:3], EYE.rotation, EYE.projection)), turns)
    corners = QUAD.vertices["position"] * poses.size[:, None, None]
    expected = np.einsum("nij,nvj->nvi", turns[:, :3, :3], corners) + poses.position[:, None]
    assert np.abs(vertices["position"] - expected).max() < 1e-6
    assert np.abs(vertices["normal"] - turns[:, None, :3, 2]).max() < 1e-6


def test_blended_particles_are_in_the_order_of_their_distances() -> None:
    poses = make_poses(faces_eye=False)
    simulation, member = CardSimulation(poses, QUAD, faces_eye=False), np.array([0])
    eyes = np.array([[0.3, 1.2, 3.4, 1.0]])
    slots = simulation.vertices(member)["position"].reshape(24, 4, 3).mean(axis=1)
    assert np.abs(slots - poses.position).max() < 1e-6
    assert not simulation.look_from(member, eyes, np.array([False])).any()
    assert simulation.look_from(member, eyes, np.array([True])).all()
    assert not simulation.look_from(member, eyes, np.array([True])).any()
    middles = simulation.vertices(member)["position"].reshape(24, 4, 3).mean(axis=1)
    distances = np.linalg.norm(middles - eyes[:, :3], axis=1)
    assert (np.diff(distances) <= 0.0).all()
    assert simulation.look_from(member, np.array([[0.0, 1.0, 0.0, 0.0]]), np.array([True])).all()
    heights = simulation.vertices(member)["position"].reshape(24, 4, 3).mean(axis=1)[:, 1]
    assert (np.diff(heights) >= 0.0).all()  # from far above


@given(
    st.integers(1, 9),
    st.floats(0.01, 20.0),
    st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    st.floats(0.0, 3.0),
    st.tuples(*[st.floats(-10.0, 10.0)] * 3),
    st.floats(0.0, 1e6),
)
def test_particles_never_leave_their_bounds(
    count: int, lifetime: float, velocity: Any, spread: float, acceleration: Any, seconds: float
) -> None:
    emitter = Emitter(count, lifetime, (1.0, 0.5, 2.0), velocity, spread, acceleration, (0.5, 2.0), 3.0)
    simulation, members = EmitterSimulation(2, emitter, QUAD), np.arange(2)
    simulation.set_time(members, seconds)
    points = simulation.vertices(members)["position"]
    lower, upper = simulation.bounds
    assert (points >= lower).all()
    assert (points <= upper).all()


def test_particles_fly_along_parabolas_and_are_thrown_again() -> None:
    emitter = Emitter(50, 2.0, (1.0, 0.0, 1.0), (0.5, 4.0, 0.0), 0.5, (0.0, -9.81, 1.0), (1.0, 3.0))
    simulation, member, step = EmitterSimulation(3, emitter, QUAD, seed=4), np.array([1]), 0.004
    assert len(simulation) == 3
    path = []
    for number in range(1000):
        simulation.set_time(member, 10.0 + number * step)
        path.append(simulation.pose(member).position[0])
    bends = np.diff(np.array(path), 2, axis=0) / step**2
    flies = np.abs(bends - emitter.acceleration).max(axis=2) < 1e-3
    assert 0.99 < flies.mean() < 1.0  # all but the two steps around a throw
    assert (~flies).sum(axis=0).max() <= 2 * 2  # twice in 4 s
    speeds = np.diff(np.array(path), axis=0)[:, 0] / step
    begins = np.flatnonzero(~flies[:, 0])[1::2] + 1
    assert (np.abs(speeds[begins] - emitter.velocity) <= 0.5 + 10.0 * step).all()
    others = EmitterSimulation(3, emitter, QUAD, seed=5)
    others.set_time(member, 10.0)
    assert np.abs(others.pose(member).position[0] - path[0]).mean() > 0.1


def test_an_emitter_is_a_dispatch_where_it_is_seen_and_nothing_elsewhere(null: rhi.Device) -> None:
    scene = make_scene(as_objects=False, faces_eye=True)
    counts = []
    with Renderer(null, scene, visibility="frustum", size=SIZE) as renderer:
        renderer.shadows.settings = ShadowSettings(cascades=1, distance=0.5)
        for camera, seconds in ((EYE, 0.5), (EYE, 0.5), (EYE, 0.75), (BEHIND, 1.0), (BEHIND, 1.25)):
            null.stream.clear()
            before = null.statistics.upload_bytes
            renderer.render(camera, seconds)
            dispatches = sum(command.op is Op.DISPATCH for command in null.stream)
            counts.append((dispatches, null.statistics.upload_bytes - before))
    assert [dispatches for dispatches, _ in counts] == [1, 0, 1, 0, 0]
    assert counts[2][1] - counts[1][1] < 24 * 32 + 256  # 32 bytes for each particle, and constants


def test_an_eye_that_moves_turns_particles_that_face_it_and_their_shadows(null: rhi.Device) -> None:
    moved = Camera.look_at((1.3, 1.2, 3.4), (0.0, 0.0, 0.0), projection=Perspective(0.9, 1.5))
    for faces_eye in (True, False):
        scene = make_scene(as_objects=False, faces_eye=faces_eye)
        scene.lights.directional["casts_shadow"] = False
        scene.lights.point["casts_shadow"] = True
        with Renderer(null, scene, visibility="none", size=SIZE) as renderer:
            renderer.render(EYE, 0.5)
            renderer.render(EYE, 0.5)
            assert renderer.shadows.count("kept") > 0
            assert renderer.shadows.count("drawn") == 0
            null.stream.clear()
            renderer.render(moved, 0.5)
            dispatches = sum(command.op is Op.DISPATCH for command in null.stream)
            assert dispatches == faces_eye
            assert (renderer.shadows.count("drawn") > 0) is faces_eye


@pytest.mark.parametrize(
    "values",
    [
        {"particles": 0},
        {"lifetime": 0.0},
        {"lifetime": np.nan},
        {"spread": -1.0},
        {"velocity": (0.0, np.inf, 0.0)},
        {"size": (1.0, -1.0)},
        {"box": (1.0, 1.0)},
        {"spin": "fast"},
    ],
    ids=str,
)
def test_bad_emitters_are_refused(values: dict[str, Any]) -> None:
    assert refused_rule(lambda: Emitter(**values)) == "scene-bad-particles"
    assert Emitter(velocity=(0.0, 1.0, 0.0)).particles == 64


def test_bad_counts_are_refused() -> None:
    for count, particles in ((0, 1), (1, 1 << 20)):
        emitter = Emitter(particles=particles)
        geometry = BUILT_IN["sphere"]()
        assert refused_rule(lambda c=count, e=emitter, g=geometry: EmitterSimulation(c, e, g)) == (
            "scene-bad-particles"
        )
    EmitterSimulation(1, Emitter(particles=1), BUILT_IN["sphere"]())


def test_the_leaves_of_the_bazaar_stay_in_their_rooms() -> None:
    scene = load_scene("bazaar:instances=60,materials=2,meshes=2,lights=1,detail=4,leaves=20")
    (leaves,) = scene.simulated
    assert len(leaves) == 4
    assert scene.name.endswith("leaves=20")
    scene.check_bounds([0.0, 1.7, 100.0])
