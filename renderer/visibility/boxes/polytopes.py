"""Convex polytopes around meshes: discrete oriented polytopes (k-DOPs), for tests for which boxes are too loose.

A k-DOP is bounded by k planes of fixed directions, each moved inwards until it touches the mesh: those of the box, and
planes that cut the box's corners (k = 14), its edges (18) or both (26). Directions are those of a box that is scaled to
a cube, so that they suit flat and long meshes too. It contains the mesh by construction: each plane has all vertices
behind it, and `_SLACK` covers the rounding of what is computed from the planes.

The cube is cut by one plane after the other. Faces are lists of vertices that neighbours share, so no gap opens between
them. Where rounding would break that, there is no polytope: the mesh's box stands for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import Floats, Indices
from renderer.visibility.boxes.cubes import CORNERS, FACES

PLANE_COUNTS: Final = (14, 18, 26)
"""The numbers of planes that a polytope may have."""
_SLACK: Final = 2.0**-20  # of the box's half size: 16 times the rounding of a float32 coordinate
_SHALLOWEST: Final = 1e-2  # planes that cut less off, along their normals in the cube, are left out
_LEAST_REACH: Final = 0.02  # of the box's half size: what is slimmer has no polytope
_SIGNS: Final = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], np.float64)


@dataclass(frozen=True, eq=False, slots=True)
class Polytope:
    """A convex polytope in the coordinates of a box that is the cube from -1 to 1.

    Attributes:
        centre: (3,) a point inside.
        corners: (t, 3, 3) the corners of its triangles relative to `centre`, counter-clockwise seen from outside.
        reach: it contains the cube from `centre` - `reach` to `centre` + `reach`.
    """

    centre: Floats
    corners: Floats
    reach: float


def list_normals(planes: int) -> Floats:
    """Return the normals (k - 6, 3) of those of `planes` that aren't the box's own."""
    counts = np.abs(_SIGNS).sum(axis=1)
    is_cut: NDArray[np.bool_] = {14: counts == 3, 18: counts == 2, 26: counts >= 2}[planes]
    return np.asarray(_SIGNS[is_cut])


def count_triangles(planes: int) -> int:
    """Return the most triangles that the faces of so many planes have: each vertex is on three of them."""
    return 4 * planes - 12


def compute_polytope(points: Floats, lower: Floats, upper: Floats, planes: int) -> Polytope | None:
    """Return the k-DOP around `points` (n, 3), which are in the box from `lower` to `upper`; None if it is the box, if
    that is flat, or if the polytope is too slim."""
    half = 0.5 * (upper - lower)
    if not (half > 0.0).all() or not len(points):
        return None
    scaled = (points - 0.5 * (lower + upper)) / half
    normals = np.concatenate([_SIGNS[np.abs(_SIGNS).sum(axis=1) == 1], list_normals(planes)])
    offsets = (scaled @ normals.T).max(axis=0) + _SLACK * np.abs(normals).sum(axis=1)
    offsets[:6] = 1.0 + _SLACK
    vertices, faces = (1.0 + _SLACK) * CORNERS.astype(np.float64), [list(face) for face in FACES.tolist()]
    is_cut = np.arange(len(normals)) < 6
    for number in range(6, len(normals)):
        used = np.unique(np.concatenate(faces))
        depth = (vertices[used] @ normals[number]).max() - offsets[number]
        if depth < _SHALLOWEST * np.linalg.norm(normals[number]):
            continue
        cut = _cut(vertices, faces, normals[number], offsets[number])
        if cut is None:
            return None
        (vertices, faces), is_cut[number] = cut, True
    if len(faces) == 6:
        return None
    triangles = [(face[0], *pair) for face in faces for pair in pairwise(face[1:])]
    corners = vertices[np.array(triangles)]
    centre = _compute_centroid(corners)
    normals, offsets = normals[is_cut], offsets[is_cut]
    reach = float(((offsets - normals @ centre) / np.abs(normals).sum(axis=1)).min())
    if reach < _LEAST_REACH:
        return None
    return Polytope(centre, corners - centre, reach)


def _compute_centroid(corners: Floats) -> Floats:
    """Return the centroid (3,) of the body that triangles (t, 3, 3) bound: that of tetrahedra from a point inside."""
    inside = corners.reshape(-1, 3).mean(axis=0)
    a, b, c = (corners - inside).transpose(1, 0, 2)
    volumes = np.einsum("td,td->t", a, np.cross(b, c))
    return np.asarray(inside + volumes @ (a + b + c) / (4.0 * volumes.sum()))


def _cut(
    vertices: Floats, faces: list[list[int]], normal: Floats, offset: float
) -> tuple[Floats, list[list[int]]] | None:
    """Return the part of a convex polytope behind a plane, as vertices and faces of their indices; None if rounding
    has made more than a loop of the section."""
    sides = vertices @ normal - offset
    is_outside = (sides > 0.0).tolist()
    crossings: dict[tuple[int, int], int] = {}
    added: list[Floats] = []
    section: dict[int, int] = {}
    remaining: list[list[int]] = []

    def cross(inner: int, outer: int) -> int:
        if (inner, outer) not in crossings:
            crossings[inner, outer] = len(vertices) + len(added)
            along = sides[inner] / (sides[inner] - sides[outer])
            added.append(vertices[inner] + along * (vertices[outer] - vertices[inner]))
        return crossings[inner, outer]

    for face in faces:
        inner_part: list[int] = []
        leaves: list[int] = []
        enters: list[int] = []
        for vertex, following in zip(face, [*face[1:], face[0]], strict=True):
            if not is_outside[vertex]:
                inner_part.append(vertex)
            if is_outside[vertex] != is_outside[following]:
                inner, outer = (following, vertex) if is_outside[vertex] else (vertex, following)
                inner_part.append(cross(inner, outer))
                (enters if is_outside[vertex] else leaves).append(inner_part[-1])
        if len(leaves) > 1:
            return None
        if leaves:
            section[enters[0]] = leaves[0]
        if inner_part:
            remaining.append(inner_part)
    loop = _follow(section)
    if loop is None:
        return None
    return np.concatenate([vertices, added]), [*remaining, loop]


def _follow(section: dict[int, int]) -> list[int] | None:
    """Return the loop of all edges of a section; None if they are no loop."""
    first = next(iter(section))
    loop, vertex = [first], section[first]
    while vertex != first and len(loop) <= len(section):
        loop.append(vertex)
        vertex = section.get(vertex, first)
    return loop if len(loop) == len(section) >= 3 else None


def list_box_corners() -> NDArray[np.float64]:
    """Return the corners (12, 3, 3) of a cube's triangles from -1 to 1, counter-clockwise seen from outside."""
    order: Indices = FACES[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int64)
    return CORNERS[order].astype(np.float64)
