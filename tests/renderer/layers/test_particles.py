"""Particles: those of the drawn fountains, where their drops are, in one draw and one upload."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.content import load_scene
from renderer.content.fountains import DROPS
from renderer.layers.particles import (
    FogParticleShader,
    Particle,
    Particles,
    collect_particles,
)
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.visibility import FrustumCulling, NoCulling
from rhi import Device, Op
from rhi.shading import compile_shader
from tests.renderer.conftest import open_device

HALL = "hall:columns=18,rows=2,flags=0,fountains=24"


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene(HALL)


class Catch:
    """A layer that keeps the particles of a frame."""

    def render(self, device: Device, frame: object) -> None:
        self.parts = list(collect_particles(frame))  # type: ignore[arg-type]
        self.frame = frame

    def destroy(self) -> None:
        pass


def test_a_particle_is_where_the_drop_is(null: Device, hall: Scene) -> None:
    catch = Catch()
    camera = hall.views["overview"]
    with Renderer(null, hall, visibility=NoCulling(hall), size=(64, 36)) as renderer:
        renderer.layers.append(catch)
        renderer.animation_lag = 0.0
        renderer.render(camera, 1.0)
        before = catch.parts[0].reshape(24, DROPS, 8)
        renderer.render(camera, 1.0 + 1.0 / 60.0)
        (part,) = catch.parts
        vertices = renderer._resources.mesh.vertices
        assert vertices is not None
        rows = renderer.simulator.objects
        first = hall.meshes.ranges["base_vertex"][hall.objects.mesh[rows]]
        drops = np.stack([vertices.read(int(begin), 12 * DROPS)["position"] for begin in first])
    centres = drops.reshape(len(rows), DROPS, 12, 3).mean(axis=2)  # of the tetrahedra on the device
    world = hall.nodes.world[hall.objects.node[rows]]
    expected = np.einsum("nij,npj->npi", world[:, :3, :3], centres) + world[:, None, :3, 3] - camera.position
    read_vertices = part.reshape(24, DROPS, 8)
    assert np.abs(read_vertices[:, :, :3] - expected).max() < 1e-5
    flying = (read_vertices[:, :, :3] != before[:, :, :3]).any(axis=2) & (
        np.abs(read_vertices[:, :, 4:7]).max(axis=2) < 1.0
    )
    moved = (read_vertices - before)[:, :, :3][flying]
    along = read_vertices[:, :, 4:7][flying]  # the way in 1/60 s, which is a step
    calm = np.abs(moved).max(axis=1) < 0.2  # thrown again, or stopped by the basin
    assert calm.mean() > 0.9
    assert np.median(np.abs(moved - along)[calm]) < 1e-5


def test_all_particles_are_one_draw_and_one_upload_and_1000_frames_create_nothing(
    null: Device, hall: Scene
) -> None:
    catch, particles = Catch(), Particles(null)
    with Renderer(null, hall, visibility=NoCulling(hall), size=(64, 36)) as renderer:
        renderer.layers.append(catch)
        renderer.render(hall.views["overview"], 2.0)
        settled = (0, 0)
        for number in range(1000):
            before = null.statistics
            null.stream.clear()
            particles.render(null, catch.frame)  # type: ignore[arg-type]
            assert sum(command.op is Op.DRAW for command in null.stream) == 1
            null.present()
            after = null.statistics
            assert after.upload_bytes - before.upload_bytes == 24 * DROPS * Particle.dtype.itemsize
            if number >= 10:
                assert (after.creations, null.transient.capacity) == settled
            settled = after.creations, null.transient.capacity
    assert particles.count == 24 * DROPS
    particles.destroy()


def test_fountains_that_are_not_drawn_have_no_particles(null: Device, hall: Scene) -> None:
    particles = Particles(null)
    counts = []
    with Renderer(null, hall, visibility=FrustumCulling(hall), size=(64, 36)) as renderer:
        renderer.layers.append(particles)
        for camera in (hall.views["overview"], Camera.look_at((0, 900, 0), (0, 1000, 0))):
            result = renderer.render(camera, 1.0)
            counts.append(particles.count)
            drawn = set(result.visible.tolist()) & set(renderer.simulator.objects.tolist())
            assert particles.count == len(drawn) * DROPS
    assert counts[0] > counts[1] == 0
    particles.destroy()


def test_a_scene_without_simulations_has_no_particles(null: Device) -> None:
    city = load_scene("city:blocks=2")
    particles = Particles(null)
    with Renderer(null, city, visibility=NoCulling(city), size=(64, 36)) as renderer:
        renderer.layers.append(particles)
        renderer.render(city.paths["ground"].camera(0))
    assert particles.count == 0
    particles.destroy()


def test_particles_show_in_front_of_farther_surfaces_only() -> None:
    hall = load_scene("hall:columns=6,rows=2,flags=0,fountains=4")
    differences = []
    for name in ("gl", "cl"):
        with (
            open_device(name) as device,
            Renderer(device, hall, visibility=NoCulling(hall), size=(160, 90)) as renderer,
        ):
            camera = hall.views["overview"]
            plain = renderer.render(camera, 1.5)
            before, depth = plain.image.read().astype(int), plain.depth.read()
            particles = Particles(device)
            renderer.layers.append(particles)
            result = renderer.render(camera, 1.5)
            differences.append(result.image.read().astype(int) - before)
            assert (result.depth.read() == depth).all()
            particles.destroy()
    first, second = differences
    lit = (first > 8).any(axis=2)
    assert 50 < lit.sum() < 0.2 * lit.size
    assert not lit[:20].any()  # drops don't fly as high as the ceiling
    assert np.abs(first - second).mean() < 0.2
    assert (lit == (second > 8).any(axis=2)).mean() > 0.995


def test_particles_call_fog_as_surfaces_do() -> None:
    bound = {binding.name: binding.type for binding in compile_shader(FogParticleShader).bindings}
    surfaces = type("Foggy", (ForwardShader,), {"__module__": __name__, "has_fog": True})
    assert (
        bound["fog"]
        == {
            program_binding.name: program_binding.type
            for program_binding in compile_shader(surfaces).bindings
        }["fog"]
    )
