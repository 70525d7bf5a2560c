"""Tangents by MikkTSpace's algorithm, of smooth, mirrored and degenerate texture coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.scene import MeshGeometry, make_geometry
from renderer.scene.tangents import add_tangents

UP = np.array([0.0, 0.0, 1.0])


def corners_of(geometry: MeshGeometry) -> NDArray[Any]:
    """Return the vertices of each triangle, (t, 3)."""
    return geometry.vertices[geometry.indices].reshape(-1, 3)


def strip(u: list[float], v: tuple[float, float] = (0.0, 1.0)) -> MeshGeometry:
    """Make quads side by side in the plane z = 0, with these u at their columns, and v at their lower and
    upper row."""
    count = len(u)
    x = np.arange(count, dtype=float)
    positions = np.concatenate([np.stack([x, 0 * x + row, 0 * x], axis=1) for row in (0, 1)])
    uv = np.concatenate([np.stack([u, np.full(count, row)], axis=1) for row in v])
    quads = [[i, i + 1, count + i + 1, i, count + i + 1, count + i] for i in range(count - 1)]
    return make_geometry(positions, np.concatenate(quads), np.tile(UP, (2 * count, 1)), uv)


@pytest.mark.parametrize("name", list(BUILT_IN))
def test_tangents_are_unit_and_perpendicular_to_normals(name: str) -> None:
    with_tangents = add_tangents(BUILT_IN[name]())
    tangent, normal = with_tangents.vertices["tangent"][:, :3], with_tangents.vertices["normal"]
    np.testing.assert_allclose(np.linalg.norm(tangent, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose((tangent * normal).sum(1), 0.0, atol=1e-6)
    assert (np.abs(with_tangents.vertices["tangent"][:, 3]) == 1.0).all()


@pytest.mark.parametrize("name", list(BUILT_IN))
def test_adding_tangents_leaves_the_triangles_unchanged(name: str) -> None:
    geometry = BUILT_IN[name]()
    with_tangents = add_tangents(geometry)
    for field in ("position", "normal", "uv"):
        assert np.array_equal(corners_of(with_tangents)[field], corners_of(geometry)[field])


def test_tangents_lead_along_u_and_bitangents_up_in_the_image() -> None:
    for upright, sign in ((strip([0, 1, 2], (1.0, 0.0)), 1.0), (strip([0, 1, 2], (0.0, 1.0)), -1.0)):
        vertices = add_tangents(upright).vertices
        assert vertices["tangent"].tolist() == [[1.0, 0.0, 0.0, sign]] * 6


def test_where_a_texture_is_mirrored_vertices_become_two() -> None:
    with_tangents = add_tangents(strip([0, 1, 0], (1.0, 0.0)))
    assert len(with_tangents.vertices) == 8
    assert (
        corners_of(with_tangents)["tangent"].tolist()
        == [[[1.0, 0, 0, 1]] * 3] * 2 + [[[-1.0, 0, 0, -1]] * 3] * 2
    )


def test_without_splitting_vertices_keep_their_number_and_order() -> None:
    geometry = strip([0, 1, 0], (1.0, 0.0))
    with_tangents = add_tangents(geometry, splits=False)
    assert np.array_equal(with_tangents.indices, geometry.indices)
    assert np.array_equal(with_tangents.vertices["position"], geometry.vertices["position"])
    assert with_tangents.vertices["tangent"][0].tolist() == [1.0, 0.0, 0.0, 1.0]


def test_a_triangle_without_area_in_texture_coordinates_takes_its_neighbours_tangents() -> None:
    with_tangents = add_tangents(strip([0, 1, 1, 2], (1.0, 0.0)))  # the middle quad is a line of the image
    assert len(with_tangents.vertices) == 8
    assert with_tangents.vertices["tangent"].tolist() == [[1.0, 0.0, 0.0, 1.0]] * 8


def test_without_any_texture_coordinates_tangents_are_perpendicular_to_normals() -> None:
    with_tangents = add_tangents(strip([0, 0, 0], (0.0, 0.0)))
    assert with_tangents.vertices["tangent"].tolist() == [[1.0, 0.0, 0.0, 1.0]] * 6


def test_triangles_of_no_size_give_no_nan() -> None:
    flat = make_geometry(np.zeros((3, 3)), [0, 1, 2], np.tile(UP, (3, 1)), [[0, 0], [1, 0], [0, 1]])
    assert np.isfinite(add_tangents(flat).vertices["tangent"]).all()
    nothing = make_geometry(np.eye(3), [0, 1, 2], np.zeros((3, 3)), [[0, 0], [1, 0], [0, 1]])
    assert np.isfinite(add_tangents(nothing).vertices["tangent"]).all()


def test_tangents_are_weighted_by_the_angle_at_their_vertex() -> None:
    # At the vertex 0, a corner of 90° whose u grows along x, where v stays the same, and one of 45° along (1,
    # 1).
    positions = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 1, 0]]
    geometry = make_geometry(
        positions, [0, 1, 2, 0, 2, 3], np.tile(UP, (4, 1)), [[0, 0], [1, 0], [0, -1], [-1, -2]]
    )
    tangents = add_tangents(geometry).vertices["tangent"]
    assert tangents[1].tolist() == [1.0, 0.0, 0.0, 1.0]
    assert tangents[3].tolist() == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0.0, 1.0])
    both = 90.0 * tangents[1, :2] + 45.0 * tangents[3, :2]
    assert tangents[0, :2].tolist() == pytest.approx((both / np.linalg.norm(both)).tolist())


@pytest.mark.parametrize("scale", [1e-12, 1e12])
def test_tangents_do_not_depend_on_size(scale: float) -> None:
    torus = BUILT_IN["torus"]()
    resized = make_geometry(
        torus.vertices["position"] * scale,
        torus.indices,
        torus.vertices["normal"],
        torus.vertices["uv"] * scale,
    )
    np.testing.assert_allclose(
        corners_of(add_tangents(resized))["tangent"], corners_of(add_tangents(torus))["tangent"], atol=1e-3
    )
