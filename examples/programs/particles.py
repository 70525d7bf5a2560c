"""A fountain: a compute shader moves the particles, and points draw them, added up in half floats."""

from __future__ import annotations

import numpy as np

import rhi
from rhi.math import look_at, perspective
from rhi.shading import (
    FullScreen,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    exp,
    fragment_coordinate,
    global_id,
    ivec2,
    mat4,
    vec3,
    vec4,
    vertex_index,
)
from rhi_screen import save_picture

COUNT = 16384
STEPS = 90
GROUP = 64
GRAVITY = 6.0


class Camera(Struct):
    view_projection: mat4


class Particle(Struct):
    place: vec3
    age: float
    velocity: vec3
    life: float


class Step(Struct):
    seconds: float
    gravity: float


class Spark(Struct):
    clip: vec4
    color: vec3


class Move(Shader):
    """A shader of one step of each particle; those below the ground bounce."""

    work_group = (GROUP,)
    step: Uniform[Step]
    particles: StorageRW[Particle]

    def compute(self) -> None:
        i = global_id().x
        p = self.particles[i]
        age = p.age + self.step.seconds
        seconds = self.step.seconds if age > 0.0 else 0.0  # before that it waits in the nozzle
        velocity = p.velocity - vec3(0.0, self.step.gravity * seconds, 0.0)
        place = p.place + velocity * seconds
        if place.y < 0.0:
            place = vec3(place.x, -place.y, place.z)
            velocity = vec3(velocity.x, -0.6 * velocity.y, velocity.z)
        self.particles[i] = Particle(place=place, age=age, velocity=velocity, life=p.life)


class Draw(Shader):
    """A point per particle, read by its number; older ones are redder."""

    camera: Uniform[Camera]
    particles: Storage[Particle]

    def vertex(self) -> Spark:
        p = self.particles[vertex_index()]
        heat = exp(-1.5 * p.age / p.life)
        return Spark(
            clip=self.camera.view_projection @ vec4(p.place, 1.0),
            color=vec3(0.8, 0.6 * heat, 0.5 * heat * heat) * (0.05 + heat),
        )

    def fragment(self, s: Spark) -> vec4:
        return vec4(s.color, 1.0)


class ToneMap(FullScreen):
    """Maps sums of any size to 0…1."""

    light: Texture2D

    def fragment(self) -> vec4:
        light = self.light.load(ivec2(fragment_coordinate().xy)).rgb
        return vec4(1.0 - exp(-light), 1.0)


def make_particles() -> np.ndarray:
    """Return COUNT particles in a nozzle at the origin, which will leave it within a second and a half, in a cone."""
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
    save_picture(render)
