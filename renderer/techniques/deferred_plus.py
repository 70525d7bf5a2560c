"""Deferred+ (Doghramachi and Bucci, GPU Zen 2017): geometry is drawn once, without materials; each pixel's
material is evaluated afterwards, and lit by its cluster's lights in the same step.

1. `geometry` draws the packed geometry buffer (`packed_geometry`), as the visibility algorithm decides: with
   `two_pass`, first what the last frame's depth doesn't hide, then what this frame's depth doesn't hide.
2. `light lists` lists the lights of clusters; with `tiled`, those of tiles, which end at their surfaces.
3. `shading` reads each pixel's surface and material, filters the textures and adds up the light, in one pass
   over the screen. A depth test leaves out the pixels without a surface, before anything is shaded: a shader
   that discards them would cost llvmpipe as much as one that lights them. What the test leaves is placed by a
   copy of the depth.

Materials with shaders of their own are shaded by draws over the screen, one for each shader: `material ids`
has the shaders of pixels as depth, which these draws test.

With `multi_pass`, each material is shaded by draws of its own: `material ids` writes materials as depth,
`rectangles` finds where each is seen, and `shading` draws the rectangles with a depth test
(`material_rectangles`).

With `object_rectangles` the rectangles are the chapter's: one for each material, around the boxes of its objects.

With `binned`, each pixel is listed with those of its material (`bins`), `shading` is a compute shader for
each shader of materials that goes through its list, and `resolve` copies what they have stored.

So a hidden fragment costs its geometry alone, and textures are read once a pixel. Scenes with what the packed
buffer has no room for (textures of one material that are read at unlike coordinates, or clamped) are drawn as
by `clustered_deferred`.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, FrameEffects, FramePass, Target
from renderer.shaders.encodings import material_depth
from renderer.shaders.pixels import BackgroundScreen, pixel_position
from renderer.techniques.parts.deferred_lighting import GeometryResolve, LitByLists, cluster_passes
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS
from renderer.techniques.parts.full_screen import Color
from renderer.techniques.parts.geometry_buffer import GEOMETRY_SHADERS
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    TILES,
    ClusterSettings,
    ForwardByCells,
    LightListReader,
    bind_light_lists,
    light_list_pass,
    lit_by_cells,
)
from renderer.techniques.parts.material_bins import (
    BIN_SHADERS,
    LANES,
    DispatchGroups,
    PixelBins,
    PixelRange,
    bins_pass,
)
from renderer.techniques.parts.material_rectangles import (
    RECTANGLE_SHADERS,
    RectangleShader,
    draw_rectangles,
    ids_pass,
    object_rectangles_pass,
    rectangles_pass,
)
from renderer.techniques.parts.packed_geometry import (
    PACKED_READER_SWITCHES,
    PACKED_SHADERS,
    PackedReader,
    can_pack,
    packed_formats,
    packed_pass,
)
from renderer.techniques.parts.resolve import LIGHT_FORMAT, LitPixels, resolve_pass
from renderer.techniques.parts.samples import (
    GeometrySamples,
    PackedSamples,
    SampleMean,
    bind_samples,
    frame_samples,
    list_samples,
)
from renderer.techniques.parts.scene_shader import ShadingShader
from renderer.techniques.parts.variants import (
    FORWARD,
    bind,
    draw_full_screen,
    list_shaders,
    local_light_effects,
    shader_variant,
)
from rhi import DepthFunction, Program, refuse


class PackedLight(PackedReader, LightListReader, ShadingShader):
    """Lights the surfaces of the packed geometry buffer, by the light lists of tiles or clusters if there
    are local lights."""

    has_local_lights = False

    def shade_sample(self, sample: int) -> sl.vec4:
        pixel_center = sl.vec2(self.get_pixel()) + 0.5
        distance = self.surface_distance(sample)
        position = pixel_position(self.rays, pixel_center, distance)
        at = self.read_input(position, sample)
        material = self.materials[at.material]
        described = self.describe(at)
        if self.has_decals:
            described = self.apply_decals(at, described)
        surface = self.make_surface(position, at.normal, described, material)
        if self.has_anisotropy:
            surface = self.stretch(surface, at)
        if self.has_lighting_models:
            surface = self.note_material(surface, at.material, material.shader)
        if self.has_light_maps:
            surface.irradiance = self.sample_light_map(at)
        color = self.shade(surface, material)
        if self.has_local_lights:
            color += self.shade_cell_lights(surface, distance)
        return self.finish(color, position)


class PackedShading(BackgroundScreen, PackedLight):
    """Shades each pixel of the screen."""

    def fragment(self) -> sl.vec4:
        return self.shade_sample(0)


class PackedShaders(PackedShading):
    """Shades the pixels whose materials have the shader of one number."""

    shader = 0

    def screen_depth(self) -> float:
        return material_depth(self.shader)


class PackedRectangles(RectangleShader, PackedLight):
    """Shades the rectangles of materials. The background has the depth of the last material, so its pixels
    are discarded."""

    def fragment(self) -> sl.vec4:
        if self.depth.load(self.get_pixel()).x == self.rays.farthest:
            sl.discard()
        return self.shade_sample(0)


class PackedBins(PackedLight):
    """Shades the pixels in the list of one material shader."""

    work_group = (LANES,)
    shader = 0

    pixels: sl.Storage[sl.uint]
    ranges: sl.Storage[PixelRange]
    lit: sl.Image2D = sl.image(LIGHT_FORMAT)

    def get_pixel(self) -> sl.ivec2:
        entry = sl.min(
            self.ranges[self.shader].begin + sl.uint(sl.global_id().x), sl.uint(len(self.pixels) - 1)
        )
        pixel = self.pixels[int(entry)]
        return sl.ivec2(int(pixel & 0xFFFF), int(pixel >> 16))

    def compute(self) -> None:
        # Lanes of no pixel shade another one: what lanes do together must be done by all.
        color = self.shade_sample(0)
        if self.ranges[self.shader].begin + sl.uint(sl.global_id().x) < self.ranges[self.shader].end:
            self.lit.store(self.get_pixel(), color)


def check_passes(multi_pass: bool, binned: bool, samples: int, call: str) -> None:
    """Refuse `multi_pass` together with `binned`, and either of them with several samples."""
    if multi_pass and binned:
        refuse(
            rules.BAD_TECHNIQUE, f"{call}(multi_pass=..., binned=...)", "True and True", "at most one of them"
        )
    if samples > 1 and (multi_pass or binned):
        arguments = f"{'multi_pass' if multi_pass else 'binned'} with samples={samples}"
        refuse(rules.BAD_TECHNIQUE, f"{call}(samples=...)", arguments, "samples=1")


class DeferredPlus:
    """Draws geometry without materials, and evaluates the material of each pixel once."""

    name: Final = "deferred_plus"
    shaders: Final[tuple[type[sl.Shader], ...]] = (
        *PACKED_SHADERS,
        PackedShading,
        PackedShaders,
        *RECTANGLE_SHADERS,
        PackedRectangles,
        *BIN_SHADERS,
        PackedBins,
        LitPixels,
        SampleMean,
        PackedSamples,
        ForwardByCells,
        *GEOMETRY_SHADERS,
        GeometryResolve,
        LitByLists,
        GeometrySamples,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self,
        samples: int = 1,
        *,
        multi_pass: bool = False,
        object_rectangles: bool = False,
        binned: bool = False,
        tiled: bool = False,
        tiles: ClusterSettings = TILES,
    ) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`. `multi_pass` finds the pixels of
        each material by a depth test and shades them in draws of their own; `binned` lists pixels by
        material and shades them in compute. They exclude each other and several samples. `object_rectangles`
        is `multi_pass` with a rectangle for each material, around the boxes of its objects. `tiled` lights
        pixels by the lists of `tiles` instead of those of clusters."""
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "DeferredPlus(samples=...)", samples)
        check_passes(multi_pass or object_rectangles, binned, self.samples, "DeferredPlus")
        self.multi_pass = multi_pass
        self.object_rectangles = object_rectangles
        self.binned = binned
        self.tiled = tiled
        self.cells = tiles if tiled else CLUSTERS

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `geometry`, `light lists` if there are local lights, `shading`, and those of
        transparent surfaces. `multi_pass` adds `material ids` and `rectangles`; `binned` adds `bins` and
        `resolve`. With several samples, `depth` comes first, and scenes whose materials have shaders of
        their own are drawn as by `ClusteredDeferred`."""
        samples = self.samples
        if not can_pack(effects) or (samples > 1 and Effect.MATERIAL_SHADERS in effects.enabled):
            return cluster_passes(effects, samples)
        # Depth of one sample doesn't bound what is lit with several: tiles then have no ends in depth.
        ends_at_surfaces = self.tiled and samples == 1
        lists: tuple[FramePass[Frame], ...] = ()
        if local_light_effects(effects):
            lists = (light_list_pass(effects, self.cells, depth="depth" if ends_at_surfaces else None),)
        material_passes: dict[
            str, FramePass[Frame]
        ] = {}  # the passes that find the pixels of materials, by their resource
        if self.binned:
            material_passes = {"bins": bins_pass()}
        elif self.multi_pass or self.object_rectangles:
            rectangles = object_rectangles_pass() if self.object_rectangles else rectangles_pass()
            material_passes = {"material ids": ids_pass(), "rectangles": rectangles}
        elif Effect.MATERIAL_SHADERS in effects.enabled:
            material_passes = {"material ids": ids_pass(by_shader=True)}
        # A pass can't read the depth that it tests. Others test `material ids`.
        copied = () if material_passes or samples > 1 else (Target("depth copy", DEPTH_FORMAT),)
        shading = FramePass(
            "shading",
            self._shade,
            "evaluates each pixel's material and its light",
            reads=(
                *list_samples(samples, *packed_formats(effects, samples), "depth"),
                *(("light lists",) if lists else ()),
                *material_passes,
                *effects.shading_reads,
            ),
            writes=(Target("lit", LIGHT_FORMAT),) if self.binned else (effects.image, *copied),
        )
        resolve = (
            (resolve_pass(effects, _show, "shows what was shaded", ("lit", "depth")),) if self.binned else ()
        )
        # Transparent surfaces lie before those that tiles end at.
        lighting = lit_by_cells(self.cells) if lists and not ends_at_surfaces else FORWARD
        passes = packed_pass(effects, samples=samples), *lists, *material_passes.values(), shading, *resolve
        return frame_samples(effects, *passes, samples=samples, lighting=lighting)

    def _shade(self, frame: Frame) -> None:
        targets, has_local_lights = frame.targets, bool(local_light_effects(frame.effects))
        shader_bindings: dict[str, Any] = bind_light_lists(frame, self.cells) if has_local_lights else {}
        switches = {**PACKED_READER_SWITCHES, "has_local_lights": has_local_lights}
        if self.samples > 1:
            shader_bindings |= bind_samples(frame)
            bases = SampleMean, PackedSamples, PackedShading
            draw_full_screen(
                frame, bases, frame.image, shader_bindings, switches={**switches, "samples": self.samples}
            )
            return
        if self.binned:
            _shade_bins(frame, shader_bindings, switches)
            return
        if self.multi_pass or self.object_rectangles:
            draw_rectangles(frame, PackedRectangles, shader_bindings, switches)
            return
        if Effect.MATERIAL_SHADERS in frame.effects.enabled:
            clear: Color | None = frame.background
            for number, shader, parameters in list_shaders(frame):
                draw_full_screen(
                    frame,
                    (*shader, PackedShaders),
                    frame.image,
                    {**shader_bindings, **parameters},
                    depth=targets["material ids"],
                    clear=clear,
                    states=(DepthFunction.EQUAL,),
                    switches={**switches, "shader": number},
                )
                clear = None
            return
        targets["depth"].copy_to(targets["depth copy"])
        shader_bindings["depth"] = targets["depth copy"]
        depth, background = targets["depth"], frame.background
        draw_full_screen(
            frame,
            PackedShading,
            frame.image,
            shader_bindings,
            depth=depth,
            clear=background,
            switches=switches,
        )


def _shade_bins(frame: Frame, shader_bindings: dict[str, Any], switches: dict[str, Any]) -> None:
    """Shade the listed pixels by one dispatch per material shader."""
    bins = frame.view.workspace(PixelBins)
    bin_bindings = {
        **shader_bindings,
        "pixels": bins.pixels,
        "ranges": bins.ranges,
        "lit": frame.targets["lit"].image(0),
    }
    for number, bases, parameters in list_shaders(frame):
        program: Program[...] = frame.program(
            shader_variant(frame, *bases, PackedBins, **switches, shader=number)
        )
        bindings = bind(frame, program, {**bin_bindings, **parameters})
        frame.device.dispatch_indirect(
            program, bins.groups, number * DispatchGroups.dtype.itemsize, **bindings
        )


def _show(frame: Frame) -> None:
    """Copy the shaded pixels to the image."""
    depth, background = frame.targets["depth"], frame.background
    draw_full_screen(frame, LitPixels, frame.image, depth=depth, clear=background)
