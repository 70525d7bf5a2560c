"""The light that arrives at a point: the functions that kinds of lights share, for shaders."""

from __future__ import annotations

from typing import Final

from rhi.shading import Struct, dot, function, inversesqrt, max, saturate, vec3

MIN_SQUARED_DISTANCE: Final = 1e-24
"""The square of the distance, a picometre, within which light no longer grows: products with the strongest
lights stay finite."""


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
    """1 / d², windowed by (1 - (d / range)⁴)² to reach 0 at `range`, and bounded within a picometre.

    The window is that of Karis, Real Shading in Unreal Engine 4 (2013).
    """
    squared_fraction = distance_squared / max(range * range, MIN_SQUARED_DISTANCE)
    window = saturate(1.0 - squared_fraction * squared_fraction)
    return window * window / max(distance_squared, MIN_SQUARED_DISTANCE)


@function
def versine(a: vec3, b: vec3) -> float:
    """1 - cos of the angle between two unit vectors. Small angles have all their digits, which a cosine
    hasn't: in float32, those of .1° and .11° have four numbers between them."""
    chord = a - b
    return 0.5 * dot(chord, chord)


@function
def is_within_range(point: vec3, position: vec3, range: float) -> bool:
    """Test whether `point` is nearer than `range` to a light at `position`."""
    to_light = position - point
    return dot(to_light, to_light) < range * range
