"""The state of cloths on a device, and the dispatches that advance them.

A dispatch takes as many steps as a group has turns for: llvmpipe ends the loops of a shader after 65,535
turns, without an error, and other drivers end dispatches that take seconds. These are a hundred steps of a
cloth of a few hundred points. What a frame takes is one dispatch; only after an absence it is more.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Indices
from renderer.scene.cloth.cloth_grid import GRAVITY, MAX_GUSTS, ClothGrid, Wind
from renderer.scene.cloth.cloth_kernels import (
    LANES,
    ClothConstants,
    ClothConstraint,
    ClothGust,
    ClothJob,
    ClothPoint,
    StepCloths,
)
from renderer.scene.cloth.reference import decay_fraction
from rhi import Device, StorageBuffer
from rhi.shading import vec4

_MAX_ITERATIONS: Final = 40_000


class ClothBuffers:
    """The state of cloths of one sheet in one wind, on a device."""

    def __init__(
        self,
        device: Device,
        cloth_grid: ClothGrid,
        wind: Wind,
        points: NDArray[np.float32],
        velocities: NDArray[np.float32],
    ) -> None:
        """Upload the state: points and speeds (2, count, n, 3), laid out as in `ClothArrays`."""
        self.device = device
        self._shape = points.shape
        self._max_steps = max(_MAX_ITERATIONS // count_iterations(cloth_grid), 1)
        self._constants = device.uniform(_make_constants(cloth_grid, wind))
        at: Any = np.zeros(len(cloth_grid.points), ClothPoint.dtype)
        at["start"], at["free"] = cloth_grid.points, cloth_grid.is_free
        at["anchor"], at["reach"] = cloth_grid.anchors, cloth_grid.reaches
        self._points = device.storage(ClothPoint, at, label="cloth points")
        constraints: Any = np.zeros(len(cloth_grid.constraints), ClothConstraint.dtype)
        for name, value in (("a", "a"), ("b", "b"), ("distance", "length"), ("softness", "softness")):
            constraints[name] = cloth_grid.constraints[value]
        self._constraints = device.storage(ClothConstraint, constraints, label="cloth constraints")
        self._batches = device.storage(int, cloth_grid.batches, label="cloth batches")
        self._positions = device.storage(vec4, _pad(points), label="cloth places")
        self._velocities = device.storage(vec4, _pad(velocities), label="cloth speeds")
        self._winds = device.storage(vec4, self._positions.count // 2, label="cloth winds")
        self._nothing = device.storage(float, 1, label="no vertices")

    def run(
        self,
        members: Indices,
        steps: Indices,
        phases: Indices,
        first_vertices: Indices,
        vertices: StorageBuffer[float] | None,
        stride: int,
    ) -> None:
        """Advance `members` (j,) by `steps` (j,), and write their vertices.

        Args:
            phases: those of the gusts in the first of the steps, (j, MAX_GUSTS).
            first_vertices: (j,), the number of each member's first vertex; without `vertices` nothing is
                written.
            stride: floats from vertex to vertex.
        """
        jobs: Any = np.zeros(len(members), ClothJob.dtype)
        jobs["member"], jobs["first"] = members, -1
        end = int(steps.max())
        for begin in range(0, max(end, 1), self._max_steps):
            jobs["steps"] = np.clip(steps - begin, 0, self._max_steps)
            jobs["phases"] = phases + begin
            if vertices is not None and begin + self._max_steps >= end:
                jobs["first"], jobs["stride"] = stride * first_vertices, stride
            self._dispatch(jobs, self._nothing if vertices is None else vertices)

    def _dispatch(self, jobs: NDArray[Any], vertices: StorageBuffer[float]) -> None:
        self.device.dispatch(
            self.device.program(StepCloths),
            len(jobs),
            cloth=self._constants,
            points=self._points,
            constraints=self._constraints,
            batches=self._batches,
            jobs=self.device.transient.storage(ClothJob, jobs),
            positions=self._positions,
            velocities=self._velocities,
            winds=self._winds,
            vertices=vertices,
        )

    def read(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return points and speeds (2, count, n, 3). Waits for the device."""
        return self._read(self._positions), self._read(self._velocities)

    def read_points(self) -> NDArray[np.float32]:
        """Return the present points (count, n, 3). Waits for the device."""
        present: NDArray[np.float32] = self._read(self._positions, self._positions.count // 2)[0]
        return present

    def _read(self, buffer: StorageBuffer[vec4], count: int | None = None) -> NDArray[np.float32]:
        return buffer.read(0, count).reshape(-1, 4)[:, :3].reshape(-1, *self._shape[1:]).copy()

    def destroy(self) -> None:
        """Destroy the buffers."""
        self._constants.destroy()
        for buffer in (
            self._points,
            self._constraints,
            self._batches,
            self._positions,
            self._velocities,
            self._winds,
        ):
            buffer.destroy()
        self._nothing.destroy()


def count_iterations(cloth_grid: ClothGrid) -> int:
    """Return the number of iterations of the loops of a lane in a step."""
    points = -(-len(cloth_grid.points) // LANES)
    batches: int = sum(1 + -(-size // LANES) for size in np.diff(cloth_grid.batches).tolist())
    return 1 + points * (1 + MAX_GUSTS) + cloth_grid.sub_steps * (1 + 3 * points + batches)


def _pad(values: NDArray[np.float32]) -> NDArray[np.float32]:
    padded = np.zeros((values.size // 3, 4), np.float32)
    padded[:, :3] = values.reshape(-1, 3)
    return padded


def _make_constants(cloth_grid: ClothGrid, wind: Wind) -> ClothConstants:
    length = cloth_grid.interval / cloth_grid.sub_steps
    calm = ClothGust(velocity=(0.0, 0.0, 0.0), along=(0.0, 0.0, 0.0))
    gusts = [ClothGust(velocity=gust.velocity, along=gust.along) for gust in wind.gusts]
    return ClothConstants(
        rows=cloth_grid.rows,
        columns=cloth_grid.columns,
        batches=len(cloth_grid.batches) - 1,
        sub_steps=cloth_grid.sub_steps,
        lower=cloth_grid.lower,
        upper=cloth_grid.upper,
        gravity_step=(0.0, -GRAVITY * length, 0.0),
        velocity=wind.velocity,
        seconds=length * (2.0 / 3.0),
        rate=1.0 / length,
        drag_factor=float(decay_fraction(cloth_grid.fabric.drag, length)),
        damping_factor=float(np.float32(1.0) - decay_fraction(cloth_grid.fabric.damping, length)),
        periods=wind.count_steps(cloth_grid.interval),
        gusts=[*gusts, *[calm] * (MAX_GUSTS - len(gusts))],
    )
