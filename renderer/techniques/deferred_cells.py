"""Deferred shading by the lights of tiles or clusters: no light volumes are drawn.

`tiled_deferred` (Andersson 2009; Lauritzen 2010) has one compute shader that does both: a work-group finds the depths
of its tile, tests the lights against them, and lights its pixels by those that it has kept. `clustered_deferred`
(Olsson, Billeter and Assarsson 2012) lists the lights of clusters and lights each pixel by its cluster's list, in the
same pass that makes the image.

Without point and spot lights in view, both are deferred shading.
"""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import rhi.shading as sl
from renderer.frame import Effect, Frame, Needs, Pass, Target
from renderer.lights.culling.cells import Cell, CellGrid, block_cell, padded_radius, range_of
from renderer.lights.culling.cone_tests import Cone, cone_overlaps_tightly
from renderer.lights.culling.kernels import LightCounts
from renderer.lights.culling.sphere_tests import overlaps_hybrid
from renderer.lights.culling.uploads import LightUploads
from renderer.lights.culling.volumes import WORD
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.deferred_lighting import cluster_passes, resolve, volume_passes
from renderer.techniques.parts.finish import finish_image
from renderer.techniques.parts.geometry_buffer import (
    GeometryReader,
    find_contents,
    geometry_pass,
    list_contents,
)
from renderer.techniques.parts.resolve import LIGHT_FORMAT, resolve_pass
from renderer.techniques.parts.scene_shader import LampShader
from renderer.techniques.parts.variants import FORWARD, bind, explain_lamps, find_variant, list_lamps
from rhi import Texture

TILE: Final = 16
"""The side of a tile in pixels: a work-group has a pixel for each of its threads."""
_GROUP: Final = TILE * TILE
_CHUNK: Final = 64
"""Number of words of lights that a tile holds at a time."""


class TiledLighting(GeometryReader, LampShader):
    """Adds up the light of each pixel. A work-group has one tile."""

    # As in other passes: highlights end up in 8 bits.
    precision = sl.Precision.FAST
    work_group = (TILE, TILE)

    grid: sl.Uniform[CellGrid]
    lights: sl.Uniform[LightCounts]
    spheres: sl.Storage[sl.vec4]
    cones: sl.Storage[Cone]
    depth: sl.Texture2D
    lit: sl.Image2D = sl.image(LIGHT_FORMAT)
    least = sl.shared(sl.uint)
    greatest = sl.shared(sl.uint)
    kept = sl.shared(sl.uint, _CHUNK)

    def compute(self) -> None:
        lane = sl.local_index()
        tile = sl.group_id().xy
        pixel = sl.global_id().xy
        inside = pixel.x < self.grid.size.x and pixel.y < self.grid.size.y
        depth = self.grid.background
        if inside:
            depth = self.depth.load(pixel).r
        has_surface = depth != self.grid.background
        cell = self.find_cell(lane, tile, depth, has_surface)

        texel = sl.uvec4(0)
        row = sl.uvec4(0)
        if has_surface:
            texel = self.surface.load(pixel)
            row = self.material.load(pixel)
        position = self.find_place(texel, pixel)
        surface = self.read_surface(row, texel, pixel, position)
        color = sl.vec3(0.0)
        words = self.lights.words
        for base in range(0, words, _CHUNK):
            if lane < _CHUNK:
                self.kept[lane] = sl.uint(0)
            sl.barrier()
            if cell.near <= cell.far:
                for k in range(lane, WORD * sl.min(words - base, _CHUNK), _GROUP):
                    if self.reaches(WORD * base + k, cell):
                        sl.atomic_or(self.kept[k // WORD], sl.uint(1) << sl.uint(k % WORD))
            sl.barrier()
            if has_surface:
                for w in range(sl.min(words - base, _CHUNK)):
                    bits = self.kept[w]
                    while bits != sl.uint(0):
                        light = WORD * (base + w) + sl.find_lsb(bits)
                        bits = bits & (bits - sl.uint(1))
                        color += self.light_of(surface, light)
            sl.barrier()
        if inside:
            self.lit.store(pixel, self.encode_light(color))

    def encode_light(self, color: sl.vec3) -> sl.vec4:
        return sl.vec4(color, 0.0)

    def find_cell(self, lane: int, tile: sl.ivec2, depth: float, has_surface: bool) -> Cell:
        """Return the tile's cell between its nearest and its farthest surface; it is empty without any."""
        if lane == 0:
            self.least = sl.uint(0x7F7FFFFF)  # the largest float: as long as no depth is below it, there is none
            self.greatest = sl.uint(0)
        sl.barrier()
        if has_surface:
            bits = sl.float_bits_to_uint(depth)  # ordered as the depths are, none of which is below 0
            sl.atomic_min(self.least, bits)
            sl.atomic_max(self.greatest, bits)
        sl.barrier()
        ends = range_of(self.grid, sl.uint_bits_to_float(self.least), sl.uint_bits_to_float(self.greatest))
        return block_cell(self.grid, tile, 1, ends.x, ends.y)

    def reaches(self, light: int, cell: Cell) -> bool:
        """Return whether a light may reach a cell that isn't empty."""
        sphere = self.spheres[light]
        if sphere.w < 0.0:
            return False
        if not overlaps_hybrid(cell, sphere.xyz, padded_radius(cell, sphere.xyz, sphere.w)):
            return False
        return self.reaches_in_cone(light - WORD * self.lights.point_words, cell)

    def reaches_in_cone(self, spot: int, cell: Cell) -> bool:
        if not self.has_spot_lights:
            return True
        if spot < 0:
            return True
        cone = self.cones[spot]
        return cone_overlaps_tightly(cell, cone, padded_radius(cell, cone.apex, cone.range) - cone.range)

    def light_of(self, surface: SurfacePoint, light: int) -> sl.vec3:
        spot = light - WORD * self.lights.point_words
        if self.has_point_lights and spot < 0:
            return self.pointlight(surface, light)
        if self.has_spot_lights and spot >= 0:
            return self.spotlight(surface, spot)
        return sl.vec3(0.0)


_make_uploads: Final = partial(LightUploads, tile=TILE)
"""Makes the lights of a frame, for tiles as large as the work-groups of `TiledLighting`."""


class TiledDeferred:
    """Draws the scene to a geometry buffer, and lights it tile by tile in one compute pass."""

    name: Final = "tiled_deferred"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `tiles` and `resolve`; those of `Deferred` without lights to test."""
        if not list_lamps(needs):
            return volume_passes(needs)
        reads = list_contents(needs)
        return (
            geometry_pass(needs),
            Pass("tiles", light_tiles, explain_lamps(needs), reads=reads, writes=(Target("light", LIGHT_FORMAT),)),
            resolve_pass(
                needs,
                partial(resolve, lights=("light",)),
                "lights surfaces by what reaches all of them",
                (*reads, "light"),
            ),
            *finish_image(needs, FORWARD),
        )


class ClusteredDeferred:
    """Draws the scene to a geometry buffer, and lights it by the lists of clusters."""

    name: Final = "clustered_deferred"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `light lists` and `resolve`; those of `Deferred` without lights to list."""
        return cluster_passes(needs)


def light_tiles(frame: Frame) -> None:
    """Add up the light of point and spot lights in `light`."""
    dispatch_tiles(frame, frame.targets["light"], TiledLighting)


def dispatch_tiles(frame: Frame, lit: Texture, *bases: type[Any]) -> None:
    """Run the compute shader with these bases for all tiles."""
    uploads = frame.view.workspace(_make_uploads)
    uploads.write(frame.camera, frame.targets.size, frame.resources.scene.lights)
    count = uploads.layout.count
    program: Any = frame.program(find_variant(frame, *bases, **find_contents(frame.needs)))
    cones = uploads.cones if Effect.SPOT_LIGHTS in frame.needs.effects else {}
    own = {"lit": lit.image(0), **uploads.bindings, **cones}
    frame.device.dispatch(program, (count.x, count.y), **bind(frame, program, own))
