"""Cells: which pixels and depths they have, and the slices and masks of depths."""

from __future__ import annotations

import numpy as np
import pytest
from culling_cases import LENSES, OffAxis, make_test_grid

import rhi
from renderer.lights.culling.cells import (
    CellGrid,
    block_cell,
    cell_index,
    corner,
    depth_bits,
    distance_of,
    distances_of,
    seen_from,
    slice_of,
    slice_start,
    squared_distance,
)
from renderer.lights.culling.projections import make_grid
from renderer.lights.culling.sphere_tests import overlaps_exactly, overlaps_planes
from renderer.lights.culling.table import SPHERE_TESTS
from renderer.scene import Depth, Orthographic, Perspective
from rhi import ValidationError
from rhi.shading import Shader, Storage, StorageRW, Uniform, evaluate, global_id, vec2

SIZES = [(1366, 768), (1680, 1050), (1280, 720), (41, 41), (1, 1)]


@pytest.mark.parametrize("tile", [1, 8, 41, 64])
@pytest.mark.parametrize("size", SIZES)
def test_every_pixel_is_in_the_cell_of_its_index(size: tuple[int, int], tile: int) -> None:
    lens = Perspective(aspect=size[0] / size[1], far=50.0)
    grid = make_grid(lens, size, tile)
    assert (grid.count.x, grid.count.y) == (-(-size[0] // tile), -(-size[1] // tile))
    rng = np.random.default_rng(4)
    x, y = (np.append(rng.integers(0, length, 500), [0, length - 1, length // tile * tile - 1]) for length in size)
    x, y = np.maximum(x, 0), np.maximum(y, 0)
    index = evaluate(cell_index, grid, np.column_stack([x, y]), 7.0)
    assert ((index >= 0) & (index < grid.count.x * grid.count.y)).all()
    tiles = np.column_stack([index % grid.count.x, index // grid.count.x])
    cells = evaluate(block_cell, grid, tiles, 1, 7.0, 7.0, dtype=np.float64)
    height = 7.0 * np.tan(lens.fov / 2)
    at = np.column_stack([(2 * x + 1) / size[0] - 1.0, 1.0 - (2 * y + 1) / size[1]]) * (height * lens.aspect, height)
    low, high = cells["low"] + cells["low_slope"] * 7.0, cells["high"] + cells["high_slope"] * 7.0
    assert ((low < at) & (at < high)).all()


def test_a_tile_is_found_by_integers() -> None:
    """In float32 41 · (1 / 41) is below 1."""
    assert np.floor(np.float32(41) * (np.float32(1) / np.float32(41))) == 0.0
    grid = make_grid(Perspective(), (1680, 1050), 41)
    pixels = np.column_stack([41 * np.arange(1680 // 41 + 1), np.zeros(1680 // 41 + 1)]).astype(np.int32)
    assert evaluate(cell_index, grid, pixels, 1.0).tolist() == list(range(1680 // 41 + 1))


def test_cells_end_with_the_image() -> None:
    grid = make_test_grid("parallel", (1366, 768), tile=64)
    last = evaluate(block_cell, grid, (21, 11), 1, 0.0, 1.0, dtype=np.float64)
    assert np.allclose(last["high"][0], 15.0 * 1366 / 768)
    assert np.allclose(last["low"][1], -15.0)
    whole = evaluate(block_cell, grid, (0, 0), 22, 0.0, 1.0, dtype=np.float64)
    assert np.allclose([whole["low"], whole["high"]], [[-15 * 1366 / 768, -15], [15 * 1366 / 768, 15]])


@pytest.mark.parametrize("lens", LENSES)
def test_neighbours_share_their_sides_to_the_last_bit(lens: str) -> None:
    grid = make_test_grid(lens)
    cells = evaluate(block_cell, grid, np.stack(np.meshgrid(np.arange(171), np.arange(96)), -1), 1, 1.0, 2.0)
    for side in ("", "_slope"):
        assert (cells["high" + side][:, :-1, 0] == cells["low" + side][:, 1:, 0]).all()
        assert (cells["low" + side][:-1, :, 1] == cells["high" + side][1:, :, 1]).all()


def test_the_sides_of_an_off_axis_eye_are_shifted() -> None:
    grid, straight = make_test_grid("off-axis", (1000, 1000)), make_grid(OffAxis().lens.with_aspect(1), (1000, 1000), 8)
    ours = evaluate(block_cell, grid, (3, 5), 1, 1.0, 2.0, dtype=np.float64)
    other = evaluate(block_cell, straight, (3, 5), 1, 1.0, 2.0, dtype=np.float64)
    focal = OffAxis().lens.matrix[1, 1]
    assert np.allclose(ours["low_slope"] - other["low_slope"], np.array(OffAxis().shift) / focal)


def test_a_parallel_lens_may_begin_at_the_eye_and_behind_it() -> None:
    for lens, near in (("parallel", 0.0), ("parallel, behind", -20.0)):
        grid = make_test_grid(lens)
        assert grid.near == near
        cell = evaluate(block_cell, grid, (0, 0), 1, grid.near, grid.far, dtype=np.float64)
        assert overlaps_at(cell, evaluate(corner, cell, 0, dtype=np.float64), 1e-6)


def overlaps_at(cell: np.ndarray, centre: object, radius: float) -> bool:
    kept = {evaluate(t.function, cell, centre, radius, dtype=np.float64).item() for t in SPHERE_TESTS.values()}
    return kept == {True}


# -- depths --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_depth_is_the_distance_that_the_projection_gives_it(lens: str, dtype: type) -> None:
    projection, grid = LENSES[lens], make_test_grid(lens)
    z = np.linspace(grid.near, grid.far, 100)
    clip = np.column_stack([np.zeros((100, 2)), -z, np.ones(100)]) @ projection.matrix.T
    depth = (clip[:, 2] / clip[:, 3]).astype(np.float32)
    between = evaluate(distances_of, grid, depth, dtype=dtype)
    rounding = 1e-6 * (1.0 + np.abs(z))
    assert (between[:, 0] <= z + rounding).all()
    assert (z <= between[:, 1] + rounding).all()
    if lens != "standard":  # which is coarse
        assert (np.ptp(between, axis=1) < 0.01 * grid.far).all()


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize("far", [100.0, np.inf])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_farthest_depth_is_the_end_of_the_grid(far: float, depth: Depth, dtype: type) -> None:
    grid = make_grid(Perspective(far=far, depth=depth), (8, 8), 8, reach=80.0)
    assert evaluate(distance_of, grid, grid.background, dtype=dtype) == 80.0
    assert evaluate(distance_of, grid, 1.0 - grid.background, dtype=dtype) == pytest.approx(0.1)
    assert evaluate(distances_of, grid, grid.background, dtype=dtype)[1] == 80.0


def test_the_mask_of_a_flat_tile_keeps_its_surface() -> None:
    for dtype in (np.float32, np.float64):
        assert evaluate(depth_bits, 5.0, 5.0, 5.0, 5.0, dtype=dtype) == 1
        assert evaluate(depth_bits, 5.0, 5.0, 3.0, 7.0, dtype=dtype) == 1
        assert evaluate(depth_bits, 5.0, np.nextafter(5.0, 6.0), 3.0, 7.0, dtype=dtype) & 1


def test_masks_that_touch_meet_whatever_rounding_does() -> None:
    rng = np.random.default_rng(2)
    near = rng.uniform(0.1, 100.0, 5000).astype(np.float32)
    far = near + (10.0 ** rng.uniform(-6, 3, 5000)).astype(np.float32)
    z = (near + (far - near) * rng.random(5000)).astype(np.float32)
    surface = evaluate(depth_bits, near, far, z, z)
    for low, high in ((z, z), (z - 1, z), (z, z + 1), (z - 9, z + 99)):
        light = evaluate(depth_bits, near, far, low.astype(np.float32), high.astype(np.float32))
        assert (surface & light != 0).all()
    ends = evaluate(depth_bits, 0.0, 32.0, np.arange(32), np.arange(32) + 0.5)
    assert ends.tolist() == [1 << bit for bit in range(32)]
    assert evaluate(depth_bits, 0.0, 32.0, 2.5, 4.5) == 0b11100
    assert evaluate(depth_bits, 0.0, 32.0, -5.0, 99.0) == 0xFFFFFFFF


# -- slices --------------------------------------------------------------------------------------------------------

GRIDS = {
    "geometric": make_grid(Perspective(far=100.0), (64, 64), 16, slices=24),
    "filament": make_grid(Perspective(far=100.0), (64, 64), 16, slices=16, first_slice=5.0),
    "endless": make_grid(Perspective(), (64, 64), 16, slices=32, reach=70.0),
    "one": make_grid(Perspective(), (64, 64), 16, reach=70.0),
    "two": make_grid(Perspective(far=60.0), (64, 64), 16, slices=2, first_slice=59.0),
    "parallel": make_grid(Orthographic(10.0, near=0.0, far=80.0), (64, 64), 16, slices=7),
    "parallel, behind": make_grid(Orthographic(10.0, near=-5.0, far=80.0), (64, 64), 16, slices=5),
}


class FindSlices(Shader):
    """Finds the slices of depths, and where those begin and end."""

    work_group = (64,)
    grid: Uniform[CellGrid]
    depths: Storage[float]
    slices: StorageRW[int]
    ends: StorageRW[vec2]
    starts: StorageRW[float]

    def compute(self) -> None:
        row = global_id().x
        if row <= self.grid.count.z:
            self.starts[row] = slice_start(self.grid, row)
        if row < len(self.depths):
            index = slice_of(self.grid, self.depths[row])
            self.slices[row] = index
            self.ends[row] = vec2(slice_start(self.grid, index), slice_start(self.grid, index + 1))


@pytest.mark.parametrize("name", GRIDS)
def test_a_shader_finds_the_slice_that_was_culled_at_every_boundary(device: rhi.Device, name: str) -> None:
    grid = GRIDS[name]
    count = grid.count.z
    starts = device.storage(float, 64)

    def find(depths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slices, ends = device.storage(int, len(depths)), device.storage(vec2, len(depths))
        device.dispatch(
            device.program(FindSlices), 64, grid=device.uniform(grid),
            depths=device.storage(float, depths), slices=slices, ends=ends, starts=starts,
        )  # fmt: skip
        return slices.read(), ends.read()

    find(np.ones(1, np.float32))
    bounds = starts.read()[: count + 1]
    assert (np.diff(bounds) > 0).all()
    below, above = np.nextafter(bounds, np.float32(-np.inf)), np.nextafter(bounds, np.float32(np.inf))
    for depths, shift in ((bounds, 0), (below, -1), (above, 0)):
        slices, _ = find(depths.astype(np.float32))
        assert slices.tolist() == np.clip(np.arange(count + 1) + shift, 0, count - 1).tolist()
    inside = np.random.default_rng(1).uniform(grid.near, grid.far, 3000).astype(np.float32)
    inside = inside[(inside >= bounds[0]) & (inside < bounds[-1])]
    slices, ends = find(inside)
    assert ((ends[:, 0] <= inside) & (inside < ends[:, 1])).all()
    assert (np.unique(slices) < count).all()


def test_slices_are_filaments() -> None:
    """z_i = zf · 2^((i - N) · L), L = log2(zf / zn) / (N - 1), and the first begins at the near plane."""
    grid, far, first, count = GRIDS["filament"], 100.0, 5.0, 16
    length = np.log2(far / first) / (count - 1)
    ours = evaluate(slice_start, grid, np.arange(count + 1), dtype=np.float64)
    assert np.allclose(ours[1:], far * 2.0 ** ((np.arange(1, count + 1) - count) * length))
    assert ours[0] == pytest.approx(0.1)
    assert ours[1] == pytest.approx(5.0)


def test_slices_without_a_first_one_are_equally_long_in_the_logarithm() -> None:
    starts = evaluate(slice_start, GRIDS["geometric"], np.arange(25), dtype=np.float64)
    assert np.allclose(starts[1:] / starts[:-1], 1000.0 ** (1 / 24))
    flat = evaluate(slice_start, GRIDS["parallel, behind"], np.arange(6), dtype=np.float64)
    assert np.allclose(flat, [-5, 12, 29, 46, 63, 80])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", GRIDS)
def test_what_lies_outside_of_the_slices_is_in_the_first_or_the_last(name: str, dtype: type) -> None:
    grid = GRIDS[name]
    depths = np.array([-1e9, -6.0, grid.near, 1e-30 if grid.near > 0 else -4.9, 1e9, 1e30, np.inf])
    last = grid.count.z - 1
    assert evaluate(slice_of, grid, depths, dtype=dtype).tolist() == [0, 0, 0, 0, last, last, last]


def test_a_depth_between_the_near_plane_and_the_second_slice_is_in_the_first() -> None:
    assert evaluate(slice_of, GRIDS["filament"], np.array([0.1, 1.0, 4.999, 5.001])).tolist() == [0, 0, 0, 1]


# -- hard cases ----------------------------------------------------------------------------------------------------


def frustum(half: float = 0.5, near: float = 1.0, far: float = 10.0) -> dict[str, object]:
    """A cell around the axis of a lens of perspective."""
    return {
        "low": (0.0, 0.0), "low_slope": (-half, -half), "high": (0.0, 0.0), "high_slope": (half, half),
        "near": near, "far": far,
    }  # fmt: skip


def find_distance(cell: dict[str, object], centre: tuple[float, float, float]) -> float:
    seen = evaluate(seen_from, cell, centre, dtype=np.float64)
    return float(np.sqrt(evaluate(squared_distance, seen, dtype=np.float64)))


def test_a_sphere_beside_a_corner_is_behind_no_plane() -> None:
    """Thatcher's figure 2: the sphere is in no half space, and yet outside."""
    cell, centre = frustum(), (6.2, 0.0, 11.4)
    assert evaluate(overlaps_planes, cell, centre, 1.6, dtype=np.float64)
    assert not evaluate(overlaps_exactly, cell, centre, 1.6, dtype=np.float64)
    assert find_distance(cell, centre) == pytest.approx(np.hypot(6.2 - 5.0, 1.4))


@pytest.mark.parametrize("radius", [1e-3, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_a_tangent_sphere_is_kept_and_one_that_is_smaller_by_a_millionth_is_not_by_exact_tests(
    name: str, radius: float
) -> None:
    test = SPHERE_TESTS[name]
    for centre in ((0.0, 0.0, 10.0 + radius), (5.0 + radius, 0.0, 10.0), (0.0, 0.0, 1.0 - radius)):
        away = find_distance(frustum(), centre)
        assert evaluate(test.function, frustum(), centre, away * (1 + 1e-6), dtype=np.float64)
        if test.is_exact:
            assert not evaluate(test.function, frustum(), centre, away * (1 - 1e-6), dtype=np.float64)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_spheres_of_no_and_of_huge_radius(name: str, dtype: type) -> None:
    test = SPHERE_TESTS[name]
    huge = [((1.0, 1.0, 5.0), 1e6), ((1e6, 0.0, 5.0), 1e6 + 10), ((0.0, 0.0, -1e6), 1e6 + 9)]
    for centre, radius in [((0.0, 0.0, 5.0), 0.0), *huge]:
        assert evaluate(test.function, frustum(), centre, radius, dtype=dtype)
    if test.is_exact:
        assert not evaluate(test.function, frustum(), (0.0, 0.0, 11.0), 0.0, dtype=dtype)
        assert not evaluate(test.function, frustum(), (0.0, 0.0, -1e6), 1e6 - 10, dtype=dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_a_light_behind_the_eye_that_reaches_the_screen_is_kept(name: str, dtype: type) -> None:
    assert evaluate(SPHERE_TESTS[name].function, frustum(), (0.3, -0.2, -4.0), 5.3, dtype=dtype)
    assert not evaluate(overlaps_exactly, frustum(), (0.3, -0.2, -4.0), 4.9, dtype=dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("name", SPHERE_TESTS)
def test_a_flat_cell_is_a_rectangle(name: str, dtype: type) -> None:
    flat = frustum(near=4.0, far=4.0)
    assert evaluate(SPHERE_TESTS[name].function, flat, (1.0, 1.0, 4.0), 0.0, dtype=dtype)
    assert evaluate(SPHERE_TESTS[name].function, flat, (1.0, 1.0, 5.0), 1.0, dtype=dtype)
    assert evaluate(SPHERE_TESTS[name].function, flat, (2.0, 2.0, 4.0), 0.0, dtype=dtype)
    assert not evaluate(overlaps_exactly, flat, (1.0, 1.0, 5.01), 1.0, dtype=dtype)


def test_a_grid_refuses_what_cannot_be_divided() -> None:
    class Rolled(OffAxis):
        @property
        def matrix(self) -> np.ndarray:
            m = super().matrix
            m[0, 1] = 0.1
            return m

    for given in (
        {"size": (0, 4)}, {"tile": 0}, {"slices": 0}, {"projection": Rolled()}, {"slices": 4, "first_slice": 0.05},
        {"slices": 4, "first_slice": 200.0},
    ):  # fmt: skip
        options = {"projection": Perspective(far=100.0), "size": (4, 4), "tile": 4} | given
        with pytest.raises(ValidationError) as refused:
            make_grid(options.pop("projection"), options.pop("size"), options.pop("tile"), **options)
        assert refused.value.rule.id == "lights-bad-grid"
