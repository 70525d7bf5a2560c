"""The shaders that choose a field's triangles: two roots are bisected level by level.

A triangle that is to be split is three vertices of the grid: the ends of its longest edge and the apex
opposite. A vertex is row · 2^16 + column, so the middle of an edge is half the sum of its ends.
`BeginBisection` makes the roots, `Bisect` splits the triangles of one level and passes on the children that
are split, too, and writes the others to the mesh. `FinishBisection` tells the draws how many there are.

Whether an edge is split depends on nothing but its middle (`EdgeTest`), so both triangles at the edge agree.
"""

from __future__ import annotations

from typing import Final

import rhi.shading as sl
from renderer.shaders import MeshPart
from renderer.visibility.gpu.draw_lists import DrawArguments

GROUP: Final = 64
"""Number of triangles per work-group."""
MAX_LEVELS: Final = 24

SPLIT_COUNTS: Final = 0
"""Where the numbers of triangles begin that each level splits."""
WRITTEN_COUNTS: Final = MAX_LEVELS
"""Where the numbers of triangles begin that each level writes to the mesh."""
LIMIT_REACHED: Final = 2 * MAX_LEVELS
"""Where it is noted that the limit was reached."""
PREVIOUS_INDEX_COUNT: Final = LIMIT_REACHED + 1
"""Where the number of indices before is kept."""
COUNTER_COUNT: Final = PREVIOUS_INDEX_COUNT + 1


class GridVertex(sl.Struct):
    """A vertex of a height field: its height, and the length and the reach of `HeightField.bounds`."""

    height: float
    length: float
    reach: float


class FieldShape(sl.Struct):
    """The constants of a field: the position of vertex 0, the steps of the grid, its side in vertices, the
    number of levels, the limit of triangles, the place of its first index, and the rows of its mesh and of
    its draw."""

    corner: sl.vec2
    steps: sl.vec2
    side: int
    levels: int
    limit: int
    first: int
    mesh: int
    draw: int


class FieldView(sl.Struct):
    """A view in the space of a field, where reaches and lengths are as they are.

    What has n · p >= d is inside a plane (n, d) of `planes`. In perspective, `is_perspective` is 1, `depth`
    is the plane through the eye, and an edge is as long on screen as is wanted if it is its distance from
    that plane, divided by `scale`. In an orthographic projection, `is_perspective` is 0, that length is 1 /
    `scale` everywhere. `out_of_view_scale` is the scale for what is not in view, by the distance from the
    `eye`, whose square is multiplied by `squared_axis_ratio`."""

    depth: sl.vec4
    eye: sl.vec3
    scale: float
    out_of_view_scale: float
    squared_axis_ratio: float
    is_perspective: float
    planes: sl.Array[sl.vec4] = sl.array(sl.vec4, 6)


class Level(sl.Struct):
    """The level that is split."""

    number: int


@sl.function
def ordered_dot(n: sl.vec3, p: sl.vec3) -> float:
    """Return a dot product, rounded in the same order everywhere."""
    return n.x * p.x + n.y * p.y + n.z * p.z


class EdgeTest(sl.Shader):
    """Decides which edges are split."""

    shape: sl.Uniform[FieldShape]
    view: sl.Uniform[FieldView]
    grid: sl.Storage[GridVertex]

    def is_split(self, left: sl.uint, right: sl.uint) -> bool:
        """Return whether an edge is: it is long on screen and in view, or close enough to the eye
        otherwise."""
        middle = (left + right) >> sl.uint(1)
        row = int(middle >> sl.uint(16))
        column = int(middle & sl.uint(65535))
        vertex = self.grid[row * self.shape.side + column]
        x = self.shape.corner.x + self.shape.steps.x * float(column)
        z = self.shape.corner.y + self.shape.steps.y * float(row)
        p = sl.vec3(x, vertex.height, z)
        depth = ordered_dot(self.view.depth.xyz, p) - self.view.is_perspective * vertex.reach
        should_split = depth - vertex.length * self.view.scale <= self.view.depth.w
        for i in range(6):
            plane = self.view.planes[i]
            should_split = should_split and ordered_dot(plane.xyz, p) + vertex.reach >= plane.w
        away = p - self.view.eye
        perspective = self.view.is_perspective
        near = vertex.length * self.view.out_of_view_scale + perspective * vertex.reach
        return (
            should_split
            or perspective * self.view.squared_axis_ratio * ordered_dot(away, away) + (1.0 - perspective)
            <= near * near
        )


class BeginBisection(EdgeTest):
    """Begins with the two halves of the field. There is one group."""

    work_group = (GROUP,)
    counters: sl.StorageRW[sl.uint]
    split: sl.StorageRW[sl.uint]
    indices: sl.StorageRW[sl.uint]
    draws: sl.Storage[DrawArguments]

    def compute(self) -> None:
        lane = sl.local_index()
        if lane < COUNTER_COUNT:
            self.counters[lane] = (
                self.draws[self.shape.draw].count if lane == PREVIOUS_INDEX_COUNT else sl.uint(0)
            )
        sl.barrier()
        if lane < 2:
            n = self.shape.side - 1
            near = 65536 * n
            left = sl.uint(0 if lane == 0 else near + n)
            apex = sl.uint(near if lane == 0 else n)
            right = sl.uint(near + n if lane == 0 else 0)
            if self.shape.levels > 0 and self.is_split(left, right):
                self.split[3 * lane] = left
                self.split[3 * lane + 1] = apex
                self.split[3 * lane + 2] = right
                if lane == 0:
                    self.counters[SPLIT_COUNTS] = sl.uint(2)
            else:
                first = self.shape.first + 3 * lane
                last = self.shape.side * self.shape.side - 1
                self.indices[first] = sl.uint(0 if lane == 0 else last)
                self.indices[first + 1] = sl.uint(last - n if lane == 0 else n)
                self.indices[first + 2] = sl.uint(last if lane == 0 else 0)
                if lane == 0:
                    self.counters[WRITTEN_COUNTS] = sl.uint(2)


class Bisect(EdgeTest):
    """Splits the triangles of a level, unless there would be more than the limit: then they are kept, all of
    them, so that the mesh is one that a smaller number of levels gives."""

    work_group = (GROUP,)
    level: sl.Uniform[Level]
    split: sl.Storage[sl.uint]
    children: sl.StorageRW[sl.uint]
    counters: sl.StorageRW[sl.uint]
    indices: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        level = self.level.number
        count = int(self.counters[SPLIT_COUNTS + level])
        written = 0
        for earlier in range(level):
            written += int(self.counters[WRITTEN_COUNTS + earlier])
        if level == 0 and count == 0:
            return  # `BeginBisection` has kept the roots
        is_cut = written + 2 * count > self.shape.limit
        is_last = level + 1 == self.shape.levels
        triangle = sl.global_id().x
        while triangle < count:
            left = self.split[3 * triangle]
            apex = self.split[3 * triangle + 1]
            right = self.split[3 * triangle + 2]
            if is_cut:
                self.counters[LIMIT_REACHED] = sl.uint(1)
                self.write_triangle(
                    written + int(sl.atomic_add(self.counters[WRITTEN_COUNTS + level], sl.uint(1))),
                    left,
                    apex,
                    right,
                )
            else:
                middle = (left + right) >> sl.uint(1)
                goes_left = not is_last and self.is_split(apex, left)
                goes_right = not is_last and self.is_split(right, apex)
                deeper = int(goes_left) + int(goes_right)
                slot = 0
                if deeper > 0:
                    slot = int(sl.atomic_add(self.counters[SPLIT_COUNTS + level + 1], sl.uint(deeper)))
                written_slot = 0
                if deeper < 2:
                    written_slot = written + int(
                        sl.atomic_add(self.counters[WRITTEN_COUNTS + level], sl.uint(2 - deeper))
                    )
                if goes_left:
                    self.push_child(slot, apex, middle, left)
                    slot += 1
                else:
                    self.write_triangle(written_slot, apex, middle, left)
                    written_slot += 1
                if goes_right:
                    self.push_child(slot, right, middle, apex)
                else:
                    self.write_triangle(written_slot, right, middle, apex)
            triangle += sl.group_count().x * GROUP

    def push_child(self, slot: int, left: sl.uint, apex: sl.uint, right: sl.uint) -> None:
        """Record a triangle that the next level splits."""
        self.children[3 * slot] = left
        self.children[3 * slot + 1] = apex
        self.children[3 * slot + 2] = right

    def write_triangle(self, slot: int, left: sl.uint, apex: sl.uint, right: sl.uint) -> None:
        """Write a triangle to the mesh."""
        at = self.shape.first + 3 * slot
        self.indices[at] = self.index(left)
        self.indices[at + 1] = self.index(apex)
        self.indices[at + 2] = self.index(right)

    def index(self, vertex: sl.uint) -> sl.uint:
        """Return the index of a vertex in the mesh."""
        return (vertex >> sl.uint(16)) * sl.uint(self.shape.side) + (vertex & sl.uint(65535))


class FinishBisection(sl.Shader):
    """Writes the number of triangles to the draws, and empty triangles over what is left of those before."""

    work_group = (GROUP,)
    shape: sl.Uniform[FieldShape]
    counters: sl.Storage[sl.uint]
    indices: sl.StorageRW[sl.uint]
    draws: sl.StorageRW[DrawArguments]
    parts: sl.StorageRW[MeshPart]

    def compute(self) -> None:
        count = 0
        for level in range(MAX_LEVELS):
            count += 3 * int(self.counters[WRITTEN_COUNTS + level])
        slot = count + sl.global_id().x
        while slot < int(self.counters[PREVIOUS_INDEX_COUNT]):
            self.indices[self.shape.first + slot] = sl.uint(0)
            slot += sl.group_count().x * GROUP
        if sl.global_id().x == 0:
            self.draws[self.shape.draw].count = sl.uint(count)
            self.parts[self.shape.mesh].count = sl.uint(count)
