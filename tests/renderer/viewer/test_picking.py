"""Picking: what a ray meets is what the image shows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import rhi
from renderer.content import load_scene, parse_camera
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Scene, SceneBuilder, TextureMap, make_geometry
from renderer.viewer.picking import Hit, Ray, find_hit, intersect_boxes, intersect_triangles
from renderer.viewer.visibility_reasons import explain_visible
from renderer.visibility import make_visibility

SIZE = (96, 54)
SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
UV = [(0, 1), (1, 1), (1, 0), (0, 0)]
FRONT_CAMERA = Camera.look_at((0, 0, 5), (0, 0, 0), projection=Perspective(aspect=1.0))


def pick(scene: Scene, camera: Camera, x: int, y: int, size: tuple[int, int] = (64, 64)) -> Hit | None:
    ray = Ray.through(camera.with_aspect(size[0] / size[1]), size, x, y)
    return find_hit(scene, scene.make_simulator(), ray, np.arange(len(scene.objects)))


def square(matrix: Any = None, **material: Any) -> Scene:
    builder = SceneBuilder("square")
    mesh = builder.add_mesh(make_geometry(SQUARE, [0, 1, 2, 0, 2, 3], uv=UV))
    builder.add_objects(builder.add_node(matrix), mesh, builder.add_material(**material))
    return builder.build()


@pytest.mark.parametrize("projection", [Perspective(aspect=1.0), Orthographic(5.0, 1.0, 0.1, 100.0)])
def test_a_ray_goes_through_the_middle_of_its_pixel(projection: Any) -> None:
    camera = Camera.look_at((1.0, 2.0, 3.0), (0.3, -0.2, 0.1), projection=projection)
    ray = Ray.through(camera, (64, 64), 10, 50)
    for distance in (0.0, 7.0):
        clip = camera.view_projection @ np.append(ray.origin + distance * ray.direction, 1.0)
        assert clip[:2] / clip[3] == pytest.approx((2 * 10.5 / 64 - 1, 1 - 2 * 50.5 / 64), abs=1e-9)


def test_the_distance_is_from_the_eye() -> None:
    hit = pick(square(), FRONT_CAMERA, 32, 32)
    assert hit is not None
    assert hit.distance == pytest.approx(np.linalg.norm(hit.point - FRONT_CAMERA.position))
    assert hit.point[2] == pytest.approx(0.0, abs=1e-12)


def test_a_triangle_without_an_area_is_not_met() -> None:
    """Its weights are infinite or not numbers, which NumPy must not warn of."""
    line, triangle = [(0, 0, 0), (0, 1, 0), (0, 2, 0)], [(-1, -1, 0), (1, -1, 0), (0, 1, 0)]
    corners = np.array([line, [(0.1, 0, 0)] * 3, [(1, 0, 0), (1, -1, 0.5), (1, -0.3, 1)], triangle], float)
    distances, _ = intersect_triangles(
        np.array([0.0, 0.0, 3.0]), np.array([0.0, 0.0, -1.0]), corners, both_sides=True
    )
    assert distances.tolist() == [np.inf, np.inf, np.inf, 3.0]


def test_beside_the_object_there_is_nothing() -> None:
    assert pick(square(), FRONT_CAMERA, 0, 0) is None


@pytest.mark.parametrize(("sides", "is_met"), [(False, False), (True, True)])
def test_a_back_is_met_only_if_it_is_drawn(sides: bool, is_met: bool) -> None:
    behind = Camera.look_at((0, 0, -5), (0, 0, 0), projection=Perspective(aspect=1.0))
    assert (pick(square(double_sided=sides), behind, 32, 32) is not None) is is_met


@pytest.mark.parametrize("flip", [(-1.0, 1.0, 1.0), (1.0, 1.0, -1.0)])
def test_a_mirrored_object_keeps_its_front(flip: tuple[float, ...]) -> None:
    """Its outside stays outside: mirrored along z, the front of the square looks away."""
    seen = pick(square(np.diag((*flip, 1.0))), FRONT_CAMERA, 32, 32) is not None
    assert seen is (flip[2] > 0.0)


@pytest.mark.parametrize(("x", "is_met"), [(28, True), (36, False)])
def test_a_hole_of_a_mask_is_passed(x: int, is_met: bool) -> None:
    builder = SceneBuilder("mask")
    texels = np.full((2, 2, 4), 255, np.uint8)
    texels[:, 1, 3] = 0  # the right half
    mesh = builder.add_mesh(make_geometry(SQUARE, [0, 1, 2, 0, 2, 3], uv=UV))
    image = TextureMap(builder.add_image(texels))
    builder.add_objects(
        builder.add_node(), mesh, builder.add_material(texture=image, alpha_mode=1, alpha_cutoff=0.5)
    )
    assert (pick(builder.build(), FRONT_CAMERA, x, 32) is not None) is is_met


def test_the_nearest_of_two_is_met_whatever_their_boxes() -> None:
    """The box of the tilted triangle begins before the square, and its surface lies behind."""
    builder = SceneBuilder("two")
    material = builder.add_material()
    tilted = make_geometry([(-9, -9, 3), (9, -9, -3), (9, 9, -3), (-9, 9, -3)], [0, 1, 2, 0, 2, 3])
    plain = make_geometry(SQUARE, [0, 1, 2, 0, 2, 3])
    builder.add_objects(builder.add_node(), builder.add_mesh(tilted), material)
    builder.add_objects(builder.add_node(), builder.add_mesh(plain), material)
    hit = pick(builder.build(), FRONT_CAMERA, 36, 28)
    assert hit is not None
    assert (hit.object_index, hit.corners[:, 2].tolist()) == (1, [0, 0, 0])


def test_a_ray_does_not_hit_objects_beyond_the_near_and_far_planes() -> None:
    near = FRONT_CAMERA.with_projection(Perspective(aspect=1.0, near=6.0))
    far = FRONT_CAMERA.with_projection(Perspective(aspect=1.0, far=4.0))
    assert pick(square(), near, 32, 32) is None
    assert pick(square(), far, 32, 32) is None


def test_boxes_are_entered_where_a_ray_is_parallel_to_their_sides() -> None:
    ray = Ray(np.array((0.0, 0.0, 5.0)), np.array((0.0, 0.0, -1.0)), np.inf, 0.0)
    lower = np.array([(-1, -1, -1), (1, 0, 0), (0, 0, 0), (-1, -1, 4), (-1, -1, 6)], float)
    upper = np.array([(1, 1, 1), (2, 1, 1), (1, 1, 1), (1, 1, 6), (1, 1, 7)], float)
    assert intersect_boxes(ray, lower, upper).tolist() == [4, np.inf, 4, 0, np.inf]


def test_a_ray_beside_a_triangle_in_its_own_plane_misses_it() -> None:
    """Without a warning, too: its weights are infinities of both signs."""
    triangle = np.array([[(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)]])
    origin, direction = np.array([(0.0, 1.0, 0.0), (1.0, 0.0, -1.0)])
    distances, weights = intersect_triangles(origin, direction, triangle, both_sides=True)
    assert sorted(weights[0]) == [-np.inf, np.inf]
    assert distances.tolist() == [np.inf]


def test_no_ray_passes_between_two_triangles() -> None:
    rng = np.random.default_rng(7)
    corners = rng.normal(size=(200, 4, 3))
    for a, b, c, d in corners:
        middle = a + rng.uniform() * (c - a)  # on the shared edge
        origin = rng.normal(size=3) * 10
        pair = np.stack([(a, b, c), (a, c, d)])
        distances, _ = intersect_triangles(origin, middle - origin, pair, both_sides=True)
        assert np.isfinite(distances).any()


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=3")


def test_every_pixel_is_as_far_as_the_depth_image_says(drawing_device: rhi.Device, city: Scene) -> None:
    """Except where an edge passes nearer to the middle of a pixel than a rasteriser's grid."""
    camera = parse_camera("roofs", city).with_aspect(SIZE[0] / SIZE[1])
    visibility = make_visibility("frustum", city, drawing_device)
    with Renderer(drawing_device, city, size=SIZE, visibility=visibility) as renderer:
        result = renderer.render(camera)
        depth = np.asarray(result.depth.read(), np.float64)
        rows, simulator = result.visible, renderer.simulator
    near = camera.projection.near  # type: ignore[attr-defined]
    wrong = total = 0
    for y in range(0, SIZE[1], 5):
        for x in range(0, SIZE[0], 5):
            ray = Ray.through(camera, SIZE, x, y)
            hit = find_hit(city, simulator, ray, rows)
            drawn = near / depth[y, x] if depth[y, x] > 0.0 else np.inf
            met = np.inf if hit is None else -(camera.rotation @ (hit.point - camera.position))[2]
            wrong += not (drawn == met or abs(drawn - met) < 1e-3 * met)
            total += 1
    assert total == 220
    assert wrong <= 3


def test_a_simulated_object_is_met_where_it_is_drawn() -> None:
    hall = load_scene("hall:fountains=1")
    simulator = hall.make_simulator()
    row = next(
        row for row in hall.objects.simulated_indices.tolist() if simulator.read_vertices(row) is not None
    )
    part = hall.meshes.ranges[hall.objects.mesh[row]]
    corners = hall.meshes.indices[part["first_index"] :][: part["index_count"]][60:63]
    world = hall.nodes.world[hall.objects.node[row]]
    centres = []
    for step in range(60):
        simulator.begin_frame(step / 60)
        simulator.advance(np.array([row]))
        vertices = simulator.read_vertices(row)
        assert vertices is not None
        points = vertices["position"][corners] @ world[:3, :3].T + world[:3, 3]
        centres.append(points.mean(axis=0))
    assert np.linalg.norm(centres[-1] - centres[0]) > 0.01
    normal = np.cross(*np.diff(points, axis=0))
    normal /= np.linalg.norm(normal)
    hit = find_hit(hall, simulator, Ray(centres[-1] + 1e-3 * normal, -normal, np.inf, 0.0), np.array([row]))
    assert hit is not None
    assert (hit.triangle, hit.distance) == (20, pytest.approx(1e-3, rel=1e-3))


@pytest.mark.parametrize(
    ("name", "says"), [("none", "everything is drawn"), ("frustum", "its box is inside the view")]
)
def test_the_algorithm_says_why_an_object_is_drawn(
    null: rhi.Device, city: Scene, name: str, says: str
) -> None:
    camera = parse_camera("above", city).with_aspect(1.0)
    algorithm = make_visibility(name, city, null)
    small = int(np.argmin(np.linalg.norm(0.5 * (city.objects.lower + city.objects.upper) - 0.0, axis=1)))
    assert explain_visible(algorithm, city, camera, small) == says


def test_the_explanation_of_an_object_at_the_edge_of_the_view_says_that_it_crosses_it(
    null: rhi.Device, city: Scene
) -> None:
    plain = int(np.argmax(np.prod((city.objects.upper - city.objects.lower)[:, ::2], axis=1)))
    camera = parse_camera("above", city).with_aspect(1.0)
    explanation = explain_visible(make_visibility("frustum", city, null), city, camera, plain)
    assert explanation == "its box is across the edge of the view"


def test_the_explanation_of_an_object_names_the_state_of_its_node(
    drawing_device: rhi.Device, city: Scene
) -> None:
    camera = parse_camera("street", city).with_aspect(SIZE[0] / SIZE[1])
    algorithm = make_visibility("chc_plus_plus", city, drawing_device)
    with Renderer(drawing_device, city, size=SIZE, visibility=algorithm) as renderer:
        for _ in range(3):
            result = renderer.render(camera)
            result.image.read()
        explanations = {
            explain_visible(algorithm, city, camera, int(row)).partition("; ")[2] for row in result.visible
        }
    algorithm.destroy()
    assert explanations & {
        "a query found something in its node visible",
        "its node was taken as visible without a query",
    }
