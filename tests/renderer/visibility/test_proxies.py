"""Polytopes that are tested in place of boxes: compared in float64 with the vertices that they must contain, and the
images with those of boxes."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from occlusion_scenes import cameras, draw_with, make_camera

import rhi
from renderer.content import load_scene
from renderer.content.shapes import BUILT_IN, bumpy_sphere
from renderer.frame import SceneResources, View
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, translation
from renderer.scene.meshes import VERTEX, MeshGeometry
from renderer.visibility import NoCulling, TwoPassCulling, VisibilitySettings
from renderer.visibility.boxes.bounds import UNKNOWN_SIZE, margin_terms, near_radius
from renderer.visibility.boxes.polytopes import (
    PLANE_COUNTS,
    Polytope,
    compute_polytope,
    count_triangles,
    list_box_corners,
)
from renderer.visibility.gpu.occludees import HIDDEN
from renderer.visibility.gpu.proxies import ProxyOccludees
from rhi import Op, ValidationError
from rhi.math import is_parallel, multiply, rotation, scaling

KINDS = ("cloud", "lattice", "slim", "ball", "corner", "few")
SIZE = (96, 54)


def make_points(seed: int, kind: str) -> np.ndarray:
    """Return points (n, 3) of float32 of a kind of mesh, as float64."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(40, 3)) @ rng.normal(size=(3, 3)) + rng.normal(size=3)
    if kind == "lattice":  # many in one plane
        points = np.round(2.0 * rng.normal(size=(40, 3)))
    if kind == "slim":
        points = np.outer(rng.uniform(-1.0, 1.0, 40), rng.normal(size=3)) + 0.2 * rng.normal(size=(40, 3))
    if kind == "ball":
        points = points / np.linalg.norm(points, axis=1, keepdims=True)
    if kind == "corner":  # a tetrahedron without the middle of its box
        points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]) * rng.uniform(0.3, 3.0, 3)
    if kind == "few":
        points = points[: rng.integers(1, 6)]
    return points.astype(np.float32).astype(np.float64)


def measure_room(triangles: np.ndarray, points: np.ndarray) -> float:
    """Return the least distance of points (n, 3) from the planes of a body's triangles (t, 3, 3), of those that aren't
    empty; below 0 for a point outside."""
    a, b, c = triangles.transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    longest = np.linalg.norm(np.stack([b - a, c - b, a - c]), axis=2).max(axis=0)
    lengths = np.linalg.norm(normals, axis=1)
    solid = lengths > 1e-4 * longest * longest.max()  # slivers have no normal of any use
    inward = np.einsum("tnd,td->tn", a[solid, None] - points[None], normals[solid])
    return float((inward / lengths[solid, None]).min())


def require_polytope(seed: int, kind: str, planes: int) -> tuple[Polytope, np.ndarray]:
    """Return the polytope of points of a kind, and the points in its coordinates."""
    points = make_points(seed, kind)
    lower, upper = points.min(axis=0), points.max(axis=0)
    polytope = compute_polytope(points, lower, upper, planes)
    if polytope is None:
        pytest.skip("its box is as good")
    return polytope, (points - 0.5 * (lower + upper)) / (0.5 * (upper - lower)) - polytope.centre


POLYTOPES = given(st.integers(0, 9999), st.sampled_from(KINDS[:-1]), st.sampled_from(PLANE_COUNTS))


@POLYTOPES
def test_a_polytope_contains_the_mesh(seed: int, kind: str, planes: int) -> None:
    polytope, points = require_polytope(seed, kind, planes)
    assert measure_room(polytope.corners, points) >= 0.0
    assert measure_room(0.99 * polytope.corners, points) < 0.0  # and it touches it


@POLYTOPES
def test_a_polytope_contains_the_cube_of_its_reach(seed: int, kind: str, planes: int) -> None:
    polytope, _ = require_polytope(seed, kind, planes)
    cube = polytope.reach * list_box_corners().reshape(-1, 3)
    assert measure_room(polytope.corners, (1.0 - 1e-9) * cube) >= 0.0
    assert measure_room(polytope.corners, 1.01 * cube) < 0.0


@POLYTOPES
def test_a_polytope_is_closed(seed: int, kind: str, planes: int) -> None:
    """Each edge is passed as often one way as the other, so no gap opens where vertices move by parts of a pixel."""
    polytope, _ = require_polytope(seed, kind, planes)
    edges: Counter[tuple[tuple[float, ...], tuple[float, ...]]] = Counter()
    for triangle in polytope.corners:
        corners = [tuple(corner) for corner in triangle.tolist()]
        edges.update(
            pair for pair in zip(corners, corners[1:] + corners[:1], strict=True) if pair[0] != pair[1]
        )
    assert edges
    assert all(edges[end, begin] == count for (begin, end), count in edges.items())


@POLYTOPES
def test_a_polytope_has_no_more_triangles_than_all_are_drawn_with(seed: int, kind: str, planes: int) -> None:
    polytope, _ = require_polytope(seed, kind, planes)
    assert 12 < len(polytope.corners) <= count_triangles(planes)


@given(st.integers(0, 999))
def test_fewer_points_than_a_body_has_have_no_polytope_or_one_around_them(seed: int) -> None:
    points = make_points(seed, "few")
    lower, upper = points.min(axis=0), points.max(axis=0)
    polytope = compute_polytope(points, lower, upper, 26)
    if (upper == lower).any():
        assert polytope is None


@pytest.mark.parametrize("planes", PLANE_COUNTS)
def test_a_box_has_no_polytope_and_a_ball_has(planes: int) -> None:
    for points, has_polytope in [(BUILT_IN["box"](), False), (BUILT_IN["sphere"](), True)]:
        corners = points.vertices["position"].astype(np.float64)
        polytope = compute_polytope(corners, corners.min(axis=0), corners.max(axis=0), planes)
        assert (polytope is not None) == has_polytope


def make_bodies(seed: int) -> Scene:
    """Make bodies of all kinds, turned, stretched, and every other one mirrored."""
    rng, builder = np.random.default_rng(seed), SceneBuilder("bodies")
    for number in range(16):
        points = make_points(seed + number, KINDS[number % 5])
        points = points / np.abs(points).max()
        vertices = np.zeros(len(points), VERTEX)
        vertices["position"] = points
        triangles = np.array([(i, i + 1, i + 2) for i in range(len(points) - 2)], np.uint32)
        mesh = builder.add_mesh(MeshGeometry(vertices, triangles.reshape(-1)))
        stretch = np.exp(rng.normal(0.0, 0.5, 3)) * (1.0, 1.0, -1.0 if number % 2 else 1.0)
        axis = rng.normal(size=3)
        turned = multiply(rotation(axis / np.linalg.norm(axis), rng.uniform(0.0, 6.3)), scaling(stretch))
        if number == 7:
            turned[:3, 0] = turned[:3, 1] + 0.01 * turned[:3, 2]  # too skewed for a polytope
        node = builder.add_node(multiply(translation(rng.uniform(-8.0, 8.0, 3)), turned))
        builder.add_objects(node, mesh, builder.add_material())
    return builder.build()


def fit_polytopes(
    device: rhi.Device, scene: Scene, camera: Camera, planes: int
) -> tuple[dict[int, np.ndarray], int]:
    """Return the triangles (t, 3, 3) of each object that is tested, relative to the eye as the vertex shader computes
    them but in float64, and how many of them are polytopes."""
    resources, occludees = SceneResources(device, scene), ProxyOccludees(device, scene, planes)
    view = View(device, "eye", NoCulling(scene))
    view.aim(camera)
    resources.update(camera)
    occludees.aim(camera, UNKNOWN_SIZE)
    occludees.compute_boxes(device, resources.scene_arrays(view.buffer))
    boxes, marks = occludees.boxes.read(), occludees.marks.read()
    firsts = occludees._first_corners.read()
    corners = occludees._corners.read()["position"][:, :3].astype(np.float64)
    for resource in (resources, view, occludees):
        resource.destroy()
    count, bodies = 3 * count_triangles(planes), {}
    for index in np.flatnonzero(marks == HIDDEN).tolist():
        first, box = int(firsts[index]), boxes[index]
        begin = -1 - first if first < 0 else first
        local = corners[begin : begin + count].reshape(-1, 3, 3)
        axes = np.stack([box["x"], box["y"], box["z"]], axis=1).astype(np.float64)[:3]
        triangles = local @ axes.T + box["centre"].astype(np.float64)[:3]
        bodies[index] = triangles[:, ::-1] if first < 0 else triangles
    return bodies, int((firsts[marks == HIDDEN] != 0).sum())


@settings(max_examples=25)
@given(st.integers(0, 9999), cameras(), st.sampled_from(PLANE_COUNTS))
def test_drawn_polytopes_contain_the_object_and_its_margin(
    device: rhi.Device, seed: int, camera: Camera, planes: int
) -> None:
    """Both of polytopes and of boxes that stay, with their fronts outside: else the room would be below 0."""
    scene = make_bodies(seed)
    bodies, _ = fit_polytopes(device, scene, camera, planes)
    constant, linear, square = margin_terms(camera)
    meshes = scene.meshes
    for index, triangles in bodies.items():
        world, mesh = scene.nodes.world[scene.objects.node[index]], scene.objects.mesh[index]
        begin = int(meshes.ranges["base_vertex"][mesh])
        local = meshes.vertices["position"][begin : begin + meshes.vertex_counts[mesh]].astype(np.float64)
        points = local @ world[:3, :3].T + (world[:3, 3] - camera.position)
        far = float(np.linalg.norm(points, axis=1).max())
        assert measure_room(triangles, points) >= 0.98 * (constant + far * (linear + far * square))
        if not is_parallel(camera.projection):
            assert np.linalg.norm(triangles.reshape(-1, 3), axis=1).min() > near_radius(camera)


def test_most_bodies_are_tested_as_polytopes(device: rhi.Device) -> None:
    """So that the test above has something to test."""
    scene = make_bodies(3)
    bodies, polytopes = fit_polytopes(device, scene, make_camera((0.0, 0.0, 30.0), (0.0, 0.0, 0.0)), 18)
    assert len(bodies) > 12
    assert 6 <= polytopes < len(bodies)  # one is too skewed, some are slim


@pytest.mark.parametrize(("distance", "polytopes"), [(5.0, 1), (5000.0, 0)])
def test_far_away_where_the_margin_is_large_the_box_is_drawn(
    device: rhi.Device, distance: float, polytopes: int
) -> None:
    builder = SceneBuilder("ball")
    builder.add_objects(builder.add_node(), builder.add_mesh(bumpy_sphere(12, 0.01)), builder.add_material())
    camera = make_camera((0.0, 0.0, distance), (0.0, 0.0, 0.0))
    bodies, drawn = fit_polytopes(device, builder.build(), camera, 18)
    assert (len(bodies), drawn) == (1, polytopes)


@pytest.mark.parametrize("may_change", [False, True])
def test_meshes_that_may_change_keep_their_boxes(device: rhi.Device, may_change: bool) -> None:
    builder, ball = SceneBuilder("ball"), bumpy_sphere(12, 0.01)
    mesh = builder.add_mesh(ball, bounds=ball.bounds if may_change else None)
    builder.add_objects(builder.add_node(), mesh, builder.add_material())
    camera = make_camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    bodies, polytopes = fit_polytopes(device, builder.build(), camera, 18)
    assert (len(bodies), polytopes) == (1, 0 if may_change else 1)


def make_corner(height: float) -> tuple[Scene, Camera]:
    """Make a ball of radius 1 behind a wall whose upper edge is so high, seen along the horizon from far away."""
    builder = SceneBuilder("corner")
    box, ball = builder.add_mesh(BUILT_IN["box"]()), builder.add_mesh(bumpy_sphere(24, 0.001))
    turned = rotation((0.0, 0.0, 1.0), 0.785)  # its box stands on an edge
    builder.add_objects(builder.add_node(turned), ball, builder.add_material())
    wall = multiply(translation((0.0, height - 10.0, 3.0)), scaling(np.array([40.0, 20.0, 1.0])))
    builder.add_objects(builder.add_node(wall), box, builder.add_material(base_color=(1.0, 0.0, 0.0)))
    return builder.build(), make_camera((0.0, height, 20.0), (0.0, height, 0.0))


@pytest.mark.parametrize(
    ("height", "listed"),
    [(1.1, {0: True, 14: True, 18: False, 26: False}), (0.8, dict.fromkeys((0, 14, 18, 26), True))],
)
def test_a_ball_whose_box_alone_sticks_out_behind_a_wall_is_hidden(
    device: rhi.Device, height: float, listed: dict[int, bool]
) -> None:
    """From the middle, the box is √2 high, the body of 14 planes 1.22, and those of 18 and 26 as high as the ball."""
    (scene, camera), results = make_corner(height), {}
    for planes in listed:
        algorithm = TwoPassCulling(scene, device, VisibilitySettings(proxy_planes=planes))
        with Renderer(device, scene, size=(320, 180)) as renderer:
            for _ in range(3):
                draw_with(renderer, algorithm, camera)
            lists = (algorithm.first, algorithm.second)
            results[planes] = any(0 in part.read_object_indices() for part in lists)
        algorithm.destroy()
    assert results == listed


@pytest.mark.parametrize("planes", PLANE_COUNTS)
def test_images_are_those_of_boxes_to_the_bit(device: rhi.Device, planes: int) -> None:
    scene, images = load_scene("grid:mesh=torus,count=60,lights=0"), []
    views = [make_camera(eye, (0.0, 0.0, 0.0)) for eye in ((9.0, 3.0, 14.0), (-4.0, 1.0, 6.0))]
    for number in (0, planes):
        algorithm = TwoPassCulling(scene, device, VisibilitySettings(proxy_planes=number))
        with Renderer(device, scene, size=SIZE) as renderer:
            images.append(
                [draw_with(renderer, algorithm, view).image.read() for view in views for _ in range(2)]
            )
            assert (algorithm.count_polytopes() > 0) == (number > 0)
        algorithm.destroy()
    assert np.std(images[0]) > 5.0
    assert np.array_equal(images[0], images[1])


def record(null: rhi.Device, scene: Scene, planes: int) -> list[str]:
    """Return the passes of the second frame, and the programs of its draws and dispatches."""
    algorithm = TwoPassCulling(scene, null, VisibilitySettings(proxy_planes=planes))
    camera = make_camera((0.0, 0.0, 12.0), (0.0, 0.0, 0.0))
    with Renderer(null, scene, size=(99, 55)) as renderer:
        draw_with(renderer, algorithm, camera)
        null.stream.clear()
        draw_with(renderer, algorithm, camera)
        kinds = (Op.DRAW, Op.DRAW_INDIRECT, Op.DISPATCH, Op.BEGIN_PASS)
        commands = [command for command in null.stream if command.op in kinds]
        names = [
            "pass" if command.op is Op.BEGIN_PASS else command.resource(command.program).name
            for command in commands
        ]
    algorithm.destroy()
    return names


def test_polytopes_cost_one_dispatch_and_no_draw_more(null: rhi.Device) -> None:
    scene = make_bodies(1)
    boxes, polytopes = record(null, scene, 0), record(null, scene, 14)
    renamed = [name.replace("Proxies", "Boxes") for name in polytopes if name != "FitProxies"]
    assert renamed == boxes
    assert polytopes.count("FitProxies") == 1


def test_boxes_are_the_default() -> None:
    assert VisibilitySettings() == VisibilitySettings(proxy_planes=0)


@pytest.mark.parametrize("planes", [-14, 1, 13, 15, 27])
def test_a_number_of_planes_that_no_polytope_has_is_refused(planes: int) -> None:
    with pytest.raises(ValidationError, match="0, 14, 18 or 26"):
        VisibilitySettings(proxy_planes=planes)
    assert [VisibilitySettings(proxy_planes=count).proxy_planes for count in PLANE_COUNTS] == [14, 18, 26]
