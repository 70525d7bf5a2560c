"""The step of a cloth on NumPy, in float32: operation by operation that of `kernels`.

Places and speeds follow from those of the two sub-steps before (BDF2, the backward differentiation formula of
second order), which loses next to no energy; that of first order lost a fifth of a swing's in twelve seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Indices
from renderer.scene.cloth.cloth_grid import GRAVITY, ClothGrid, Wind, compute_grid_normals

_TWO_PI: Final = np.float32(2.0 * np.pi)
_MIN_DIVISOR: Final = np.float32(1e-20)


@dataclass(frozen=True, eq=False, slots=True)
class ConstraintBatch:
    """Constraints that share no point: their ends `a` and `b`, which of them are free (k, 1), how far they
    are apart (k, 1), and the sum of the weights (k, 1), softness included."""

    a: Indices
    b: Indices
    free_a: NDArray[np.float32]
    free_b: NDArray[np.float32]
    distance: NDArray[np.float32]
    weight: NDArray[np.float32]

    @classmethod
    def make(cls, cloth_grid: ClothGrid, begin: int, end: int) -> ConstraintBatch:
        """Return some of the constraints of a sheet."""
        constraints, free = cloth_grid.constraints[begin:end], cloth_grid.is_free.astype(np.float32)[:, None]
        free_a, free_b = free[constraints["a"]], free[constraints["b"]]
        distance, softness = constraints["length"][:, None], constraints["softness"][:, None]
        return cls(constraints["a"], constraints["b"], free_a, free_b, distance, free_a + free_b + softness)

    def project(self, points: NDArray[np.float32]) -> None:
        """Move both ends of each constraint towards their distance, in all members' points (j, n, 3)."""
        a, b = points[:, self.a], points[:, self.b]
        way = b - a
        size = vector_lengths(way)
        way *= (size - self.distance) / np.maximum(self.weight * size, _MIN_DIVISOR)
        points[:, self.a] = a + way * self.free_a
        points[:, self.b] = b - way * self.free_b


class ClothArrays:
    """The state of `count` cloths of one sheet in one wind, on NumPy.

    Attributes:
        points: (2, count, n, 3) float32, in m: now, and a sub-step before. speeds: the same, in m/s.
    """

    def __init__(
        self, cloth_grid: ClothGrid, wind: Wind, points: NDArray[np.float32], velocities: NDArray[np.float32]
    ) -> None:
        self.points, self.velocities = points, velocities
        self._grid = cloth_grid
        self._velocity = np.array(wind.velocity, np.float32)
        self._waves = [
            (np.array(gust.velocity, np.float32), cloth_grid.points @ np.array(gust.along, np.float32))
            for gust in wind.gusts
        ]
        self._periods = wind.count_steps(cloth_grid.interval)
        self._batches = [
            ConstraintBatch.make(cloth_grid, begin, end)
            for begin, end in pairwise(cloth_grid.batches.tolist())
        ]

    def step(self, members: Indices, phases: Indices) -> None:
        """Take one step with `members` (j,); `phases` (j, MAX_GUSTS) are the phases of the gusts, in
        steps."""
        cloth_grid = self._grid
        fabric = cloth_grid.fabric
        count = cloth_grid.sub_steps
        length = cloth_grid.interval / count
        seconds, rate = np.float32(length), np.float32(1.0 / length)
        drag_factor = decay_fraction(fabric.drag, length)
        damping_factor = np.float32(1.0) - decay_fraction(fabric.damping, length)
        gravity_step = np.array([0.0, -GRAVITY * length, 0.0], np.float32)
        wind = self._compute_wind(phases)
        (points, older), (velocities, slower) = self.points[:, members], self.velocities[:, members]
        for _ in range(count):
            normal = compute_grid_normals(points, cloth_grid.rows, cloth_grid.columns)
            pulled = velocities + gravity_step
            pulled += normal * (drag_factor * (normal * (wind - pulled)).sum(-1, keepdims=True))
            pulled = (velocities * 2.0 - slower + pulled * (damping_factor * np.float32(2.0))) / np.float32(
                3.0
            )
            pulled[:, ~cloth_grid.is_free] = 0.0
            before, slower = points, velocities
            points = points + (
                (points - older) / np.float32(3.0) + pulled * (seconds * np.float32(2.0 / 3.0))
            )
            for batch in self._batches:
                batch.project(points)
            way = points - cloth_grid.anchors
            far = vector_lengths(way)
            reach = cloth_grid.reaches[:, None]
            points = np.where(
                far > reach, cloth_grid.anchors + way * (reach / np.maximum(far, _MIN_DIVISOR)), points
            )
            points = np.clip(points, cloth_grid.lower, cloth_grid.upper)
            velocities = ((points - before) * np.float32(1.5) - (before - older) * np.float32(0.5)) * rate
            older = before
        self.points[:, members], self.velocities[:, members] = (points, older), (velocities, slower)

    def _compute_wind(self, phases: Indices) -> NDArray[np.float32]:
        """Return the wind at the points of each member, (j, n, 3)."""
        wind = np.broadcast_to(self._velocity, (len(phases), len(self._grid.points), 3)).astype(np.float32)
        for number, (velocity, along) in enumerate(self._waves):
            period = np.float32(self._periods[number])
            turn = phases[:, number, None].astype(np.float32) / period + along
            wind += np.sin(_TWO_PI * (turn - np.floor(turn)))[..., None] * velocity
        return wind


def vector_lengths(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lengths (..., 1) of vectors (..., 3); `np.linalg.norm` takes three times as long for a
    few."""
    lengths: NDArray[np.float32] = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return lengths


def decay_fraction(rate: float, seconds: float) -> np.float32:
    """Return the fraction of a value lost in a sub-step by exponential decay at `rate` per second: 0 to 1."""
    return np.float32(1.0 - np.exp(-rate * seconds))
