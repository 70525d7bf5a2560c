"""Culling through the hierarchy gives exactly the set of a test of every box."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from renderer.scene import Camera, Depth, Orthographic, Perspective
from renderer.visibility import HierarchyCuller, build_by_area, build_by_middle, select_visible
from renderer.visibility.boxes import culling


def make_boxes(count, seed=0, spread=100.0, extent=5.0):
    rng = np.random.default_rng(seed)
    centre = rng.uniform(-spread, spread, (count, 3))
    half = rng.uniform(0.0, extent, (count, 3))
    return centre - half, centre + half


def cull(culler, planes):
    return culler.select_visible(planes)[0]


@st.composite
def cameras(draw, scale):
    numbers = st.floats(-1.0, 1.0, allow_subnormal=False)
    eye = np.array([draw(numbers) for _ in range(3)]) * scale
    angles = draw(st.floats(0.0, 6.28)), draw(st.floats(-1.57, 1.57))
    forward = np.array([np.cos(angles[0]) * np.cos(angles[1]), np.sin(angles[1]), np.sin(angles[0])])
    near = scale * draw(st.sampled_from([1e-6, 1e-3, 0.1]))
    depth = draw(st.sampled_from(list(Depth)))
    if draw(st.booleans()):
        far = draw(st.sampled_from([np.inf, 2.0 * near, 0.5 * scale, 10.0 * scale]))
        fov = draw(st.sampled_from([0.01, 0.6, 1.2, 3.1]))
        projection = Perspective(
            fov, draw(st.sampled_from([0.3, 1.0, 2.4])), near, max(far, 1.5 * near), depth
        )
    else:
        projection = Orthographic(scale * draw(st.sampled_from([1e-4, 0.5])), 1.3, -near, scale, depth)
    return Camera.look_at(eye, eye + forward * scale, projection=projection)


@st.composite
def culling_cases(draw):
    """Draw boxes and a camera of similar size; some boxes are flat, equal, around the camera, or on its
    planes."""
    scale = 10.0 ** draw(st.sampled_from([-30, -3, 0, 2, 7, 30]))
    camera = draw(cameras(scale))
    count = draw(st.integers(1, 400))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    centre = rng.uniform(-1.0, 1.0, (count, 3)) * scale
    half = rng.uniform(0.0, 1.0, (count, 3)) * scale * 10.0 ** rng.integers(-9, 1, (count, 1))
    half[rng.random((count, 3)) < 0.2] = 0.0
    centre[rng.random(count) < 0.1] = camera.position
    planes = camera.frustum.planes
    touching = rng.random(count) < 0.2  # corners that lie on a plane up to rounding
    plane = planes[rng.integers(0, len(planes), count)]
    offset = ((centre * plane[:, :3]).sum(1) + plane[:, 3])[:, None] * plane[:, :3]
    centre = np.where(touching[:, None], centre - offset, centre)
    half[touching & (rng.random(count) < 0.5)] = 0.0
    return centre - half, centre + half, camera


@given(culling_case=culling_cases())
@settings(max_examples=150)
@pytest.mark.parametrize("build", [build_by_area, build_by_middle])
def test_the_hierarchy_selects_exactly_the_boxes_that_brute_force_selects(build, culling_case):
    lower, upper, camera = culling_case
    planes = camera.frustum.planes
    expected = np.flatnonzero(select_visible(planes, lower, upper))
    culler = HierarchyCuller(build(lower, upper), lower, upper)
    assert cull(culler, planes).tolist() == expected.tolist()
    assert cull(culler, planes).tolist() == expected.tolist()  # and with what it remembers


@pytest.mark.parametrize("width", [8, 64])
def test_it_stays_exact_along_a_path_over_many_levels_with_jumps(monkeypatch, width):
    monkeypatch.setattr(culling, "_WIDTH", width)
    monkeypatch.setattr(culling, "_WIDEST", 16)
    lower, upper = make_boxes(6000)
    culler = HierarchyCuller(build_by_area(lower, upper), lower, upper)
    assert len(culler._blocks) == (3 if width == 8 else 2)
    for frame in range(40):
        angle = 0.05 * frame + (2.0 if frame > 20 else 0.0)
        projection = Perspective(far=150.0) if frame % 2 else Perspective()  # six planes, five planes
        eye = np.array([3.0 * frame, 0.0, 0.0])
        camera = Camera.look_at(
            eye, eye + np.array([np.cos(angle), 0.1, np.sin(angle)]), projection=projection
        )
        planes = camera.frustum.planes
        visible = cull(culler, planes)
        assert visible.tolist() == np.flatnonzero(select_visible(planes, lower, upper)).tolist()
        assert 0 < len(visible) < 6000


def test_brute_force_selects_the_same_boxes_as_a_corner_by_corner_test():
    lower, upper = make_boxes(500)
    planes = Camera.look_at((0, 0, 0), (1, 0.2, 0.3), projection=Perspective(far=80.0)).frustum.planes
    choice = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, 8).T.astype(bool)
    corners = np.where(choice[None], upper[:, None], lower[:, None])
    distance = corners @ planes[:, :3].T + planes[:, 3]
    expected = (distance >= 0.0).any(1).all(1)
    assert (select_visible(planes, lower, upper) == expected).all()
    assert 0 < expected.sum() < 500


def test_a_box_that_touches_a_plane_is_kept_and_one_an_ulp_behind_is_culled():
    planes = np.array([[1.0, 0.0, 0.0, -2.0]])
    flat = np.array([[2.0, 0.0, 0.0]])
    behind = np.nextafter(flat, 0.0) * (1.0, 0.0, 0.0)
    for box, expected in ((flat, [0]), (behind, [])):
        assert np.flatnonzero(select_visible(planes, box, box)).tolist() == expected
        assert cull(HierarchyCuller(build_by_area(box, box), box, box), planes).tolist() == expected


def test_a_camera_inside_a_box_sees_it():
    lower, upper = np.array([[-5.0, -5.0, -5.0]]), np.array([[5.0, 5.0, 5.0]])
    for target in ((1, 0, 0), (0, -1, 0), (0.3, 0.3, -0.8)):
        planes = Camera.look_at((0, 0, 0), target).frustum.planes
        assert cull(HierarchyCuller(build_by_area(lower, upper), lower, upper), planes).tolist() == [0]


def test_without_boxes_nothing_is_visible():
    nothing = np.zeros((0, 3))
    planes = Camera.look_at((0, 0, 0), (0, 0, -1)).frustum.planes
    rows, counts = HierarchyCuller(build_by_area(nothing, nothing), nothing, nothing).select_visible(planes)
    assert len(rows) == 0
    assert counts.planes == 0


def test_the_plane_that_culled_last_time_saves_tests():
    lower, upper = make_boxes(5000, spread=500.0)
    culler = HierarchyCuller(build_by_area(lower, upper), lower, upper)
    camera = Camera.look_at((0, 0, 0), (1, 0, 0.2), projection=Perspective(far=200.0))
    _, first = culler.select_visible(camera.frustum.planes)
    for _ in range(3):
        _, again = culler.select_visible(camera.frustum.planes)
    assert again.nodes == first.nodes
    assert again.planes < first.planes


def test_objects_culled_by_a_far_plane_are_drawn_for_a_camera_without_far_plane():
    lower = np.arange(400)[:, None] * (0.0, 0.0, -1.0)  # a row of cubes ahead
    upper = lower + 0.5
    culler = HierarchyCuller(build_by_area(lower, upper), lower, upper)
    planes = [
        Camera.look_at((0, 0, 1), (0, 0, -1), projection=Perspective(far=far)).frustum.planes
        for far in (50.5, np.inf)
    ]
    for _ in range(2):
        assert len(cull(culler, planes[0])) == 51
    assert len(cull(culler, planes[1])) == 400


def test_planes_that_a_node_lies_inside_are_not_tested_below_it():
    lower = np.arange(64)[:, None] * (1.0, 0.0, 0.0)  # a row of cubes
    upper = lower + 1.0
    tree = build_by_area(lower, upper)
    cut = tree.cut(8)
    passed = cut[tree.upper[cut, 0] >= 30.5]
    objects = int(tree.count[passed[tree.lower[passed, 0] < 30.5]].sum())
    assert 0 < objects < 10
    across, inside = [1.0, 0.0, 0.0, -30.5], [1.0, 0.0, 0.0, 1000.0]
    _, counts = HierarchyCuller(tree, lower, upper).select_visible(np.array([across] + [inside] * 5))
    # Each node against one plane, what passed it against the other five, objects against one.
    assert counts == culling.CullingCounts(len(cut), objects, len(cut) + 5 * len(passed) + objects)


def test_a_node_inside_all_planes_is_taken_whole():
    lower, upper = make_boxes(1000)
    culler = HierarchyCuller(build_by_area(lower, upper), lower, upper)
    rows, counts = culler.select_visible(np.array([[0.0, 1.0, 0.0, 1e4], [0.0, -1.0, 0.0, 1e4]]))
    assert len(rows) == 1000
    assert counts.objects == 0
