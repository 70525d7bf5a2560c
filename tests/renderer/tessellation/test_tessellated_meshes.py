"""Tessellated meshes: their points against float64 formulas, and their triangles in frames."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import pytest
from frames import open_renderer as open_any
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import shapes
from renderer.frame import UploadSettings
from renderer.lab.exam.tessellated_mesh_cases import count_open_edges, read_triangles
from renderer.renderer import Renderer
from renderer.scene import (
    Camera,
    MeshGeometry,
    Scene,
    SceneBuilder,
    TessellatedMesh,
    TextureMap,
    make_geometry,
    rotation,
    scaling,
    tessellate,
    translation,
)
from renderer.tessellation import TessellationSettings
from tests.renderer.refusals import refused_rule

CAMERA = Camera.look_at((1.2, 1.0, 2.0), (0.0, 0.0, 0.0))
ELSEWHERE = Camera.look_at((-2.2, 0.4, 0.6), (0.0, 0.0, 0.0))
BODIES = {"box": shapes.box(), "sphere": shapes.sphere(12), "cylinder": shapes.cylinder(8)}
BUMPS = 0.02 * np.random.default_rng(2).random((9, 11))
open_renderer = partial(open_any, size=(96, 64), visibility="frustum")


def list_points(mesh: TessellatedMesh) -> NDArray[np.float64]:
    """Return the positions (k, 3) of the vertices that triangles use."""
    return mesh.positions().reshape(-1, 3)[np.unique(mesh.list_triangles())]


def make_ball(divisions: int) -> MeshGeometry:
    """Make an octahedron whose faces are divided, its corners and normals those of the unit sphere."""
    geometry = make_geometry(
        np.concatenate([np.eye(3), -np.eye(3)]),
        [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)],
    )
    for _ in range(divisions):
        corners = geometry.vertices["position"].astype(np.float64)[geometry.indices.reshape(-1, 3)]
        a, b, c = corners.transpose(1, 0, 2)
        ab, bc, ca = (
            (p + q) / np.linalg.norm(p + q, axis=1, keepdims=True) for p, q in ((a, b), (b, c), (c, a))
        )
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        points = np.concatenate([np.stack(part, axis=1) for part in parts]).reshape(-1, 3)
        geometry = make_geometry(points, np.arange(len(points)), points)
    points = geometry.vertices["position"]
    return make_geometry(points, geometry.indices, points)


def make_scene(mesh: TessellatedMesh, *, is_chosen: bool = True, has_ground: bool = True) -> Scene:
    """Make a scene of a tessellated mesh, or of a mesh of all its triangles, above a ground in a low sun."""
    builder = SceneBuilder("body")
    image = np.random.default_rng(4).integers(0, 255, (16, 16, 4), np.uint8)
    material = builder.add_material(texture=TextureMap(builder.add_image(image)), roughness=0.4)
    if is_chosen:
        body = builder.add_tessellated_mesh(mesh, "body")
    else:
        full = mesh.list_triangles().astype(np.uint32).reshape(-1)
        body = builder.add_mesh(MeshGeometry(mesh.vertices.reshape(-1), full), "body")
    builder.add_objects(builder.add_node(rotation((0.3, 1.0, 0.2), 0.7)), body, material)
    if has_ground:
        node = builder.add_node(translation((0.0, -0.6, 0.0)) @ scaling((6.0, 1.0, 6.0)))
        builder.add_objects(node, builder.add_mesh(shapes.plane()), builder.add_material())
    builder.lights.add_directional((-0.8, -0.6, -0.3), casts_shadow=True)
    builder.lights.sky = builder.lights.ground = (0.2, 0.2, 0.2)
    return builder.build()


def test_each_quarter_of_the_triangles_is_nearer_to_a_sphere_than_the_third_power() -> None:
    errors = [
        float(np.abs(np.linalg.norm(list_points(tessellate(make_ball(k))), axis=1) - 1.0).max())
        for k in range(4)
    ]
    assert errors[0] < 0.25
    assert all(finer < coarser / 8.0 for coarser, finer in itertools.pairwise(errors[1:])), errors


def test_a_patch_is_the_cubic_of_its_published_control_points() -> None:
    corners = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.1), (0.2, 0.9, 0.0)])
    normals = np.array([(0.1, -0.2, 1.0), (-0.3, 0.0, 1.0), (0.2, 0.4, 1.0)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    mesh = tessellate(make_geometry(corners, [0, 1, 2], normals), halvings=2)

    def control(i: int, j: int) -> NDArray[np.float64]:  # Vlachos et al. 2001, section 3.1
        w = (corners[j] - corners[i]) @ normals[i]
        return (2.0 * corners[i] + corners[j] - w * normals[i]) / 3.0

    inner = {(i, j): control(i, j) for i in range(3) for j in range(3) if i != j}
    mean = sum(inner.values()) / 6.0
    middle = mean + (mean - corners.mean(axis=0)) / 2.0
    expected = []
    for share in np.random.default_rng(1).dirichlet((1.0, 1.0, 1.0), 4000):
        point = 6.0 * share.prod() * middle + share**3 @ corners
        expected.append(point + sum(3.0 * share[i] ** 2 * share[j] * inner[i, j] for i, j in inner))
    points = list_points(mesh)
    away = np.linalg.norm(points[:, None] - np.array(expected)[None], axis=2).min(axis=1)
    assert away.max() < 0.03  # how dense the random points are; flat triangles are farther off
    flat = list_points(tessellate(make_geometry(corners, [0, 1, 2], normals), halvings=2, smoothness=0.0))
    assert np.linalg.norm(flat[:, None] - np.array(expected)[None], axis=2).min(axis=1).max() > 0.05


def test_without_smoothness_points_are_in_the_planes_of_triangles() -> None:
    geometry = make_ball(1)
    points = list_points(tessellate(geometry, halvings=3, smoothness=0.0))
    corners = geometry.vertices["position"].astype(np.float64)[geometry.indices.reshape(-1, 3)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = points @ normals.T - np.einsum("td,td->t", corners[:, 0], normals)
    assert np.abs(away).min(axis=1).max() < 1e-6
    assert away.max() < 1e-6


def test_creases_stay_sharp_and_bend_along_themselves() -> None:
    box = list_points(tessellate(shapes.box()))
    assert np.abs(np.abs(box).max(axis=1) - 0.5).max() < 1e-6
    mesh = tessellate(shapes.cylinder(8))
    vertices = mesh.vertices.reshape(-1)[np.unique(mesh.list_triangles())]
    is_rim = (np.abs(vertices["position"][:, 1] - 0.5) < 1e-6) & (np.abs(vertices["normal"][:, 1]) < 0.1)
    radius = np.linalg.norm(vertices["position"][is_rim][:, ::2], axis=1)
    assert len(radius) > 100
    assert 0.49 < radius.min() < radius.max() < 0.5001  # chords are as near as 0.462


@pytest.mark.parametrize("name", BODIES)
@pytest.mark.parametrize("heights", [None, BUMPS], ids=["smooth", "bumps"])
def test_all_triangles_of_a_closed_body_are_closed_bit_by_bit(
    name: str, heights: NDArray[np.float64] | None
) -> None:
    mesh = tessellate(BODIES[name], halvings=3, heights=heights)
    positions = mesh.vertices["position"].reshape(-1, 3)
    assert count_open_edges(positions, mesh.list_triangles()) == 0
    assert count_open_edges(positions, mesh.list_triangles()[1:]) == 3
    used = np.unique(mesh.list_triangles())
    numbers, points = mesh.points.reshape(-1)[used], positions[used]
    order = np.argsort(numbers, kind="stable")
    is_copy = numbers[order][1:] == numbers[order][:-1]
    assert is_copy.sum() > 100
    assert (points[order][1:] == points[order][:-1])[is_copy].all()


def test_copies_have_the_same_bounds_which_hold_those_below() -> None:
    mesh = tessellate(BODIES["sphere"], halvings=3, heights=BUMPS)
    numbers = mesh.points.reshape(-1)
    for bound in mesh.bounds:
        largest = np.zeros(numbers.max() + 1)
        np.maximum.at(largest, numbers, bound.reshape(-1))
        assert (bound.reshape(-1) == largest[numbers]).all()


def test_heights_are_read_along_texture_coordinates() -> None:
    mesh = tessellate(shapes.plane(), halvings=5, heights=BUMPS, height_scale=3.0)
    used = np.unique(mesh.list_triangles())
    vertices = mesh.vertices.reshape(-1)[used]
    height, width = BUMPS.shape

    def sample(u: float, v: float) -> float:
        x, y = u * width - 0.5, v * height - 0.5
        total = 0.0
        for row in range(-1, height + 1):
            for column in range(-1, width + 1):
                share = max(1.0 - abs(x - column), 0.0) * max(1.0 - abs(y - row), 0.0)
                total += share * BUMPS[row % height, column % width]
        return 3.0 * total

    expected = [sample(u, v) for u, v in vertices["uv"].astype(np.float64)]
    assert np.abs(vertices["position"][:, 1] - expected).max() < 1e-6
    assert np.ptp(expected) > 0.03


def test_heights_turn_normals() -> None:
    along = np.arange(64) / 64.0
    waves = 0.02 * np.sin(2.0 * np.pi * along)[None].repeat(64, axis=0)
    mesh = tessellate(shapes.plane(), halvings=5, heights=waves)
    vertices = mesh.vertices.reshape(-1)[np.unique(mesh.list_triangles())]
    u = vertices["uv"][:, 0].astype(np.float64)
    inside = (np.abs(vertices["position"][:, ::2]) < 0.49).all(axis=1)
    slope = 0.02 * 2.0 * np.pi * np.cos(2.0 * np.pi * (u - 0.5 / 64.0))
    expected = np.stack([-slope, np.ones_like(u), 0.0 * u], axis=1) / np.hypot(1.0, slope)[:, None]
    off = np.abs(vertices["normal"] - expected)[inside]
    assert off.max() < 0.02
    assert np.abs(expected[:, 0]).max() > 0.1


def test_one_triangle_and_three_at_one_edge() -> None:
    single = tessellate(make_geometry(np.eye(3), [0, 1, 2]), halvings=1)
    assert (single.grid_count, single.half_count, single.count) == (3, 3, 12)
    points = np.array([(0, 0, 0), (0, 1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, 1)], float)
    fins = tessellate(make_geometry(points, [(0, 1, 2), (0, 1, 3), (0, 1, 4)]), halvings=2)
    edges = fins.positions().reshape(-1, 3)[np.unique(fins.list_triangles())]
    at_edge = np.unique(edges[(np.abs(edges[:, ::2]) < 1e-3).all(axis=1)], axis=0)
    assert len(at_edge) == 5


def test_triangles_without_an_area_are_left_out() -> None:
    geometry = make_geometry(np.eye(3), [(0, 1, 2), (1, 1, 2)])
    assert tessellate(geometry, halvings=1).count == 12
    assert refused_rule(lambda: tessellate(make_geometry(np.eye(3), [(1, 1, 2)]))) == "scene-bad-mesh"


@pytest.mark.parametrize(
    "arguments",
    [
        {"halvings": 0},
        {"halvings": 7},
        {"smoothness": -0.1},
        {"smoothness": 1.1},
        {"smoothness": np.nan},
        {"height_scale": np.inf},
        {"heights": [[np.nan]]},
        {"heights": [1.0]},
        {"heights": np.zeros((0, 3))},
        {"heights": [["high"]]},
        {"limit": 35},
    ],
    ids=str,
)
def test_bad_arguments_are_refused(arguments: dict[str, object]) -> None:
    assert refused_rule(lambda: tessellate(shapes.box(), **arguments)) == "scene-bad-mesh"  # type: ignore[arg-type]
    assert tessellate(shapes.box(), halvings=1, smoothness=0.5, heights=[[1.0]], limit=36).limit == 36


def test_too_many_edges_are_refused() -> None:
    geometry = shapes.plane(64)
    assert refused_rule(lambda: tessellate(geometry, halvings=6)) == "scene-bad-mesh"
    assert tessellate(geometry, halvings=1).half_count == 3 * len(geometry.indices) // 3


def test_a_tessellated_mesh_has_one_object() -> None:
    def make(count: int) -> Scene:
        builder = SceneBuilder("bodies")
        mesh = builder.add_tessellated_mesh(tessellate(shapes.box(), halvings=1))
        for _ in range(count):
            builder.add_objects(builder.add_node(), mesh, builder.add_material())
        return builder.build()

    assert list(make(1).tessellated) == [0]
    assert refused_rule(lambda: make(2)) == "scene-shared-heights"


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "deferred"])
def test_all_triangles_make_the_image_of_their_mesh_with_its_shadow(
    device: rhi.Device, technique: str
) -> None:
    mesh, images = tessellate(shapes.torus(8), halvings=2, heights=BUMPS), []
    for is_chosen in (True, False):
        with open_renderer(device, make_scene(mesh, is_chosen=is_chosen), technique) as renderer:
            renderer.tessellator.settings = TessellationSettings(0.001)
            images.append(renderer.render(CAMERA).image.read().astype(int))
            if is_chosen:
                assert renderer.tessellator.surfaces[0].read_count() == mesh.count
                sunny = make_scene(mesh)
                sunny.objects.casts_shadow[:] = False
    with open_renderer(device, sunny, technique) as renderer:
        renderer.tessellator.settings = TessellationSettings(0.001)
        without = renderer.render(CAMERA).image.read().astype(int)
    assert np.abs(images[0] - images[1]).max() <= 1
    assert (np.abs(images[0] - without).max(axis=-1) > 20).mean() > 0.01
    assert images[0][..., 0].std() > 20.0


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", BODIES)
def test_chosen_triangles_are_closed_and_as_many_as_a_view_calls_for(device: rhi.Device, name: str) -> None:
    mesh, counts = tessellate(BODIES[name], halvings=4, heights=BUMPS), []
    scene = make_scene(mesh, has_ground=False)
    positions = scene.meshes.vertices["position"]
    with open_renderer(device, scene) as renderer:
        for edge_pixels, camera in ((4.0, CAMERA), (4.0, ELSEWHERE), (16.0, CAMERA), (500.0, CAMERA)):
            renderer.tessellator.settings = TessellationSettings(edge_pixels)
            renderer.render(camera)
            triangles = read_triangles(renderer)
            assert count_open_edges(positions, triangles) == 0
            counts.append(len(triangles))
    assert counts[0] > 2 * counts[2] >= 2 * counts[3] == 2 * mesh.half_count
    assert counts[0] < mesh.count


def count_commands(null: rhi.Device, renderer: Renderer, camera: Camera) -> tuple[int, int, int]:
    """Return the numbers of dispatches, of indirect draws and of written bytes of a frame."""
    null.stream.clear()
    before = null.statistics.upload_bytes
    renderer.render(camera)
    ops = [command.op for command in null.stream]
    return (
        ops.count(rhi.Op.DISPATCH),
        ops.count(rhi.Op.DRAW_INDIRECT),
        null.statistics.upload_bytes - before,
    )


def test_a_new_view_costs_dispatches_and_a_still_one_nothing(null: rhi.Device) -> None:
    mesh = tessellate(shapes.sphere(12), halvings=3)
    scene = make_scene(mesh, has_ground=False)
    scene.lights.directional["casts_shadow"] = False
    with open_renderer(null, scene) as renderer:
        renderer.render(CAMERA)
        moved, still = (count_commands(null, renderer, ELSEWHERE) for _ in range(2))
        away = count_commands(null, renderer, Camera.look_at((0.0, 0.0, 9.0), (0.0, 0.0, 99.0)))
    assert moved[:2] == (mesh.levels + 2, 1)
    assert still == (0, 1, 0)
    assert away[:2] == (0, 0)


def test_a_mesh_that_does_not_ask_costs_nothing(null: rhi.Device) -> None:
    mesh, counts = tessellate(shapes.sphere(12), halvings=3), []
    for is_chosen in (True, False):
        null.stream.clear()
        with open_renderer(null, make_scene(mesh, is_chosen=is_chosen)) as renderer:
            renderer.render(CAMERA)
            labelled = sum("tessellation" in command.labels for command in null.stream)
            counts.append(
                (labelled, len(null.stream.filter(rhi.Op.DISPATCH)), len(renderer.tessellator.surfaces))
            )
    assert counts[0][0] > mesh.levels
    assert counts[0][1:] == (mesh.levels + 2, 1)
    assert counts[1] == (0, 0, 0)


def test_a_streamed_mesh_is_chosen_once_it_is_on_the_device(device: rhi.Device) -> None:
    mesh, images = tessellate(shapes.sphere(12), halvings=4, heights=BUMPS), []
    for uploads in (None, UploadSettings(1 << 18)):
        with Renderer(
            device, make_scene(mesh), size=(96, 64), visibility="frustum", uploads=uploads
        ) as renderer:
            renderer.tessellator.settings = TessellationSettings(4.0)
            frames = 0
            while True:
                image, frames = renderer.render(CAMERA).image.read().astype(int), frames + 1
                if renderer.uploads is None or (renderer.uploads.is_done and frames > 8):
                    break
            images.append(image)
    assert frames > 8
    assert (images[0] == images[1]).all()
