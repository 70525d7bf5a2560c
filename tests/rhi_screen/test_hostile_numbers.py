"""Numbers that screens can't use: a program's are refused by a rule, an event's move nothing."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi import RhiError
from rhi.math import Camera, Orthographic, Perspective
from rhi_screen import FixedSteps, FlyCamera, OrbitCamera, VideoWriter, open_screen
from rhi_screen.controllers import Controller, Fly, Orbit

NAN, INF = float("nan"), float("inf")
NO_NUMBERS: tuple[Any, ...] = (NAN, INF, -INF, 1j, "1", None, (1.0,), np.ma.masked, 10**400, 1e39, True)
BEGIN = Camera.look_at((3.0, 2.0, 5.0), (0.0, 1.0, -2.0))
PARALLEL = Camera.look_at((3.0, 2.0, 5.0), (0.0, 1.0, -2.0), projection=Orthographic(4.0))
CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "orbit": lambda: Orbit(BEGIN, np.array((0.0, 1.0, -2.0)), 4.0),
    "parallel orbit": lambda: Orbit(PARALLEL, np.array((0.0, 1.0, -2.0)), 4.0),
    "fly": lambda: Fly(BEGIN, 4.0),
    "parallel fly": lambda: Fly(PARALLEL, 4.0),
}


def is_usable(camera: Camera) -> bool:
    """True if a camera's matrices are finite, and see something."""
    return bool(np.isfinite(camera.view_projection).all() and np.isfinite(camera.frustum.planes).all())


def gesture(controller: Controller, rng: random.Random, number: Callable[[], float]) -> None:
    """Make a random gesture with these numbers."""
    match rng.randrange(4):
        case 0:
            controller.turn(number(), number())
        case 1:
            controller.drag(number(), number())
        case 2:
            controller.zoom(number())
        case _:
            push, turn = (np.array([number() for _ in range(3)]) for _ in range(2))
            controller.advance(push, turn, number())


@pytest.mark.parametrize("kind", CONTROLLERS)
@pytest.mark.parametrize("seed", range(8))
def test_a_camera_survives_any_gesture(kind: str, seed: int) -> None:
    """Whatever comes, the camera is usable, and the next gestures move it."""
    rng = random.Random(seed)
    hostile = (NAN, INF, -INF, 1e308, -1e308, 1e30, 10_000.0, -10_000.0, 1e-320, 0.0, 1.0)
    controller = CONTROLLERS[kind]()
    for _ in range(60):
        gesture(controller, rng, lambda: rng.choice(hostile))
        assert is_usable(controller.camera)
    before = controller.camera
    controller.turn(0.3, -0.2)
    assert not np.array_equal(controller.camera.rotation, before.rotation)


@pytest.mark.parametrize("kind", ["orbit", "parallel orbit"])
@pytest.mark.parametrize("notches", [10_000.0, -10_000.0, 1e300, -1e300])
def test_an_orbit_comes_back_from_many_notches(kind: str, notches: float) -> None:
    controller = CONTROLLERS[kind]()
    assert isinstance(controller, Orbit)
    controller.zoom(notches)
    distance = controller.distance
    for _ in range(300):
        controller.zoom(-1.0 if notches > 0 else 1.0)
    assert is_usable(controller.camera)
    assert not 0.5 < controller.distance / distance < 2.0
    assert 1e-6 < controller.distance < 1e12 or controller.distance in (1e-6, 1e12)


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_ordinary_gestures_move_as_before(kind: str) -> None:
    """The control: nothing that a person does is dropped."""
    controller = CONTROLLERS[kind]()
    for move in (
        lambda: controller.zoom(3.0),
        lambda: controller.drag(0.2, 0.1),
        lambda: controller.turn(0.1, 0.1),
    ):
        before = controller.camera.view_projection.copy()
        move()
        assert not np.array_equal(controller.camera.view_projection, before)


@pytest.mark.parametrize("number", [NAN, INF, -INF])
@pytest.mark.parametrize("name", ["x", "y", "dx", "dy"])
def test_an_event_without_finite_numbers_moves_nothing(number: float, name: str) -> None:
    with open_screen("null", canvas="offscreen", size=(60, 40)) as screen:
        orbit = OrbitCamera(screen)
        begin = orbit.update()
        screen.send("pointer_down", x=10.0, y=10.0, button=1, buttons=(1,))
        if name in "xy":
            screen.send("pointer_move", **{"x": 30.0, "y": 20.0, "buttons": (1,), name: number})
        else:
            screen.send("wheel", **{"dx": 0.0, "dy": 0.0, name: number})
        assert np.array_equal(orbit.update().view, begin.view)
        screen.send("pointer_move", x=40.0, y=20.0, buttons=(1,))
        assert is_usable(orbit.update())
        assert not np.array_equal(orbit.update().view, begin.view)


@pytest.mark.parametrize("name", ["target", "distance", "yaw", "pitch"])
@pytest.mark.parametrize("value", [NAN, INF, 1j, "x", None, np.ma.masked, {1.0}])
def test_a_camera_of_a_screen_begins_with_numbers(name: str, value: Any) -> None:
    with open_screen("null", canvas="offscreen", size=(60, 40)) as screen:
        arguments: dict[str, Any] = {"target": (0.0, 0.0, value)} if name == "target" else {name: value}
        with pytest.raises(RhiError, match=r"^\[camera-bad-value\]"):
            OrbitCamera(screen, **arguments)
        with pytest.raises(RhiError):
            FlyCamera(screen, speed=value)


@pytest.mark.parametrize("value", [*NO_NUMBERS, 0.0, -1.0])
def test_steps_take_a_rate_above_0(value: Any) -> None:
    with pytest.raises(RhiError, match=r"^\[device-argument\]"):
        FixedSteps(value)


@pytest.mark.parametrize("value", [NAN, INF, 1.5, "1", 0, -1, True])
def test_steps_take_a_whole_number_of_them(value: Any) -> None:
    with pytest.raises(RhiError, match=r"^\[device-argument\]"):
        FixedSteps(60.0, value)


@pytest.mark.parametrize("value", [number for number in NO_NUMBERS if number is not None] + [-0.1])
def test_steps_take_time_that_has_passed(value: Any) -> None:
    steps = FixedSteps(10.0)
    with pytest.raises(RhiError, match=r"^\[device-argument\]"):
        steps.advance(value)
    assert len(steps.advance(0.25)) == 2  # the refused call has changed nothing


@pytest.mark.parametrize("value", [*(number for number in NO_NUMBERS), 0.0, -1.0, 1e6])
def test_a_video_has_a_rate(tmp_path: Path, value: Any) -> None:
    pytest.importorskip("av", reason='no PyAV: pip install "rhi[video]"')
    with pytest.raises(RhiError, match=r"^\[device-argument\]"):
        VideoWriter(tmp_path / "turn.mp4", value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name", ["", ".", "folder", "none", "turn.unknown", "turn.txt", "turn.wav", "turn.png/turn.mp4"]
)
def test_a_video_that_cannot_be_written_is_refused(tmp_path: Path, name: str) -> None:
    pytest.importorskip("av", reason='no PyAV: pip install "rhi[video]"')
    (tmp_path / "folder").mkdir()
    (tmp_path / "turn.png").write_bytes(b"")
    with pytest.raises(RhiError, match=r"^\[video-file\]"):
        VideoWriter(tmp_path / name)


@pytest.mark.parametrize("path", [None, 3, b"turn.mp4", 1j])
def test_a_video_has_a_path(path: Any) -> None:
    pytest.importorskip("av", reason='no PyAV: pip install "rhi[video]"')
    with pytest.raises(RhiError, match=r"^\[device-argument\]"):
        VideoWriter(path)


@pytest.mark.parametrize(
    "image",
    [
        None, 5, "image", [[1, 2], [3]], {1, 2}, np.zeros((4, 4)), np.zeros((4, 4, 3)), np.zeros((4, 4, 2), np.uint8),
        np.zeros((4, 4, 5), np.uint8), np.zeros((4, 4, 4), np.int8), np.ma.masked_array(np.zeros((4, 4, 3), np.uint8)),
        np.zeros((2, 4, 4, 3), np.uint8),
    ],
)  # fmt: skip
def test_a_video_takes_images(tmp_path: Path, image: Any) -> None:
    pytest.importorskip("av", reason='no PyAV: pip install "rhi[video]"')
    with VideoWriter(tmp_path / "turn.mp4") as video:
        with pytest.raises(RhiError, match=r"^\[video-image\]"):
            video.add(image)
        video.add(np.zeros((4, 4, 3), np.uint8))
        assert video.frames == 1
    with pytest.raises(RhiError, match=r"^\[video-image\]"):
        video.add(np.zeros((4, 4, 3), np.uint8))


def test_perspective_and_parallel_cameras_are_usable() -> None:
    """`is_usable` accepts ordinary cameras, and refuses others."""
    assert is_usable(BEGIN)
    assert is_usable(PARALLEL)
    assert not is_usable(Camera(np.full(3, NAN), np.eye(3), Perspective()))
