"""Tessellated meshes: any triangles, as smooth surfaces with displacement, whose triangles are chosen for each view.

Each triangle of a mesh is three: its sides with its centroid. The two at a side are the halves of a square grid,
whose diagonal is the side; so a mesh is a `TessellatedSurface` of as many grids as it has sides. All vertices of
the grids are computed once, in float64:

- Positions are those of curved PN triangles (Vlachos et al. 2001), cubic patches that meet the normals at the
  corners. At an edge whose sides have different normals the border bends along the crease.
- Heights of an image are added along the normals, and turn these.

A point that several grids share is computed once, for the first of them: copies of it are equal bit by bit, also
where texture coordinates or normals have a seam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry, compute_normals
from renderer.scene.tangents import add_tangents
from renderer.scene.tessellated_surfaces import TessellatedSurface, bisect
from rhi.errors import describe_value, refuse
from rhi.errors.array_likes import to_real_array

MAX_HALVINGS: Final = 6
MAX_ROWS: Final = 1 << 18
"""The most rows of vertices of all grids, which the device numbers."""

_CREASE: Final = 0.02  # the sine of an angle between normals, from which on an edge is a crease
_WELDED: Final = 2.0**-20
"""Vertices are at one position if their coordinates are the same multiples of this share of the largest."""
_NEXT: Final = np.array([1, 2, 0])


@dataclass(frozen=True, eq=False)
class TessellatedMesh(TessellatedSurface):
    """A mesh of grids of vertices, whose triangles are chosen for each view; `tessellate` makes it.

    Attributes:
        vertices: (g, s, s) of a vertex format, those of the grids.
        points: (g, s, s) the numbers of their positions.
        pairs: the number of grids whose halves are both used; of the others the first is.
        limit: the largest number of its triangles.
    """

    vertices: NDArray[Any]
    points: Indices
    pairs: int
    limit: int

    @property
    def half_count(self) -> int:
        """The number of halves of grids that are used."""
        return self.grid_count + self.pairs

    @property
    def side(self) -> int:
        """The number of vertices along a side of a grid."""
        return int(self.vertices.shape[1])

    @property
    def grid_count(self) -> int:
        """The number of grids: of the mesh's edges."""
        return len(self.vertices)

    def positions(self) -> Floats:
        """Return the positions (g, s, s, 3) of the vertices, as float32 has them."""
        return self.vertices["position"].astype(np.float64)

    def number_points(self) -> Indices:
        """Return the numbers of positions, equal for copies."""
        return self.points

    def make_mesh(self) -> MeshGeometry:
        """Make a mesh of all vertices, and of as many equal triangles as the limit allows."""
        return MeshGeometry(self.vertices.reshape(-1), self.list_equal_triangles())


def tessellate(
    geometry: MeshGeometry,
    *,
    halvings: int = 4,
    smoothness: float = 1.0,
    heights: ArrayLike | None = None,
    height_scale: float = 1.0,
    limit: int = 1 << 18,
) -> TessellatedMesh:
    """Make a mesh whose triangles are chosen for each view. Seen from afar it has three triangles for each of
    `geometry`.

    Args:
        halvings: how often the finest edges are halves of the mesh's, 1 to 6. There are up to 3 · 4^halvings
            triangles for each of the mesh, and half as many vertices or more, which are on the device.
        smoothness: 1 for a surface that meets the vertices' normals, 0 for flat triangles.
        heights: (h, w) in metres, read along `uv`, repeated and interpolated; None for none.
        height_scale: multiplies the heights.
        limit: the largest number of triangles, rounded down to a power of two times three for each of the
            mesh.

    Raises:
        ValidationError `scene-bad-mesh`: a number out of its range, heights that aren't finite, or a mesh of too
        many triangles for its `halvings`.
    """
    call = "tessellate"
    halvings = rules.check_count(rules.BAD_MESH, f"{call}(halvings=...)", halvings, 1)
    if halvings > MAX_HALVINGS:
        refuse(rules.BAD_MESH, f"{call}(halvings=...)", halvings, f"1 to {MAX_HALVINGS}")
    (smoothness,) = rules.check_numbers(rules.BAD_MESH, call, smoothness=smoothness)
    if not 0.0 <= smoothness <= 1.0:
        refuse(rules.BAD_MESH, f"{call}(smoothness=...)", smoothness, "0 to 1")
    (height_scale,) = rules.check_numbers(rules.BAD_MESH, call, height_scale=height_scale)
    image = None if heights is None else height_scale * _read_heights(call, heights)
    base = _Base.make(geometry)
    if not len(base.faces):
        refuse(rules.BAD_MESH, call, "only triangles without an area", "at least one with an area")
    side = (1 << halvings) + 1
    sides, pairs = base.list_grids()
    if len(sides) * side > MAX_ROWS:
        allowed = f"{MAX_ROWS // side:,} edges with halvings={halvings}"
        refuse(rules.BAD_MESH, call, f"a mesh of {len(sides):,} edges", allowed)
    half_count = len(sides) + pairs
    limit = rules.check_count(rules.BAD_MESH, f"{call}(limit=...)", limit, half_count)
    depth = min((limit // half_count).bit_length() - 1, 2 * halvings)
    face, weights = base.lay_grids(sides, side)
    points, first = base.number_points(face, weights, 3 * (side - 1))
    vertices = base.interpolate(face, weights / (3.0 * (side - 1)))
    flat, shares = face.reshape(-1)[first], weights.reshape(-1, 3)[first] / (3.0 * (side - 1))
    smooth = base.compute_patches(smoothness, flat, shares)
    position = smooth
    if image is not None:
        position = smooth + base.displace(image, flat, shares)
        triangles = points.reshape(-1)[bisect(side, 2 * halvings, len(sides), half_count)]
        turned = compute_normals(position, triangles) - compute_normals(smooth, triangles)
        vertices["normal"] = _unit(vertices["normal"] + turned[points], vertices["normal"])
    vertices["position"] = position[points]
    return TessellatedMesh(vertices, points, pairs, half_count << depth)


@dataclass(frozen=True, eq=False, slots=True)
class _Base:
    """The triangles of a mesh, without those that have fewer than three points.

    Attributes:
        vertices: of the mesh.
        faces: (t, 3) the vertices of triangles.
        welded: (v,) the point of each vertex: those at one position are one.
        edges: (t, 3) the number of the edge from each corner to the next, between points.
    """

    vertices: NDArray[Any]
    faces: Indices
    welded: Indices
    edges: Indices

    @classmethod
    def make(cls, geometry: MeshGeometry) -> _Base:
        """Weld the vertices of a mesh, which gets tangents unless it has them."""
        if "tangent" not in geometry.attributes:
            geometry = add_tangents(geometry)
        vertices = geometry.vertices
        position = vertices["position"].astype(np.float64)
        cell = _WELDED * 2.0 ** np.ceil(np.log2(max(float(np.abs(position).max()), 1e-30)))
        _, welded = np.unique(np.rint(position / cell) + 0.0, axis=0, return_inverse=True)
        welded = welded.reshape(-1).astype(np.int64)
        faces = geometry.indices.astype(np.int64).reshape(-1, 3)
        corner = welded[faces]
        faces = faces[(corner != corner[:, _NEXT]).all(axis=1)]
        ends = np.sort(np.stack([welded[faces], welded[faces][:, _NEXT]], axis=-1), axis=-1)
        key = ends[..., 0] * (len(vertices) + 1) + ends[..., 1]
        _, edges = np.unique(key, return_inverse=True)
        return cls(vertices, faces, welded, edges.reshape(faces.shape).astype(np.int64))

    def list_grids(self) -> tuple[Indices, int]:
        """Return for each grid the sides (g, 2) of triangles, face · 3 + corner, that are its diagonal, and how
        many grids come first that have two: where both triangles have the same vertices. Others have -1."""
        begin, end = self.faces.reshape(-1), self.faces[:, _NEXT].reshape(-1)
        key = begin * (len(self.vertices) + 1) + end
        reverse = end * (len(self.vertices) + 1) + begin
        order = np.argsort(key, kind="stable")
        at = np.minimum(np.searchsorted(key[order], reverse), len(key) - 1)
        _, kind, uses = np.unique(key, return_inverse=True, return_counts=True)
        alone = uses[kind.reshape(-1)] == 1
        partner = np.where(key[order[at]] == reverse, order[at], -1)
        partner[(partner >= 0) & ~(alone & alone[partner])] = -1  # more than two triangles meet there
        number = np.arange(len(key))
        pairs = np.stack([number, partner], axis=1)[partner > number]
        singles = np.stack([number, partner], axis=1)[partner < 0]
        return np.concatenate([pairs, singles]), len(pairs)

    def lay_grids(self, sides: Indices, side: int) -> tuple[Indices, Indices]:
        """Return the triangle (g, s, s) of each vertex of grids, and its weights (g, s, s, 3) of the corners in
        parts of 3 (s - 1). An unused half mirrors the other."""
        n = side - 1
        row, column = np.indices((side, side))
        is_first = row >= column
        low, high = np.minimum(row, column), np.maximum(row, column)
        second = np.where(sides[:, 1] >= 0, sides[:, 1], sides[:, 0])
        side_number = np.where(is_first, sides[:, 0, None, None], second[:, None, None])
        # The first half has its side's begin at the last vertex of the diagonal, the second at the first.
        begins_last = is_first | (sides[:, 1] < 0)[:, None, None]
        inner = high - low
        at_last, at_first = 3 * low + inner, 3 * (n - high) + inner
        face, corner = np.divmod(side_number, 3)
        weights = np.zeros((*face.shape, 3), np.int64)
        for values, offset in (
            (np.where(begins_last, at_last, at_first), 0),
            (np.where(begins_last, at_first, at_last), 1),
            (np.broadcast_to(inner, face.shape), 2),
        ):
            np.put_along_axis(weights, ((corner + offset) % 3)[..., None], values[..., None], axis=-1)
        return face, weights

    def number_points(self, face: Indices, weights: Indices, total: int) -> tuple[Indices, Indices]:
        """Return the number of each vertex's point, and of each point the first vertex that has it: vertices at
        one corner, at one position along an edge, or at one of a triangle have the same."""
        point = self.welded[self.faces]
        stride = total + 1
        corner_count = len(self.vertices)
        edge_count = int(self.edges.max()) + 1
        key = (
            corner_count + edge_count * stride + (face * stride + weights[..., 0]) * stride + weights[..., 1]
        )
        for k in range(3):
            following, opposite = int(_NEXT[k]), int(_NEXT[_NEXT[k]])
            is_edge = weights[..., opposite] == 0
            begins_lower = (point[:, k] < point[:, following])[face]
            along = np.where(begins_lower, weights[..., k], weights[..., following])
            key = np.where(is_edge, corner_count + self.edges[:, k][face] * stride + along, key)
        for k in range(3):
            key = np.where(weights[..., k] == total, point[:, k][face], key)
        _, first, number = np.unique(key.reshape(-1), return_index=True, return_inverse=True)
        return number.reshape(key.shape).astype(np.int64), first

    def interpolate(self, face: Indices, shares: Floats) -> NDArray[Any]:
        """Return vertices (g, s, s) with the means of the corners' values."""
        result = np.zeros(face.shape, self.vertices.dtype)
        for name in self.vertices.dtype.names or ():
            corners = self.vertices[name].astype(np.float64)[self.faces]
            result[name] = sum(corners[:, k][face] * shares[..., k, None] for k in range(3))
        first = self.vertices[self.faces[:, 0]][face]
        result["normal"] = _unit(result["normal"], first["normal"])
        result["tangent"][..., :3] = _unit(result["tangent"][..., :3], first["tangent"][..., :3])
        result["tangent"][..., 3] = first["tangent"][..., 3]
        return result

    def compute_patches(self, smoothness: float, face: Indices, shares: Floats) -> Floats:
        """Return the positions (p, 3) of PN triangles at shares (p, 3) of their corners."""
        corners = self.vertices["position"].astype(np.float64)[self.faces]
        controls = self._bend_edges(corners)
        thirds = np.array([1.0, 2.0])[:, None] / 3.0
        straight = corners[:, :, None] + thirds * (corners[:, _NEXT] - corners)[:, :, None]
        controls = straight + smoothness * (controls - straight)
        mean = controls.mean(axis=(1, 2))
        middle = mean + 0.5 * (mean - corners.mean(axis=1))
        result = 6.0 * shares.prod(axis=1, keepdims=True) * middle[face]
        for k in range(3):
            begin, end = shares[:, k, None], shares[:, _NEXT[k], None]
            result += begin**3 * corners[face, k]
            result += 3.0 * begin * end * (begin * controls[face, k, 0] + end * controls[face, k, 1])
        return np.asarray(result)

    def _bend_edges(self, corners: Floats) -> Floats:
        """Return the two inner control points (t, 3, 2, 3) of each triangle's sides: a third of the way to the
        other end, moved into the planes at this one that the normals of both sides' triangles are normal to."""
        normals = _unit(self.vertices["normal"].astype(np.float64), (0.0, 1.0, 0.0))[self.faces]
        flat_edges, point = self.edges.reshape(-1), self.welded[self.faces]
        is_forward = (point < point[:, _NEXT]).reshape(-1)
        low = np.where(is_forward[:, None], normals.reshape(-1, 3), normals[:, _NEXT].reshape(-1, 3))
        high = np.where(is_forward[:, None], normals[:, _NEXT].reshape(-1, 3), normals.reshape(-1, 3))
        order = np.argsort(flat_edges, kind="stable")
        begins = np.searchsorted(flat_edges[order], np.arange(int(flat_edges.max()) + 1))
        ends = np.append(begins[1:], len(order)) - 1
        # An edge's first side and its last; others, where three triangles meet, bend nothing.
        first_side, last_side = order[begins][flat_edges], order[ends][flat_edges]
        controls = np.empty((len(flat_edges), 2, 3))
        start = np.where(is_forward[:, None], corners.reshape(-1, 3), corners[:, _NEXT].reshape(-1, 3))
        stop = np.where(is_forward[:, None], corners[:, _NEXT].reshape(-1, 3), corners.reshape(-1, 3))
        for number, (here, there, normal) in enumerate(((start, stop, low), (stop, start, high))):
            third = (there - here) / 3.0
            controls[:, number] = here + _project(third, normal[first_side], normal[last_side])
        controls[~is_forward] = controls[~is_forward][:, ::-1]
        return controls.reshape(*corners.shape[:2], 2, 3)

    def displace(self, heights: Floats, face: Indices, shares: Floats) -> Floats:
        """Return the offsets (p, 3) of points by heights along the mean normals of their corners."""
        unit = _unit(self.vertices["normal"].astype(np.float64), (0.0, 1.0, 0.0))
        total = np.zeros((int(self.welded.max()) + 1, 3))
        _, distinct = np.unique(
            np.concatenate([self.welded[:, None].astype(np.float64), unit], axis=1), axis=0, return_index=True
        )
        np.add.at(total, self.welded[distinct], unit[distinct])
        mean = _unit(total[self.welded], unit)[self.faces]
        uv = self.vertices["uv"].astype(np.float64)[self.faces]
        direction = _unit(np.einsum("pk,pkd->pd", shares, mean[face]), mean[face, 0])
        height = _sample(heights, np.einsum("pk,pkd->pd", shares, uv[face]))
        return direction * height[:, None]


def _read_heights(call: str, heights: ArrayLike) -> Floats:
    """Return heights (h, w) that are finite; refuse others."""
    call = f"{call}(heights=...)"
    try:
        image = np.asarray(to_real_array(heights), np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        refuse(rules.BAD_MESH, call, describe_value(heights), f"real numbers: {error}")
    if image.ndim != 2 or not image.size or not np.isfinite(image).all():
        refuse(rules.BAD_MESH, call, describe_value(heights), "finite heights (h, w)")
    return image


def _sample(heights: Floats, uv: Floats) -> Floats:
    """Return heights at texture coordinates (p, 2), repeated and interpolated between centres of texels."""
    count = np.array(heights.shape[::-1])
    at = uv * count - 0.5
    low = np.floor(at)
    part = at - low
    (x, y), (right, below) = (low.astype(np.int64) % count).T, ((low.astype(np.int64) + 1) % count).T
    upper = heights[y, x] * (1.0 - part[:, 0]) + heights[y, right] * part[:, 0]
    lower = heights[below, x] * (1.0 - part[:, 0]) + heights[below, right] * part[:, 0]
    return np.asarray(upper * (1.0 - part[:, 1]) + lower * part[:, 1])


def _project(vectors: Floats, first: Floats, second: Floats) -> Floats:
    """Return vectors (k, 3) projected into the planes of both normals (k, 3), or of their mean if they are almost
    the same."""
    across = np.cross(first, second)
    is_crease = np.linalg.norm(across, axis=1, keepdims=True) > _CREASE
    along = _unit(across, (1.0, 0.0, 0.0))
    mean = _unit(first + second, first)
    in_plane = vectors - mean * np.einsum("kd,kd->k", vectors, mean)[:, None]
    on_line = along * np.einsum("kd,kd->k", vectors, along)[:, None]
    return np.asarray(np.where(is_crease, on_line, in_plane))


def _unit(vectors: Floats, otherwise: ArrayLike) -> Floats:
    """Return vectors (..., 3) of length 1, or `otherwise` where they have no direction."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, vectors / np.maximum(length, 1e-12), otherwise))
