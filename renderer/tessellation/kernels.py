"""The shaders that choose a surface's triangles: halves of its grids are bisected level by level.

A triangle that is to be split is three vertices of a grid: the ends of its longest edge and the apex opposite.
A vertex is row · 2^13 + column, where rows count on from grid to grid, so the middle of an edge is half the
sum of its ends. `BeginBisection` makes the halves, `Bisect` splits the triangles of one level and passes on
the children that are split, too, and writes the others to the mesh. `FinishBisection` tells the draws how
many there are.

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
"""Where the numbers of triangles begin that are written to the mesh: of halves, then of each level."""
LIMIT_REACHED: Final = 2 * MAX_LEVELS + 1
"""Where it is noted that the limit was reached."""
PREVIOUS_INDEX_COUNT: Final = LIMIT_REACHED + 1
"""Where the number of indices before is kept."""
COUNTER_COUNT: Final = PREVIOUS_INDEX_COUNT + 1
COLUMN_BITS: Final = 13
"""The bits of a vertex that are its column: 4,097 columns need as many."""
MAX_ROWS: Final = 1 << (31 - COLUMN_BITS)
"""The most rows of all grids: the sum of two vertices then fits into 32 bits."""


class VertexBound(sl.Struct):
    """The length and the reach of a vertex (`TessellatedSurface.bounds`)."""

    length: float
    reach: float


class SurfaceShape(sl.Struct):
    """The constants of a surface.

    Attributes:
        side: the vertices along a side of its grids.
        grids, halves: the number of grids, and of halves that are used: both of the first grids.
        levels: how often triangles can be bisected.
        limit: the largest number of triangles.
        first: the index of its first index.
        first_float, stride: of its vertices, the first float, and the floats from one to the next.
        mesh, draw: the indices of its mesh and its draw.
    """

    side: int
    grids: int
    halves: int
    levels: int
    limit: int
    first: int
    first_float: int
    stride: int
    mesh: int
    draw: int


class SurfaceView(sl.Struct):
    """A view in the space of a surface, where reaches and lengths are as they are.

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

    shape: sl.Uniform[SurfaceShape]
    view: sl.Uniform[SurfaceView]
    bounds: sl.Storage[VertexBound]
    vertices: sl.Storage[float]

    def is_split(self, left: sl.uint, right: sl.uint) -> bool:
        """Return whether an edge is: it is long on screen and in view, or close enough to the eye
        otherwise."""
        vertex = self.index((left + right) >> sl.uint(1))
        at = self.shape.first_float + self.shape.stride * int(vertex)
        p = sl.vec3(self.vertices[at], self.vertices[at + 1], self.vertices[at + 2])
        length = self.bounds[vertex].length
        reach = self.bounds[vertex].reach
        depth = ordered_dot(self.view.depth.xyz, p) - self.view.is_perspective * reach
        should_split = depth - length * self.view.scale <= self.view.depth.w
        for i in range(6):
            plane = self.view.planes[i]
            should_split = should_split and ordered_dot(plane.xyz, p) + reach >= plane.w
        away = p - self.view.eye
        perspective = self.view.is_perspective
        near = length * self.view.out_of_view_scale + perspective * reach
        return (
            should_split
            or perspective * self.view.squared_axis_ratio * ordered_dot(away, away) + (1.0 - perspective)
            <= near * near
        )

    def index(self, vertex: sl.uint) -> sl.uint:
        """Return the index of a vertex in the mesh."""
        column = vertex & sl.uint((1 << COLUMN_BITS) - 1)
        return (vertex >> sl.uint(COLUMN_BITS)) * sl.uint(self.shape.side) + column


class BeginBisection(EdgeTest):
    """Begins with the halves of the grids. There is one group."""

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
        last = self.shape.side - 1
        pairs = self.shape.halves - self.shape.grids
        half = lane
        while half < self.shape.halves:
            is_second = half < 2 * pairs and half % 2 == 1
            grid = half // 2 if half < 2 * pairs else half - pairs
            origin = (grid * self.shape.side) << COLUMN_BITS
            below = last << COLUMN_BITS
            left = sl.uint(origin + (below + last if is_second else 0))
            apex = sl.uint(origin + (last if is_second else below))
            right = sl.uint(origin + (0 if is_second else below + last))
            if self.shape.levels > 0 and self.is_split(left, right):
                slot = int(sl.atomic_add(self.counters[SPLIT_COUNTS], sl.uint(1)))
                self.split[3 * slot] = left
                self.split[3 * slot + 1] = apex
                self.split[3 * slot + 2] = right
            else:
                at = self.shape.first + 3 * int(sl.atomic_add(self.counters[WRITTEN_COUNTS], sl.uint(1)))
                self.indices[at] = self.index(left)
                self.indices[at + 1] = self.index(apex)
                self.indices[at + 2] = self.index(right)
            half += GROUP


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
        for earlier in range(level + 1):
            written += int(self.counters[WRITTEN_COUNTS + earlier])
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
                    written + int(sl.atomic_add(self.counters[WRITTEN_COUNTS + level + 1], sl.uint(1))),
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
                        sl.atomic_add(self.counters[WRITTEN_COUNTS + level + 1], sl.uint(2 - deeper))
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


class FinishBisection(sl.Shader):
    """Writes the number of triangles to the draws, and empty triangles over what is left of those before."""

    work_group = (GROUP,)
    shape: sl.Uniform[SurfaceShape]
    counters: sl.Storage[sl.uint]
    indices: sl.StorageRW[sl.uint]
    draws: sl.StorageRW[DrawArguments]
    parts: sl.StorageRW[MeshPart]

    def compute(self) -> None:
        count = 0
        for level in range(MAX_LEVELS + 1):
            count += 3 * int(self.counters[WRITTEN_COUNTS + level])
        slot = count + sl.global_id().x
        while slot < int(self.counters[PREVIOUS_INDEX_COUNT]):
            self.indices[self.shape.first + slot] = sl.uint(0)
            slot += sl.group_count().x * GROUP
        if sl.global_id().x == 0:
            self.draws[self.shape.draw].count = sl.uint(count)
            self.parts[self.shape.mesh].count = sl.uint(count)
