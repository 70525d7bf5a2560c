"""Simplified versions of meshes: their bounds, compared with distances between dense samples in float64, and what of a
mesh they keep."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from dense_meshes import make_grid
from hypothesis import example, given, settings
from hypothesis import strategies as st

from renderer.content import BUILT_IN
from renderer.content.shapes import bumpy_sphere, torus
from renderer.scene import MeshGeometry, MeshLevel, SceneBuilder, simplify
from renderer.scene.meshes import join, make_geometry
from rhi import ValidationError


def corners(geometry: MeshGeometry, indices: np.ndarray) -> np.ndarray:
    """Return the corners of triangles (t, 3, 3)."""
    return geometry.vertices["position"][indices].astype(np.float64).reshape(-1, 3, 3)


def measure_distances(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the distance of each point (k, 3) from the nearest of all triangles (t, 3, 3)."""
    a, b, c = triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    nearest = []
    for part in np.array_split(points, max(len(points) // 100, 1)):
        p = part[:, None]
        heights = ((p - a) * normals).sum(axis=-1)
        foot = p - heights[..., None] * normals
        inside = np.ones(heights.shape, bool)
        distances = np.full(heights.shape, np.inf)
        for begin, end in ((a, b), (b, c), (c, a)):
            edge = end - begin
            inside &= (np.cross(edge, foot - begin) * normals).sum(axis=-1) >= 0.0
            along = ((p - begin) * edge).sum(axis=-1) / np.maximum((edge * edge).sum(axis=-1), 1e-300)
            at = begin + along.clip(0.0, 1.0)[..., None] * edge
            distances = np.minimum(distances, np.linalg.norm(p - at, axis=-1))
        nearest.append(np.where(inside, np.abs(heights), distances).min(axis=1))
    return np.concatenate(nearest)


def sample(triangles: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return about so many points of triangles, and their corners and middles."""
    each = max(count // len(triangles), 1)
    weights = np.random.default_rng(seed).dirichlet(np.ones(3), (len(triangles), each))
    return np.concatenate(
        [(weights @ triangles).reshape(-1, 3), triangles.reshape(-1, 3), triangles.mean(axis=1)]
    )


def measure_hausdorff(geometry: MeshGeometry, level: MeshLevel, count: int = 1500, seed: int = 0) -> float:
    """Return the largest distance of samples of a mesh from a level, and of the level from the mesh."""
    whole, part = corners(geometry, geometry.indices), corners(geometry, level.indices)
    there = measure_distances(sample(whole, count, seed), part).max()
    back = measure_distances(sample(part, count, seed), whole).max()
    return float(max(there, back))


@settings(max_examples=6)
@given(st.integers(12, 18), st.floats(0.0, 0.4), st.integers(0, 99))
@example(20, 0.0, 0)
def test_no_point_is_farther_than_the_bound(side: int, height: float, seed: int) -> None:
    geometry = bumpy_sphere(side, height, seed)
    levels = simplify(geometry, 4)
    assert levels
    for level in levels:
        distance = measure_hausdorff(geometry, level, seed=seed)
        assert distance <= level.error
        assert level.error <= 8.0 * distance, "the bound is of use"


def test_a_torus_and_parts_far_from_each_other_keep_their_bounds() -> None:
    ring = torus(14)
    far = ring.transformed(np.diag([0.01, 0.01, 0.01, 1.0]) + np.eye(4, 4, 3) * [[50.0], [0.0], [0.0], [0.0]])
    for geometry in (ring, join([ring, far])):
        levels = simplify(geometry, 2)
        assert len(levels) == 2
        assert all(measure_hausdorff(geometry, level) <= level.error for level in levels)


def test_each_level_has_half_the_triangles_and_a_larger_bound() -> None:
    geometry = bumpy_sphere(32)
    counts = [geometry.triangle_count, *(len(level.indices) // 3 for level in simplify(geometry, 4))]
    errors = [level.error for level in simplify(geometry, 4)]
    assert all(0.4 * before <= after <= 0.52 * before for before, after in pairwise(counts))
    assert errors == sorted(errors)
    assert errors[0] > 0.0


def test_a_closed_surface_stays_closed_and_keeps_its_winding() -> None:
    geometry = bumpy_sphere(28)
    for level in simplify(geometry, 4):
        triangles = level.indices.reshape(-1, 3).astype(np.int64)
        edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        directed = {tuple(edge) for edge in edges.tolist()}
        assert len(directed) == len(edges)
        assert all((b, a) in directed for a, b in directed)
        a, b, c = corners(geometry, level.indices).transpose(1, 0, 2)
        assert (np.cross(a, b) * c).sum() / 6.0 > 2.0  # the volume: 4.19 for a sphere


def test_a_plane_loses_nothing_but_triangles() -> None:
    geometry = make_grid(24, lambda x, y: 0.3 * x - 0.2 * y)
    levels = simplify(geometry, 3)
    assert len(levels) == 3
    assert all(level.error < 1e-6 for level in levels)
    control = simplify(make_grid(24, lambda x, y: 0.1 * np.sin(9.0 * x) * y), 3)
    assert all(level.error > 1e-3 for level in control)


def test_borders_and_seams_stay() -> None:
    geometry = make_grid(20, lambda x, y: 0.05 * np.sin(7.0 * x + y))
    position = geometry.vertices["position"]
    is_border = (np.abs(position[:, [0, 2]]) > 0.999).any(axis=1)
    (level, *_) = simplify(geometry, 1)
    remaining = np.zeros(len(position), bool)
    remaining[level.indices] = True
    assert remaining[is_border].all()
    assert remaining[~is_border].sum() < 0.5 * (~is_border).sum()
    # Two halves that share positions, but not vertices: nothing moves across.
    left = geometry.indices.reshape(-1, 3)[position[geometry.indices.reshape(-1, 3), 0].mean(axis=1) < 0.0]
    right = geometry.indices.reshape(-1, 3)[position[geometry.indices.reshape(-1, 3), 0].mean(axis=1) >= 0.0]
    halves = join(
        [MeshGeometry(geometry.vertices, np.ascontiguousarray(part).reshape(-1)) for part in (left, right)]
    )
    (level, *_) = simplify(halves, 1)
    is_seam = np.abs(halves.vertices["position"][:, 0]) < 1e-6
    used = np.zeros(len(halves.vertices), bool)
    used[halves.indices] = True
    remaining = np.zeros(len(halves.vertices), bool)
    remaining[level.indices] = True
    assert remaining[is_seam & used].all()


def test_few_triangles_and_hard_edges_are_left_alone() -> None:
    assert simplify(BUILT_IN["box"](), 3) == ()
    sphere = bumpy_sphere(16)
    assert simplify(sphere, 0) == ()
    flat = make_geometry(sphere.vertices["position"][sphere.indices], np.arange(len(sphere.indices)))
    assert simplify(sphere, 1)
    (level,) = simplify(flat, 1) or (None,)
    assert level is None or len(level.indices) == len(flat.indices)


def test_degenerate_triangles_are_kept() -> None:
    sphere = bumpy_sphere(16)
    indices = np.concatenate([sphere.indices, np.array([0, 0, 5], np.uint32)])
    (level,) = simplify(MeshGeometry(sphere.vertices, indices), 1)
    assert [0, 0, 5] in level.indices.reshape(-1, 3).tolist()


@pytest.mark.parametrize("levels", [-1, 1.5, "2"])
def test_numbers_of_levels_are_checked(levels: object) -> None:
    with pytest.raises(ValidationError, match=r"^\[scene-bad-mesh\]"):
        SceneBuilder("x").add_mesh(bumpy_sphere(16), levels=levels)  # type: ignore[arg-type]


def test_a_mesh_that_may_change_has_no_levels() -> None:
    sphere = bumpy_sphere(16)
    builder = SceneBuilder("x")
    with pytest.raises(ValidationError, match=r"^\[scene-bad-mesh\]"):
        builder.add_mesh(sphere, bounds=sphere.bounds, levels=2)
    assert builder.add_mesh(sphere, bounds=sphere.bounds) == 0  # the refused one wasn't added


def test_a_scene_has_the_levels_of_its_meshes() -> None:
    builder = SceneBuilder("x")
    material = builder.add_material()
    for levels, geometry in ((2, bumpy_sphere(16)), (0, BUILT_IN["box"]()), (3, bumpy_sphere(20))):
        builder.add_objects(builder.add_node(), builder.add_mesh(geometry, levels=levels), material)
    meshes = builder.build().meshes
    assert meshes.level_begins.tolist() == [0, 2, 2, 5]
    assert np.isinf(meshes.level_errors).tolist() == [[False, False, True], [True] * 3, [False] * 3]
    expected = [*simplify(bumpy_sphere(16), 2), *simplify(bumpy_sphere(20), 3)]
    for row, level in zip(meshes.level_ranges, expected, strict=True):
        part = meshes.level_indices[row["first_index"] :][: row["index_count"]]
        assert part.tolist() == level.indices.tolist()


def test_all_meshes_but_those_that_change_are_simplified_at_once() -> None:
    builder = SceneBuilder("x")
    material = builder.add_material()
    geometries = [bumpy_sphere(12, seed=seed) for seed in range(3)]
    meshes = [builder.add_mesh(geometries[0]), builder.add_mesh(geometries[1])]
    meshes.append(builder.add_mesh(geometries[2], bounds=geometries[2].bounds))
    builder.add_objects(builder.add_nodes(np.eye(4)[None].repeat(3, axis=0)), meshes, material)
    builder.simplify_meshes(1, 2)
    counts = np.diff(builder.build().meshes.level_begins)
    assert counts[0] == counts[2] == 0 < counts[1] <= 2


def test_a_mesh_that_is_added_again_has_the_most_levels() -> None:
    builder, geometry = SceneBuilder("x"), bumpy_sphere(12)
    mesh = builder.add_mesh(geometry)
    assert builder.add_mesh(geometry, levels=2) == builder.add_mesh(geometry) == mesh
    builder.add_objects(builder.add_node(), mesh, builder.add_material())
    assert builder.build().meshes.level_begins[-1] > 0
