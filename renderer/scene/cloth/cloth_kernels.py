"""The step of cloths on the device: a work-group for each cloth, all steps and sub-steps in one dispatch.

Of places and speeds the first half is what they are, the second what they were a sub-step before.

The lanes of a group share the points, and wait for each other after each batch of constraints. The last thing
that a group does is to write the cloth's vertices where they are drawn from, with their normals.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.scene.cloth.cloth_grid import MAX_GUSTS

LANES: Final = 64
_TWO_PI: Final = 6.283185307179586
_MIN_DIVISOR: Final = 1e-20
_FLAT: Final = 1e-12


class ClothPoint(sl.Struct):
    """A point of a sheet: where it is at first, 1 if it isn't pinned, its pin, and how far away that may
    be."""

    start: sl.vec3
    free: float
    anchor: sl.vec3
    reach: float


class ClothConstraint(sl.Struct):
    """Two points that keep their distance."""

    a: int
    b: int
    distance: float
    softness: float


class ClothJob(sl.Struct):
    """The work of a group: advance a cloth by `steps`, and write its vertices.

    `first` is the float with which its vertices begin, negative if none are to be written, and `stride` the
    floats from vertex to vertex. `phases` are those of the gusts in the first step, in steps.
    """

    member: int
    steps: int
    first: int
    stride: int
    phases: sl.ivec4


class ClothGust(sl.Struct):
    """A wave of wind."""

    velocity: sl.vec3
    along: sl.vec3


class ClothConstants(sl.Struct):
    """The constants of all cloths and steps; `seconds` is two thirds of a sub-step."""

    rows: int
    columns: int
    batches: int
    sub_steps: int
    lower: sl.vec3
    upper: sl.vec3
    gravity_step: sl.vec3
    velocity: sl.vec3
    seconds: float
    rate: float
    drag_factor: float
    damping_factor: float
    periods: sl.ivec4
    gusts: sl.Array[ClothGust] = sl.array(ClothGust, MAX_GUSTS)


class StepCloths(sl.Shader):
    """Takes the steps of cloths, and writes their vertices."""

    work_group = (LANES,)
    cloth: sl.Uniform[ClothConstants]
    points: sl.Storage[ClothPoint]
    constraints: sl.Storage[ClothConstraint]
    batches: sl.Storage[int]
    jobs: sl.Storage[ClothJob]
    positions: sl.StorageRW[sl.vec4]
    velocities: sl.StorageRW[sl.vec4]
    winds: sl.StorageRW[sl.vec4]
    vertices: sl.StorageRW[float]

    def compute(self) -> None:
        lane = sl.local_index()
        job = self.jobs[sl.group_id().x]
        count = self.cloth.rows * self.cloth.columns
        first = job.member * count
        for step in range(job.steps):
            for point in range(lane, count, LANES):
                self.winds[first + point] = sl.vec4(self.compute_wind(point, job, step), 0.0)
            for _ in range(self.cloth.sub_steps):
                self.take_substep(first, count, lane)
        if job.first >= 0:
            for point in range(lane, count, LANES):
                position = self.positions[first + point].xyz
                normal = self.compute_normal(first, point)
                at = job.first + point * job.stride
                self.vertices[at] = position.x
                self.vertices[at + 1] = position.y
                self.vertices[at + 2] = position.z
                self.vertices[at + 3] = normal.x
                self.vertices[at + 4] = normal.y
                self.vertices[at + 5] = normal.z

    def take_substep(self, first: int, count: int, lane: int) -> None:
        """Take a sub-step: forces, constraints, and what no point leaves."""
        before = len(self.positions) // 2 + first
        for point in range(lane, count, LANES):
            speed = self.velocities[first + point].xyz
            pulled = speed + self.cloth.gravity_step
            normal = self.compute_normal(first, point)
            pulled += normal * (
                self.cloth.drag_factor * sl.dot(normal, self.winds[first + point].xyz - pulled)
            )
            pulled = (
                speed * 2.0 - self.velocities[before + point].xyz + pulled * (2.0 * self.cloth.damping_factor)
            ) / 3.0
            self.velocities[before + point] = sl.vec4(speed, 0.0)
            self.velocities[first + point] = sl.vec4(pulled * self.points[point].free, 0.0)
        sl.barrier()  # normals were found from all points
        for point in range(lane, count, LANES):
            position = self.positions[first + point].xyz
            pulled = self.velocities[first + point].xyz
            self.velocities[first + point] = sl.vec4(position, 0.0)  # for now, where the point was
            way = (position - self.positions[before + point].xyz) / 3.0 + pulled * self.cloth.seconds
            self.positions[first + point] = sl.vec4(position + way, 0.0)
        sl.barrier()
        for batch in range(self.cloth.batches):
            for number in range(self.batches[batch] + lane, self.batches[batch + 1], LANES):
                self.project(first, self.constraints[number])
            sl.barrier()
        for point in range(lane, count, LANES):
            position = self.positions[first + point].xyz
            anchor = self.points[point].anchor
            reach = self.points[point].reach
            way = position - anchor
            far = sl.length(way)
            if far > reach:
                position = anchor + way * (reach / far)
            position = sl.clamp(position, self.cloth.lower, self.cloth.upper)
            last = self.velocities[first + point].xyz
            speed = (
                (position - last) * 1.5 - (last - self.positions[before + point].xyz) * 0.5
            ) * self.cloth.rate
            self.positions[before + point] = sl.vec4(last, 0.0)
            self.positions[first + point] = sl.vec4(position, 0.0)
            self.velocities[first + point] = sl.vec4(speed, 0.0)
        sl.barrier()

    def project(self, first: int, constraint: ClothConstraint) -> None:
        """Move two points towards their distance."""
        a = self.positions[first + constraint.a].xyz
        b = self.positions[first + constraint.b].xyz
        free_a = self.points[constraint.a].free
        free_b = self.points[constraint.b].free
        way = b - a
        size = sl.length(way)
        weight = free_a + free_b + constraint.softness
        move = (size - constraint.distance) / sl.max(weight * size, _MIN_DIVISOR)
        self.positions[first + constraint.a] = sl.vec4(a + way * (free_a * move), 0.0)
        self.positions[first + constraint.b] = sl.vec4(b - way * (free_b * move), 0.0)

    def compute_normal(self, first: int, point: int) -> sl.vec3:
        """Return the unit normal at a point."""
        columns = self.cloth.columns
        row = point // columns
        column = point - row * columns
        line = first + row * columns
        across = (
            self.positions[line + sl.min(column + 1, columns - 1)].xyz
            - self.positions[line + sl.max(column - 1, 0)].xyz
        )
        above = sl.max(row - 1, 0) * columns + column
        below = sl.min(row + 1, self.cloth.rows - 1) * columns + column
        normal = sl.cross(across, self.positions[first + above].xyz - self.positions[first + below].xyz)
        size = sl.length(normal)
        return normal / size if size > _FLAT else sl.vec3(0.0, 0.0, 1.0)

    def compute_wind(self, point: int, job: ClothJob, step: int) -> sl.vec3:
        """Return the wind at a point in a step of a job."""
        wind = self.cloth.velocity
        for number in range(MAX_GUSTS):
            period = self.cloth.periods[number]
            phase = float((job.phases[number] + step) % period) / float(period)
            turn = phase + sl.dot(self.points[point].start, self.cloth.gusts[number].along)
            wind += self.cloth.gusts[number].velocity * sl.sin(_TWO_PI * (turn - sl.floor(turn)))
        return wind
