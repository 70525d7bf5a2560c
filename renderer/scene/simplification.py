"""Simplified versions of a mesh, each with a bound of its distance from the mesh.

A level is made by collapses: a vertex is moved to a neighbour, and two triangles vanish. Before and after, the
triangles around are height fields over the same polygon, in the direction of their mean normal, or the collapse isn't
done. So their distance, each from the other, is at most the largest difference of their heights. That is linear
between crossings of edges, so it is found at the vertex and at these crossings. Bounds of successive collapses are
added (J. Cohen, D. Manocha and M. Olano, *Simplifying Polygonal Models Using Successive Mappings*, 1997). The collapse
that leads to the least bound is done first.

Vertices stay where they are: a level is other indices of the same vertices. Those at borders, and those where vertices
with other normals or texture coordinates are in the same position, are never moved. Normals and texture coordinates
change with the level as they are interpolated; the bound says nothing about them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry, MeshLevel
from rhi.math.indexing import count_indices

LEAST_TRIANGLES: Final = 32
"""Meshes of fewer triangles aren't simplified."""

_LARGEST_STAR: Final = 9
"""Vertices in more triangles aren't moved."""
_TRIED_TARGETS: Final = 2
"""The neighbours of each vertex whose bound is computed: those with the least difference at the vertex itself."""
_SHARE: Final = 0.5
"""The collapses of a round are among so many of all vertices, those with the least bounds."""
_LEAST_GAIN: Final = 0.8
"""A level has at most so many of the triangles of the one before."""
_FLATTEST: Final = 1e-3
"""The least area of a triangle, in that of the square of its longest edge."""
_CHUNK: Final = 1024
"""So many vertices are examined together: the arrays of more leave the cache."""


@dataclass(frozen=True, eq=False, slots=True)
class _Stars:
    """The triangles around vertices (k,), each as a row of `width` triangles: the vertex and two others.

    Attributes:
        vertices: (k,) the points.
        triangles: (k, width), -1 for none.
        next, last: (k, width) the points after the vertex, counter-clockwise; -1 for none.
        next_corner, last_corner: the same as indices of the mesh's vertices.
    """

    vertices: Indices
    triangles: Indices
    next: Indices
    last: Indices
    next_corner: Indices
    last_corner: Indices


class _Simplifier:
    """A surface whose triangles get fewer.

    Attributes:
        positions: (p, 3) the points of the surface, each once.
        corners: (t, 3) indices of the mesh's vertices.
        points: (t, 3) the same as indices of points.
        errors: (t,) the bound of each triangle's distance from the mesh.
    """

    def __init__(self, geometry: MeshGeometry) -> None:
        vertices = geometry.vertices["position"]
        self.corners = geometry.indices.reshape(-1, 3).astype(np.int64)
        unique, inverse = np.unique(vertices + np.float32(0.0), axis=0, return_inverse=True)  # -0 is 0
        self.positions: Floats = unique.astype(np.float64)
        self.points: Indices = inverse.reshape(-1)[self.corners]
        self.errors: Floats = np.zeros(len(self.corners))
        pairs = np.unique(np.stack([self.points.ravel(), self.corners.ravel()], axis=1), axis=0)
        count = len(self.positions)
        self._is_seam = count_indices(pairs[:, 0], minlength=count) > 1
        self._is_outdated: NDArray[np.bool_] = np.ones(count, bool)  # whose collapse may have changed
        self._costs: Floats = np.full(count, np.inf)  # the least bound that the collapse of a point leads to
        self._targets: Indices = np.full(count, -1)  # the point that it moves to then
        self._target_corners: Indices = np.full(count, -1)  # and the vertex of the mesh

    def collapse(self, most: int) -> int:
        """Do up to `most` collapses that don't touch each other; return how many."""
        self._update_costs()
        costs = self._costs
        order = np.argsort(costs, kind="stable")
        used = len(np.unique(self.points))
        order = order[np.isfinite(costs[order])][: max(int(used * _SHARE), 1)]
        is_blocked = np.zeros(len(self.positions), bool)
        begins, neighbors = self._list_neighbors()
        moved = []
        for vertex in order.tolist():
            around = neighbors[begins[vertex] : begins[vertex + 1]]
            if not is_blocked[vertex] and not is_blocked[around].any():
                is_blocked[vertex] = True
                is_blocked[around] = True
                moved.append(vertex)
                if len(moved) == most:
                    break
        if not moved:
            return 0
        to_point, to_corner = np.arange(len(self.positions)), np.full(len(self.positions), -1)
        to_point[moved], to_corner[moved] = self._targets[moved], self._target_corners[moved]
        is_moved = to_corner[self.points] >= 0
        touched = is_moved.any(axis=1)
        cost = np.where(is_moved, costs[self.points], 0.0).max(axis=1)
        self.errors = np.where(touched, cost, self.errors)
        is_near = np.zeros(len(self.positions), bool)
        is_near[self.points[touched]] = True
        self._is_outdated[self.points[is_near[self.points].any(axis=1)]] = True
        self.corners = np.where(is_moved, to_corner[self.points], self.corners)
        self.points = to_point[self.points]
        a, b, c = self.points.T
        stays = (a != b) & (b != c) & (c != a) | ~touched
        self.points, self.corners, self.errors = self.points[stays], self.corners[stays], self.errors[stays]
        costs[moved] = np.inf
        self._is_outdated[moved] = False
        return len(moved)

    def _list_neighbors(self) -> tuple[Indices, Indices]:
        """Return the neighbours of all points, in a row, and where those of each begin (p + 1,)."""
        pairs = np.concatenate([self.points[:, [i, j]] for i in range(3) for j in range(3) if i != j])
        pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]
        return np.searchsorted(pairs[:, 0], np.arange(len(self.positions) + 1)), pairs[:, 1]

    def _update_costs(self) -> None:
        """Compute the least bounds of the points around which triangles have changed; infinite ones if they must
        stay."""
        count = len(self.positions)
        edges = np.concatenate([self.points[:, [0, 1]], self.points[:, [1, 2]], self.points[:, [2, 0]]])
        edges.sort(axis=1)
        keys, uses = np.unique(edges[:, 0] * count + edges[:, 1], return_counts=True)
        is_fixed = self._is_seam.copy()
        odd = keys[uses != 2]
        is_fixed[odd // count] = is_fixed[odd % count] = True
        a, b, c = self.points.T
        is_fixed[self.points[(a == b) | (b == c) | (c == a)]] = True
        sizes = count_indices(self.points.ravel(), minlength=count)
        is_movable = ~is_fixed & (sizes >= 3) & (sizes <= _LARGEST_STAR)
        self._costs[self._is_outdated] = np.inf
        movable = np.flatnonzero(is_movable & self._is_outdated)
        self._is_outdated[:] = False
        order = np.argsort(self.points.ravel(), kind="stable")
        begins = np.cumsum(sizes) - sizes
        for first in range(0, len(movable), _CHUNK):
            part = movable[first : first + _CHUNK]
            stars = self._gather_stars(part, order, begins, sizes)
            self._costs[part], column = self._bound(stars, keys)
            rows = np.arange(len(part))
            self._targets[part] = stars.next[rows, column]
            self._target_corners[part] = stars.next_corner[rows, column]

    def _gather_stars(self, vertices: Indices, order: Indices, begins: Indices, sizes: Indices) -> _Stars:
        width = int(sizes[vertices].max())
        column = np.arange(width)
        is_there = column < sizes[vertices][:, None]
        uses = order[np.where(is_there, begins[vertices][:, None] + column, 0)]
        triangles, corner = uses // 3, uses % 3
        ahead, behind = (corner + 1) % 3, (corner + 2) % 3

        def select(values: Indices, at: Indices) -> Indices:
            return np.where(is_there, values[triangles, at], -1)

        return _Stars(
            vertices,
            np.where(is_there, triangles, -1),
            select(self.points, ahead),
            select(self.points, behind),
            select(self.corners, ahead),
            select(self.corners, behind),
        )

    def _bound(self, stars: _Stars, edges: Indices) -> tuple[Floats, Indices]:
        """Return the least bound (k,) that moving each vertex to one of its neighbours leads to, and which one."""
        is_there = stars.triangles >= 0
        rows = np.arange(len(is_there))[:, None]
        center = self.positions[stars.vertices][:, None]
        ahead = np.where(is_there[..., None], self.positions[stars.next] - center, 0.0)
        behind = np.where(is_there[..., None], self.positions[stars.last] - center, 0.0)
        normal = np.cross(ahead, behind).sum(axis=1)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        normal /= np.where(length > 0.0, length, 1.0)
        ahead, behind = _to_plane(ahead, normal), _to_plane(behind, normal)

        # The vertex must be inside a polygon of its neighbours, around which the triangles go once.
        cross = _cross(ahead, behind)
        angles = np.arctan2(cross, (ahead[..., :2] * behind[..., :2]).sum(axis=-1))
        is_fan = (cross > _FLATTEST * _squared(behind[..., :2] - ahead[..., :2])) | ~is_there
        is_valid = is_fan.all(axis=1) & (
            np.abs(np.where(is_there, angles, 0.0).sum(axis=1) - 2.0 * np.pi) < 0.1
        )
        is_valid &= (np.sort(stars.next, axis=1) == np.sort(stars.last, axis=1)).all(axis=1) & (
            length[:, 0] > 0.0
        )

        # By target (axis 1) and triangle (axis 2):
        target = ahead[:, :, None]
        left, right = ahead[:, None], behind[:, None]
        is_gone = (stars.next[:, None] == stars.next[:, :, None]) | (
            stars.last[:, None] == stars.next[:, :, None]
        )
        is_gone |= ~is_there[:, None]
        area = _cross(left - target, right - target)
        longest = np.maximum(
            np.maximum(_squared((left - target)[..., :2]), _squared((right - target)[..., :2])),
            _squared((right - left)[..., :2]),
        )
        is_target = is_there & is_valid[:, None] & ((area > _FLATTEST * longest) | is_gone).all(axis=2)
        # Its vertex must be the same one in both triangles, and it must have no other common neighbour.
        is_behind = stars.last[:, None] == stars.next[:, :, None]
        corner_behind = np.where(is_behind, stars.last_corner[:, None], -1).max(axis=2)
        is_target &= corner_behind == stars.next_corner
        count = len(self.positions)
        ends = np.sort(
            np.stack(np.broadcast_arrays(stars.next[:, :, None], stars.next[:, None]), -1), axis=-1
        )
        codes = ends[..., 0] * count + ends[..., 1]
        is_edge = edges[np.minimum(np.searchsorted(edges, codes), len(edges) - 1)] == codes
        is_edge &= is_there[:, None] & is_there[:, :, None]
        is_target &= is_edge.sum(axis=2) == 2

        # The difference at the vertex, from the triangle that covers it then.
        weights = np.stack(
            np.broadcast_arrays(_cross(left, right), _cross(right, target), _cross(target, left)), axis=-1
        )
        covers = (weights >= -1e-9 * np.abs(area)[..., None]).all(axis=-1) & ~is_gone
        heights = np.stack(np.broadcast_arrays(target[..., 2], left[..., 2], right[..., 2]), axis=-1)
        total = np.where(covers, weights.sum(axis=-1), 1.0)
        at_vertex = np.where(covers, np.abs((weights * heights).sum(axis=-1) / total), -1.0).max(axis=2)
        differences = np.where(is_target & (at_vertex >= 0.0), at_vertex, np.inf)

        # The differences where old and new edges cross, for the most promising targets.
        tried = np.argsort(differences, axis=1, kind="stable")[:, :_TRIED_TARGETS]
        differences = np.take_along_axis(differences, tried, axis=1)
        goal = ahead[rows, tried][:, :, None, None]  # by target, old edge and new edge
        old, new = ahead[:, None, :, None], ahead[:, None, None, :] - goal
        determinant = _cross(old, new)
        is_crossing = np.abs(determinant) > 0.0
        determinant = np.where(is_crossing, determinant, 1.0)
        along_old, along_new = _cross(goal, new) / determinant, _cross(goal, old) / determinant
        for along in (along_old, along_new):
            is_crossing &= (along > -1e-9) & (along < 1.0 + 1e-9)
        is_crossing &= is_there[:, None, :, None] & is_there[:, None, None, :]
        gaps = np.abs(along_old * old[..., 2] - goal[..., 2] - along_new * new[..., 2])
        gaps = np.where(is_crossing, gaps, 0.0).max(axis=(2, 3))
        before = np.where(is_there, self.errors[stars.triangles], 0.0).max(axis=1)
        bounds = before[:, None] + np.maximum(differences, gaps)
        best = bounds.argmin(axis=1)
        column = np.arange(len(best))
        return bounds[column, best], tried[column, best]


def _to_plane(offsets: Floats, normal: Floats) -> Floats:
    """Return offsets (k, n, 3) as coordinates in the plane across unit normals (k, 3), and heights above it."""
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, least)
    length = np.linalg.norm(first, axis=1, keepdims=True)
    first /= np.where(length > 0.0, length, 1.0)
    axes = np.stack([first, np.cross(normal, first), normal], axis=1)
    plane: Floats = offsets @ axes.transpose(0, 2, 1)
    return plane


def _cross(a: Floats, b: Floats) -> Floats:
    """Return the cross products of vectors (..., 3) in the plane."""
    product: Floats = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return product


def _squared(a: Floats) -> Floats:
    squared: Floats = (a * a).sum(axis=-1)
    return squared


def simplify(geometry: MeshGeometry, levels: int) -> tuple[MeshLevel, ...]:
    """Return up to so many simplified versions of a mesh, each with about half the triangles of the one before and
    a larger bound.

    There are fewer where the mesh has less than `LEAST_TRIANGLES`, or where a collapse would fold the surface or
    change its topology.
    """
    surface = _Simplifier(geometry)
    simplified: list[MeshLevel] = []
    rounding = 1e-12 * float(np.abs(surface.positions).max(initial=0.0))
    count = len(surface.corners)
    while len(simplified) < levels and count >= 2 * LEAST_TRIANGLES:
        goal = count // 2
        while len(surface.corners) > goal and surface.collapse((len(surface.corners) - goal + 1) // 2):
            pass
        if len(surface.corners) > _LEAST_GAIN * count:
            break
        count = len(surface.corners)
        error = float(surface.errors.max(initial=0.0)) * (1.0 + 1e-9) + rounding
        simplified.append(MeshLevel(surface.corners.astype(np.uint32).reshape(-1), error))
    return tuple(simplified)
