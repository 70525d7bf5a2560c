"""Meshes cut into meshlets: runs of neighbouring triangles, each small enough to be culled apart from the rest.

A mesh is cut in two, again and again, until no part has more triangles than allowed. A cut is across the widest of
six axes: the three of the triangles' middles, and the three of their normals, of which opposite ones count as a
diagonal of the part apart. So a meshlet's triangles are near each other, and face similar ways. Parts are as large as
they can be: a mesh of t triangles has ⌈t / most⌉ meshlets.

A cut only changes the order of a mesh's triangles. Those of a meshlet keep theirs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.meshes import MeshGeometry
from rhi.errors import Rule, refuse
from rhi.math.indexing import reduce_runs, repeat_each

MESHLET_SIZES: Final = (8, 4096)
"""The least and the largest number of triangles that a meshlet may be allowed."""

_NORMAL_WEIGHT: Final = 0.5
"""The distance of normals that differ by 1, in diagonals of what is cut."""


def check_meshlet_size(rule: Rule, call: str, value: Any) -> int:
    """Return the number of triangles that a meshlet may have, 0 for no meshlets; refuse what it can't be."""
    size = rules.check_count(rule, f"{call}(meshlet_size=...)", value, 0)
    least, most = MESHLET_SIZES
    if size and not least <= size <= most:
        refuse(rule, f"{call}(meshlet_size=...)", size, f"0, or {least} to {most:,}")
    return size


def cut_into_meshlets(geometry: MeshGeometry, most: int) -> tuple[MeshGeometry, Indices]:
    """Return a mesh with its triangles in the order of meshlets of at most `most` triangles, and their numbers of
    triangles (c,). A mesh that is small enough stays whole, and so does any if `most` is 0: it has no meshlet."""
    count = geometry.triangle_count
    if count <= most or not most:
        return geometry, np.zeros(0, np.int64)
    corners = geometry.vertices["position"].astype(np.float64)[geometry.indices].reshape(-1, 3, 3)
    middles, normals = corners.mean(axis=1), unit_normals(corners)
    parts: list[Indices] = []
    pending: list[Indices] = [np.arange(count)]
    while pending:
        part = pending.pop()
        meshlets = -(-len(part) // most)
        if meshlets == 1:
            parts.append(np.sort(part))
            continue
        diagonal = float(np.linalg.norm(np.ptp(middles[part], axis=0)))
        keys = np.concatenate([middles[part], _NORMAL_WEIGHT * diagonal * normals[part]], axis=1)
        order = part[np.argsort(keys[:, np.ptp(keys, axis=0).argmax()], kind="stable")]
        cut = len(part) * (meshlets // 2) // meshlets
        pending += [order[cut:], order[:cut]]
    triangles = geometry.indices.reshape(-1, 3)[np.concatenate(parts)]
    return MeshGeometry(geometry.vertices, triangles.reshape(-1)), np.array([len(part) for part in parts])


def unit_normals(corners: Floats) -> Floats:
    """Return the unit normals (t, 3) of triangles (t, 3, 3), 0 for those without an area."""
    normals: Floats = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    units: Floats = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    return units


@dataclass(frozen=True, eq=False, slots=True)
class MeshletBounds:
    """The bounds of runs of triangles.

    Attributes:
        lower, upper: (c, 3) float32, the boxes.
        axis: (c, 3) float32, the axes of the cones of normals.
        cosine: (c,) float32, at most the least cosine of the angle of a normal with the axis, below 0 for no cone.
        radius: (c,) float32, at least the largest distance of a vertex from the middle of the box.
    """

    lower: NDArray[np.float32]
    upper: NDArray[np.float32]
    axis: NDArray[np.float32]
    cosine: NDArray[np.float32]
    radius: NDArray[np.float32]


def bound_meshlets(positions: NDArray[Any], begins: Indices) -> MeshletBounds:
    """Return the bounds of meshlets.

    Args:
        positions: float32, the corners (3t, 3) of all triangles.
        begins: (c,) the triangle that each meshlet begins at, ascending from 0.
    """
    corners = positions.astype(np.float64).reshape(-1, 3, 3)
    sizes = np.diff(begins, append=len(corners))
    lower = reduce_runs(np.minimum, positions, 3 * begins)
    upper = reduce_runs(np.maximum, positions, 3 * begins)
    normals = unit_normals(corners)
    axis = reduce_runs(np.add, normals, begins)
    lengths = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.divide(axis, lengths, out=np.zeros_like(axis), where=lengths > 0.0).astype(np.float32)
    cosines = np.einsum("td,td->t", normals, repeat_each(axis.astype(np.float64), sizes, axis=0))
    cosines[~normals.any(axis=1)] = 1.0  # triangles without an area are never seen
    cosine = reduce_runs(np.minimum, cosines, begins)
    cosine = np.where(lengths[:, 0] > 0.0, cosine - 1e-6, -1.0)  # less the rounding of the axis's length
    middle = (np.float32(0.5) * (lower + upper)).astype(np.float64)  # as shaders compute it
    away = np.linalg.norm(corners - repeat_each(middle, sizes, axis=0)[:, None], axis=2).max(axis=1)
    radius = reduce_runs(np.maximum, away, begins) * (1.0 + 1e-6)
    return MeshletBounds(lower, upper, axis, cosine.astype(np.float32), _round_up(radius))


def _round_up(values: Floats) -> NDArray[np.float32]:
    return np.nextafter(values.astype(np.float32), np.float32(np.inf))
