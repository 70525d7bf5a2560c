"""Tests of spheres against cells, run on a device at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.cell_pairs import Pairs
from renderer.lab.exam.pair_tests import GROUP, run_tests
from renderer.lights.culling import sphere_tests
from renderer.lights.culling.cells import Cell, ClusterGrid, block_cell, padded_radius
from renderer.lights.culling.table import SPHERE_TESTS
from rhi import Device
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, function, global_id, ivec2, uint, vec3


class SpherePair(Struct):
    """A sphere, and the cell of a tile between two depths."""

    centre: vec3
    radius: float
    tile: ivec2
    near: float
    far: float


@function
def result_bit(index: int, passed: bool) -> uint:
    """The bit of a test that a pair passes."""
    return (uint(1) if passed else uint(0)) << uint(index)


class RunSphereTests(Shader):
    """Runs all tests, in the order of the table, and stores a bit for each."""

    work_group = (GROUP,)
    grid: Uniform[ClusterGrid]
    pairs: Storage[SpherePair]
    passed: StorageRW[uint]

    def compute(self) -> None:
        row = global_id().x
        if row < len(self.pairs):
            pair = self.pairs[row]
            cell = block_cell(self.grid, pair.tile, 1, pair.near, pair.far)
            self.passed[row] = self.test(cell, pair.centre, padded_radius(cell, pair.centre, pair.radius))

    def test(self, cell: Cell, centre: vec3, radius: float) -> uint:
        return (
            result_bit(0, sphere_tests.overlaps_always(cell, centre, radius))
            | result_bit(1, sphere_tests.overlaps_planes(cell, centre, radius))
            | result_bit(2, sphere_tests.overlaps_faces(cell, centre, radius))
            | result_bit(3, sphere_tests.overlaps_edges(cell, centre, radius))
            | result_bit(4, sphere_tests.overlaps_vertices(cell, centre, radius))
            | result_bit(5, sphere_tests.overlaps_faces_edges(cell, centre, radius))
            | result_bit(6, sphere_tests.overlaps_faces_vertices(cell, centre, radius))
            | result_bit(7, sphere_tests.overlaps_edges_vertices(cell, centre, radius))
            | result_bit(8, sphere_tests.overlaps_all_axes(cell, centre, radius))
            | result_bit(9, sphere_tests.overlaps_nearest_vertex(cell, centre, radius))
            | result_bit(10, sphere_tests.overlaps_hybrid(cell, centre, radius))
            | result_bit(11, sphere_tests.overlaps_box(cell, centre, radius))
            | result_bit(12, sphere_tests.overlaps_planes_box(cell, centre, radius))
            | result_bit(13, sphere_tests.overlaps_exactly(cell, centre, radius))
        )


def run_sphere_tests(device: Device, grid: ClusterGrid, rows: NDArray[Any]) -> dict[str, NDArray[np.bool_]]:
    """The pairs `rows` (n,) of `SpherePair` that pass each test."""
    return run_tests(device, RunSphereTests, SPHERE_TESTS, grid, SpherePair, rows)


def pack_pairs(pairs: Pairs) -> NDArray[Any]:
    """Pairs as an array of `SpherePair`."""
    rows = np.zeros(len(pairs.radii), SpherePair.dtype)
    rows["centre"], rows["radius"], rows["tile"] = pairs.centres, pairs.radii, pairs.tiles
    rows["near"], rows["far"] = pairs.near, pairs.far
    return rows
