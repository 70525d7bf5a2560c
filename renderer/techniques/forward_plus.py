"""Forward shading with lists of lights for tiles or clusters.

`forward_plus` (Harada, McKee and Yang 2012; Thatcher 2014) draws depth first, lists the lights that reach the surfaces
of each tile, and then draws the scene lit by the lists. No hidden fragment is lit. `clustered` (Olsson, Billeter and
Assarsson 2012) lists the lights of clusters, which needs no depth, so the scene is drawn once.

Without point and spot lights in view there is nothing to list, and both are plain forward shading.
"""

from __future__ import annotations

from typing import Final

from renderer.frame import Frame, Needs, Pass
from renderer.techniques.parts.cell_lists import (
    CLUSTERS,
    TILES,
    LightCells,
    by_cells,
    list_pass,
)
from renderer.techniques.parts.depth import depth_pass
from renderer.techniques.parts.finish import finish_image, forward_passes
from renderer.techniques.parts.variants import FORWARD, list_lamps, lit_pass


class ForwardPlus:
    """Draws depth, lists the lights of tiles, and draws what is seen, lit by its tile's lights."""

    name: Final = "forward_plus"

    def __init__(self, *, tiles: LightCells = TILES) -> None:
        """Choose the tiles whose lights are listed."""
        self.cells = tiles

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `depth`, `light lists` and `forward`; only the last one without lights to list."""
        if not list_lamps(needs):
            return forward_passes(needs)
        because = "draws what is seen, lit by its tile's lights"
        return (
            depth_pass("lights are listed for what is seen"),
            list_pass(needs, self.cells, depth="depth"),
            lit_pass(needs, by_cells(self.cells), because, after_depth=True),
            *finish_image(needs, FORWARD),  # the lists of tiles end at opaque surfaces
        )


class Clustered:
    """Lists the lights of clusters, and draws the scene lit by them."""

    name: Final = "clustered"

    def __init__(self, *, depth_first: bool = False, clusters: LightCells = CLUSTERS) -> None:
        """Choose the clusters whose lights are listed. With `depth_first`, a pass of its own draws depth before, so
        that no hidden fragment is lit."""
        self.depth_first = depth_first
        self.cells = clusters

    def declare(self, needs: Needs) -> tuple[Pass[Frame], ...]:
        """Return the passes `light lists` and `forward`, and before them `depth` if that is drawn first; only the last
        one without lights to list."""
        if not list_lamps(needs):
            return forward_passes(needs)
        lighting, because = by_cells(self.cells), "draws the visible objects, lit by their clusters' lights"
        return (
            *([depth_pass("no hidden fragment is lit")] if self.depth_first else []),
            list_pass(needs, self.cells),
            lit_pass(needs, lighting, because, after_depth=self.depth_first),
            *finish_image(needs, lighting),
        )
