"""Cells, spheres, and their exact distances, computed independently of the light culling shaders."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cells import ClusterGrid
from renderer.lights.culling.grid_projection import make_grid
from renderer.scene import Depth, Orthographic, Perspective, Projection
from renderer.scene.arrays import Floats


@dataclass(frozen=True)
class OffAxisPerspective:
    """A perspective projection whose axis doesn't meet the middle of the image, as for an eye of a stereo
    pair."""

    shift: tuple[float, float] = (0.35, -0.2)
    projection: Perspective = field(default_factory=lambda: Perspective(far=120.0))

    @property
    def depth(self) -> Depth:
        """The direction of depth."""
        return self.projection.depth

    @property
    def matrix(self) -> Floats:
        """The matrix (4, 4) float64 from view space to clip space."""
        m = self.projection.matrix.copy()
        m[:2, 2] = self.shift
        return m

    def with_aspect(self, aspect: float) -> OffAxisPerspective:
        """The same projection for an image of width / height = `aspect`."""
        return OffAxisPerspective(self.shift, self.projection.with_aspect(aspect))


PROJECTIONS: dict[str, Projection] = {
    "perspective": Perspective(far=100.0),
    "endless": Perspective(fov=1.9, near=0.05),
    "standard": Perspective(near=0.5, far=300.0, depth=Depth.STANDARD),
    "off-axis": OffAxisPerspective(),
    "parallel": Orthographic(height=30.0, near=0.0, far=90.0),
    "parallel, behind": Orthographic(height=8.0, near=-20.0, far=20.0, depth=Depth.STANDARD),
}
REACH = 150.0


def make_test_grid(
    name: str, size: tuple[int, int] = (1366, 768), tile: int = 8, slices: int = 1
) -> ClusterGrid:
    """Make the grid of a projection by its name."""
    projection = PROJECTIONS[name].with_aspect(size[0] / size[1])
    return make_grid(projection, size, tile, slices=slices, reach=REACH)


def choose_cells(
    grid: ClusterGrid, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int32], Floats, Floats]:
    """Choose tiles (n, 2) and depths from near to far: shallow ones, flat ones, and the whole depth of the
    view."""
    tiles = np.column_stack([rng.integers(0, (grid.count.x, grid.count.y)[axis], count) for axis in range(2)])
    near = grid.near + (grid.far - grid.near) * rng.random(count) ** 3 * 0.9
    far = near + (grid.far - near) * rng.choice([0.0, 1e-4, 0.01, 0.1, 1.0], count) * rng.random(count)
    whole = rng.random(count) < 0.1
    return tiles.astype(np.int32), np.where(whole, grid.near, near), np.where(whole, grid.far, far)


def cell_corners(
    projection: Projection, grid: ClusterGrid, tiles: NDArray[np.int32], near: Floats, far: Floats
) -> Floats:
    """Compute the corners (n, 8, 3) in eye space with the inverse of the projection; right is bit 0, top 1,
    far 2."""
    inverse = np.linalg.inv(projection.matrix)
    count, size = len(tiles), np.array([grid.size.x, grid.size.y])
    first = tiles * grid.tile
    last = np.minimum(first + grid.tile, size)
    corners = np.empty((len(tiles), 8, 3))
    for index in range(8):
        pixel = np.column_stack([(last if index & 1 else first)[:, 0], (first if index & 2 else last)[:, 1]])
        clip = 2.0 * pixel / size - 1.0
        line = []
        for depth in (0.25, 0.75):  # two points of the line that projects to the pixel
            position = (
                np.column_stack([clip * (1.0, -1.0), np.full(count, depth), np.ones(count)]) @ inverse.T
            )
            line.append(position[:, :3] / position[:, 3:])
        z = -(far if index & 4 else near)
        share = (z - line[0][:, 2]) / (line[1][:, 2] - line[0][:, 2])
        corners[:, index] = line[0] + share[:, None] * (line[1] - line[0])
    return corners * (1.0, 1.0, -1.0)


_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def distances(corners: Floats, points: Floats) -> Floats:
    """Compute the distance of points (n, 3) from hexahedra (n, 8, 3): 0 inside, otherwise the least one from
    the sides and the faces."""
    nearest = np.full(len(points), np.inf)
    inside = np.ones(len(points), bool)
    median_of = corners.mean(1)
    for face in _FACES:
        quad = corners[:, face]
        normal = np.cross(quad[:, 2] - quad[:, 0], quad[:, 3] - quad[:, 1])
        size = np.linalg.norm(normal, axis=1)
        normal = np.divide(normal, size[:, None], where=size[:, None] > 0, out=np.zeros_like(normal))
        out = np.where(((median_of - quad[:, 0]) * normal).sum(1) > 0.0, -1.0, 1.0)
        height = ((points - quad[:, 0]) * normal).sum(1) * out
        inside &= (height <= 0.0) & (size > 0.0)
        over = size > 0.0
        side = np.zeros(len(points))
        for i in range(4):
            start, edge = quad[:, i], quad[:, (i + 1) % 4] - quad[:, i]
            length = (edge * edge).sum(1)
            away = points - start
            share = np.divide((away * edge).sum(1), length, where=length > 0, out=np.zeros_like(length))
            beside = away - edge * np.clip(share, 0.0, 1.0)[:, None]
            nearest = np.minimum(nearest, np.linalg.norm(beside, axis=1))
            turn = (np.cross(edge, away) * normal).sum(1)
            over &= (turn * side >= 0.0) | (side == 0.0)
            side = np.where(turn != 0.0, np.sign(turn), side)
        nearest = np.where(over, np.minimum(nearest, np.abs(height)), nearest)
    flat = np.ptp(corners[:, :, 2], axis=1) == 0.0
    return np.where(inside & ~flat, 0.0, nearest)


@dataclass(frozen=True)
class Pairs:
    """Pairs of a cell and a sphere of one projection, with their exact distances."""

    grid: ClusterGrid
    tiles: NDArray[np.int32]
    near: Floats
    far: Floats
    corners: Floats
    centres: Floats
    radii: Floats
    distances: Floats

    @cached_property
    def overlap(self) -> NDArray[np.bool_]:
        """The pairs that overlap, a mask."""
        return self.distances <= self.radii


@cache  # a module's fixture is made again for each device
def make_pairs(projection: str, count: int, seed: int = 0, size: tuple[int, int] = (1366, 768)) -> Pairs:
    """Make pairs that mostly nearly touch: a third have a radius within a millionth of the distance."""
    rng = np.random.default_rng([seed, *projection.encode()])
    grid = make_test_grid(projection, size)
    tiles, near, far = choose_cells(grid, count, rng)
    corners = cell_corners(PROJECTIONS[projection].with_aspect(size[0] / size[1]), grid, tiles, near, far)
    weights = rng.dirichlet(np.full(8, 0.3), count)  # at corners, on edges and faces, inside
    away = rng.normal(size=(count, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    scale = 10.0 ** rng.uniform(-2.0, 1.5, count)
    # Shaders read float32.
    centres = (
        ((weights[:, :, None] * corners).sum(1) + away * scale[:, None]).astype(np.float32).astype(np.float64)
    )
    exact = distances(corners, centres)
    factor = np.where(
        rng.random(count) < 1 / 3, 1.0 + rng.uniform(-1e-6, 1e-6, count), rng.uniform(0.3, 1.7, count)
    )
    radii = np.where(exact > 0.0, exact, scale) * factor
    radii = radii.astype(np.float32).astype(np.float64)
    return Pairs(grid, tiles, near, far, corners, centres, radii, exact)
