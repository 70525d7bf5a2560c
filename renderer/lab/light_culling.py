"""Comparison of the tests of light culling: what each keeps, and what it costs (Thatcher 2014, tables 1 to 3).

- The scene is drawn once, so that tiles end at their surfaces. Then every test makes the lists of the same frame, in
  turn in one process.
- Kept pairs of a cell and a light are compared with those that overlap, found in float64 on the CPU: from positions in
  float64, and from the depths that the device has drawn. Of a spot light that is the sphere around its cone.
- A test of cones or a depth mask drops pairs of which only these spheres overlap. Then what is missed are *lit* pairs:
  those with a pixel of the cell whose surface the light reaches, found from the same depths.
- With the lists of each test the scene is drawn, too, as forward shading by cells does it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass
from functools import partial
from time import perf_counter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target
from renderer.lab.comparison import Record, Subject, compare, middle, time
from renderer.lights.culling.cells import CellGrid, block_cell, slice_start
from renderer.lights.culling.grid import CellLists, LightGrid
from renderer.lights.culling.sphere_tests import overlaps_exactly, overlaps_planes
from renderer.lights.culling.volumes import LightVolumes, find_volumes
from renderer.renderer import Renderer
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats, list_ranges
from renderer.techniques.parts.cell_lists import by_cells, list_pass
from renderer.techniques.parts.depth import draw_depth
from renderer.techniques.parts.full_screen import find_rays
from renderer.techniques.parts.glow import glow_passes
from renderer.techniques.parts.variants import draw_lit
from rhi import Device, Texture
from rhi.errors import refuse
from rhi.shading import evaluate

_LIGHTS_AT_A_TIME = 16


@dataclass(frozen=True, slots=True)
class ListMaker:
    """The tests that make lists: the arguments of a `LightGrid`.

    Attributes:
        cones: the test of spot lights' cones, made where their spheres are kept; "sphere" makes none.
        depth_mask: whether 32 slices of a tile's depths are told apart.
        pre_filter: whether blocks of 8 × 8 tiles are tested first.
    """

    test: str
    cones: str
    depth_mask: bool
    pre_filter: bool

    def make(self, device: Device, tile: int, slices: int) -> LightGrid:
        """Return a grid with these tests, which counts them."""
        return LightGrid(
            device,
            tile=tile,
            slices=slices,
            sphere_test=self.test,
            cone_test=self.cones,
            block_test="planes" if self.pre_filter else "none",
            depth_mask=self.depth_mask,
            counted=True,
        )


class ListedForward:
    """Forward shading by the lists of a grid. Its last pass is timed: the device is finished before and after it.

    Attributes:
        seconds: the time of the last pass of the latest frame.
    """

    name: Final = "listed"
    seconds: float

    def __init__(self, kind: Callable[[Device], LightGrid]) -> None:
        """`kind` makes the grid for a device."""
        self._kind = kind

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return a pass that draws depth, one that makes the lists, and one that draws the scene by them."""
        return (
            Pass("depth", draw_depth, "lists end at surfaces", writes=(Target("depth", DEPTH_FORMAT),)),
            list_pass(needs, self._kind, depth="depth"),
            Pass(
                "forward",
                self._draw,
                "is what is timed",
                reads=("depth", "light lists"),
                writes=(needs.image,),
            ),
            *glow_passes(needs, needs.image.name),
        )

    def _draw(self, frame: Frame) -> None:
        frame.device.finish()
        began = perf_counter()
        draw_lit(frame, by_cells(self._kind), after_depth=True)
        frame.device.finish()
        self.seconds = perf_counter() - began


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
    cones: Sequence[str] = ("sphere",),
    depth_masks: Sequence[bool] = (False,),
    rounds: int = 5,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[Record]:
    """Return a row for each number of lights and each combination of tests: of spheres, of cones, with and without the
    depth mask and the pre-filter. The renderer's scene has other lights meanwhile.

    A row has the tests, as `ListMaker` names them, and the number of `lights`; `pairs` of a cell and a light that were
    kept, `over_exact`: these divided by the number of those that overlap, and `missed`: those that overlap and weren't
    kept, or with cones or a mask, lit ones; `tests_made` of lights against cells and blocks; `collect_ms`, the median
    time from the upload of the lights until the lists are finished, and `draw_ms` that of drawing the scene by them,
    where its depth was drawn before; and which `kernels` drew.

    Raises:
        ValidationError `measure-few-lights`: the scene has fewer lights. `measure-no-pictures`: the device draws
            nothing.
    """
    device = renderer.device
    if not device.capabilities.shading:
        refuse(rules.NO_PICTURES, "compare_light_culling", device.backend_name)
    sets = [choose_lights(renderer.scene.lights, count) for count in counts]
    camera = camera.with_aspect(renderer.size[0] / renderer.size[1])
    depth = renderer.render(camera).depth.read()
    makers = [
        ListMaker(test, cone_test, mask, is_on)
        for test in tests
        for cone_test in cones
        for mask in depth_masks
        for is_on in pre_filters
    ]
    grids = {one: one.make(device, tile, slices) for one in makers}
    drawn = {one: ListedForward(partial(one.make, tile=tile, slices=slices)) for one in makers}
    rows = []
    before = renderer.scene.lights, renderer.technique
    try:
        for lights in sets:
            renderer.scene.lights = replace_lamps(before[0], lights)
            rows += _compare_tests(renderer, camera, lights, grids, drawn, depth, progress(range(rounds)))
    finally:
        renderer.scene.lights, renderer.technique = before
        for grid in grids.values():
            grid.destroy()
    return rows


def replace_lamps(lights: Lights, lamps: Lights) -> Lights:
    """Return lights with the point and spot lights of `lamps`, and the others of `lights`."""
    made = copy(lights)
    made.point, made.spot = lamps.point, lamps.spot
    return made


def _compare_tests(
    renderer: Renderer,
    camera: Camera,
    lights: Lights,
    grids: Mapping[ListMaker, LightGrid],
    drawn: Mapping[ListMaker, ListedForward],
    depth: NDArray[np.float32],
    rounds: Iterable[int],
) -> list[Record]:
    """Return the rows of all tests for the lights that the renderer's scene has."""
    device, size = renderer.device, renderer.size
    renderer.technique = next(iter(drawn.values()))
    texture = renderer.render(camera).depth
    overlap: NDArray[np.bool_] | None = None
    lit: NDArray[np.bool_] | None = None
    found: dict[ListMaker, Record] = {}
    for one, grid in grids.items():
        lists = _collect_all(grid, camera, size, lights, texture)
        pairs = _as_pairs(lists, lights)
        if overlap is None:
            overlap = find_overlaps(grid.layout, find_volumes(lights, camera), depth)
        wanted = overlap
        if one.depth_mask or one.cones != "sphere":
            lit = find_lit(grid.layout, camera, lights, depth) if lit is None else lit
            wanted = lit
        found[one] = asdict(one) | {
            "lights": len(lights.point) + len(lights.spot),
            "pairs": lists.pairs,
            "over_exact": round(lists.pairs / max(int(np.count_nonzero(overlap)), 1), 4),
            "missed": int(np.count_nonzero(wanted & ~pairs)),
            "tests_made": lists.tests or 0,
        }

    def collect(grid: LightGrid, _: int) -> None:
        grid.collect(device, camera, size, lights, texture)
        device.finish()

    def draw(_: int) -> None:
        renderer.render(camera)

    def exchange(technique: ListedForward) -> None:
        renderer.technique = technique

    def count(technique: ListedForward) -> Record:
        return {"draw_ms": technique.seconds}

    collecting = [Subject(found[one], partial(collect, grid)) for one, grid in grids.items()]
    drawing = [Subject({}, draw, partial(exchange, one), partial(count, one), device) for one in drawn.values()]
    numbers = list(rounds)
    collected = compare(collecting, {"collect_ms": time()}, numbers)
    shown = compare(drawing, {"draw_ms": middle(1e3)}, numbers, warm_ups=3)
    return [one | other for one, other in zip(collected, shown, strict=True)]


def find_lit(grid: CellGrid, camera: Camera, lights: Lights, depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Find in float64 which cells (c, l) have a pixel whose surface a light reaches, point lights first: it is within
    the range and, of a spot light, within the cone."""
    z = _find_distances(grid, depth)
    rows, columns = np.nonzero(np.isfinite(z))
    z = z[rows, columns]
    rays = find_rays(camera, (depth.shape[1], depth.shape[0]))
    at = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    width = rays.lens.y - rays.lens.w * z
    across, along, start = (np.asarray(one, np.float64) for one in (rays.across, rays.along, rays.start))
    places = at @ across.T * width[:, None] + along * z[:, None] + start + camera.position
    layers = np.arange(grid.count.z + 1)[:, None]
    starts = evaluate(slice_start, grid, layers, dtype=np.float64).ravel()
    layer = np.clip(np.searchsorted(starts, z, side="right") - 1, 0, grid.count.z - 1)
    cell = (layer * grid.count.y + rows // grid.tile) * grid.count.x + columns // grid.tile
    found = np.zeros((grid.count.x * grid.count.y * grid.count.z, len(lights.point) + len(lights.spot)), bool)
    for number, light in enumerate([*lights.point, *lights.spot]):
        away = places - light["position"]
        squared = np.einsum("ij,ij->i", away, away)
        reached = np.flatnonzero(squared < np.float64(light["range"]) ** 2 * (1.0 - 1e-6))
        if number >= len(lights.point):
            along_axis = away[reached] @ light["direction"].astype(np.float64)
            reached = reached[along_axis > (np.cos(light["outer"]) + 1e-6) * np.sqrt(squared[reached])]
        found[cell[reached], number] = True
    return found


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
        exact = evaluate(overlaps_exactly, cells[row, 0], some[0, light, :3], some[0, light, 3], dtype=np.float64)
        found[rows[row[exact]], first + light[exact]] = True
    return found


def find_surfaces(grid: CellGrid, depth: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """Return the distances (rows, columns) of the nearest and the farthest surface of each tile; where it has none,
    inf and -inf."""
    z = _find_distances(grid, depth)
    down, across = (np.arange(0, length, grid.tile) for length in depth.shape)
    near, far = z, np.where(np.isfinite(z), z, -np.inf)
    near = np.minimum.reduceat(np.minimum.reduceat(near, down, 0), across, 1)
    return near, np.maximum.reduceat(np.maximum.reduceat(far, down, 0), across, 1)


def _find_distances(grid: CellGrid, depth: NDArray[np.float32]) -> Floats:
    """Return the distance (h, w) of each pixel's surface along the view, inf where there is none."""
    below = grid.depth.z - grid.depth.w * depth.astype(np.float64)
    with np.errstate(divide="ignore"):
        z: Floats = (grid.depth.x - grid.depth.y * depth.astype(np.float64)) / below
    return np.where(depth != grid.background, z, np.inf)


def _collect_all(grid: LightGrid, camera: Camera, size: tuple[int, int], lights: Lights, depth: Texture) -> CellLists:
    """Return the lists of a frame, and leave room for all of them."""
    while True:
        grid.collect(grid.device, camera, size, lights, depth)
        lists = grid.read()
        if not lists.full.any():
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
        found[np.repeat(cells, sizes), first + lists.lights[list_ranges(begins, sizes)]] = True
    return found
