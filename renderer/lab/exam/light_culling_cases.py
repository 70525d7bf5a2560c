"""Light culling: no test may drop a pair of a cell and a light that overlap.

Cells are looked up and tested in float32 on the device. What is right is known in float64, mostly by formulas
that shaders don't use: the inverse of a projection gives the corners of cells.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

import rhi.shading as sl
from renderer.lab.exam.case import CaseResult, Measures, largest_error
from renderer.lab.exam.cell_pairs import PROJECTIONS, Pairs, cell_corners, make_pairs, make_test_grid
from renderer.lab.exam.cone_pairs import ANGLES, make_cone_pairs, run_cone_tests
from renderer.lab.exam.sphere_pairs import SpherePair, pack_pairs, run_sphere_tests
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling.cells import (
    Cell,
    ClusterGrid,
    block_cell,
    cell_index,
    depth_bits,
    rounded_distance_range,
    slice_index,
    slice_start,
)
from renderer.lights.culling.grid_projection import make_grid
from renderer.lights.culling.light_lists import LightLists
from renderer.lights.culling.table import CONE_TESTS, SPHERE_TESTS
from renderer.scene import Camera, Depth, Lights, Orthographic, Perspective
from renderer.scene.arrays import Floats
from rhi import Device

GROUP: Final = 64
PAIRS: Final = 4_000  # for each of six projections
EXACT: Final = [name for name, test in SPHERE_TESTS.items() if test.is_exact]
HALF: Final = 0.5
"""Half the width and height of the view at a distance of one metre, in cases with one cell."""


class Sphere(NamedTuple):
    """A sphere, and whether it overlaps the cell of the whole view between two depths."""

    centre: tuple[float, float, float]
    radius: float
    depths: tuple[float, float]
    overlaps: bool


def measure_sphere_decisions(spheres: dict[str, Sphere], device: Device) -> CaseResult:
    """Count the wrong decisions: tests that drop overlapping pairs, and exact tests that keep others. They
    run on the device, with radii padded for its rounding, and unpadded on NumPy in float64 and float32."""
    rows = np.zeros(len(spheres), SpherePair.dtype)
    for row, (centre, radius, depths, _) in zip(rows, spheres.values(), strict=True):
        row["centre"], row["radius"], (row["near"], row["far"]) = centre, radius, depths
    grid = make_grid(Perspective(fov=2.0 * np.arctan(HALF), aspect=1.0), (1, 1), 1)
    passed = run_sphere_tests(device, grid, rows)
    overlaps = np.array([sphere.overlaps for sphere in spheres.values()])
    cells, centres = (
        make_frustums(rows["near"], rows["far"]),
        np.array([sphere.centre for sphere in spheres.values()]),
    )
    radii = np.array([sphere.radius for sphere in spheres.values()])
    wrong = np.zeros(len(rows), np.int64)
    for name, test in SPHERE_TESTS.items():
        plain = (
            sl.evaluate(test.function, cells, centres, radii, dtype=dtype)
            for dtype in (np.float64, np.float32)
        )
        for passes in (passed[name], *plain):
            wrong += overlaps & ~passes
            if test.is_exact:
                wrong += passes & ~overlaps
    return CaseResult(
        int(wrong.sum()),
        {title: f"{count} wrong" for title, count in zip(spheres, wrong.tolist(), strict=True)},
    )


def make_frustums(near: Floats, far: Floats) -> dict[str, Floats]:
    """The cells of the whole view between depths (n,), as shaders have them."""
    slope = np.full((len(near), 2), HALF)
    return {
        "low": 0.0 * slope,
        "low_slope": -slope,
        "high": 0.0 * slope,
        "high_slope": slope,
        "near": np.asarray(near, np.float64),
        "far": np.asarray(far, np.float64),
    }


WHOLE_DEPTH_RANGE: Final = (1.0, 10.0)
FIGURE_2: Final = Sphere((6.2, 0.0, 11.4), 1.6, WHOLE_DEPTH_RANGE, False)
SPHERES: Final[dict[int, dict[str, Sphere]]] = {
    24: {
        "no radius, inside": Sphere((0.0, 0.0, 5.0), 0.0, WHOLE_DEPTH_RANGE, True),
        "no radius, outside": Sphere((0.0, 0.0, 10.1), 0.0, WHOLE_DEPTH_RANGE, False),
        "a huge radius around it": Sphere((1.0, 1.0, 5.0), 1e6, WHOLE_DEPTH_RANGE, True),
        "a huge radius": Sphere((1e6, 0.0, 5.0), 1e6 + 10.0, WHOLE_DEPTH_RANGE, True),
        "a huge radius, behind": Sphere((0.0, 0.0, -1e6), 1e6 + 9.0, WHOLE_DEPTH_RANGE, True),
        "a huge radius, and too far": Sphere((0.0, 0.0, -1e6), 1e6 - 10.0, WHOLE_DEPTH_RANGE, False),
    },
    25: {
        "behind the eye": Sphere((0.3, -0.2, -4.0), 5.3, WHOLE_DEPTH_RANGE, True),
        "behind the eye, and too far": Sphere((0.3, -0.2, -4.0), 4.9, WHOLE_DEPTH_RANGE, False),
    },
    26: {
        "a point in a flat cell": Sphere((1.0, 1.0, 4.0), 0.0, (4.0, 4.0), True),
        "a flat cell": Sphere((1.0, 1.0, 5.0), 1.0, (4.0, 4.0), True),
        "the corner of a flat cell": Sphere((2.0, 2.0, 4.0), 0.0, (4.0, 4.0), True),
        "before a flat cell": Sphere((1.0, 1.0, 5.01), 1.0, (4.0, 4.0), False),
    },
}
"""The spheres of cases that need no further code."""


def measure_sphere_beside_corner(device: Device) -> CaseResult:
    """Test the sphere of Thatcher's figure 2, and check that plane tests keep it."""
    result = measure_sphere_decisions(
        {"beside a corner": FIGURE_2, "a larger one": FIGURE_2._replace(radius=2.4, overlaps=True)}, device
    )
    planes = sl.evaluate(
        SPHERE_TESTS["planes"].function,
        make_frustums(*np.atleast_2d(WHOLE_DEPTH_RANGE).T),
        np.array([FIGURE_2.centre]),
        1.6,
        dtype=np.float64,
    )
    return CaseResult(result.error, result.numbers, {"it is behind no plane": bool(planes.all())})


def measure_tangent_spheres(device: Device) -> CaseResult:
    """Test spheres that touch the end, an edge and the begin of a cell, a millionth larger and smaller.

    In float32 only the larger ones are checked: the padding keeps the smaller.
    """
    spheres = [
        (title, centre, radius)
        for radius in (1e-3, 1.0, 1e3, 1e6)
        for title, centre in (
            ("behind", (0.0, 0.0, 10.0 + radius)),
            ("beside", (5.0 + radius, 0.0, 10.0)),
            ("before", (0.0, 0.0, 1.0 - radius)),
        )
    ]
    count = len(spheres)
    centres, radii = (
        np.array([centre for _, centre, _ in spheres]),
        np.array([radius for *_, radius in spheres]),
    )
    cells = make_frustums(np.full(count, 1.0), np.full(count, 10.0))
    wrong = np.zeros(count, np.int64)
    for test in SPHERE_TESTS.values():
        larger, smaller = (
            sl.evaluate(test.function, cells, centres, radii * (1.0 + off), dtype=np.float64)
            for off in (1e-6, -1e-6)
        )
        wrong += ~larger
        if test.is_exact:
            wrong += smaller
    rows = np.zeros(count, SpherePair.dtype)
    rows["centre"], rows["near"], rows["far"] = centres, 1.0, 10.0
    away = np.where(centres[:, 0] > 0.0, rows["centre"][:, 0] - 5.0, np.abs(rows["centre"][:, 2] - 5.5) - 4.5)
    rows["radius"] = away * (1.0 + 1e-6)  # of the centres as float32 has them
    grid = make_grid(Perspective(fov=2.0 * np.arctan(HALF), aspect=1.0), (1, 1), 1)
    for passed in run_sphere_tests(device, grid, rows).values():
        wrong += ~passed
    numbers = {
        f"{title}, radius {radius:g}": f"{n} wrong"
        for (title, _, radius), n in zip(spheres, wrong, strict=True)
    }
    return CaseResult(int(wrong.sum()), numbers)


class CellQuery(sl.Struct):
    """A pixel, the distance of its surface, the depth of a texture, and ranges of depth for a mask."""

    pixel: sl.ivec2
    z: float
    depth: float
    near: float
    far: float
    low: float
    high: float


class CellQueryResult(sl.Struct):
    """The shader's results for a `CellQuery`: the cell, its slice and the slice's begin and end, its sides at
    the distance z (left, lower, right, upper), the least and greatest distance of the depth, and the bits of
    the mask."""

    sides: sl.vec4
    ends: sl.vec2
    distances: sl.vec2
    cell: int
    slice: int
    bits: sl.uint


@sl.function
def cell_sides(grid: ClusterGrid, index: int, z: float) -> sl.vec4:
    """The left, lower, right and upper side of the cell of this index at a distance."""
    tile = sl.ivec2(index % grid.count.x, index // grid.count.x % grid.count.y)
    cell: Cell = block_cell(grid, tile, 1, z, z)
    return sl.vec4(cell.low + cell.low_slope * z, cell.high + cell.high_slope * z)


class QueryCells(sl.Shader):
    """Computes the results of `CellQuery` structs."""

    work_group = (GROUP,)
    grid: sl.Uniform[ClusterGrid]
    queries: sl.Storage[CellQuery]
    results: sl.StorageRW[CellQueryResult]

    def compute(self) -> None:
        row = sl.global_id().x
        if row >= len(self.queries):
            return
        asked = self.queries[row]
        index = cell_index(self.grid, asked.pixel, asked.z)
        at = slice_index(self.grid, asked.z)
        self.results[row] = CellQueryResult(
            sides=cell_sides(self.grid, index, asked.z),
            ends=sl.vec2(slice_start(self.grid, at), slice_start(self.grid, at + 1)),
            distances=rounded_distance_range(self.grid, asked.depth),
            cell=index,
            slice=at,
            bits=depth_bits(asked.near, asked.far, asked.low, asked.high),
        )


def query_cells(device: Device, grid: ClusterGrid, queries: NDArray[Any]) -> NDArray[Any]:
    """The results of a device for queries (n,) of `CellQuery`."""
    count = len(queries)
    buffers = (
        device.uniform(grid),
        device.storage(CellQuery, queries),
        device.storage(CellQueryResult, count),
    )
    uniform, asked, results = buffers
    device.dispatch(
        device.program(QueryCells), -(-count // GROUP), grid=uniform, queries=asked, results=results
    )
    cells: NDArray[Any] = results.read()
    for buffer in buffers:
        buffer.destroy()
    return cells


def make_queries(count: int, **fields: Any) -> NDArray[Any]:
    """Make queries with these fields; depths are 1 by default."""
    queries = np.ones(count, CellQuery.dtype)
    queries["pixel"] = 0
    for name, values in fields.items():
        queries[name] = values
    return queries


def measure_flat_tiles(device: Device) -> CaseResult:
    """Test spheres against flat cells, and check that the masks of flat ranges, and of ranges of a millionth,
    meet those of everything that touches them."""
    result = measure_sphere_decisions(SPHERES[26], device)
    rng = np.random.default_rng(2)
    near = rng.uniform(0.1, 100.0, 5000).astype(np.float32)
    far = near + (10.0 ** rng.uniform(-6, 3, 5000)).astype(np.float32)
    far[:500] = near[:500]
    far[500:600] = np.nextafter(near[500:600], np.float32(np.inf))
    z = (near + (far - near) * rng.random(5000)).astype(np.float32)
    grid, lost = make_test_grid("perspective"), 0
    surface = query_cells(device, grid, make_queries(5000, near=near, far=far, low=z, high=z))["bits"]
    for low, high in ((z, z), (z - 1, z), (z, z + 1), (z - 9, z + 99)):
        light = query_cells(device, grid, make_queries(5000, near=near, far=far, low=low, high=high))["bits"]
        lost += int((surface & light == 0).sum())
    ends = query_cells(
        device, grid, make_queries(32, near=0.0, far=32.0, low=np.arange(32), high=np.arange(32) + 0.5)
    )["bits"]
    part = query_cells(device, grid, make_queries(1, near=0.0, far=32.0, low=2.5, high=4.5))["bits"]
    holds = {
        "a mask has a bit for each slice": ends.tolist() == [1 << bit for bit in range(32)],
        "a mask is no wider than its range": part.tolist() == [0b11100],
    }
    numbers = {**result.numbers, "masks that don't meet": lost}
    return CaseResult(result.error + lost, numbers, holds)


def measure_depth_ranges(device: Device) -> CaseResult:
    """Compute the distances of the nearest and the farthest depth, with the far plane at 100 m and at
    infinity."""
    wrong: dict[str, object] = {}
    error = 0.0
    for depth in Depth:
        for far in (100.0, np.inf):
            grid = make_grid(Perspective(far=far, depth=depth), (8, 8), 8, reach=80.0)
            queries = make_queries(2, depth=(grid.background, 1.0 - grid.background))
            (_, farthest), (nearest, _) = query_cells(device, grid, queries)["distances"].tolist()
            off = largest_error(abs(farthest - 80.0) / 80.0, abs(nearest - 0.1) / 0.1)
            wrong[f"{depth.value}, far plane at {far:g} m"] = f"{nearest:.6g} to {farthest:.6g} m"
            error = largest_error(error, off) if np.isfinite(off) else np.inf
    return CaseResult(error, wrong)


_IMAGE_SIZES: Final = ((1366, 768), (1680, 1050), (1280, 720), (41, 41), (1, 1))


def measure_pixel_cells(device: Device) -> CaseResult:
    """Look up the cells of pixels, those at the edges included, and check that each pixel is inside the sides
    of its cell."""
    wrong: dict[str, int] = {}
    for size in _IMAGE_SIZES:
        for tile in (1, 8, 41, 64):
            projection = Perspective(aspect=size[0] / size[1], far=50.0)
            grid, rng = make_grid(projection, size, tile), np.random.default_rng(4)
            x, y = (
                np.maximum(np.append(rng.integers(0, n, 500), [0, n - 1, n // tile * tile - 1]), 0)
                for n in size
            )
            results = query_cells(device, grid, make_queries(len(x), pixel=np.column_stack([x, y]), z=7.0))
            columns, rows = -(-size[0] // tile), -(-size[1] // tile)
            valid = (results["cell"] >= 0) & (results["cell"] < columns * rows)
            height = 7.0 * np.tan(projection.fov / 2)
            clip = np.column_stack([(2 * x + 1) / size[0] - 1.0, 1.0 - (2 * y + 1) / size[1]])
            at = clip * (height * projection.aspect, height)
            inside = ((results["sides"][:, :2] < at) & (at < results["sides"][:, 2:])).all(1)
            count = int((~(valid & inside)).sum()) + ((grid.count.x, grid.count.y) != (columns, rows))
            wrong[f"{size[0]} × {size[1]}, tiles of {tile}"] = count
    return CaseResult(sum(wrong.values()), wrong)


def measure_orthographic_cells_at_eye(device: Device) -> CaseResult:
    """Test points at the corners of cells of parallel projections that begin at the eye, and behind it."""
    wrong: dict[str, int] = {}
    for name, near in (("parallel", 0.0), ("parallel, behind", -20.0)):
        grid = make_test_grid(name)
        tiles = np.array([(0, 0), (170, 95), (85, 40)], np.int32)
        depth = np.full(3, near)
        corners = cell_corners(PROJECTIONS[name].with_aspect(1366 / 768), grid, tiles, depth, depth)
        rows = np.zeros(3, SpherePair.dtype)
        rows["centre"], rows["radius"], rows["tile"] = corners[:, 0], 1e-6, tiles
        rows["near"], rows["far"] = near, grid.far
        passed = run_sphere_tests(device, grid, rows)
        wrong[f"near plane at {near:g} m"] = sum(int((~passes).sum()) for passes in passed.values()) + (
            grid.near != near
        )
    return CaseResult(sum(wrong.values()), wrong)


SLICED_GRIDS: Final = {
    "geometric": make_grid(Perspective(far=100.0), (64, 64), 16, slices=24),
    "filament": make_grid(Perspective(far=100.0), (64, 64), 16, slices=16, first_slice=5.0),
    "endless": make_grid(Perspective(), (64, 64), 16, slices=32, reach=70.0),
    "one": make_grid(Perspective(), (64, 64), 16, reach=70.0),
    "two": make_grid(Perspective(far=60.0), (64, 64), 16, slices=2, first_slice=59.0),
    "parallel": make_grid(Orthographic(10.0, near=0.0, far=80.0), (64, 64), 16, slices=7),
    "parallel, behind": make_grid(Orthographic(10.0, near=-5.0, far=80.0), (64, 64), 16, slices=5),
}
"""Grids with depth slices of all kinds."""


def measure_outer_slices(device: Device) -> CaseResult:
    """Look up the slices of depths between the near plane and the first boundary, before them and behind the
    last."""
    numbers: dict[str, object] = {}
    total = 0
    for name, grid in SLICED_GRIDS.items():
        low = 1e-30 if grid.near > 0 else -4.9
        depths = np.array([-1e9, -6.0, grid.near, low, 1e9, 1e30, np.inf])
        last = grid.count.z - 1
        slices = query_cells(device, grid, make_queries(len(depths), z=depths))["slice"]
        total += int((slices != [0, 0, 0, 0, last, last, last]).sum())
        numbers[name] = slices.tolist()
    between = query_cells(device, SLICED_GRIDS["filament"], make_queries(4, z=[0.1, 1.0, 4.999, 5.001]))[
        "slice"
    ]
    numbers["0.1, 1, 4.999 and 5.001 m, where the second slice begins at 5"] = between.tolist()
    return CaseResult(total + int((between != [0, 0, 0, 1]).sum()), numbers)


def measure_tile_division(device: Device) -> CaseResult:
    """Look up the tiles of the first pixels of tiles of 41, for which float32 gives 41 · (1 / 41) < 1."""
    grid = make_grid(Perspective(), (1680, 1050), 41)
    count = 1680 // 41 + 1
    pixels = np.column_stack([41 * np.arange(count), np.zeros(count)])
    cells = query_cells(device, grid, make_queries(count, pixel=pixels))["cell"]
    wrong = int((cells != np.arange(count)).sum())
    rounded = np.floor(np.float32(41) * (np.float32(1) / np.float32(41)))
    return CaseResult(
        wrong, {"wrong tiles": wrong}, {"a product with the reciprocal is wrong": rounded == 0.0}
    )


def measure_slice_boundaries(device: Device) -> CaseResult:
    """Look up the slices at each boundary, an ulp before and behind it, and between them."""
    numbers: dict[str, int] = {}
    for name, grid in SLICED_GRIDS.items():
        count = grid.count.z
        exact = sl.evaluate(slice_start, grid, np.arange(count + 1), dtype=np.float64)
        guess = query_cells(device, grid, make_queries(count, z=0.5 * (exact[:-1] + exact[1:])))
        bounds = np.append(guess["ends"][:, 0], guess["ends"][-1, 1])  # as the device has them
        shifted = (np.nextafter(bounds, np.float32(-np.inf)), np.nextafter(bounds, np.float32(np.inf)))
        wrong = int((np.diff(bounds) <= 0).sum()) + int((guess["slice"] != np.arange(count)).sum())
        for depths, shift in ((bounds, 0), (shifted[0], -1), (shifted[1], 0)):
            slices = query_cells(device, grid, make_queries(count + 1, z=depths))["slice"]
            wrong += int((slices != np.clip(np.arange(count + 1) + shift, 0, count - 1)).sum())
        inside = np.random.default_rng(1).uniform(bounds[0], bounds[-1], 3000).astype(np.float32)
        inside = inside[(inside >= bounds[0]) & (inside < bounds[-1])]
        ends = query_cells(device, grid, make_queries(len(inside), z=inside))["ends"]
        numbers[name] = wrong + int((~((ends[:, 0] <= inside) & (inside < ends[:, 1]))).sum())
    return CaseResult(sum(numbers.values()), numbers)


def measure_cone_tests(device: Device) -> CaseResult:
    """Run the tests of cones of 0.1° to 180° on overlapping pairs of six projections."""
    dropped, holds = dict[str, int](), {}
    for projection in PROJECTIONS:
        pairs, left_out = make_cone_pairs(projection), dict[str, float]()
        for name, passed in run_cone_tests(device, pairs).items():
            dropped[f"{projection}, {name}"] = int((pairs.overlap & ~passed).sum())
            left_out[name] = float((~passed).mean())
        holds[f"{projection}: the tightest test leaves out a tenth"] = left_out["tight"] > 0.1
        holds[f"{projection}: some pairs overlap, and some don't"] = bool(0.3 < pairs.overlap.mean() < 0.9)
    return CaseResult(sum(dropped.values()), dropped, holds)


def measure_cells_on_cone_axis(device: Device) -> CaseResult:
    """Run the tests on a cell on the axes of cones, where the squared distance from the axis, as a difference
    of squares, may be negative; on NumPy, in float32 and float64."""
    cell = Cell(low=(-0.1, -0.1), low_slope=(0, 0), high=(0.1, 0.1), high_slope=(0, 0), near=9.9, far=10.1)
    dropped = dict.fromkeys(CONE_TESTS, 0)
    for name, test in CONE_TESTS.items():
        for dtype in (np.float32, np.float64):
            for z in (7.2, 8.123457, 9.7):
                cones = make_cones(ANGLES, (0.0, 0.0, z))
                dropped[name] += int((~sl.evaluate(test.function, cell, cones, 1e-5, dtype=dtype)).sum())
    return CaseResult(sum(dropped.values()), dropped)


def make_cones(angles: Floats, apex: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> NDArray[Any]:
    """Make cones of these angles that point along z and reach 3 m."""
    cones = np.zeros(len(angles), Cone.dtype)
    cones["apex"], cones["range"], cones["axis"], cones["cosine"] = apex, 3.0, (0, 0, 1), np.cos(angles)
    return cones


_OVERFULL_SIZE: Final = (333, 187)


def measure_overfull_lists(device: Device) -> CaseResult:
    """Fill lists with room for all pairs, for one less, and for one; check that the masks have the lights
    that lists have no room for, and that lists grow."""
    rng, lights = np.random.default_rng(1), Lights()
    camera = Camera.look_at(
        (0.0, 2.0, 0.0),
        (3.0, 1.0, -8.0),
        projection=Perspective(aspect=_OVERFULL_SIZE[0] / _OVERFULL_SIZE[1], far=60.0),
    )
    for offset in np.column_stack([rng.uniform(-20, 20, (60, 2)), rng.uniform(-60, 5, 60)]) @ camera.rotation:
        lights.add_point(camera.position + offset, float(rng.uniform(0.1, 6.0)))

    def collect(capacity: int) -> LightLists:
        grid = LightLists(device, capacity=capacity)
        grid.collect(device, camera, _OVERFULL_SIZE, lights)
        return grid

    whole = collect(100_000)
    every = whole.read()
    numbers: dict[str, object] = {"pairs": every.pairs}
    total = 0
    for capacity in (every.pairs, every.pairs - 1, 1):
        grid = collect(capacity)
        lists = grid.read()
        off = int((lists.full != (every.ends > capacity)).sum()) + int(
            not np.array_equal(lists.lights, every.lights)
        )
        for _ in range(4):  # a frame asks for the need of the one before, and the next learns it
            grid.collect(device, camera, _OVERFULL_SIZE, lights)
            device.finish()
        grown = grid.read()
        off += int(grown.full.sum()) + int(not np.array_equal(grown.lights, every.lights))
        numbers[f"full cells with room for {capacity}"] = int(lists.full.sum())
        total += off
        grid.destroy()
    whole.destroy()
    return CaseResult(total, numbers, {"there are pairs": every.pairs > 100})


def measure_off_axis_sides(device: Device) -> CaseResult:
    """Compute the sides of tiles of an off-axis eye, and compare them with the inverse of the projection."""
    size = (1366, 768)
    grid, projection = (
        make_test_grid("off-axis", size),
        PROJECTIONS["off-axis"].with_aspect(size[0] / size[1]),
    )
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 171, 10), np.arange(0, 96, 5)))
    tiles, z = np.column_stack([x, y]).astype(np.int32), np.full(len(x), 7.0)
    results = query_cells(device, grid, make_queries(len(x), pixel=8 * tiles, z=z))
    corners = cell_corners(projection, grid, tiles, z, z)
    exact = np.column_stack([corners[:, 0, :2], corners[:, 3, :2]])
    error = float((np.abs(results["sides"] - exact) / np.abs(exact).max()).max())
    straight = cell_corners(PROJECTIONS["perspective"].with_aspect(size[0] / size[1]), grid, tiles, z, z)
    return CaseResult(
        error,
        {"largest side, m": float(np.abs(exact).max())},
        {"an eye on the axis has other sides": bool(np.abs(straight - corners).max() > 1.0)},
    )


def measure_sphere_tests(device: Device) -> CaseResult:
    """Run all tests on random pairs of a cell and a sphere that nearly touch, of six projections."""
    wrong, holds = dict[str, int](), {}
    for projection in PROJECTIONS:
        pairs = make_pairs(projection, PAIRS)
        passed = run_sphere_tests(device, pairs.grid, pack_pairs(pairs))
        beyond = exceeds_padding(pairs)
        wrong[f"{projection}: dropped"] = sum(
            int((pairs.overlap & ~passes).sum()) for passes in passed.values()
        )
        wrong[f"{projection}: kept by exact tests"] = sum(
            int((passed[name] & beyond).sum()) for name in EXACT
        )
        holds[f"{projection}: some pairs are beyond what padding keeps"] = bool(beyond.mean() > 0.2)
    return CaseResult(sum(wrong.values()), wrong, holds)


def exceeds_padding(pairs: Pairs) -> NDArray[np.bool_]:
    """The pairs that are farther apart than the padding of radii, a mask."""
    lengths = np.abs(pairs.corners).max((1, 2)) * 3 + np.abs(pairs.centres).sum(1) + pairs.radii
    return np.asarray(pairs.distances > pairs.radii + 4e-6 * lengths)


MEASURES: Final[Measures] = {
    22: measure_sphere_beside_corner,
    23: measure_tangent_spheres,
    24: partial(measure_sphere_decisions, SPHERES[24]),
    25: partial(measure_sphere_decisions, SPHERES[25]),
    26: measure_flat_tiles,
    27: measure_depth_ranges,
    28: measure_pixel_cells,
    29: measure_orthographic_cells_at_eye,
    30: measure_outer_slices,
    31: measure_tile_division,
    32: measure_slice_boundaries,
    33: measure_cone_tests,
    34: measure_cells_on_cone_axis,
    35: measure_overfull_lists,
    36: measure_off_axis_sides,
    54: measure_sphere_tests,
}
