"""Shaders of the renderer, in the shading language: shared structs, the lighting model, one class a technique."""

from renderer.shaders.forward import PARTS, ForwardShader, forward_variant
from renderer.shaders.lighting import (
    ambient_light,
    attenuation,
    directional_light,
    hemisphere,
    point_light,
    reflected_light,
    safe_normalize,
    spot_light,
    tone_map,
)
from renderer.shaders.structs import (
    Ambient,
    DirectionalLight,
    Haze,
    Material,
    Object,
    PointLight,
    SpotLight,
    Surface,
    Varying,
    Vertex,
    View,
)

__all__ = [
    "PARTS",
    "Ambient",
    "DirectionalLight",
    "ForwardShader",
    "Haze",
    "Material",
    "Object",
    "PointLight",
    "SpotLight",
    "Surface",
    "Varying",
    "Vertex",
    "View",
    "ambient_light",
    "attenuation",
    "directional_light",
    "forward_variant",
    "hemisphere",
    "point_light",
    "reflected_light",
    "safe_normalize",
    "spot_light",
    "tone_map",
]
