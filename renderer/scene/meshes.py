"""Meshes: triangles in one shared vertex array and one shared index array.

A `MeshGeometry` is one mesh with arrays of its own. `Meshes` holds all meshes of a scene: index ranges with
base vertices into the shared arrays, so that one vertex buffer, one index buffer and one multi-draw serve
every object.

All vertices have a position, a normal and texture coordinates. A second set of them, a tangent and a colour
are there only where they are needed (`vertex_format`); all meshes of a scene have the same ones.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from rhi.errors import refuse
from rhi.errors.arguments import to_little_endian
from rhi.math import normal_matrices
from rhi.math.arguments import read_floats
from rhi.math.indexing import count_indices, repeat_each

VERTEX: Final = np.dtype([("position", "<f4", 3), ("normal", "<f4", 3), ("uv", "<f4", 2)])
"""The vertex format of all meshes of the renderer: 32 bytes, tightly packed."""

_OPTIONAL: Final = {"uv2": ("<f4", 2), "tangent": ("<f4", 4), "color": ("<f4", 4)}
_ABSENT: Final[dict[str, tuple[float, ...]]] = {
    "uv2": (0.0, 0.0),
    "tangent": (1.0, 0.0, 0.0, 1.0),
    "color": (1.0, 1.0, 1.0, 1.0),
}
"""The values of vertices that lack an attribute which others of their scene have."""

RANGE: Final = np.dtype([("first_index", "<u4"), ("index_count", "<u4"), ("base_vertex", "<i4")])
"""The part of the shared arrays that a mesh uses, in the fields of an indexed draw."""

_EXAMINED_TRIANGLES: Final = 64
"""Meshes of more triangles aren't examined for being convex."""

_FLATNESS: Final = 1e-6
"""By so much of its size corners of a convex mesh may be in front of a plane."""

_USUAL_LENGTHS: Final = (1e-6, 1e6)
"""Normals and tangents of these lengths are left as they are: float32 has the squares of all of them."""

MeshBounds = tuple[Floats, Floats]
"""The lower and the upper corner (3,) of a mesh's bounding box."""


def vertex_format(attributes: Collection[str] = ()) -> np.dtype[Any]:
    """Return the format of vertices with the attributes of `VERTEX` and these.

    They are `uv2`, a second set of texture coordinates; `tangent`, a unit vector along which u grows, and a
    number whose sign is that of the bitangent `sign * cross(normal, tangent)`, which leads up in the image,
    where v decreases, and whose size is how much longer a step along v is than one along u, or 1; and
    `color`, linear with alpha, which multiplies a material's base colour.
    """
    unknown = set(attributes) - set(_OPTIONAL)
    if unknown:
        refuse(rules.BAD_MESH, "vertex_format", sorted(unknown), sorted(_OPTIONAL))
    return _make_format(frozenset(attributes))


@cache
def _make_format(attributes: frozenset[str]) -> np.dtype[Any]:
    return np.dtype([*VERTEX.descr, *((name, *_OPTIONAL[name]) for name in _OPTIONAL if name in attributes)])


def list_attributes(format: np.dtype[Any]) -> frozenset[str]:
    """Return the names of a vertex format's attributes that `VERTEX` hasn't got."""
    return frozenset(format.names or ()) & frozenset(_OPTIONAL)


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class MeshGeometry:
    """A mesh: `vertices` (v,) of a `vertex_format` and `indices` (3 * triangles,) uint32, counter-clockwise
    from outside."""

    vertices: NDArray[Any]
    indices: NDArray[np.uint32]

    def __post_init__(self) -> None:
        call = "MeshGeometry"
        for name in ("vertices", "indices"):
            object.__setattr__(self, name, to_little_endian(getattr(self, name)))
        if self.vertices.dtype != vertex_format(list_attributes(self.vertices.dtype)):
            refuse(
                rules.BAD_MESH,
                call,
                f"vertices of {self.vertices.dtype}",
                "meshes.VERTEX, or a vertex_format",
            )
        if self.indices.dtype != np.uint32 or self.indices.ndim != 1 or len(self.indices) % 3:
            problem = f"indices of {self.indices.dtype}, shape {self.indices.shape}"
            refuse(rules.BAD_MESH, call, problem, "uint32, shape (3 * triangles,)")
        if not len(self.indices):
            refuse(rules.BAD_MESH, call, "no triangle", "at least one")
        if int(self.indices.max()) >= len(self.vertices):
            refuse(rules.BAD_MESH, call, f"index {self.indices.max()}", f"0 to {len(self.vertices) - 1}")
        floats = np.ascontiguousarray(self.vertices).view(np.float32).reshape(len(self.vertices), -1)
        if not np.isfinite(floats).all():
            worst = int(np.flatnonzero(~np.isfinite(floats).all(1))[0])
            refuse(rules.BAD_VERTICES, call, f"vertex {worst}: {self.vertices[worst]}", "finite numbers")

    @property
    def triangle_count(self) -> int:
        """The number of triangles."""
        return len(self.indices) // 3

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """The lower and the upper corner (3,) float64 of the bounding box."""
        position = self.vertices["position"]
        return position.min(0).astype(np.float64), position.max(0).astype(np.float64)

    @property
    def attributes(self) -> frozenset[str]:
        """The names of the vertices' attributes that `VERTEX` hasn't got."""
        return list_attributes(self.vertices.dtype)

    def with_attributes(self, attributes: Collection[str]) -> MeshGeometry:
        """Return the mesh with these attributes besides those of `VERTEX`: others are left out, and missing
        ones are uv 0, a tangent along x, and white."""
        if self.attributes == frozenset(attributes):
            return self
        vertices = np.zeros(len(self.vertices), vertex_format(attributes))
        for name in vertices.dtype.names or ():
            is_present = name in (self.vertices.dtype.names or ())
            vertices[name] = self.vertices[name] if is_present else _ABSENT[name]
        return MeshGeometry(vertices, self.indices)

    def transformed(self, matrix: ArrayLike) -> MeshGeometry:
        """Return the mesh transformed by an affine matrix (4, 4); a mirroring one reverses the triangles'
        winding."""
        m = np.asarray(matrix, np.float64)
        vertices = self.vertices.copy()
        vertices["position"] = self.vertices["position"] @ m[:3, :3].T + m[:3, 3]
        normals = self.vertices["normal"] @ normal_matrices(m).T
        vertices["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
        mirrored = np.linalg.det(m[:3, :3]) < 0.0
        if "tangent" in self.attributes:
            along = self.vertices["tangent"][:, :3] @ m[:3, :3].T
            vertices["tangent"][:, :3] = along / np.maximum(
                np.linalg.norm(along, axis=1, keepdims=True), 1e-30
            )
            vertices["tangent"][:, 3] *= -1.0 if mirrored else 1.0
        corners = self.indices.reshape(-1, 3)
        return MeshGeometry(
            vertices, np.ascontiguousarray(corners[:, ::-1] if mirrored else corners).reshape(-1)
        )


@dataclass(frozen=True, eq=False, slots=True)
class MeshLevel:
    """A simplified version of a mesh: other triangles between the same vertices.

    Attributes:
        indices: (3 * triangles,) uint32.
        error: no point of the mesh is farther than this from the level, and none of the level from the mesh.
    """

    indices: NDArray[np.uint32]
    error: float


def join(parts: Sequence[MeshGeometry]) -> MeshGeometry:
    """Join several meshes to one, which has the attributes of all of them."""
    attributes: frozenset[str] = frozenset().union(*(part.attributes for part in parts))
    parts = [part.with_attributes(attributes) for part in parts]
    offsets = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
    indices = [part.indices + np.uint32(offset) for part, offset in zip(parts, offsets, strict=True)]
    return MeshGeometry(np.concatenate([part.vertices for part in parts]), np.concatenate(indices))


def list_grid_triangles(rows: int, columns: int) -> NDArray[np.uint32]:
    """Return the indices (k,) of the triangles of a grid of points, two for each four of them. Their front is
    where columns run right as rows run down."""
    corner = np.arange(rows * columns, dtype=np.uint32).reshape(rows, columns)
    a, b, c, d = corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1)


def make_geometry(
    positions: ArrayLike,
    indices: ArrayLike,
    normals: ArrayLike | None = None,
    uv: ArrayLike | None = None,
    *,
    uv2: ArrayLike | None = None,
    tangent: ArrayLike | None = None,
    color: ArrayLike | None = None,
) -> MeshGeometry:
    """Create a mesh from plain arrays: positions (v, 3), indices (3t,) or (t, 3), normals (v, 3), uv (v, 2).

    Missing normals are computed, weighted by area; missing texture coordinates are 0. Vertices have `uv2` (v,
    2), `tangent` (v, 4) and `color` (v, 4) only if these are given; see `vertex_format`.
    """
    attributes: Mapping[str, ArrayLike | None] = {"uv2": uv2, "tangent": tangent, "color": color}
    more = {name: values for name, values in attributes.items() if values is not None}
    points = _read_vertices("positions", positions, None, 3)
    corners = read_floats("make_geometry(indices=...)", indices, rule=rules.BAD_MESH).reshape(-1)
    if corners.size and not (corners.min() >= 0 and corners.max() < len(points)):
        refuse(rules.BAD_MESH, "make_geometry", f"an index outside 0 to {len(points) - 1}")
    if corners.size % 3 or (corners != np.floor(corners)).any():
        refuse(
            rules.BAD_MESH,
            "make_geometry",
            f"{corners.size} indices",
            "whole numbers, three for each triangle",
        )
    vertices = np.zeros(len(points), vertex_format(more))
    vertices["position"] = points
    vertices["normal"] = (
        compute_normals(points, corners.astype(np.int64))
        if normals is None
        else _read_vertices("normals", normals, len(points), 3)
    )
    if uv is not None:
        more["uv"] = uv
    for name, values in more.items():
        vertices[name] = _read_vertices(name, values, len(points), vertices[name].shape[1])
    return MeshGeometry(vertices, corners.astype(np.uint32))


def _read_vertices(name: str, values: ArrayLike, count: int | None, components: int) -> Floats:
    """Return an attribute of `count` vertices as (v, components); refuse other shapes."""
    call = f"make_geometry({name}=...)"
    numbers = read_floats(call, values, rule=rules.BAD_MESH)
    if numbers.ndim != 2 or numbers.shape[1] != components or count not in (None, len(numbers)):
        allowed = f"shape ({'v' if count is None else count}, {components})"
        refuse(rules.BAD_MESH, call, f"shape {numbers.shape}", allowed)
    return numbers


def compute_normals(positions: ArrayLike, indices: ArrayLike) -> Floats:
    """Return unit vertex normals (v, 3), weighted by the area of the triangles around each vertex.

    A vertex that only degenerate triangles use gets +Y, so that all normals are unit vectors.
    """
    points = np.asarray(positions, np.float64)
    corners = np.asarray(indices).reshape(-1, 3)
    a, b, c = (points[corners[:, i]] for i in range(3))
    size = max(float(np.ptp(points)), 1e-300) if points.size else 1.0
    faces = np.cross((b - a) / size, (c - a) / size)
    target = corners.T.reshape(-1)
    total = np.stack(
        [count_indices(target, np.tile(faces[:, axis], 3), len(points)) for axis in range(3)], axis=1
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0.0, total / np.where(length > 0.0, length, 1.0), (0.0, 1.0, 0.0))


def _is_convex(corners: Floats) -> bool:
    """Return whether all corners of triangles (t, 3, 3) are behind the plane of each triangle."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals /= np.where(lengths > 0.0, lengths, 1.0)
    in_front = np.einsum("td,tkd->tk", normals, corners.reshape(1, -1, 3) - corners[:, :1])
    return bool((in_front <= _FLATNESS * np.ptp(corners.reshape(-1, 3), axis=0).max()).all())


def _replace_missing_normals(vertices: NDArray[Any], indices: NDArray[np.uint32]) -> NDArray[Any]:
    """Return vertices whose normals of length 0 are those of the triangles around: a normal without a
    direction would be another one with each technique."""
    is_missing = ~vertices["normal"].any(axis=1)
    if not is_missing.any():
        return vertices
    vertices = vertices.copy()
    vertices["normal"][is_missing] = compute_normals(vertices["position"], indices)[is_missing]
    return vertices


def _normalize_extremes(vertices: NDArray[Any]) -> None:
    """Give unit length to the normals and tangents (v, 3) whose squared length a shader would round to 0 or
    to infinity. Tangents of length 0 stay."""
    for name in {"normal", "tangent"} & set(vertices.dtype.names or ()):
        directions = vertices[name][:, :3]
        largest = np.abs(directions).max(axis=1, initial=0.0)
        is_extreme = (largest > 0.0) & ((largest < _USUAL_LENGTHS[0]) | (largest > _USUAL_LENGTHS[1]))
        if is_extreme.any():
            exact = directions[is_extreme].astype(np.float64)
            vertices[name][is_extreme, :3] = exact / np.linalg.norm(exact, axis=1, keepdims=True)


class Meshes:
    """The meshes of a scene, in shared arrays.

    Attributes:
        vertices: (v,) of a `vertex_format`, with the attributes that any mesh has.
        indices: (i,) uint32, relative to each mesh's base vertex.
        ranges: (m,) of `RANGE`.
        lower, upper: (m, 3) float64, local bounds.
        names: the names of the meshes, m of them.
        level_indices: (l,) uint32, the indices of all simplified versions, as `indices`.
        level_ranges: (k,) of `RANGE`, the parts of `level_indices`; those of mesh i are from `level_begins[i]`
            to `level_begins[i + 1]`, ever coarser.
        level_errors: (m, most levels) float64, the bound of each level's distance from its mesh, infinite
            where there is none.
        meshlet_ranges: (k,) of `RANGE`, the parts of `indices` that are the meshlets of meshes that are cut; those
            of mesh i are from `meshlet_begins[i]` to `meshlet_begins[i + 1]`.
        may_change: (m,) bool, whether a mesh has bounds that were declared, within which its vertices may move.
        with_tangents: the meshes that had tangents, which normal maps need; others have the same for all
            vertices.
    """

    def __init__(
        self,
        geometries: Sequence[MeshGeometry],
        names: Sequence[str],
        bounds: Sequence[MeshBounds | None] = (),
        levels: Sequence[Sequence[MeshLevel]] = (),
        meshlets: Sequence[Indices] = (),
    ) -> None:
        """`bounds` that aren't None replace those of the geometries, for meshes that change; `levels` are the
        simplified versions of each mesh, `meshlets` the numbers of triangles of its meshlets, none if it is whole."""
        count = len(geometries)
        attributes: frozenset[str] = frozenset().union(*(g.attributes for g in geometries))
        self.with_tangents = frozenset(i for i, g in enumerate(geometries) if "tangent" in g.attributes)
        geometries = [g.with_attributes(attributes) for g in geometries]
        fixed = bounds or [None] * count
        self.may_change: NDArray[np.bool_] = np.array([box is not None for box in fixed], bool)
        self.vertices: NDArray[Any] = np.concatenate(
            [_replace_missing_normals(g.vertices, g.indices) for g in geometries] or [np.empty(0, VERTEX)]
        )
        _normalize_extremes(self.vertices)
        self.indices: NDArray[np.uint32] = np.concatenate(
            [g.indices for g in geometries] or [np.empty(0, np.uint32)]
        )
        self.ranges: NDArray[Any] = np.zeros(count, RANGE)
        self.ranges["index_count"] = [len(g.indices) for g in geometries]
        self.ranges["first_index"][1:] = np.cumsum(self.ranges["index_count"], dtype=np.uint32)[:-1]
        self.ranges["base_vertex"][1:] = np.cumsum([len(g.vertices) for g in geometries])[:-1]
        corners = np.array(
            [declared_bounds or g.bounds for declared_bounds, g in zip(fixed, geometries, strict=True)]
        )
        corners = corners.reshape(count, 2, 3)
        self.lower: Floats = corners[:, 0]
        self.upper: Floats = corners[:, 1]
        self.names: tuple[str, ...] = tuple(names)
        self._list_levels(levels or [()] * count)
        self._list_meshlets(meshlets or [np.zeros(0, np.int64)] * count)
        self._layers: dict[int, int] = {}  # of meshes whose layers were counted
        self._flat: dict[int, bool] = {}  # of meshes that were asked about
        for array in (self.vertices, self.indices, self.ranges, self.lower, self.upper):
            array.flags.writeable = False

    def _list_levels(self, levels: Sequence[Sequence[MeshLevel]]) -> None:
        """Put the levels of all meshes into shared arrays."""
        counts = [len(of_mesh) for of_mesh in levels]
        every = [level for of_mesh in levels for level in of_mesh]
        self.level_begins: NDArray[np.int64] = np.cumsum([0, *counts])
        self.level_errors: Floats = np.full((len(levels), max(counts, default=0)), np.inf)
        for row, of_mesh in zip(self.level_errors, levels, strict=True):
            row[: len(of_mesh)] = [level.error for level in of_mesh]
        self.level_indices: NDArray[np.uint32] = np.concatenate(
            [np.zeros(0, np.uint32), *(level.indices for level in every)]
        )
        self.level_ranges: NDArray[Any] = np.zeros(len(every), RANGE)
        self.level_ranges["index_count"] = [len(level.indices) for level in every]
        ends = np.cumsum(self.level_ranges["index_count"], dtype=np.uint32)
        self.level_ranges["first_index"] = ends - self.level_ranges["index_count"]

    def _list_meshlets(self, meshlets: Sequence[Indices]) -> None:
        """List the ranges of the meshlets of all meshes."""
        counts = [len(of_mesh) for of_mesh in meshlets]
        self.meshlet_begins: NDArray[np.int64] = np.cumsum([0, *counts])
        mesh = repeat_each(np.arange(len(meshlets)), counts)
        self.meshlet_ranges: NDArray[Any] = np.zeros(len(mesh), RANGE)
        sizes = 3 * np.concatenate([np.zeros(0, np.int64), *meshlets])
        ends = np.cumsum(sizes)
        before = np.append(0, ends)[self.meshlet_begins[:-1]]  # what the meshlets of earlier meshes have
        self.meshlet_ranges["index_count"] = sizes
        self.meshlet_ranges["first_index"] = ends - sizes - before[mesh] + self.ranges["first_index"][mesh]
        self.meshlet_ranges["base_vertex"] = self.ranges["base_vertex"][mesh]

    def __len__(self) -> int:
        return len(self.ranges)

    def geometry(self, mesh: int) -> MeshGeometry:
        """Return one mesh with arrays of its own."""
        first, count, base = (int(value) for value in self.ranges[mesh])
        end = base + int(self.vertex_counts[mesh])
        return MeshGeometry(self.vertices[base:end].copy(), self.indices[first : first + count].copy())

    def count_layers(self, mesh: int) -> int:
        """Return the number of triangles of a mesh that may cover a pixel, if only those that face the eye are drawn:
        one of a convex mesh. Each may if there are more than 64, which aren't examined."""
        if mesh not in self._layers:
            geometry = self.geometry(mesh)
            corners = geometry.vertices["position"][geometry.indices].astype(np.float64).reshape(-1, 3, 3)
            is_convex = len(corners) <= _EXAMINED_TRIANGLES and _is_convex(corners)
            self._layers[mesh] = 1 if is_convex else len(corners)
        return self._layers[mesh]

    def is_flat(self, mesh: int) -> bool:
        """Return whether all corners of a mesh are in one plane, so that no part of it is behind another."""
        if mesh not in self._flat:
            points = self.geometry(mesh).vertices["position"].astype(np.float64)
            size = float(np.ptp(points, axis=0).max())
            spread = np.linalg.svd((points - points.mean(axis=0)) / (size or 1.0), compute_uv=False)
            self._flat[mesh] = bool(len(points) < 4 or spread[-1] <= _FLATNESS * np.sqrt(len(points)))
        return self._flat[mesh]

    @property
    def vertex_counts(self) -> NDArray[np.int64]:
        """The number of vertices of each mesh, (m,)."""
        begins = self.ranges["base_vertex"].astype(np.int64)
        return np.append(begins[1:], len(self.vertices)) - begins

    @property
    def triangle_counts(self) -> NDArray[np.int64]:
        """The number of triangles of each mesh, (m,)."""
        return self.ranges["index_count"].astype(np.int64) // 3
