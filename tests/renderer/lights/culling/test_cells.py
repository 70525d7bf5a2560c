"""Cells: which pixels and depths they have, and their slices. What devices find of them is examined by the
exam."""

from __future__ import annotations

import numpy as np
import pytest

from renderer.lab.exam.cell_pairs import PROJECTIONS, OffAxisPerspective, make_test_grid
from renderer.lab.exam.light_culling_cases import SLICED_GRIDS
from renderer.lights.culling.cells import (
    block_cell,
    corner,
    depth_bits,
    depth_to_distance,
    padded_radius,
    rounded_distance_range,
    slice_start,
)
from renderer.lights.culling.grid_projection import make_grid
from renderer.scene import Depth, Perspective
from rhi import ValidationError
from rhi.shading import evaluate


def test_cells_end_with_the_image() -> None:
    grid = make_test_grid("parallel", (1366, 768), tile=64)
    last = evaluate(block_cell, grid, (21, 11), 1, 0.0, 1.0, dtype=np.float64)
    assert np.allclose(last["high"][0], 15.0 * 1366 / 768)
    assert np.allclose(last["low"][1], -15.0)
    whole = evaluate(block_cell, grid, (0, 0), 22, 0.0, 1.0, dtype=np.float64)
    assert np.allclose([whole["low"], whole["high"]], [[-15 * 1366 / 768, -15], [15 * 1366 / 768, 15]])


@pytest.mark.parametrize("projection_name", PROJECTIONS)
def test_neighbours_share_their_sides_to_the_last_bit(projection_name: str) -> None:
    grid = make_test_grid(projection_name)
    cells = evaluate(block_cell, grid, np.stack(np.meshgrid(np.arange(171), np.arange(96)), -1), 1, 1.0, 2.0)
    for side in ("", "_slope"):
        assert (cells["high" + side][:, :-1, 0] == cells["low" + side][:, 1:, 0]).all()
        assert (cells["low" + side][:-1, :, 1] == cells["high" + side][1:, :, 1]).all()


def test_the_sides_of_an_off_axis_eye_are_shifted() -> None:
    grid, straight = (
        make_test_grid("off-axis", (1000, 1000)),
        make_grid(OffAxisPerspective().projection.with_aspect(1), (1000, 1000), 8),
    )
    ours = evaluate(block_cell, grid, (3, 5), 1, 1.0, 2.0, dtype=np.float64)
    other = evaluate(block_cell, straight, (3, 5), 1, 1.0, 2.0, dtype=np.float64)
    focal = OffAxisPerspective().projection.matrix[1, 1]
    assert np.allclose(ours["low_slope"] - other["low_slope"], np.array(OffAxisPerspective().shift) / focal)


# -- depths --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("projection_name", PROJECTIONS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_depth_is_the_distance_that_the_projection_gives_it(projection_name: str, dtype: type) -> None:
    projection, grid = PROJECTIONS[projection_name], make_test_grid(projection_name)
    z = np.linspace(grid.near, grid.far, 100)
    clip = np.column_stack([np.zeros((100, 2)), -z, np.ones(100)]) @ projection.matrix.T
    depth = (clip[:, 2] / clip[:, 3]).astype(np.float32)
    between = evaluate(rounded_distance_range, grid, depth, dtype=dtype)
    rounding = 1e-6 * (1.0 + np.abs(z))
    assert (between[:, 0] <= z + rounding).all()
    assert (z <= between[:, 1] + rounding).all()
    if projection_name != "standard":  # which is coarse
        assert (np.ptp(between, axis=1) < 0.01 * grid.far).all()


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize("far", [100.0, np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_farthest_depth_is_the_end_of_the_grid(far: float, depth: Depth, dtype: type) -> None:
    grid = make_grid(Perspective(far=far, depth=depth), (8, 8), 8, reach=80.0)
    assert evaluate(depth_to_distance, grid, grid.background, dtype=dtype) == 80.0
    assert evaluate(depth_to_distance, grid, 1.0 - grid.background, dtype=dtype) == pytest.approx(0.1)
    assert evaluate(rounded_distance_range, grid, grid.background, dtype=dtype)[1] == 80.0


# -- masks and radii -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_slices_of_a_mask_are_those_that_depths_lie_in(dtype: type) -> None:
    """Of 32 slices of 2 m that begin at 10 m; what lies beyond is in the first or the last."""
    rows = [(10.0, 11.9, 0, 0), (12.0, 12.0, 1, 1), (11.9, 12.1, 0, 1), (9.0, 13.0, 0, 1), (40.5, 75.0, 15, 31),
            (10.0, 74.0, 0, 31), (80.0, 90.0, 31, 31), (1.0, 2.0, 0, 0)]  # fmt: skip
    for low, high, first, last in rows:
        expected = sum(1 << bit for bit in range(first, last + 1))
        assert evaluate(depth_bits, 10.0, 74.0, low, high, dtype=dtype) == expected, (low, high)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_all_of_a_flat_range_is_in_its_first_slice(dtype: type) -> None:
    for low, high in ((5.0, 5.0), (1.0, 9.0), (6.0, 9.0), (1.0, 2.0)):
        assert evaluate(depth_bits, 5.0, 5.0, low, high, dtype=dtype) == 1


@pytest.mark.parametrize("projection_name", ["perspective", "parallel"])
def test_a_padded_radius_is_larger_by_the_rounding_of_the_greatest_coordinates(projection_name: str) -> None:
    """2^-20 of their sum: the sphere's, and those of the corners of a cell."""
    grid = make_test_grid(projection_name)
    tiles = np.stack(np.meshgrid(np.arange(0, 171, 10), np.arange(0, 96, 5)), -1).reshape(-1, 2)
    cells = evaluate(block_cell, grid, tiles, 1, 3.0, 20.0, dtype=np.float64)
    corners = np.stack([evaluate(corner, cells, index, dtype=np.float64) for index in range(8)])
    assert (np.abs(corners).max(0)[:, 2] == 20.0).all()
    centre, radius = np.array((-7.0, 2.5, 11.0)), 1.5
    padded = evaluate(padded_radius, cells, centre, radius, dtype=np.float64)
    reach = np.abs(corners).max(0).sum(1)
    assert np.allclose(padded - radius, 2.0**-20 * (radius + reach + np.abs(centre).sum()), rtol=1e-7)


# -- slices --------------------------------------------------------------------------------------------------


def test_slices_are_filaments() -> None:
    """z_i = zf · 2^((i - N) · L), L = log2(zf / zn) / (N - 1), and the first begins at the near plane."""
    grid, far, first, count = SLICED_GRIDS["filament"], 100.0, 5.0, 16
    length = np.log2(far / first) / (count - 1)
    ours = evaluate(slice_start, grid, np.arange(count + 1), dtype=np.float64)
    assert np.allclose(ours[1:], far * 2.0 ** ((np.arange(1, count + 1) - count) * length))
    assert ours[0] == pytest.approx(0.1)
    assert ours[1] == pytest.approx(5.0)


def test_slices_without_a_first_slice_are_spaced_logarithmically() -> None:
    starts = evaluate(slice_start, SLICED_GRIDS["geometric"], np.arange(25), dtype=np.float64)
    assert np.allclose(starts[1:] / starts[:-1], 1000.0 ** (1 / 24))
    flat = evaluate(slice_start, SLICED_GRIDS["parallel, behind"], np.arange(6), dtype=np.float64)
    assert np.allclose(flat, [-5, 12, 29, 46, 63, 80])


def test_a_grid_refuses_sizes_and_projections_that_cannot_be_divided() -> None:
    class Rolled(OffAxisPerspective):
        @property
        def matrix(self) -> np.ndarray:
            m = super().matrix
            m[0, 1] = 0.1
            return m

    for wrong_options in (
        {"size": (0, 4)},
        {"tile": 0},
        {"slices": 0},
        {"projection": Rolled()},
        {"slices": 4, "first_slice": 0.05},
        {"slices": 4, "first_slice": 200.0},
    ):
        options = {"projection": Perspective(far=100.0), "size": (4, 4), "tile": 4} | wrong_options
        with pytest.raises(ValidationError, match="lights-bad-grid"):
            make_grid(options.pop("projection"), options.pop("size"), options.pop("tile"), **options)
