"""Settings of the accuracy of ambient occlusion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer import rules
from renderer.scene import Camera, Scene
from rhi import refuse
from rhi.math import Depth, distance_at_depth, is_parallel

OCCLUSION: Final = "ambient_occlusion"
"""The resource that has the share of ambient light that reaches each pixel's surface."""
CONTACTS: Final = "contact_shadows"
"""The resource that has the share of the sun's light that what is near each pixel's surface lets through."""
MOST_PIXELS: Final = 32_768
"""The height of the largest image that any device draws."""
NEAREST_DEPTH: Final = {Depth.REVERSED: 1.0, Depth.STANDARD: 0.0}
"""The depth of the near plane."""
_MAX_SLICES: Final = 32
_MAX_STEPS: Final = 64


@dataclass(frozen=True, slots=True)
class OcclusionSettings:
    """Settings of the accuracy of ambient occlusion.

    Attributes:
        slices: directions that a pixel looks along, 1 to 32; each has two sides.
        steps: samples of depth on each side, 1 to 64.
        is_smooth: whether a pixel takes the mean of 4 × 4 pixels of its surface, which all look along other
            directions.
        bits: those that the result is stored with, 8 or 16.
    """

    slices: int = 2
    steps: int = 6
    is_smooth: bool = True
    bits: int = 8

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_OCCLUSION)
        for name, most in (("slices", _MAX_SLICES), ("steps", _MAX_STEPS)):
            value = getattr(self, name)
            if not 1 <= value <= most:
                call = f"OcclusionSettings({name}=...)"
                refuse(rules.BAD_OCCLUSION, call, value, f"a whole number from 1 to {most}")
        if self.bits not in (8, 16):
            refuse(rules.BAD_OCCLUSION, "OcclusionSettings(bits=...)", self.bits, "8 or 16")


DEFAULT_OCCLUSION: Final = OcclusionSettings()
"""Ambient occlusion as frames have it unless told otherwise."""


def is_occlusion_seen(scene: Scene, camera: Camera) -> bool:
    """Return whether the radius of ambient occlusion may be as long as a pixel: on a surface at the near plane,
    in the largest image."""
    if scene.ambient_occlusion is None:
        return False
    projection = camera.projection
    scale = float(abs(projection.matrix[1, 1])) * 0.5 * MOST_PIXELS
    if not is_parallel(projection):
        scale /= distance_at_depth(projection.matrix, NEAREST_DEPTH[projection.depth])
    return scene.ambient_occlusion.radius * scale >= 1.0
