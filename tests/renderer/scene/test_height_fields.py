"""Height fields: the grids that maps become, their meshes, and what is refused."""

import numpy as np
import pytest
from refusals import refused_rule

from renderer.scene import SceneBuilder, make_height_field
from renderer.scene.tessellated_surfaces import bisect


@pytest.mark.parametrize(
    ("shape", "side"), [((1, 1), 2), ((2, 2), 2), ((3, 3), 3), ((4, 2), 5), ((5, 5), 5), ((1, 6), 9)]
)
def test_a_map_becomes_the_next_finer_grid(shape, side):
    field = make_height_field(np.ones(shape), 4.0)
    assert field.heights.shape == (side, side)
    assert (field.heights == 1.0).all()


def test_a_map_is_interpolated_between_its_corners():
    field = make_height_field([[0.0, 3.0], [0.0, 3.0], [3.0, 6.0], [6.0, 9.0]], (4.0, 8.0))
    assert field.heights[0, 0] == 0.0
    assert field.heights[-1, -1] == 9.0
    assert field.heights[0].tolist() == [0.0, 0.75, 1.5, 2.25, 3.0]
    assert field.positions()[0, 0, 0].tolist() == [-2.0, 0.0, -4.0]
    assert field.positions()[0, -1, -1].tolist() == [2.0, 9.0, 4.0]


def test_its_mesh_has_equal_triangles_as_many_as_the_limit_allows():
    for limit, count in ((2, 2), (3, 2), (64, 64), (127, 64), (128, 128), (10_000, 128)):
        mesh = make_height_field(np.zeros((9, 9)), 8.0, limit=limit).make_mesh()
        assert mesh.triangle_count == count
        corners = mesh.vertices["position"][mesh.indices.reshape(-1, 3)]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert normals[:, 1] == pytest.approx(128.0 / count)  # upwards, twice the area


def test_heights_between_vertices_are_interpolated():
    field = make_height_field([[0.0, 3.0], [6.0, 9.0]], (4.0, 8.0))
    assert field.sample_heights([-2.0, 2.0, 0.0, 9.0], [-4.0, -4.0, 2.0, 0.0]) == pytest.approx(
        [0.0, 3.0, 6.0, 6.0]
    )


def test_normals_and_tangents_follow_a_slope():
    x = np.linspace(0.0, 8.0, 9)
    mesh = make_height_field(np.broadcast_to(2.0 * x, (9, 9)), 8.0).make_mesh()
    assert mesh.vertices["normal"] == pytest.approx(
        np.broadcast_to(np.array([-2, 1, 0]) / 5**0.5, (81, 3)), abs=1e-6
    )
    assert mesh.vertices["tangent"] == pytest.approx(
        np.broadcast_to([5**-0.5, 2 * 5**-0.5, 0, 1], (81, 4)), abs=1e-6
    )


def test_lengths_and_reaches_hold_those_of_all_that_depends_on_a_vertex():
    field = make_height_field(np.random.default_rng(1).random((17, 17)) * 9.0, 16.0)
    points = field.positions().reshape(-1, 3)
    length, reach = (bound.reshape(-1) for bound in field.bounds)
    for depth in range(field.levels):
        left, _, right = bisect(17, depth).T
        middle = (left + right) // 2
        assert (length[middle] >= np.linalg.norm(points[left] - points[right], axis=1)).all()
        assert (reach[middle] >= np.linalg.norm(points[left] - points[middle], axis=1)).all()
        if depth + 1 < field.levels:
            below = bisect(17, depth + 1)
            child, above = (below[:, 0] + below[:, 2]) // 2, np.repeat(middle, 2)
            assert (length[above] > length[child]).all()
            assert (reach[above] > reach[child] + np.linalg.norm(points[above] - points[child], axis=1)).all()


@pytest.mark.parametrize(
    ("heights", "size", "limit"),
    [
        ([[np.nan]], 1.0, 2),
        ([[np.inf]], 1.0, 2),
        ([1.0], 1.0, 2),
        (np.zeros((0, 3)), 1.0, 2),
        (np.zeros((1, 4098)), 1.0, 2),
        ([[1.0]], 0.0, 2),
        ([[1.0]], (1.0, np.nan), 2),
        ([[1.0]], 1.0, 1),
    ],
)
def test_bad_maps_are_refused(heights, size, limit):
    assert refused_rule(lambda: make_height_field(heights, size, limit=limit)) == "scene-bad-heights"


def test_a_field_has_one_object():
    def make(count):
        builder = SceneBuilder("fields")
        mesh, material = builder.add_height_field(make_height_field([[1.0]], 1.0)), builder.add_material()
        for _ in range(count):
            builder.add_objects(builder.add_node(), mesh, material)
        return builder.build()

    assert list(make(1).tessellated) == [0]
    assert refused_rule(lambda: make(2)) == "scene-shared-heights"
