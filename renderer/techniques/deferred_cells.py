"""Deferred shading by the lights of tiles or clusters: no light volumes are drawn.

`tiled_deferred` (Andersson 2009; Lauritzen 2010) has one compute shader that does both: a work-group finds the depths
of its tile, tests the lights against them, and lights its pixels by those that it has kept. `clustered_deferred`
(Olsson, Billeter and Assarsson 2012) lists the lights of clusters and lights each pixel by its cluster's list, in the
same pass that makes the image.

Without point and spot lights in view, both are deferred shading.
"""

from __future__ import annotations

from collections.abc import Mapping
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
from renderer.techniques.parts.deferred_lighting import cluster_passes, resolve
from renderer.techniques.parts.geometry_buffer import (
    EXACT_NORMAL,
    NORMAL_BITS,
    GeometryReader,
    find_contents,
    geometry_pass,
    list_contents,
)
from renderer.techniques.parts.resolve import LIGHT_FORMAT, LitPixels, check_bits, resolve_pass
from renderer.techniques.parts.samples import GeometrySamples, bind_samples, frame_samples, list_samples
from renderer.techniques.parts.scene_shader import LampShader, ShadingShader
from renderer.techniques.parts.variants import bind, draw_full_screen, explain_lamps, find_variant, list_lamps
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
        cell = self.find_cell(lane, tile, depth, depth, has_surface)

        texel = sl.uvec4(0)
        row = sl.uvec4(0)
        if has_surface:
            texel = self.load_surface(pixel, 0)
            row = self.load_material(pixel, 0)
        position = self.find_place(texel, pixel)
        surface = self.read_surface(row, texel, pixel, 0, position)
        color = sl.vec3(0.0)
        for base in range(0, self.lights.words, _CHUNK):
            self.keep_lights(lane, base, cell)
            if has_surface:
                color += self.kept_light(surface, base)
            sl.barrier()
        if inside:
            self.lit.store(pixel, self.encode_light(color))

    def keep_lights(self, lane: int, base: int, cell: Cell) -> None:
        """Keep those of the lights from word `base` on that may reach a cell, as many as a tile holds at a time."""
        if lane < _CHUNK:
            self.kept[lane] = sl.uint(0)
        sl.barrier()
        if cell.near <= cell.far:
            for k in range(lane, WORD * sl.min(self.lights.words - base, _CHUNK), _GROUP):
                if self.reaches(WORD * base + k, cell):
                    sl.atomic_or(self.kept[k // WORD], sl.uint(1) << sl.uint(k % WORD))
        sl.barrier()

    def kept_light(self, surface: SurfacePoint, base: int) -> sl.vec3:
        """Return the light of those that are kept, from word `base` on."""
        color = sl.vec3(0.0)
        for w in range(sl.min(self.lights.words - base, _CHUNK)):
            bits = self.kept[w]
            while bits != sl.uint(0):
                light = WORD * (base + w) + sl.find_lsb(bits)
                bits = bits & (bits - sl.uint(1))
                color += self.light_of(surface, light)
        return color

    def encode_light(self, color: sl.vec3) -> sl.vec4:
        return sl.vec4(color, 0.0)

    def find_cell(self, lane: int, tile: sl.ivec2, low: float, high: float, has_surface: bool) -> Cell:
        """Return the tile's cell between its nearest and its farthest surface; it is empty without any. Those of a
        pixel lie between two depths, of which none is below 0."""
        if lane == 0:
            self.least = sl.uint(0x7F7FFFFF)  # the largest float: as long as no depth is below it, there is none
            self.greatest = sl.uint(0)
        sl.barrier()
        if has_surface:
            sl.atomic_min(self.least, sl.float_bits_to_uint(low))  # bits are ordered as the depths are
            sl.atomic_max(self.greatest, sl.float_bits_to_uint(high))
        sl.barrier()
        ends = self.find_ends(sl.uint_bits_to_float(self.least), sl.uint_bits_to_float(self.greatest))
        return block_cell(self.grid, tile, 1, ends.x, ends.y)

    def find_ends(self, low: float, high: float) -> sl.vec2:
        """Return the least and the greatest distance of the tile's surfaces, given their depths."""
        return range_of(self.grid, low, high)

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


class SampledTiles(GeometrySamples, TiledLighting, ShadingShader):
    """Shades the samples of each pixel, each surface once, and stores their mean colour."""

    def compute(self) -> None:
        pixel = self.find_pixel()
        inside = pixel.x < self.grid.size.x and pixel.y < self.grid.size.y
        near = self.rays.far
        far = 0.0
        colors = sl.array(sl.vec3, self.samples)
        if inside:
            for sample in range(self.samples):
                if self.is_covered(sample):
                    distance = self.find_distance(sample)
                    near = sl.min(near, distance)
                    far = sl.max(far, distance)
                    if self.is_new(sample):
                        row = int(self.load_material(pixel, sample).x)
                        colors[sample] = self.shade(self.find_surface(sample), self.materials[row])
        lane = sl.local_index()
        cell = self.find_cell(lane, sl.group_id().xy, near, far, near <= far)
        for base in range(0, self.lights.words, _CHUNK):
            self.keep_lights(lane, base, cell)
            if near <= far:
                for sample in range(self.samples):
                    if self.is_covered(sample) and self.is_new(sample):
                        colors[sample] += self.kept_light(self.find_surface(sample), base)
            sl.barrier()
        total = sl.vec4(0.0)
        color = sl.vec4(0.0)
        if inside:
            for sample in range(self.samples):
                if self.is_new(sample):
                    color = self.find_backdrop()
                    if self.is_covered(sample):
                        position = self.find_place(self.load_surface(pixel, sample), pixel)
                        color = self.finish(colors[sample], position)
                total += color
            self.lit.store(pixel, total / float(self.samples))

    def find_pixel(self) -> sl.ivec2:
        return sl.global_id().xy

    def find_distance(self, sample: int) -> float:
        """Return the distance along the view of a sample's surface."""
        return sl.max(sl.uint_bits_to_float(self.load_surface(self.find_pixel(), sample).x), 0.0)

    def find_surface(self, sample: int) -> SurfacePoint:
        """Return the surface of a sample."""
        pixel = self.find_pixel()
        texel = self.load_surface(pixel, sample)
        row = self.load_material(pixel, sample)
        return self.read_surface(row, texel, pixel, sample, self.find_place(texel, pixel))

    def find_ends(self, low: float, high: float) -> sl.vec2:
        return sl.vec2(low, high) if low <= high else sl.vec2(1.0, 0.0)  # surfaces store distances


_make_uploads: Final = partial(LightUploads, tile=TILE)
"""Makes the lights of a frame, for tiles as large as the work-groups of `TiledLighting`."""


class TiledDeferred:
    """Draws the scene to a geometry buffer, and lights it tile by tile in one compute pass."""

    name: Final = "tiled_deferred"

    def __init__(self, samples: int = 1, *, normal_bits: int = EXACT_NORMAL) -> None:
        """Choose the number of samples per pixel, as for `Forward`, and as for `Deferred` the bits of normals."""
        check_bits(normal_bits, NORMAL_BITS, "TiledDeferred(normal_bits=...)")
        self.samples, self.normal_bits = samples, normal_bits

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `tiles` and `resolve`, with several samples also `depth` before them; those of
        `ClusteredDeferred` without lights to test."""
        if not list_lamps(needs):
            return cluster_passes(needs, self.samples, self.normal_bits)
        samples, reads = self.samples, list_samples(self.samples, *list_contents(needs))
        geometry = geometry_pass(needs, samples=samples, normal_bits=self.normal_bits)
        name, shader = ("light", TiledLighting) if samples == 1 else ("lit", SampledTiles)
        run = partial(light_tiles, name=name, shader=shader, samples=samples)
        light = Pass("tiles", run, explain_lamps(needs), reads, (Target(name, LIGHT_FORMAT),))
        if samples == 1:
            add, because = partial(resolve, lights=(name,)), "lights surfaces by what reaches all of them"
            shown = resolve_pass(needs, add, because, (*reads, name))
        else:
            shown = resolve_pass(needs, _show, "shows what was shaded", (name,))
        return frame_samples(needs, geometry, light, shown, samples=samples)


class ClusteredDeferred:
    """Draws the scene to a geometry buffer, and lights it by the lists of clusters."""

    name: Final = "clustered_deferred"

    def __init__(self, samples: int = 1, *, normal_bits: int = EXACT_NORMAL) -> None:
        """Choose the number of samples per pixel, as for `Forward`, and as for `Deferred` the bits of normals."""
        check_bits(normal_bits, NORMAL_BITS, "ClusteredDeferred(normal_bits=...)")
        self.samples, self.normal_bits = samples, normal_bits

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `light lists` and `resolve`, with several samples also `depth` before them;
        those of `Deferred` without lights to list."""
        return cluster_passes(needs, self.samples, self.normal_bits)


def light_tiles(frame: Frame, *, name: str, shader: type[TiledLighting], **switches: int) -> None:
    """Add up the light of point and spot lights in the contents `name`, or shade the samples of all pixels, and store
    their means there."""
    own = bind_samples(frame) if shader is SampledTiles else {}
    dispatch_tiles(frame, frame.targets[name], shader, own=own, **switches)


def _show(frame: Frame) -> None:
    draw_full_screen(frame, LitPixels, frame.image)


def dispatch_tiles(frame: Frame, lit: Texture, *bases: type[Any], own: Mapping[str, Any] = {}, **switches: int) -> None:
    """Run the compute shader with these bases for all tiles, with bindings of its own and its switches."""
    uploads = frame.view.workspace(_make_uploads)
    uploads.write(frame.camera, frame.targets.size, frame.resources.lights)
    program: Any = frame.program(find_variant(frame, *bases, **find_contents(frame), **switches))
    cones = uploads.cones if Effect.SPOT_LIGHTS in frame.needs.effects else {}
    own = {**own, "lit": lit.image(0), **uploads.bindings, **cones}
    frame.device.dispatch(program, uploads.count[:2], **bind(frame, program, own))
