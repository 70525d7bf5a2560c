"""Cameras that the events of a screen move: around a point, or freely.

    camera = OrbitCamera(screen, target=(0, 1, 0), distance=5)
    def draw():
        seen = camera.update()                       # a rhi.math.Camera of the screen's proportions
        device.draw(program, mesh, camera=Camera(view_projection=seen.view_projection))

Left button or one finger: turn. Right button, or left with Shift: drag. Wheel or two fingers: zoom. W A S D Q
E and the arrows move as long as they are held, faster with Shift. Of a game controller the left stick and
the triggers move, the right stick turns, and the bumpers change the speed. What a handler before them has
stopped (`event["stop_propagation"]`), as widgets do, doesn't move a camera.
"""

from __future__ import annotations

from math import cos, inf, isfinite, sin
from time import perf_counter
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from rhi.errors.rules import CAMERA_VALUE
from rhi.math import Camera, Orthographic, Perspective
from rhi.math.arguments import check_camera, check_real, read_floats
from rhi_screen.controllers import FAST_FACTOR, Controller, Fly, Orbit
from rhi_screen.gamepads import GamepadEvent
from rhi_screen.gestures import Event, Gestures
from rhi_screen.screen import Screen

MAX_STEP: Final = 0.25
"""Seconds by which an update moves a camera at most, however long the frame took."""
SPEED_STEPS: Final = {"right_bumper": 1.5, "left_bumper": 1.0 / 1.5}
"""The factors by which these buttons change a camera's speed."""
_MIN_SPEED, _MAX_SPEED = 1e-6, 1e9  # metres a second that buttons reach
_EVENTS: Final = ("pointer_down", "pointer_up", "pointer_move", "wheel", "key_down", "key_up")


class ScreenCamera:
    """A controller that a screen's events move.

    Attributes:
        controller: what moves: its `camera` has the place, its `speed` is that of keys, in metres a second.
        is_enabled: whether events move it.
    """

    def __init__(self, screen: Screen, controller: Controller) -> None:
        self.controller = controller
        self.is_enabled = True
        self._screen = screen
        self._gestures = Gestures()
        self._time: float | None = None
        self._listener = self._handle  # one object: handlers are found by identity
        self._gamepad_listener = self._handle_gamepad
        screen.canvas.add_event_handler(self._listener, *_EVENTS)
        screen.gamepads.add_handler(self._gamepad_listener, "gamepad_button_down", "gamepad_axis")

    @property
    def camera(self) -> Camera:
        """The camera as of now, with the proportions of the screen."""
        width, height = self._screen.size
        return self.controller.camera.with_aspect(width / height)

    def update(self, seconds: float | None = None) -> Camera:
        """Move by the keys that are held and the controllers' sticks, and return the camera: call it once a
        frame.

        Args:
            seconds: the time since the last update; None: as a clock says.
        """
        now = perf_counter()
        past = 0.0 if self._time is None else now - self._time
        step = min(past, MAX_STEP) if seconds is None else float(seconds)
        gamepads = self._screen.gamepads
        gamepads.poll()
        is_pushed = gamepads.is_pushed and self.is_enabled
        is_moving = self._gestures.has_pressed_keys or is_pushed or self.controller.is_moving
        self._time = now if is_moving else None
        if is_moving:
            push, turn = self._gestures.pushes()
            if is_pushed:
                more_push, more_turn = gamepads.motion()
                push = np.clip(push + more_push, -FAST_FACTOR, FAST_FACTOR)
                turn = np.clip(turn + more_turn, -1.0, 1.0)
            self.controller.advance(push, turn, step)
            self._screen.canvas.request_draw()
        return self.camera

    def close(self) -> None:
        """Listen to no more events."""
        self._screen.canvas.remove_event_handler(self._listener, *_EVENTS)
        self._screen.gamepads.remove_handler(self._gamepad_listener)

    def _handle_gamepad(self, event: GamepadEvent) -> None:
        if not self.is_enabled:
            return
        factor = SPEED_STEPS.get(event.get("button", ""))
        if factor is not None:
            self.controller.speed = change_speed(self.controller.speed, factor)
        elif event["event_type"] == "gamepad_axis":
            self._time = self._time or perf_counter()
            self._screen.canvas.request_draw()

    def _handle(self, event: Event) -> None:
        if not self.is_enabled:
            self._gestures.release()
        elif event["event_type"].startswith("key"):
            if self._gestures.handle_key(event):
                self._time = self._time or perf_counter()
                self._screen.canvas.request_draw()
        else:
            moves = self._gestures.will_move(event)
            self._gestures.move(event, self.controller, self._screen.canvas.get_logical_size()[1])
            if moves:
                self._screen.canvas.request_draw()


def change_speed(speed: float, factor: float) -> float:
    """A speed that was multiplied, between a micrometre and a million kilometres a second."""
    return min(max(speed * factor, _MIN_SPEED), _MAX_SPEED)


class OrbitCamera(ScreenCamera):
    """A camera that circles a point."""

    def __init__(
        self,
        screen: Screen,
        target: ArrayLike = (0.0, 0.0, 0.0),
        distance: float = 5.0,
        yaw: float = 0.5,
        pitch: float = 0.4,
        *,
        projection: Perspective | Orthographic | None = None,
    ) -> None:
        """
        Args:
            screen: whose events move it.
            target: (3,), the point in the middle.
            distance, yaw, pitch: where the camera is, as of `rhi.math.orbit`.
            projection: the projection; None: `Perspective()`.

        Raises:
            ValidationError: `camera-bad-value` for numbers that aren't finite, and a distance that isn't
                above 0.
        """
        check_real("OrbitCamera", distance=distance, yaw=yaw, pitch=pitch)
        middle = read_floats("OrbitCamera(target=...)", target, 3, rule=CAMERA_VALUE)
        check_camera("OrbitCamera(distance=...)", distance, 0.0 < distance < inf, "above 0, finite")
        check_camera("OrbitCamera(yaw=...)", yaw, isfinite(yaw), "finite")
        check_camera("OrbitCamera(pitch=...)", pitch, isfinite(pitch), "finite")
        away = distance * np.array([sin(yaw) * cos(pitch), sin(pitch), cos(yaw) * cos(pitch)])
        begin = Camera.look_at(middle + away, middle, projection=projection)
        super().__init__(screen, Orbit(begin, middle, distance))


class FlyCamera(ScreenCamera):
    """A camera that flies freely."""

    def __init__(
        self,
        screen: Screen,
        position: ArrayLike = (0.0, 0.0, 5.0),
        target: ArrayLike = (0.0, 0.0, 0.0),
        *,
        speed: float = 3.0,
        projection: Perspective | Orthographic | None = None,
    ) -> None:
        """
        Args:
            screen: whose events move it.
            position, target: (3,), where it is, and what it looks at.
            speed: metres a second, by keys.
            projection: the projection; None: `Perspective()`.
        """
        super().__init__(screen, Fly(Camera.look_at(position, target, projection=projection), speed))
