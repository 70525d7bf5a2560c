"""Deferred shading by the lights of tiles or clusters: no light volumes are drawn.

`tiled_deferred` (Andersson 2009; Lauritzen 2010) has one compute shader that does both: a work-group finds
the depths of its tile, tests the lights against them, and lights its pixels by those that it has kept.
`clustered_deferred` (Olsson, Billeter and Assarsson 2012) lists the lights of clusters and lights each pixel
by its cluster's list, in the same pass that makes the image.

Without point and spot lights in view, both are deferred shading.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import LOCAL_LIGHTS, Frame, FrameEffects, FramePass, Target
from renderer.light_kinds.bounds import WORD_FIELDS
from renderer.light_kinds.generation import define
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.light_kinds.volumes import Cone
from renderer.lights.culling.cells import Cell, ClusterGrid, block_cell, distance_range, padded_radius
from renderer.lights.culling.cone_tests import cone_overlaps_tightly
from renderer.lights.culling.kernels import LightMaskSize
from renderer.lights.culling.sphere_tests import overlaps_hybrid
from renderer.lights.culling.uploads import LightUploads
from renderer.lights.culling.volumes import WORD
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.parts.deferred_lighting import GeometryResolve, LitByLists, cluster_passes, resolve
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS
from renderer.techniques.parts.geometry_buffer import (
    DEFAULT_NORMAL_BITS,
    GEOMETRY_SHADERS,
    NORMAL_BITS,
    GeometryReader,
    geometry_buffer_names,
    geometry_buffer_switches,
    geometry_pass,
)
from renderer.techniques.parts.light_list_reader import ForwardByCells
from renderer.techniques.parts.resolve import LIGHT_FORMAT, LitPixels, check_bits, resolve_pass
from renderer.techniques.parts.samples import (
    GeometrySamples,
    SampleMean,
    bind_samples,
    frame_samples,
    list_samples,
)
from renderer.techniques.parts.scene_shader import LocalLightShader, ShadingShader
from renderer.techniques.parts.variants import (
    bind,
    draw_full_screen,
    explain_local_lights,
    local_light_effects,
    shader_variant,
)
from rhi import Texture

TILE: Final = 16
"""The side of a tile in pixels: a work-group has a pixel for each of its threads."""
_GROUP: Final = TILE * TILE
_CHUNK: Final = 64
"""Number of words of lights that a tile holds at a time."""


def _shade_by_kind() -> str:
    """The source of `MaskedLightShader.light_of`: a chain of tests, one for each kind of lights."""
    text, before = "", "light"
    for number, kind in enumerate(LOCAL_LIGHT_KINDS):
        tests = [f"self.has_{kind.name}_lights", *([f"{before} >= 0"] if number else [])]
        if number < len(WORD_FIELDS):
            after = f"after_{kind.name}"
            text += f"        {after} = light - WORD * self.lights.{WORD_FIELDS[number]}\n"
            tests.append(f"{after} < 0")
        text += f"        if {' and '.join(tests)}:\n"
        text += f"            return self.shade_{kind.name}_light(surface, {before})\n"
        before = after
    return text


if TYPE_CHECKING:

    class MaskedLightShader(LocalLightShader):
        """The base of shaders that light surfaces by the lights whose bits are set in words."""

        def light_of(self, surface: SurfacePoint, light: int) -> sl.vec3:
            """The light that a surface reflects of the light of a bit."""

else:
    MaskedLightShader = define(
        f"""
class MaskedLightShader(LocalLightShader):
    def light_of(self, surface: SurfacePoint, light: int) -> sl.vec3:
{_shade_by_kind()}
        return sl.vec3(0.0)
""",
        "MaskedLightShader",
        __name__,
        LocalLightShader=LocalLightShader,
        SurfacePoint=SurfacePoint,
        WORD=WORD,
        sl=sl,
    )


class TiledLighting(GeometryReader, MaskedLightShader):
    """Accumulates the light of each pixel, one tile per work-group."""

    # As in other passes: highlights end up in 8 bits.
    precision = sl.Precision.FAST
    work_group = (TILE, TILE)

    has_cones = False

    grid: sl.Uniform[ClusterGrid]
    lights: sl.Uniform[LightMaskSize]
    spheres: sl.Storage[sl.vec4]
    cones: sl.Storage[Cone]
    depth: sl.Texture2D
    lit: sl.Image2D = sl.image(LIGHT_FORMAT)
    least = sl.shared(sl.uint)
    greatest = sl.shared(sl.uint)
    visible_bits = sl.shared(sl.uint, _CHUNK)

    def compute(self) -> None:
        lane = sl.local_index()
        tile = sl.group_id().xy
        pixel = sl.global_id().xy
        inside = pixel.x < self.grid.size.x and pixel.y < self.grid.size.y
        depth = self.grid.background
        if inside:
            depth = self.depth.load(pixel).r
        has_surface = depth != self.grid.background
        cell = self.tile_cell(lane, tile, depth, depth, has_surface)

        texel = sl.uvec4(0)
        material_texel = sl.uvec4(0)
        if has_surface:
            texel = self.load_surface(pixel, 0)
            material_texel = self.load_material(pixel, 0)
        position = self.surface_position(texel, pixel)
        surface = self.read_surface(material_texel, texel, pixel, 0, position)
        color = sl.vec3(0.0)
        for base in range(0, self.lights.words, _CHUNK):
            self.cull_tile_lights(lane, base, cell)
            if has_surface:
                color += self.shade_tile_lights(surface, base)
            sl.barrier()
        if inside:
            self.lit.store(pixel, self.linear_to_srgb_color(color))

    def cull_tile_lights(self, lane: int, base: int, cell: Cell) -> None:
        """Set the bits of the lights that may reach a cell: one chunk of lights, from word `base` of the
        mask on."""
        if lane < _CHUNK:
            self.visible_bits[lane] = sl.uint(0)
        sl.barrier()
        if cell.near <= cell.far:
            for k in range(lane, WORD * sl.min(self.lights.words - base, _CHUNK), _GROUP):
                if self.reaches(WORD * base + k, cell):
                    sl.atomic_or(self.visible_bits[k // WORD], sl.uint(1) << sl.uint(k % WORD))
        sl.barrier()

    def shade_tile_lights(self, surface: SurfacePoint, base: int) -> sl.vec3:
        """Light that a surface reflects of one chunk of the tile's lights, from word `base` of the mask
        on."""
        color = sl.vec3(0.0)
        for w in range(sl.min(self.lights.words - base, _CHUNK)):
            bits = self.visible_bits[w]
            while bits != sl.uint(0):
                light = WORD * (base + w) + sl.find_lsb(bits)
                bits = bits & (bits - sl.uint(1))
                color += self.light_of(surface, light)
        return color

    def linear_to_srgb_color(self, color: sl.vec3) -> sl.vec4:
        return sl.vec4(color, 0.0)

    def tile_cell(self, lane: int, tile: sl.ivec2, low: float, high: float, has_surface: bool) -> Cell:
        """The tile's cell between its nearest and farthest surface, empty if it has none. `low` and `high`
        are the least and greatest depth of the lane's pixel; no depth is below 0."""
        if lane == 0:
            self.least = sl.uint(
                0x7F7FFFFF
            )  # the largest float: as long as no depth is below it, there is none
            self.greatest = sl.uint(0)
        sl.barrier()
        if has_surface:
            sl.atomic_min(self.least, sl.float_bits_to_uint(low))  # bits are ordered as the depths are
            sl.atomic_max(self.greatest, sl.float_bits_to_uint(high))
        sl.barrier()
        ends = self.tile_distance_range(
            sl.uint_bits_to_float(self.least), sl.uint_bits_to_float(self.greatest)
        )
        return block_cell(self.grid, tile, 1, ends.x, ends.y)

    def tile_distance_range(self, low: float, high: float) -> sl.vec2:
        """Distances of the tile's nearest and farthest surface along the view, from their depths."""
        return distance_range(self.grid, low, high)

    def reaches(self, light: int, cell: Cell) -> bool:
        """True if a light may reach a cell that isn't empty."""
        sphere = self.spheres[light]
        if sphere.w < 0.0:
            return False
        if not overlaps_hybrid(cell, sphere.xyz, padded_radius(cell, sphere.xyz, sphere.w)):
            return False
        return self.reaches_in_cone(light - WORD * self.lights.first_cone_word, cell)

    def reaches_in_cone(self, cone_index: int, cell: Cell) -> bool:
        if not self.has_cones:
            return True
        if cone_index < 0:
            return True
        cone = self.cones[cone_index]
        return cone_overlaps_tightly(cell, cone, padded_radius(cell, cone.apex, cone.range) - cone.range)


class SampledTiles(GeometrySamples, TiledLighting, ShadingShader):
    """Shades the samples of each pixel, each surface once, and stores their mean colour."""

    def compute(self) -> None:
        pixel = self.get_pixel()
        inside = pixel.x < self.grid.size.x and pixel.y < self.grid.size.y
        near = self.rays.far
        far = 0.0
        colors = sl.array(sl.vec3, self.samples)
        if inside:
            for sample in range(self.samples):
                if self.is_covered(sample):
                    distance = self.surface_distance(sample)
                    near = sl.min(near, distance)
                    far = sl.max(far, distance)
                    if self.is_new(sample):
                        material_index = int(self.load_material(pixel, sample).x)
                        colors[sample] = self.shade(
                            self.read_surface_sample(sample), self.materials[material_index]
                        )
        lane = sl.local_index()
        cell = self.tile_cell(lane, sl.group_id().xy, near, far, near <= far)
        for base in range(0, self.lights.words, _CHUNK):
            self.cull_tile_lights(lane, base, cell)
            if near <= far:
                for sample in range(self.samples):
                    if self.is_covered(sample) and self.is_new(sample):
                        colors[sample] += self.shade_tile_lights(self.read_surface_sample(sample), base)
            sl.barrier()
        total = sl.vec4(0.0)
        color = sl.vec4(0.0)
        if inside:
            for sample in range(self.samples):
                if self.is_new(sample):
                    color = self.background_color()
                    if self.is_covered(sample):
                        position = self.surface_position(self.load_surface(pixel, sample), pixel)
                        color = self.finish(colors[sample], position)
                total += color
            self.lit.store(pixel, total / float(self.samples))

    def get_pixel(self) -> sl.ivec2:
        return sl.global_id().xy

    def surface_distance(self, sample: int) -> float:
        """Distance of a sample's surface along the view."""
        return sl.max(sl.uint_bits_to_float(self.load_surface(self.get_pixel(), sample).x), 0.0)

    def read_surface_sample(self, sample: int) -> SurfacePoint:
        """The surface of a sample."""
        pixel = self.get_pixel()
        texel = self.load_surface(pixel, sample)
        material_texel = self.load_material(pixel, sample)
        return self.read_surface(material_texel, texel, pixel, sample, self.surface_position(texel, pixel))

    def tile_distance_range(self, low: float, high: float) -> sl.vec2:
        return sl.vec2(low, high) if low <= high else sl.vec2(1.0, 0.0)  # surfaces store distances


_make_uploads: Final = partial(LightUploads, tile=TILE)
"""Makes the lights of a frame, for tiles as large as the work-groups of `TiledLighting`."""


class TiledDeferred:
    """Draws the scene to a geometry buffer, and lights it tile by tile in one compute pass."""

    name: Final = "tiled_deferred"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        *GEOMETRY_SHADERS,
        TiledLighting,
        SampledTiles,
        LitPixels,
        GeometryResolve,
        ForwardByCells,
        SampleMean,
        GeometrySamples,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(self, samples: int = 1, *, normal_bits: int = DEFAULT_NORMAL_BITS) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`; `normal_bits` is as for
        `Deferred`."""
        check_bits(normal_bits, NORMAL_BITS, "TiledDeferred(normal_bits=...)")
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "TiledDeferred(samples=...)", samples)
        self.normal_bits = normal_bits

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `geometry`, `tiles` and `resolve`, after `depth` with several samples. Without local
        lights, those of `ClusteredDeferred`."""
        if not local_light_effects(effects) or effects.needs_forward:
            return cluster_passes(effects, self.samples, self.normal_bits)
        samples, reads = self.samples, list_samples(self.samples, *geometry_buffer_names(effects))
        geometry = geometry_pass(effects, samples=samples, normal_bits=self.normal_bits)
        name, shader = ("light", TiledLighting) if samples == 1 else ("lit", SampledTiles)
        run = partial(light_tiles, name=name, shader=shader, samples=samples)
        inputs = reads if samples == 1 else (*reads, *effects.shading_reads)
        light = FramePass("tiles", run, explain_local_lights(effects), inputs, (Target(name, LIGHT_FORMAT),))
        if samples == 1:
            add, reason = partial(resolve, lights=(name,)), "lights surfaces by what reaches all of them"
            image = resolve_pass(effects, add, reason, (*reads, name, *effects.shading_reads))
        else:
            image = resolve_pass(effects, _show, "shows what was shaded", (name,))
        return frame_samples(effects, geometry, light, image, samples=samples)


class ClusteredDeferred:
    """Draws the scene to a geometry buffer, and lights it by the lists of clusters."""

    name: Final = "clustered_deferred"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        *GEOMETRY_SHADERS,
        GeometryResolve,
        LitByLists,
        ForwardByCells,
        SampleMean,
        GeometrySamples,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(self, samples: int = 1, *, normal_bits: int = DEFAULT_NORMAL_BITS) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`; `normal_bits` is as for
        `Deferred`."""
        check_bits(normal_bits, NORMAL_BITS, "ClusteredDeferred(normal_bits=...)")
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "ClusteredDeferred(samples=...)", samples)
        self.normal_bits = normal_bits

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `geometry`, `light lists` and `resolve`, after `depth` with several samples. Without
        local lights, those of `Deferred`."""
        return cluster_passes(effects, self.samples, self.normal_bits)


def light_tiles(frame: Frame, *, name: str, shader: type[TiledLighting], **switches: int) -> None:
    """Accumulate the light of local lights in the resource `name`; with several samples, store each
    pixel's mean colour there."""
    shader_bindings = bind_samples(frame) if shader is SampledTiles else {}
    dispatch_tiles(frame, frame.targets[name], shader, shader_bindings=shader_bindings, **switches)


def _show(frame: Frame) -> None:
    draw_full_screen(frame, LitPixels, frame.image)


def dispatch_tiles(
    frame: Frame, lit: Texture, *bases: type[Any], shader_bindings: Mapping[str, Any] = {}, **switches: int
) -> None:
    """Dispatch the compute shader with these bases over all tiles."""
    uploads = frame.view.workspace(_make_uploads)
    uploads.write(frame.camera, frame.targets.size, frame.resources.lights)
    has_cones = any(
        LOCAL_LIGHTS[effect].kind.cones is not None for effect in local_light_effects(frame.effects)
    )
    switches = {**geometry_buffer_switches(frame), **switches, "has_cones": has_cones}
    program: Any = frame.program(shader_variant(frame, *bases, **switches))
    cones = uploads.cones if has_cones else {}
    shader_bindings = {**shader_bindings, "lit": lit.image(0), **uploads.bindings, **cones}
    frame.device.dispatch(program, uploads.count[:2], **bind(frame, program, shader_bindings))
