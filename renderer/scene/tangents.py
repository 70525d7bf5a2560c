"""Tangents of vertices, by which normal maps are read: the algorithm of MikkTSpace (Mikkelsen 2008), for
whole arrays.

Tools that make normal maps and tools that show them must agree on the tangents, so this is what glTF 2.0 asks
for:

1. Corners with equal position, normal and texture coordinates are one vertex.
2. A triangle's tangent is the direction in which u grows, and its orientation the sign of its area in texture
   coordinates. Triangles without such an area have no tangent and take the orientation of a neighbour.
3. Around a vertex, triangles of one orientation that are connected by edges are a group. Its tangent is the
   sum of the triangles' tangents, projected to the plane of the vertex normal and weighted by the angle at
   the vertex.
4. A vertex in several groups, as along the seam of a mirrored texture, becomes several.

Where three and more triangles meet in an edge, all of them are connected; the reference pairs them by their
order. A vertex that only triangles without tangent meet gets the tangent of another group there, or any one
that is perpendicular to its normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry
from rhi.math.indexing import count_indices, repeat_each


@dataclass(frozen=True, eq=False, slots=True)
class TangentGroups:
    """The inputs of a mesh's tangents besides its positions and normals, for meshes that change.

    Attributes:
        corners: (c,) the vertex of each corner of a triangle.
        uv: (t, 3, 2) the texture coordinates of triangles.
        sign: (t,) of their bitangents.
        group: (c,) the group of each corner; its tangents are added.
        vertex: (c,) the same number for corners of equal position, normal and texture coordinates.
    """

    corners: Indices
    uv: Floats
    sign: NDArray[np.int64]
    group: Indices
    vertex: Indices

    @classmethod
    def make(cls, geometry: MeshGeometry, uv: str, *, splits: bool = True) -> TangentGroups:
        """Find the groups of a mesh; with `splits` False, each vertex is one."""
        corners = geometry.indices.astype(np.int64)
        vertices = geometry.vertices
        has_uv = uv in (vertices.dtype.names or ())
        coordinates = (vertices[uv] if has_uv else np.zeros((len(vertices), 2)))[corners]
        coordinates = coordinates.astype(np.float64).reshape(-1, 3, 2)
        points = vertices["position"].astype(np.float64)[corners].reshape(-1, 3, 3)
        _, sign = _triangle_tangents(points, coordinates)
        vertex = _weld(geometry, uv)[corners]
        links = _link_corners(vertex)
        sign = _orient_flat(links, sign)
        group = _group_corners(links, sign) if splits else corners
        return cls(corners, coordinates, sign, group, vertex if splits else corners)

    def compute(self, positions: NDArray[Any], normals: NDArray[Any]) -> Floats:
        """Return the tangents of corners (c, 4) where vertices (v, 3) are at these positions."""
        points = positions.astype(np.float64)[self.corners].reshape(-1, 3, 3)
        along, _ = _triangle_tangents(points, self.uv)
        corner_normals = normals.astype(np.float64)[self.corners]
        tangents = _sum_tangents(points, along, corner_normals, self.group)
        tangents = _fill_missing(tangents, corner_normals, self.vertex)
        return np.concatenate([tangents, repeat_each(self.sign, 3)[:, None]], axis=1)


def add_tangents(geometry: MeshGeometry, uv: str = "uv", *, splits: bool = True) -> MeshGeometry:
    """Return the mesh with tangents along one set of texture coordinates, `uv` or `uv2`.

    A vertex becomes several where its triangles' tangents are of different groups. If it must not, because
    something relies on the number of vertices, `splits` is False, and it gets their sum.
    """
    if splits:
        return split_by_tangents(geometry, uv)[0]
    groups = TangentGroups.make(geometry, uv, splits=False)
    vertices = geometry.with_attributes(geometry.attributes | {"tangent"}).vertices.copy()
    vertices["tangent"][groups.corners] = groups.compute(vertices["position"], vertices["normal"])
    return MeshGeometry(vertices, geometry.indices)


def split_by_tangents(geometry: MeshGeometry, uv: str = "uv") -> tuple[MeshGeometry, Indices, TangentGroups]:
    """Return the mesh with tangents, of which vertex (v,) each of its vertices was made, and the groups, for
    tangents of the new vertices where these are elsewhere."""
    groups = TangentGroups.make(geometry, uv)
    corners, group = groups.corners, groups.group
    signed = groups.compute(geometry.vertices["position"], geometry.vertices["normal"])
    vertices = geometry.with_attributes(geometry.attributes | {"tangent"}).vertices
    _, first, index = np.unique(corners * len(group) + group, return_index=True, return_inverse=True)
    index = index.reshape(-1)
    split = vertices[corners[first]]
    split["tangent"] = signed[first]
    mesh = MeshGeometry(split, index.astype(np.uint32))
    return mesh, corners[first], replace(groups, corners=index.astype(np.int64))


def add_stretch(geometry: MeshGeometry, uv: str = "uv") -> MeshGeometry:
    """Return a mesh with tangents whose w also says how much longer a step along v is than one along u, as
    the mean of the triangles around a vertex: a normal map with rotated coordinates needs it."""
    if uv not in (geometry.vertices.dtype.names or ()):
        return geometry
    corners = geometry.indices.astype(np.int64)
    vertices = geometry.vertices.copy()
    points = vertices["position"].astype(np.float64)[corners].reshape(-1, 3, 3)
    u, v = _triangle_gradients(points, vertices[uv].astype(np.float64)[corners].reshape(-1, 3, 2))
    lengths = repeat_each(np.linalg.norm([u, v], axis=2), 3, axis=1)
    along, across = (count_indices(corners, length, len(vertices)) for length in lengths)
    ratio = np.divide(across, along, out=np.ones_like(along), where=(along > 0.0) & (across > 0.0))
    ratio = np.clip(ratio, 1e-30, 1e30)  # finite in float32
    vertices["tangent"][:, 3] = np.where(vertices["tangent"][:, 3] < 0.0, -ratio, ratio)
    return MeshGeometry(vertices, geometry.indices)


def _triangle_gradients(points: Floats, uv: Floats) -> tuple[Floats, Floats]:
    """Return the steps (t, 3), (t, 3) of triangles along u and along v, both times the same area."""
    a, b = (points[:, 1:] - points[:, :1]).transpose(1, 0, 2)
    u, v = (uv[:, 1:] - uv[:, :1]).transpose(2, 0, 1)
    side = np.sign(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])[:, None]
    return (a * v[:, 1, None] - b * v[:, 0, None]) * side, (b * u[:, 0, None] - a * u[:, 1, None]) * side


def _triangle_tangents(points: Floats, uv: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return the unit tangents (t, 3) of triangles, or 0, and the signs (t,) of their bitangents: 0 without a
    tangent.

    An image's rows count down, so a triangle whose texture isn't mirrored has a negative area in (u, v).
    """
    u, v = (uv[:, 1:] - uv[:, :1]).transpose(2, 0, 1)
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    along, across = _triangle_gradients(points, uv)
    length = np.linalg.norm(along, axis=1)
    is_flat = (area == 0.0) | (length == 0.0) | (np.linalg.norm(across, axis=1) == 0.0)
    unit = along / np.where(length > 0.0, length, 1.0)[:, None]
    return np.where(is_flat[:, None], 0.0, unit), np.where(is_flat, 0, -np.sign(area)).astype(np.int64)


def _weld(geometry: MeshGeometry, uv: str) -> Indices:
    """Return the same number (v,) for vertices of equal position, normal and texture coordinates."""
    names = ["position", "normal", *([uv] if uv in (geometry.vertices.dtype.names or ()) else [])]
    rows = np.concatenate([geometry.vertices[name] for name in names], axis=1) + 0.0  # -0 is 0
    as_bytes = np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1] * 4))).reshape(-1)
    welded: Indices = np.unique(as_bytes, return_inverse=True)[1].reshape(-1)
    return welded


def _link_corners(vertex: Indices) -> tuple[Indices, Indices]:
    """Return pairs of corners (l,), (l,) that begin an edge in one triangle and end it in another."""
    corner = np.arange(len(vertex))
    following = corner - corner % 3 + (corner + 1) % 3
    begin, end = vertex[corner], vertex[following]
    low, high = np.minimum(begin, end), np.maximum(begin, end)
    order = np.lexsort((begin, high, low))
    first, second = order[:-1], order[1:]
    same = (low[first] == low[second]) & (high[first] == high[second]) & (low[first] != high[first])
    first, second = first[same], second[same]
    turned = begin[first] != begin[second]  # the edge runs the other way
    first, second = first[turned], second[turned]
    return np.concatenate([first, following[first]]), np.concatenate([following[second], second])


def _orient_flat(links: tuple[Indices, Indices], sign: NDArray[np.int64]) -> NDArray[np.int64]:
    """Give triangles without a tangent the sign of a neighbour, or 1."""
    first, second = (side // 3 for side in links)
    sign = sign.copy()
    while True:
        before = sign.copy()
        for here, there in ((first, second), (second, first)):
            learns = (sign[here] == 0) & (before[there] != 0)
            sign[here[learns]] = before[there[learns]]
        if np.array_equal(sign, before):
            return np.where(sign == 0, 1, sign)


def _group_corners(links: tuple[Indices, Indices], sign: NDArray[np.int64]) -> Indices:
    """Return the group of each corner: its lowest corner. Corners joined by edges of equal orientation are a
    group."""
    first, second = links
    alike = sign[first // 3] == sign[second // 3]
    first, second = first[alike], second[alike]
    group = np.arange(3 * len(sign))
    while True:
        lowest = np.minimum(group[first], group[second])
        before = group.copy()
        for side in (first, second):
            np.minimum.at(group, before[side], lowest)  # the lowest corner so far learns of a lower one
        group = group[group]
        if np.array_equal(group, before):
            return group


def _sum_tangents(points: Floats, along: Floats, normals: Floats, group: Indices) -> Floats:
    """Return the unit tangent (c, 3) of each corner's group, perpendicular to the normal; 0 where there is
    none."""
    triangle = np.arange(len(group)) // 3
    before, after = (points[:, order].reshape(-1, 3) for order in ([2, 0, 1], [1, 2, 0]))
    here = points.reshape(-1, 3)
    sides = [_normalize(_project(end - here, normals)) for end in (before, after)]
    angle = np.arccos(np.clip(np.einsum("ij,ij->i", *sides), -1.0, 1.0))
    weighted = _normalize(_project(along[triangle], normals)) * angle[:, None]
    total = np.stack([count_indices(group, weighted[:, axis], len(group)) for axis in range(3)], axis=1)
    return _normalize(total)[group]


def _fill_missing(tangents: Floats, normals: Floats, vertex: Indices) -> Floats:
    """Give corners without a tangent that of another corner of their vertex, or one perpendicular to the
    normal."""
    has = np.flatnonzero(tangents.any(1))
    source = np.full(int(vertex.max()) + 1, -1)
    source[vertex[has][::-1]] = has[::-1]
    missing = ~tangents.any(1)
    shared = missing & (source[vertex] >= 0)
    tangents = tangents.copy()
    tangents[shared] = tangents[source[vertex[shared]]]
    lost = missing & ~shared
    axis = np.eye(3)[np.abs(normals[lost]).argmin(1)]
    tangents[lost] = _normalize(_project(axis, normals[lost]))
    return tangents


def _project(vectors: Floats, normals: Floats) -> Floats:
    projected: Floats = vectors - normals * np.einsum("ij,ij->i", vectors, normals)[:, None]
    return projected


def _normalize(vectors: NDArray[Any]) -> Floats:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), 0.0)
    return unit
