"""Tests of spheres against cells: none drops a pair that overlaps, on any device."""

from __future__ import annotations

import numpy as np
import pytest
from culling_cases import LENSES, Pairs, make_pairs

import rhi
from renderer.lights.culling.cells import Cell, CellGrid, block_cell, corner, padded_radius
from renderer.lights.culling.projections import make_grid
from renderer.lights.culling.sphere_tests import (
    overlaps_all_axes,
    overlaps_always,
    overlaps_box,
    overlaps_edges,
    overlaps_edges_vertices,
    overlaps_exactly,
    overlaps_faces,
    overlaps_faces_edges,
    overlaps_faces_vertices,
    overlaps_hybrid,
    overlaps_nearest_vertex,
    overlaps_planes,
    overlaps_planes_box,
    overlaps_vertices,
)
from renderer.lights.culling.table import SPHERE_TESTS
from renderer.scene import Perspective
from rhi.shading import (
    Shader,
    Storage,
    StorageRW,
    Struct,
    Uniform,
    evaluate,
    function,
    global_id,
    ivec2,
    uint,
    vec3,
)

COUNT = 17_000  # of each of six lenses


class Pair(Struct):
    centre: vec3
    radius: float
    tile: ivec2
    near: float
    far: float


@function
def bit(index: int, kept: bool) -> uint:
    return (uint(1) if kept else uint(0)) << uint(index)


class RunSphereTests(Shader):
    """Makes all tests, in the order of the table, and stores a bit for each."""

    work_group = (64,)
    grid: Uniform[CellGrid]
    pairs: Storage[Pair]
    kept: StorageRW[uint]

    def compute(self) -> None:
        row = global_id().x
        if row < len(self.pairs):
            pair = self.pairs[row]
            cell = block_cell(self.grid, pair.tile, 1, pair.near, pair.far)
            self.kept[row] = self.test(cell, pair.centre, padded_radius(cell, pair.centre, pair.radius))

    def test(self, cell: Cell, centre: vec3, radius: float) -> uint:
        return (
            bit(0, overlaps_always(cell, centre, radius))
            | bit(1, overlaps_planes(cell, centre, radius))
            | bit(2, overlaps_faces(cell, centre, radius))
            | bit(3, overlaps_edges(cell, centre, radius))
            | bit(4, overlaps_vertices(cell, centre, radius))
            | bit(5, overlaps_faces_edges(cell, centre, radius))
            | bit(6, overlaps_faces_vertices(cell, centre, radius))
            | bit(7, overlaps_edges_vertices(cell, centre, radius))
            | bit(8, overlaps_all_axes(cell, centre, radius))
            | bit(9, overlaps_nearest_vertex(cell, centre, radius))
            | bit(10, overlaps_hybrid(cell, centre, radius))
            | bit(11, overlaps_box(cell, centre, radius))
            | bit(12, overlaps_planes_box(cell, centre, radius))
            | bit(13, overlaps_exactly(cell, centre, radius))
        )


def run_rows(device: rhi.Device, grid: CellGrid, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Make all tests of rows of `Pair`."""
    kept = device.storage(uint, len(rows))
    device.dispatch(
        device.program(RunSphereTests),
        -(-len(rows) // 64),
        grid=device.uniform(grid),
        pairs=device.storage(Pair, rows),
        kept=kept,
    )
    bits = kept.read()
    return {name: (bits >> index & 1).astype(bool) for index, name in enumerate(SPHERE_TESTS)}


def run(device: rhi.Device, pairs: Pairs) -> dict[str, np.ndarray]:
    """Make all tests of pairs on a device, in float32."""
    rows = np.zeros(len(pairs.radii), Pair.dtype)
    rows["centre"], rows["radius"], rows["tile"] = pairs.centres, pairs.radii, pairs.tiles
    rows["near"], rows["far"] = pairs.near, pairs.far
    return run_rows(device, pairs.grid, rows)


@pytest.fixture(scope="module", params=LENSES)
def pairs(request: pytest.FixtureRequest) -> Pairs:
    return make_pairs(request.param, COUNT)


def test_corners_are_those_of_the_inverse_projection(pairs: Pairs) -> None:
    for index in range(8):
        ours = evaluate(corner, pairs.cells, index, dtype=np.float64)
        assert np.allclose(ours, pairs.corners[:, index], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_no_pair_that_overlaps_is_dropped_in_float64(pairs: Pairs, name: str) -> None:
    test = SPHERE_TESTS[name]
    kept = evaluate(test.function, pairs.cells, pairs.centres, pairs.radii, dtype=np.float64)
    certain = np.abs(pairs.distances - pairs.radii) > 1e-9 * (1.0 + np.abs(pairs.centres).sum(1))
    assert not (pairs.overlap & ~kept & certain).any()
    assert 0.2 < pairs.overlap.mean() < 0.8
    assert certain.mean() > 0.9
    is_box = not pairs.grid.slope_step.x and "box" in name  # of a parallel lens
    if test.is_exact or is_box:
        assert (kept == pairs.overlap)[certain].all()
    else:
        assert (kept & ~pairs.overlap & certain).any()  # otherwise the table calls it less than it is


def test_no_pair_that_overlaps_is_dropped_on_a_device(device: rhi.Device, pairs: Pairs) -> None:
    for name, kept in run(device, pairs).items():
        assert not (pairs.overlap & ~kept).any(), name


def test_padding_adds_few_pairs_on_a_device(device: rhi.Device, pairs: Pairs) -> None:
    """Of exact tests: beyond what the padding explains, they keep nothing that doesn't overlap."""
    kept = run(device, pairs)
    lengths = np.abs(pairs.corners).max((1, 2)) * 3 + np.abs(pairs.centres).sum(1) + pairs.radii
    beyond = pairs.distances > pairs.radii + 4e-6 * lengths
    assert beyond.mean() > 0.2
    assert not (kept["exact"] & beyond).any()
    assert not (kept["all_axes"] & beyond).any()


# The cell is the whole view of a square lens that sees half a metre to each side at a distance of one.
HARD_CASES = {
    "a sphere beside a corner, behind no plane": ((6.2, 0.0, 11.4), 1.6, (1.0, 10.0), False),
    "a tangent sphere": ((0.0, 0.0, 11.0), 1.0 + 1e-6, (1.0, 10.0), True),
    "a tangent sphere beside an edge": ((6.0, 0.0, 10.0), 1.0 + 1e-6, (1.0, 10.0), True),
    "no radius, inside": ((0.0, 0.0, 5.0), 0.0, (1.0, 10.0), True),
    "no radius, outside": ((0.0, 0.0, 10.1), 0.0, (1.0, 10.0), False),
    "a huge radius": ((1e6, 0.0, 5.0), 1e6 + 10.0, (1.0, 10.0), True),
    "a huge radius, and too far": ((0.0, 0.0, -1e6), 1e6 - 10.0, (1.0, 10.0), False),
    "behind the eye": ((0.3, -0.2, -4.0), 5.3, (1.0, 10.0), True),
    "behind the eye, and too far": ((0.3, -0.2, -4.0), 4.9, (1.0, 10.0), False),
    "a flat cell": ((1.0, 1.0, 5.0), 1.0, (4.0, 4.0), True),
    "the corner of a flat cell": ((2.0, 2.0, 4.0), 0.0, (4.0, 4.0), True),
    "before a flat cell": ((1.0, 1.0, 5.01), 1.0, (4.0, 4.0), False),
}


@pytest.mark.parametrize("case", HARD_CASES)
def test_hard_cases_on_a_device(device: rhi.Device, case: str) -> None:
    centre, radius, (near, far), overlaps = HARD_CASES[case]
    grid = make_grid(Perspective(fov=2 * np.arctan(0.5), aspect=1.0), (1, 1), 1)
    row = np.zeros(1, Pair.dtype)
    row["centre"], row["radius"], row["near"], row["far"] = centre, radius, near, far
    kept = {name: bool(found[0]) for name, found in run_rows(device, grid, row).items()}
    if overlaps:
        assert all(kept.values())
    else:
        assert kept["planes"] or "too far" in case or case.startswith(("no", "before"))
        assert not kept["exact"]
        assert not kept["all_axes"]


@pytest.mark.nightly
@pytest.mark.parametrize("lens", LENSES)
def test_no_pair_of_a_hundred_thousand_is_dropped(device: rhi.Device, lens: str) -> None:
    many = make_pairs(lens, 100_000, seed=1)
    for name, kept in run(device, many).items():
        assert not (many.overlap & ~kept).any(), name
        test = SPHERE_TESTS[name].function
        exact = evaluate(test, many.cells, many.centres, many.radii * (1 + 1e-9) + 1e-9, dtype=np.float64)
        assert not (many.overlap & ~exact).any(), name
