"""Shadow maps: what they show, when they are drawn, and how shaders read them."""

from renderer.shadows.maps import MapReport, ShadowMaps, shadow_passes
from renderer.shadows.receiver import FILTERS, ShadowReceiver
from renderer.shadows.settings import ShadowFilter, ShadowSettings

__all__ = [
    "FILTERS",
    "MapReport",
    "ShadowFilter",
    "ShadowMaps",
    "ShadowReceiver",
    "ShadowSettings",
    "shadow_passes",
]
