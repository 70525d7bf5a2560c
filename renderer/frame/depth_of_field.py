"""Settings of the accuracy of depth of field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer import rules
from renderer.frame.drawing import FARTHEST
from renderer.frame.occlusion import MOST_PIXELS, NEAREST_DEPTH
from renderer.scene import Camera, Scene
from rhi import refuse
from rhi.math import distance_at_depth, is_parallel

_MIN_SAMPLES: Final = 8
_MAX_SAMPLES: Final = 1024


@dataclass(frozen=True, slots=True)
class DepthOfFieldSettings:
    """Settings of the accuracy of depth of field.

    Attributes:
        samples: pixels that a disc is the mean of, 8 to 1024; small discs take fewer.
        max_radius: the radius of the largest disc, in heights of the image, from 0.001 to 0.5.
        bits: those of a channel of the image while it holds light, 16 or 32.
    """

    samples: int = 64
    max_radius: float = 0.05
    bits: int = 16

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_FOCUS)
        if not _MIN_SAMPLES <= self.samples <= _MAX_SAMPLES:
            allowed = f"a whole number from {_MIN_SAMPLES} to {_MAX_SAMPLES}"
            refuse(rules.BAD_FOCUS, "DepthOfFieldSettings(samples=...)", self.samples, allowed)
        if not 0.001 <= self.max_radius <= 0.5:
            refuse(
                rules.BAD_FOCUS, "DepthOfFieldSettings(max_radius=...)", self.max_radius, "from 0.001 to 0.5"
            )
        if self.bits not in (16, 32):
            refuse(rules.BAD_FOCUS, "DepthOfFieldSettings(bits=...)", self.bits, "16 or 32")


DEFAULT_FOCUS: Final = DepthOfFieldSettings()
"""Depth of field as frames have it unless told otherwise."""


def is_blur_seen(scene: Scene, camera: Camera) -> bool:
    """Return whether a disc may be as wide as a pixel: at the near plane or the far plane, in the largest image."""
    depth_of_field, projection = scene.depth_of_field, camera.projection
    if depth_of_field is None:
        return False
    focus = 1.0 / depth_of_field.focus_distance
    ends = (NEAREST_DEPTH[projection.depth], FARTHEST[projection.depth])
    distances = [distance_at_depth(projection.matrix, depth) for depth in ends]
    if is_parallel(projection):
        largest = max(abs(distance * focus - 1.0) for distance in distances)
    else:
        largest = max(abs(1.0 / distance - focus) for distance in distances)
    pixels = depth_of_field.aperture_radius * largest * float(abs(projection.matrix[1, 1])) * MOST_PIXELS
    return pixels >= 1.0
