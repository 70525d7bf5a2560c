"""Gestures: what events do to a controller."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rhi.math import Camera
from rhi_screen.controllers import FAST_FACTOR
from rhi_screen.gestures import Gestures

Motions = list[tuple[str, float, float]]


class Listener:
    """A controller that notes what it is told."""

    name = "motions"
    speed = 1.0
    is_moving = False
    angle = 2.0
    camera = Camera.look_at((0, 0, 1), (0, 0, 0))

    def __init__(self) -> None:
        self.motions: Motions = []

    def turn(self, left: float, up: float) -> None:
        self.motions.append(("turn", left, up))

    def drag(self, right: float, up: float) -> None:
        self.motions.append(("drag", right, up))

    def zoom(self, notches: float) -> None:
        self.motions.append(("zoom", notches, 0.0))

    def advance(self, push: Any, turn: Any, seconds: float) -> None:
        raise AssertionError


def pointer(kind: str, x: float, y: float, button: int = 0, **more: Any) -> dict[str, Any]:
    buttons = (button,) if button and kind != "pointer_up" else ()
    event = {
        "event_type": kind,
        "x": x,
        "y": y,
        "button": button,
        "buttons": buttons,
        "modifiers": (),
        "touches": {},
    }
    return event | more


def apply(*events: dict[str, Any]) -> Motions:
    gestures, controller = Gestures(), Listener()
    for event in events:
        gestures.move(event, controller, 100.0)
    return controller.motions


def drag(button: int, **more: Any) -> Motions:
    return apply(pointer("pointer_down", 10, 10, button), pointer("pointer_move", 30, 20, button, **more))


def test_the_left_button_turns_by_parts_of_the_height() -> None:
    assert drag(1) == [("turn", pytest.approx(-0.4), pytest.approx(-0.2))]


@pytest.mark.parametrize("motions", [drag(2), drag(3), drag(1, modifiers=("Shift",))])
def test_other_buttons_and_shift_drag(motions: Motions) -> None:
    assert motions == [("drag", pytest.approx(0.2), pytest.approx(-0.1))]


def test_without_a_button_nothing_moves() -> None:
    assert apply(pointer("pointer_move", 10, 10), pointer("pointer_move", 50, 50)) == []


def test_a_button_that_was_released_outside_of_the_window_is_forgotten() -> None:
    down, out = pointer("pointer_down", 10, 10, 1), pointer("pointer_move", 50, 50)
    assert apply(down, out, pointer("pointer_move", 90, 90, 1)) == []


def test_the_wheel_zooms_and_sideways_drags() -> None:
    wheel = {"event_type": "wheel", "dx": 0.0, "dy": -200.0}
    assert apply(wheel) == [("zoom", 2.0, 0.0)]
    assert apply(wheel | {"dx": 50.0, "dy": 0.0}) == [("zoom", 0.0, 0.0), ("drag", -0.05, 0.0)]


def test_two_fingers_drag_and_zoom() -> None:
    def touches(*positions: tuple[float, float]) -> dict[str, Any]:
        fingers = {number: {"x": x, "y": y, "pressure": 1.0} for number, (x, y) in enumerate(positions)}
        return pointer("pointer_move", *positions[0], 1, touches=fingers)

    motions = apply(touches((40, 50), (60, 50)), touches((40, 60), (80, 60)))
    assert motions[0] == ("drag", pytest.approx(0.1), pytest.approx(-0.1))
    assert motions[1][:2] == ("zoom", pytest.approx(np.log(2.0) / np.log(1.15)))
    assert len(apply(touches((40, 50), (60, 50)), touches((40, 60)))) == 0  # one was lifted


@pytest.mark.parametrize(("moved", "is_click"), [(0.0, True), (3.0, True), (5.0, False)])
def test_a_click_has_hardly_moved(moved: float, is_click: bool) -> None:
    gestures, controller = Gestures(), Listener()
    gestures.move(pointer("pointer_down", 10, 10, 1), controller, 100.0)
    gestures.move(pointer("pointer_move", 10 + moved, 10, 1), controller, 100.0)
    assert gestures.is_click(pointer("pointer_up", 10 + moved, 10, 1)) is is_click
    assert not gestures.is_click(pointer("pointer_up", 10, 10, 2))


def press(gestures: Gestures, *keys: str) -> None:
    for key in keys:
        gestures.handle_key({"event_type": "key_down", "key": key})


def test_held_keys_push_and_opposite_ones_cancel() -> None:
    gestures = Gestures()
    press(gestures, "w", "d", "ArrowLeft")
    push, turn = gestures.pushes()
    assert (push.tolist(), turn.tolist()) == ([1, 0, -1], [1, 0, 0])
    press(gestures, "a")
    assert gestures.pushes()[0].tolist() == [0, 0, -1]


def test_shift_is_fast_and_a_letter_is_the_same_key_with_it() -> None:
    gestures = Gestures()
    press(gestures, "w", "Shift")
    assert gestures.pushes()[0].tolist() == [0, 0, -FAST_FACTOR]
    gestures.handle_key({"event_type": "key_up", "key": "W"})
    assert not gestures.has_pressed_keys


def test_a_key_that_moves_nothing_is_not_held() -> None:
    gestures = Gestures()
    press(gestures, "t", "Shift")
    assert not gestures.has_pressed_keys
    press(gestures, "e")
    assert gestures.has_pressed_keys
    gestures.release()
    assert not gestures.has_pressed_keys
