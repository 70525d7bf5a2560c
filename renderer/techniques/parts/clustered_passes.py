"""The passes of clustered forward shading, for `clustered`, and for techniques whose buffers lack what a material
needs."""

from __future__ import annotations

from renderer.frame import Frame, FrameEffects, FramePass
from renderer.techniques.parts.finish import draw_once, forward_passes
from renderer.techniques.parts.light_list_reader import (
    CLUSTERS,
    ClusterSettings,
    light_list_pass,
    lit_by_cells,
)
from renderer.techniques.parts.variants import local_light_effects


def clustered_passes(
    effects: FrameEffects, *, samples: int = 1, depth_first: str = "", cells: ClusterSettings = CLUSTERS
) -> tuple[FramePass[Frame], ...]:
    """The passes `light lists` and `forward`. Without local lights, those of forward shading.

    Args:
        samples: samples per pixel.
        depth_first: why depth is drawn before; empty if it isn't.
        cells: the clusters whose lights are listed.
    """
    if not local_light_effects(effects):
        return forward_passes(effects, samples=samples)
    lighting = lit_by_cells(cells)
    return draw_once(
        effects,
        lighting,
        "draws the visible objects, lit by their clusters' lights",
        samples=samples,
        depth_first=depth_first,
        lists=(light_list_pass(effects, cells),),
        transparent=lighting,
    )
