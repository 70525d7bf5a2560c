"""Bounding boxes: their classification against the frustum, which is never wrong."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from occlusion_scenes import cameras

from renderer.content import load_scene
from renderer.content.shapes import box, sphere
from renderer.scene import Camera, Scene, SceneBuilder, rotation, scaling, translation
from renderer.visibility.boxes.culling import select_visible
from renderer.visibility.boxes.volumes import Containment, classify, compute_rotated_boxes
from rhi.math import multiply

CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))


def corners(scene: Scene) -> np.ndarray:
    """Return the corners (n, 8, 3) of the objects' boxes."""
    lower, upper = scene.objects.lower, scene.objects.upper
    return 0.5 * (lower + upper)[:, None] + 0.5 * (upper - lower)[:, None] * CORNERS


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


@given(scene=turned_scenes(), camera=cameras())
def test_boxes_classified_as_outside_or_inside_are_outside_or_inside(scene: Scene, camera: Camera) -> None:
    planes, objects = camera.frustum.planes, scene.objects
    distance = before(planes, corners(scene))
    side = classify(planes, objects.lower, objects.upper)
    assert (distance[side == Containment.OUTSIDE].max(axis=1) < 0.0).any(axis=1).all()
    assert (distance[side == Containment.INSIDE] >= 0.0).all()
    crossing = distance[side == Containment.CROSSING]
    assert (crossing.min(axis=1) < 1e-9).any(axis=1).all()
    assert (crossing.max(axis=1) > -1e-9).all()


@given(scene=turned_scenes())
def test_every_rotated_box_holds_its_object(scene: Scene) -> None:
    boxes = compute_rotated_boxes(scene, np.arange(len(scene.objects)))
    for row, centre, half, axes in zip(
        boxes.object_indices, boxes.centre, boxes.half, boxes.axes, strict=True
    ):
        draw = scene.meshes.ranges[scene.objects.mesh[row]]
        first, count = draw["first_index"], draw["index_count"]
        local = scene.meshes.vertices["position"][
            scene.meshes.indices[first : first + count] + draw["base_vertex"]
        ]
        world = scene.nodes.world[scene.objects.node[row]]
        points = local @ world[:3, :3].T + world[:3, 3]
        assert (np.abs((points - centre) @ axes.T) <= half + 1e-12 * (1.0 + np.abs(points))).all()


@given(turned_scenes(), cameras())
def test_boxes_are_culled_as_the_hierarchy_culls_them_but_for_the_margin(
    scene: Scene, camera: Camera
) -> None:
    objects, planes = scene.objects, camera.frustum.planes
    visible = select_visible(planes, objects.lower, objects.upper)
    side = classify(planes, objects.lower, objects.upper)
    assert (side[visible] != Containment.OUTSIDE).all()
    away = before(planes, corners(scene)).max(axis=1).min(axis=1)
    assert (away[~visible & (side != Containment.OUTSIDE)] > -1e-9).all()


@pytest.mark.parametrize(
    ("x", "side"),
    [
        (-2.001, Containment.OUTSIDE),
        (-1.999, Containment.CROSSING),
        (-0.001, Containment.CROSSING),
        (0.001, Containment.INSIDE),
    ],
)
def test_both_sides_of_each_boundary(x: float, side: Containment) -> None:
    planes = np.array([[1.0, 0.0, 0.0, 1.0]])  # x >= -1
    centre = np.array([[x, 3.0, 4.0]])
    assert classify(planes, centre - 1.0, centre + 1.0)[0] == side


def test_many_are_tested_at_once() -> None:
    scene = load_scene("city:blocks=8,detail=2")
    planes = scene.paths["ground"].camera(0).frustum.planes
    lower, upper = scene.objects.lower, scene.objects.upper
    whole = classify(planes, lower, upper)
    assert len(set(whole.tolist())) == 3
    one_by_one = [
        classify(planes, lower[row : row + 1], upper[row : row + 1])[0] for row in range(len(lower))
    ]
    assert (whole == one_by_one).all()
