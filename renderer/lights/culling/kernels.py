"""The compute shaders that list the lights of each cell.

1. Where there is a depth texture, `ReduceTileDepths` computes each tile's nearest and farthest surface, and
   `ReduceTileMasks` adds a mask of the depths between them that have a surface (Harada, McKee and Yang 2013:
   2.5D culling).
2. `CollectLights`: a work-group has a block of 8 × 8 tiles of one slice. First, as a pre-filter, it tests
   each light against the whole block, then each tile against the lights that the block has kept. The result
   is a bit for each cell and light.
3. `PrefixSum` turns the number of lights of each cell into the index where its list begins.
4. `WriteLists` writes the bits as lists.

A bit has the same position whichever invocation sets it, so lists are in ascending order, the same in every
run and on every device. All lanes of a work-group read the same light at the same time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import rhi.shading as sl
from renderer.light_kinds.bounds import KIND_COUNT, WORD_FIELDS, index_in_kind
from renderer.light_kinds.generation import define
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling.cells import (
    Cell,
    ClusterGrid,
    block_cell,
    depth_bits,
    distance_range,
    padded_radius,
    rounded_distance_range,
    slice_start,
)
from renderer.lights.culling.sphere_tests import overlaps_always
from renderer.lights.culling.table import ConeTest, SphereTest
from renderer.lights.culling.volumes import WORD
from rhi.errors.shared_caches import cache_once

BLOCK: Final = 8
"""The side of a block in tiles."""
GROUP: Final = BLOCK * BLOCK
_CHUNK: Final = 64
"""Number of words of lights that a block holds at a time."""


class LightMaskWords(sl.Struct):
    """The number of words with a bit for each light."""

    words: int


class LightMaskSize(LightMaskWords):
    """The number of words with a bit for each light, and the end of the words of each kind of light but the
    last (`WORD_FIELDS`)."""

    if TYPE_CHECKING:
        first_cone_word: int
    __annotations__ = dict.fromkeys(WORD_FIELDS, int)


class TileDepths(sl.Struct):
    """The depths of a tile's nearest and farthest surface, and a bit for each of 32 slices between them that
    has one."""

    near: float
    far: float
    mask: sl.uint


class ReduceTileDepths(sl.Shader):
    """Computes the depths of each tile, one invocation for each tile, so that none waits. With a work-group
    for each tile of 8 × 8 pixels, PoCL takes 6 times the processor time and llvmpipe 11 times."""

    work_group = (BLOCK, BLOCK)
    grid: sl.Uniform[ClusterGrid]
    depth: sl.Texture2D
    depths: sl.StorageRW[TileDepths]
    is_from_near = False
    """Whether tiles begin at the near plane, and end at their farthest pixel."""

    def compute(self) -> None:
        tile = sl.global_id().xy
        if tile.x >= self.grid.count.x or tile.y >= self.grid.count.y:
            return
        first = tile * self.grid.tile
        end = sl.min(first + self.grid.tile, self.grid.size)
        least = 2.0
        greatest = -1.0
        for y in range(first.y, end.y):
            for x in range(first.x, end.x):
                depth = self.depth.load(sl.ivec2(x, y)).r
                if self.is_from_near or depth != self.grid.background:
                    least = sl.min(least, depth)
                    greatest = sl.max(greatest, depth)
        ends = distance_range(self.grid, least, greatest)
        if self.is_from_near:
            ends.x = self.grid.near
        mask = self.depth_mask_of(first, end, ends.x, ends.y)
        self.depths[tile.y * self.grid.count.x + tile.x] = TileDepths(near=ends.x, far=ends.y, mask=mask)

    def depth_mask_of(self, first: sl.ivec2, end: sl.ivec2, near: float, far: float) -> sl.uint:
        return sl.uint(0xFFFFFFFF)


class ReduceTileMasks(ReduceTileDepths):
    """Computes the depths of each tile, and the mask of the slices between them that have a surface."""

    def depth_mask_of(self, first: sl.ivec2, end: sl.ivec2, near: float, far: float) -> sl.uint:
        mask = sl.uint(0)
        for y in range(first.y, end.y):
            for x in range(first.x, end.x):
                depth = self.depth.load(sl.ivec2(x, y)).r
                if depth != self.grid.background:
                    between = rounded_distance_range(self.grid, depth)
                    mask = mask | depth_bits(near, far, between.x, between.y)
        return mask


class ReduceTileEnds(ReduceTileDepths):
    """Computes where each tile ends behind the near plane: at its farthest pixel. Pixels without a surface have the
    farthest depth of all."""

    is_from_near = True


class CollectLights(sl.Shader):
    """Marks and counts the lights of each cell. Subclasses add tests of cones, depths and masks;
    `collect_variant` combines them."""

    work_group = (BLOCK, BLOCK)
    grid: sl.Uniform[ClusterGrid]
    lights: sl.Uniform[LightMaskSize]
    spheres: sl.Storage[sl.vec4]
    masks: sl.StorageRW[sl.uint]
    counts: sl.StorageRW[sl.uint]
    visible_bits = sl.shared(sl.uint, _CHUNK)
    tests_blocks = True

    def compute(self) -> None:
        lane = sl.local_index()
        block = sl.group_id()
        first = block.xy * BLOCK
        tile = sl.global_id().xy
        slice_near = slice_start(self.grid, block.z)
        slice_far = slice_start(self.grid, block.z + 1)
        inside = tile.x < self.grid.count.x and tile.y < self.grid.count.y
        depths = TileDepths(near=1.0, far=0.0, mask=sl.uint(0))
        if inside:
            depths = self.tile_depths(tile.y * self.grid.count.x + tile.x)
        near = sl.max(slice_near, depths.near)
        far = sl.min(slice_far, depths.far)
        cell = block_cell(self.grid, tile, 1, near, far)
        has_surface = inside and near <= far

        ends = self.block_depths(lane, near, far, slice_near, slice_far)
        whole = block_cell(self.grid, first, BLOCK, ends.x, ends.y)
        words = self.lights.words
        index = (block.z * self.grid.count.y + tile.y) * self.grid.count.x + tile.x
        count = 0
        tests = 0
        for base in range(0, words, _CHUNK):
            self.visible_bits[lane] = sl.uint(0)
            sl.barrier()
            for k in range(lane, WORD * sl.min(words - base, _CHUNK), GROUP):
                sphere = self.spheres[WORD * base + k]
                if sphere.w >= 0.0 and ends.x <= ends.y:
                    if self.tests_blocks:
                        tests += 1
                    if self.overlaps_sphere(whole, sphere):
                        sl.atomic_or(self.visible_bits[k // WORD], sl.uint(1) << sl.uint(k % WORD))
            sl.barrier()
            for w in range(sl.min(words - base, _CHUNK)):
                bits = self.visible_bits[w]
                light_bits = sl.uint(0)
                if has_surface:
                    while bits != sl.uint(0):
                        bit = sl.find_lsb(bits)
                        bits = bits & (bits - sl.uint(1))
                        tests += 1
                        if self.reaches_cell(WORD * (base + w) + bit, cell, depths):
                            light_bits = light_bits | (sl.uint(1) << sl.uint(bit))
                if inside:
                    self.masks[index * words + base + w] = light_bits
                    count += sl.bit_count(light_bits)
            sl.barrier()
        if inside:
            self.counts[index] = sl.uint(count)
        if index == 0:
            self.counts[self.grid.count.x * self.grid.count.y * self.grid.count.z] = sl.uint(0)
        self.note_tests(tests, lane)

    def tile_depths(self, tile: int) -> TileDepths:
        return TileDepths(near=self.grid.near, far=self.grid.far, mask=sl.uint(0xFFFFFFFF))

    def block_depths(
        self, lane: int, near: float, far: float, slice_near: float, slice_far: float
    ) -> sl.vec2:
        return sl.vec2(slice_near, slice_far)

    def overlaps_sphere(self, block: Cell, sphere: sl.vec4) -> bool:
        return self.overlaps_block(block, sphere.xyz, padded_radius(block, sphere.xyz, sphere.w))

    def reaches_cell(self, light: int, cell: Cell, depths: TileDepths) -> bool:
        if not self.reaches(cell, self.spheres[light], depths):
            return False
        return self.reaches_in_cone(light - WORD * self.lights.first_cone_word, cell)

    def reaches(self, cell: Cell, sphere: sl.vec4, depths: TileDepths) -> bool:
        return self.overlaps(cell, sphere.xyz, padded_radius(cell, sphere.xyz, sphere.w))

    def reaches_in_cone(self, cone_index: int, cell: Cell) -> bool:
        return True

    def note_tests(self, tests: int, lane: int) -> None:
        return

    @staticmethod
    def overlaps_block(cell: Cell, centre: sl.vec3, radius: float) -> bool:
        return True

    @staticmethod
    def overlaps(cell: Cell, centre: sl.vec3, radius: float) -> bool:
        return True


class CollectCones(CollectLights):
    """Tests the cones of lights whose spheres reach a cell."""

    cones: sl.Storage[Cone]

    def reaches_in_cone(self, cone_index: int, cell: Cell) -> bool:
        return cone_index < 0 or self.lights_cone(cell, self.cones[cone_index])

    def lights_cone(self, cell: Cell, cone: Cone) -> bool:
        return self.overlaps_cone(cell, cone, padded_radius(cell, cone.apex, cone.range) - cone.range)

    @staticmethod
    def overlaps_cone(cell: Cell, cone: Cone, padding: float) -> bool:
        return True


class CollectByDepth(CollectLights):
    """Tests only the part of a cell between the nearest and the farthest surface of its tile."""

    depths: sl.Storage[TileDepths]
    nears = sl.shared(float, GROUP)
    fars = sl.shared(float, GROUP)

    def tile_depths(self, tile: int) -> TileDepths:
        return self.depths[tile]

    def block_depths(
        self, lane: int, near: float, far: float, slice_near: float, slice_far: float
    ) -> sl.vec2:
        self.nears[lane] = near if near <= far else slice_far
        self.fars[lane] = far if near <= far else slice_near
        sl.barrier()
        least = slice_far
        greatest = slice_near
        for other in range(GROUP):
            least = sl.min(least, self.nears[other])
            greatest = sl.max(greatest, self.fars[other])
        return sl.vec2(least, greatest)


class CollectByMask(CollectByDepth):
    """Drops lights between whose depths the tile has no surface, by its mask."""

    def reaches(self, cell: Cell, sphere: sl.vec4, depths: TileDepths) -> bool:
        radius = padded_radius(cell, sphere.xyz, sphere.w)
        bits = depth_bits(depths.near, depths.far, sphere.z - radius, sphere.z + radius)
        if (bits & depths.mask) == sl.uint(0):
            return False
        return self.overlaps(cell, sphere.xyz, radius)


class CollectCounted(CollectLights):
    """Counts the tests that each cell makes."""

    tests: sl.StorageRW[sl.uint]

    def note_tests(self, tests: int, lane: int) -> None:
        sl.atomic_add(self.tests[0], sl.uint(tests))


class ListWriter(sl.Shader):
    """The base of `WriteLists`."""

    work_group = (GROUP,)
    lights: sl.Uniform[LightMaskSize]
    masks: sl.Storage[sl.uint]
    sums: sl.Storage[sl.uint]
    lists: sl.StorageRW[int]


WriteLists: Final[type[sl.Shader]] = define(
    f"""
class WriteLists(ListWriter):
    def compute(self) -> None:
        cell = sl.global_id().x
        cells = len(self.sums) - 1
        if cell > cells:
            return
        header = {KIND_COUNT} * cells + 1
        end = len(self.lists)
        entry = header + int(self.sums[cell])
        self.lists[{KIND_COUNT} * cell] = entry
        if cell == cells:
            return
{"".join(f"        {name} = entry" + chr(10) for name in WORD_FIELDS)}
        for word in range(self.lights.words):
            bits = self.masks[cell * self.lights.words + word]
            first = WORD * {index_in_kind("word", [f"self.lights.{name}" for name in WORD_FIELDS])}
            while bits != sl.uint(0):
                if entry < end:
                    self.lists[entry] = first + sl.find_lsb(bits)
                bits = bits & (bits - sl.uint(1))
                entry += 1
"""
    + "".join(
        f"""
            if word < self.lights.{name}:
                {name} = entry
"""
        for name in WORD_FIELDS
    )
    + "".join(
        f"        self.lists[{KIND_COUNT} * cell + {number}] = {name}\n"
        for number, name in enumerate(WORD_FIELDS, 1)
    ),
    "WriteLists",
    __name__,
    ListWriter=ListWriter,
    WORD=WORD,
    sl=sl,
)
"""Writes the lists of lights: for each cell its begin and the end of the lights of each kind, then the end of
all, then the lists. A light behind the buffer's end isn't written; the bounds of a list that ends there say
so."""


@cache_once
def collect_variant(
    sphere_test: SphereTest,
    cone_test: ConeTest,
    block_test: SphereTest,
    features: tuple[type[CollectLights], ...],
) -> type[CollectLights]:
    """Return the `CollectLights` shader that combines these tests of cells and blocks and these feature
    classes."""
    methods: dict[str, Any] = {
        "overlaps": staticmethod(sphere_test.function.python),
        "overlaps_cone": staticmethod(cone_test.function.python),
        "overlaps_block": staticmethod(block_test.function.python),
        "tests_blocks": block_test.function is not overlaps_always,
    }
    bases = (*features, CollectLights)
    return type("Collect", bases, methods | {"__module__": __name__})
