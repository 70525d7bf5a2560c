"""Cascades: where the maps of a directional light are."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from frames import make_boxes
from hypothesis import given
from hypothesis import strategies as st

from renderer.content import load_scene
from renderer.scene import Camera, Orthographic, Perspective, Projection
from renderer.scene.arrays import Floats
from renderer.shadows import ShadowSettings
from renderer.shadows.cascades import (
    Cascade,
    enclose_slices,
    fit_cascades,
    near_and_far,
    slice_corners,
    split_distances,
)
from renderer.shadows.casters import SceneCasters
from renderer.shadows.map_planner import _find_depth

SUN = np.array((-0.55, -0.62, -0.50)) / np.linalg.norm((-0.55, -0.62, -0.50))
PROJECTION = Perspective(fov=1.0, near=0.2)
AHEAD = np.array((0.0, 0.0, -1.0))
SHALLOW = (-100.0, 100.0)


def fit(camera: Camera, direction: Floats = SUN, top: float = 150.0, **settings: float) -> list[Cascade]:
    return fit_cascades([camera], direction, ShadowSettings(**settings), top, SHALLOW)  # type: ignore[arg-type]


def look(position: Floats, target: Floats, projection: Projection = PROJECTION) -> Camera:
    return Camera.look_at(position, target, projection=projection)


def list_bits(cascades: list[Cascade]) -> list[tuple[object, ...]]:
    return [
        (c.camera.position.tobytes(), c.camera.rotation.tobytes(), c.camera.projection, c.texel)
        for c in cascades
    ]


def test_splits_are_between_equal_distances_and_equal_ratios() -> None:
    assert np.allclose(split_distances(1.0, 16.0, 4, 1.0), [1, 2, 4, 8, 16])
    assert np.allclose(split_distances(1.0, 17.0, 4, 0.0), [1, 5, 9, 13, 17])
    assert np.allclose(split_distances(1.0, 17.0, 4, 0.5)[2], 0.5 * 9 + 0.5 * 17**0.5)


@pytest.mark.parametrize("near", [0.0, -5.0])
def test_slices_that_begin_at_the_eye_or_behind_it_are_equally_deep(near: float) -> None:
    assert np.allclose(np.diff(split_distances(near, 15.0, 5, 1.0)), (15.0 - near) / 5)


@pytest.mark.parametrize(
    "projection",
    [PROJECTION, Perspective(fov=2.0, far=50.0), Orthographic(height=8.0, near=-3.0, far=40.0)],
    ids=["no far plane", "wide", "parallel"],
)
def test_spheres_hold_the_corners_of_their_slices(projection: Projection) -> None:
    camera = look(np.array((3.0, 4.0, 5.0)), np.array((1.0, 0.0, -9.0)), projection)
    distances = np.array([near_and_far(camera)[0], 4.0, 9.0, 30.0])
    centres, radii = enclose_slices(camera, distances)
    corners = camera.position + slice_corners(camera, distances) @ camera.rotation
    for first, (centre, radius) in enumerate(zip(centres, radii, strict=True)):
        both = corners[first : first + 2].reshape(-1, 3)
        assert np.linalg.norm(both - centre, axis=1).max() <= radius * (1 + 1e-12)
    clip = camera.view_projection @ np.concatenate([corners[1].T, np.ones((1, 4))])
    assert np.allclose(np.abs(clip[:2] / clip[3]), 1.0)


@given(
    st.tuples(*[st.floats(-1e5, 1e5)] * 3),
    st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: float(np.linalg.norm(v)) > 0.1),
)
def test_maps_are_at_whole_texels_and_as_large_wherever_the_eye_is_and_looks(
    eye: tuple[float, ...], towards: tuple[float, ...]
) -> None:
    first = fit(look(np.zeros(3), AHEAD))
    for cascade, other in zip(first, fit(look(np.array(eye), np.array(eye) + towards)), strict=True):
        assert cascade.texel == other.texel
        texels = (other.camera.rotation @ other.camera.position)[:2] / other.texel
        assert np.abs(texels - np.round(texels)).max() < 1e-12 * np.abs(texels).max() + 1e-6


def test_a_turn_of_the_eye_keeps_the_width_of_texels() -> None:
    angles = np.linspace(0.0, 2.0 * np.pi, 50)
    widths = {
        fit(look(np.zeros(3), np.array((np.sin(a), 0.3 * np.sin(2 * a), np.cos(a)))))[2].texel for a in angles
    }
    assert len(widths) == 1


def test_cascades_end_at_the_far_plane() -> None:
    near = fit(look(np.zeros(3), AHEAD, Perspective(fov=1.0, near=0.2, far=20.0)))
    least = fit(look(np.zeros(3), AHEAD, Perspective(fov=1.0, near=0.2, far=0.3)))
    assert len(near) == len(least) == 4
    assert 10.0 < near[-1].inner < 30.0
    assert least[-1].inner < 0.6


def test_a_near_plane_beyond_the_distance_of_shadows_has_cascades_behind_it() -> None:
    projection = Perspective(fov=1.0, near=1000.0)
    cascades = fit(look(np.zeros(3), AHEAD, projection))
    assert all(np.isfinite(cascade.texel) and cascade.texel > 0.0 for cascade in cascades)


def test_parallel_views_have_cascades_where_the_scene_is() -> None:
    camera = look(np.array((0.0, 50.0, 0.0)), np.zeros(3), Orthographic(height=20.0, near=0.0, far=1e4))
    cascades = fit_cascades([camera], SUN, ShadowSettings(), 10.0, (48.0, 64.0))
    assert max(cascade.inner for cascade in cascades) < 40.0
    for cascade in cascades:
        low = camera.position + camera.forward * 64.0 - cascade.camera.position
        assert 0.0 < low @ cascade.camera.forward < cascade.length


def test_the_depths_of_a_parallel_view_are_those_of_the_scene_in_whole_steps() -> None:
    scene = load_scene("hall:columns=6")
    lower, upper = scene.bounds
    corners = np.array(list(product(*zip(lower, upper, strict=True))))
    for direction in ((1.0, 0.0, 0.0), (0.3, -0.8, 0.2)):
        camera = look(np.array((3.0, 5.0, 7.0)), np.array(direction))
        true = (corners - camera.position) @ camera.forward
        low, high = _find_depth(scene, camera)
        assert true.min() - 16.0 < low <= true.min()
        assert true.max() <= high < true.max() + 16.0


def test_a_map_of_one_texel_holds_its_slice() -> None:
    (cascade,) = fit(look(np.zeros(3), AHEAD), cascades=1, cascade_size=1)
    assert cascade.inner == pytest.approx(0.5 * cascade.texel)


def test_views_of_one_frame_share_cascades_that_hold_the_slices_of_all() -> None:
    eyes = [look(np.array((x, 2.0, 0.0)), np.array((x, 2.0, -1.0))) for x in (-0.03, 0.03)]
    both = fit_cascades(eyes, SUN, ShadowSettings(), 150.0, SHALLOW)
    for eye in eyes:
        distances = split_distances(0.2, 250.2, 4, 0.7)
        for cascade, centre, radius in zip(both, *enclose_slices(eye, distances), strict=True):
            aside = np.abs(cascade.camera.rotation @ (centre - cascade.camera.position))[:2].max()
            assert aside + radius <= cascade.inner


@given(st.floats(-500.0, 500.0))
def test_maps_reach_from_all_casters_to_below_their_slice(top: float) -> None:
    camera = look(np.zeros(3), AHEAD)
    distances = split_distances(0.2, 250.2, 4, 0.7)
    for cascade, centre, radius in zip(fit(camera, top=top), *enclose_slices(camera, distances), strict=True):
        above = cascade.camera.rotation[2] @ cascade.camera.position
        middle = cascade.camera.rotation[2] @ centre
        assert above >= top
        assert above - cascade.length <= middle - radius


@pytest.mark.parametrize("aside", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_casters_beside_a_cascade_are_left_out_though_the_receiver_reaches_them(
    aside: tuple[int, int],
) -> None:
    cascade = fit(look(np.array((0.0, 3.0, 0.0)), np.array((0.0, 3.0, -1.0))))[0]
    map_camera, rows = cascade.camera, cascade.camera.rotation
    edge = 1.0 / map_camera.projection.matrix[0, 0]  # with what filters read
    way = aside[0] * rows[0] + aside[1] * rows[1]
    below = map_camera.position + map_camera.forward * 0.5 * cascade.length
    steps = [0.0, 0.9 * edge, edge + 1.5, 3.0 * edge]  # half of a box's diagonal is 0.87
    scene = make_boxes(*(below + step * way for step in steps)).build()
    receiver = np.full((1, 3), -1e3), np.full((1, 3), 1e3)
    casters = SceneCasters(scene).rotate_casters(0, rows).select_casters(cascade, receiver)
    assert casters is not None
    assert casters.static.tolist() == [0, 1]
