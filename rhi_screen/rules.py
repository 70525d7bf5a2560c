"""The rules of screens. A rule is an id (stable: tests compare it), a sentence and a tip."""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

INSTALL: Final = 'pip install "rhi[viewer]"'

SCREEN_MISSING: Final = Rule("screen-missing", "a package that this canvas needs is not installed", INSTALL)
SCREEN_DISPLAY: Final = Rule(
    "screen-display",
    "no window can be opened here",
    'set DISPLAY or WAYLAND_DISPLAY, or use a canvas that needs no display: "page", "jupyter", "offscreen"',
)
SCREEN_DRIVER: Final = Rule(
    "screen-driver", "no window with OpenGL can be opened", "on Debian: apt install libegl1 libgl1-mesa-dri"
)
SCREEN_CANVAS: Final = Rule("screen-canvas", "there is no canvas of this name")
SCREEN_IMAGE: Final = Rule(
    "screen-image", "a screen shows images of 8-bit colors", "draw or blit to an RGBA8 texture first"
)
SCREEN_ERRORS: Final = Rule("screen-errors", "a screen either raises the errors of its draws or logs them")
SCREEN_WINDOW: Final = Rule("screen-window", "only a window supports this", 'canvas="window" opens one')
VIDEO_FILE: Final = Rule("video-file", "the file can't be written as a video", "name it .mp4 or .webm")
VIDEO_IMAGE: Final = Rule("video-image", "this array can't be a frame of a video")
VIDEO_SIZE: Final = Rule("video-size", "all frames of a video must have the same size")
