"""Simulations of objects (particles, cloth, skinning) that are only stepped where the objects are drawn.

A simulation has members: objects with a mesh of their own, whose vertices it computes. It goes in steps of constant
length, so that skipped steps can be made up for: a member that isn't drawn isn't stepped. When it is drawn again, it
takes the steps that it has missed, and looks as if it had been stepped all the time. A state may be forgotten after a
number of steps, such as that of a drop after the drop is thrown again; then a member takes that number of steps at
most.

Whether an object is visible depends on its bounds, and those of objects that aren't stepped aren't known. So a
simulated mesh is added with bounds that hold at all times (`SceneBuilder.add_mesh(..., bounds=...)`).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Rows

__rhi_internal__ = True


_EARLY: Final = 1e-6  # of a step: a time that rounding has put just before a step counts as the step


class ObjectSimulation(Protocol):
    """A simulation of k objects, its members. A `deepcopy` is independent of the original.

    Attributes:
        interval: the length of a step in seconds.
        memory: the number of steps after which an earlier state has no effect any more; None if it always has one.
    """

    interval: float
    memory: int | None

    def step(self, members: Rows, numbers: Rows) -> None:
        """Advance `members` (j,) by one `interval`, each to its step of `numbers` (j,), of which the first is 1.

        The same steps must give the same state to the last bit, whatever other members take them.
        """
        ...

    def vertices(self, member: int) -> NDArray[Any]:
        """Return the present vertices of a member, (v,) of `VERTEX`; their number never changes."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Simulated:
    """A simulation in its initial state, and the rows (k,) of the objects that are its members."""

    simulation: ObjectSimulation
    objects: Rows


@dataclass(frozen=True, eq=False, slots=True)
class Advanced:
    """The state of the object `row`, `member` of `simulation`: its step `number` determines its vertices."""

    row: int
    number: int
    simulation: ObjectSimulation
    member: int


class Simulator:
    """Steps those members of a scene's simulations that are drawn; a renderer has one.

    Attributes:
        objects: rows of the simulated objects, ascending.
        seconds: the time of the frame.
        steps: number of steps that members took since `begin_frame`. seen: number of members drawn since then.
    """

    def __init__(self, simulated: Sequence[Simulated], object_count: int) -> None:
        self._begin = tuple(simulated)
        self._which: Rows = np.full(object_count, -1, np.int64)
        self._member: Rows = np.zeros(object_count, np.int64)
        for which, one in enumerate(self._begin):
            self._which[one.objects] = which
            self._member[one.objects] = np.arange(len(one.objects))
        self.objects: Rows = np.flatnonzero(self._which >= 0)
        self.seconds = 0.0
        self.steps = 0
        self._seen = np.zeros(object_count, bool)
        self._restart()

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def seen(self) -> int:
        """The number of members drawn since `begin_frame`."""
        return int(self._seen[self.objects].sum())

    def begin_frame(self, seconds: float) -> None:
        """Begin a frame at the time `seconds`. If that is before the last frame's time, all simulations start
        again."""
        if seconds < self.seconds:
            self._restart()
        self.seconds = seconds
        self.steps = 0
        self._seen[self.objects] = False

    def advance(self, rows: Rows) -> list[Advanced]:
        """Step the simulated ones of the objects `rows` to the frame's time, and return their states."""
        advanced: list[Advanced] = []
        if not self._begin:
            return advanced
        rows = rows[self._which[rows] >= 0]
        self._seen[rows] = True
        for which, simulation in enumerate(self._simulations):
            chosen = rows[self._which[rows] == which]
            members = self._member[chosen]
            numbers = self._numbers[which]
            target = int(self.seconds / simulation.interval + _EARLY)
            if simulation.memory is not None:
                numbers[members] = np.maximum(numbers[members], target - simulation.memory)
            while (behind := members[numbers[members] < target]).size:
                numbers[behind] += 1
                simulation.step(behind, numbers[behind])
                self.steps += len(behind)
            places = zip(chosen.tolist(), members.tolist(), numbers[members].tolist(), strict=True)
            advanced += [Advanced(row, number, simulation, member) for row, member, number in places]
        return advanced

    def list_drawn(self) -> list[tuple[ObjectSimulation, Rows, Rows]]:
        """Return for each simulation the rows (j,) of its objects that were drawn since `begin_frame`, and which
        members (j,) they are."""
        rows = self.objects[self._seen[self.objects]]
        parts = [rows[self._which[rows] == which] for which in range(len(self._simulations))]
        return [
            (simulation, part, self._member[part])
            for simulation, part in zip(self._simulations, parts, strict=True)
        ]

    def _restart(self) -> None:
        self._simulations = [deepcopy(one.simulation) for one in self._begin]
        self._numbers: list[Rows] = [np.zeros(len(one.objects), np.int64) for one in self._begin]
