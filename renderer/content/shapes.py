"""Built-in meshes: sheets, lathes, lofts, and the solids made of them.

A sheet is a grid of points; its normal is columns x rows. Outlines are closed polygons in the xz plane,
counter-clockwise seen from above, around a point from which every corner can be seen, so that their caps are
fans. Texture coordinates have v = 0 at the first row of an image, its top, so v decreases where y increases.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.scene.arrays import Floats
from renderer.scene.meshes import VERTEX, MeshGeometry, join, make_geometry

_SLIVER: Final = 1e-4  # a triangle is dropped if its area is less than this times its longest edge squared


def grid_mesh(
    points: ArrayLike, uv: ArrayLike | None = None, normals: ArrayLike | None = None
) -> MeshGeometry:
    """Make quads over a grid of points (rows, columns, 3), or over each of several (..., rows, columns, 3);
    rows and columns are at least 2.

    Without `normals`, of the shape of the points, each quad is flat and has vertices of its own. `uv` is
    (..., rows, columns, 2). Of degenerate quads, as at a pole, only the triangles with an area are kept.
    """
    grid = np.asarray(points, np.float64)
    coordinates = np.zeros((*grid.shape[:-1], 2)) if uv is None else np.asarray(uv, np.float64)
    corners = _quads(grid)
    if normals is not None:
        vertices = np.zeros(grid.size // 3, VERTEX)
        vertices["position"] = grid.reshape(-1, 3)
        vertices["normal"] = np.asarray(normals).reshape(-1, 3)
        vertices["uv"] = coordinates.reshape(-1, 2)
        return MeshGeometry(vertices, _triangles(vertices["position"], corners))
    vertices = np.zeros(corners.shape, VERTEX)
    vertices["position"], vertices["uv"] = grid.reshape(-1, 3)[corners], coordinates.reshape(-1, 2)[corners]
    a, b, c, d = (vertices["position"][:, i].astype(np.float64) for i in range(4))
    normal = np.cross(c - a, d - b)  # of the diagonals: correct for quads that taper to a point
    vertices["normal"] = (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))[:, None]
    flat = vertices.reshape(-1)
    return MeshGeometry(flat, _triangles(flat["position"], np.arange(len(flat)).reshape(-1, 4)))


def fan(outline: ArrayLike, y: float, uv: tuple[float, float] = (0.0, 0.0)) -> MeshGeometry:
    """Make a flat cap over an outline (k, 2) around the origin, facing up."""
    ring = np.asarray(outline, np.float64)
    count = len(ring)
    vertices = np.zeros(count + 1, VERTEX)
    vertices["position"][1:, (0, 2)] = ring
    vertices["position"][:, 1] = y
    vertices["normal"] = (0.0, 1.0, 0.0)
    vertices["uv"] = uv
    edge = np.arange(count)
    corners = np.stack([np.zeros(count, np.int64), 1 + edge, 1 + (edge + 1) % count], axis=1)
    return MeshGeometry(vertices, _without_slivers(vertices["position"], corners))


def box(detail: int = 1) -> MeshGeometry:
    """Make a cube from -1/2 to 1/2, with `detail` by `detail` quads on each face: 12 * detail² triangles."""
    steps = np.linspace(-0.5, 0.5, detail + 1)
    u, v = np.meshgrid(steps, steps)
    face = np.stack([u, v, np.full_like(u, 0.5)], axis=-1)
    sides = (face, face * (-1.0, 1.0, -1.0))  # rotating by 180° about the second axis keeps the orientation
    faces = np.stack([np.roll(side, axis, axis=-1) for axis in range(3) for side in sides])
    return grid_mesh(faces, np.broadcast_to(np.stack([u + 0.5, 0.5 - v], axis=-1), (*faces.shape[:-1], 2)))


def plane(detail: int = 1, uv_scale: tuple[float, float] = (1.0, 1.0)) -> MeshGeometry:
    """Make a square from -1/2 to 1/2 in xz, facing up."""
    steps = np.linspace(-0.5, 0.5, detail + 1)
    x, z = np.meshgrid(steps, -steps)
    return grid_mesh(
        np.stack([x, np.zeros_like(x), z], axis=-1), (np.stack([x, z], axis=-1) + 0.5) * uv_scale
    )


def lathe(profile: ArrayLike, segments: int) -> MeshGeometry:
    """Make a surface of revolution about y: `profile` (k, 2) holds (radius, y), from the bottom up.

    Normals are smooth around and flat along the profile; `segments` * k * 2 triangles at most.
    """
    ends = np.asarray(profile, np.float64)
    bands = np.stack([ends[:-1], ends[1:]], axis=1)[..., None]  # (k - 1, lower or upper, radius or y, 1)
    slope = bands[:, (1, 0), (1, 0)] - bands[:, (0, 1), (1, 0)]  # how much y rises and the radius falls
    slope = (slope / np.hypot(slope[:, :1], slope[:, 1:]))[:, None]
    angle = np.linspace(0.0, 2.0 * np.pi, segments + 1)
    u = np.broadcast_to(angle / (2.0 * np.pi), (len(bands), 2, segments + 1))
    points, normals = (
        np.stack(
            np.broadcast_arrays(np.cos(angle) * of[:, :, 0], of[:, :, 1], -np.sin(angle) * of[:, :, 0]), -1
        )
        for of in (bands, np.broadcast_to(slope, bands.shape))
    )
    return grid_mesh(points, np.stack([u, -points[..., 1]], axis=-1), normals)


def cylinder(segments: int = 24) -> MeshGeometry:
    """Make a cylinder of radius 1/2 with caps, y from -1/2 to 1/2."""
    return lathe([(0.0, -0.5), (0.5, -0.5), (0.5, 0.5), (0.0, 0.5)], segments)


def cone(segments: int = 24) -> MeshGeometry:
    """Make a cone with a base of radius 1/2 at y = -1/2 and its tip at y = 1/2."""
    return lathe([(0.0, -0.5), (0.5, -0.5), (0.0, 0.5)], segments)


def sphere(segments: int = 24) -> MeshGeometry:
    """Make a smooth sphere of radius 1/2, with `segments` around and half as many from pole to pole."""
    return _smooth_surface(lambda u, v: _sphere_point(u, v), segments, max(segments // 2, 3))


def torus(segments: int = 32) -> MeshGeometry:
    """Make a torus in xz that fits into a unit cube, with a tube radius of 1/8."""

    def point(u: Floats, v: Floats) -> tuple[Floats, Floats]:
        out = np.stack([np.cos(u), np.zeros_like(u), -np.sin(u)], axis=-1)
        normal = out * np.cos(v)[..., None] + np.array([0.0, 1.0, 0.0]) * np.sin(v)[..., None]
        return 0.375 * out + 0.125 * normal, normal

    return _smooth_surface(lambda u, v: point(u, 2.0 * v), segments, max(segments // 2, 3))


def bumpy_sphere(side: int = 32, height: float = 0.1, seed: int = 0) -> MeshGeometry:
    """Make a sphere of about `side`² triangles, whose radii are 1 and up to `height` more or less.

    Unlike `sphere` it has no seam and no texture coordinates: each position is one vertex, so it can be simplified
    everywhere.
    """
    rings = side // 2 - 1
    around = 2.0 * np.pi * np.arange(side) / side
    down = np.pi * np.arange(1, rings + 1)[:, None] / (rings + 1)
    ring = np.broadcast_arrays(np.sin(down) * np.cos(around), np.cos(down), -np.sin(down) * np.sin(around))
    points = np.concatenate([[[0.0, 1.0, 0.0]], np.stack(ring).reshape(3, -1).T, [[0.0, -1.0, 0.0]]])
    waves = np.random.default_rng(seed).normal(0.0, 3.0, (3, 3))
    points *= 1.0 + height * np.sin(points @ waves).prod(axis=1, keepdims=True)
    number = 1 + np.arange(rings * side).reshape(rings, side)
    ahead = np.roll(number, -1, axis=1)
    a, b, c, d = (part.reshape(-1) for part in (number[:-1], ahead[:-1], number[1:], ahead[1:]))
    caps = [
        np.stack(np.broadcast_arrays(0, number[0], ahead[0]), axis=1),
        np.stack(np.broadcast_arrays(rings * side + 1, ahead[-1], number[-1]), axis=1),
    ]
    return make_geometry(points, np.concatenate([*caps, np.stack([a, c, d], 1), np.stack([a, d, b], 1)]))


BUILT_IN: Final[dict[str, Callable[[], MeshGeometry]]] = {
    "box": box,
    "plane": plane,
    "cylinder": cylinder,
    "cone": cone,
    "sphere": sphere,
    "torus": torus,
}
"""The built-in meshes by name."""


def loft(
    outline: ArrayLike,
    rings: Sequence[tuple[float, float, float]],
    walls: tuple[float, float],
    roof_uv: tuple[float, float] = (0.0, 0.0),
    smooth: bool = False,
) -> MeshGeometry:
    """Make walls through `rings` (y, scale x, scale z) of an outline (k, 2), closed by a cap at the last
    ring.

    On steep parts the texture repeats `walls` = (times around, times per unit of y); flatter parts all get
    `roof_uv`. With `smooth`, steep parts that face outwards have normals away from the axis.
    """
    shape = np.asarray(outline, np.float64)
    closed = np.concatenate([shape, shape[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    around = length / length[-1] * walls[0]
    y, sx, sz = np.array(rings, np.float64).T[..., None]
    points = np.stack(np.broadcast_arrays(closed[:, 0] * sx, y, closed[:, 1] * sz), axis=-1)
    uv = np.stack(np.broadcast_arrays(around, -y * walls[1]), axis=-1)
    side = grid_mesh(points, uv)
    vertices = side.vertices.copy()
    level = np.abs(vertices["normal"][:, 1]) > 0.3
    vertices["uv"][level] = roof_uv
    if smooth:
        radial = vertices["position"] * np.array([1.0, 0.0, 1.0], np.float32)
        radial /= np.maximum(np.linalg.norm(radial, axis=1, keepdims=True), 1e-9)
        outward = ~level & ((vertices["normal"] * radial).sum(1) > 0.0)
        vertices["normal"][outward] = radial[outward]
    parts = [MeshGeometry(vertices, side.indices)]
    if min(rings[-1][1:]) > 0.0:
        parts.append(fan(shape * rings[-1][1:], rings[-1][0], roof_uv))
    return join(parts)


def _smooth_surface(
    point: Callable[[Floats, Floats], tuple[Floats, Floats]], columns: int, rows: int
) -> MeshGeometry:
    u, v = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, columns + 1), np.linspace(-0.5, 0.5, rows + 1) * np.pi)
    positions, normals = point(u, v)
    return grid_mesh(positions, np.stack([u / (2.0 * np.pi), 0.5 - v / np.pi], axis=-1), normals)


def _sphere_point(u: Floats, v: Floats) -> tuple[Floats, Floats]:
    normal = np.stack([np.cos(u) * np.cos(v), np.sin(v), -np.sin(u) * np.cos(v)], axis=-1)
    return 0.5 * normal, normal


def _quads(grid: Floats) -> NDArray[np.int64]:
    """Return the points at the corners of each quad, (quads, 4), of grids (..., rows, columns, 3)."""
    at = np.arange(grid.size // 3).reshape(grid.shape[:-1])
    parts = [at[..., :-1, :-1], at[..., :-1, 1:], at[..., 1:, 1:], at[..., 1:, :-1]]
    return np.stack(parts, axis=-1).reshape(-1, 4)


def _triangles(positions: NDArray[Any], quads: NDArray[np.int64]) -> NDArray[np.uint32]:
    return _without_slivers(positions, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3))


def _without_slivers(positions: NDArray[Any], corners: NDArray[np.int64]) -> NDArray[np.uint32]:
    a, b, c = (positions[corners[:, i]].astype(np.float64) for i in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    return np.ravel(corners[area > _SLIVER * longest**2]).astype(np.uint32)
