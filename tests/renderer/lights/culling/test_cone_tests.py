"""Tests of spot lights' cones against cells: none drops a pair that overlaps, at any angle, on any device.

That a pair overlaps is shown by a point of both, which is sought by projecting onto the cell and the cone in turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from culling_cases import LENSES, choose_cells, find_corners, make_test_grid

import rhi
from renderer.lights.culling.cells import Cell, CellGrid, block_cell, padded_radius
from renderer.lights.culling.cone_tests import (
    Cone,
    bounding_sphere,
    cone_overlaps_always,
    cone_overlaps_planes,
    cone_overlaps_sphere,
    cone_overlaps_tightly,
)
from renderer.lights.culling.sphere_tests import overlaps_exactly
from renderer.lights.culling.table import CONE_TESTS
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, evaluate, global_id, ivec2, uint

COUNT = 3_000
_NEXT = (-1e-5, 0.0, 1e-5)
ANGLES = np.radians([0.1, 5.0, 30.0, *(45.0 + e for e in _NEXT), 70.0, *(90.0 + e for e in _NEXT), 120.0, 180.0])


@dataclass(frozen=True)
class ConePairs:
    """Pairs of a cell and a cone, and whether they certainly overlap."""

    grid: CellGrid
    tiles: np.ndarray
    near: np.ndarray
    far: np.ndarray
    cones: dict[str, np.ndarray]
    overlap: np.ndarray

    @property
    def cells(self) -> np.ndarray:
        return evaluate(block_cell, self.grid, self.tiles, 1, self.near, self.far, dtype=np.float64)


def nearest_in_cells(cells: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Find the points of cells nearest to points, by halving the range of depth."""

    def beside(z: np.ndarray) -> np.ndarray:
        low = cells["low"] + cells["low_slope"] * z[:, None]
        high = cells["high"] + cells["high_slope"] * z[:, None]
        return np.column_stack([np.clip(points[:, :2], low, high), z])

    def square(z: np.ndarray) -> np.ndarray:
        return ((beside(z) - points) ** 2).sum(1)

    begin, end = cells["near"].copy(), cells["far"].copy()
    for _ in range(40):
        left, right = begin + (end - begin) * 0.45, begin + (end - begin) * 0.55
        first = square(left) < square(right)
        begin, end = np.where(first, begin, left), np.where(first, right, end)
    return beside(0.5 * (begin + end))


def nearest_in_cones(cones: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Find points of cones near points: the nearest where a cone is convex."""
    away = points - cones["apex"]
    along = (away * cones["axis"]).sum(1)
    across = away - cones["axis"] * along[:, None]
    size = np.linalg.norm(across, axis=1)
    cosine, sine = cones["cosine"], np.sqrt(1.0 - cones["cosine"] ** 2)
    inside = along >= np.hypot(along, size) * cosine
    on_side = np.maximum(along * cosine + size * sine, 0.0)
    unit = across / np.maximum(size, 1e-300)[:, None]
    onto = on_side[:, None] * (cosine[:, None] * cones["axis"] + sine[:, None] * unit)
    found = np.where(inside[:, None], away, onto)
    length = np.linalg.norm(found, axis=1)
    return cones["apex"] + found * np.minimum(1.0, cones["range"] / np.maximum(length, 1e-300))[:, None]


def are_in_cones(cones: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    away = points - cones["apex"]
    length = np.linalg.norm(away, axis=1)
    along = (away * cones["axis"]).sum(1)
    return (length < cones["range"] * (1.0 - 1e-9)) & (along > length * (cones["cosine"] + 1e-9))


@pytest.fixture(scope="module", params=LENSES)
def pairs(request: pytest.FixtureRequest) -> ConePairs:
    return make_cone_pairs(request.param)


@cache  # a module's fixture is made again for each device
def make_cone_pairs(name: str) -> ConePairs:
    rng = np.random.default_rng([7, *name.encode()])
    grid = make_test_grid(name, tile=32)
    tiles, near, far = choose_cells(grid, COUNT, rng)
    lens = LENSES[name].with_aspect(1366 / 768)
    corners = find_corners(lens, grid, tiles, near, far)
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
        "apex": apex, "range": scale * rng.uniform(0.5, 2.0, COUNT), "axis": axis, "cosine": np.cos(angle)
    }  # fmt: skip
    cones = {name: values.astype(np.float32).astype(np.float64) for name, values in cones.items()}
    cones["axis"] /= np.linalg.norm(cones["axis"], axis=1)[:, None]
    cells = evaluate(block_cell, grid, tiles, 1, near, far, dtype=np.float64)
    points, overlap = aim, np.zeros(COUNT, bool)
    inner = cones | {"range": 0.999 * cones["range"], "cosine": np.cos(0.999 * np.arccos(cones["cosine"]))}
    for _ in range(40):
        overlap |= are_in_cones(cones, points)
        points = nearest_in_cells(cells, nearest_in_cones(inner, points))
    assert 0.3 < overlap.mean() < 0.9
    return ConePairs(grid, tiles, near, far, cones, overlap)


def test_the_sphere_around_a_cone_holds_its_rim_its_tip_and_its_apex() -> None:
    for angle in ANGLES:
        sphere = evaluate(bounding_sphere, make_cone(angle), dtype=np.float64)
        angles = np.linspace(0.0, angle, 50)
        rim = 3.0 * np.column_stack([np.sin(angles), np.zeros(50), np.cos(angles)])
        away = np.linalg.norm(np.vstack([rim, np.zeros(3)]) - sphere[:3], axis=1)
        assert away.max() <= sphere[3] * (1 + 1e-12)
        assert sphere[3] <= 3.0
        assert away.max() >= sphere[3] * (1 - 1e-6)


def make_cone(angle: float, apex: tuple[float, float, float] = (0, 0, 0)) -> Cone:
    return Cone(apex=apex, range=3.0, axis=(0, 0, 1), cosine=np.cos(angle))


def overlaps_sphere_first(pairs: ConePairs) -> np.ndarray:
    sphere = evaluate(bounding_sphere, pairs.cones, dtype=np.float64)
    return evaluate(overlaps_exactly, pairs.cells, sphere[:, :3], sphere[:, 3] * (1 + 1e-12), dtype=np.float64)


def test_the_sphere_around_a_cone_overlaps_what_the_cone_overlaps(pairs: ConePairs) -> None:
    assert not (pairs.overlap & ~overlaps_sphere_first(pairs)).any()


@pytest.mark.parametrize("name", CONE_TESTS)
def test_no_cone_that_overlaps_is_dropped_in_float64(pairs: ConePairs, name: str) -> None:
    kept = evaluate(CONE_TESTS[name].function, pairs.cells, pairs.cones, 1e-12, dtype=np.float64)
    assert not (pairs.overlap & ~kept).any()


def test_cone_tests_differ_by_what_they_keep(pairs: ConePairs) -> None:
    around = overlaps_sphere_first(pairs)
    kept = {
        name: int((around & evaluate(test.function, pairs.cells, pairs.cones, 0.0, dtype=np.float64)).sum())
        for name, test in CONE_TESTS.items()
    }
    assert kept["tight"] < kept["planes"] < kept["sphere"]
    assert kept["cone_sphere"] < kept["sphere"]
    assert kept["tight"] < 1.1 * pairs.overlap.sum()


class ConePair(Struct):
    cone: Cone
    tile: ivec2
    near: float
    far: float


class RunConeTests(Shader):
    """Makes all tests, in the order of the table, and stores a bit for each."""

    work_group = (64,)
    grid: Uniform[CellGrid]
    pairs: Storage[ConePair]
    kept: StorageRW[uint]

    def compute(self) -> None:
        row = global_id().x
        if row < len(self.pairs):
            pair = self.pairs[row]
            cell = block_cell(self.grid, pair.tile, 1, pair.near, pair.far)
            padding = padded_radius(cell, pair.cone.apex, pair.cone.range) - pair.cone.range
            self.kept[row] = uint(self.test(cell, pair.cone, padding))

    def test(self, cell: Cell, cone: Cone, padding: float) -> int:
        always = 1 if cone_overlaps_always(cell, cone, padding) else 0
        sphere = 2 if cone_overlaps_sphere(cell, cone, padding) else 0
        planes = 4 if cone_overlaps_planes(cell, cone, padding) else 0
        tight = 8 if cone_overlaps_tightly(cell, cone, padding) else 0
        return always + sphere + planes + tight


def run(device: rhi.Device, pairs: ConePairs) -> dict[str, np.ndarray]:
    rows = np.zeros(len(pairs.near), ConePair.dtype)
    for name, values in pairs.cones.items():
        rows["cone"][name] = values
    rows["tile"], rows["near"], rows["far"] = pairs.tiles, pairs.near, pairs.far
    kept = device.storage(uint, len(rows))
    device.dispatch(
        device.program(RunConeTests),
        -(-len(rows) // 64),
        grid=device.uniform(pairs.grid),
        pairs=device.storage(ConePair, rows),
        kept=kept,
    )
    bits = kept.read()
    return {name: (bits >> index & 1).astype(bool) for index, name in enumerate(CONE_TESTS)}


def test_no_cone_that_overlaps_is_dropped_on_a_device(device: rhi.Device, pairs: ConePairs) -> None:
    for name, kept in run(device, pairs).items():
        assert not (pairs.overlap & ~kept).any(), name


@pytest.mark.parametrize("angle", ANGLES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", CONE_TESTS)
def test_a_cell_on_a_cones_axis_is_kept(name: str, dtype: type, angle: float) -> None:
    """The square of the distance from the axis, as a difference of squares, may be negative there."""
    cell = Cell(low=(-0.1, -0.1), low_slope=(0, 0), high=(0.1, 0.1), high_slope=(0, 0), near=9.9, far=10.1)
    for z in (7.2, 8.123457, 9.7):
        assert evaluate(CONE_TESTS[name].function, cell, make_cone(angle, (0, 0, z)), 1e-5, dtype=dtype)


@pytest.mark.parametrize(
    ("angle", "kept"),
    [(0.1, False), (44.0, False), (46.0, True), (90.0, True), (120.0, True), (180.0, True)],
)
def test_a_cell_beside_a_cone_is_kept_if_the_angle_reaches_it(angle: float, kept: bool) -> None:
    """The cell is a point at 45° from the axis."""
    cell = Cell(low=(1, 0), low_slope=(0, 0), high=(1, 0), high_slope=(0, 0), near=1.0, far=1.0)
    for name in ("cone_sphere", "tight"):
        test = CONE_TESTS[name].function
        assert evaluate(test, cell, make_cone(np.radians(angle)), 0.0, dtype=np.float64) == kept


@pytest.mark.parametrize(
    ("angle", "kept"), [(89.0, False), (91.0, False), (134.0, False), (136.0, True), (180.0, True)]
)
def test_a_cell_behind_a_light_is_kept_if_the_cone_is_wider_than_a_half_space(angle: float, kept: bool) -> None:
    """The cell is a point at 135° from the axis."""
    cell = Cell(low=(1, 0), low_slope=(0, 0), high=(1, 0), high_slope=(0, 0), near=-1.0, far=-1.0)
    for name in ("cone_sphere", "tight"):
        test = CONE_TESTS[name].function
        assert evaluate(test, cell, make_cone(np.radians(angle)), 0.0, dtype=np.float64) == kept
