"""Fountains: drops that are thrown up, fall, and are thrown again; the simulation of the hall.

A fountain throws one drop in each step. Its direction is a function of the fountain's and the step's number,
so a drop's flight depends on nothing but the step in which it was thrown. When all drops have been thrown
again, nothing is left of an earlier state. With fewer drops steps are longer, and the drops are some of those
that there would be.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices, hash_to_unit
from renderer.scene.catch_up import Stepwise
from renderer.scene.meshes import VERTEX, MeshGeometry

DROPS: Final = 90
"""Number of drops of a fountain, unless it is asked for others. One is thrown in each step, so each flies for
this number of steps."""

_STEP: Final = 1.0 / 60.0
_STEPS_PER_FRAME: Final = 2048
_GRAVITY: Final = 9.81
_UP: Final = (5.2, 6.8)  # least and greatest upward speed in m/s
_AWAY: Final = 0.55  # greatest horizontal speed in m/s
_SIZE: Final = 0.045  # from a drop's centre to its corners
_CORNERS: Final = _SIZE * np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)]) / np.sqrt(3.0)
_FACES: Final = np.array([(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)])

BOUNDS: Final = (
    np.array([-1.0, 0.0, -1.0]) * (_AWAY * DROPS * _STEP) - _SIZE,
    np.array([1.0, 0.0, 1.0]) * (_AWAY * DROPS * _STEP) + (0.0, 0.5 * _UP[1] ** 2 / _GRAVITY, 0.0) + _SIZE,
)
"""The lower and upper corner (3,) of the box that drops never leave, with the nozzle at the origin."""


class FountainSimulation:
    """The simulation of `count` fountains, each with its nozzle at its own origin.

    22 fountains that show at once are up to date in that frame, of more some are late by a few frames.

    Attributes:
        interval: the length of a step in seconds: a drop flies for 1.5.
        position, velocity: (count, drops, 3) in m and m/s.
    """

    def __init__(self, count: int, seed: int, drops: int = DROPS) -> None:
        self.catch_up = Stepwise(max(_STEPS_PER_FRAME, count), memory=drops)
        self.interval = _STEP * (DROPS / drops)
        self._seed = seed
        self.position: Floats = np.zeros((count, drops, 3))
        self.velocity: Floats = np.zeros((count, drops, 3))

    def step(self, members: Indices, numbers: Indices) -> None:
        """Move the drops of `members` (j,), and throw one drop of each."""
        velocity, drops = self.velocity[members], self.position.shape[1]
        position = self.position[members] + velocity * self.interval
        position[:, :, 1] -= 0.5 * _GRAVITY * self.interval**2  # the parabola, exactly
        velocity[:, :, 1] -= _GRAVITY * self.interval
        np.maximum(position[:, :, 1], 0.0, out=position[:, :, 1])  # the basin
        member_indices, slot = np.arange(len(members)), numbers % drops
        position[member_indices, slot], velocity[member_indices, slot] = (
            0.0,
            self._throw(members, numbers * DROPS // drops),
        )
        self.position[members], self.velocity[members] = position, velocity

    def _throw(self, members: Indices, numbers: Indices) -> Floats:
        """Return velocities (j, 3): hashes of member and step number, so that skipping steps needs no
        state."""
        key = (members.astype(np.uint64) << np.uint64(40)) + numbers.astype(np.uint64) + np.uint64(self._seed)
        angle, away, up = (hash_to_unit(key * np.uint64(3) + np.uint64(part)) for part in range(3))
        away = _AWAY * np.sqrt(away)
        angle = 2.0 * np.pi * angle
        rise = _UP[0] + (_UP[1] - _UP[0]) * up
        return np.stack([away * np.cos(angle), rise, away * np.sin(angle)], axis=1)

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the vertices (12 * drops * j,) of `members` (j,): a tetrahedron for each drop."""
        return _tetrahedra(self.position[members].reshape(-1, 3))

    def particles(self, members: Indices) -> tuple[Floats, Floats]:
        """Return the positions and velocities (j, drops, 3) of the drops of `members` (j,)."""
        return self.position[members], self.velocity[members]


def make_drops(count: int = DROPS) -> MeshGeometry:
    """Make the mesh of a fountain before its first step: all drops are at the nozzle."""
    vertices = _tetrahedra(np.zeros((count, 3)))
    return MeshGeometry(vertices, np.arange(len(vertices), dtype=np.uint32))


def _tetrahedra(centres: Floats) -> NDArray[Any]:
    corners = _CORNERS[_FACES]  # (4, 3, 3)
    normals = corners.mean(axis=1)
    vertices = np.zeros((len(centres), 4, 3), VERTEX)
    vertices["position"] = centres[:, None, None] + corners
    vertices["normal"] = (normals / np.linalg.norm(normals, axis=1, keepdims=True))[:, None]
    return vertices.reshape(-1)
