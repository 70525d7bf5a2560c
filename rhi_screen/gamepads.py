"""Game controllers: what is pressed and how far sticks are pushed, as values and as events.

    def on_button(event):
        if event["button"] == "a":
            jump()

    screen.gamepads.add_handler(on_button, "gamepad_button_down")
    def draw():
        for gamepad in screen.gamepads.poll():
            steer(gamepad.left_stick, gamepad.right_trigger)

Buttons and axes are named as GLFW names those of an Xbox controller, wherever they are on another one. Sticks
are (right, up), each from -1 to 1, and triggers are from 0 to 1. Inside their dead zone they are exactly 0.

In a window, controllers are read before each of its events and draws. On other canvases `source` says where
readings come from, such as `SimulatedGamepads` in tests.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import hypot, isfinite
from typing import Any, Final, Protocol

import numpy as np

from rhi.errors.arguments import ArgumentChecker
from rhi.math import Floats

GamepadEvent = dict[str, Any]
"""An event of a controller. All have `event_type` and `gamepad`, its number. Those of buttons have `button`,
those of axes `axis` and `value`, and `gamepad_connected` has `name`."""

BUTTONS: Final = (
    "a",
    "b",
    "x",
    "y",
    "left_bumper",
    "right_bumper",
    "back",
    "start",
    "guide",
    "left_thumb",
    "right_thumb",
    "dpad_up",
    "dpad_right",
    "dpad_down",
    "dpad_left",
)
"""The names of all buttons, in GLFW's order."""
AXES: Final = ("left_x", "left_y", "right_x", "right_y", "left_trigger", "right_trigger")
"""The names of all axes, in GLFW's order. As values of events, `left_y` and `right_y` are positive upwards."""
EVENT_TYPES: Final = (
    "gamepad_connected",
    "gamepad_disconnected",
    "gamepad_button_down",
    "gamepad_button_up",
    "gamepad_axis",
)
"""The types of events that handlers get."""
DEAD_ZONE: Final = 0.15
"""The default share of an axis in which a stick or trigger counts as at rest."""
_STEP: Final = 1.0 / 256.0  # of an axis: smaller changes are noise


@dataclass(frozen=True, slots=True)
class GamepadReading:
    """A driver's report of a controller, as `glfw.get_gamepad_state` does.

    Attributes:
        name: the controller's name.
        buttons: whether each of `BUTTONS` is pressed.
        axes: each of `AXES`, from -1 to 1: positive to the right and downwards; a trigger at rest is -1.
    """

    name: str
    buttons: tuple[bool, ...] = (False,) * len(BUTTONS)
    axes: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, -1.0, -1.0)


class GamepadSource(Protocol):
    """Where readings come from."""

    def read(self) -> Mapping[int, GamepadReading]:
        """The readings of all connected controllers, by their numbers."""
        ...


@dataclass(frozen=True, slots=True)
class Gamepad:
    """A controller as of the latest poll.

    Attributes:
        number: which one it is, from 0; it stays the same while the controller is connected.
        name: the controller's name.
        left_stick, right_stick: (right, up), each from -1 to 1.
        left_trigger, right_trigger: from 0 to 1.
        buttons: the names of the pressed buttons.
    """

    number: int
    name: str
    left_stick: tuple[float, float] = (0.0, 0.0)
    right_stick: tuple[float, float] = (0.0, 0.0)
    left_trigger: float = 0.0
    right_trigger: float = 0.0
    buttons: frozenset[str] = frozenset()

    @property
    def axes(self) -> dict[str, float]:
        """The value of each of `AXES`."""
        values = (*self.left_stick, *self.right_stick, self.left_trigger, self.right_trigger)
        return dict(zip(AXES, values, strict=True))


class Gamepads:
    """The controllers of a screen.

    Attributes:
        source: where readings come from; None: there are no controllers.
    """

    def __init__(self, source: GamepadSource | None = None, dead_zone: float = DEAD_ZONE) -> None:
        """`dead_zone` is from 0 to less than 1.

        Raises:
            ValidationError: `device-argument`.
        """
        self.source = source
        self._gamepads: dict[int, Gamepad] = {}
        self._handlers: list[tuple[Callable[[GamepadEvent], object], frozenset[str]]] = []
        self.dead_zone = dead_zone

    @property
    def dead_zone(self) -> float:
        """The share of an axis in which a stick or a trigger counts as at rest. Beyond it, values grow from 0.

        Raises:
            ValidationError: `device-argument` for a new one below 0, or of 1 or more.
        """
        return self._dead_zone

    @dead_zone.setter
    def dead_zone(self, dead_zone: float) -> None:
        check = ArgumentChecker("Gamepads(dead_zone=...)")
        value = float(check.number("dead_zone", dead_zone, 0))
        if value >= 1.0:
            check.fail("dead_zone", dead_zone, "0 or more, and less than 1")
        self._dead_zone = value

    def __iter__(self) -> Any:
        """Iterate over the controllers as of the latest poll."""
        return iter(tuple(self._gamepads.values()))

    def __len__(self) -> int:
        return len(self._gamepads)

    def add_handler(self, handler: Callable[[GamepadEvent], object], *event_types: str) -> None:
        """Call `handler` with each event of these types.

        Args:
            handler: a function of an event.
            event_types: of `EVENT_TYPES`; none: all of them.

        Raises:
            ValidationError: `device-argument` for another type.
        """
        for event_type in event_types:
            if event_type not in EVENT_TYPES:
                ArgumentChecker("gamepads.add_handler").fail(
                    "event_types", event_type, ", ".join(EVENT_TYPES)
                )
        self._handlers.append((handler, frozenset(event_types or EVENT_TYPES)))

    def remove_handler(self, handler: Callable[[GamepadEvent], object]) -> None:
        """Don't call `handler` any more."""
        self._handlers = [entry for entry in self._handlers if entry[0] != handler]

    def poll(self) -> tuple[Gamepad, ...]:
        """Read all controllers, hand out the events of what has changed, and return the controllers.

        What a controller that goes away has pressed is released before."""
        readings = {} if self.source is None else self.source.read()
        events: list[GamepadEvent] = []
        for number, gamepad in list(self._gamepads.items()):
            if number not in readings or readings[number].name != gamepad.name:
                events += _list_changes(gamepad, Gamepad(number, gamepad.name))
                events.append({"event_type": "gamepad_disconnected", "gamepad": number})
                del self._gamepads[number]
        for number, reading in sorted(readings.items()):
            before = self._gamepads.get(number)
            if before is None:
                before = Gamepad(number, reading.name)
                events.append({"event_type": "gamepad_connected", "gamepad": number, "name": reading.name})
            self._gamepads[number] = gamepad = _steady(before, interpret(number, reading, self._dead_zone))
            events += _list_changes(before, gamepad)
        for event in events:
            for handler, event_types in tuple(self._handlers):
                if event["event_type"] in event_types:
                    handler(event)
        return tuple(self._gamepads.values())

    @property
    def is_pushed(self) -> bool:
        """True if a stick or trigger that moves a camera isn't at rest."""
        return any(any(gamepad.axes.values()) for gamepad in self)

    def motion(self) -> tuple[Floats, Floats]:
        """The motion of a camera that controllers ask for: push (3,) and turn (3,), as of `Controller.advance`.

        The left stick pushes sideways and ahead, the right trigger up, the left one down, and the right stick
        turns.
        """
        push, turn = np.zeros(3), np.zeros(3)
        for gamepad in self:
            right, ahead = gamepad.left_stick
            push += (right, gamepad.right_trigger - gamepad.left_trigger, -ahead)
            turn += (-gamepad.right_stick[0], gamepad.right_stick[1], 0.0)
        return np.clip(push, -1.0, 1.0), np.clip(turn, -1.0, 1.0)


@dataclass(slots=True)
class SimulatedGamepads:
    """A source of readings that a program sets: for tests, and for replays.

    pads = screen.gamepads.source = SimulatedGamepads()
    pads.set(0, left_x=1.0, buttons=("a",))
    """

    readings: dict[int, GamepadReading] = field(default_factory=dict)

    def read(self) -> Mapping[int, GamepadReading]:
        """The readings as they are set."""
        return dict(self.readings)

    def set(self, number: int = 0, *, name: str = "simulated", buttons: Any = (), **axes: float) -> None:
        """Connect a controller, or replace what it reports.

        Args:
            number: which controller.
            name: the controller's name.
            buttons: the names of the pressed buttons.
            axes: of `AXES`, as events have them: up is positive, and a trigger is from 0 to 1.

        Raises:
            ValidationError: `device-argument` for other names.
        """
        check = ArgumentChecker("SimulatedGamepads.set")
        for word in (*buttons, *axes):
            if word not in (AXES if word in axes else BUTTONS):
                check.fail("name", word, ", ".join((*BUTTONS, *AXES)))
        values = {axis: float(axes.get(axis, 0.0)) for axis in AXES}
        raw = (
            values["left_x"],
            -values["left_y"],
            values["right_x"],
            -values["right_y"],
            2.0 * values["left_trigger"] - 1.0,
            2.0 * values["right_trigger"] - 1.0,
        )
        self.readings[number] = GamepadReading(name, tuple(button in buttons for button in BUTTONS), raw)

    def remove(self, number: int = 0) -> None:
        """Disconnect a controller."""
        self.readings.pop(number, None)


def interpret(number: int, reading: GamepadReading, dead_zone: float) -> Gamepad:
    """The controller of a reading. Numbers that aren't finite count as at rest, and others end at 1."""
    x, y, turn_x, turn_y, *triggers = (value if isfinite(value) else None for value in reading.axes)
    pressed = (button for button, is_down in zip(BUTTONS, reading.buttons, strict=False) if is_down)
    left, right = (
        _cut(0.5 * (1.0 + min(max(-1.0 if value is None else value, -1.0), 1.0)), dead_zone)
        for value in triggers
    )
    return Gamepad(
        number,
        reading.name,
        _cut_stick(x or 0.0, -(y or 0.0), dead_zone),
        _cut_stick(turn_x or 0.0, -(turn_y or 0.0), dead_zone),
        left,
        right,
        frozenset(pressed),
    )


def _cut(value: float, dead_zone: float) -> float:
    """A value from 0 to 1 that begins to grow at the end of the dead zone."""
    return max(min(value, 1.0) - dead_zone, 0.0) / (1.0 - dead_zone)


def _cut_stick(right: float, up: float, dead_zone: float) -> tuple[float, float]:
    """A stick outside of a round dead zone: its direction stays, so it can be pushed along any line."""
    right, up = min(max(right, -1.0), 1.0), min(max(up, -1.0), 1.0)
    length = hypot(right, up)
    if length <= dead_zone:
        return 0.0, 0.0
    scale = _cut(length, dead_zone) / length
    return right * scale, up * scale


def _steady(before: Gamepad, after: Gamepad) -> Gamepad:
    """The later state, but the earlier one if nothing has changed by more than noise."""
    moved = any(
        abs(value - before.axes[axis]) >= _STEP or (value == 0.0) != (before.axes[axis] == 0.0)
        for axis, value in after.axes.items()
    )
    return after if moved or after.buttons != before.buttons else before


def _list_changes(before: Gamepad, after: Gamepad) -> list[GamepadEvent]:
    """The events between two states of a controller: releases, presses, then axes."""
    number = after.number
    events: list[GamepadEvent] = []
    for event_type, changed in (
        ("gamepad_button_up", before.buttons - after.buttons),
        ("gamepad_button_down", after.buttons - before.buttons),
    ):
        events += [
            {"event_type": event_type, "gamepad": number, "button": button}
            for button in BUTTONS
            if button in changed
        ]
    events += [
        {"event_type": "gamepad_axis", "gamepad": number, "axis": axis, "value": value}
        for axis, value in after.axes.items()
        if value != before.axes[axis]
    ]
    return events
