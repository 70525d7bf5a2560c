"""Meshes that are cut into meshlets, and the bounds of these: compared with brute force over the triangles."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from renderer.content import load_scene
from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.scene import Scene, SceneBuilder
from renderer.scene.meshes import MeshGeometry, make_geometry
from renderer.scene.meshlets import MESHLET_SIZES, bound_meshlets, cut_into_meshlets


def make_triangles(seed: int, count: int, kind: str) -> MeshGeometry:
    """Make a mesh of so many triangles: a strip of a sphere, a soup, or one whose triangles have no area."""
    rng = np.random.default_rng(seed)
    if kind == "sphere":
        sphere = bumpy_sphere(24, 0.1)
        return MeshGeometry(sphere.vertices, sphere.indices[: 3 * min(count, sphere.triangle_count)])
    points = rng.normal(0.0, 1.0, (3 * count, 3)) * np.exp(rng.uniform(-3.0, 3.0, 3))
    if kind == "flat":
        points[:, 1] = 0.0
    if kind == "without area":
        points[:] = points[0]
    return make_geometry(points, np.arange(3 * count), np.broadcast_to((0.0, 1.0, 0.0), points.shape))


def list_triangles(geometry: MeshGeometry) -> list[tuple[int, ...]]:
    return [tuple(triangle) for triangle in geometry.indices.reshape(-1, 3).tolist()]


KINDS = st.sampled_from(["sphere", "soup", "flat", "without area"])


@given(st.integers(0, 999), st.integers(1, 400), st.integers(*MESHLET_SIZES) | st.integers(8, 40), KINDS)
def test_each_triangle_is_in_exactly_one_meshlet(seed: int, count: int, most: int, kind: str) -> None:
    geometry = make_triangles(seed, count, kind)
    cut, sizes = cut_into_meshlets(geometry, most)
    assert Counter(list_triangles(cut)) == Counter(list_triangles(geometry))
    assert cut.vertices is geometry.vertices
    total = geometry.triangle_count
    if total <= most:
        assert not len(sizes)
        assert cut is geometry
        return
    assert sizes.sum() == total
    assert len(sizes) == -(-total // most)
    assert 0 < sizes.min() <= sizes.max() <= most


@given(st.integers(0, 999), st.integers(20, 300), KINDS)
def test_triangles_of_a_meshlet_keep_their_order(seed: int, count: int, kind: str) -> None:
    geometry = make_triangles(seed, count, kind)
    cut, sizes = cut_into_meshlets(geometry, 16)
    order = {triangle: number for number, triangle in enumerate(list_triangles(geometry))}
    numbers = np.array([order[triangle] for triangle in list_triangles(cut)])
    for part in np.split(numbers, np.cumsum(sizes)[:-1]):
        assert (np.diff(part) > 0).all()


@given(st.integers(0, 999), st.integers(1, 300), KINDS, st.floats(0.0, 1e6))
def test_bounds_contain_all_triangles(seed: int, count: int, kind: str, offset: float) -> None:
    geometry = make_triangles(seed, count, kind)
    vertices = geometry.vertices.copy()
    vertices["position"] += np.float32(offset)
    cut, sizes = cut_into_meshlets(MeshGeometry(vertices, geometry.indices), 16)
    begins = np.cumsum(sizes) - sizes if len(sizes) else np.zeros(1, np.int64)
    positions = cut.vertices["position"][cut.indices]
    bounds = bound_meshlets(positions, begins)
    corners = positions.astype(np.float64).reshape(-1, 3, 3)
    for number, part in enumerate(np.split(corners, begins[1:])):
        points = part.reshape(-1, 3)
        assert (bounds.lower[number] == points.min(axis=0)).all()
        assert (bounds.upper[number] == points.max(axis=0)).all()
        middle = 0.5 * (bounds.lower[number] + bounds.upper[number])
        assert np.linalg.norm(points - middle, axis=1).max() <= bounds.radius[number]
        if bounds.cosine[number] <= 0.0:
            continue
        for a, b, c in part:
            normal = np.cross(b - a, c - a)
            if not np.linalg.norm(normal):
                continue
            axis = bounds.axis[number].astype(np.float64)
            cosine = normal @ axis / np.linalg.norm(normal) / np.linalg.norm(axis)
            assert cosine >= bounds.cosine[number]


def test_cones_are_as_narrow_as_the_normals() -> None:
    cut, sizes = cut_into_meshlets(bumpy_sphere(64, 0.08), 64)
    bounds = bound_meshlets(cut.vertices["position"][cut.indices], np.cumsum(sizes) - sizes)
    angles = np.degrees(np.arccos(bounds.cosine))
    assert angles.max() < 60.0
    assert (
        np.median(angles) < 25.0
    )  # a part of 64 of 4,000 triangles spans about 14 degrees each way, bumps aside
    sides = make_geometry(
        [(0, 0, 0), (1, 0, 0), (0, 1, 0)], [0, 1, 2, 0, 2, 1], np.broadcast_to((0.0, 0.0, 1.0), (3, 3))
    )
    bounds = bound_meshlets(sides.vertices["position"][sides.indices], np.zeros(1, np.int64))
    assert bounds.cosine[0] < 0.0, "opposite normals have no cone"


def build(meshlet_size: int, levels: int = 0) -> Scene:
    builder = SceneBuilder("cut")
    for name in ("torus", "box", "sphere"):
        mesh = builder.add_mesh(BUILT_IN[name](), name, meshlet_size=meshlet_size, levels=levels)
        builder.add_objects(builder.add_node(), mesh, builder.add_material())
    return builder.build()


def test_scenes_list_the_meshlets_of_each_mesh() -> None:
    meshes = build(32, levels=2).meshes
    counts = np.diff(meshes.meshlet_begins)
    assert counts.tolist() == [-(-n // 32) if n > 32 else 0 for n in meshes.triangle_counts.tolist()]
    for mesh in range(3):
        parts = meshes.meshlet_ranges[meshes.meshlet_begins[mesh] : meshes.meshlet_begins[mesh + 1]]
        first, count, base = meshes.ranges[mesh].tolist()
        if not len(parts):
            continue
        begins = parts["first_index"].astype(np.int64)
        assert begins[0] == first
        assert (begins[1:] == begins[:-1] + parts["index_count"][:-1]).all(), "one behind the other"
        assert begins[-1] + parts["index_count"][-1] == first + count
        assert (parts["base_vertex"] == base).all()


@pytest.mark.parametrize(("triangles", "is_cut"), [(16, False), (17, True)])
def test_meshes_above_the_size_are_cut(triangles: int, is_cut: bool) -> None:
    builder = SceneBuilder("cut")
    mesh = builder.add_mesh(make_triangles(1, triangles, "soup"), meshlet_size=16)
    builder.add_objects(builder.add_node(), mesh, builder.add_material())
    assert bool(len(builder.build().meshes.meshlet_ranges)) == is_cut


def test_scenes_without_meshlets_keep_their_triangles() -> None:
    plain, cut = build(0).meshes, build(32).meshes
    assert not len(plain.meshlet_ranges)
    geometry = BUILT_IN["torus"]()
    assert (plain.geometry(0).indices == geometry.indices).all()
    assert (cut.geometry(0).indices != geometry.indices).any()


@pytest.mark.parametrize("size", [-1, 7, 4097, 1.5, True, "64"])
def test_sizes_that_no_meshlet_has_are_refused(size: object) -> None:
    builder = SceneBuilder("cut")
    for call in (
        lambda: builder.add_mesh(BUILT_IN["box"](), meshlet_size=size),  # type: ignore[arg-type]
        lambda: builder.cut_meshes(0, size),  # type: ignore[arg-type]
    ):
        with pytest.raises(rhi.ValidationError, match="meshlet_size") as error:
            call()
        assert error.value.rule.id == "scene-bad-mesh"
    for allowed in (0, 8, 4096):
        builder.add_mesh(BUILT_IN["box"](), meshlet_size=allowed)


def test_meshes_that_may_change_are_never_cut() -> None:
    builder = SceneBuilder("cut")
    geometry = BUILT_IN["torus"]()
    with pytest.raises(rhi.ValidationError, match="bounds"):
        builder.add_mesh(geometry, bounds=geometry.bounds, meshlet_size=16)
    meshes = [builder.add_mesh(geometry, bounds=geometry.bounds), builder.add_mesh(geometry)]
    builder.cut_meshes(0, 16)
    for mesh in meshes:
        builder.add_objects(builder.add_node(), mesh, builder.add_material())
    assert np.diff(builder.build().meshes.meshlet_begins).tolist() == [0, 64]


def test_a_geometry_added_twice_is_cut_once() -> None:
    builder, geometry = SceneBuilder("cut"), BUILT_IN["torus"]()
    first = builder.add_mesh(geometry)
    assert builder.add_mesh(geometry, meshlet_size=64) == first == builder.add_mesh(geometry)
    builder.add_objects(builder.add_node(), first, builder.add_material())
    assert len(builder.build().meshes.meshlet_ranges) == 16


def test_grids_say_the_size_of_their_meshlets() -> None:
    scene = load_scene("grid:mesh=torus,count=4,meshlet_size=64")
    assert len(scene.meshes.meshlet_ranges) == 16
    assert "meshlet_size=64" in scene.name
    assert not len(load_scene("grid:mesh=torus,count=4").meshes.meshlet_ranges)
    with pytest.raises(rhi.ValidationError, match="meshlet_size"):
        load_scene("grid:mesh=torus,count=4,meshlet_size=5")


@settings(max_examples=20)
@given(st.integers(0, 99))
def test_cuts_don_t_depend_on_anything_else(seed: int) -> None:
    geometry = make_triangles(seed, 200, "soup")
    first, second = cut_into_meshlets(geometry, 16), cut_into_meshlets(geometry, 16)
    assert (first[0].indices == second[0].indices).all()
