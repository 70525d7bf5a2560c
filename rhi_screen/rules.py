"""The rules of screens. A rule is an id (stable: tests compare it), a sentence and a tip."""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

INSTALL: Final = 'pip install "rhi[viewer]"'

SCREEN_MISSING: Final = Rule("screen-missing", "a package that is needed here is not installed", INSTALL)
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

EXECUTOR_NAME: Final = Rule("executor-name", "no executor is called this")
EXECUTOR_MISSING: Final = Rule(
    "executor-missing", "a package that this executor needs is not installed", 'pip install "rhi[dask]"'
)
EXECUTOR_SCHEDULER: Final = Rule(
    "executor-scheduler",
    "no scheduler answers at this address",
    "start one: dask scheduler, and dask worker ADDRESS on each machine",
)
EXECUTOR_ENDED: Final = Rule(
    "executor-ended",
    "a call ended each process that ran it, or no process is left",
    "what others have finished is stored: run the same again; executor serial shows what ends it",
)

FILM_FRAMES: Final = Rule("film-frames", "these are no frames of a film", "such as range(0, 600)")
FILM_OUTPUT: Final = Rule(
    "film-output",
    "a film is written to a video, or to an image for each frame",
    "such as turn.mp4, or turn/%05d.png",
)
FILM_PICKLE: Final = Rule(
    "film-pickle",
    "what draws frames in other processes must be picklable, and on threads copyable",
    "a function of a module, or an object of a class of one; serial takes any",
)
FILM_FRAME: Final = Rule(
    "film-frame", "a frame of a film can't be drawn", "the frames that were finished before are stored"
)
FILM_KILLED: Final = Rule(
    "film-killed",
    "frames of a film end each process that draws them",
    "all others are stored; executor serial shows what ends it",
)
FILM_OTHER: Final = Rule(
    "film-other",
    "the files here are frames of another film, or were drawn with other settings",
    "choose another folder, or delete them",
)
