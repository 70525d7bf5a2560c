"""Forward shading with lists of lights for tiles or clusters.

`forward_plus` (Harada, McKee and Yang 2012; Thatcher 2014) draws depth first, lists the lights that reach the surfaces
of each tile, and then draws the scene lit by the lists. No hidden fragment is lit. `clustered` (Olsson, Billeter and
Assarsson 2012) lists the lights of clusters, which needs no depth, so the scene is drawn once.

With several samples per pixel, a surface may cover samples of a tile, but no pixel's centre: depth of one sample
doesn't bound what is lit. So tiles then have no ends in depth: their lists hold all lights that reach any place of
the tile, as those of clusters do.

Without point and spot lights in view there is nothing to list, and both are plain forward shading.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import Frame, Needs, Pass
from renderer.techniques.parts.cell_lists import CLUSTERS, TILES, LightCells, by_cells, list_pass
from renderer.techniques.parts.finish import draw_once, forward_passes
from renderer.techniques.parts.variants import list_lamps


class ForwardPlus:
    """Draws depth, lists the lights of tiles, and draws what is seen, lit by its tile's lights."""

    name: Final = "forward_plus"

    def __init__(self, samples: int = 1, *, tiles: LightCells = TILES) -> None:
        """Choose the number of samples per pixel, as for `Forward`, and the tiles whose lights are listed."""
        self.samples = samples
        self.cells = tiles

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `depth`, `light lists` and `forward`, with several samples also `depth samples` and
        `resolve`; those of `Forward` without lights to list."""
        if not list_lamps(needs):
            return forward_passes(needs, samples=self.samples)
        return draw_once(
            needs,
            by_cells(self.cells),
            "draws what is seen, lit by its tile's lights",
            samples=self.samples,
            depth_first="lights are listed for what is seen" if self.samples == 1 else "finds what is seen",
            lists=(list_pass(needs, self.cells, depth="depth" if self.samples == 1 else None),),
        )  # transparent surfaces have the lists of their objects: those of tiles end at opaque surfaces


class Clustered:
    """Lists the lights of clusters, and draws the scene lit by them."""

    name: Final = "clustered"

    def __init__(self, samples: int = 1, *, depth_first: bool = False, clusters: LightCells = CLUSTERS) -> None:
        """Choose the number of samples per pixel, as for `Forward`, and the clusters whose lights are listed. With
        `depth_first`, a pass of its own draws depth before, so that no hidden fragment is lit."""
        self.samples = samples
        self.depth_first = depth_first
        self.cells = clusters

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `light lists` and `forward`, and before them `depth` if that is drawn first; those of
        `Forward` without lights to list."""
        if not list_lamps(needs):
            return forward_passes(needs, samples=self.samples)
        lighting = by_cells(self.cells)
        return draw_once(
            needs,
            lighting,
            "draws the visible objects, lit by their clusters' lights",
            samples=self.samples,
            depth_first="no hidden fragment is lit" if self.depth_first else "",
            lists=(list_pass(needs, self.cells),),
            transparent=lighting,
        )
