"""The light that arrives at a point: the functions that kinds of lights share, for shaders."""

from __future__ import annotations

from rhi.shading import Struct, dot, function, inversesqrt, max, saturate, vec3


class Incidence(Struct):
    """Light that arrives at a point: the unit direction that it comes from, and its irradiance."""

    direction: vec3
    irradiance: vec3


@function
def safe_normalize(v: vec3) -> vec3:
    """`v` scaled to length 1. A zero vector stays (almost) zero, where `normalize` would give NaN."""
    return v * inversesqrt(max(dot(v, v), 1e-30))


@function
def attenuation(distance_squared: float, range: float) -> float:
    """1 / d², windowed by (1 - (d / range)⁴)² to reach 0 at `range`, and bounded within a centimetre.

    The window is that of Karis, Real Shading in Unreal Engine 4 (2013).
    """
    squared_fraction = distance_squared / max(range * range, 1e-20)
    window = saturate(1.0 - squared_fraction * squared_fraction)
    return window * window / max(distance_squared, 1e-4)


@function
def is_within_range(point: vec3, position: vec3, range: float) -> bool:
    """Test whether `point` is nearer than `range` to a light at `position`."""
    to_light = position - point
    return dot(to_light, to_light) < range * range
