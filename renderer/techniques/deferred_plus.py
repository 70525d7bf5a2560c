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

So a hidden fragment costs its geometry alone, and textures are read once a pixel. Scenes with what the packed buffer
has no room for (unlike transforms of one material's textures, a second set of texture coordinates, colours of vertices)
are drawn as by `clustered_deferred`.
"""

from __future__ import annotations

from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target
from renderer.shaders.encodings import material_depth
from renderer.shaders.pixels import distance_at, nearness_of, place_pixel
from renderer.techniques.parts.cell_lists import CLUSTERS, CellReader, bind_lists, by_cells, list_pass
from renderer.techniques.parts.deferred_lighting import cluster_passes
from renderer.techniques.parts.finish import finish_image
from renderer.techniques.parts.full_screen import Color
from renderer.techniques.parts.material_rectangles import (
    RectangleShader,
    draw_rectangles,
    ids_pass,
    rectangles_pass,
)
from renderer.techniques.parts.packed_geometry import UNPACKED, PackedReader, can_pack, packed_pass
from renderer.techniques.parts.scene_shader import ShadingShader
from renderer.techniques.parts.variants import FORWARD, draw_full_screen, list_lamps, list_shaders
from rhi import DepthFunction
from rhi.shading import discard, fragment_coordinate, ivec2, vec4


class PackedShading(PackedReader, CellReader, ShadingShader):
    """Shades the pixels of the packed geometry buffer, by the lights of clusters if there are any."""

    has_lamps = False

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        distance = distance_at(self.rays, nearness_of(self.rays, self.depth.load(ivec2(place)).x))
        position = place_pixel(self.rays, place, distance)
        at = self.read_input(position)
        material = self.materials[at.material]
        described = self.describe(at)
        surface = self.make_surface(position, at.normal, described, material)
        color = self.shade(surface, material)
        if self.has_lamps:
            color += self.celllight(surface, distance)
        return self.finish(color, position)


class PackedShaders(PackedShading):
    """Shades the pixels whose materials have one shader: that of a number."""

    shader = 0

    def screen_depth(self) -> float:
        return material_depth(self.shader)


class PackedRectangles(RectangleShader, PackedShading):
    """Shades the pixels of materials. The depth of the last material is also that of pixels without a surface."""

    def fragment(self) -> vec4:
        if self.depth.load(ivec2(fragment_coordinate().xy)).x == self.rays.farthest:
            discard()
        return super().fragment()


class DeferredPlus:
    """Draws geometry without materials, and evaluates the material of each pixel once."""

    name: Final = "deferred_plus"

    def __init__(self, *, multi_pass: bool = False) -> None:
        """With `multi_pass`, the pixels of a material are found by a depth test, and shaded in draws of their own."""
        self.multi_pass = multi_pass

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `geometry`, `light lists` if there are lights to list, and `shading`; with `multi_pass`
        also `material ids` and `rectangles`; and those of transparent surfaces."""
        if not can_pack(needs):
            return cluster_passes(needs)
        lists = (list_pass(needs, CLUSTERS),) if list_lamps(needs) else ()
        has_own = Effect.MATERIAL_SHADERS in needs.effects
        found = [ids_pass(by_shader=not self.multi_pass)] if self.multi_pass or has_own else []
        found += [rectangles_pass()] if self.multi_pass else []
        # A pass can't read the depth that it tests. Others test `material ids`.
        copied = () if found else (Target("depth copy", DEPTH_FORMAT),)
        reads = ["packed", "depth"]
        reads += ["light lists"] if lists else []
        reads += ["material ids"] if found else []
        reads += ["rectangles"] if self.multi_pass else []
        shading = Pass(
            "shading",
            self._shade,
            "evaluates each pixel's material and its light",
            reads=tuple(reads),
            writes=(needs.image, *copied),
        )
        lighting = by_cells(CLUSTERS) if lists else FORWARD
        return (packed_pass(needs), *lists, *found, shading, *finish_image(needs, lighting))

    def _shade(self, frame: Frame) -> None:
        targets, has_lamps = frame.targets, bool(list_lamps(frame.needs))
        own: dict[str, Any] = bind_lists(frame, CLUSTERS) if has_lamps else {}
        switches = {**UNPACKED, "has_lamps": has_lamps}
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
                    switches={**switches, "shader": max(number, 0)},
                )
                clear = None
            return
        targets["depth"].copy_to(targets["depth copy"])
        own["depth"] = targets["depth copy"]
        depth, background = targets["depth"], frame.background
        draw_full_screen(frame, PackedShading, frame.image, own, depth=depth, clear=background, switches=switches)
