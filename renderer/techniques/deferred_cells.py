"""Deferred shading by the lights of tiles or clusters: no light volumes are drawn.

`tiled_deferred` (Andersson 2009; Lauritzen 2010) has one compute shader that does both: a work-group finds the depths
of its tile, tests the lights against them, and lights its pixels by those that it has kept. `clustered_deferred`
(Olsson, Billeter and Assarsson 2012) lists the lights of clusters and lights each pixel by its cluster's list, in the
same pass that makes the image.

Without point and spot lights in view, both are deferred shading.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Final

from renderer.frame import Effect, Frame, Needs, Pass, Target
from renderer.lights.culling.cells import Cell, CellGrid, block_cell, padded_radius, range_of
from renderer.lights.culling.cone_tests import Cone, cone_overlaps_tightly
from renderer.lights.culling.kernels import LightCounts
from renderer.lights.culling.sphere_tests import overlaps_hybrid
from renderer.lights.culling.uploads import LightUploads
from renderer.lights.culling.volumes import WORD
from renderer.shaders.lighting import is_near, point_incidence, spot_incidence
from renderer.shaders.structs import PointLight, SpotLight, SurfacePoint
from renderer.shadows import SHADOW_PARTS, ShadowReceiver
from renderer.techniques.cell_lists import CLUSTERS, CellReader, bind_lists, list_pass
from renderer.techniques.deferred import Deferred, GeometryResolve, resolve, resolve_geometry
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import bind_lamps, bind_shading, explain_lamps, find_forward, list_lamps
from renderer.techniques.forward_plus import find_listed
from renderer.techniques.forward_shader import LampShader
from renderer.techniques.geometry_buffer import (
    GeometryReader,
    bind_geometry,
    geometry_pass,
    list_contents,
    list_readers,
)
from renderer.techniques.resolve import LIGHT_FORMAT, resolve_pass
from rhi import Device, Texture
from rhi.shading import (
    Image2D,
    Precision,
    Shader,
    Storage,
    Texture2D,
    Uniform,
    atomic_max,
    atomic_min,
    atomic_or,
    barrier,
    find_lsb,
    float_bits_to_uint,
    global_id,
    group_id,
    image,
    ivec2,
    local_index,
    min,
    shared,
    uint,
    uint_bits_to_float,
    uvec4,
    vec3,
    vec4,
)

__rhi_internal__ = True

TILE: Final = 16
"""The side of a tile in pixels: a work-group has a pixel for each of its threads."""
_GROUP: Final = TILE * TILE
_CHUNK: Final = 64
"""Number of words of lights that a tile holds at a time."""


class LitByLists(CellReader, LampShader, GeometryResolve):
    """Makes the image from the geometry buffer, lit by the lights of clusters."""

    def local_light(self, surface: SurfacePoint, pixel: ivec2, distance: float) -> vec3:
        return self.lamplight(surface, self.find_cell_lights(distance))


class TiledLighting(GeometryReader, ShadowReceiver):
    """Adds up the light of each pixel. A work-group has one tile."""

    # As in other passes: highlights end up in 8 bits.
    precision = Precision.FAST
    work_group = (TILE, TILE)

    grid: Uniform[CellGrid]
    lights: Uniform[LightCounts]
    spheres: Storage[vec4]
    depth: Texture2D
    lit: Image2D = image(LIGHT_FORMAT)
    least = shared(uint)
    greatest = shared(uint)
    kept = shared(uint, _CHUNK)

    def compute(self) -> None:
        lane = local_index()
        tile = group_id().xy
        pixel = global_id().xy
        inside = pixel.x < self.grid.size.x and pixel.y < self.grid.size.y
        depth = self.grid.background
        if inside:
            depth = self.depth.load(pixel).r
        has_surface = depth != self.grid.background
        cell = self.find_cell(lane, tile, depth, has_surface)

        texel = uvec4(0)
        row = uvec4(0)
        if has_surface:
            texel = self.surface.load(pixel)
            row = self.material.load(pixel)
        position = self.find_place(texel, pixel)
        surface = self.read_surface(row, texel, pixel, position)
        color = vec3(0.0)
        words = self.lights.words
        for base in range(0, words, _CHUNK):
            if lane < _CHUNK:
                self.kept[lane] = uint(0)
            barrier()
            if cell.near <= cell.far:
                for k in range(lane, WORD * min(words - base, _CHUNK), _GROUP):
                    if self.reaches(WORD * base + k, cell):
                        atomic_or(self.kept[k // WORD], uint(1) << uint(k % WORD))
            barrier()
            if has_surface:
                for w in range(min(words - base, _CHUNK)):
                    bits = self.kept[w]
                    while bits != uint(0):
                        light = WORD * (base + w) + find_lsb(bits)
                        bits = bits & (bits - uint(1))
                        color += self.light_of(surface, light)
            barrier()
        if inside:
            self.lit.store(pixel, self.encode_light(color))

    def encode_light(self, color: vec3) -> vec4:
        return vec4(color, 0.0)

    def find_cell(self, lane: int, tile: ivec2, depth: float, has_surface: bool) -> Cell:
        """Return the tile's cell between its nearest and its farthest surface; it is empty without any."""
        if lane == 0:
            self.least = uint(0x7F7FFFFF)  # the largest float: as long as no depth is below it, there is none
            self.greatest = uint(0)
        barrier()
        if has_surface:
            bits = float_bits_to_uint(depth)  # ordered as the depths are, none of which is below 0
            atomic_min(self.least, bits)
            atomic_max(self.greatest, bits)
        barrier()
        ends = range_of(self.grid, uint_bits_to_float(self.least), uint_bits_to_float(self.greatest))
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
        return True

    def light_of(self, surface: SurfacePoint, light: int) -> vec3:
        spot = light - WORD * self.lights.point_words
        if spot < 0:
            return self.point_lamp(surface, light)
        return self.spot_lamp(surface, spot)

    def point_lamp(self, surface: SurfacePoint, row: int) -> vec3:
        return vec3(0.0)

    def spot_lamp(self, surface: SurfacePoint, row: int) -> vec3:
        return vec3(0.0)


class TiledPointLights(TiledLighting):
    """Adds point lights."""

    point_lights: Storage[PointLight]

    def point_lamp(self, surface: SurfacePoint, row: int) -> vec3:
        light = self.point_lights[row]
        if not is_near(surface.position, light.position, light.range):
            return vec3(0.0)
        reflected = self.reflect_light(surface, point_incidence(surface.position, light))
        return self.unblocked_point(reflected, surface.position, surface.plane, row)


class TiledSpotLights(TiledLighting):
    """Adds spot lights."""

    cones: Storage[Cone]
    spot_lights: Storage[SpotLight]

    def reaches_in_cone(self, spot: int, cell: Cell) -> bool:
        if spot < 0:
            return True
        cone = self.cones[spot]
        return cone_overlaps_tightly(cell, cone, padded_radius(cell, cone.apex, cone.range) - cone.range)

    def spot_lamp(self, surface: SurfacePoint, row: int) -> vec3:
        light = self.spot_lights[row]
        if not is_near(surface.position, light.position, light.range):
            return vec3(0.0)
        reflected = self.reflect_light(surface, spot_incidence(surface.position, light))
        return self.unblocked_spot(reflected, surface.position, surface.plane, row)


class TileUploads(LightUploads):
    """The lights of a frame, for tiles as large as the work-groups of `TiledLighting`."""

    def __init__(self, device: Device) -> None:
        super().__init__(device, tile=TILE)


class TiledDeferred:
    """Draws the scene to a geometry buffer, and lights it tile by tile in one compute pass."""

    name: Final = "tiled_deferred"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `tiles` and `resolve`; those of `Deferred` without lights to test."""
        if not list_lamps(needs):
            return Deferred().declare(needs)
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
            *finish_image(needs, find_forward),
        )


class ClusteredDeferred:
    """Draws the scene to a geometry buffer, and lights it by the lists of clusters."""

    name: Final = "clustered_deferred"

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `light lists` and `resolve`; those of `Deferred` without lights to list."""
        if not list_lamps(needs):
            return Deferred().declare(needs)
        reads = list_contents(needs)
        return (
            geometry_pass(needs),
            list_pass(needs, CLUSTERS),
            resolve_pass(
                needs,
                light_clusters,
                "lights surfaces by what reaches all of them and by their clusters' lights",
                (*reads, "light lists"),
            ),
            *finish_image(needs, partial(find_listed, cells=CLUSTERS), reads=("light lists",)),
        )


@cache
def tiled_variant(
    parts: tuple[str, ...], readers: tuple[type[Shader], ...], added: tuple[type[TiledLighting], ...] = ()
) -> type[Shader]:
    """Return the compute shader for point lights, spot lights or both, which reads the geometry buffer by `readers`;
    bases that are `added` come first."""
    known = {"point_lights": TiledPointLights, "spot_lights": TiledSpotLights, **SHADOW_PARTS}
    bases = (*added, *readers, *(known[part] for part in parts))
    return type("TiledLights", bases, {"__module__": __name__})


def light_tiles(frame: Frame) -> None:
    """Add up the light of point and spot lights in `light`."""
    dispatch_tiles(frame, frame.targets["light"])


def dispatch_tiles(frame: Frame, lit: Texture, added: tuple[type[TiledLighting], ...] = ()) -> None:
    """Run the compute shader for all tiles. With bases that are `added`, it adds up something else than light."""
    resources = frame.resources
    uploads = frame.view.workspace(TileUploads)
    uploads.write(frame.camera, frame.targets.size, resources.scene.lights)
    parts, lamps = bind_lamps(frame)
    lamps.pop("light_rows")
    count = uploads.layout.count
    frame.device.dispatch(
        frame.program(tiled_variant(tuple(parts), list_readers(frame.needs), added)),
        (count.x, count.y),
        depth=frame.targets["depth"],
        lit=lit.image(0),
        **uploads.bindings,
        **(uploads.cones if Effect.SPOT_LIGHTS in frame.needs.effects else {}),
        **bind_geometry(frame),
        **lamps,
    )


def light_clusters(frame: Frame) -> None:
    """Make the image: shade each pixel of the geometry buffer by the light of everything and of its cluster."""
    (features, bindings), (parts, lamps) = bind_shading(frame), bind_lamps(frame)
    resolve_geometry(frame, LitByLists, [*features, *parts], bindings | lamps | bind_lists(frame, CLUSTERS))
