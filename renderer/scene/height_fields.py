"""Height fields: grounds whose triangles are chosen for each view.

A field is a square grid of (2^k + 1)² heights. Its triangles come from bisecting two right triangles at the
middle of their longest edge, again and again: a triangle is three vertices of the grid, and its edge's middle
is one, too. The middle belongs to the two triangles on both sides of the edge. So it is decided vertex by
vertex what is split (`renderer.tessellation`), and both triangles are split or neither is: there are no
cracks.

That holds only if a vertex is never used without the two edges that it was found on. Therefore each vertex
has a `reach`, a ball around it that holds the balls of all vertices which depend on it, and a `length` that
is at least theirs: whatever calls for one of those calls for this one as well (Lindstrom and Pascucci, 2002).
The slack between them is larger than the rounding of float32 in any test that is linear in position, length
and reach.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats
from renderer.scene.meshes import MeshGeometry, vertex_format
from rhi.errors import describe_value, refuse
from rhi.errors.array_likes import to_real_array

MAX_SAMPLES: Final = 4097
"""The largest side of a map of heights."""

_RELATIVE_SLACK: Final = 2.0**-20
_ABSOLUTE_SLACK: Final = 2.0**-20  # of the largest coordinate


@dataclass(frozen=True, eq=False)
class HeightField:
    """A ground: heights over a rectangle around the origin.

    Attributes:
        heights: (n + 1, n + 1) float32, where n is a power of two; row 0 is at the smallest z, column 0 at
            the smallest x.
        size: the lengths in metres along x and z.
        limit: the largest number of its triangles, a power of two.
        has_normal_map: whether the normals of its vertices are straight up, because a normal map has the true
            ones.
    """

    heights: NDArray[np.float32]
    size: tuple[float, float]
    limit: int
    has_normal_map: bool = False

    @property
    def levels(self) -> int:
        """The number of times that a triangle can be bisected."""
        return 2 * (len(self.heights) - 1).bit_length() - 2

    @property
    def count(self) -> int:
        """The number of all triangles, if none is left out."""
        return 2 << self.levels

    @property
    def steps(self) -> tuple[float, float]:
        """The distances between neighbours along x and z."""
        n = len(self.heights) - 1
        return self.size[0] / n, self.size[1] / n

    def positions(self) -> Floats:
        """Return the positions (n + 1, n + 1, 3) of the vertices."""
        n = len(self.heights) - 1
        along = np.arange(n + 1) / n - 0.5
        points = np.empty((n + 1, n + 1, 3))
        points[..., 0], points[..., 2] = along * self.size[0], (along * self.size[1])[:, None]
        points[..., 1] = self.heights
        return points

    def sample_heights(self, x: ArrayLike, z: ArrayLike) -> Floats:
        """Return the heights at points, interpolated between vertices; points beyond the border are moved to
        it."""
        n = len(self.heights) - 1
        coordinates = [
            np.clip((np.asarray(at, np.float64) / side + 0.5) * n, 0.0, n)
            for at, side in zip((z, x), self.size[::-1], strict=True)
        ]
        row, column = (np.minimum(coordinate.astype(np.int64), n - 1) for coordinate in coordinates)
        down, along = (coordinate - low for coordinate, low in zip(coordinates, (row, column), strict=True))
        upper, lower = (
            self.heights[line, column] * (1.0 - along) + self.heights[line, column + 1] * along
            for line in (row, row + 1)
        )
        return np.asarray(upper * (1.0 - down) + lower * down)

    def normals(self) -> Floats:
        """Return unit normals (n + 1, n + 1, 3) of the full field, by differences of neighbours."""
        slopes = np.gradient(self.heights.astype(np.float64), *self.steps[::-1])
        normals = np.stack([-slopes[1], np.ones_like(slopes[0]), -slopes[0]], axis=-1)
        return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))

    def make_mesh(self) -> MeshGeometry:
        """Make a mesh of all vertices, and of as many equal triangles as the limit allows."""
        width = len(self.heights)
        vertices = np.zeros((width, width), vertex_format(["tangent"]))
        vertices["position"] = self.positions()
        vertices["normal"] = (0.0, 1.0, 0.0) if self.has_normal_map else self.normals()
        slopes = np.gradient(self.heights.astype(np.float64), self.steps[0], axis=1) * (
            not self.has_normal_map
        )
        vertices["tangent"][..., 0] = 1.0 / np.hypot(1.0, slopes)
        vertices["tangent"][..., 1] = slopes / np.hypot(1.0, slopes)
        vertices["tangent"][..., 3] = 1.0
        along = np.arange(width) / (width - 1)
        vertices["uv"][..., 0], vertices["uv"][..., 1] = along, along[:, None]
        depth = min(self.levels, self.limit.bit_length() - 2)
        return MeshGeometry(vertices.reshape(-1), bisect(width, depth).astype(np.uint32).reshape(-1))

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """The length and the reach of each vertex, (n + 1, n + 1) each, in metres; see the module."""
        return _compute_bounds(self.positions())


def make_height_field(
    heights: ArrayLike,
    size: float | tuple[float, float],
    *,
    limit: int = 1 << 18,
    has_normal_map: bool = False,
) -> HeightField:
    """Make a height field of a map of heights (r, c) in metres, any size from 1 × 1 on.

    A map whose sides aren't 2^k + 1 is interpolated on the next finer grid.

    Args:
        size: the length along x and z in metres, or both lengths; `heights[0, 0]` is at the corner with the
            smallest x and z.
        limit: the largest number of triangles, rounded down to a power of two.
        has_normal_map: whether a normal map of its material holds the normals. Vertices then point straight
            up.

    Raises:
        ValidationError `scene-bad-heights`: heights that aren't finite, or too many; a size that isn't above
        0.
    """
    call = "make_height_field"
    try:
        samples = np.asarray(to_real_array(heights), np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        refuse(rules.BAD_HEIGHTS, f"{call}(heights=...)", describe_value(heights), f"real numbers: {error}")
    if samples.ndim != 2 or not samples.size or max(samples.shape) > MAX_SAMPLES:
        refuse(rules.BAD_HEIGHTS, call, f"shape {samples.shape}", f"(r, c), each from 1 to {MAX_SAMPLES:,}")
    if not np.isfinite(samples).all() or np.abs(samples).max() > 1e9:
        refuse(
            rules.BAD_HEIGHTS, call, "a height that isn't finite or too large", "finite heights up to 10⁹ m"
        )
    x, z = size if isinstance(size, tuple | list | np.ndarray) and np.shape(size) == (2,) else (size, size)
    sides = rules.check_numbers(rules.BAD_HEIGHTS, call, size=x) + rules.check_numbers(
        rules.BAD_HEIGHTS, call, size=z
    )
    if not all(0.0 < side < 1e9 for side in sides):
        refuse(rules.BAD_HEIGHTS, f"{call}(size=...)", size, "above 0, up to 10⁹ m")
    limit = rules.check_count(rules.BAD_HEIGHTS, f"{call}(limit=...)", limit, 2)
    cells = 1 << max(max(samples.shape) - 2, 0).bit_length()
    for _ in range(2):
        samples = _resample(samples, cells + 1).T
    grid = np.ascontiguousarray(samples, np.float32)
    return HeightField(
        grid, (sides[0], sides[1]), 1 << (min(limit, 2 * cells * cells).bit_length() - 1), has_normal_map
    )


def _resample(rows: Floats, count: int) -> Floats:
    """Interpolate along axis 0 to `count` rows."""
    if len(rows) == count:
        return rows
    at = np.linspace(0.0, len(rows) - 1.0, count)
    low = np.minimum(at.astype(np.int64), max(len(rows) - 2, 0))
    part = (at - low)[:, None]
    return np.asarray(rows[low] * (1.0 - part) + rows[np.minimum(low + 1, len(rows) - 1)] * part)


def bisect(width: int, depth: int) -> NDArray[np.int64]:
    """Return the triangles (2^(depth + 1), 3) of a grid of `width` × `width` vertices, row by row, after
    bisecting all `depth` times: the left end of the longest edge, the apex and the right end,
    counter-clockwise from above."""
    last = width * width - 1
    triangles = np.array([(0, last - width + 1, last), (last, width - 1, 0)])
    for _ in range(depth):
        left, apex, right = triangles.T
        middle = (left + right) // 2
        triangles = np.stack([apex, middle, left, right, middle, apex], axis=1).reshape(-1, 3)
    return triangles


def _compute_bounds(points: Floats) -> tuple[Floats, Floats]:
    """Return the length and the reach of each vertex, from the finest ones up."""
    width = len(points)
    length, reach = np.zeros((width, width)), np.zeros((width, width))
    slack = _ABSOLUTE_SLACK * float(np.abs(points).max())

    def visit(
        rows: NDArray[np.int64],
        columns: NDArray[np.int64],
        ends: list[tuple[int, int]],
        steps: NDArray[np.int64],
    ) -> None:
        """Bound vertices whose edges have `ends`, and which those at `steps` depend on."""
        at = np.ix_(rows, columns)
        here = points[at]
        first, second = (points[np.ix_(rows + dy, columns + dx)] for dy, dx in ends)
        longest = np.linalg.norm(first - second, axis=-1)
        widest = np.maximum(np.linalg.norm(first - here, axis=-1), np.linalg.norm(second - here, axis=-1))
        for dy, dx in steps.tolist():
            inside = (rows + dy >= 0) & (rows + dy < width), (columns + dx >= 0) & (columns + dx < width)
            part, there = np.ix_(*inside), np.ix_(rows[inside[0]] + dy, columns[inside[1]] + dx)
            away = np.linalg.norm(points[there] - here[part], axis=-1)
            longest[part] = np.maximum(longest[part], length[there])
            widest[part] = np.maximum(widest[part], away + reach[there])
        length[at] = longest * (1.0 + _RELATIVE_SLACK)
        reach[at] = (widest + slack) * (1.0 + _RELATIVE_SLACK)

    crosses = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)])
    sides = np.array([(-1, 0), (1, 0), (0, -1), (0, 1)])
    none = np.zeros((0, 2), np.int64)
    size = 2
    while size < width:
        half, quarter = size // 2, size // 4
        odd, even = np.arange(half, width, size), np.arange(0, width, size)
        below = crosses * quarter if quarter else none
        visit(even, odd, [(0, -half), (0, half)], below)
        visit(odd, even, [(-half, 0), (half, 0)], below)
        # The diagonal of a square leads from the middle of the square above to its far corner.
        for turn in (0, 1):
            rows = odd[turn::2]
            for other in (0, 1):
                sign = 1 if turn == other else -1
                visit(rows, odd[other::2], [(-half, -sign * half), (half, sign * half)], sides * half)
        size *= 2
    return length, reach
