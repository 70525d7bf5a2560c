"""Building scenes: meshes, materials, lights and objects as arrays, and what is refused."""

import numpy as np
import pytest
from refusals import refused_rule

from renderer import scene as scenes
from renderer.content import BUILT_IN
from renderer.scene.meshes import compute_normals
from rhi.errors import ValidationError
from rhi.math import multiply

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]


def build_two(dynamic=False):
    builder = scenes.SceneBuilder("two")
    box = builder.add_mesh(BUILT_IN["box"](), "box")
    ball = builder.add_mesh(BUILT_IN["sphere"](), "ball")
    red = builder.add_material(base_color=(1, 0, 0))
    arm = builder.add_node(scenes.translation((5, 0, 0)), dynamic=dynamic, name="arm")
    hand = builder.add_node(scenes.translation((0, 2, 0)), arm, name="hand")
    still = builder.add_node(name="still")
    builder.add_objects([hand, still], [box, ball], red)
    return builder, arm


def test_objects_have_the_bounds_of_their_mesh_in_the_world():
    scene = build_two()[0].build()
    assert np.allclose(scene.objects.lower[0], (4.5, 1.5, -0.5))
    assert np.allclose(scene.objects.upper[0], (5.5, 2.5, 0.5))
    assert scene.triangle_count == scene.meshes.triangle_counts.sum()


def test_triangles_are_counted_by_mesh_and_by_object():
    builder = scenes.SceneBuilder("counted")
    plane = scenes.make_geometry([*TRIANGLE, [1.0, 1.0, 0.0]], [0, 1, 2, 2, 1, 3])
    meshes = [
        builder.add_mesh(geometry)
        for geometry in (scenes.make_geometry(TRIANGLE, [0, 1, 2]), plane, BUILT_IN["box"]())
    ]
    nodes, material = [builder.add_node() for _ in range(3)], builder.add_material()
    builder.add_objects(nodes, [meshes[1], meshes[1], meshes[2]], material)
    scene = builder.build()
    assert scene.meshes.triangle_counts.tolist() == [1, 2, 12]
    assert scene.triangle_count == 2 + 2 + 12
    assert scene.count_triangles(np.array([0, 2])) == 2 + 12


def test_moving_a_node_moves_only_the_bounds_of_its_descendants():
    builder, _ = build_two(dynamic=True)
    scene = builder.build()
    assert scene.objects.dynamic.tolist() == [True, False]
    still = scene.objects.lower[1].copy()
    scene.nodes.set_local(
        scene.nodes.find("arm"),
        multiply(scenes.translation((9, 0, 0)), scenes.rotation((0, 0, 1), np.pi / 2)),
    )
    assert scene.update().tolist() == [0]
    assert np.allclose(scene.objects.lower[0], (6.5, -0.5, -0.5))
    assert (scene.objects.lower[1] == still).all()
    assert scene.update().size == 0


def test_an_animation_depends_on_the_time_alone():
    builder, arm = build_two(dynamic=True)
    builder.animate(arm, lambda seconds: scenes.translation([(seconds, 0.0, 0.0)]))
    scene = builder.build()
    scene.update(3.0)
    first = scene.objects.lower.copy()
    scene.update(1.0)
    assert not np.array_equal(scene.objects.lower, first)
    scene.update(3.0)
    assert np.array_equal(scene.objects.lower, first)


def test_animating_a_static_node_is_refused():
    builder, arm = build_two()
    builder.animate(arm, lambda seconds: scenes.translation([(seconds, 0.0, 0.0)]))
    assert refused_rule(builder.build) == "scene-static-node"


def test_meshes_share_arrays_that_draws_can_index():
    scene = build_two()[0].build()
    meshes = scene.meshes
    assert meshes.vertices.dtype == scenes.VERTEX
    for mesh, name in enumerate(("box", "sphere")):
        draw = meshes.ranges[mesh]
        geometry = BUILT_IN[name]()
        indices = meshes.indices[draw["first_index"] : draw["first_index"] + draw["index_count"]]
        assert np.array_equal(
            meshes.vertices[indices + draw["base_vertex"]], geometry.vertices[geometry.indices]
        )


def test_transforms_relative_to_a_far_eye_are_exact():
    builder = scenes.SceneBuilder("far")
    mesh = builder.add_mesh(scenes.make_geometry(TRIANGLE, [0, 1, 2]))
    node = builder.add_node(scenes.translation((1e6, 0.0, 1e6 + 0.25)))
    builder.add_objects(node, mesh, builder.add_material())
    relative = builder.build().relative_transforms((1e6, 0.0, 1e6))
    assert relative.dtype == np.float32
    assert relative[0, :3, 3].tolist() == [0.0, 0.0, 0.25]


SOLIDS = {name: make() for name, make in BUILT_IN.items()}
SOLIDS["mirrored"] = BUILT_IN["sphere"]().transformed(scenes.scaling((-1, 2, 1)))


@pytest.mark.parametrize("name", SOLIDS)
def test_built_in_meshes_mirrored_or_not_face_outwards_with_unit_normals(name):
    geometry = SOLIDS[name]
    corners = geometry.vertices[geometry.indices].reshape(-1, 3)
    position, normal = corners["position"].astype(np.float64), corners["normal"].astype(np.float64)
    face = np.cross(position[:, 1] - position[:, 0], position[:, 2] - position[:, 0])
    assert (np.linalg.norm(face, axis=1) > 0.0).all()
    assert ((face[:, None] * normal).sum(2) > 0.0).all()
    assert np.allclose(np.linalg.norm(normal, axis=2), 1.0, atol=1e-5)
    if name != "plane":
        volume = np.einsum("ij,ij->i", position[:, 0], np.cross(position[:, 1], position[:, 2])).sum() / 6
        assert volume > 0.0


def test_missing_normals_are_weighted_by_area():
    positions = np.array([*TRIANGLE, [0.0, 0.0, 3.0]])  # a small floor and a large wall share an edge
    normals = compute_normals(positions, [0, 1, 2, 0, 2, 3])
    assert np.allclose(normals[1], (0, 0, 1))
    assert np.allclose(normals[3], (1, 0, 0))
    assert np.allclose(normals[0], np.array([3.0, 0.0, 1.0]) / np.sqrt(10.0))


def test_degenerate_triangles_give_unit_normals_and_no_nan():
    normals = compute_normals(np.zeros((3, 3)), [0, 1, 2])
    assert normals.tolist() == [[0.0, 1.0, 0.0]] * 3


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_normals_of_tiny_and_huge_triangles_are_unit(scale):
    assert np.allclose(compute_normals(np.array(TRIANGLE) * scale, [0, 1, 2]), (0, 0, 1))


@pytest.mark.parametrize(
    ("positions", "indices", "rule"),
    [
        (TRIANGLE, [0, 1, 3], "scene-bad-mesh"),
        (TRIANGLE, [0, 1, -1], "scene-bad-mesh"),
        (TRIANGLE, [0, 1], "scene-bad-mesh"),
        (TRIANGLE, [], "scene-bad-mesh"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [0, 1, 2], "scene-bad-vertices"),
        ([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [0, 1, 2], "scene-bad-vertices"),
    ],
)
def test_bad_meshes_are_refused(positions, indices, rule):
    normals = np.tile((0.0, 0.0, 1.0), (3, 1))
    assert refused_rule(lambda: scenes.make_geometry(positions, np.array(indices, np.int64), normals)) == rule


def test_a_geometry_of_another_dtype_is_refused():
    assert refused_rule(lambda: scenes.MeshGeometry(np.zeros(3), np.zeros(3, np.uint32))) == "scene-bad-mesh"


def test_a_geometry_whose_indices_name_no_vertex_is_refused():
    vertices = np.zeros(3, scenes.VERTEX)
    assert (
        refused_rule(lambda: scenes.MeshGeometry(vertices, np.array([0, 1, 3], np.uint32)))
        == "scene-bad-mesh"
    )
    assert scenes.MeshGeometry(vertices, np.array([0, 1, 2], np.uint32)).triangle_count == 1


def test_materials_are_a_storage_buffer_without_padding():
    assert scenes.MATERIAL.itemsize == 128
    material = scenes.make_material(base_color=(0.1, 0.2, 0.3), texture=-1)
    assert material["base_color"].tolist() == pytest.approx([0.1, 0.2, 0.3, 1.0])


def test_lights_are_packed_relative_to_the_eye():
    lights = scenes.Lights()
    lights.add_directional((0, -2, 0), intensity=3.0)
    lights.add_point((1e6, 2.0, 0.0), 5.0, (1, 0.5, 0.25), 7.0)
    lights.add_spot((1e6, 3.0, 0.0), (0, -1, 0), 9.0, 0.0, np.pi)
    packed = lights.relative_to((1e6, 0.0, 0.0))
    assert packed["point"].dtype == scenes.RELATIVE_POINT
    assert (scenes.RELATIVE_POINT.itemsize, scenes.RELATIVE_SPOT.itemsize) == (32, 64)
    assert packed["point"]["position"].tolist() == [[0.0, 2.0, 0.0]]
    assert lights.directional["direction"].tolist() == [[0.0, -1.0, 0.0]]
    assert packed["spot"]["inner_versine"][0] == 0.0
    assert packed["spot"]["outer_versine"][0] == 2.0
    assert len(lights) == 3


@pytest.mark.parametrize(
    "add",
    [
        lambda lights: lights.add_directional((0, 0, 0)),
        lambda lights: lights.add_directional((0, np.nan, 0)),
        lambda lights: lights.add_point((0, 0, np.inf), 1.0),
        lambda lights: lights.add_point((0, 0, 0), -1.0),
        lambda lights: lights.add_point((0, 0, 0), np.inf),
        lambda lights: lights.add_point((0, 0, 0), 1.0, (1, 1, -1)),
        lambda lights: lights.add_point((0, 0, 0), 1.0, intensity=-1.0),
        lambda lights: lights.add_spot((0, 0, 0), (0, 1, 0), 1.0, 0.5, 0.4),
        lambda lights: lights.add_spot((0, 0, 0), (0, 1, 0), 1.0, 0.5, 3.2),
        lambda lights: lights.add_point((0, 0), 1.0),
        lambda lights: lights.add_point((0, 0, 0), 1e39),  # infinite as a float32
        lambda lights: lights.add_points((0, 0, 0), 1.0),
        lambda lights: lights.add_points(np.zeros((3, 3)), [1.0, 2.0]),
        lambda lights: lights.add_points(np.zeros((3, 3)), [1.0, 2.0, -1.0]),
        lambda lights: lights.add_points([(0, 0, 0), (0, np.nan, 0)], 1.0),
        lambda lights: lights.add_points(np.zeros((2, 3)), 1.0, [(1, 1, 1), (1, -1, 1)]),
        lambda lights: lights.add_spots(np.zeros((2, 3)), [(0, 1, 0), (0, 0, 0)], 1.0, 0.1, 0.2),
        lambda lights: lights.add_spots(np.zeros((2, 3)), (0, 1, 0), 1.0, [0.1, 0.3], 0.2),
    ],
)
def test_bad_lights_are_refused_and_nothing_is_added(add):
    lights = scenes.Lights()
    assert refused_rule(lambda: add(lights)) == "scene-bad-light"
    assert len(lights) == 0


def test_the_refusal_of_many_lights_names_the_first_bad_index():
    with pytest.raises(ValidationError, match=r"-2\.0 in row 1"):
        scenes.Lights().add_points(np.zeros((3, 3)), [1.0, -2.0, -3.0])


def test_lights_added_as_arrays_are_those_added_one_by_one():
    rng = np.random.default_rng(0)
    positions, aims, colors = rng.normal(size=(3, 5, 3))
    ranges, colors = rng.random(5), np.abs(colors)
    single, bulk = scenes.Lights(), scenes.Lights()
    for lights in (single, bulk):
        lights.add_point((1, 2, 3), 4.0)
    points = [single.add_point(*row, 2.0) for row in zip(positions, ranges, colors, strict=True)]
    spots = [
        single.add_spot(at, aim, reach, 0.1, reach + 0.1, color, reach)
        for at, aim, reach, color in zip(positions, aims, ranges, colors, strict=True)
    ]
    assert bulk.add_points(positions, ranges, colors, 2.0).tolist() == points == [1, 2, 3, 4, 5]
    added = bulk.add_spots(positions, aims, ranges, 0.1, ranges + 0.1, colors, ranges)
    assert added.tolist() == spots == [0, 1, 2, 3, 4]
    assert np.array_equal(single.point, bulk.point)
    assert np.array_equal(single.spot, bulk.spot)
    assert bulk.add_points(np.zeros((0, 3)), 1.0).tolist() == []


def test_lights_at_the_edge_of_their_range_are_taken():
    lights = scenes.Lights()
    lights.add_point((0, 0, 0), 0.0, (0, 0, 0), 0.0)
    lights.add_spot((0, 0, 0), (1e-300, 0, 0), 1e6, 0.0, 0.0)
    assert lights.spot["direction"].tolist() == [[1.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    "call",
    [
        lambda b: b.add_node(parent=3),
        lambda b: b.add_objects(3, 0, 0),
        lambda b: b.add_objects(0, 2, 0),
        lambda b: b.add_objects(0, 0, -1),
        lambda b: b.add_material(texture=0),
    ],
)
def test_ids_of_nothing_are_refused(call):
    builder = build_two()[0]
    assert refused_rule(lambda: call(builder)) == "scene-bad-index"
    builder.add_objects(2, 1, 0)


@pytest.mark.parametrize(
    "image", [np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2, 4)), np.zeros((0, 2, 4), np.uint8)]
)
def test_bad_images_are_refused(image):
    assert refused_rule(lambda: scenes.SceneBuilder("x").add_image(image)) == "scene-bad-image"


def test_a_scene_without_objects_is_refused():
    assert refused_rule(scenes.SceneBuilder("nothing").build) == "scene-empty-model"
