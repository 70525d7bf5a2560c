"""The simulation of cloths: which steps are due, and where they are taken.

A step that is asked for is only noted. It is taken when somebody wants to see the cloth: on the device together with
all that was noted since, or on NumPy as long as there is no device.

When more steps were missed than a frame may take, the first of them are left out (`Leap`). Wind makes states alike only
in part: a flag may stay a metre away for good.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Rows
from renderer.scene.catching_up import Leap
from renderer.scene.cloth.on_device import ClothBuffers
from renderer.scene.cloth.reference import ClothArrays
from renderer.scene.cloth.sheets import INTERVAL, Sheet, Wind
from rhi import Device, StorageBuffer
from rhi.errors import refuse

MOST_CLOTHS: Final = 65_535
"""The most cloths of one simulation: each is a work-group of a dispatch."""
_STEPS_PER_FRAME: Final = 240


class Cloths:
    """A simulation of `count` cloths of one sheet in one wind, each in the space of its object.

    Attributes:
        sheet, wind: what they are and what blows on them.
        catch_up: its `error` is in metres: the greatest distance between two states of a point.
    """

    interval: float = INTERVAL

    def __init__(
        self,
        count: int,
        sheet: Sheet,
        wind: Wind | None = None,
        *,
        seed: int = 0,
        steps_per_frame: int = _STEPS_PER_FRAME,
    ) -> None:
        """Begin with all cloths as their sheet is at first.

        Args:
            seed: gusts reach each cloth at a time of its own, which follows from this.
            steps_per_frame: the most steps that all of them together take in a frame, at least one each.

        Raises:
            ValidationError `scene-bad-cloth`: a count outside 1 to 65,535.
        """
        if not 1 <= count <= MOST_CLOTHS:
            refuse(rules.BAD_CLOTH, "Cloths(count=...)", count, f"1 to {MOST_CLOTHS:,}")
        self.sheet, self.wind, self.interval = sheet, wind or Wind(), sheet.interval
        self._periods = self.wind.count_steps(sheet.interval)
        self.catch_up = Leap(max(steps_per_frame, count), error=sheet.diameter)
        self._later: Rows = np.random.default_rng([seed, 18]).integers(0, 1 << 30, (count, 1))
        self._number: Rows = np.zeros(count, np.int64)  # of the last step that was asked for
        self._due: Rows = np.zeros(count, np.int64)  # how many of the last ones weren't taken yet
        self._state: ClothArrays | ClothBuffers = self._begin()

    def __len__(self) -> int:
        return len(self._number)

    def __deepcopy__(self, memo: object) -> Cloths:
        """Return a copy with a state of its own; where this one's is on a device, that waits for it."""
        made = Cloths.__new__(Cloths)
        made.__dict__.update(self.__dict__)
        made._number, made._due = self._number.copy(), self._due.copy()
        made._state = ClothArrays(self.sheet, self.wind, *self._read())
        return made

    def _begin(self) -> ClothArrays:
        """Return the state of cloths that are as their sheet is at first."""
        points = np.tile(self.sheet.points, (2, len(self), 1, 1))
        return ClothArrays(self.sheet, self.wind, points, np.zeros_like(points))

    def step(self, members: Rows, numbers: Rows) -> None:
        """Note one more step for `members` (j,)."""
        self._number[members] = numbers
        self._due[members] += 1

    def leap(self, members: Rows, numbers: Rows, counts: Rows) -> None:
        """Leave out `counts` (j,) steps of `members` (j,): only the wind goes on."""
        self._take(members[self._due[members] > 0])
        self._number[members] = numbers

    def vertices(self, members: Rows) -> NDArray[Any]:
        """Return the vertices of `members` (j,), one after another. Waits for the device that has them."""
        self._take(members)
        state = self._state
        points = state.points[0] if isinstance(state, ClothArrays) else state.read_points()
        return self.sheet.make_vertices(points[members]).reshape(-1)

    def read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return points and speeds (count, n, 3) after the steps taken so far. Waits for the device that has them."""
        points, speeds = self._read()
        return points[0], speeds[0]

    def _read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        state = self._state
        return (state.points.copy(), state.speeds.copy()) if isinstance(state, ClothArrays) else state.read()

    def deform(self, device: Device, members: Rows, vertices: StorageBuffer[float], begins: Rows, stride: int) -> None:
        """Take the steps that are due of `members` (j,) on a device, and write their vertices. What a frame takes is
        one dispatch.

        Args:
            vertices: what is drawn. begins: (j,), the number of each member's first vertex in it.
            stride: floats from vertex to vertex.
        """
        if not isinstance(self._state, ClothBuffers) or self._state.device is not device:
            before, points_and_speeds = self._state, self._read()
            self._state = ClothBuffers(device, self.sheet, self.wind, *points_and_speeds)
            if isinstance(before, ClothBuffers):
                before.destroy()
        self._state.run(members, self._due[members], self._find_phases(members), begins, vertices, stride)
        self._due[members] = 0

    def release(self, device: Device) -> None:
        """Destroy what is on this device, if anything is: the cloths then begin again as their sheet."""
        if isinstance(self._state, ClothBuffers) and self._state.device is device:
            self._state.destroy()
            self._state = self._begin()

    def _take(self, members: Rows) -> None:
        """Take the steps that are due, where the state is."""
        due = self._due[members]
        members, due = members[due > 0], due[due > 0]
        if not len(members):
            return
        phases = self._find_phases(members)
        if isinstance(self._state, ClothBuffers):
            self._state.run(members, due, phases, np.zeros(len(members), np.int64), None, 0)
        else:
            for number in range(int(due.max())):
                going = due > number
                self._state.step(members[going], (phases[going] + number) % self._periods)
        self._due[members] = 0

    def _find_phases(self, members: Rows) -> Rows:
        """Return the phases of the gusts in the first step that is due, (j, MOST_GUSTS): whole steps, exact after any
        time."""
        first = self._number[members] - self._due[members] + 1
        phases: Rows = (first[:, None] + self._later[members]) % self._periods
        return phases
