"""Gestures: pointer, wheel, touch and key events, as rendercanvas submits them, turned into motion of a
controller."""

from __future__ import annotations

from collections.abc import Mapping
from math import hypot, log
from typing import Any, Final

import numpy as np

from rhi.math import Floats
from rhi_screen.arguments import are_gestures
from rhi_screen.controllers import FAST_FACTOR, NOTCH, Controller

Event = Mapping[str, Any]

_PUSHES: Final = {
    "w": (0, 0, -1), "s": (0, 0, 1), "a": (-1, 0, 0), "d": (1, 0, 0), "e": (0, 1, 0), "q": (0, -1, 0),
    "pageup": (0, 1, 0), "pagedown": (0, -1, 0),
}  # fmt: skip
_TURNS: Final = {
    "arrowleft": (1, 0, 0),
    "arrowright": (-1, 0, 0),
    "arrowup": (0, 1, 0),
    "arrowdown": (0, -1, 0),
}
MOVEMENT_KEYS: Final = frozenset({*_PUSHES, *_TURNS})
"""The keys that move as long as they are held, in lower case."""

_LEFT: Final = 1
_WHEEL: Final = 100.0  # of a notch
_SIDEWAYS: Final = 1000.0  # of the wheel, for the image's height
_CLICK: Final = 4.0  # logical pixels that a click may move


class Gestures:
    """Knows which keys are held and where fingers and the pointer are.

    - Left button, or one finger: turn. Right or middle button, or left with Shift: drag.
    - Wheel, or two fingers on a touch pad up and down: zoom. Sideways: drag. A pinch on a touch pad is a
      wheel, too.
    - Two fingers on a touch screen: drag and zoom.
    """

    def __init__(self) -> None:
        self._pressed: set[str] = set()
        self._pointer: tuple[float, float] | None = None  # while a button is down
        self._way = 0.0  # that it went since then
        self._fingers: list[tuple[float, float]] = []

    @property
    def has_pressed_keys(self) -> bool:
        """True if a key that moves is held."""
        return not MOVEMENT_KEYS.isdisjoint(self._pressed)

    def release(self) -> None:
        """Forget what is held: its release may never be told, as when the console takes the keys."""
        self._pressed.clear()
        self._pointer = None
        self._fingers = []

    def pushes(self) -> tuple[Floats, Floats]:
        """Return the motion (3,) and the turn (3,) of the keys that are held."""
        fast = FAST_FACTOR if "shift" in self._pressed else 1.0
        push, turn = (
            np.sum([way for key, way in ways.items() if key in self._pressed] or [(0, 0, 0)], axis=0).astype(
                float
            )
            for ways in (_PUSHES, _TURNS)
        )
        return np.clip(push, -1.0, 1.0) * fast, turn

    def handle_key(self, event: Event) -> bool:
        """Note a key that is pressed or released; return whether it is one that moves."""
        key = str(event["key"]).lower()
        if event["event_type"] == "key_down":
            self._pressed.add(key)
        else:
            self._pressed.discard(key)
        return key in MOVEMENT_KEYS

    def is_click(self, event: Event) -> bool:
        """True if a release of the pointer ends a click of the left button: it has hardly moved."""
        return event.get("button") == _LEFT and self._pointer is not None and self._way < _CLICK

    def will_move(self, event: Event) -> bool:
        """True if an event is one that moves the camera: a drag or a turn of the wheel."""
        return event["event_type"] == "wheel" or (
            event["event_type"] == "pointer_move" and self._pointer is not None and bool(event["buttons"])
        )

    def move(self, event: Event, controller: Controller, height: float) -> None:
        """Apply a pointer or wheel event in an image of `height` logical pixels; one with numbers that aren't
        finite is dropped."""
        numbers = [event[name] for name in ("x", "y", "dx", "dy") if name in event]
        if not are_gestures(*numbers):
            return
        height = max(height, 1.0)  # of a window that is minimised
        match event["event_type"]:
            case "wheel":
                controller.zoom(-float(event["dy"]) / _WHEEL)
                if event["dx"]:
                    controller.drag(-float(event["dx"]) / _SIDEWAYS, 0.0)
            case "pointer_down":
                self._pointer, self._way = (float(event["x"]), float(event["y"])), 0.0
            case "pointer_up":
                self._pointer = None
                self._fingers = []
            case "pointer_move":
                self._move_pointer(event, controller, height)

    def _move_pointer(self, event: Event, controller: Controller, height: float) -> None:
        fingers = [(float(touch["x"]), float(touch["y"])) for touch in (event.get("touches") or {}).values()]
        if not all(are_gestures(*finger) for finger in fingers):
            return
        if len(fingers) == 2:
            self._move_fingers(fingers, controller, height)
            return
        self._fingers = []
        if self._pointer is None:
            return
        if not event["buttons"] and not fingers:  # released outside of the window
            self._pointer = None
            return
        x, y = float(event["x"]), float(event["y"])
        right, down = x - self._pointer[0], y - self._pointer[1]
        self._pointer = x, y
        self._way += hypot(right, down)
        if self._way < _CLICK:
            return
        if (_LEFT in event["buttons"] and "Shift" not in event["modifiers"]) or fingers:
            controller.turn(-right / height * controller.angle, -down / height * controller.angle)
        else:
            controller.drag(right / height, -down / height)

    def _move_fingers(
        self, fingers: list[tuple[float, float]], controller: Controller, height: float
    ) -> None:
        before, self._fingers = self._fingers, fingers
        self._pointer = None  # when one finger is lifted, the other doesn't jump
        if len(before) != 2:
            return
        (old, old_way), (new, new_way) = (_span(two) for two in (before, fingers))
        controller.drag((new[0] - old[0]) / height, -(new[1] - old[1]) / height)
        if old_way > 0.0 and new_way > 0.0:
            controller.zoom(log(new_way / old_way) / log(NOTCH))


def _span(two: list[tuple[float, float]]) -> tuple[tuple[float, float], float]:
    """Return the middle between two fingers, and how far they are apart."""
    (x, y), (u, v) = two
    return (0.5 * (x + u), 0.5 * (y + v)), hypot(u - x, v - y)
