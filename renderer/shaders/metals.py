"""The metallic-roughness model of glTF 2.0: GGX, Smith and Schlick (specification, appendix B).

With the half vector h between light l and eye v, the roughness r and α = r²:

- `D = α² / (π ((n·h)² (α² - 1) + 1)²)`, how much of the surface mirrors l to v (Trowbridge and Reitz, GGX);
- `V = 1 / ((n·l + √(α² + (1 - α²) (n·l)²)) (n·v + √(α² + (1 - α²) (n·v)²)))`, what of it both see (Smith);
- `F = f0 + (1 - f0) (1 - v·h)⁵`, what of it is mirrored (Schlick); what isn't is scattered, in metals
  nothing;
- `f0 = mix(0.04, base, metallic)` and `diffuse = mix(base, 0, metallic)`.

A light of irradiance E reflects `E n·l ((1 - F) diffuse + F π D V)`. As in the specular model, colours are
those of fully lit surfaces, so no π is left.

With p = (1 - v·h)⁵ the bracket is `(1 - p) · (1 - f0) diffuse + (1 - p) π D V · f0 + p π D V`: three
**terms** that don't depend on colours, two of them times a colour of the material. So a light pre-pass can
collect them, and a `SurfacePoint` has the two colours.

`(n·h)² (α² - 1) + 1` loses all digits of a sharp highlight in float32; it is the same as `|n×h|² + α²
(n·h)²`, which loses none. Where a mapped normal looks away from the eye and n·h is negative, D isn't cut to
0, which would show as an edge.

**Anisotropic** materials have a roughness α_t along a tangent t and α_b along the bitangent b (Burley 2012; glTF's
KHR_materials_anisotropy, α_t = mix(α, 1, anisotropy²) and α_b = α):

- `D = 1 / (π α_t α_b ((t·h)² / α_t² + (b·h)² / α_b² + (n·h)²)²)`;
- of V, each root is `√(α_t² (t·l)² + α_b² (b·l)² + (n·l)²)`.

With α = √(α_t α_b) and a stretch s = √(α_t / α_b), the bitangent falls out: (b·h)² is `|n×h|² - (t·h)²`.

A roughness below `MIN_ROUGHNESS` counts as that: the highlight of a light without size is white there anyway,
and normals that are stored in 2 × 16 bits would no longer do.
"""

from __future__ import annotations

from typing import Final

from renderer.light_kinds.incidence import Incidence
from renderer.shaders.lighting import hemisphere, safe_normalize
from renderer.shaders.structs import Ambient, SurfacePoint
from rhi.shading import abs, cross, dot, exp2, function, length, max, min, mix, reflect, saturate, sqrt, vec3

MIN_ROUGHNESS: Final = 0.1
"""The least roughness. Its highlight is about that of a shininess of 20,000."""


@function
def encode_roughness(roughness: float) -> float:
    """Return the shininess that encodes a roughness in a `SurfacePoint` of this model."""
    return -max(roughness, MIN_ROUGHNESS)


@function
def metallic_surface(surface: SurfacePoint, metallic: float, roughness: float) -> SurfacePoint:
    """Return a surface of this model from one whose `base_color` is the material's."""
    base = surface.base_color
    f0 = mix(vec3(0.04), base, metallic)
    surface.specular_color = f0
    surface.base_color = base * (1.0 - metallic) * (1.0 - f0)
    surface.shininess = encode_roughness(roughness)
    return surface


@function
def metallic_terms(surface: SurfacePoint, to_light: vec3) -> vec3:
    """Return the factors by which the surface's base colour, its specular colour and white reflect light from
    the unit direction `to_light`, in front of it."""
    halfway = safe_normalize(to_light + surface.to_eye)
    along = dot(surface.normal, halfway)
    beyond = 1.0 - saturate(dot(surface.to_eye, halfway))
    p = beyond * beyond
    p = p * p * beyond
    roughness = surface.shininess * surface.shininess
    alpha = roughness * roughness
    across = cross(surface.normal, halfway)
    spread = max(dot(across, across) + alpha * along * along, alpha)
    lit = saturate(dot(surface.normal, to_light))
    seen = abs(dot(surface.normal, surface.to_eye))
    masked = (lit + sqrt(alpha + (1.0 - alpha) * lit * lit)) * (
        seen + sqrt(alpha + (1.0 - alpha) * seen * seen)
    )
    lobe = alpha / (spread * spread * masked)
    return vec3(1.0 - p, lobe * (1.0 - p), lobe * p)


@function
def stretch_surface(surface: SurfacePoint, anisotropy: vec3) -> SurfacePoint:
    """Return a surface of this model whose highlights are drawn out along a direction, by the square of its length of
    0 to 1: the roughness there is mixed with 1. All else then sees the round lobe with as much area."""
    strength = saturate(length(anisotropy))
    flat = anisotropy - surface.normal * dot(surface.normal, anisotropy)
    alpha = surface.shininess * surface.shininess
    along = mix(alpha, 1.0, strength * strength)
    surface.stretch = safe_normalize(flat) * (sqrt(along / alpha) - 1.0)
    surface.shininess = -sqrt(sqrt(along * alpha))
    return surface


@function
def anisotropic_terms(surface: SurfacePoint, to_light: vec3) -> vec3:
    """Return the factors of `metallic_terms` for a surface whose highlights are drawn out."""
    halfway = safe_normalize(to_light + surface.to_eye)
    beyond = 1.0 - saturate(dot(surface.to_eye, halfway))
    p = beyond * beyond
    p = p * p * beyond
    length_less_1 = length(surface.stretch)
    tangent = surface.stretch / max(length_less_1, 1e-6)
    squared = (1.0 + length_less_1) * (1.0 + length_less_1)
    excess = squared - 1.0 / squared
    roughness = surface.shininess * surface.shininess
    alpha = roughness * roughness
    across = cross(surface.normal, halfway)
    along = dot(surface.normal, halfway)
    side = dot(tangent, halfway)
    spread = max(dot(across, across) * squared - side * side * excess + alpha * along * along, alpha)
    lit = saturate(dot(surface.normal, to_light))
    lit_side = dot(tangent, to_light)
    seen = abs(dot(surface.normal, surface.to_eye))
    seen_side = dot(tangent, surface.to_eye)
    lit_width = (1.0 - lit * lit) / squared + lit_side * lit_side * excess
    seen_width = (1.0 - seen * seen) / squared + seen_side * seen_side * excess
    masked = (lit + sqrt(alpha * lit_width + lit * lit)) * (seen + sqrt(alpha * seen_width + seen * seen))
    lobe = alpha / (spread * spread * masked)
    return vec3(1.0 - p, lobe * (1.0 - p), lobe * p)


@function
def reflected_light_metallic(surface: SurfacePoint, light: Incidence) -> vec3:
    """Return the light that a surface of this model reflects to the eye."""
    facing = dot(surface.normal, light.direction)
    if facing <= 0.0:
        return vec3(0.0)
    terms = metallic_terms(surface, light.direction)
    color = surface.base_color * terms.x + surface.specular_color * terms.y + terms.z
    return color * light.irradiance * facing


@function
def ambient_light_metallic(surface: SurfacePoint, ambient: Ambient) -> vec3:
    """Return the ambient light that a surface of this model sends to the eye, scattered and mirrored.

    glTF leaves this to the application. What is mirrored is weighted by Karis's fit of the model over all
    directions (Physically Based Shading on Mobile, 2014), and comes from about the mirrored direction: the
    rougher, the nearer to the normal.
    """
    roughness = -surface.shininess
    seen = saturate(dot(surface.normal, surface.to_eye))
    x = 1.0 - roughness
    bend = min(x * x, exp2(-9.28 * seen)) * x + 0.0425 - 0.0275 * roughness
    scale = -1.04 * bend + 1.04 - 0.572 * roughness
    offset = 1.04 * bend - 0.04 + 0.022 * roughness
    beyond = mix(reflect(-surface.to_eye, surface.normal), surface.normal, roughness * roughness)
    mirrored = surface.specular_color * scale + offset
    scattered = surface.base_color * hemisphere(ambient, surface.normal)
    return (scattered + mirrored * hemisphere(ambient, beyond)) * surface.occlusion
