"""Tests of the cones of lights, such as spot lights, against cells, all with one signature.

A light's cone is the part of the sphere of its range within an angle of its axis; with more than 90° it isn't
convex, and with 180° it is the sphere. Its *reach* along an axis is how far its points go: an axis along
which the whole cell lies beyond it separates the two. The tests come after one of the sphere around the cone.
`padding` enlarges the cone, for the rounding of float32.
"""

from __future__ import annotations

from renderer.light_kinds.volumes import Cone, cone_sine
from renderer.lights.culling.cells import Cell, corner, extent_along, relative_cell
from renderer.lights.culling.sphere_tests import nearest_vertex
from rhi.shading import dot, function, length, max, min, sqrt, vec3


@function
def cone_overlaps_always(cell: Cell, cone: Cone, padding: float) -> bool:
    """Return True: only the sphere around the cone is tested."""
    return True


@function
def cone_overlaps_sphere(cell: Cell, cone: Cone, padding: float) -> bool:
    """Return whether a cone overlaps the sphere around a cell (Wronski 2017): good for clusters, poor for
    long tiles."""
    seen = relative_cell(cell, cone.apex)
    centre = vec3(0.0)
    for index in range(8):
        centre += corner(seen, index) * 0.125
    square = 0.0
    for index in range(8):
        away = corner(seen, index) - centre
        square = max(square, dot(away, away))
    radius = sqrt(square) + padding
    along = dot(centre, cone.axis)
    behind = cone.cosine >= 0.0 and along < -radius
    return not (_beside(cone, centre) > radius or behind or along > cone.range + radius)


@function
def cone_overlaps_planes(cell: Cell, cone: Cone, padding: float) -> bool:
    """Return whether a cone is not completely behind one of the six planes of a cell."""
    return _meets_cone_planes(relative_cell(cell, cone.apex), cone, padding)


@function
def cone_overlaps_tightly(cell: Cell, cone: Cone, padding: float) -> bool:
    """Return whether no plane of a cell separates it from a cone, nor the axis to its nearest vertex, nor the
    cone's tangent planes towards that vertex and towards the middle. What a cone of more than 90° leaves out
    is convex: a cell with all corners there is outside."""
    seen = relative_cell(cell, cone.apex)
    if cone.cosine < 0.0:
        least = cone.range
        for index in range(8):
            least = min(least, _beside(cone, corner(seen, index)))
        if least > padding:
            return False
    if not _meets_cone_planes(seen, cone, padding):
        return False
    vertex = nearest_vertex(seen)
    if _separates_cone(seen, cone, padding, vertex):
        return False
    middle = (corner(seen, 0) + corner(seen, 3) + corner(seen, 4) + corner(seen, 7)) * 0.25
    return not (
        _separates_cone(seen, cone, padding, _tangent(cone, vertex))
        or _separates_cone(seen, cone, padding, _tangent(cone, middle))
    )


@function
def reach_along(cone: Cone, axis: vec3) -> float:
    """Return the greatest value of `dot(axis, p)` in a cone, from its apex."""
    size = length(axis)
    if not size > 0.0:
        return 0.0
    cosine = dot(axis, cone.axis) / size
    if cosine >= cone.cosine:
        return cone.range * size
    sine = sqrt(max(1.0 - cosine * cosine, 0.0))
    return cone.range * size * max(cosine * cone.cosine + sine * cone_sine(cone), 0.0)


@function
def _beside(cone: Cone, point: vec3) -> float:
    """Return the distance of a point, relative to the apex, outside of a cone's side; negative inside."""
    along = dot(point, cone.axis)
    # The root of |place|² - along² would be off by 3e-4 of the length near the axis, or not a number.
    across = length(point - cone.axis * along)
    return cone.cosine * across - cone_sine(cone) * along


# From here on the cell is seen from the cone's apex.


@function
def _meets_cone_planes(seen: Cell, cone: Cone, padding: float) -> bool:
    return not (
        _behind_plane(seen.near, cone, padding, vec3(0.0, 0.0, 1.0))
        or _behind_plane(-seen.far, cone, padding, vec3(0.0, 0.0, -1.0))
        or _behind_plane(seen.low.x, cone, padding, vec3(1.0, 0.0, -seen.low_slope.x))
        or _behind_plane(seen.low.y, cone, padding, vec3(0.0, 1.0, -seen.low_slope.y))
        or _behind_plane(-seen.high.x, cone, padding, vec3(-1.0, 0.0, seen.high_slope.x))
        or _behind_plane(-seen.high.y, cone, padding, vec3(0.0, -1.0, seen.high_slope.y))
    )


@function
def _behind_plane(least: float, cone: Cone, padding: float, inward: vec3) -> bool:
    """Return whether a cone reaches less far along `inward` than a plane of the cell is away."""
    return least > reach_along(cone, inward) + padding * length(inward)


@function
def _separates_cone(seen: Cell, cone: Cone, padding: float, axis: vec3) -> bool:
    return extent_along(seen, axis).x > reach_along(cone, axis) + padding * length(axis)


@function
def _tangent(cone: Cone, towards: vec3) -> vec3:
    """Return the outward normal of a cone's side in the direction of a point."""
    across = towards - cone.axis * dot(towards, cone.axis)
    return across * cone.cosine - cone.axis * (length(across) * cone_sine(cone))
