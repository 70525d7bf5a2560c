"""The controllers that GLFW knows: those of its database of mappings, and of `SDL_GAMECONTROLLERCONFIG`."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Final

import glfw

from rhi_screen.gamepads import GamepadReading

MAPPINGS: Final = "SDL_GAMECONTROLLERCONFIG"
"""The environment variable with further mappings, a line each, as SDL reads them."""


class GlfwGamepads:
    """Reads controllers on the thread of windows; GLFW must have been initialised."""

    def __init__(self) -> None:
        mappings = os.environ.get(MAPPINGS, "")
        if mappings:
            glfw.update_gamepad_mappings(mappings)

    def read(self) -> Mapping[int, GamepadReading]:
        """The readings of all connected controllers that have a mapping."""
        readings = {}
        for number in range(glfw.JOYSTICK_LAST + 1):
            if not glfw.joystick_present(number) or not glfw.joystick_is_gamepad(number):
                continue
            state = glfw.get_gamepad_state(number)
            if state is not None:
                buttons, axes = state
                readings[number] = GamepadReading(
                    glfw.get_gamepad_name(number) or "",
                    tuple(bool(button) for button in buttons),
                    tuple(float(axis) for axis in axes),
                )
        return readings
