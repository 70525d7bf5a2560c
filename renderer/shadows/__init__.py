"""Shadow maps: what they show, when they are drawn, and how shaders read them."""

from renderer.shadows.maps import MapReport, ShadowMaps, shadow_passes
from renderer.shadows.receiver import SHADOW_PARTS, ShadowReceiver
from renderer.shadows.settings import ShadowFilter, ShadowSettings

__all__ = [
    "SHADOW_PARTS",
    "MapReport",
    "ShadowFilter",
    "ShadowMaps",
    "ShadowReceiver",
    "ShadowSettings",
    "shadow_passes",
]
