"""Shadow maps: which casters they show, when they are drawn, and how shaders read them."""

from renderer.shadows.filters import FILTERS as FILTERS
from renderer.shadows.filters import filter_shader as filter_shader
from renderer.shadows.maps import MapReport as MapReport
from renderer.shadows.maps import ShadowMaps as ShadowMaps
from renderer.shadows.maps import shadow_passes as shadow_passes
from renderer.shadows.receiver import ShadowReceiver as ShadowReceiver
from renderer.shadows.shadow_settings import ShadowFilter as ShadowFilter
from renderer.shadows.shadow_settings import ShadowSettings as ShadowSettings
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
