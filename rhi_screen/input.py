"""The input of a GLFW window as rendercanvas's events.

Keys are named as on the web (`KeyboardEvent.key`), in the user's keyboard layout: "a", "ArrowUp", "Shift".
Positions are logical pixels from the top left.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Final

import glfw

Event = dict[str, Any]

KEYS: Final = {
    glfw.KEY_DOWN: "ArrowDown",
    glfw.KEY_UP: "ArrowUp",
    glfw.KEY_LEFT: "ArrowLeft",
    glfw.KEY_RIGHT: "ArrowRight",
    glfw.KEY_BACKSPACE: "Backspace",
    glfw.KEY_CAPS_LOCK: "CapsLock",
    glfw.KEY_DELETE: "Delete",
    glfw.KEY_END: "End",
    glfw.KEY_ENTER: "Enter",
    glfw.KEY_KP_ENTER: "Enter",
    glfw.KEY_ESCAPE: "Escape",
    glfw.KEY_HOME: "Home",
    glfw.KEY_INSERT: "Insert",
    glfw.KEY_MENU: "ContextMenu",
    glfw.KEY_NUM_LOCK: "NumLock",
    glfw.KEY_PAGE_DOWN: "PageDown",
    glfw.KEY_PAGE_UP: "PageUp",
    glfw.KEY_PAUSE: "Pause",
    glfw.KEY_PRINT_SCREEN: "PrintScreen",
    glfw.KEY_SCROLL_LOCK: "ScrollLock",
    glfw.KEY_SPACE: " ",
    glfw.KEY_TAB: "Tab",
    glfw.KEY_LEFT_ALT: "Alt",
    glfw.KEY_RIGHT_ALT: "Alt",
    glfw.KEY_LEFT_CONTROL: "Control",
    glfw.KEY_RIGHT_CONTROL: "Control",
    glfw.KEY_LEFT_SHIFT: "Shift",
    glfw.KEY_RIGHT_SHIFT: "Shift",
    glfw.KEY_LEFT_SUPER: "Meta",
    glfw.KEY_RIGHT_SUPER: "Meta",
    **{glfw.KEY_F1 + number: f"F{number + 1}" for number in range(25)},
}
MODIFIERS: Final = ("Alt", "Control", "Meta", "Shift")
BUTTONS: Final = {glfw.MOUSE_BUTTON_LEFT: 1, glfw.MOUSE_BUTTON_RIGHT: 2, glfw.MOUSE_BUTTON_MIDDLE: 3}
"""Numbers of buttons as rendercanvas has them; all others are GLFW's plus 1."""
WHEEL_STEP: Final = 100.0
"""Pixels that a notch of a wheel scrolls, as in browsers."""
DOUBLE_SECONDS: Final = 0.3
DOUBLE_PIXELS: Final = 5.0


class WindowInput:
    """Turns what GLFW reports of a window into events.

    The pointer's events outside of the window are those of a drag that began in it.
    """

    def __init__(self, window: Any, submit: Callable[[Event], None], pixel: Callable[[], float]) -> None:
        """Report events of `window` to `submit`; `pixel`: logical pixels in a unit of the window's
        coordinates."""
        self._submit = submit
        self._pixel = pixel
        self._pressed: set[str] = set()
        self._buttons: set[int] = set()
        self._position = (0.0, 0.0)
        self._inside = False
        self._press = (0, 0.0, 0.0, 0.0)
        """The last press that may begin a double click: button, time, x, y."""
        glfw.set_key_callback(window, self._on_key)
        glfw.set_char_callback(window, self._on_char)
        glfw.set_mouse_button_callback(window, self._on_button)
        glfw.set_cursor_pos_callback(window, self._on_move)
        glfw.set_cursor_enter_callback(window, self._on_enter)
        glfw.set_scroll_callback(window, self._on_scroll)

    @property
    def _modifiers(self) -> tuple[str, ...]:
        return tuple(name for name in MODIFIERS if name in self._pressed)

    def _pointer(self, kind: str, button: int = 0) -> Event:
        return {
            "event_type": kind,
            "x": self._position[0],
            "y": self._position[1],
            "button": button,
            "buttons": tuple(sorted(self._buttons)),
            "modifiers": self._modifiers,
            "ntouches": 0,
            "touches": {},
        }

    def _on_key(self, _window: Any, key: int, scancode: int, action: int, _mods: int) -> None:
        if action == glfw.REPEAT:
            return
        name = KEYS.get(key) or glfw.get_key_name(key, scancode)
        if not name:
            return
        if name in MODIFIERS:
            (self._pressed.add if action == glfw.PRESS else self._pressed.discard)(name)
        elif "Shift" in self._pressed and len(name) == 1:
            name = name.upper()
        kind = "key_down" if action == glfw.PRESS else "key_up"
        self._submit({"event_type": kind, "key": name, "modifiers": self._modifiers})

    def _on_char(self, _window: Any, codepoint: int) -> None:
        text = chr(codepoint)
        self._submit({"event_type": "char", "data": text, "char_str": text, "modifiers": self._modifiers})

    def _on_button(self, window: Any, number: int, action: int, _mods: int) -> None:
        self._on_move(window, *glfw.get_cursor_pos(window), moved=False)
        button = BUTTONS.get(number, number + 1)
        if action == glfw.RELEASE:
            self._buttons.discard(button)
            self._submit(self._pointer("pointer_up", button))
            return
        self._buttons.add(button)
        self._submit(self._pointer("pointer_down", button))
        last, then, x, y = self._press
        now = time.perf_counter()
        near = abs(self._position[0] - x) + abs(self._position[1] - y) <= DOUBLE_PIXELS
        if button == last and now - then <= DOUBLE_SECONDS and near:
            self._press = (0, 0.0, 0.0, 0.0)  # a third press begins another double click
            self._submit(self._pointer("double_click", button))
        else:
            self._press = (button, now, *self._position)

    def _on_move(self, _window: Any, x: float, y: float, moved: bool = True) -> None:
        pixel = self._pixel()
        self._position = (x * pixel, y * pixel)
        if moved and (self._inside or self._buttons):
            self._submit(self._pointer("pointer_move"))

    def _on_enter(self, _window: Any, entered: int) -> None:
        self._inside = bool(entered)
        self._submit({"event_type": "pointer_enter" if entered else "pointer_leave"})

    def _on_scroll(self, window: Any, dx: float, dy: float) -> None:
        self._on_move(window, *glfw.get_cursor_pos(window), moved=False)
        wheel = self._pointer("wheel")
        self._submit(
            {name: wheel[name] for name in ("event_type", "x", "y", "buttons", "modifiers")}
            | {"dx": WHEEL_STEP * dx, "dy": -WHEEL_STEP * dy}
        )
