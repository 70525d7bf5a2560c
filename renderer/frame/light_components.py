"""Components of light: parts of what surfaces send to the eye, each of which can be drawn alone.

The ambient, diffuse, specular and emitted components add up to all light. A component is a choice between frames:
what it leaves out isn't an effect of the frame, so that its passes aren't drawn, and its shaders leave it out by
switches.
"""

from __future__ import annotations

from typing import Final

from rhi.errors.choices import Choice


class LightComponent(Choice):
    """The part of the light of surfaces that a frame draws. Without the others there is no air either: haze and fog are
    left out, and the background is black."""

    ALL = "all"
    """All of the light, with the background and the air."""
    DIFFUSE = "diffuse"
    """What surfaces scatter of directional and local lights."""
    SPECULAR = "specular"
    """What they mirror of these lights."""
    AMBIENT = "ambient"
    """Light of the sky and the ground, or of an environment, with its occlusion."""
    EMISSIVE = "emissive"
    """What surfaces emit."""
    SUN = "sun"
    """What they scatter and mirror of directional lights."""
    ALBEDO = "albedo"
    """Their base colour, without a light or tones."""

    __hash__ = object.__hash__

    @property
    def has_directional_lights(self) -> bool:
        """True if directional lights have a part in it."""
        return self in (
            LightComponent.ALL,
            LightComponent.DIFFUSE,
            LightComponent.SPECULAR,
            LightComponent.SUN,
        )

    @property
    def has_local_lights(self) -> bool:
        """True if local lights have a part in it."""
        return self.has_directional_lights and self is not LightComponent.SUN

    @property
    def switches(self) -> dict[str, bool]:
        """The switches of shaders that differ from their values with all light."""
        if self is LightComponent.ALL:
            return {}
        is_albedo = self is LightComponent.ALBEDO
        return {
            "has_ambient_light": self is LightComponent.AMBIENT,
            "has_diffuse_light": self is not LightComponent.SPECULAR,
            "has_specular_light": self is not LightComponent.DIFFUSE,
            "is_albedo": is_albedo,
        } | ({"keeps_light": True} if is_albedo else {})


COMPONENTS: Final = {
    component.value: component for component in LightComponent if component is not LightComponent.ALL
}
"""The components of light by their names, as `--show` has them."""
