"""What happens over time and is only worth working out where it is seen: particles, cloth, skinning.

A simulation has members, each an object with a mesh of its own, whose vertices it makes. It goes in steps of one
length, so that what was left out can be made up for: a member that isn't drawn isn't stepped, and one that is
drawn again takes the steps that it missed, and looks as if it had never been away. Where a state is forgotten
after some steps, as a drop's once the drop is thrown anew, it takes these at most.

Whether something is seen depends on bounds, and those of what isn't stepped aren't known. So a simulated mesh is
added with bounds that hold at all times (`SceneBuilder.add_mesh(..., bounds=...)`).
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


_EARLY: Final = 1e-6  # of a step: a time that rounding put just before one counts as on it


class ObjectSimulation(Protocol):
    """What k members do. A copy (`deepcopy`) goes its own way.

    Attributes:
        interval: seconds of a step.
        memory: after how many steps nothing is left of an earlier state; None if something always is.
    """

    interval: float
    memory: int | None

    def step(self, members: Rows, numbers: Rows) -> None:
        """Let `members` (j,) go one `interval` on, each to its step of `numbers` (j,), of which 1 is the first.

        The same steps give the same state to the last bit, whoever else takes them.
        """
        ...

    def vertices(self, member: int) -> NDArray[Any]:
        """(v,) of `VERTEX`: its mesh as it is now, as many as it has always had."""
        ...


@dataclass(frozen=True, eq=False, slots=True)
class Simulated:
    """A simulation of a scene at its beginning, and the objects (k,) that its members are."""

    simulation: ObjectSimulation
    objects: Rows


@dataclass(frozen=True, eq=False, slots=True)
class Advanced:
    """The object `row`, `member` of `simulation`, is at its step `number`: which says all about its vertices."""

    row: int
    number: int
    simulation: ObjectSimulation
    member: int


class Simulator:
    """Steps the simulations of a scene, of what is drawn alone; a renderer has one.

    Attributes:
        objects: rows of the objects that are simulated, ascending.
        seconds: the time that what is drawn is brought to.
        steps: that members took since `begin_frame`; seen: members that were drawn since.
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
        """How many members were drawn since `begin_frame`."""
        return int(self._seen[self.objects].sum())

    def begin_frame(self, seconds: float) -> None:
        """What is drawn from now on is drawn at this time; if that is before the last frame's, from the beginning
        on."""
        if seconds < self.seconds:
            self._restart()
        self.seconds = seconds
        self.steps = 0
        self._seen[self.objects] = False

    def advance(self, rows: Rows) -> list[Advanced]:
        """Bring what is simulated among the objects `rows` up to the frame's time; those, and where they are."""
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

    def _restart(self) -> None:
        self._simulations = [deepcopy(one.simulation) for one in self._begin]
        self._numbers: list[Rows] = [np.zeros(len(one.objects), np.int64) for one in self._begin]
