"""Settings of how small the triangles of surfaces are."""

from __future__ import annotations

from dataclasses import dataclass

from renderer import rules
from rhi import refuse


@dataclass(frozen=True, slots=True)
class TessellationSettings:
    """Settings of the size of tessellated triangles.

    Attributes:
        edge_pixels: the length in pixels that edges are split down to, where the vertices are fine enough. In
            the middle of the image no edge is longer; off the middle, at an angle a to the camera's
            direction, it is at most 1 / cos(a) times as long. Half the length gives up to four times as many
            triangles.

        out_of_view_scale: edges out of view may be this many times as long, 1 or more: they only cast
            shadows, and are there when the eye turns.

    Raises:
        ValidationError `tessellation-edge`: a length that isn't above 0 and finite, or `out_of_view_scale`
        below 1.
    """

    edge_pixels: float = 8.0
    out_of_view_scale: float = 8.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_EDGE)
        if not 0.0 < self.edge_pixels < float("inf"):
            refuse(
                rules.BAD_EDGE, "TessellationSettings(edge_pixels=...)", self.edge_pixels, "above 0, finite"
            )
        if not 1.0 <= self.out_of_view_scale < float("inf"):
            call, scale = "TessellationSettings(out_of_view_scale=...)", self.out_of_view_scale
            refuse(rules.BAD_EDGE, call, scale, "1 or more, finite")
