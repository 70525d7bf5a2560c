"""The keys of a viewer: each runs a line, as it could be typed in the console."""

from __future__ import annotations

from typing import Final

from renderer.scene import Scene

KEY_BINDINGS: Final[dict[str, tuple[str, str]]] = {
    "F1": ("keys", "what the keys do"),
    "F2": ("console", "the console; Tab completes, arrows up and down recall"),
    "`": ("console", ""),
    "F3": ("panel", "a panel: settings, scene, statistics, times"),
    "F11": ("fullscreen", "fill the display, or go back to the window"),
    "c": ("drive next", "fly or orbit"),
    "+": ("speed faster", "faster"),
    "-": ("speed slower", "slower"),
    "t": ("technique next", "the next technique"),
    "v": ("visibility next", "the next visibility algorithm"),
    "b": ("show next", "the next buffer or image of the frame"),
    "n": ("show image", "the lit image again"),
    "h": ("shadows next", "the shadows of the scene, of all lights, none"),
    "x": ("fxaa", "smooth edges"),
    "y": ("stereo next", "the next way to show two eyes, or one"),
    "u": ("particles", "the particles of fountains"),
    "o": ("overlay", "the overlay: times, counters, culling"),
    "i": ("pick", "pick what is under the pointer, as a click does"),
    "Escape": ("clear", "forget what was picked, hide the keys"),
    " ": ("pause", "pause the scene's time, or resume it"),
    "r": ("record", "begin or end a recording of the camera"),
    "p": ("play", "show the latest recording"),
    "F12": ("screenshot", "write the image to a file"),
}
"""By the key's name in events: the line that it runs, and what it does, empty if it does as the key
before."""

MOTION: Final = (
    ("W A S D, Q E, PgUp PgDn", "ahead, left, back, right, down, up; fast with Shift"),
    ("arrows, left button", "turn"),
    ("right or middle button", "drag sideways and up"),
    ("wheel, pinch, two fingers", "nearer and farther; in orbit, closer"),
    ("controller: sticks, triggers", "move, turn, down and up; LB RB slower and faster"),
)
"""The keys and gestures that move the camera, and what they do."""


GAMEPAD_BINDINGS: Final[dict[str, tuple[str, str]]] = {
    "left_bumper": ("speed slower", "slower"),
    "right_bumper": ("speed faster", "faster"),
    "a": ("pick", "pick what is in the middle of the image"),
    "b": ("clear", "forget what was picked, hide the keys"),
    "x": ("technique next", "the next technique"),
    "y": ("show next", "the next buffer or image of the frame"),
    "start": ("pause", "pause the scene's time, or resume it"),
    "back": ("keys", "what the keys do"),
    "left_thumb": ("drive next", "fly or orbit"),
    "right_thumb": ("fullscreen", "fill the display, or go back to the window"),
    "dpad_up": ("overlay", "the overlay"),
    "dpad_right": ("visibility next", "the next visibility algorithm"),
    "dpad_down": ("panel", "the panel"),
    "dpad_left": ("shadows next", "the shadows of the scene, of all lights, none"),
}
"""By a controller's button: the line that it runs, and what it does. Sticks and triggers move the camera."""


def list_cameras(scene: Scene) -> list[str]:
    """Return the lines of the keys 1 to 9: the scene's views, then its paths."""
    views = [f"camera {name}" for name in scene.views]
    return [*views, *(f"play {name}" for name in scene.paths)][:9]


def command_for_key(scene: Scene, key: str) -> str:
    """Return the line that a key runs, empty if there is none. Letters run the same with Shift."""
    cameras = list_cameras(scene)
    if key.isdigit() and key.isascii() and 1 <= int(key) <= len(cameras):
        return cameras[int(key) - 1]
    return KEY_BINDINGS.get(key.lower() if len(key) == 1 else key, ("", ""))[0]


def list_key_bindings(scene: Scene) -> list[tuple[str, str]]:
    """Return all keys and what they do, for people."""
    names = {" ": "Space", "`": ""}
    keys = [
        (names.get(key, key.upper() if len(key) == 1 else key), text)
        for key, (_, text) in KEY_BINDINGS.items()
        if text
    ]
    cameras = list_cameras(scene)
    words = ", ".join(line.partition(" ")[2] for line in cameras)
    return [*MOTION, (f"1 to {len(cameras)}", f"cameras: {words}"), *keys]
