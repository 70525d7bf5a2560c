"""Exponential height fog: its transmittance along a ray, by the integral of its density (Wenzel 2006).

The density at the height y is σ(y) = density · e^(-falloff · (y - base)). Along a straight ray of length L
that rises by Δ the integral of it is L · σ(lower end) · g(falloff · |Δ|), where g(x) = (1 - e^-x) / x.
Written from the lower of both ends, the thicker one, no term overflows or cancels: g is from 0 to 1, for rays
up and down alike. Where a ray is nearly horizontal g is its series, because 1 - e^-x loses its digits there.
"""

from __future__ import annotations

from renderer.shaders.pixels import ViewRayShader
from rhi.shading import Struct, Uniform, abs, dot, exp, function, inversesqrt, length, max, min, mix, vec3

_LEVEL = 0.1
"""The rise below which g is computed by its series, in units of the height over which the fog thins to 1 / e.
The first term left out is x⁴ / 120, 10^-6 of g."""
_DEEPEST = 60.0
"""The largest exponent of the density, which is then e^60 times that at the base: nothing is seen through
it."""


class FogConstants(Struct):
    """The constants of fog for an eye: the light of endless fog, the density at its base, and the falloff.
    `height` is that of the eye above the base, times the falloff."""

    color: vec3
    density: float
    falloff: float
    height: float


@function
def mean_fog_density(rise: float) -> float:
    """Return the mean density along a ray that rises by `rise / falloff`, relative to the density at its
    lower end."""
    x = abs(rise)
    if x < _LEVEL:
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0)))
    return (1.0 - exp(-x)) / x


@function
def density_at(fog: FogConstants, rise: float) -> float:
    """Return the density at `rise / falloff` above the eye."""
    return fog.density * exp(min(-(fog.height + rise), _DEEPEST))


@function
def fog_transmittance(position: vec3, fog: FogConstants) -> float:
    """Return the transmittance of the fog between the eye and `position`, relative to the eye: from 0 to
    1."""
    rise = fog.falloff * position.y
    return exp(-length(position) * (density_at(fog, min(rise, 0.0)) * mean_fog_density(rise)))


@function
def fog_from_height(fog: FogConstants, height: float) -> FogConstants:
    """Return the fog for rays that begin `height` metres above the eye."""
    return FogConstants(
        color=fog.color,
        density=fog.density,
        falloff=fog.falloff,
        height=fog.height + fog.falloff * height,
    )


@function
def apply_fog(color: vec3, position: vec3, fog: FogConstants) -> vec3:
    """Return the light from `position`, relative to the eye, mixed with the fog's light between."""
    return mix(fog.color, color, fog_transmittance(position, fog))


@function
def apply_fog_to_background(color: vec3, direction: vec3, fog: FogConstants) -> vec3:
    """Return light from infinitely far away, mixed with the fog's: all fog unless the ray leaves it
    upwards."""
    rise = fog.falloff * direction.y * inversesqrt(max(dot(direction, direction), 1e-30))
    if rise <= 0.0:
        return fog.color
    return mix(fog.color, color, exp(-density_at(fog, 0.0) / rise))


class FogReader(ViewRayShader):
    """The base of shaders that see through fog, if the scene has any."""

    has_fog = False

    fog: Uniform[FogConstants]

    def fog_at(self, start: vec3) -> FogConstants:
        """Return the fog for a ray that begins at `start`, relative to the eye."""
        if self.has_parallel_rays:
            return fog_from_height(self.fog, start.y)
        return self.fog
