"""Boxes found on the device: each encloses its object with the margin, and is near, outside or to be
tested."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from occlusion_scenes import cameras, make_boxes, make_camera, mirrored_boxes, scenes

import rhi
from renderer.frame import SceneResources, View
from renderer.lab.exam.scenes import make_views
from renderer.scene import Camera, Depth, Orthographic, Perspective, Scene
from renderer.visibility import NoCulling
from renderer.visibility.boxes.bounds import UNKNOWN_SIZE, margin_terms, near_radius
from renderer.visibility.gpu.occludees import HIDDEN, OUTSIDE, VISIBLE, Occludees
from rhi.math import is_parallel

CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def compute_occludees(device: rhi.Device, scene: Scene, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Return boxes and marks."""
    resources, occludees = SceneResources(device, scene), Occludees(device, len(scene.objects))
    view = View(device, "eye", NoCulling(scene))
    view.aim(camera)
    resources.update(camera)
    occludees.aim(camera, UNKNOWN_SIZE)
    occludees.compute_boxes(device, resources.scene_arrays(view.buffer))
    results = occludees.boxes.read(), occludees.marks.read()
    for resource in (resources, view, occludees):
        resource.destroy()
    return results


def place_corners(scene: Scene, camera: Camera) -> np.ndarray:
    """Return (n, 8, 3) corners of the objects' boxes relative to the eye, in float64."""
    mesh, world = scene.objects.mesh, scene.nodes.world[scene.objects.node]
    middle, half = ((scene.meshes.upper + s * scene.meshes.lower)[mesh] * 0.5 for s in (1.0, -1.0))
    local = middle[:, None] + half[:, None] * CORNERS
    return np.einsum("nij,nkj->nki", world[:, :3, :3], local) + (world[:, :3, 3] - camera.position)[:, None]


def check(device: rhi.Device, scene: Scene, camera: Camera) -> np.ndarray:
    """Check the position and size of each box; return the marks."""
    boxes, marks = compute_occludees(device, scene, camera)
    corners = place_corners(scene, camera)
    constant, linear, square = margin_terms(camera)
    far = np.linalg.norm(corners, axis=2).max(1)
    margin = constant + far * (linear + far * square)
    axes = np.stack([boxes["x"], boxes["y"], boxes["z"]], axis=2).astype(float)
    asked = marks == HIDDEN
    inverse = np.linalg.inv(axes[asked])
    inside = np.einsum("nij,nkj->nki", inverse, corners[asked] - boxes["centre"][asked][:, None])
    # A coordinate of 1 is the box's side; what is left of it, in metres at right angles to the side:
    room = (1.0 - np.abs(inside).max(1)) / np.linalg.norm(inverse, axis=2)
    assert (room >= 0.98 * margin[asked, None]).all()
    assert (np.linalg.det(axes[asked]) > 0.0).all()
    assert (axes[~asked] == 0.0).all()
    farthest = (corners @ camera.forward).max(1)
    around = np.where(camera.forward > 0.0, corners.max(1), corners.min(1)) @ camera.forward
    assert (boxes["depth"] >= farthest - 1e-5 * far).all()
    assert (boxes["depth"] <= around + 10.0 * margin + 1e-5 * far).all()

    planes = camera.frustum.planes.copy()
    planes[:, 3] += planes[:, :3] @ camera.position
    behind = (np.einsum("pi,nki->npk", planes[:, :3], corners) + planes[None, :, 3:] < 0.0).all(2).any(1)
    assert behind[marks == OUTSIDE].all()
    away = np.maximum(np.maximum(corners.min(1), -corners.max(1)), 0.0)
    if not is_parallel(camera.projection):
        assert (marks[np.linalg.norm(away, axis=1) < near_radius(camera)] == VISIBLE).all()
    return marks


@settings(max_examples=30)
@given(scenes(), cameras())
def test_boxes_are_around_their_objects(device: rhi.Device, scene: Scene, camera: Camera) -> None:
    check(device, scene, camera)


@pytest.mark.parametrize("depth", Depth)
def test_mirrored_and_skewed_boxes_are_too(device: rhi.Device, depth: Depth) -> None:
    scene = mirrored_boxes()
    projection = Perspective(far=300.0, depth=depth)
    marks = check(device, scene, Camera.look_at((12.0, 3.0, 4.0), (0.0, 0.0, 0.0), projection=projection))
    assert (marks == HIDDEN).sum() > 20


@pytest.mark.parametrize("case", make_views())
def test_boxes_of_hard_cases_are_too(device: rhi.Device, case: str) -> None:
    check(device, *make_views()[case])


def test_a_box_behind_the_eye_or_beside_the_view_is_outside(device: rhi.Device) -> None:
    object_positions = [
        (0.0, 0.0, 9.0),
        (30.0, 0.0, -5.0),
        (0.0, -30.0, -5.0),
        (0.0, 0.0, -90.0),
        (0.0, 0.0, -5.0),
    ]
    scene = make_boxes(object_positions, np.ones((5, 3)))
    camera = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), far=50.0)
    assert check(device, scene, camera).tolist() == [OUTSIDE] * 4 + [HIDDEN]


@pytest.mark.parametrize(("gap", "mark"), [(0.9, VISIBLE), (1.1, HIDDEN)])
def test_a_box_is_near_within_the_corners_of_the_near_plane(
    device: rhi.Device, gap: float, mark: int
) -> None:
    # At 60° and 16:9 they are 1.54 near away; the margin is far smaller than the tenth that is tried.
    eye = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.5)
    radius = near_radius(eye)
    assert radius == pytest.approx(0.5 * 1.54, rel=0.01)
    scene = make_boxes([(0.0, 0.0, -gap * radius - 1.0)], [(2.0, 2.0, 2.0)])
    assert compute_occludees(device, scene, eye)[1].tolist() == [mark]


@pytest.mark.parametrize(("gap", "mark"), [(-0.1, VISIBLE), (0.1, HIDDEN)])
def test_a_parallel_projection_is_near_at_its_near_plane(device: rhi.Device, gap: float, mark: int) -> None:
    projection = Orthographic(10.0, near=3.0, far=50.0)
    camera = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=projection)
    scene = make_boxes([(0.0, 0.0, -4.0 - gap)], [(2.0, 2.0, 2.0)])
    assert compute_occludees(device, scene, camera)[1].tolist() == [mark]


def test_objects_too_far_for_float32_are_marked_visible_without_a_query(device: rhi.Device) -> None:
    scene = make_boxes([(0.0, 0.0, -1e16), (0.0, 0.0, -1e13)], [(1.0, 1.0, 1.0)] * 2)
    _, marks = compute_occludees(device, scene, make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0)))
    assert marks.tolist() == [VISIBLE, HIDDEN]
