"""Comparison of the tests of light culling: what each keeps, and what it costs (Thatcher 2014, tables 1 to 3).

- The scene is drawn once, so that tiles end at their surfaces. Then every test makes the lists of the same frame, in
  turn in one process.
- Kept pairs of a cell and a light are compared with those that overlap, found in float64 on the CPU: from positions in
  float64, and from the depths that the device has drawn. Of a spot light that is the sphere around its cone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.lights.culling.cells import CellGrid, block_cell, slice_start
from renderer.lights.culling.grid import CellLists, LightGrid
from renderer.lights.culling.sphere_tests import overlaps_exactly, overlaps_planes
from renderer.lights.culling.volumes import LightVolumes, find_volumes
from renderer.measure.alternate import alternate
from renderer.renderer import Renderer
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats
from rhi import Texture
from rhi.errors import refuse
from rhi.shading import evaluate

_LIGHTS_AT_A_TIME = 16


@dataclass(frozen=True, slots=True)
class LightCullingRow:
    """The result of a test for a number of lights.

    Attributes:
        pre_filter: whether blocks of 8 × 8 tiles are tested first.
        pairs: number of pairs of a cell and a light that were kept.
        over_exact: `pairs` divided by the number of those that overlap.
        missed: number of pairs that overlap and weren't kept.
        tests_made: number of tests of lights against cells and blocks.
        collect_ms: median time from the upload of the lights until the lists are finished.
    """

    test: str
    pre_filter: bool
    lights: int
    pairs: int
    over_exact: float
    missed: int
    tests_made: int
    collect_ms: float


def choose_lights(lights: Lights, count: int) -> Lights:
    """Return `count` of the point and spot lights, spread over the scene. More of them include those of fewer.

    Raises:
        ValidationError `measure-few-lights`: there aren't that many.
    """
    points, total = len(lights.point), len(lights.point) + len(lights.spot)
    if count > total:
        refuse(rules.FEW_LIGHTS, "choose_lights", f"{count:,} lights", f"at most {total:,}")
    rows = np.random.default_rng(0).permutation(total)[:count]
    chosen = Lights()
    chosen.point = lights.point[np.sort(rows[rows < points])]
    chosen.spot = lights.spot[np.sort(rows[rows >= points]) - points]
    return chosen


def compare_light_culling(
    renderer: Renderer,
    camera: Camera,
    counts: Sequence[int],
    tests: Sequence[str],
    *,
    tile: int,
    slices: int = 1,
    pre_filters: Sequence[bool] = (True,),
    rounds: int = 5,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[LightCullingRow]:
    """Return a row for each number of lights and each test of spheres, with and without the pre-filter.

    Raises:
        ValidationError `measure-few-lights`: the scene has fewer lights. `measure-no-pictures`: the device draws
            nothing.
    """
    device = renderer.device
    if not device.capabilities.shading:
        refuse(rules.NO_PICTURES, "compare_light_culling", device.backend_name)
    sets = [choose_lights(renderer.scene.lights, count) for count in counts]
    camera = camera.with_aspect(renderer.size[0] / renderer.size[1])
    depth = renderer.render(camera).depth
    grids = {
        (test, is_on): LightGrid(
            device,
            tile=tile,
            slices=slices,
            sphere_test=test,
            cone_test="sphere",
            block_test="planes" if is_on else "none",
            depth_mask=False,
            counted=True,
        )
        for test in tests
        for is_on in pre_filters
    }
    rows = []
    for lights in sets:
        overlap: NDArray[np.bool_] | None = None
        found = {}
        for key, grid in grids.items():
            lists = _collect_all(grid, camera, renderer.size, lights, depth)
            if overlap is None:
                overlap = find_overlaps(grid.layout, find_volumes(lights, camera), depth.read())
            found[key] = lists.pairs, np.count_nonzero(overlap & ~_as_pairs(lists, lights)), lists.tests

        def collect(grid: LightGrid, lights: Lights = lights) -> None:
            grid.collect(device, camera, renderer.size, lights, depth)
            device.finish()

        work = {key: (lambda _, grid=grid: collect(grid)) for key, grid in grids.items()}
        times = alternate({str(key): run for key, run in work.items()}, progress(range(rounds)))
        overlapping = 1 if overlap is None else max(int(np.count_nonzero(overlap)), 1)
        for key, (pairs, missed, tests_made) in found.items():
            rows.append(
                LightCullingRow(
                    test=key[0],
                    pre_filter=key[1],
                    lights=len(lights.point) + len(lights.spot),
                    pairs=pairs,
                    over_exact=round(pairs / overlapping, 4),
                    missed=int(missed),
                    tests_made=tests_made or 0,
                    collect_ms=round(1e3 * times[str(key)].median, 3),
                )
            )
    for grid in grids.values():
        grid.destroy()
    return rows


def find_overlaps(grid: CellGrid, volumes: LightVolumes, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find in float64 which cells (c, l) the spheres of lights overlap, point lights first.

    Cells end at the surfaces of their tile, as `depth` (h, w) has them.
    """
    near, far = find_surfaces(grid, depth)
    layer = np.arange(grid.count.z)[:, None, None]
    near = np.maximum(near, evaluate(slice_start, grid, layer, dtype=np.float64)).ravel()
    far = np.minimum(far, evaluate(slice_start, grid, layer + 1, dtype=np.float64)).ravel()
    rows = np.flatnonzero(near <= far)
    cell = rows % (grid.count.x * grid.count.y)
    tiles = np.column_stack([cell % grid.count.x, cell // grid.count.x])
    cells = evaluate(block_cell, grid, tiles, 1, near[rows], far[rows], dtype=np.float64)[:, None]
    spheres = volumes.spheres[volumes.spheres[:, 3] >= 0.0]
    found = np.zeros((len(near), len(spheres)), bool)
    for first in range(0, len(spheres), _LIGHTS_AT_A_TIME):
        some = spheres[None, first : first + _LIGHTS_AT_A_TIME]
        row, light = np.nonzero(evaluate(overlaps_planes, cells, some[..., :3], some[..., 3], dtype=np.float64))
        exact = evaluate(
            overlaps_exactly, cells[row, 0], some[0, light, :3], some[0, light, 3], dtype=np.float64
        )
        found[rows[row[exact]], first + light[exact]] = True
    return found


def find_surfaces(grid: CellGrid, depth: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Return the distances (rows, columns) of the nearest and the farthest surface of each tile; where it has none,
    inf and -inf."""
    below = grid.depth.z - grid.depth.w * depth.astype(np.float64)
    with np.errstate(divide="ignore"):
        z = (grid.depth.x - grid.depth.y * depth.astype(np.float64)) / below
    is_drawn = depth != grid.background
    down, across = (np.arange(0, length, grid.tile) for length in depth.shape)
    near, far = np.where(is_drawn, z, np.inf), np.where(is_drawn, z, -np.inf)
    near = np.minimum.reduceat(np.minimum.reduceat(near, down, 0), across, 1)
    return near, np.maximum.reduceat(np.maximum.reduceat(far, down, 0), across, 1)


def _collect_all(
    grid: LightGrid, camera: Camera, size: tuple[int, int], lights: Lights, depth: Texture
) -> CellLists:
    """Return the lists of a frame, whole."""
    while True:
        grid.collect(grid.device, camera, size, lights, depth)
        lists = grid.read()
        if not lists.dropped:
            return lists
        grid.capacity = lists.pairs


def _as_pairs(lists: CellLists, lights: Lights) -> NDArray[np.bool_]:
    """Return which lights each cell lists (c, l), point lights first."""
    points = len(lights.point)
    found = np.zeros((len(lists.begins), points + len(lights.spot)), bool)
    cells = np.arange(len(lists.begins))
    for begins, ends, first in (
        (lists.begins, lists.points_ends, 0),
        (lists.points_ends, lists.ends, points),
    ):
        sizes = ends - begins
        places = np.arange(sizes.sum()) + np.repeat(begins - np.concatenate([[0], np.cumsum(sizes)[:-1]]), sizes)
        found[np.repeat(cells, sizes), first + lists.lights[places]] = True
    return found
