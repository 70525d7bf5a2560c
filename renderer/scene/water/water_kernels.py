"""The step of pools on the device: a work-group for each pool, all of its steps in one dispatch.

Heights are kept for even and for odd steps. A step writes over those of two steps before, of which it reads
only the one that it writes; so lanes wait for each other once a step, and once more after a drop has fallen.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.scene.arrays import Indices
from rhi import Device, StorageBuffer

LANES: Final = 64
_MAX_ITERATIONS: Final = 40_000  # of a lane in a dispatch: llvmpipe ends loops after 65,535
_MIN_DROP_HEIGHT: Final = 1e-9  # metres: lower drops aren't there


class PoolJob(sl.Struct):
    """The job of a work-group: advance a pool by `steps` steps and write its vertices.

    Attributes:
        member: the pool's number.
        begin: the number of the first step.
        steps: how many steps to take.
        is_reset: whether the pool begins flat.
        drops: the number of the first step's drop.
        first: the index of the first float of the vertices; negative if none are written.
        stride: the number of floats from vertex to vertex.
    """

    member: int
    begin: int
    steps: int
    is_reset: int
    drops: int
    first: int
    stride: int


class PoolConstants(sl.Struct):
    """The constants of all pools and steps.

    Attributes:
        columns, rows: the number of points along x and z.
        spacing: the metres between two points along x and z.
        courant_squared: the squared Courant numbers along x and z (`WaterPool.courant_squared`).
        damping_factor: the fraction of a wave that is left after a step.
        radius: the radius of a drop, in metres.
        max_height: the greatest height of the surface, in metres.
    """

    columns: int
    rows: int
    spacing: sl.vec2
    courant_squared: sl.vec2
    damping_factor: float
    radius: float
    max_height: float


class StepPools(sl.Shader):
    """Takes the steps of pools, and writes their vertices."""

    work_group = (LANES,)
    pool: sl.Uniform[PoolConstants]
    jobs: sl.Storage[PoolJob]
    drops: sl.Storage[sl.vec4]
    heights: sl.StorageRW[float]
    vertices: sl.StorageRW[float]

    def compute(self) -> None:
        lane = sl.local_index()
        job = self.jobs[sl.group_id().x]
        count = self.pool.columns * self.pool.rows
        even = 2 * job.member * count
        if job.is_reset == 1:
            for point in range(lane, 2 * count, LANES):
                self.heights[even + point] = 0.0
        sl.barrier()
        for step in range(job.steps):
            after = even + (job.begin + step) % 2 * count
            now = 2 * even + count - after
            drop = self.drops[job.drops + step]
            for point in range(lane, count, LANES):
                if drop.z > _MIN_DROP_HEIGHT:
                    bump = self.drop_lift(point, drop)
                    self.heights[now + point] += bump
                    self.heights[after + point] += bump
            sl.barrier()
            for point in range(lane, count, LANES):
                height = self.pool.damping_factor * (
                    2.0 * self.heights[now + point] + self.curvature(now, point)
                )
                height -= self.pool.damping_factor * self.pool.damping_factor * self.heights[after + point]
                self.heights[after + point] = sl.clamp(height, -self.pool.max_height, self.pool.max_height)
            sl.barrier()
        if job.first >= 0:
            last = even + (job.begin + job.steps + 1) % 2 * count
            for point in range(lane, count, LANES):
                self.write_vertex(job.first + point * job.stride, last, point)

    def drop_lift(self, point: int, drop: sl.vec4) -> float:
        """Return the height by which a drop lifts a point: its middle rises by the volume that sinks around
        it."""
        position = (
            sl.vec2(float(point % self.pool.columns), float(point // self.pool.columns)) * self.pool.spacing
        )
        way = (position - drop.xy) / self.pool.radius
        square = sl.dot(way, way)
        return drop.z * (1.0 - square) * sl.exp(-square)

    def curvature(self, first: int, point: int) -> float:
        """Return the curvature of the surface at a point, times `courant_squared`; walls reflect."""
        columns = self.pool.columns
        row = point // columns
        column = point - row * columns
        line = first + row * columns
        left = self.heights[line + (1 if column == 0 else column - 1)]
        right = self.heights[line + (column - 1 if column == columns - 1 else column + 1)]
        above = self.heights[first + (1 if row == 0 else row - 1) * columns + column]
        below = self.heights[first + (row - 1 if row == self.pool.rows - 1 else row + 1) * columns + column]
        here = 2.0 * self.heights[first + point]
        return self.pool.courant_squared.x * (left + right - here) + self.pool.courant_squared.y * (
            above + below - here
        )

    def write_vertex(self, at: int, first: int, point: int) -> None:
        """Write a vertex's height and normal. Its x and z never change.

        Heights of neighbours differ by at most `max_height` (`WaterPool.break_waves`).
        """
        columns = self.pool.columns
        row = point // columns
        column = point - row * columns
        line = first + row * columns
        height = self.heights[first + point]
        left = self.heights[line + sl.max(column - 1, 0)]
        right = self.heights[line + sl.min(column + 1, columns - 1)]
        above = self.heights[first + sl.max(row - 1, 0) * columns + column]
        below = self.heights[first + sl.min(row + 1, self.pool.rows - 1) * columns + column]
        highest = sl.max(sl.max(left, right), sl.max(above, below))
        lowest = sl.min(sl.min(left, right), sl.min(above, below))
        rise_x = 0.0
        rise_z = 0.0
        if column > 0 and column < columns - 1:
            rise_x = (right - left) / (2.0 * self.pool.spacing.x)
        if row > 0 and row < self.pool.rows - 1:
            rise_z = (below - above) / (2.0 * self.pool.spacing.y)
        normal = sl.normalize(sl.vec3(-rise_x, 1.0, -rise_z))
        limit = self.pool.max_height
        self.vertices[at + 1] = sl.clamp(height, highest - limit, lowest + limit)
        self.vertices[at + 3] = normal.x
        self.vertices[at + 4] = normal.y
        self.vertices[at + 5] = normal.z


class PoolBuffers:
    """The state of pools on a device."""

    def __init__(self, device: Device, constants: PoolConstants, heights: NDArray[np.float32]) -> None:
        """`heights`: (count, 2, n), of even and of odd steps."""
        self.device = device
        self._shape = heights.shape
        self._max_steps = max(_MAX_ITERATIONS // (2 * -(-heights.shape[2] // LANES) + 1), 1)
        self._constants = device.uniform(constants)
        self._heights = device.storage(float, heights.reshape(-1), label="pool heights")
        self._nothing = device.storage(float, 1, label="no vertices")

    def run(
        self,
        members: Indices,
        numbers: Indices,
        steps: Indices,
        is_reset: Indices,
        drops: NDArray[np.float32],
        first_vertices: Indices,
        vertices: StorageBuffer[float] | None,
        stride: int,
    ) -> None:
        """Advance `members` (j,) by `steps` (j,) to their steps `numbers` (j,), and write their vertices.

        Args:
            is_reset: (j,) 1 for those that begin flat.
            drops: (j, most steps, 4), of each step.
            first_vertices: (j,), the number of each member's first vertex; without `vertices` nothing is
                written.
            stride: floats from vertex to vertex.
        """
        jobs: Any = np.zeros(len(members), PoolJob.dtype)
        jobs["member"], jobs["first"], jobs["is_reset"] = members, -1, is_reset
        end = drops.shape[1]
        for begin in range(0, max(end, 1), self._max_steps):
            jobs["steps"] = np.clip(steps - begin, 0, self._max_steps)
            jobs["begin"] = (numbers - steps + 1 + np.minimum(begin, steps)) % 2
            jobs["drops"] = end * np.arange(len(members)) + begin
            if vertices is not None and begin + self._max_steps >= end:
                jobs["first"], jobs["stride"] = stride * first_vertices, stride
            self.device.dispatch(
                self.device.program(StepPools),
                len(jobs),
                pool=self._constants,
                jobs=self.device.transient.storage(PoolJob, jobs),
                drops=self.device.transient.storage(
                    sl.vec4, drops.reshape(-1, 4) if end else np.zeros((1, 4), "f4")
                ),
                heights=self._heights,
                vertices=self._nothing if vertices is None else vertices,
            )
            jobs["is_reset"] = 0

    def read(self) -> NDArray[np.float32]:
        """Return the heights (count, 2, n). Waits for the device."""
        heights: NDArray[np.float32] = self._heights.read().reshape(self._shape).copy()
        return heights

    def destroy(self) -> None:
        """Destroy the buffers."""
        for buffer in (self._constants, self._heights, self._nothing):
            buffer.destroy()
