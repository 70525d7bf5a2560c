"""Particles: a layer that draws what simulations emit, thousands of sprites in one draw (thesis 4.3).

- Only simulated objects that were drawn in the frame have particles: what is culled isn't simulated, and
  emits nothing.
- All particles of a frame are one array in the device's transient memory. The vertex stage reads it by its
  index, and stretches each particle along the way that it goes in the time of an exposure.
- Particles are tested against the frame's depth and don't change it. They are added up in any order
  (premultiplied, with less alpha than light), so they aren't sorted. In fog they fade to it, as far as they
  cover what is behind them.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.frame import Effect, Frame, SceneLayer
from renderer.frame.drawing import NEARER
from renderer.frame.fog import bind_fog
from renderer.frame.mirrors import MirroredValue
from renderer.frame.pixel_rays import bind_rays
from renderer.scene.arrays import Floats, Indices
from renderer.shaders import ViewConstants, tone_map
from renderer.shaders.fog import FogReader, fog_transmittance
from renderer.shaders.pixels import ViewRayShader
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Device
from rhi.errors.shared_caches import cache_once
from rhi.math import is_parallel

_CORNERS: Final = 6  # of the two triangles
_CAPACITY: Final = 1024  # particles at first
_RADIUS: Final = 0.05  # in m
_EXPOSURE: Final = 1.0 / 60.0  # seconds


@runtime_checkable
class ParticleEmitter(Protocol):
    """A simulation whose members are surrounded by particles."""

    def particles(self, members: Indices) -> tuple[Floats, Floats]:
        """Return positions and velocities (j, p, 3) of `members` (j,), in m and m/s and in the space of the
        object."""
        ...


class Particle(sl.Struct):
    """A particle along the axes of the world: its position relative to the eye, and the distance it moves
    during an exposure."""

    centre: sl.vec3
    displacement: sl.vec3


class ParticleConstants(sl.Struct):
    """The radius of particles, and the way from this eye to the one that their positions are relative to."""

    eye_offset: sl.vec3
    radius: float


class ParticleVarying(sl.Struct):
    """The varyings of `ParticleShader`; `quad_position` is -1 to 1 from edge to edge."""

    clip: sl.vec4
    quad_position: sl.vec2


class ParticleShader(ViewRayShader):
    """Draws particles as soft sprites that face the eye."""

    lean = True  # `rays` are for parallel projections alone

    view: sl.Uniform[ViewConstants]
    particles: sl.Storage[Particle]
    constants: sl.Uniform[ParticleConstants]

    def vertex(self) -> ParticleVarying:
        number = sl.vertex_index()
        particle = self.particles[number // 6]
        centre = particle.centre + self.constants.eye_offset
        turn = number % 6
        x = float((22 >> turn) & 1) * 2.0 - 1.0  # the corners of the two triangles: 00 10 11, 00 11 01
        y = float((52 >> turn) & 1) * 2.0 - 1.0
        along = particle.displacement
        if sl.dot(along, along) < 1e-12:
            along = sl.vec3(0.0, 1e-6, 0.0)
        along = along / sl.length(along)
        toward = self.direction_to_eye(centre)
        aside = sl.cross(toward, along)
        aside = aside / sl.max(sl.length(aside), 1e-6)
        offset = (
            along * (self.constants.radius * x)
            + particle.displacement * (0.5 * x)
            + aside * (self.constants.radius * y)
        )
        offset += toward * self.constants.radius  # before the drop itself
        return ParticleVarying(
            clip=self.view.relative_view_projection @ sl.vec4(centre + offset, 1.0),
            quad_position=sl.vec2(x, y),
        )

    def fragment(self, v: ParticleVarying) -> sl.vec4:
        light = sl.max(1.0 - sl.dot(v.quad_position, v.quad_position), 0.0)
        return sl.vec4(sl.vec3(0.16, 0.24, 0.32) * light, 0.2 * light)


class FogParticleVarying(sl.Struct):
    """The varyings of `FogParticleShader`: the colour of the fog in front of a particle, and the fraction of
    light that passes it."""

    clip: sl.vec4
    quad_position: sl.vec2
    fog: sl.vec3
    transmittance: float


class FogParticleShader(FogReader, ParticleShader):
    """Draws particles in fog: their colours are mixed with the fog's, both as the image has them."""

    def vertex(self) -> FogParticleVarying:  # type: ignore[override]  # more varyings
        v = super().vertex()
        centre = self.particles[sl.vertex_index() // 6].centre + self.constants.eye_offset
        path = self.path_from_eye(centre)
        transmittance = fog_transmittance(path, self.fog_at(centre - path))
        return FogParticleVarying(
            clip=v.clip,
            quad_position=v.quad_position,
            fog=tone_map(self.fog.color) * (1.0 - transmittance),
            transmittance=transmittance,
        )

    def fragment(self, v: FogParticleVarying) -> sl.vec4:  # type: ignore[override]  # as `vertex`
        color = super().fragment(ParticleVarying(clip=v.clip, quad_position=v.quad_position))
        return sl.vec4(color.rgb * v.transmittance + v.fog * color.a, color.a)


class Particles(SceneLayer):
    """A layer that draws the particles of the simulated objects that were drawn. For two eyes they are collected and
    uploaded once, relative to the left one.

    Attributes:
        count: the number of particles of the latest frame.
    """

    def __init__(self, device: Device) -> None:
        self._device = device
        self._mesh = device.mesh(_CORNERS * _CAPACITY, label="particles")
        constants = ParticleConstants(eye_offset=np.zeros(3), radius=_RADIUS)
        self._constants = [MirroredValue(device, constants) for _ in range(2)]  # of both eyes
        self._uploaded: Any = None  # the particles of this frame
        self.count = 0

    def render(self, device: Device, frame: Frame) -> None:
        """Draw the particles in one draw."""
        if frame.first is None:
            self._upload(device, frame)
        if not self.count:
            return
        eye = frame.camera.position
        offset = np.zeros(3) if frame.first is None else frame.first.camera.position - eye
        mirror = self._constants[frame.first is not None]
        mirror.write(ParticleConstants(eye_offset=offset.tolist(), radius=_RADIUS))
        shader, bindings = _select_shader(frame)
        program: Any = self._device.program(shader)
        targets, nearer = frame.targets, NEARER[frame.camera.projection.depth]
        with (
            device.event("particles"),
            device.render_pass(targets["image"], targets.depth),
            device.states(CullMode.NONE, DepthTest.ON, nearer, DepthWrite.OFF, BlendFunction.PREMULTIPLIED),
        ):
            device.draw(
                program,
                self._mesh.view(0, _CORNERS * self.count),
                view=frame.view.buffer,
                particles=self._uploaded,
                constants=mirror.buffer,
                **bindings,
            )

    def _upload(self, device: Device, frame: Frame) -> None:
        """Upload the particles of a frame, and make room for their corners."""
        parts = list(collect_particles(frame))
        self.count = sum(map(len, parts))
        if not self.count:
            return
        array = np.concatenate(parts).reshape(-1).view(Particle.dtype)
        if _CORNERS * len(array) > self._mesh.count:
            corners = _CORNERS << (len(array) - 1).bit_length()
            old, self._mesh = self._mesh, device.mesh(corners, label="particles")
            old.destroy()
        self._uploaded = device.transient.storage(Particle, array)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._mesh.destroy()
        for constants in self._constants:
            constants.destroy()


def _select_shader(frame: Frame) -> tuple[type[ParticleShader], dict[str, Any]]:
    """Return the shader for the fog and the projection of the frame, and what it binds for those."""
    has_fog, is_seen_in_parallel = Effect.FOG in frame.effects.enabled, is_parallel(frame.camera.projection)
    shader = FogParticleShader if has_fog else ParticleShader
    bindings: dict[str, Any] = {"fog": bind_fog(frame)} if has_fog else {}
    if is_seen_in_parallel:
        return _parallel_variant(shader), {**bindings, "rays": bind_rays(frame)}
    return shader, bindings


@cache_once
def _parallel_variant(shader: type[ParticleShader]) -> type[ParticleShader]:
    """Return the shader of particles for parallel projections."""
    return type(f"Parallel{shader.__name__}", (shader,), {"__module__": __name__, "has_parallel_rays": True})


def collect_particles(frame: Frame) -> Iterator[NDArray[np.float32]]:
    """Yield the particles (p, 8) as rows of `Particle`, one array for each simulation of which anything was
    drawn."""
    scene, eye = frame.resources.scene, frame.camera.position
    for simulation, object_indices, members in frame.resources.simulator.list_drawn_members():
        if isinstance(simulation, ParticleEmitter) and len(members):
            position, velocity = simulation.particles(members)
            world = scene.nodes.world[scene.objects.node[object_indices]]
            turn = world[:, :3, :3].transpose(0, 2, 1)
            floats = np.zeros((*position.shape[:2], 8), np.float32)
            floats[:, :, 0:3] = position @ turn + (world[:, None, :3, 3] - eye)
            floats[:, :, 4:7] = velocity @ turn * _EXPOSURE
            yield floats.reshape(-1, 8)
