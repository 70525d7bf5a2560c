"""Ambient occlusion: surfaces nearby take ambient light away from each other, in corners, folds and narrow
places.

Of the light that would arrive from a direction, a surface at the distance d in that direction takes the share
`max(0, 1 - (d / radius)²)`. So what is left is, with V of the nearest surface in each direction ω,

    1 - 1/π ∫ V(ω) cos θ dω                V = max(0, 1 - (d / radius)²)

over the hemisphere of the surface: all of it on an open plane, and less the more of the hemisphere is taken.
The radius is where light that a room's walls scatter makes up for what they take (Méndez-Feliu and Sbert 2009
call this obscurance).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer import rules
from rhi.errors import refuse

_MAX_RADIUS: Final = 1e6


@dataclass(frozen=True, slots=True)
class AmbientOcclusion:
    """Ambient occlusion of all opaque surfaces of a scene by each other.

    Attributes:
        radius: the distance in metres from which on surfaces take no light; more than 0, at most 10⁶.
    """

    radius: float = 1.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_EFFECT)
        if not 0.0 < self.radius <= _MAX_RADIUS:
            refuse(
                rules.BAD_EFFECT,
                "AmbientOcclusion(radius=...)",
                self.radius,
                f"more than 0, at most {_MAX_RADIUS:g}",
            )
