"""A fountain: a compute shader moves the particles, and points draw them, added up in half floats."""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi.math import look_at, perspective
from rhi_screen import save_image

COUNT = 16384
STEPS = 90
GROUP = 64
GRAVITY = 6.0


class Camera(sl.Struct):
    view_projection: sl.mat4


class Particle(sl.Struct):
    position: sl.vec3
    age: float
    velocity: sl.vec3
    life: float


class Step(sl.Struct):
    seconds: float
    gravity: float


class Spark(sl.Struct):
    clip: sl.vec4
    color: sl.vec3


class Move(sl.Shader):
    """A shader of one step of each particle; those below the ground bounce."""

    work_group = (GROUP,)
    step: sl.Uniform[Step]
    particles: sl.StorageRW[Particle]

    def compute(self) -> None:
        i = sl.global_id().x
        p = self.particles[i]
        age = p.age + self.step.seconds
        seconds = self.step.seconds if age > 0.0 else 0.0  # before that it waits in the nozzle
        velocity = p.velocity - sl.vec3(0.0, self.step.gravity * seconds, 0.0)
        position = p.position + velocity * seconds
        if position.y < 0.0:
            position = sl.vec3(position.x, -position.y, position.z)
            velocity = sl.vec3(velocity.x, -0.6 * velocity.y, velocity.z)
        self.particles[i] = Particle(position=position, age=age, velocity=velocity, life=p.life)


class Draw(sl.Shader):
    """A point per particle, read by its number; older ones are redder."""

    camera: sl.Uniform[Camera]
    particles: sl.Storage[Particle]

    def vertex(self) -> Spark:
        p = self.particles[sl.vertex_index()]
        heat = sl.exp(-1.5 * p.age / p.life)
        return Spark(
            clip=self.camera.view_projection @ sl.vec4(p.position, 1.0),
            color=sl.vec3(0.8, 0.6 * heat, 0.5 * heat * heat) * (0.05 + heat),
        )

    def fragment(self, s: Spark) -> sl.vec4:
        return sl.vec4(s.color, 1.0)


class ToneMap(sl.FullScreen):
    """Maps sums of any size to 0…1."""

    light: sl.Texture2D

    def fragment(self) -> sl.vec4:
        light = self.light.load(sl.ivec2(sl.fragment_coordinate().xy)).rgb
        return sl.vec4(1.0 - sl.exp(-light), 1.0)


def make_particles() -> np.ndarray:
    """Return COUNT particles in a nozzle at the origin, which will leave it within a second and a half, in a
    cone."""
    rng = np.random.default_rng(7)
    angle, lean = rng.uniform(0, 2 * np.pi, COUNT), 0.35 * np.sqrt(rng.uniform(0, 1, COUNT))
    start = np.stack([np.cos(angle) * lean, np.ones(COUNT), np.sin(angle) * lean], axis=-1)
    start *= rng.uniform(5.5, 7, COUNT)[:, None]
    rows = np.zeros(COUNT, Particle.dtype)
    rows["velocity"] = start
    rows["age"] = rng.uniform(-1.5, 0, COUNT)
    rows["life"] = rng.uniform(1, 3, COUNT)
    return rows


def simulate(device: rhi.Device) -> rhi.StorageBuffer[Particle]:
    """Move the particles STEPS times."""
    particles = device.storage(Particle, make_particles())
    step = device.uniform(Step(seconds=1 / 60, gravity=GRAVITY))
    move = device.program(Move)
    for _ in range(STEPS):
        device.dispatch(move, COUNT // GROUP, step=step, particles=particles)
    return particles


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Move the particles, draw them, and tone-map."""
    particles = simulate(device)
    view_projection = perspective(np.radians(50), size[0] / size[1]) @ look_at((0, 3.5, 8), (0, 1.7, 0))
    camera = device.uniform(Camera(view_projection=view_projection))
    light = device.texture(size, rhi.Format.RGBA16F)
    image = device.texture(size, rhi.Format.RGBA8_SRGB)
    points = device.mesh(COUNT, primitive=rhi.Primitive.POINTS)
    with device.render_pass(light, clear=(0, 0, 0, 1)), device.states(rhi.BlendFunction.ADDITIVE):
        device.draw(device.program(Draw), points, camera=camera, particles=particles)
    with device.render_pass(image):
        device.draw(device.program(ToneMap), device.mesh(3), light=light)
    return image


if __name__ == "__main__":
    save_image(render)
