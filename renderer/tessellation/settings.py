"""The choice of how small triangles are."""

from __future__ import annotations

from dataclasses import dataclass

from renderer import rules
from rhi import refuse


@dataclass(frozen=True, slots=True)
class TessellationSettings:
    """Settings of the size of height fields' triangles.

    Attributes:
        edge_pixels: the length in pixels that edges are split down to, where the heights are fine enough. In the middle
            of the image no edge is longer; off the middle, at an angle a to the camera's direction, it is at most
            1 / cos(a) times as long. Half the length gives up to four times as many triangles.

        unseen: edges out of view may be this many times as long, 1 or more: they only cast shadows, and are there when
            the eye turns.

    Raises:
        ValidationError `tessellation-edge`: a length that isn't above 0 and finite, or `unseen` below 1.
    """

    edge_pixels: float = 8.0
    unseen: float = 8.0

    def __post_init__(self) -> None:
        rules.check_kinds(self, rules.BAD_EDGE)
        if not 0.0 < self.edge_pixels < float("inf"):
            refuse(rules.BAD_EDGE, "TessellationSettings(edge_pixels=...)", self.edge_pixels, "above 0, finite")
        if not 1.0 <= self.unseen < float("inf"):
            refuse(rules.BAD_EDGE, "TessellationSettings(unseen=...)", self.unseen, "1 or more, finite")
