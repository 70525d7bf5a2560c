"""Surfaces whose triangles are chosen for each view: what height fields and tessellated meshes share.

A surface is one or more square grids of (2^k + 1)² vertices. Its triangles come from bisecting the two halves
of each grid at the middle of their longest side, again and again: a triangle is three vertices of a grid, and
its edge's middle is one, too. The middle belongs to the two triangles on both sides of the edge. So it is
decided vertex by vertex what is split (`renderer.tessellation`), and both triangles are split or neither is:
there are no cracks. Where grids meet, each has a copy of the vertices at the border, and the copies are equal.

That holds only if a vertex is never used without the two edges that it was found on. Therefore each vertex
has a `reach`, a ball around it that holds the balls of all vertices which depend on it, and a `length` that
is at least theirs: whatever calls for one of those calls for this one as well (Lindstrom and Pascucci, 2002).
The slack between them is larger than the rounding of float32 in any test that is linear in position, length
and reach.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry

_RELATIVE_SLACK: Final = 2.0**-20
_ABSOLUTE_SLACK: Final = 2.0**-20  # of the largest coordinate


class TessellatedSurface(ABC):
    """A surface of grids of vertices, whose triangles are chosen for each view.

    Attributes:
        limit: the largest number of its triangles, the number of halves times a power of two.
    """

    limit: int

    @property
    @abstractmethod
    def side(self) -> int:
        """The number of vertices along a side of a grid, 2^k + 1."""

    @property
    def grid_count(self) -> int:
        """The number of grids."""
        return 1

    @property
    def half_count(self) -> int:
        """The number of halves of grids that are used: both of the first grids, then one of each other."""
        return 2

    @property
    def levels(self) -> int:
        """The number of times that a triangle can be bisected."""
        return 2 * (self.side - 1).bit_length() - 2

    @property
    def count(self) -> int:
        """The number of all triangles, if none is left out."""
        return self.half_count << self.levels

    @abstractmethod
    def positions(self) -> Floats:
        """Return the positions (grids, side, side, 3) of the vertices."""

    @abstractmethod
    def make_mesh(self) -> MeshGeometry:
        """Make a mesh of all vertices, grid by grid, and of as many equal triangles as the limit allows."""

    def list_triangles(self) -> Indices:
        """Return all triangles (count, 3) as `bisect` does, if none is left out."""
        return bisect(self.side, self.levels, self.grid_count, self.half_count)

    def list_equal_triangles(self) -> NDArray[np.uint32]:
        """Return the indices of as many equal triangles as the limit allows."""
        depth = (self.limit // self.half_count).bit_length() - 1
        return bisect(self.side, depth, self.grid_count, self.half_count).astype(np.uint32).reshape(-1)

    def number_points(self) -> Indices | None:
        """Return the numbers (grids, side, side) of points, equal for copies of a vertex; None without copies."""
        return None

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """The length and the reach of each vertex, (grids, side, side) each, in metres; see the module."""
        return _compute_bounds(self.positions(), self.number_points())


def bisect(side: int, depth: int, grids: int = 1, halves: int = 2) -> Indices:
    """Return the triangles (halves * 2^depth, 3) of grids of `side` × `side` vertices, row by row, after
    bisecting all `depth` times: the left end of the longest edge, the apex and the right end,
    counter-clockwise from above."""
    last = side * side - 1
    roots = np.array([(0, last - side + 1, last), (last, side - 1, 0)])
    firsts = np.arange(grids)[:, None] * (last + 1)
    pairs = halves - grids
    triangles = np.concatenate(
        [(firsts[:pairs, None] + roots).reshape(-1, 3), (firsts[pairs:, None] + roots[:1]).reshape(-1, 3)]
    )
    for _ in range(depth):
        left, apex, right = triangles.T
        middle = (left + right) // 2
        triangles = np.stack([apex, middle, left, right, middle, apex], axis=1).reshape(-1, 3)
    return triangles


def _compute_bounds(points: Floats, numbers: Indices | None) -> tuple[Floats, Floats]:
    """Return the length and the reach of each vertex (g, s, s), from the finest ones up."""
    side = points.shape[1]
    length, reach = np.zeros(points.shape[:3]), np.zeros(points.shape[:3])
    slack = _ABSOLUTE_SLACK * float(np.abs(points).max())

    def select(rows: Indices, columns: Indices) -> tuple[slice, Indices, Indices]:
        return slice(None), rows[:, None], columns[None]

    def visit(rows: Indices, columns: Indices, ends: list[tuple[int, int]], steps: Indices) -> None:
        """Bound vertices whose edges have `ends`, and which those at `steps` depend on."""
        at = select(rows, columns)
        here = points[at]
        first, second = (points[select(rows + dy, columns + dx)] for dy, dx in ends)
        longest = np.linalg.norm(first - second, axis=-1)
        widest = np.maximum(np.linalg.norm(first - here, axis=-1), np.linalg.norm(second - here, axis=-1))
        for dy, dx in steps.tolist():
            inside = (rows + dy >= 0) & (rows + dy < side), (columns + dx >= 0) & (columns + dx < side)
            part = select(np.flatnonzero(inside[0]), np.flatnonzero(inside[1]))
            there = select(rows[inside[0]] + dy, columns[inside[1]] + dx)
            away = np.linalg.norm(points[there] - here[part], axis=-1)
            longest[part] = np.maximum(longest[part], length[there])
            widest[part] = np.maximum(widest[part], away + reach[there])
        length[at] = longest * (1.0 + _RELATIVE_SLACK)
        reach[at] = (widest + slack) * (1.0 + _RELATIVE_SLACK)

    def unite(rows: Indices, columns: Indices) -> None:
        """Give the copies of each vertex the largest of their bounds."""
        if numbers is None:
            return
        at = select(rows, columns)
        for values in (length, reach):
            largest = np.zeros(int(numbers.max()) + 1)
            np.maximum.at(largest, numbers[at], values[at])
            values[at] = largest[numbers[at]]

    crosses = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    sides = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
    none = np.zeros((0, 2), np.int64)
    size = 2
    while size < side:
        half, quarter = size // 2, size // 4
        odd, even = np.arange(half, side, size), np.arange(0, side, size)
        below = crosses * quarter if quarter else none
        visit(even, odd, [(0, -half), (0, half)], below)
        visit(odd, even, [(-half, 0), (half, 0)], below)
        # A copy may be in a row of one grid and in a column of another.
        unite(np.arange(0, side, half), np.arange(0, side, half))
        # The diagonal of a square leads from the middle of the square above to its far corner.
        for turn in (0, 1):
            rows = odd[turn::2]
            for other in (0, 1):
                sign = 1 if turn == other else -1
                visit(rows, odd[other::2], [(-half, -sign * half), (half, sign * half)], sides * half)
        unite(odd, odd)
        size *= 2
    return length, reach
