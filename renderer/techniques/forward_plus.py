"""Forward shading with lists of lights for tiles or clusters.

`forward_plus` (Harada, McKee and Yang 2012; Thatcher 2014) draws depth first, lists the lights that reach the
surfaces of each tile, and then draws the scene lit by the lists. No hidden fragment is lit. `clustered`
(Olsson, Billeter and Assarsson 2012) lists the lights of clusters, which needs no depth, so the scene is
drawn once.

With several samples per pixel, a surface may cover samples of a tile, but no pixel's centre: depth of one
sample doesn't bound what is lit. So tiles then have no ends in depth: their lists hold all lights that reach
any place of the tile, as those of clusters do.

Transparent surfaces are lit by the lists of their objects. With `tiled_transparency` they have lists of tiles of
their own (Thatcher 2014, 5.2), from the near plane to the tile's farthest opaque surface.

Without point and spot lights in view there is nothing to list, and both are plain forward shading.
"""

from __future__ import annotations

from typing import Final

from renderer import rules
from renderer.frame import Effect, Frame, FrameEffects, FramePass
from renderer.techniques.parts.clustered_passes import clustered_passes
from renderer.techniques.parts.depth import DEPTH_SHADERS
from renderer.techniques.parts.finish import FINISH_SHADERS, draw_once, forward_passes
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    TILES,
    ClusterSettings,
    ForwardByCells,
    TilesInFront,
    light_list_pass,
    lit_by_cells,
)
from renderer.techniques.parts.variants import FORWARD, local_light_effects
from rhi.shading import Shader


class ForwardPlus:
    """Draws depth, lists the lights of tiles, and draws the visible surfaces lit by the list of their
    tile."""

    name: Final = "forward_plus"
    shaders: Final[tuple[type[Shader], ...]] = (
        ForwardByCells,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self, samples: int = 1, *, tiles: ClusterSettings = TILES, tiled_transparency: bool = False
    ) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`; `tiles` are the tiles whose
        lights are listed. `tiled_transparency` lights transparent surfaces by lists of tiles instead of those
        of their objects."""
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "ForwardPlus(samples=...)", samples)
        self.cells = tiles
        self.tiled_transparency = tiled_transparency

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `depth`, `light lists` and `forward`; with several samples also `depth samples` and
        `resolve`. `tiled_transparency` adds `transparent light lists` if a transparent object is in view. Without
        local lights, those of `Forward`."""
        if not local_light_effects(effects):
            return forward_passes(effects, samples=self.samples)
        depth = "depth" if self.samples == 1 else None
        lists, transparent = [light_list_pass(effects, self.cells, depth=depth)], FORWARD
        if self.tiled_transparency and Effect.TRANSPARENCY in effects.enabled:
            if depth is None:  # tiles without ends in depth hold for all surfaces
                transparent = lit_by_cells(self.cells)
            else:
                in_front, name = TilesInFront(self.cells), "transparent light lists"
                lists.append(light_list_pass(effects, in_front, depth=depth, name=name))
                transparent = lit_by_cells(in_front, name)
        return draw_once(
            effects,
            lit_by_cells(self.cells),
            "draws what is seen, lit by its tile's lights",
            samples=self.samples,
            depth_first="lights are listed for what is seen" if self.samples == 1 else "finds what is seen",
            lists=tuple(lists),
            transparent=transparent,
        )


class Clustered:
    """Lists the lights of clusters, and draws the scene lit by the lists."""

    name: Final = "clustered"
    shaders: Final[tuple[type[Shader], ...]] = (
        ForwardByCells,
        *DEPTH_SHADERS,
        *FINISH_SHADERS,
    )
    """The shaders of its passes: a draw's shader is one of them, or several combined."""

    def __init__(
        self, samples: int = 1, *, depth_first: bool = False, clusters: ClusterSettings = CLUSTERS
    ) -> None:
        """`samples` is the number of samples per pixel, as for `Forward`; `clusters` are the clusters
        whose lights are listed. `depth_first` draws depth in a pass before, so that no hidden fragment is
        lit."""
        self.samples = rules.check_count(rules.BAD_TECHNIQUE, "Clustered(samples=...)", samples)
        self.depth_first = depth_first
        self.cells = clusters

    def declare(self, effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
        """The passes `light lists` and `forward`, with `depth` before them if `depth_first`. Without local
        lights, those of `Forward`."""
        reason = "no hidden fragment is lit" if self.depth_first else ""
        return clustered_passes(effects, samples=self.samples, depth_first=reason, cells=self.cells)
