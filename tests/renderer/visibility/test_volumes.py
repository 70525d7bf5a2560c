"""Bounding volumes: their classification against the frustum, which is never wrong."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from occlusion_scenes import cameras, draw_with, make_boxes

import rhi
from renderer.content import load_scene
from renderer.content.shapes import box, sphere
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, rotation, scaling, translation
from renderer.scene.transforms import multiply
from renderer.visibility import NoCulling, ScenePass, VisibilityStatistics, find_visible_objects
from renderer.visibility.boxes.culling import find_visible
from renderer.visibility.boxes.volumes import (
    AlignedBoxes,
    Containment,
    Fit,
    OrientedBoxes,
    Spheres,
    Volumes,
    classify,
    fit_aligned,
    fit_oriented,
    fit_spheres,
)

FITS = (fit_aligned, fit_oriented, fit_spheres)
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def surface(volumes: Volumes) -> np.ndarray:
    """Return points (n, k, 3) of each volume: the corners of boxes, and points all around spheres."""
    if isinstance(volumes, AlignedBoxes):
        half = 0.5 * (volumes.upper - volumes.lower)
        return volumes.centre[:, None] + half[:, None] * CORNERS
    if isinstance(volumes, OrientedBoxes):
        return volumes.centre[:, None] + np.einsum("kj,njx->nkx", CORNERS, volumes.axes)
    assert isinstance(volumes, Spheres)
    directions = np.random.default_rng(1).normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return volumes.centre[:, None] + volumes.radius[:, None, None] * directions


def before(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return distances (n, k, p) from the planes."""
    return points @ planes[:, :3].T + planes[:, 3]


@st.composite
def turned_scenes(draw: st.DrawFn) -> Scene:
    """Draw boxes and spheres with any transform: rotated, scaled, sheared, mirrored, flat."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    count = draw(st.integers(1, 12))
    builder = SceneBuilder("turned")
    meshes = [builder.add_mesh(box()), builder.add_mesh(sphere(6))]
    axis = rng.normal(size=3)
    turn = rotation(axis / np.linalg.norm(axis), rng.uniform(0.0, 6.3, count))
    local = multiply(translation(rng.uniform(-8.0, 8.0, (count, 3))), turn)
    local = multiply(local, scaling(rng.choice([-1.0, 0.0, 0.3, 1.0, 4.0], (count, 3))))
    if draw(st.booleans()):
        local[:, 0, 1] += rng.uniform(-1.0, 1.0, count)
    builder.add_objects(builder.add_nodes(local), rng.choice(meshes, count), builder.add_material())
    return builder.build()


@pytest.mark.parametrize("fit", FITS)
@given(scene=turned_scenes(), camera=cameras())
def test_what_is_said_to_be_outside_or_inside_is(fit: object, scene: Scene, camera: Camera) -> None:
    planes = camera.frustum.planes
    volumes = fit(scene, np.arange(len(scene.objects)))
    distance = before(planes, surface(volumes))
    side = classify(planes, volumes)
    assert (distance[side == Containment.OUTSIDE].max(axis=1) < 0.0).any(axis=1).all()
    assert (distance[side == Containment.INSIDE] >= 0.0).all()
    if fit is not fit_spheres:  # of which all points are known
        crossing = distance[side == Containment.CROSSING]
        assert (crossing.min(axis=1) < 1e-9).any(axis=1).all()
        assert (crossing.max(axis=1) > -1e-9).all()


@pytest.mark.parametrize("fit", FITS)
@given(scene=turned_scenes())
def test_every_volume_holds_its_object(fit: object, scene: Scene) -> None:
    rows = np.arange(len(scene.objects))
    volumes = fit(scene, rows)
    normals = np.random.default_rng(2).normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reach = volumes.reach(normals)
    for row in rows:
        draw = scene.meshes.ranges[scene.objects.mesh[row]]
        first, count = draw["first_index"], draw["index_count"]
        local = scene.meshes.vertices["position"][
            scene.meshes.indices[first : first + count] + draw["base_vertex"]
        ]
        world = scene.nodes.world[scene.objects.node[row]]
        points = local @ world[:3, :3].T + world[:3, 3]
        along = (points - volumes.centre[row]) @ normals.T
        assert (along.max(axis=0) <= reach[row] + 1e-12 * volumes.scale[row]).all()


@given(turned_scenes())
def test_an_oriented_box_reaches_no_further_along_an_axis_than_the_aligned_one(scene: Scene) -> None:
    rows = np.arange(len(scene.objects))
    oriented, aligned = (fit(scene, rows).reach(np.eye(3)) for fit in (fit_oriented, fit_aligned))
    assert (oriented <= aligned + 1e-9).all()


@given(turned_scenes(), cameras())
def test_aligned_boxes_are_culled_as_the_hierarchy_culls_them_but_for_the_margin(
    scene: Scene, camera: Camera
) -> None:
    objects, planes = scene.objects, camera.frustum.planes
    visible = find_visible(planes, objects.lower, objects.upper)
    side = classify(planes, fit_aligned(scene, np.arange(len(objects))))
    assert (side[visible] != Containment.OUTSIDE).all()
    away = before(planes, surface(fit_aligned(scene, np.arange(len(objects))))).max(axis=1).min(axis=1)
    assert (away[~visible & (side != Containment.OUTSIDE)] > -1e-9).all()


def test_a_turned_box_beside_the_frustum_is_outside_by_its_own_box_alone() -> None:
    # A long beam along the left plane: its aligned box, and its sphere, reach far in.
    camera = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=Perspective(np.pi / 2, 1.0, 0.1))
    builder = SceneBuilder("beam")
    turn = multiply(translation((-11.0, 0.0, -10.0)), rotation((0, 1, 0), np.pi / 4))
    beam = multiply(turn, scaling((0.2, 0.2, 10.0)))
    builder.add_objects(builder.add_node(beam), builder.add_mesh(box()), builder.add_material())
    scene, rows = builder.build(), np.zeros(1, np.int64)
    sides = [classify(camera.frustum.planes, fit(scene, rows))[0] for fit in FITS]
    assert sides == [Containment.CROSSING, Containment.OUTSIDE, Containment.CROSSING]


@pytest.mark.parametrize(("x", "side"), [
    (-2.001, Containment.OUTSIDE),
    (-1.999, Containment.CROSSING), (-0.001, Containment.CROSSING),
    (0.001, Containment.INSIDE),
])  # fmt: skip
def test_both_sides_of_each_boundary(x: float, side: Containment) -> None:
    planes = np.array([[1.0, 0.0, 0.0, 1.0]])  # x >= -1
    centre, one = np.array([[x, 3.0, 4.0]]), np.ones(1)
    volumes = (
        AlignedBoxes(centre - 1.0, centre + 1.0),
        OrientedBoxes(centre, np.eye(3)[None], one),
        Spheres(centre, one, one),
    )
    assert [classify(planes, volume)[0] for volume in volumes] == [side] * 3


def test_many_are_tested_at_once() -> None:
    scene = load_scene("city:blocks=8,detail=2")
    planes = scene.paths["ground"].camera(0).frustum.planes
    rows = np.arange(len(scene.objects))
    for fit in FITS:
        whole = classify(planes, fit(scene, rows))
        assert len(set(whole.tolist())) == 3
        one_by_one = [classify(planes, fit(scene, rows[row : row + 1]))[0] for row in rows]
        assert (whole == one_by_one).all()


class VolumeCulling:
    """Draws the objects of which no bounding volume of the given kinds is outside the frustum."""

    opens_pass = False

    def __init__(self, scene: Scene, fits: Sequence[Fit]) -> None:
        self.scene, self.fits = scene, fits
        self.static = [fit(scene, scene.objects.static_rows) for fit in fits]

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        objects, planes = self.scene.objects, camera.frustum.planes
        seen = np.ones(len(objects), bool)
        for fit, static in zip(self.fits, self.static, strict=True):
            seen[objects.static_rows] &= classify(planes, static) != Containment.OUTSIDE
            moving = fit(self.scene, objects.dynamic_rows)
            seen[objects.dynamic_rows] &= classify(planes, moving) != Containment.OUTSIDE
        visible = np.flatnonzero(seen)
        if len(visible):
            scene_pass.draw(visible)
        return VisibilityStatistics(len(objects), len(visible))

    def destroy(self) -> None:
        pass


@pytest.mark.parametrize("path", ["ground", "sky"])
def test_culling_by_volumes_draws_what_a_test_of_each_leaves(path: str) -> None:
    hall = load_scene("hall:columns=8,rows=2,flags=6")  # some of it moves
    rows = np.arange(len(hall.objects))
    culls = {fits: VolumeCulling(hall, fits) for fits in ((FITS[0],), (FITS[1],), (FITS[2],), FITS)}
    for frame in (0, 700, 1500):
        hall.update(frame / 60)
        camera = hall.paths[path].camera(frame)
        seen = [classify(camera.frustum.planes, fit(hall, rows)) != Containment.OUTSIDE for fit in FITS]
        for fits, cull in culls.items():
            expected = np.all([seen[FITS.index(fit)] for fit in fits], axis=0)
            assert (find_visible_objects(cull, camera) == np.flatnonzero(expected)).all()
    assert seen[1].sum() <= seen[0].sum() < len(rows)


@pytest.mark.parametrize("fit", FITS)
def test_culling_by_volumes_changes_no_pixel(gl: rhi.Device, fit: object) -> None:
    hall = load_scene("hall:columns=8,rows=2,flags=6")
    with Renderer(gl, hall, size=(97, 55)) as renderer:
        for frame in range(0, 1800, 300):
            camera = hall.paths["ground"].camera(frame)
            images = [
                draw_with(renderer, one, camera, frame / 60).image.read()
                for one in (NoCulling(hall), VolumeCulling(hall, [fit]))
            ]
            assert (images[0] == images[1]).all()


def test_spheres_around_meshes_are_as_large_as_their_furthest_vertex() -> None:
    scene = make_boxes([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0)], [(2.0, 2.0, 2.0), (1.0, 1.0, 4.0)])
    spheres = fit_spheres(scene, np.arange(2))
    assert spheres.radius == pytest.approx([np.sqrt(3.0), 2.0], rel=1e-6)  # a box's diagonal, a ball's half
