"""Pairs of eyes: parallax by its formula, what both see, and a comfortable default. All in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused_rule

from renderer import scene as scenes
from renderer.scene import (
    HUMAN_EYE_DISTANCE,
    Camera,
    Depth,
    Perspective,
    Projection,
    StereoRig,
    measure_parallax,
)
from renderer.scene.arrays import Floats

HERE = (3.0, 1.7, -4.0)
FAR_AWAY = (1e5, 1.7, -2e5)
PROJECTIONS: dict[str, Projection] = {
    "perspective": Perspective(1.1, 16 / 9, 0.1),
    "perspective with an end": Perspective(0.7, 1.3, 0.5, 80.0, Depth.STANDARD),
    "parallel": scenes.Orthographic(6.0, 1.5, -2.0, 90.0),
}


def look(projection: Projection, position: tuple[float, float, float] = HERE) -> Camera:
    return Camera.look_at(position, np.add(position, (1.0, -0.2, -2.0)), projection=projection)


def make_points(camera: Camera, distances: Any, aside: Any = 0.3) -> Floats:
    """Return points at distances along the view, `aside` of each to the right and half as much upwards."""
    z = np.asarray(distances, np.float64)[:, None]
    right, up, _ = camera.rotation
    return np.asarray(camera.position + z * camera.forward + aside * z * right + 0.5 * aside * z * up)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_parallax_is_that_of_the_formula_and_never_vertical_far_from_the_origin(name: str) -> None:
    camera, rig = look(PROJECTIONS[name], FAR_AWAY), StereoRig(0.065, 2.5)
    distances = np.geomspace(0.5, 1e4, 40)
    measured = measure_parallax(rig.place_eyes(camera), make_points(camera, distances))
    scale = PROJECTIONS[name].matrix[0, 0] * 0.065
    formula = scale * (distances / 2.5 - 1.0) if name == "parallel" else scale * (1.0 / 2.5 - 1.0 / distances)
    assert rig.compute_parallax(PROJECTIONS[name], distances) == pytest.approx(formula, rel=1e-14)
    exactness = 1e-9  # a double at 2e5 m has steps of 3e-11 m
    spread = 1.0 + np.abs(formula)
    assert (np.abs(measured[:, 0] - formula) / spread).max() < exactness
    assert (np.abs(measured[:, 1]) / spread).max() < exactness


@pytest.mark.parametrize("name", PROJECTIONS)
def test_parallax_changes_its_sign_at_the_convergence_distance(name: str) -> None:
    camera, rig = look(PROJECTIONS[name]), StereoRig(0.065, 2.5)
    before, at, behind = measure_parallax(
        rig.place_eyes(camera), make_points(camera, [2.5 * (1 - 1e-9), 2.5, 2.5 * (1 + 1e-9)])
    )[:, 0]
    assert before < 0.0 < behind
    assert abs(at) < 1e-15
    assert rig.compute_parallax(PROJECTIONS[name], 2.5) == 0.0


def test_parallax_at_infinity_is_the_eye_distance_over_the_convergence() -> None:
    projection = PROJECTIONS["perspective"]
    camera = look(projection)
    for convergence, want in ((2.5, projection.matrix[0, 0] * 0.065 / 2.5), (np.inf, 0.0)):
        rig = StereoRig(0.065, convergence)
        assert rig.compute_parallax(projection, np.inf) == pytest.approx(want)
        measured = measure_parallax(rig.place_eyes(camera), make_points(camera, [1e12]))
        assert measured[0, 0] == pytest.approx(want, abs=1e-12)
    assert StereoRig(0.065, np.inf).compute_parallax(projection, 5.0) < 0.0, (
        "all is in front of a screen at infinity"
    )


def test_eyes_that_are_toed_in_see_corners_at_different_heights() -> None:
    projection = Perspective(np.pi / 3, 16 / 9)
    camera = look(projection)
    right, up, _ = camera.rotation
    for convergence, pixels in ((1.0, 32.0), (10.0, 3.3)):
        corner = camera.position + convergence * (
            camera.forward + (0.98 * right / projection.matrix[0, 0]) + 0.98 * up / projection.matrix[1, 1]
        )
        toed_in, off_axis = (
            measure_parallax(StereoRig(0.065, convergence, toed).place_eyes(camera), [corner])[0] * (960, 540)
            for toed in (True, False)
        )
        assert abs(toed_in[1]) == pytest.approx(pixels, rel=0.1)
        assert abs(off_axis[1]) < 1e-9
    middle = camera.position + 10.0 * camera.forward
    for toed in (True, False):
        assert (
            np.abs(measure_parallax(StereoRig(0.065, 10.0, toed).place_eyes(camera), [middle])).max() < 1e-12
        )


@pytest.mark.parametrize("is_toed_in", [False, True])
@pytest.mark.parametrize("convergence", [0.4, 3.0, np.inf])
@pytest.mark.parametrize("name", PROJECTIONS)
def test_the_camera_that_encloses_both_eyes_sees_everything_that_either_eye_sees(
    name: str, convergence: float, is_toed_in: bool
) -> None:
    projection = PROJECTIONS[name]
    camera, rig = look(projection), StereoRig(0.1, convergence, is_toed_in)
    rng = np.random.default_rng(3)
    around = rig.enclose(camera).frustum.planes
    ends = (1.0, 1e-6) if projection.depth is Depth.REVERSED else (0.0, 1.0)
    for eye in rig.place_eyes(camera):
        clip = rng.uniform(-1.0, 1.0, (4000, 4))
        clip[:2000, :2] = np.sign(clip[:2000, :2])  # the edges of the view, where it matters
        clip[:, 2] = np.where(rng.random(4000) < 0.5, ends[0], rng.uniform(*sorted(ends), 4000))
        clip[:, 3] = 1.0
        points = clip @ np.linalg.inv(eye.projection.matrix).T
        world = points[:, :3] / points[:, 3:] @ eye.rotation + eye.position
        assert (world @ around[:, :3].T + around[:, 3]).min() >= -1e-9 * np.abs(world).max()


def test_the_camera_around_both_eyes_sees_little_more() -> None:
    # The control: a frustum that holds everything would pass the test above.
    camera, rig = look(PROJECTIONS["perspective"]), StereoRig(0.065, 3.0)
    planes = rig.enclose(camera).frustum.planes
    for distance in (0.5, 3.0, 100.0):
        edge = 1.0 / PROJECTIONS["perspective"].matrix[0, 0]
        margin = 0.065 * (1.0 + distance / 3.0) / distance
        outside = make_points(camera, [distance], edge + margin)
        assert (outside @ planes[:, :3].T + planes[:, 3]).min() < 0.0


@pytest.mark.parametrize("is_toed_in", [False, True])
def test_eyes_without_a_distance_are_the_camera(is_toed_in: bool) -> None:
    camera, rig = look(PROJECTIONS["perspective"]), StereoRig(0.0, 3.0, is_toed_in)
    assert all(eye is camera for eye in (*rig.place_eyes(camera), rig.enclose(camera)))


@pytest.mark.parametrize(
    "projection", [PROJECTIONS["perspective"], scenes.Orthographic(1.0, 1.5)], ids=["perspective", "parallel"]
)
def test_the_comfortable_rig_spreads_parallax_evenly_about_the_screen(projection: Projection) -> None:
    rig = StereoRig.comfortable(projection, 0.5, 20.0)
    near, far = rig.compute_parallax(projection, [0.5, 20.0])
    assert near == pytest.approx(-far)
    assert far - near == pytest.approx(2.0 * scenes.COMFORTABLE_PARALLAX)
    assert 0.0 < rig.eye_distance < HUMAN_EYE_DISTANCE


def test_the_comfortable_rig_has_at_most_the_distance_of_human_eyes() -> None:
    projection = PROJECTIONS["perspective"]
    for nearest, farthest in ((50.0, 1000.0), (5.0, 5.0), (5.0, np.inf)):
        rig = StereoRig.comfortable(projection, nearest, farthest)
        assert rig.eye_distance == HUMAN_EYE_DISTANCE
        assert nearest <= rig.convergence <= farthest
    assert StereoRig.comfortable(projection, 0.5, np.inf).eye_distance < HUMAN_EYE_DISTANCE


@pytest.mark.parametrize(
    "bad",
    [
        {"eye_distance": -0.1},
        {"eye_distance": np.inf},
        {"eye_distance": np.nan},
        {"convergence": 0.0},
        {"convergence": np.nan},
    ],
)
def test_bad_rigs_are_refused(bad: dict[str, float]) -> None:
    assert refused_rule(lambda: StereoRig(**bad)) == "stereo-bad-value"


@pytest.mark.parametrize(("nearest", "farthest"), [(0.0, 1.0), (2.0, 1.0), (np.nan, 1.0)])
def test_bad_depth_ranges_are_refused(nearest: float, farthest: float) -> None:
    assert (
        refused_rule(lambda: StereoRig.comfortable(PROJECTIONS["perspective"], nearest, farthest))
        == "stereo-bad-value"
    )


def test_eyes_toed_in_beyond_a_half_space_are_refused() -> None:
    camera = look(Perspective(2.6, 1.0))
    assert refused_rule(lambda: StereoRig(0.5, 0.2, is_toed_in=True).enclose(camera)) == "stereo-bad-value"
    assert StereoRig(0.065, 3.0, is_toed_in=True).enclose(camera).projection.matrix[0, 0] > 0.0
