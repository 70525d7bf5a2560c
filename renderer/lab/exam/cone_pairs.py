"""Pairs of a cell and a spot light's cone that overlap, and all cone tests of them, run on a device at once.

A pair overlaps if a point is in both; it is searched by projecting onto the cell and the cone in turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.cell_pairs import PROJECTIONS, cell_corners, choose_cells, make_test_grid
from renderer.lab.exam.pair_tests import GROUP, run_tests
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling import cone_tests
from renderer.lights.culling.cells import Cell, ClusterGrid, block_cell, padded_radius
from renderer.lights.culling.table import CONE_TESTS
from renderer.scene.arrays import Floats
from rhi import Device
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, global_id, ivec2, uint

COUNT: Final = 3_000
_NEXT: Final = (-1e-5, 0.0, 1e-5)
ANGLES: Final[Floats] = np.radians(
    [0.1, 5.0, 30.0, *(45.0 + e for e in _NEXT), 70.0, *(90.0 + e for e in _NEXT), 120.0, 180.0]
)

Cones = dict[str, Floats]
"""The fields of `Cone`, each an array over all cones."""


@dataclass(frozen=True)
class ConePairs:
    """Pairs of a cell and a cone, and whether they certainly overlap."""

    grid: ClusterGrid
    tiles: NDArray[np.int32]
    near: Floats
    far: Floats
    cones: Cones
    overlap: NDArray[np.bool_]


def nearest_points_in_cells(corners: Floats, points: Floats) -> Floats:
    """The points of cells nearest to points, found by bisecting the range of depth; `corners` as of
    `cell_corners`."""
    near, far = corners[:, 0, 2], corners[:, 4, 2]
    length = np.where(far > near, far - near, 1.0)

    def beside(z: Floats) -> Floats:
        share = ((z - near) / length)[:, None]
        low, high = (
            corners[:, corner, :2] * (1.0 - share) + corners[:, corner + 4, :2] * share for corner in (0, 3)
        )
        return np.column_stack([np.clip(points[:, :2], low, high), z])

    def square(z: Floats) -> Floats:
        return np.asarray(((beside(z) - points) ** 2).sum(1))

    begin, end = near.copy(), far.copy()
    for _ in range(40):
        left, right = begin + (end - begin) * 0.45, begin + (end - begin) * 0.55
        first = square(left) < square(right)
        begin, end = np.where(first, begin, left), np.where(first, right, end)
    return beside(0.5 * (begin + end))


def nearest_points_in_cones(cones: Cones, points: Floats) -> Floats:
    """Points of cones near points: the nearest ones where a cone is convex."""
    away = points - cones["apex"]
    along = (away * cones["axis"]).sum(1)
    across = away - cones["axis"] * along[:, None]
    size = np.linalg.norm(across, axis=1)
    cosine, sine = cones["cosine"], np.sqrt(1.0 - cones["cosine"] ** 2)
    inside = along >= np.hypot(along, size) * cosine
    on_side = np.maximum(along * cosine + size * sine, 0.0)
    unit = across / np.maximum(size, 1e-300)[:, None]
    onto = on_side[:, None] * (cosine[:, None] * cones["axis"] + sine[:, None] * unit)
    offset = np.where(inside[:, None], away, onto)
    length = np.linalg.norm(offset, axis=1)
    return np.asarray(
        cones["apex"] + offset * np.minimum(1.0, cones["range"] / np.maximum(length, 1e-300))[:, None]
    )


def are_in_cones(cones: Cones, points: Floats) -> NDArray[np.bool_]:
    """The points that are certainly in their cones, a mask."""
    away = points - cones["apex"]
    length = np.linalg.norm(away, axis=1)
    along = (away * cones["axis"]).sum(1)
    return np.asarray((length < cones["range"] * (1.0 - 1e-9)) & (along > length * (cones["cosine"] + 1e-9)))


def _select(cones: Cones, rows: NDArray[np.intp]) -> Cones:
    """The selected cones."""
    return {name: values[rows] for name, values in cones.items()}


@cache
def make_cone_pairs(name: str) -> ConePairs:
    """Make pairs of one projection, about half of which overlap."""
    rng = np.random.default_rng([7, *name.encode()])
    grid = make_test_grid(name, tile=32)
    tiles, near, far = choose_cells(grid, COUNT, rng)
    projection = PROJECTIONS[name].with_aspect(1366 / 768)
    corners = cell_corners(projection, grid, tiles, near, far)
    aim = (rng.dirichlet(np.full(8, 0.5), COUNT)[:, :, None] * corners).sum(1)
    scale = 10.0 ** rng.uniform(-1.0, 1.5, COUNT)
    away = rng.normal(size=(COUNT, 3))
    apex = aim + away / np.linalg.norm(away, axis=1)[:, None] * scale[:, None]
    angle = rng.choice(ANGLES, COUNT)
    # Aimed at the cell, but off by about the cone's own angle; a few straight at it.
    sideways = np.tan(np.minimum(angle, 1.2)) * rng.choice([0.0, 1.0, 1.2], COUNT)
    axis = (aim - apex) / scale[:, None] + rng.normal(size=(COUNT, 3)) * sideways[:, None]
    axis *= (np.where(angle > 1.7, -1.0, 1.0) / np.linalg.norm(axis, axis=1))[:, None]
    cones = {
        "apex": apex,
        "range": scale * rng.uniform(0.5, 2.0, COUNT),
        "axis": axis,
        "cosine": np.cos(angle),
    }
    cones = {name: values.astype(np.float32).astype(np.float64) for name, values in cones.items()}
    cones["axis"] /= np.linalg.norm(cones["axis"], axis=1)[:, None]
    inner = cones | {"range": 0.999 * cones["range"], "cosine": np.cos(0.999 * np.arccos(cones["cosine"]))}
    points, overlap, rows = aim, np.zeros(COUNT, bool), np.arange(COUNT)
    for _ in range(40):
        is_inside = are_in_cones(_select(cones, rows), points)
        overlap[rows[is_inside]] = True
        rows, points = rows[~is_inside], points[~is_inside]
        points = nearest_points_in_cells(corners[rows], nearest_points_in_cones(_select(inner, rows), points))
    return ConePairs(grid, tiles, near, far, cones, overlap)


class ConePair(Struct):
    """A cone, and the cell of a tile between two depths."""

    cone: Cone
    tile: ivec2
    near: float
    far: float


class RunConeTests(Shader):
    """Runs all tests, in the order of the table, and stores a bit for each."""

    work_group = (GROUP,)
    grid: Uniform[ClusterGrid]
    pairs: Storage[ConePair]
    passed: StorageRW[uint]

    def compute(self) -> None:
        row = global_id().x
        if row < len(self.pairs):
            pair = self.pairs[row]
            cell = block_cell(self.grid, pair.tile, 1, pair.near, pair.far)
            padding = padded_radius(cell, pair.cone.apex, pair.cone.range) - pair.cone.range
            self.passed[row] = uint(self.test(cell, pair.cone, padding))

    def test(self, cell: Cell, cone: Cone, padding: float) -> int:
        always = 1 if cone_tests.cone_overlaps_always(cell, cone, padding) else 0
        sphere = 2 if cone_tests.cone_overlaps_sphere(cell, cone, padding) else 0
        planes = 4 if cone_tests.cone_overlaps_planes(cell, cone, padding) else 0
        tight = 8 if cone_tests.cone_overlaps_tightly(cell, cone, padding) else 0
        return always + sphere + planes + tight


def run_cone_tests(device: Device, pairs: ConePairs) -> dict[str, NDArray[np.bool_]]:
    """The pairs that pass each test, a mask."""
    rows = np.zeros(len(pairs.near), ConePair.dtype)
    for name, values in pairs.cones.items():
        rows["cone"][name] = values
    rows["tile"], rows["near"], rows["far"] = pairs.tiles, pairs.near, pairs.far
    return run_tests(device, RunConeTests, CONE_TESTS, pairs.grid, ConePair, rows)
