"""Depth of field: an aperture of a finite radius shows one distance sharply, and all else as discs.

The optics are thin: all light that passes the aperture from a point at the distance `focus_distance` f along the view
meets in a point of the image. From the distance d it fills a disc, the circle of confusion, whose radius in metres at
that distance is

    aperture_radius · |d / f - 1|

On the screen it grows without bound towards the eye, and far away it approaches `aperture_radius / f` of the distance.
A camera of focal length F and f-number N has an aperture radius of F / (2 N).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer import rules
from rhi.errors import refuse

_LARGEST: Final = 1e6
_NEAREST: Final = 1e-6


@dataclass(frozen=True, slots=True)
class DepthOfField:
    """The focus and the aperture of all cameras that look at a scene.

    Attributes:
        focus_distance: the distance along the view, in metres, that is sharp; from 10⁻⁶ to 10⁶.
        aperture_radius: the radius of the aperture in metres; more than 0, at most 10⁶.
    """

    focus_distance: float = 10.0
    aperture_radius: float = 0.02

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_EFFECT)
        if not _NEAREST <= self.focus_distance <= _LARGEST:
            call = "DepthOfField(focus_distance=...)"
            refuse(rules.BAD_EFFECT, call, self.focus_distance, f"from {_NEAREST:g} to {_LARGEST:g}")
        if not 0.0 < self.aperture_radius <= _LARGEST:
            call = "DepthOfField(aperture_radius=...)"
            refuse(rules.BAD_EFFECT, call, self.aperture_radius, f"more than 0, at most {_LARGEST:g}")
