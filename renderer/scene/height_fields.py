"""Height fields: grounds whose triangles are chosen for each view.

A field is a square grid of (2^k + 1)² heights, a `TessellatedSurface` of one grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats
from renderer.scene.meshes import MeshGeometry, vertex_format
from renderer.scene.tessellated_surfaces import TessellatedSurface
from rhi.errors import describe_value, refuse
from rhi.errors.array_likes import to_real_array

MAX_SAMPLES: Final = 4097
"""The largest side of a map of heights."""


@dataclass(frozen=True, eq=False)
class HeightField(TessellatedSurface):
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
    def side(self) -> int:
        """The number of vertices along a side."""
        return len(self.heights)

    @property
    def steps(self) -> tuple[float, float]:
        """The distances between neighbours along x and z."""
        n = len(self.heights) - 1
        return self.size[0] / n, self.size[1] / n

    def positions(self) -> Floats:
        """Return the positions (1, n + 1, n + 1, 3) of the vertices."""
        n = len(self.heights) - 1
        along = np.arange(n + 1) / n - 0.5
        points = np.empty((n + 1, n + 1, 3))
        points[..., 0], points[..., 2] = along * self.size[0], (along * self.size[1])[:, None]
        points[..., 1] = self.heights
        return points[None]

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
        vertices["position"] = self.positions()[0]
        vertices["normal"] = (0.0, 1.0, 0.0) if self.has_normal_map else self.normals()
        slopes = np.gradient(self.heights.astype(np.float64), self.steps[0], axis=1) * (
            not self.has_normal_map
        )
        vertices["tangent"][..., 0] = 1.0 / np.hypot(1.0, slopes)
        vertices["tangent"][..., 1] = slopes / np.hypot(1.0, slopes)
        vertices["tangent"][..., 3] = 1.0
        along = np.arange(width) / (width - 1)
        vertices["uv"][..., 0], vertices["uv"][..., 1] = along, along[:, None]
        return MeshGeometry(vertices.reshape(-1), self.list_equal_triangles())


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
