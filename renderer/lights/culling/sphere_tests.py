"""Tests of spheres against cells, from none to exact, all with one signature (Thatcher 2014, 6.1 and 7.5).

A sphere and a convex body are apart if they are along some axis: that of a face's normal, of the line from an
edge, or from a vertex, to the centre. Tests that skip axes keep too much, never too little. An axis need not
have length 1, and since any axis that separates proves that the two are apart, its own rounding is harmless.
"""

from __future__ import annotations

from renderer.lights.culling.cells import Cell, corner, extent_along, relative_cell, squared_distance
from rhi.shading import abs, dot, function, length, max, min, vec2, vec3


@function
def overlaps_always(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return True: the test that culls nothing."""
    return True


@function
def overlaps_planes(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether a sphere is not completely behind one of the six planes of a cell."""
    return _meets_planes(relative_cell(cell, centre), radius)


@function
def overlaps_faces(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no normal of a face separates a sphere and a cell. Unlike the planes, that looks at both
    ends of the cell along a normal."""
    return not _faces_separate(relative_cell(cell, centre), radius)


@function
def overlaps_edges(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis from one of the twelve edges to the centre separates a sphere and a cell."""
    return not _edges_separate(relative_cell(cell, centre), radius)


@function
def overlaps_vertices(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis from one of the eight vertices to the centre separates a sphere and a cell."""
    return not _vertices_separate(relative_cell(cell, centre), radius)


@function
def overlaps_faces_edges(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis of a face or an edge separates a sphere and a cell."""
    seen = relative_cell(cell, centre)
    return not (_faces_separate(seen, radius) or _edges_separate(seen, radius))


@function
def overlaps_faces_vertices(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis of a face or a vertex separates a sphere and a cell."""
    seen = relative_cell(cell, centre)
    return not (_faces_separate(seen, radius) or _vertices_separate(seen, radius))


@function
def overlaps_edges_vertices(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis of an edge or a vertex separates a sphere and a cell."""
    seen = relative_cell(cell, centre)
    return not (_edges_separate(seen, radius) or _vertices_separate(seen, radius))


@function
def overlaps_all_axes(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether no axis of a face, an edge or a vertex separates a sphere and a cell: then they
    overlap."""
    seen = relative_cell(cell, centre)
    return not (
        _faces_separate(seen, radius) or _edges_separate(seen, radius) or _vertices_separate(seen, radius)
    )


@function
def overlaps_nearest_vertex(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether the axis from the nearest vertex to the centre doesn't separate a sphere and a cell."""
    seen = relative_cell(cell, centre)
    return not _separates(seen, radius, nearest_vertex(seen))


@function
def overlaps_hybrid(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether neither a plane nor the axis of the nearest vertex separates a sphere and a cell
    (Thatcher's algorithm 7)."""
    seen = relative_cell(cell, centre)
    return _meets_planes(seen, radius) and not _separates(seen, radius, nearest_vertex(seen))


@function
def overlaps_box(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether a sphere overlaps the box around a cell."""
    return _meets_box(relative_cell(cell, centre), radius)


@function
def overlaps_planes_box(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether a sphere overlaps the box around a cell, and is not completely behind one of its
    planes."""
    seen = relative_cell(cell, centre)
    return _meets_planes(seen, radius) and _meets_box(seen, radius)


@function
def overlaps_exactly(cell: Cell, centre: vec3, radius: float) -> bool:
    """Return whether a sphere and a cell overlap."""
    return not squared_distance(relative_cell(cell, centre)) > radius * radius


@function
def nearest_vertex(seen: Cell) -> vec3:
    """Return the vertex that is nearest to the origin."""
    near = _nearest_corner(seen, seen.near)
    far = _nearest_corner(seen, seen.far)
    return near if dot(near, near) < dot(far, far) else far


# From here on the cell is seen from the sphere's centre.


@function
def _nearest_corner(seen: Cell, z: float) -> vec3:
    low = seen.low + seen.low_slope * z
    high = seen.high + seen.high_slope * z
    x = low.x if abs(low.x) < abs(high.x) else high.x
    y = low.y if abs(low.y) < abs(high.y) else high.y
    return vec3(x, y, z)


@function
def _meets_planes(seen: Cell, radius: float) -> bool:
    if seen.near > radius or seen.far < -radius:
        return False
    # A side's normal is (1, -slope), so the lengths along it are these over its length.
    return not (
        seen.low.x > radius * length(vec2(1.0, seen.low_slope.x))
        or seen.low.y > radius * length(vec2(1.0, seen.low_slope.y))
        or -seen.high.x > radius * length(vec2(1.0, seen.high_slope.x))
        or -seen.high.y > radius * length(vec2(1.0, seen.high_slope.y))
    )


@function
def _meets_box(seen: Cell, radius: float) -> bool:
    low = min(seen.low + seen.low_slope * seen.near, seen.low + seen.low_slope * seen.far)
    high = max(seen.high + seen.high_slope * seen.near, seen.high + seen.high_slope * seen.far)
    gap = vec3(max(max(low, -high), vec2(0.0)), max(max(seen.near, -seen.far), 0.0))
    return not dot(gap, gap) > radius * radius


@function
def _separates(seen: Cell, radius: float, axis: vec3) -> bool:
    extent = extent_along(seen, axis)
    reach = radius * length(axis)
    return extent.x > reach or -extent.y > reach


@function
def _faces_separate(seen: Cell, radius: float) -> bool:
    return (
        _separates(seen, radius, vec3(0.0, 0.0, 1.0))
        or _separates(seen, radius, vec3(1.0, 0.0, -seen.low_slope.x))
        or _separates(seen, radius, vec3(1.0, 0.0, -seen.high_slope.x))
        or _separates(seen, radius, vec3(0.0, 1.0, -seen.low_slope.y))
        or _separates(seen, radius, vec3(0.0, 1.0, -seen.high_slope.y))
    )


@function
def _edges_separate(seen: Cell, radius: float) -> bool:
    for index in range(4):
        # The edges along x and y of the near and the far face, then those between the two faces.
        low = corner(seen, 0 if index < 2 else 4)
        high = corner(seen, 3 if index < 2 else 7)
        level = low if index % 2 == 0 else high
        if _separates(seen, radius, vec3(0.0, level.y, level.z)):
            return True
        if _separates(seen, radius, vec3(level.x, 0.0, level.z)):
            return True
        right = index % 2 == 1
        top = index >= 2
        start = vec3(seen.high.x if right else seen.low.x, seen.high.y if top else seen.low.y, 0.0)
        along = vec3(
            seen.high_slope.x if right else seen.low_slope.x,
            seen.high_slope.y if top else seen.low_slope.y,
            1.0,
        )
        if _separates(seen, radius, start - along * (dot(start, along) / dot(along, along))):
            return True
    return False


@function
def _vertices_separate(seen: Cell, radius: float) -> bool:
    separates = False
    for index in range(8):
        separates = separates or _separates(seen, radius, corner(seen, index))
    return separates
