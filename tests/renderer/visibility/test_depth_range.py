"""The range of depths that a camera sees."""

from __future__ import annotations

import numpy as np
import pytest
from occlusion_scenes import make_boxes, make_camera

from renderer.content import load_scene
from renderer.scene import Camera, Orthographic, Perspective
from renderer.visibility.boxes.depth_range import compute_depth_range


def test_boxes_in_view_are_the_range() -> None:
    scene = make_boxes([(0, 0, -5), (1, 0, -20), (0, 0, 4)], [(2, 2, 2)] * 3)
    camera = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)
    near, far = compute_depth_range(scene, camera) or (0.0, 0.0)
    half = float(scene.objects.upper[0, 2] + 5.0)
    assert near == pytest.approx(5.0 - half)
    assert far == pytest.approx(20.0 + half)


def test_a_ground_begins_where_it_enters_the_image() -> None:
    scene = make_boxes([(0, -2, 0)], [(200, 0.5, 200)])
    top = float(scene.objects.upper[0, 1])
    projection = Perspective(np.pi / 3, 1.5)
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection)
    near, _ = compute_depth_range(scene, camera) or (0.0, 0.0)
    assert near == pytest.approx(-top / np.tan(np.pi / 6), rel=1e-9)


def test_a_box_around_the_camera_does_not_count() -> None:
    inside = make_boxes([(0, 0, 0)], [(8, 8, 8)])
    camera = make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)
    assert compute_depth_range(inside, camera) is None
    both = make_boxes([(0, 0, 0), (0, 0, -30)], [(8, 8, 8), (2, 2, 2)])
    near, far = compute_depth_range(both, camera) or (0.0, 0.0)
    assert 28.0 < near < far < 32.0


def test_nothing_in_view_has_no_range() -> None:
    scene = make_boxes([(0, 0, 30)], [(2, 2, 2)])
    assert compute_depth_range(scene, make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1)) is None
    assert compute_depth_range(scene, make_camera((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), near=0.1)) is not None


@pytest.mark.parametrize("projection", [Perspective(1.0, 1.5, 0.2, 40.0), Orthographic(20.0, 1.5, 1.0, 40.0)])
def test_the_range_is_that_of_the_samples_in_view(projection: Perspective | Orthographic) -> None:
    scene = load_scene("city:blocks=4")
    camera = scene.paths["ground"].camera(600).with_projection(projection)
    near, far = compute_depth_range(scene, camera) or (0.0, 0.0)
    rng = np.random.default_rng(2)
    objects, eye = scene.objects, camera.position
    planes = camera.frustum.planes
    least, greatest = np.inf, 0.0
    for lower, upper in zip(objects.lower, objects.upper, strict=True):
        if (lower <= eye).all() and (eye <= upper).all():
            continue
        points = rng.uniform(lower, upper, (4000, 3))
        seen = points[(points @ planes[:, :3].T + planes[:, 3] >= 0.0).all(axis=1)]
        if len(seen):
            depth = (seen - eye) @ camera.forward
            least, greatest = min(least, float(depth.min())), max(greatest, float(depth.max()))
    assert near <= least
    assert near > 0.5 * least
    assert greatest <= far <= 40.0 * (1.0 + 1e-9)


def test_a_scene_of_hidden_objects_has_no_depth_range() -> None:
    scene, camera = (
        make_boxes([(0, 0, -30)], [(2, 2, 2)]),
        make_camera((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), near=0.1),
    )
    assert compute_depth_range(scene, camera) is not None
    scene.nodes.hide(scene.objects.node[0])
    scene.update()
    assert compute_depth_range(scene, camera) is None
