"""The step of cloths on the device: a work-group for each cloth, all steps and sub-steps in one dispatch.

Of places and speeds the first half is what they are, the second what they were a sub-step before.

The lanes of a group share the points, and wait for each other after each batch of constraints. The last thing that a
group does is to write the cloth's vertices where they are drawn from, with their normals.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.scene.cloth.sheets import MOST_GUSTS

LANES: Final = 64
_TURN: Final = 6.283185307179586
_LEAST: Final = 1e-20
_FLAT: Final = 1e-12


class ClothPoint(sl.Struct):
    """A point of a sheet: where it is at first, 1 if it isn't pinned, its pin, and how far away that may be."""

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

    `first` is the float with which its vertices begin, negative if none are to be written, and `stride` the floats from
    vertex to vertex. `phases` are those of the gusts in the first step, in steps.
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
    """The constants of all cloths and steps; `seconds` are two thirds of those of a sub-step."""

    rows: int
    columns: int
    batches: int
    substeps: int
    lower: sl.vec3
    upper: sl.vec3
    fall: sl.vec3
    velocity: sl.vec3
    seconds: float
    rate: float
    share: float
    kept: float
    periods: sl.ivec4
    gusts: sl.Array[ClothGust] = sl.array(ClothGust, MOST_GUSTS)


class StepCloths(sl.Shader):
    """Takes the steps of cloths, and writes their vertices."""

    work_group = (LANES,)
    cloth: sl.Uniform[ClothConstants]
    points: sl.Storage[ClothPoint]
    constraints: sl.Storage[ClothConstraint]
    batches: sl.Storage[int]
    jobs: sl.Storage[ClothJob]
    places: sl.StorageRW[sl.vec4]
    speeds: sl.StorageRW[sl.vec4]
    winds: sl.StorageRW[sl.vec4]
    vertices: sl.StorageRW[float]

    def compute(self) -> None:
        lane = sl.local_index()
        job = self.jobs[sl.group_id().x]
        count = self.cloth.rows * self.cloth.columns
        first = job.member * count
        for step in range(job.steps):
            for point in range(lane, count, LANES):
                self.winds[first + point] = sl.vec4(self.blow(point, job, step), 0.0)
            for _ in range(self.cloth.substeps):
                self.take_substep(first, count, lane)
        if job.first >= 0:
            for point in range(lane, count, LANES):
                place = self.places[first + point].xyz
                normal = self.find_normal(first, point)
                at = job.first + point * job.stride
                self.vertices[at] = place.x
                self.vertices[at + 1] = place.y
                self.vertices[at + 2] = place.z
                self.vertices[at + 3] = normal.x
                self.vertices[at + 4] = normal.y
                self.vertices[at + 5] = normal.z

    def take_substep(self, first: int, count: int, lane: int) -> None:
        """Take a sub-step: forces, constraints, and what no point leaves."""
        before = len(self.places) // 2 + first
        for point in range(lane, count, LANES):
            speed = self.speeds[first + point].xyz
            pulled = speed + self.cloth.fall
            normal = self.find_normal(first, point)
            pulled += normal * (self.cloth.share * sl.dot(normal, self.winds[first + point].xyz - pulled))
            pulled = (speed * 2.0 - self.speeds[before + point].xyz + pulled * (2.0 * self.cloth.kept)) / 3.0
            self.speeds[before + point] = sl.vec4(speed, 0.0)
            self.speeds[first + point] = sl.vec4(pulled * self.points[point].free, 0.0)
        sl.barrier()  # normals were found from all points
        for point in range(lane, count, LANES):
            place = self.places[first + point].xyz
            pulled = self.speeds[first + point].xyz
            self.speeds[first + point] = sl.vec4(place, 0.0)  # for now, where the point was
            way = (place - self.places[before + point].xyz) / 3.0 + pulled * self.cloth.seconds
            self.places[first + point] = sl.vec4(place + way, 0.0)
        sl.barrier()
        for batch in range(self.cloth.batches):
            for number in range(self.batches[batch] + lane, self.batches[batch + 1], LANES):
                self.project(first, self.constraints[number])
            sl.barrier()
        for point in range(lane, count, LANES):
            place = self.places[first + point].xyz
            anchor = self.points[point].anchor
            reach = self.points[point].reach
            way = place - anchor
            far = sl.length(way)
            if far > reach:
                place = anchor + way * (reach / far)
            place = sl.clamp(place, self.cloth.lower, self.cloth.upper)
            last = self.speeds[first + point].xyz
            speed = ((place - last) * 1.5 - (last - self.places[before + point].xyz) * 0.5) * self.cloth.rate
            self.places[before + point] = sl.vec4(last, 0.0)
            self.places[first + point] = sl.vec4(place, 0.0)
            self.speeds[first + point] = sl.vec4(speed, 0.0)
        sl.barrier()

    def project(self, first: int, constraint: ClothConstraint) -> None:
        """Move two points towards their distance."""
        a = self.places[first + constraint.a].xyz
        b = self.places[first + constraint.b].xyz
        free_a = self.points[constraint.a].free
        free_b = self.points[constraint.b].free
        way = b - a
        size = sl.length(way)
        weight = free_a + free_b + constraint.softness
        move = (size - constraint.distance) / sl.max(weight * size, _LEAST)
        self.places[first + constraint.a] = sl.vec4(a + way * (free_a * move), 0.0)
        self.places[first + constraint.b] = sl.vec4(b - way * (free_b * move), 0.0)

    def find_normal(self, first: int, point: int) -> sl.vec3:
        """Return the unit normal at a point."""
        columns = self.cloth.columns
        row = point // columns
        column = point - row * columns
        line = first + row * columns
        across = self.places[line + sl.min(column + 1, columns - 1)].xyz - self.places[line + sl.max(column - 1, 0)].xyz
        above = sl.max(row - 1, 0) * columns + column
        below = sl.min(row + 1, self.cloth.rows - 1) * columns + column
        normal = sl.cross(across, self.places[first + above].xyz - self.places[first + below].xyz)
        size = sl.length(normal)
        return normal / size if size > _FLAT else sl.vec3(0.0, 0.0, 1.0)

    def blow(self, point: int, job: ClothJob, step: int) -> sl.vec3:
        """Return the wind at a point in a step of a job."""
        wind = self.cloth.velocity
        for number in range(MOST_GUSTS):
            period = self.cloth.periods[number]
            phase = float((job.phases[number] + step) % period) / float(period)
            turn = phase + sl.dot(self.points[point].start, self.cloth.gusts[number].along)
            wind += self.cloth.gusts[number].velocity * sl.sin(_TURN * (turn - sl.floor(turn)))
        return wind
