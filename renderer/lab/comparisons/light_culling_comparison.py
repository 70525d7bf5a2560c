"""Compares light culling tests: how exact their lists are, and what they cost (Thatcher 2014, tables 1 to 3).

- The scene is drawn once, so that tiles end at their surfaces. Then every test makes the lists of the same
  frame, in turn in one process.
- Kept pairs of a cell and a light are compared with those that overlap, found in float64 on the CPU: from
  positions in float64, and from the depths that the device has drawn. Of a spot light that is the sphere
  around its cone.
- A test of cones or a depth mask drops pairs of which only these spheres overlap. Then what is missed are
  *lit* pairs: those with a pixel of the cell whose surface the light reaches, found from the same depths.
- With the lists of each test the scene is drawn, too, as forward shading by cells does it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass
from functools import partial
from itertools import pairwise
from time import perf_counter
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Frame, FrameEffects, FramePass, Target
from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.lab.comparison import Record, Subject, compare, median_of, time
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.lights.culling.cells import ClusterGrid, block_cell, slice_start
from renderer.lights.culling.light_lists import LightListData, LightLists
from renderer.lights.culling.sphere_tests import overlaps_exactly, overlaps_planes
from renderer.lights.culling.volumes import LightVolumes, compute_light_volumes
from renderer.renderer import Renderer
from renderer.scene import Camera, Lights
from renderer.scene.arrays import Floats, list_ranges
from renderer.techniques.parts.depth import draw_depth
from renderer.techniques.parts.finish import camera_passes
from renderer.techniques.parts.light_list_reader import light_list_pass, lit_by_cells
from renderer.techniques.parts.variants import draw_lit
from rhi import Device, Texture
from rhi.errors import refuse
from rhi.math.indexing import repeat_each
from rhi.shading import evaluate

_LIGHT_BATCH = 16


@dataclass(frozen=True, slots=True)
class CullingTests:
    """The tests that fill light lists: the arguments of a `LightLists`.

    Attributes:
        cones: the cone test of spot lights whose spheres overlap a cell; "sphere" tests no cones.
        depth_mask: whether a mask of 32 depth slices is tested for each tile.
        pre_filter: whether blocks of 8 × 8 tiles are tested first.
    """

    test: str
    cones: str
    depth_mask: bool
    pre_filter: bool

    def make(self, device: Device, tile: int, slices: int) -> LightLists:
        """A grid of light lists with these tests, which counts them."""
        return LightLists(
            device,
            tile=tile,
            slices=slices,
            sphere_test=self.test,
            cone_test=self.cones,
            block_test="planes" if self.pre_filter else "none",
            depth_mask=self.depth_mask,
            counted=True,
        )


class LightListForward:
    """Forward shading with the light lists of a grid. Its last pass is timed, with the device idle before and
    after it.

    Attributes:
        seconds: the time of the last pass of the latest frame.
    """

    name: Final = "listed"
    seconds: float

    def __init__(self, kind: Callable[[Device], LightLists]) -> None:
        """`kind` makes the grid for a device."""
        self._kind = kind

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes that draw depth, fill the light lists, and draw the scene with them."""
        return (
            FramePass("depth", draw_depth, "lists end at surfaces", writes=(Target("depth", DEPTH_FORMAT),)),
            light_list_pass(effects, self._kind, depth="depth"),
            FramePass(
                "forward",
                self._draw,
                "is what is timed",
                reads=("depth", "light lists"),
                writes=(effects.image,),
            ),
            *camera_passes(effects, effects.image.name),
        )

    def _draw(self, frame: Frame) -> None:
        frame.device.finish()
        began = perf_counter()
        draw_lit(frame, lit_by_cells(self._kind), after_depth=True)
        frame.device.finish()
        self.seconds = perf_counter() - began


def choose_lights(lights: Lights, count: int) -> Lights:
    """Select `count` of the local lights, spread over the scene. A larger selection includes the smaller
    ones.

    Raises:
        ValidationError `measure-too-few-lights`: there aren't that many.
    """
    ends = np.cumsum([0, *(len(lights.of_kind(kind)) for kind in LOCAL_LIGHT_KINDS)]).tolist()
    total = ends[-1]
    if count > total:
        refuse(rules.TOO_FEW_LIGHTS, "choose_lights", f"{count:,} lights", f"at most {total:,}")
    numbers = np.sort(np.random.default_rng(0).permutation(total)[:count])
    selection = Lights()
    for kind, (begin, end) in zip(LOCAL_LIGHT_KINDS, pairwise(ends), strict=True):
        of_kind = numbers[(numbers >= begin) & (numbers < end)] - begin
        setattr(selection, kind.name, lights.of_kind(kind)[of_kind])
    return selection


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
    """Return a row for each number of lights and each combination of tests: sphere tests, cone tests, with
    and without the depth mask and the pre-filter. The lights of the renderer's scene are exchanged meanwhile.

    A row has the tests, as `CullingTests` names them, and the number of `lights`; `pairs` of a cell and a
    light that were kept, `over_exact`: these divided by the number of those that overlap, and `missed`: those
    that overlap and weren't kept, or with cones or a mask, lit ones; `tests_made` of lights against cells and
    blocks; `collect_ms`, the median time from the upload of the lights until the lists are finished, and
    `draw_ms` that of drawing the scene by them, where its depth was drawn before; and which `kernels` drew.

    Raises:
        ValidationError `measure-too-few-lights`: the scene has fewer lights. `measure-no-rendering`: the
            device draws nothing.
    """
    device = renderer.device
    if not device.capabilities.shading:
        refuse(rules.NO_RENDERING, "compare_light_culling", device.backend_name)
    sets = [choose_lights(renderer.scene.lights, count) for count in counts]
    camera = camera.with_aspect(renderer.size[0] / renderer.size[1])
    depth = renderer.render(camera).depth.read()
    makers = [
        CullingTests(test, cone_test, mask, is_on)
        for test in tests
        for cone_test in cones
        for mask in depth_masks
        for is_on in pre_filters
    ]
    grids = {maker: maker.make(device, tile, slices) for maker in makers}
    drawn = {maker: LightListForward(partial(maker.make, tile=tile, slices=slices)) for maker in makers}
    rows = []
    before = renderer.scene.lights, renderer.technique
    try:
        for lights in sets:
            renderer.scene.lights = replace_local_lights(before[0], lights)
            rows += _compare_tests(renderer, camera, lights, grids, drawn, depth, progress(range(rounds)))
    finally:
        renderer.scene.lights, renderer.technique = before
        for grid in grids.values():
            grid.destroy()
    return rows


def replace_local_lights(lights: Lights, local_lights: Lights) -> Lights:
    """Lights with the local lights of `local_lights`, and the others of `lights`."""
    result = copy(lights)
    for kind in LOCAL_LIGHT_KINDS:
        setattr(result, kind.name, local_lights.of_kind(kind))
    return result


def _compare_tests(
    renderer: Renderer,
    camera: Camera,
    lights: Lights,
    grids: Mapping[CullingTests, LightLists],
    drawn: Mapping[CullingTests, LightListForward],
    depth: NDArray[np.float32],
    rounds: Iterable[int],
) -> list[Record]:
    """Measure all tests with the lights that the renderer's scene has now."""
    device, size = renderer.device, renderer.size
    renderer.technique = next(iter(drawn.values()))
    texture = renderer.render(camera).depth
    overlap: NDArray[np.bool_] | None = None
    lit: NDArray[np.bool_] | None = None
    rows_by_tests: dict[CullingTests, Record] = {}
    for tests, grid in grids.items():
        lists = _collect_all(grid, camera, size, lights, texture)
        pairs = _as_pairs(lists, lights)
        if overlap is None:
            overlap = overlapping_cells(grid.layout, compute_light_volumes(lights, camera), depth)
        required_pairs = overlap
        if tests.depth_mask or tests.cones != "sphere":
            lit = lit_cells(grid.layout, camera, lights, depth) if lit is None else lit
            required_pairs = lit
        rows_by_tests[tests] = asdict(tests) | {
            "lights": lights.local_count,
            "pairs": lists.pairs,
            "over_exact": round(lists.pairs / max(int(np.count_nonzero(overlap)), 1), 4),
            "missed": int(np.count_nonzero(required_pairs & ~pairs)),
            "tests_made": lists.tests or 0,
        }

    def collect(grid: LightLists, _: int) -> None:
        grid.collect(device, camera, size, lights, texture)
        device.finish()

    def draw(_: int) -> None:
        renderer.render(camera)

    def exchange(technique: LightListForward) -> None:
        renderer.technique = technique

    def count(technique: LightListForward) -> Record:
        return {"draw_ms": technique.seconds}

    collecting = [Subject(rows_by_tests[tests], partial(collect, grid)) for tests, grid in grids.items()]
    drawing = [
        Subject({}, draw, partial(exchange, tests), partial(count, tests), device) for tests in drawn.values()
    ]
    numbers = list(rounds)
    collected = compare(collecting, {"collect_ms": time()}, numbers)
    timed_rows = compare(drawing, {"draw_ms": median_of(1e3)}, numbers, warm_ups=3)
    return [row | times for row, times in zip(collected, timed_rows, strict=True)]


def lit_cells(
    grid: ClusterGrid, camera: Camera, lights: Lights, depth: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Compute in float64 which cells (c, l) have a pixel whose surface a light reaches, point lights first:
    within the range and, for a spot light, within the cone."""
    z = _surface_distances(grid, depth)
    rows, columns = np.nonzero(np.isfinite(z))
    z = z[rows, columns]
    rays = compute_pixel_rays(camera, (depth.shape[1], depth.shape[0]))
    at = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    width = rays.projection.y - rays.projection.w * z
    across, along, start = (
        np.asarray(ray_array, np.float64) for ray_array in (rays.across, rays.along, rays.start)
    )
    positions = at @ across.T * width[:, None] + along * z[:, None] + start + camera.position
    layers = np.arange(grid.count.z + 1)[:, None]
    starts = evaluate(slice_start, grid, layers, dtype=np.float64).ravel()
    layer = np.clip(np.searchsorted(starts, z, side="right") - 1, 0, grid.count.z - 1)
    cell = (layer * grid.count.y + rows // grid.tile) * grid.count.x + columns // grid.tile
    is_lit = np.zeros((grid.count.x * grid.count.y * grid.count.z, lights.local_count), bool)
    every = [(kind, light) for kind in LOCAL_LIGHT_KINDS for light in lights.of_kind(kind)]
    for number, (kind, light) in enumerate(every):
        away = positions - light["position"]
        squared = np.einsum("ij,ij->i", away, away)
        reached = np.flatnonzero(squared < np.float64(light["range"]) ** 2 * (1.0 - 1e-6))
        if kind.cones is not None:
            along_axis = away[reached] @ light["direction"].astype(np.float64)
            reached = reached[
                along_axis > (1.0 - kind.cone_versine(light) + 1e-6) * np.sqrt(squared[reached])
            ]
        is_lit[cell[reached], number] = True
    return is_lit


def overlapping_cells(
    grid: ClusterGrid, volumes: LightVolumes, depth: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Compute in float64 which cells (c, l) the spheres of lights overlap, point lights first.

    Cells end at the surfaces of their tile, as `depth` (h, w) has them.
    """
    near, far = surface_ranges(grid, depth)
    layer = np.arange(grid.count.z)[:, None, None]
    near = np.maximum(near, evaluate(slice_start, grid, layer, dtype=np.float64)).ravel()
    far = np.minimum(far, evaluate(slice_start, grid, layer + 1, dtype=np.float64)).ravel()
    rows = np.flatnonzero(near <= far)
    cell = rows % (grid.count.x * grid.count.y)
    tiles = np.column_stack([cell % grid.count.x, cell // grid.count.x])
    cells = evaluate(block_cell, grid, tiles, 1, near[rows], far[rows], dtype=np.float64)[:, None]
    spheres = volumes.spheres[volumes.spheres[:, 3] >= 0.0]
    overlaps = np.zeros((len(near), len(spheres)), bool)
    for first in range(0, len(spheres), _LIGHT_BATCH):
        batch = spheres[None, first : first + _LIGHT_BATCH]
        row, light = np.nonzero(
            evaluate(overlaps_planes, cells, batch[..., :3], batch[..., 3], dtype=np.float64)
        )
        exact = evaluate(
            overlaps_exactly, cells[row, 0], batch[0, light, :3], batch[0, light, 3], dtype=np.float64
        )
        overlaps[rows[row[exact]], first + light[exact]] = True
    return overlaps


def surface_ranges(grid: ClusterGrid, depth: NDArray[np.float32]) -> tuple[Floats, Floats]:
    """The distances (rows, columns) of the nearest and the farthest surface of each tile; inf and -inf where
    there is none."""
    z = _surface_distances(grid, depth)
    down, across = (np.arange(0, length, grid.tile) for length in depth.shape)
    near, far = z, np.where(np.isfinite(z), z, -np.inf)
    near = np.minimum.reduceat(np.minimum.reduceat(near, down, 0), across, 1)
    return near, np.maximum.reduceat(np.maximum.reduceat(far, down, 0), across, 1)


def _surface_distances(grid: ClusterGrid, depth: NDArray[np.float32]) -> Floats:
    """The distance (h, w) of each pixel's surface along the view direction, inf where there is none."""
    below = grid.depth.z - grid.depth.w * depth.astype(np.float64)
    with np.errstate(divide="ignore"):
        z: Floats = (grid.depth.x - grid.depth.y * depth.astype(np.float64)) / below
    return np.where(depth != grid.background, z, np.inf)


def _collect_all(
    grid: LightLists, camera: Camera, size: tuple[int, int], lights: Lights, depth: Texture
) -> LightListData:
    """Fill the light lists of a frame, enlarging them until all lights fit."""
    while True:
        grid.collect(grid.device, camera, size, lights, depth)
        lists = grid.read()
        if not lists.full.any():
            return lists
        grid.capacity = lists.pairs


def _as_pairs(lists: LightListData, lights: Lights) -> NDArray[np.bool_]:
    """The pairs (c, l) of cell and light in light lists, point lights first."""
    pairs = np.zeros((len(lists.begins), lights.local_count), bool)
    cells, first = np.arange(len(lists.begins)), 0
    for number, kind in enumerate(LOCAL_LIGHT_KINDS):
        begins, sizes = lists.bounds[:, number], np.diff(lists.bounds)[:, number]
        pairs[repeat_each(cells, sizes), first + lists.lights[list_ranges(begins, sizes)]] = True
        first += len(lights.of_kind(kind))
    return pairs
