"""The simulation of cloths: which steps are due, and where they are taken.

When more steps were missed than a frame may take, the first of them are left out (`Leap`). Wind makes states
alike only in part: a flag may stay a metre away for good.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Indices
from renderer.scene.catch_up import Leap
from renderer.scene.cloth.cloth_buffers import ClothBuffers
from renderer.scene.cloth.cloth_grid import INTERVAL, ClothGrid, Wind
from renderer.scene.cloth.reference import ClothArrays
from renderer.scene.deferred_steps import DeferredSteps
from rhi import Device, StorageBuffer

_STEPS_PER_FRAME: Final = 240


class ClothSimulation(DeferredSteps[ClothArrays, ClothBuffers]):
    """A simulation of `count` cloths of one sheet in one wind, each in the space of its object.

    Attributes:
        cloth_grid: the sheet that all of them are.
        wind: the wind that blows on them.
        catch_up: its `error` is in metres: the greatest distance between two states of a point.
    """

    interval: float = INTERVAL

    def __init__(
        self,
        count: int,
        cloth_grid: ClothGrid,
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
        self.cloth_grid = cloth_grid
        self.wind = wind or Wind()
        self.interval = cloth_grid.interval
        self._periods = self.wind.count_steps(cloth_grid.interval)
        self._phase_offsets: Indices = np.random.default_rng([seed, 18]).integers(0, 1 << 30, (count, 1))
        super().__init__(count, rules.BAD_CLOTH)
        self.catch_up = Leap(max(steps_per_frame, count), error=cloth_grid.diameter)

    def _make_initial_state(self) -> ClothArrays:
        points = np.tile(self.cloth_grid.points, (2, len(self), 1, 1))
        return ClothArrays(self.cloth_grid, self.wind, points, np.zeros_like(points))

    def leap(self, members: Indices, numbers: Indices, counts: Indices) -> None:
        """Leave out `counts` (j,) steps of `members` (j,): only the wind goes on."""
        self._take_due_steps(members)
        self._number[members] = numbers

    def vertices(self, members: Indices) -> NDArray[Any]:
        """Return the vertices of `members` (j,), one after another. Waits for the device that has them."""
        self._take_due_steps(members)
        points = self._arrays.points[0] if self._buffers is None else self._buffers.read_points()
        return self.cloth_grid.make_vertices(points[members]).reshape(-1)

    def read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return points and speeds (count, n, 3) after the steps taken so far. Waits for the device that has
        them."""
        state = self._read()
        return state.points[0], state.velocities[0]

    def _read(self) -> ClothArrays:
        arrays, buffers = self._arrays, self._buffers
        state = (arrays.points.copy(), arrays.velocities.copy()) if buffers is None else buffers.read()
        return ClothArrays(self.cloth_grid, self.wind, *state)

    def _upload(self, device: Device, state: ClothArrays) -> ClothBuffers:
        return ClothBuffers(device, self.cloth_grid, self.wind, state.points, state.velocities)

    def _step(self, members: Indices, numbers: Indices) -> None:
        self._arrays.step(members, self._compute_phases(members, numbers))

    def _run(
        self, members: Indices, first_vertices: Indices, vertices: StorageBuffer[float] | None, stride: int
    ) -> None:
        assert self._buffers is not None
        phases = self._compute_phases(members, self._first_due_steps(members))
        self._buffers.run(members, self._due[members], phases, first_vertices, vertices, stride)

    def _compute_phases(self, members: Indices, numbers: Indices) -> Indices:
        """Return the phases of the gusts in the steps `numbers` (j,) of `members` (j,), (j, MAX_GUSTS): whole
        steps, exact after any time."""
        phases: Indices = (numbers[:, None] + self._phase_offsets[members]) % self._periods
        return phases
