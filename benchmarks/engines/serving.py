"""Code that the programs of `benchmarks/engines.py` share: each draws a model on request.

They run in environments of their own, so this imports no more than NumPy. The job is the first argument, as
JSON. On the standard input a line `frame` asks for a frame, and `end FILE` for its image as bytes, rows of
RGB from the top; each is answered by a line of JSON. What engines print goes to the standard error.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypedDict

import numpy as np


class Job(TypedDict):
    """A model to draw: its `path`, at `width` × `height` pixels, from `eye` along `ahead` (3,) with y
    upwards, by a projection of `fov` degrees bottom to top that sees from `near` to `far` metres, before
    `background` (3,), linear, with the light `ambient` (3,), linear, from everywhere; `sun` (3,) is the hue
    of directional light, and `engine` the row's name."""

    engine: str
    path: str
    width: int
    height: int
    eye: list[float]
    ahead: list[float]
    fov: float
    near: float
    far: float
    background: list[float]
    ambient: list[float]
    sun: list[float]


def serve(load: Callable[[Job], tuple[str, Callable[[], Any]]]) -> None:
    """Load, then draw as often as asked for.

    Args:
        load: makes what a job needs; returns what draws, and the function that draws a frame and returns its
            image (h, w, 3 or more) as bytes, top row first, or a function that returns the image and the
            MiB that its process holds, by the names of their kinds.
    """
    answers = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    device, draw = load(json.loads(sys.argv[1]))
    print(json.dumps({"device": device}), file=answers)
    for line in sys.stdin:
        order, _, file = line.strip().partition(" ")
        image = draw()
        figures: dict[str, float] = {}
        if order == "end":
            status = Path("/proc/self/status").read_text(encoding="utf-8")
            figures["memory"] = float(status.partition("VmHWM:")[2].split()[0]) / 1024.0
            if callable(image):  # of another process
                image, parts = image()
                figures |= {"memory": sum(parts.values()), **parts}
            Path(file).write_bytes(np.ascontiguousarray(image[..., :3]).tobytes())
        print(json.dumps(figures), file=answers)


def encode(linear: list[float]) -> list[float]:
    """Return a linear colour as sRGB, for engines that take colours so."""
    return [12.92 * x if x <= 0.0031308 else 1.055 * x ** (1 / 2.4) - 0.055 for x in linear]
