"""Controllers: motion by time, dragging by parts of the image, and cameras in float64."""

from __future__ import annotations

import numpy as np
import pytest

from rhi.math import Camera, Orthographic, Perspective
from rhi_screen.controllers import Controller, Fly, Glide, Heading, Orbit, image_height

NONE = np.zeros(3)
AHEAD = np.array((0.0, 0.0, -1.0))
BEGIN = Camera.look_at((3.0, 2.0, 5.0), (0.0, 1.0, -2.0))


def make(kind: str, camera: Camera = BEGIN) -> Controller:
    return Fly(camera, 4.0) if kind == "fly" else Orbit(camera, np.array((0.0, 1.0, -2.0)), 4.0)


def run(controller: Controller, push: np.ndarray, seconds: float, frames: int) -> Camera:
    for _ in range(frames):
        controller.advance(push, NONE, seconds / frames)
    return controller.camera


@pytest.mark.parametrize("kind", ["fly", "orbit"])
def test_a_controller_begins_at_its_camera(kind: str) -> None:
    camera = make(kind).camera
    assert np.allclose(camera.position, BEGIN.position, atol=1e-12)
    assert np.allclose(camera.rotation, BEGIN.rotation, atol=1e-12)


@pytest.mark.parametrize("kind", ["fly", "orbit"])
@pytest.mark.parametrize("frames", [2, 7, 240])
def test_a_second_of_a_key_goes_as_far_in_any_number_of_frames(kind: str, frames: int) -> None:
    once, often = (run(make(kind), AHEAD, 1.0, count) for count in (1, frames))
    assert np.allclose(once.position, often.position, atol=1e-9)
    assert np.linalg.norm(once.position - BEGIN.position) > 2.0


def test_a_key_reaches_the_speed_and_its_release_ends_the_motion() -> None:
    fly = Fly(BEGIN, 4.0)
    run(fly, AHEAD, 2.0, 120)
    before = fly.camera.position
    assert np.linalg.norm(run(fly, AHEAD, 1.0, 60).position - before) == pytest.approx(4.0, rel=1e-6)
    run(fly, NONE, 1.0, 60)
    assert not fly.is_moving
    assert (fly.camera.position == run(fly, NONE, 1.0, 60).position).all()


def test_a_glide_is_the_integral_of_its_speed() -> None:
    glide, steps = Glide(), 100_000
    target_speed, way, speeds = np.array((2.0, 0.0, 0.0)), 0.0, []
    fine = Glide()
    for _ in range(steps):
        speeds.append(fine.speed[0])
        fine.advance(target_speed, 0.5 / steps)
    way = float(glide.advance(target_speed, 0.5)[0])
    assert way == pytest.approx(np.mean(speeds) * 0.5, rel=1e-4)


@pytest.mark.parametrize("kind", ["fly", "orbit"])
def test_the_view_never_turns_over(kind: str) -> None:
    controller = make(kind)
    for _ in range(50):
        controller.turn(0.1, 0.5)
    assert controller.camera.rotation[1][1] >= -1e-12
    assert controller.camera.forward[1] == pytest.approx(1.0)
    controller.turn(0.0, -0.1)
    assert controller.camera.forward[1] < 1.0


@pytest.mark.parametrize("pitch", [-np.pi / 2, -0.7, 0.0, 0.7, np.pi / 2])
@pytest.mark.parametrize("yaw", [-3.0, -1.0, 0.0, 2.0])
def test_the_heading_of_a_camera_is_the_heading_that_it_was_built_with(yaw: float, pitch: float) -> None:
    heading = Heading(yaw, pitch)
    camera = Camera(np.zeros(3), heading.rotation, Perspective())
    assert np.allclose(Heading.of(camera).rotation, heading.rotation, atol=1e-9)
    assert np.allclose(heading.rotation @ heading.rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(heading.rotation) == pytest.approx(1.0)


def test_a_drag_in_an_orbit_keeps_the_point_below_the_pointer() -> None:
    orbit = Orbit(BEGIN, np.array((0.0, 1.0, -2.0)), 1.0)
    before = orbit.camera
    point = orbit.target.copy()
    orbit.drag(0.2, -0.1)
    after = orbit.camera

    def position_in_view(camera: Camera) -> np.ndarray:
        clip = camera.view_projection @ np.append(point, 1.0)
        return np.asarray(clip[:2] / clip[3] * (camera.projection.aspect, 1.0) / 2.0)  # type: ignore[attr-defined]

    assert position_in_view(after) - position_in_view(before) == pytest.approx((0.2, -0.1), abs=1e-9)


def test_zooming_an_orbit_in_and_out_comes_back() -> None:
    orbit = Orbit(BEGIN, np.array((0.0, 1.0, -2.0)), 1.0)
    orbit.zoom(5.0)
    assert np.linalg.norm(orbit.camera.position - orbit.target) < 5.0
    orbit.zoom(-5.0)
    assert np.allclose(orbit.camera.position, BEGIN.position, atol=1e-9)
    orbit.zoom(10_000.0)
    assert np.isfinite(orbit.camera.position).all()


@pytest.mark.parametrize("kind", ["fly", "orbit"])
def test_zooming_an_orthographic_projection_shows_less(kind: str) -> None:
    controller = make(kind, BEGIN.with_projection(Orthographic(10.0)))
    controller.zoom(1.0)
    assert image_height(controller.camera.projection, 1.0) == pytest.approx(10.0 / 1.15)


def test_steps_of_a_millimetre_add_up_far_from_the_origin() -> None:
    far = Camera.look_at((3e7, 2.0, 5.0), (3e7, 2.0, -5.0))
    fly = Fly(far, 0.06)
    run(fly, AHEAD, 2.0, 120)
    before = fly.camera.position
    run(fly, AHEAD, 1.0, 60)
    assert fly.camera.position - before == pytest.approx((0.0, 0.0, -0.06), abs=1e-6)
