"""Local lights that are spheres: point and spot lights whose light comes from a sphere of a radius around
their position.

The sphere shines as strongly as the point does from afar, I / d². Seen over an angle of sine σ = radius / d:

- **Scattered light** is exact (Snyder, Area Light Sources for Real-Time Graphics, 1996; Lagarde and de
  Rousiers, Moving Frostbite to PBR, 2014). As long as all of the sphere is above the horizon it is that of
  the point. Otherwise n·l is replaced by the cosine-weighted area that is above it. In and on the sphere σ
  counts as 1, and d as the radius.
- **Mirrored light** comes from a representative point (Karis, Real Shading in Unreal Engine 4, 2013): the one
  of the sphere that is nearest to the mirrored direction. So a highlight is flat over the sphere's image, and
  falls off around it. It has to be weaker for that, by the area of such a lobe over that of the point's: for
  a lobe of width a and a sphere that turns halfway vectors by up to q = σ / 2, both small, `(a² + k a q + q²)
  / a²`. k is π/2 for GGX with a = α, and √π for Blinn-Phong with a = √(2 / s). Where light comes at an angle
  of cosine c, halfway vectors turn by q / c to the sides, so q² is q² / c, and q in the second term the mean
  of both. Karis has 2 for k, and leaves c out: what his highlights have is up to 1.6 times as bright at 60°.

A radius of 0 gives what a point gives, so one shader lights surfaces by points and spheres.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import rhi.shading as sl
from renderer.light_kinds.generation import define, for_each_kind
from renderer.light_kinds.incidence import MIN_SQUARED_DISTANCE, safe_normalize
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.shaders.structs import TABLE_WIDTH, SurfacePoint

_PI: Final = 3.14159265
GGX_TAIL: Final = 1.57079633
"""The weight k of the mixed term in `lobe_normalization`, for the metallic-roughness model."""
PHONG_TAIL: Final = 1.77245385
"""The same weight for the specular model."""


@sl.function
def sphere_cosine(cosine: float, size: float) -> float:
    """Return the effective n·l of a sphere light. `cosine` is n·l of its centre, `size` the squared sine of
    its angle."""
    above = size - cosine * cosine
    if above <= 0.0:
        return sl.saturate(cosine)
    side = sl.sqrt(above / size)
    cotangent = sl.sqrt(sl.max(1.0 / size - 1.0, 1e-6))
    slope = side / cotangent
    # Slope less its arc tangent loses all digits of a small one.
    squared = slope * slope
    gap = squared * slope * (1.0 / 3.0 - squared * (0.2 - squared / 7.0))
    if slope > 0.3:
        gap = slope - sl.atan(slope)
    return sl.max(cosine * sl.atan2(side, -cotangent * cosine) + slope - gap / size, 0.0) / _PI


@sl.function
def nearest_direction(surface: SurfacePoint, to_center: sl.vec3, sine: float) -> sl.vec3:
    """Return the unit direction to the point of a sphere that is nearest to the mirrored direction."""
    mirrored = sl.reflect(-surface.to_eye, surface.normal)
    along = sl.dot(mirrored, to_center)
    cosine = sl.sqrt(1.0 - sine * sine)
    if along >= cosine:
        return mirrored
    return to_center * cosine + safe_normalize(mirrored - to_center * along) * sine


@sl.function
def lobe_normalization(widening: float, slant: float, tail: float) -> float:
    """Return the factor that keeps the energy of a specular lobe which is flat over a sphere `widening` times
    as wide as itself; the cosine `slant` makes it wider in one direction."""
    return 1.0 / (1.0 + widening * (0.5 * tail * (1.0 + 1.0 / slant) + widening / slant))


class SourceRadiusReader(sl.Shader):
    """The base of shaders that read the radii of lights: a channel for each kind."""

    lean = True

    source_radii: sl.Texture2D


_COUNT: Final = len(LOCAL_LIGHT_KINDS)

if TYPE_CHECKING:

    class SphereLightReader(SourceRadiusReader):
        """The base of shaders that light surfaces by local lights. `has_…_spheres` says for each kind whether
        its lights may be spheres."""

        def squared_angular_sizes(self, to_center: sl.vec3, light_index: int) -> Any:
            """Squares of radius / distance of the lights of each kind."""

else:
    SphereLightReader = define(
        f'''
class SphereLightReader(SourceRadiusReader):
    lean = True
{for_each_kind("    has_${kind}_spheres = False" + chr(10))}
    def squared_angular_sizes(self, to_center: sl.vec3, light_index: int) -> sl.vec{_COUNT}:
        """Return (radius / distance)² of the light at this index of each kind, 0 for a point and above 1 in
        a sphere. `to_center` leads from the surface to the light."""
        radii = self.source_radii.load(
            sl.ivec2(light_index % TABLE_WIDTH, light_index // TABLE_WIDTH)
        ).{"xyz"[:_COUNT]}
        return radii * radii / sl.max(sl.dot(to_center, to_center), MIN_SQUARED_DISTANCE)
''',
        "SphereLightReader",
        __name__,
        MIN_SQUARED_DISTANCE=MIN_SQUARED_DISTANCE,
        SourceRadiusReader=SourceRadiusReader,
        TABLE_WIDTH=TABLE_WIDTH,
        sl=sl,
    )
