"""Game controllers: readings, dead zones, events, and the cameras that they move."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import hypot, inf, isfinite, nan
from typing import Any

import numpy as np
import pytest

from rhi import ValidationError

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi_screen import FlyCamera, Gamepads, OrbitCamera, Screen, SimulatedGamepads, open_screen
from rhi_screen.gamepads import AXES, BUTTONS, EVENT_TYPES, GamepadEvent, GamepadReading, interpret


@pytest.fixture
def screen() -> Iterator[Screen]:
    with open_screen("null", canvas="offscreen", size=(60, 40)) as opened:
        yield opened


@pytest.fixture
def pads(screen: Screen) -> SimulatedGamepads:
    source = screen.gamepads.source = SimulatedGamepads()
    return source


def make_reading(rng: np.random.Generator) -> GamepadReading:
    """A reading with many values at rest, at the ends, and beyond what a driver should report."""
    axes = rng.choice([0.0, -1.0, 1.0, 0.1, -0.1, 0.4, nan, inf, -inf, 7.0, *rng.uniform(-1, 1, 4)], 6)
    return GamepadReading("pad", tuple((rng.random(15) < 0.3).tolist()), tuple(axes.tolist()))


@pytest.mark.parametrize("dead_zone", [0.0, 0.15, 0.6, 0.99])
def test_values_are_0_in_the_dead_zone_and_grow_to_1_along_the_direction(dead_zone: float) -> None:
    rng = np.random.default_rng(1)
    for angle in rng.uniform(0.0, 2.0 * np.pi, 20):
        lengths = []
        for raw in np.linspace(0.0, 1.0, 41):
            x, y = raw * np.cos(angle), raw * np.sin(angle)
            stick = interpret(0, GamepadReading("pad", axes=(x, -y, 0, 0, -1, -1)), dead_zone).left_stick
            lengths.append(hypot(*stick))
            if raw < dead_zone - 1e-9:
                assert stick == (0.0, 0.0)
            elif lengths[-1]:
                assert np.allclose(np.divide(stick, lengths[-1]), (np.cos(angle), np.sin(angle)), atol=1e-6)
        assert all(first <= second for first, second in pairwise(lengths))
        assert lengths[-1] == pytest.approx(1.0)
    triggers = [
        interpret(0, GamepadReading("pad", axes=(0, 0, 0, 0, raw, -1)), dead_zone).left_trigger
        for raw in np.linspace(-1.0, 1.0, 41)
    ]
    assert triggers[0] == 0.0
    assert triggers[-1] == pytest.approx(1.0)
    assert all(first <= second for first, second in pairwise(triggers))
    at_rest = np.linspace(0.0, 1.0, 41) < dead_zone - 1e-9
    assert not np.any(np.array(triggers)[at_rest])


def test_whatever_a_driver_reports_axes_are_finite_and_at_most_1() -> None:
    rng = np.random.default_rng(2)
    for _ in range(500):
        gamepad = interpret(0, make_reading(rng), 0.15)
        assert all(isfinite(value) for value in gamepad.axes.values())
        assert max(hypot(*gamepad.left_stick), hypot(*gamepad.right_stick)) <= 1.0 + 1e-12
        assert 0.0 <= gamepad.left_trigger <= 1.0


@pytest.mark.parametrize("seed", range(4))
def test_events_alone_tell_the_state_of_all_controllers(seed: int) -> None:
    """Controllers come, go and change at random; what events say is what a poll returns."""
    rng = np.random.default_rng(seed)
    source = SimulatedGamepads()
    gamepads = Gamepads(source)
    pressed: dict[int, set[str]] = {}
    axes: dict[int, dict[str, float]] = {}

    def note(event: GamepadEvent) -> None:
        number = event["gamepad"]
        match event["event_type"]:
            case "gamepad_connected":
                assert number not in pressed
                pressed[number], axes[number] = set(), dict.fromkeys(AXES, 0.0)
            case "gamepad_disconnected":
                assert not pressed.pop(number), "what was pressed is released before"
                assert not any(axes.pop(number).values())
            case "gamepad_button_down":
                assert event["button"] not in pressed[number]
                pressed[number].add(event["button"])
            case "gamepad_button_up":
                pressed[number].remove(event["button"])
            case "gamepad_axis":
                assert axes[number][event["axis"]] != event["value"]
                axes[number][event["axis"]] = event["value"]

    gamepads.add_handler(note)
    for _ in range(300):
        number = int(rng.integers(3))
        if rng.random() < 0.3:
            source.remove(number)
        else:
            reading = make_reading(rng)
            name = str(rng.choice(["pad", "pad", "other pad"]))
            source.readings[number] = GamepadReading(name, reading.buttons, reading.axes)
        polled = gamepads.poll()
        assert {gamepad.number: (gamepad.buttons, gamepad.axes) for gamepad in polled} == {
            number: (pressed[number], axes[number]) for number in pressed
        }
    assert gamepads.poll() == tuple(gamepads), "nothing has changed"


def test_a_second_poll_without_a_change_has_no_events(screen: Screen, pads: SimulatedGamepads) -> None:
    events: list[GamepadEvent] = []
    screen.gamepads.add_handler(events.append)
    pads.set(0, buttons=("a",), left_x=0.7)
    screen.gamepads.poll()
    assert [event["event_type"] for event in events] == [
        "gamepad_connected",
        "gamepad_button_down",
        "gamepad_axis",
    ]
    screen.gamepads.poll()
    assert len(events) == 3
    screen.gamepads.remove_handler(events.append)
    pads.set(0)
    screen.gamepads.poll()
    assert len(events) == 3


def test_a_handler_gets_the_types_that_it_asks_for(screen: Screen, pads: SimulatedGamepads) -> None:
    events: list[GamepadEvent] = []

    def listen(event: GamepadEvent) -> None:
        events.append(event)

    screen.gamepads.add_handler(listen, "gamepad_button_up")
    for buttons in (("a", "y"), ("a",), ()):
        pads.set(0, buttons=buttons, right_x=0.5 if buttons else 0.0)
        screen.gamepads.poll()
    assert [event["button"] for event in events] == ["y", "a"]
    screen.gamepads.remove_handler(listen)
    pads.set(0, buttons=("b",))
    screen.gamepads.poll()
    pads.set(0)
    screen.gamepads.poll()
    assert len(events) == 2


@pytest.mark.parametrize(
    "misuse",
    [
        lambda: Gamepads(dead_zone=1.0),
        lambda: Gamepads(dead_zone=-0.1),
        lambda: Gamepads(dead_zone=nan),
        lambda: Gamepads(dead_zone="wide"),  # type: ignore[arg-type]
        lambda: Gamepads().add_handler(print, "gamepad_button"),
        lambda: SimulatedGamepads().set(0, buttons=("c",)),
        lambda: SimulatedGamepads().set(0, left_z=1.0),
    ],
)
def test_misuse_is_refused(misuse: Any) -> None:
    with pytest.raises(ValidationError) as caught:
        misuse()
    assert caught.value.rule.id == "device-argument"


def test_all_names_can_be_simulated(screen: Screen, pads: SimulatedGamepads) -> None:
    for button in BUTTONS:
        pads.set(0, buttons=(button,))
        assert screen.gamepads.poll()[0].buttons == {button}
    for axis in AXES:
        pads.set(0, **{axis: 1.0})
        assert screen.gamepads.poll()[0].axes == {name: float(name == axis) for name in AXES}
    assert len(set(EVENT_TYPES)) == 5


@pytest.mark.parametrize(
    ("axis", "value", "direction"),
    [
        ("left_x", 1.0, (1, 0, 0)),
        ("left_x", -1.0, (-1, 0, 0)),
        ("left_y", 1.0, (0, 0, -1)),
        ("left_y", -1.0, (0, 0, 1)),
        ("right_trigger", 1.0, (0, 1, 0)),
        ("left_trigger", 1.0, (0, -1, 0)),
    ],
)
def test_sticks_and_triggers_move_a_camera(
    screen: Screen, pads: SimulatedGamepads, axis: str, value: float, direction: tuple[int, ...]
) -> None:
    fly = FlyCamera(screen, (0.0, 0.0, 5.0), speed=2.0)
    before = fly.update(0.1).position
    pads.set(0, **{axis: 0.1 * value})
    assert np.array_equal(fly.update(0.1).position, before), "in the dead zone"
    pads.set(0, **{axis: value})
    for _ in range(10):
        camera = fly.update(0.1)
    way = camera.position - before
    assert np.allclose(way / np.linalg.norm(way), direction, atol=1e-6)
    pads.set(0)
    for _ in range(30):
        rest = fly.update(0.1)
    assert np.array_equal(fly.update(0.1).position, rest.position)


def test_the_right_stick_turns_and_a_disabled_camera_stays(screen: Screen, pads: SimulatedGamepads) -> None:
    fly = FlyCamera(screen, (0.0, 0.0, 5.0))
    pads.set(0, right_x=1.0, right_y=0.5)
    for _ in range(5):
        camera = fly.update(0.1)
    assert camera.forward[0] > 0.1, "to the right"
    assert camera.forward[1] > 0.05, "upwards"
    fly.is_enabled = False
    for _ in range(30):
        fly.update(0.1)
    still = fly.camera.forward
    fly.update(0.1)
    assert np.array_equal(fly.camera.forward, still)


@pytest.mark.parametrize("kind", [FlyCamera, OrbitCamera])
def test_bumpers_change_the_speed(screen: Screen, pads: SimulatedGamepads, kind: Any) -> None:
    camera = kind(screen)
    speed = camera.controller.speed
    for buttons in (("right_bumper",), (), ("right_bumper",), (), ("left_bumper",), ()):
        pads.set(0, buttons=buttons)
        camera.update()
    assert camera.controller.speed == pytest.approx(1.5 * speed)
    camera.close()
    pads.set(0, buttons=("right_bumper",))
    screen.gamepads.poll()
    assert camera.controller.speed == pytest.approx(1.5 * speed)


def test_glfw_is_asked_for_each_controller_with_a_mapping(monkeypatch: pytest.MonkeyPatch) -> None:
    glfw = pytest.importorskip("glfw", reason="no GLFW: pip install rhi[viewer]")
    from rhi_screen.glfw_gamepads import MAPPINGS, GlfwGamepads

    mappings: list[str] = []
    states = {2: ([1] + [0] * 14, [0.5, 0.0, 0.0, -1.0, -1.0, 1.0]), 5: None}
    monkeypatch.setenv(MAPPINGS, "03000000de280000ff11000001000000,pad,a:b0")
    monkeypatch.setattr(glfw, "update_gamepad_mappings", mappings.append)
    monkeypatch.setattr(glfw, "joystick_present", lambda number: number in (1, 2, 5))
    monkeypatch.setattr(glfw, "joystick_is_gamepad", lambda number: number != 1)
    monkeypatch.setattr(glfw, "get_gamepad_state", states.__getitem__)
    monkeypatch.setattr(glfw, "get_gamepad_name", lambda number: f"pad {number}")
    gamepads = Gamepads(GlfwGamepads(), dead_zone=0.0)
    (gamepad,) = gamepads.poll()
    assert mappings == ["03000000de280000ff11000001000000,pad,a:b0"]
    assert (gamepad.number, gamepad.name, gamepad.buttons) == (2, "pad 2", {"a"})
    assert gamepad.axes == dict(zip(AXES, (0.5, 0.0, 0.0, 1.0, 0.0, 1.0), strict=True))
