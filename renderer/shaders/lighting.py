"""The lighting model: Blinn-Phong, in linear light.

The reflected light is `base + specular · (s + 8) / 8 · (n · h)^s` per unit of irradiance, times `n · l`: the
factor keeps a highlight's energy as its exponent s grows (Akenine-Möller, Haines and Hoffman, Real-Time
Rendering, 3rd ed., 7.6). Colours are those of fully lit surfaces, so no π appears. Every function is finite for
every finite input: directions of length 0, lights at the surface, ranges and cones of 0.
"""

from __future__ import annotations

from typing import Final

from renderer.shaders.structs import (
    Ambient,
    DirectionalLight,
    Haze,
    Incidence,
    PointLight,
    SpotLight,
    SurfacePoint,
)
from rhi.shading import dot, exp, function, inversesqrt, length, max, min, mix, pow, reflect, saturate, vec3

BRIGHTEST: Final = 65504.0
"""The largest half float; beyond it is infinity. It is white in each image."""


@function
def safe_normalize(v: vec3) -> vec3:
    """Return `v` scaled to length 1. A zero vector stays (almost) zero, where `normalize` would give NaN."""
    return v * inversesqrt(max(dot(v, v), 1e-30))


@function
def highlight(surface: SurfacePoint, to_light: vec3) -> float:
    """Return how much of the light from the unit direction `to_light` is mirrored to the eye, for a specular color of
    1."""
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
def directional_incidence(light: DirectionalLight) -> Incidence:
    """Return the light of a directional light that arrives anywhere."""
    return Incidence(direction=-light.direction, irradiance=light.color * light.intensity)


@function
def attenuation(distance_squared: float, range: float) -> float:
    """Return 1 / d², windowed by (1 - (d / range)⁴)² to reach 0 at `range`, and bounded within a centimetre.

    The window is that of Karis, Real Shading in Unreal Engine 4 (2013).
    """
    share = distance_squared / max(range * range, 1e-20)
    window = saturate(1.0 - share * share)
    return window * window / max(distance_squared, 1e-4)


@function
def is_near(place: vec3, position: vec3, range: float) -> bool:
    """Return whether a place is within the range of a light at `position`."""
    to_light = position - place
    return dot(to_light, to_light) < range * range


@function
def in_range(surface: SurfacePoint, position: vec3, range: float) -> bool:
    """Return whether the surface is within a light's range. Test this before reading the rest of the light."""
    return is_near(surface.position, position, range)


@function
def point_incidence(position: vec3, light: PointLight) -> Incidence:
    """Return the light of a point light that arrives at a position; 0 beyond its range."""
    to_light = light.position - position
    distance_squared = dot(to_light, to_light)
    return Incidence(
        direction=safe_normalize(to_light),
        irradiance=light.color * (light.intensity * attenuation(distance_squared, light.range)),
    )


@function
def spot_incidence(position: vec3, light: SpotLight) -> Incidence:
    """Return the light of a spot light that arrives at a position: full inside the inner angle, squared between, and
    outside the outer angle 0, from no direction."""
    to_light = light.position - position
    distance_squared = dot(to_light, to_light)
    direction = safe_normalize(to_light)
    away = -dot(direction, light.direction)
    if away <= light.cos_outer:
        return Incidence(direction=vec3(0.0), irradiance=vec3(0.0))
    cone = saturate((away - light.cos_outer) / max(light.cos_inner - light.cos_outer, 1e-4))
    irradiance = light.color * (light.intensity * cone * cone * attenuation(distance_squared, light.range))
    return Incidence(direction=direction, irradiance=irradiance)


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
def through_haze(color: vec3, position: vec3, haze: Haze) -> vec3:
    """Return a final colour at `position`, relative to the eye, as haze between them fades it to its own."""
    return mix(haze.color, color, exp(-haze.density * length(position)))


@function
def tone_map(color: vec3) -> vec3:
    """Map linear light of any strength to linear 0…1 by Narkowicz's fit of the ACES filmic curve (2016)."""
    # 0.6 is the exposure of the fit; 1e4 is far beyond white and can be squared.
    color = min(color * 0.6, 1e4)
    return saturate((color * (2.51 * color + 0.03)) / (color * (2.43 * color + 0.59) + 0.14))
