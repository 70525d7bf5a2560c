"""The lighting model: Blinn-Phong, in linear light.

The reflected light is `base + specular · (s + 8) / 8 · (n · h)^s` per unit of irradiance, times `n · l`: the
factor keeps a highlight's energy as its exponent s grows (Akenine-Möller, Haines and Hoffman, Real-Time
Rendering, 3rd ed., 7.6). Colours are those of fully lit surfaces, so no π appears. Every function is finite
for every finite input: directions of length 0, lights at the surface, ranges and cones of 0.
"""

from __future__ import annotations

from typing import Final

from renderer.light_kinds.incidence import Incidence, is_within_range
from renderer.light_kinds.incidence import safe_normalize as safe_normalize
from renderer.shaders.structs import Ambient, Haze, SurfacePoint
from rhi.shading import dot, exp, function, length, mix, pow, reflect, saturate, vec3

MAX_HALF_FLOAT: Final = 65504.0
"""The largest half float; beyond it is infinity. It is white in each image."""


@function
def highlight(surface: SurfacePoint, to_light: vec3) -> float:
    """Return the share of the light from the unit direction `to_light` that is mirrored to the eye, for a
    specular colour of 1."""
    halfway = safe_normalize(to_light + surface.to_eye)
    lobe = pow(saturate(dot(surface.normal, halfway)), surface.shininess)
    return lobe * (surface.shininess + 8.0) * 0.125


@function
def reflected_light(surface: SurfacePoint, light: Incidence) -> vec3:
    """Return the light that the surface reflects to the eye."""
    facing = dot(surface.normal, light.direction)
    if facing <= 0.0:
        return vec3(0.0)
    specular = surface.specular_color * highlight(surface, light.direction)
    return (surface.base_color + specular) * light.irradiance * facing


@function
def in_range(surface: SurfacePoint, position: vec3, range: float) -> bool:
    """Return whether the surface is within a light's range. Test this before reading the rest of the
    light."""
    return is_within_range(surface.position, position, range)


@function
def hemisphere(ambient: Ambient, direction: vec3) -> vec3:
    """Return the ambient light from the unit `direction`."""
    return mix(ambient.ground, ambient.sky, 0.5 + 0.5 * direction.y)


@function
def ambient_light(surface: SurfacePoint, ambient: Ambient, rim_strength: float, rim_power: float) -> vec3:
    """Return the ambient light that the surface sends to the eye, scattered and mirrored.

    It mirrors `specular + strength · (1 - n · v)^power` of the light from the mirrored direction: the Fresnel
    rim term (Duality Engine 4.2.2), with the ambient hemisphere as surroundings.
    """
    mirrored = surface.specular_color
    if rim_strength > 0.0:
        grazing = 1.0 - saturate(dot(surface.normal, surface.to_eye))
        mirrored = mirrored + vec3(rim_strength * pow(grazing, rim_power))
    beyond = reflect(-surface.to_eye, surface.normal)
    scattered = surface.base_color * hemisphere(ambient, surface.normal)
    return (scattered + mirrored * hemisphere(ambient, beyond)) * surface.occlusion


@function
def apply_haze(color: vec3, path: vec3, haze: Haze) -> vec3:
    """Return a final colour as haze on the `path` between it and the eye fades it to its own."""
    return mix(haze.color, color, exp(-haze.density * length(path)))
