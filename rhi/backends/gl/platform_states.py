"""States that only the GL backend supports; `capabilities.platform_states` lists them."""

from __future__ import annotations

from rhi.contract.states import PlatformState


class DepthClamp(PlatformState):
    """Clamping of depth beyond the viewport's range, instead of clipping triangles at the near
    and the far plane: shadow casters in front of the light's near plane still cast."""

    OFF = "off"
    ON = "on"

    @classmethod
    def platform(cls) -> str:
        return "gl"
