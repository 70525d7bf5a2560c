"""Deferred+ (Doghramachi and Bucci, GPU Zen 2017): geometry is drawn once, without materials; each pixel's material is
evaluated afterwards, and lit by its cluster's lights in the same step.

1. `geometry` draws the packed geometry buffer (`packed_geometry`), as the visibility algorithm decides: with
   `two_pass`, first what the last frame's depth doesn't hide, then what this frame's depth doesn't hide.
2. `light lists` lists the lights of clusters.
3. `shading` reads each pixel's surface and material, filters the textures and adds up the light, in one pass over the
   screen. A depth test leaves out the pixels without a surface, before anything is shaded: a shader that discards them
   would cost llvmpipe as much as one that lights them. What the test leaves is placed by a copy of the depth.

With `multi_pass`, each material is shaded by draws of its own: `material ids` writes materials as depth, `rectangles`
finds where each is seen, and `shading` draws the rectangles with a depth test (`material_rectangles`).

So a hidden fragment costs its geometry alone, and textures are read once a pixel. Scenes with what the packed buffer
has no room for (unlike transforms of one material's textures, a second set of texture coordinates, colours of vertices)
are drawn as by `clustered_deferred`.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target
from renderer.shaders.pixels import distance_at, nearness_of, place_pixel
from renderer.shaders.structs import SurfacePoint
from renderer.techniques.cell_lists import CLUSTERS, CellReader, bind_lists, list_pass
from renderer.techniques.deferred_cells import ClusteredDeferred
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import bind_lamps, bind_shading, find_forward, list_lamps
from renderer.techniques.forward_plus import find_listed
from renderer.techniques.forward_shader import LampShader, find_parts
from renderer.techniques.full_screen import draw_full_screen
from renderer.techniques.material_rectangles import (
    RectangleShader,
    draw_rectangles,
    ids_pass,
    rectangles_pass,
)
from renderer.techniques.packed_geometry import PackedReader, bind_packed, can_pack, packed_pass
from renderer.techniques.scene_shader import ShadingShader
from rhi.shading import Shader, discard, fragment_coordinate, ivec2, vec3, vec4

__rhi_internal__ = True


class PackedShading(PackedReader, ShadingShader):  # type: ignore[misc]  # as `PackedReader`
    """Shades the pixels of the packed geometry buffer."""

    def fragment(self) -> vec4:
        place = fragment_coordinate().xy
        distance = distance_at(self.rays, nearness_of(self.rays, self.depth.load(ivec2(place)).x))
        position = place_pixel(self.rays, place, distance)
        v = self.read_varying(position)
        material = self.materials[v.material]
        surface = self.find_surface(v, material)
        color = self.shade(surface, material)
        color += self.local_light(surface, distance)
        return self.finish(color, position)

    def local_light(self, surface: SurfacePoint, distance: float) -> vec3:
        return vec3(0.0)


class PackedLamps(CellReader, LampShader, PackedShading):  # type: ignore[misc]  # as `PackedReader`
    """Adds the lights of clusters."""

    def local_light(self, surface: SurfacePoint, distance: float) -> vec3:
        return self.lamplight(surface, self.find_cell_lights(distance))


class PackedRectangles(RectangleShader, PackedShading):  # type: ignore[misc]  # as `PackedReader`
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
            return ClusteredDeferred().declare(needs)
        lists = (list_pass(needs, CLUSTERS),) if list_lamps(needs) else ()
        found = (ids_pass(), rectangles_pass()) if self.multi_pass else ()
        # A pass can't read the depth that it tests. Rectangles test `material ids`.
        copied = () if self.multi_pass else (Target("depth copy", DEPTH_FORMAT),)
        reads = ["packed", "depth"]
        reads += ["light lists"] if lists else []
        reads += ["material ids", "rectangles"] if self.multi_pass else []
        shading = Pass(
            "shading",
            self._shade,
            "evaluates each pixel's material and its light",
            reads=tuple(reads),
            writes=(needs.image, *copied),
        )
        if lists:
            lit_by_cells = partial(find_listed, cells=CLUSTERS)
            transparency = finish_image(needs, lit_by_cells, reads=("light lists",))
        else:
            transparency = finish_image(needs, find_forward)
        return (packed_pass(needs), *lists, *found, shading, *transparency)

    def _shade(self, frame: Frame) -> None:
        (features, bindings), (parts, lamps) = bind_shading(frame), bind_lamps(frame)
        readers, packed = bind_packed(frame)
        bindings |= packed | lamps
        if lamps:
            bindings |= bind_lists(frame, CLUSTERS)
        shader = shading_variant(
            (*features, *parts),
            readers,
            has_lamps=bool(lamps),
            has_sun=frame.needs.has_sun,
            multi_pass=self.multi_pass,
        )
        if self.multi_pass:
            draw_rectangles(frame, shader, bindings)
        else:
            targets, clear = frame.targets, frame.background
            targets["depth"].copy_to(targets["depth copy"])
            bindings["depth"] = targets["depth copy"]
            draw_full_screen(frame, shader, frame.image, bindings, depth=targets["depth"], clear=clear)


@cache
def shading_variant(
    parts: tuple[str, ...],
    readers: tuple[type[Shader], ...],
    *,
    has_lamps: bool,
    has_sun: bool,
    multi_pass: bool,
) -> type[Any]:
    """Return the shader of the last pass with these parts (`find_parts`), and these that read the buffer."""
    bases = [*find_parts(parts, has_sun=has_sun)]
    bases += [PackedRectangles] if multi_pass else []
    bases += readers
    bases.append(PackedLamps if has_lamps else PackedShading)
    return type("PackedShading", tuple(bases), {"__module__": __name__})
