"""Deferred+ (Doghramachi and Bucci, GPU Zen 2017): geometry is drawn once, without materials; each pixel's material is
evaluated afterwards, and lit by its cluster's lights in the same step.

1. `geometry` draws the packed geometry buffer (`packed_geometry`), as the visibility algorithm decides: with
   `two_pass`, first what the last frame's depth doesn't hide, then what this frame's depth doesn't hide.
2. `light lists` lists the lights of clusters.
3. `shading` reads each pixel's surface and material, filters the textures and adds up the light, in one pass over the
   screen. A depth test leaves out the pixels without a surface, before anything is shaded: a shader that discards them
   would cost llvmpipe as much as one that lights them. What the test leaves is placed by a copy of the depth.

Materials with shaders of their own are shaded by draws over the screen, one for each shader: `material ids` has the
shaders of pixels as depth, which these draws test.

With `multi_pass`, each material is shaded by draws of its own: `material ids` writes materials as depth, `rectangles`
finds where each is seen, and `shading` draws the rectangles with a depth test (`material_rectangles`).

With `binned`, each pixel is listed with those of its material (`bins`), `shading` is a compute shader for each shader
of materials that goes through its list, and `resolve` copies what they have stored.

So a hidden fragment costs its geometry alone, and textures are read once a pixel. Scenes with what the packed buffer
has no room for (textures of one material that are read at unlike coordinates, or clamped) are drawn as by
`clustered_deferred`.
"""

from __future__ import annotations

from typing import Any, Final

import rhi.shading as sl
from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import material_depth
from renderer.shaders.pixels import BackgroundScreen, place_pixel
from renderer.techniques.parts.cell_lists import CLUSTERS, CellReader, bind_lists, by_cells, list_pass
from renderer.techniques.parts.deferred_lighting import cluster_passes
from renderer.techniques.parts.full_screen import Color
from renderer.techniques.parts.material_bins import LANES, DispatchGroups, PixelBins, PixelRange, bins_pass
from renderer.techniques.parts.material_rectangles import (
    RectangleShader,
    draw_rectangles,
    ids_pass,
    rectangles_pass,
)
from renderer.techniques.parts.packed_geometry import UNPACKED, PackedReader, can_pack, find_packed, packed_pass
from renderer.techniques.parts.resolve import LIGHT_FORMAT, LitPixels, resolve_pass
from renderer.techniques.parts.samples import PackedSamples, SampleMean, bind_samples, frame_samples, list_samples
from renderer.techniques.parts.scene_shader import ShadingShader
from renderer.techniques.parts.variants import FORWARD, bind, draw_full_screen, find_variant, list_lamps, list_shaders
from rhi import DepthFunction, Program, refuse


class PackedLight(PackedReader, CellReader, ShadingShader):
    """Lights the surfaces of the packed geometry buffer, by the lights of clusters if there are any."""

    has_lamps = False

    def light_sample(self, sample: int) -> sl.vec4:
        place = sl.vec2(self.find_pixel()) + 0.5
        distance = self.find_distance(sample)
        position = place_pixel(self.rays, place, distance)
        at = self.read_input(position, sample)
        material = self.materials[at.material]
        described = self.describe(at)
        surface = self.make_surface(position, at.normal, described, material)
        color = self.shade(surface, material)
        if self.has_lamps:
            color += self.celllight(surface, distance)
        return self.finish(color, position)


class PackedShading(BackgroundScreen, PackedLight):
    """Shades pixels where they lie."""

    def fragment(self) -> sl.vec4:
        return self.light_sample(0)


class PackedShaders(PackedShading):
    """Shades the pixels whose materials have one shader: that of a number."""

    shader = 0

    def screen_depth(self) -> float:
        return material_depth(self.shader)


class PackedRectangles(RectangleShader, PackedLight):
    """Shades the pixels of materials. The depth of the last material is also that of pixels without a surface."""

    def fragment(self) -> sl.vec4:
        if self.depth.load(self.find_pixel()).x == self.rays.farthest:
            sl.discard()
        return self.light_sample(0)


class PackedBins(PackedLight):
    """Shades the pixels that are listed for one shader of materials."""

    work_group = (LANES,)
    shader = 0

    pixels: sl.Storage[sl.uint]
    ranges: sl.Storage[PixelRange]
    lit: sl.Image2D = sl.image(LIGHT_FORMAT)

    def find_pixel(self) -> sl.ivec2:
        place = sl.min(self.ranges[self.shader].begin + sl.uint(sl.global_id().x), sl.uint(len(self.pixels) - 1))
        pixel = self.pixels[int(place)]
        return sl.ivec2(int(pixel & 0xFFFF), int(pixel >> 16))

    def compute(self) -> None:
        # Lanes of no pixel shade another one: what lanes do together must be done by all.
        color = self.light_sample(0)
        if self.ranges[self.shader].begin + sl.uint(sl.global_id().x) < self.ranges[self.shader].end:
            self.lit.store(self.find_pixel(), color)


def check_passes(multi_pass: bool, binned: bool, samples: int, call: str) -> None:
    """Refuse two ways at once to shade pixels by their materials, and either of them for several samples."""
    if multi_pass and binned:
        refuse(rules.BAD_TECHNIQUE, f"{call}(multi_pass=..., binned=...)", "True and True", "one of them")
    if samples > 1 and (multi_pass or binned):
        given = f"{'multi_pass' if multi_pass else 'binned'} with samples={samples}"
        refuse(rules.BAD_TECHNIQUE, f"{call}(samples=...)", given, "samples=1")


class DeferredPlus:
    """Draws geometry without materials, and evaluates the material of each pixel once."""

    name: Final = "deferred_plus"

    def __init__(self, samples: int = 1, *, multi_pass: bool = False, binned: bool = False) -> None:
        """Choose the number of samples per pixel, as for `Forward`. With `multi_pass`, the pixels of a material are
        found by a depth test, and shaded in draws of their own. If they are `binned`, they are listed by material, and
        shaded by compute shaders. Not both, and neither with several samples."""
        check_passes(multi_pass, binned, samples, "DeferredPlus")
        self.samples, self.multi_pass, self.binned = samples, multi_pass, binned

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `light lists` if there are lights to list, and `shading`; with `multi_pass`
        also `material ids` and `rectangles`, if `binned` also `bins` and `resolve`; and those of transparent
        surfaces. With several samples, `depth` comes before, and shaders of materials are evaluated as by
        `ClusteredDeferred`: the samples of a pixel may have several."""
        samples = self.samples
        if not can_pack(needs) or (samples > 1 and Effect.MATERIAL_SHADERS in needs.effects):
            return cluster_passes(needs, samples)
        lists = (list_pass(needs, CLUSTERS),) if list_lamps(needs) else ()
        found: dict[str, Pass[Frame]] = {}  # what finds the pixels of materials, by its contents
        if self.binned:
            found = {"bins": bins_pass()}
        elif self.multi_pass:
            found = {"material ids": ids_pass(), "rectangles": rectangles_pass()}
        elif Effect.MATERIAL_SHADERS in needs.effects:
            found = {"material ids": ids_pass(by_shader=True)}
        # A pass can't read the depth that it tests. Others test `material ids`.
        copied = () if found or samples > 1 else (Target("depth copy", DEPTH_FORMAT),)
        shading = Pass(
            "shading",
            self._shade,
            "evaluates each pixel's material and its light",
            reads=(
                *list_samples(samples, *find_packed(needs, samples), "depth"),
                *(("light lists",) if lists else ()),
                *found,
            ),
            writes=(Target("lit", LIGHT_FORMAT),) if self.binned else (needs.image, *copied),
        )
        shown = (resolve_pass(needs, _show, "shows what was shaded", ("lit", "depth")),) if self.binned else ()
        lighting = by_cells(CLUSTERS) if lists else FORWARD
        passes = packed_pass(needs, samples=samples), *lists, *found.values(), shading, *shown
        return frame_samples(needs, *passes, samples=samples, lighting=lighting)

    def _shade(self, frame: Frame) -> None:
        targets, has_lamps = frame.targets, bool(list_lamps(frame.needs))
        own: dict[str, Any] = bind_lists(frame, CLUSTERS) if has_lamps else {}
        switches = {**UNPACKED, "has_lamps": has_lamps}
        if self.samples > 1:
            own |= bind_samples(frame)
            bases = SampleMean, PackedSamples, PackedShading
            draw_full_screen(frame, bases, frame.image, own, switches={**switches, "samples": self.samples})
            return
        if self.binned:
            _shade_bins(frame, own, switches)
            return
        if self.multi_pass:
            draw_rectangles(frame, PackedRectangles, own, switches)
            return
        if Effect.MATERIAL_SHADERS in frame.needs.effects:
            clear: Color | None = frame.background
            for number, shader, parameters in list_shaders(frame):
                draw_full_screen(
                    frame,
                    (*shader, PackedShaders),
                    frame.image,
                    {**own, **parameters},
                    depth=targets["material ids"],
                    clear=clear,
                    states=(DepthFunction.EQUAL,),
                    switches={**switches, "shader": number},
                )
                clear = None
            return
        targets["depth"].copy_to(targets["depth copy"])
        own["depth"] = targets["depth copy"]
        depth, background = targets["depth"], frame.background
        draw_full_screen(frame, PackedShading, frame.image, own, depth=depth, clear=background, switches=switches)


def _shade_bins(frame: Frame, own: dict[str, Any], switches: dict[str, Any]) -> None:
    """Shade the pixels that are listed, by the shaders of their materials."""
    bins = frame.view.workspace(PixelBins)
    given = {**own, "pixels": bins.pixels, "ranges": bins.ranges, "lit": frame.targets["lit"].image(0)}
    for number, bases, parameters in list_shaders(frame):
        program: Program[...] = frame.program(find_variant(frame, *bases, PackedBins, **switches, shader=number))
        bindings = bind(frame, program, {**given, **parameters})
        frame.device.dispatch_indirect(program, bins.groups, number * DispatchGroups.dtype.itemsize, **bindings)


def _show(frame: Frame) -> None:
    """Make the image of what was shaded."""
    depth, background = frame.targets["depth"], frame.background
    draw_full_screen(frame, LitPixels, frame.image, depth=depth, clear=background)
