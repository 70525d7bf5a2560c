"""The step of cloths on the device: a work-group for each cloth, all steps and sub-steps in one dispatch.

Of places and speeds the first half is what they are, the second what they were a sub-step before.

The lanes of a group share the points, and wait for each other after each batch of constraints. The last thing that a
group does is to write the cloth's vertices where they are drawn from, with their normals.
"""

from __future__ import annotations

from typing import Final

from renderer.scene.cloth.sheets import MOST_GUSTS
from rhi.shading import (
    Array,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Uniform,
    array,
    barrier,
    clamp,
    cross,
    dot,
    floor,
    group_id,
    ivec4,
    length,
    local_index,
    max,
    min,
    sin,
    vec3,
    vec4,
)

LANES: Final = 64
_TURN: Final = 6.283185307179586
_LEAST: Final = 1e-20
_FLAT: Final = 1e-12


class ClothPoint(Struct):
    """A point of a sheet: where it is at first, 1 if it isn't pinned, its pin, and how far away that may be."""

    start: vec3
    free: float
    anchor: vec3
    reach: float


class ClothConstraint(Struct):
    """Two points that keep their distance."""

    a: int
    b: int
    distance: float
    softness: float


class ClothJob(Struct):
    """The work of a group: advance a cloth by `steps`, and write its vertices.

    `first` is the float with which its vertices begin, negative if none are to be written, and `stride` the floats from
    vertex to vertex. `phases` are those of the gusts in the first step, in steps.
    """

    member: int
    steps: int
    first: int
    stride: int
    phases: ivec4


class ClothGust(Struct):
    """A wave of wind."""

    velocity: vec3
    along: vec3


class ClothConstants(Struct):
    """The constants of all cloths and steps; `seconds` are two thirds of those of a sub-step."""

    rows: int
    columns: int
    batches: int
    substeps: int
    lower: vec3
    upper: vec3
    fall: vec3
    velocity: vec3
    seconds: float
    rate: float
    share: float
    kept: float
    periods: ivec4
    gusts: Array[ClothGust] = array(ClothGust, MOST_GUSTS)


class StepCloths(Shader):
    """Takes the steps of cloths, and writes their vertices."""

    work_group = (LANES,)
    cloth: Uniform[ClothConstants]
    points: Storage[ClothPoint]
    constraints: Storage[ClothConstraint]
    batches: Storage[int]
    jobs: Storage[ClothJob]
    places: StorageRW[vec4]
    speeds: StorageRW[vec4]
    winds: StorageRW[vec4]
    vertices: StorageRW[float]

    def compute(self) -> None:
        lane = local_index()
        job = self.jobs[group_id().x]
        count = self.cloth.rows * self.cloth.columns
        first = job.member * count
        for step in range(job.steps):
            for point in range(lane, count, LANES):
                self.winds[first + point] = vec4(self.blow(point, job, step), 0.0)
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
            pulled += normal * (self.cloth.share * dot(normal, self.winds[first + point].xyz - pulled))
            pulled = (speed * 2.0 - self.speeds[before + point].xyz + pulled * (2.0 * self.cloth.kept)) / 3.0
            self.speeds[before + point] = vec4(speed, 0.0)
            self.speeds[first + point] = vec4(pulled * self.points[point].free, 0.0)
        barrier()  # normals were found from all points
        for point in range(lane, count, LANES):
            place = self.places[first + point].xyz
            pulled = self.speeds[first + point].xyz
            self.speeds[first + point] = vec4(place, 0.0)  # for now, where the point was
            way = (place - self.places[before + point].xyz) / 3.0 + pulled * self.cloth.seconds
            self.places[first + point] = vec4(place + way, 0.0)
        barrier()
        for batch in range(self.cloth.batches):
            for number in range(self.batches[batch] + lane, self.batches[batch + 1], LANES):
                self.project(first, self.constraints[number])
            barrier()
        for point in range(lane, count, LANES):
            place = self.places[first + point].xyz
            anchor = self.points[point].anchor
            reach = self.points[point].reach
            way = place - anchor
            far = length(way)
            if far > reach:
                place = anchor + way * (reach / far)
            place = clamp(place, self.cloth.lower, self.cloth.upper)
            last = self.speeds[first + point].xyz
            speed = ((place - last) * 1.5 - (last - self.places[before + point].xyz) * 0.5) * self.cloth.rate
            self.places[before + point] = vec4(last, 0.0)
            self.places[first + point] = vec4(place, 0.0)
            self.speeds[first + point] = vec4(speed, 0.0)
        barrier()

    def project(self, first: int, constraint: ClothConstraint) -> None:
        """Move two points towards their distance."""
        a = self.places[first + constraint.a].xyz
        b = self.places[first + constraint.b].xyz
        free_a = self.points[constraint.a].free
        free_b = self.points[constraint.b].free
        way = b - a
        size = length(way)
        weight = free_a + free_b + constraint.softness
        move = (size - constraint.distance) / max(weight * size, _LEAST)
        self.places[first + constraint.a] = vec4(a + way * (free_a * move), 0.0)
        self.places[first + constraint.b] = vec4(b - way * (free_b * move), 0.0)

    def find_normal(self, first: int, point: int) -> vec3:
        """Return the unit normal at a point."""
        columns = self.cloth.columns
        row = point // columns
        column = point - row * columns
        line = first + row * columns
        across = self.places[line + min(column + 1, columns - 1)].xyz - self.places[line + max(column - 1, 0)].xyz
        above = max(row - 1, 0) * columns + column
        below = min(row + 1, self.cloth.rows - 1) * columns + column
        normal = cross(across, self.places[first + above].xyz - self.places[first + below].xyz)
        size = length(normal)
        return normal / size if size > _FLAT else vec3(0.0, 0.0, 1.0)

    def blow(self, point: int, job: ClothJob, step: int) -> vec3:
        """Return the wind at a point in a step of a job."""
        wind = self.cloth.velocity
        for number in range(MOST_GUSTS):
            period = self.cloth.periods[number]
            phase = float((job.phases[number] + step) % period) / float(period)
            turn = phase + dot(self.points[point].start, self.cloth.gusts[number].along)
            wind += self.cloth.gusts[number].velocity * sin(_TURN * (turn - floor(turn)))
        return wind
