"""The step of a cloth on NumPy, in float32: operation by operation that of `kernels`.

Places and speeds follow from those of the two sub-steps before (BDF2, the backward differentiation formula of second
order), which loses next to no energy; that of first order lost a fifth of a swing's in twelve seconds.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Rows
from renderer.scene.cloth.sheets import GRAVITY, Sheet, Wind, find_normals

_TURN: Final = np.float32(2.0 * np.pi)
_LEAST: Final = np.float32(1e-20)


@dataclass(frozen=True, eq=False, slots=True)
class ConstraintBatch:
    """Constraints that share no point: their ends `a` and `b`, which of them are free (k, 1), how far they are apart
    (k, 1), and the sum of the weights (k, 1), softness included."""

    a: Rows
    b: Rows
    free_a: NDArray[np.float32]
    free_b: NDArray[np.float32]
    distance: NDArray[np.float32]
    weight: NDArray[np.float32]

    @classmethod
    def make(cls, sheet: Sheet, begin: int, end: int) -> ConstraintBatch:
        """Return some of the constraints of a sheet."""
        found, free = sheet.constraints[begin:end], sheet.is_free.astype(np.float32)[:, None]
        free_a, free_b = free[found["a"]], free[found["b"]]
        distance, softness = found["length"][:, None], found["softness"][:, None]
        return cls(found["a"], found["b"], free_a, free_b, distance, free_a + free_b + softness)

    def project(self, points: NDArray[np.float32]) -> None:
        """Move both ends of each constraint towards their distance, in all members' points (j, n, 3)."""
        a, b = points[:, self.a], points[:, self.b]
        way = b - a
        size = find_lengths(way)
        way *= (size - self.distance) / np.maximum(self.weight * size, _LEAST)
        points[:, self.a] = a + way * self.free_a
        points[:, self.b] = b - way * self.free_b


class ClothArrays:
    """The state of `count` cloths of one sheet in one wind, on NumPy.

    Attributes:
        points: (2, count, n, 3) float32, in m: now, and a sub-step before. speeds: the same, in m/s.
    """

    def __init__(self, sheet: Sheet, wind: Wind, points: NDArray[np.float32], speeds: NDArray[np.float32]) -> None:
        self.points, self.speeds = points, speeds
        self._sheet = sheet
        self._velocity = np.array(wind.velocity, np.float32)
        self._waves = [
            (np.array(gust.velocity, np.float32), sheet.points @ np.array(gust.along, np.float32))
            for gust in wind.gusts
        ]
        self._periods = wind.count_steps(sheet.interval)
        self._batches = [ConstraintBatch.make(sheet, begin, end) for begin, end in pairwise(sheet.batches.tolist())]

    def step(self, members: Rows, phases: Rows) -> None:
        """Take one step with `members` (j,); `phases` (j, MOST_GUSTS) are those of the gusts in steps."""
        sheet, fabric, count = self._sheet, self._sheet.fabric, self._sheet.sub_steps
        length = sheet.interval / count
        seconds, rate = np.float32(length), np.float32(1.0 / length)
        share = find_share(fabric.drag, length)
        kept = np.float32(1.0) - find_share(fabric.damping, length)
        fall = np.array([0.0, -GRAVITY * length, 0.0], np.float32)
        wind = self._blow(phases)
        (points, older), (speeds, slower) = self.points[:, members], self.speeds[:, members]
        for _ in range(count):
            normal = find_normals(points, sheet.rows, sheet.columns)
            pulled = speeds + fall
            pulled += normal * (share * (normal * (wind - pulled)).sum(-1, keepdims=True))
            pulled = (speeds * 2.0 - slower + pulled * (kept * np.float32(2.0))) / np.float32(3.0)
            pulled[:, ~sheet.is_free] = 0.0
            before, slower = points, speeds
            points = points + ((points - older) / np.float32(3.0) + pulled * (seconds * np.float32(2.0 / 3.0)))
            for batch in self._batches:
                batch.project(points)
            way = points - sheet.anchors
            far = find_lengths(way)
            reach = sheet.reaches[:, None]
            points = np.where(far > reach, sheet.anchors + way * (reach / np.maximum(far, _LEAST)), points)
            points = np.clip(points, sheet.lower, sheet.upper)
            speeds = ((points - before) * np.float32(1.5) - (before - older) * np.float32(0.5)) * rate
            older = before
        self.points[:, members], self.speeds[:, members] = (points, older), (speeds, slower)

    def _blow(self, phases: Rows) -> NDArray[np.float32]:
        """Return the wind at the points of each member, (j, n, 3)."""
        wind = np.broadcast_to(self._velocity, (len(phases), len(self._sheet.points), 3)).astype(np.float32)
        for number, (velocity, along) in enumerate(self._waves):
            period = np.float32(self._periods[number])
            turn = phases[:, number, None].astype(np.float32) / period + along
            wind += np.sin(_TURN * (turn - np.floor(turn)))[..., None] * velocity
        return wind


def find_lengths(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the lengths (..., 1) of vectors (..., 3); `np.linalg.norm` takes three times as long for a few."""
    lengths: NDArray[np.float32] = np.sqrt(np.einsum("...i,...i->...", vectors, vectors))[..., None]
    return lengths


def find_share(rate: float, seconds: float) -> np.float32:
    """Return the share that a sub-step has of an exponential decay at a `rate` per second: 0 to 1 for any rate."""
    return np.float32(1.0 - np.exp(-rate * seconds))
