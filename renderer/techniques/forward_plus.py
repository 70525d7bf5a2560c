"""Forward shading with lists of lights for tiles or clusters.

`forward_plus` (Harada, McKee and Yang 2012; Thatcher 2018) draws depth first, lists the lights that reach the surfaces
of each tile, and then draws the scene lit by the lists. No hidden fragment is lit. `clustered` (Olsson, Billeter and
Assarsson 2012) lists the lights of clusters, which needs no depth, so the scene is drawn once.

Without point and spot lights in view there is nothing to list, and both are plain forward shading.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, Final

from renderer.frame import DEPTH_FORMAT, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.pixels import PixelRays
from renderer.shaders.structs import SurfaceVarying
from renderer.techniques.cell_lists import (
    CLUSTERS,
    TILES,
    CellReader,
    LightCells,
    LightLists,
    bind_lists,
    list_pass,
)
from renderer.techniques.depth import draw_depth
from renderer.techniques.finish import finish_image
from renderer.techniques.forward import Forward, bind_lamps, bind_materials, find_forward, list_lamps
from renderer.techniques.forward_shader import ForwardShader, forward_variant
from renderer.techniques.full_screen import bind_rays
from rhi import DepthFunction, DepthWrite
from rhi.shading import Uniform, dot, ivec3

__rhi_internal__ = True


class LitByCells(CellReader, ForwardShader):
    """Lights a fragment by the lights of its cell instead of those of its object."""

    rays: Uniform[PixelRays]

    def find_lights(self, v: SurfaceVarying) -> ivec3:
        return self.find_cell_lights(dot(v.position, self.rays.forward))


class ForwardPlus:
    """Draws depth, lists the lights of tiles, and draws what is seen, lit by its tile's lights."""

    name: Final = "forward_plus"

    def __init__(self, *, cells: LightCells = TILES) -> None:
        """Choose the tiles whose lights are listed."""
        self.cells = cells

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `depth`, `light lists` and `forward`; only the last one without lights to list."""
        if not list_lamps(needs):
            return Forward().declare(needs)
        return (
            Pass(
                "depth",
                draw_depth,
                "lights are listed for what is seen",
                writes=(Target("depth", DEPTH_FORMAT),),
            ),
            list_pass(needs, self.cells, depth="depth"),
            Pass(
                "forward",
                lambda frame: draw_listed(frame, self.cells, after_depth=True),
                "draws what is seen, lit by its tile's lights",
                reads=("depth", "light lists"),
                writes=(needs.image,),
            ),
            # The lists of tiles end at opaque surfaces.
            *finish_image(needs, find_forward),
        )


class Clustered:
    """Lists the lights of clusters, and draws the scene lit by them."""

    name: Final = "clustered"

    def __init__(self, *, depth_first: bool = False, cells: LightCells = CLUSTERS) -> None:
        """Choose the clusters whose lights are listed. With `depth_first`, a pass of its own draws depth before, so
        that no hidden fragment is lit."""
        self.depth_first = depth_first
        self.cells = cells

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `light lists` and `forward`, and before them `depth` if that is drawn first; only the last
        one without lights to list."""
        if not list_lamps(needs):
            return Forward().declare(needs)
        image, depth = needs.image, Target("depth", DEPTH_FORMAT)
        before = (Pass("depth", draw_depth, "no hidden fragment is lit", writes=(depth,)),) if self.depth_first else ()
        return (
            *before,
            list_pass(needs, self.cells),
            Pass(
                "forward",
                lambda frame: draw_listed(frame, self.cells, after_depth=self.depth_first),
                "draws the visible objects, lit by their clusters' lights",
                reads=("depth", "light lists") if before else ("light lists",),
                writes=(image,) if before else (image, depth),
            ),
            *finish_image(needs, partial(find_listed, cells=self.cells), reads=("light lists",)),
        )


@cache
def cells_variant(parts: tuple[str, ...], *, has_sun: bool) -> type[ForwardShader]:
    """Return the forward shader with these parts, lit by the lights of cells."""
    return type(
        "LitByCells", (LitByCells, forward_variant(*parts, has_sun=has_sun)), {"__module__": __name__}
    )


def find_listed(
    frame: Frame, cells: LightLists
) -> tuple[type[ForwardShader], dict[str, Any]]:
    """Return the forward shader that is lit by the lights of cells, and its bindings."""
    (features, bindings), (more, lamps) = bind_materials(frame), bind_lamps(frame)
    shader = cells_variant((*features, *more), has_sun=frame.needs.has_sun)
    return shader, bindings | lamps | bind_lists(frame, cells) | bind_rays(frame)


def draw_listed(frame: Frame, cells: LightLists, *, after_depth: bool) -> None:
    """Draw the visible objects, lit by the lights of their cells; where depth was drawn before, only what is seen."""
    shader, bindings = find_listed(frame, cells)
    frame.draw_visible(
        TechniquePass(
            frame.device,
            frame.resources,
            frame.view,
            frame.program(shader),
            bindings,
            color=frame.image,
            depth=frame.targets["depth"],
            clear=frame.background,
            states=(DepthFunction.EQUAL, DepthWrite.OFF) if after_depth else (),
            clears=not after_depth,
        )
    )
