"""Emitters that throw particles: where each is follows from the time alone, in closed form.

A particle flies along a parabola for its lifetime, turns, and grows or shrinks; then its index is thrown again. How it
is thrown is a hash of the emitter, the index, and how often that was thrown before. So nothing is ever missed: what
wasn't drawn for an hour costs what any frame costs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from renderer import rules
from renderer.scene.arrays import Floats, Indices, hash_to_unit
from renderer.scene.catch_up import Recompute
from renderer.scene.meshes import MeshBounds, MeshGeometry
from renderer.scene.particles.mesh_particles import MeshParticles, ParticlePoses
from rhi.errors import refuse

_HASHES: Final = 10  # numbers that a throw takes
_ROUNDING: Final = 1.0 + 2.0**-20  # vertices are float32
_LARGEST: Final = 1e4


@dataclass(frozen=True, slots=True)
class Emitter:
    """An emitter at the origin of its object.

    Attributes:
        particles: how many are in flight at any time.
        lifetime: seconds from a throw to the next.
        box: metres along x, y and z of the box around the origin in which particles begin.
        velocity: metres a second along x, y and z, at first.
        spread: metres a second: to the velocity comes one of up to this much in each direction of x, y and z.
        acceleration: metres a second, every second.
        size: how many times as large as its mesh a particle is when it begins, and when it ends.
        spin: radians a second that particles turn, at most, around axes of their own; around the eye's if they face it.
    """

    particles: int = 64
    lifetime: float = 2.0
    box: tuple[float, float, float] = (0.0, 0.0, 0.0)
    velocity: tuple[float, float, float] = (0.0, 3.0, 0.0)
    spread: float = 1.0
    acceleration: tuple[float, float, float] = (0.0, -9.81, 0.0)
    size: tuple[float, float] = (1.0, 1.0)
    spin: float = 0.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_PARTICLES)
        for name, least, most in (
            ("particles", 1, 1 << 20),
            ("lifetime", 1e-3, _LARGEST),
            ("box", 0.0, _LARGEST),
            ("velocity", -_LARGEST, _LARGEST),
            ("spread", 0.0, _LARGEST),
            ("acceleration", -_LARGEST, _LARGEST),
            ("size", 0.0, _LARGEST),
            ("spin", 0.0, _LARGEST),
        ):
            values = np.atleast_1d(np.asarray(getattr(self, name), np.float64))
            if not ((values >= least) & (values <= most)).all():
                value = getattr(self, name)
                refuse(rules.BAD_PARTICLES, f"Emitter({name}=...)", value, f"{least:g} to {most:g}")

    def bounds(self, geometry: MeshGeometry) -> MeshBounds:
        """Return the lower and the upper corner (3,) of a box that copies of a mesh never leave."""
        middle, bend = np.array(self.velocity), 0.5 * np.array(self.acceleration)
        corners = []
        for speed in (middle - self.spread, middle + self.spread):
            turns = np.abs(2.0 * bend) * self.lifetime > np.abs(speed)  # before its end
            turning = np.divide(-speed, 2.0 * bend, out=np.zeros(3), where=turns)
            ages = np.stack([0.0 * speed, np.maximum(turning, 0.0), 0.0 * speed + self.lifetime])
            corners.append(speed * ages + bend * ages**2)
        ways = np.concatenate(corners)
        reach = np.linalg.norm(geometry.vertices["position"].astype(np.float64), axis=1).max()
        reach = _ROUNDING * (0.5 * np.array(self.box) + max(self.size) * reach) + 1e-6
        return ways.min(axis=0) * _ROUNDING - reach, ways.max(axis=0) * _ROUNDING + reach


class EmitterSimulation(MeshParticles):
    """The particles of `count` emitters of one kind.

    Attributes:
        emitter: what they are.
    """

    def __init__(
        self, count: int, emitter: Emitter, geometry: MeshGeometry, *, faces_eye: bool = False, seed: int = 0
    ) -> None:
        """Begin at time 0, with all particles in flight.

        Args:
            geometry: the mesh that each particle is a copy of.
            faces_eye: whether it turns its front, +z, to the eye.
            seed: how particles are thrown follows from it.

        Raises:
            ValidationError `scene-bad-particles`: a count below 1, or too many vertices.
        """
        self.catch_up = Recompute()
        self.emitter = emitter
        self._seed = seed
        self._seconds: Floats = np.zeros(count)
        super().__init__(count, emitter.particles, geometry, faces_eye=faces_eye)

    @property
    def bounds(self) -> MeshBounds:
        """The lower and the upper corner (3,) of a box that holds the particles of a member at all times."""
        return self.emitter.bounds(self.geometry)

    def set_time(self, members: Indices, seconds: float) -> None:
        """Set the time of `members` (j,)."""
        self._seconds[members] = seconds

    def pose(self, members: Indices) -> ParticlePoses:
        """Return the particles of `members` (j,) at their times."""
        emitter, count = self.emitter, self.copies
        turns = self._seconds[members][:, None] / emitter.lifetime + np.arange(count) / count
        throw = np.floor(turns)
        share = turns - throw
        random = self._hash(members, throw.astype(np.int64))
        age = (share * emitter.lifetime)[..., None]
        speed = np.array(emitter.velocity) + emitter.spread * (2.0 * random[..., 0:3] - 1.0)
        begin = np.array(emitter.box) * (random[..., 3:6] - 0.5)
        position = begin + speed * age + 0.5 * np.array(emitter.acceleration) * age**2
        size = emitter.size[0] + (emitter.size[1] - emitter.size[0]) * share
        angle = np.pi * random[..., 6] + 0.5 * emitter.spin * (2.0 * random[..., 7] - 1.0) * age[..., 0]
        height = 2.0 * random[..., 8] - 1.0
        around, width = 2.0 * np.pi * random[..., 9], np.sqrt(1.0 - height**2)
        axis = np.stack([width * np.cos(around), height, width * np.sin(around)], axis=-1)
        if self.faces_eye:
            axis[...] = (0.0, 0.0, 1.0)
        rotation = np.concatenate([axis * np.sin(angle)[..., None], np.cos(angle)[..., None]], axis=-1)
        return ParticlePoses(position, size, rotation)

    def _hash(self, members: Indices, throws: Indices) -> Floats:
        """Return numbers (j, p, 10) from 0 to 1 of the throws (j, p) of particles."""
        emitters = hash_to_unit((members + (self._seed << 20)).astype(np.uint64))
        first = (emitters * 2.0**53).astype(np.uint64)[:, None]
        key = first + (throws.astype(np.uint64) << np.uint64(21)) + np.arange(self.copies, dtype=np.uint64)
        keys = key[..., None] * np.uint64(_HASHES) + np.arange(_HASHES, dtype=np.uint64)
        return hash_to_unit(keys.astype(np.uint64))
