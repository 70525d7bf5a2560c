"""`demo`: measure several variants to render a scene along its paths, and write pictures made by the fastest device.

  python -m renderer demo
  python -m renderer demo hall --output pictures
  python -m renderer demo city:blocks=12 --frames 20

All backends that work here are compared, or only the one that RHI_BACKEND names; the fastest writes the pictures.
The frames are spread evenly along each path, and each is rendered in all ways in turn. Times are medians, until the
GPU is finished. `vs none` is the median of the frames' ratios to no culling. Counters are means per frame. The null
device records the same commands and draws nothing: its time is that of the CPU. `kernels` says which kernels cl ran:
those of a first run are `quick` ones, unless RHI_KERNELS=optimised.
"""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from dataclasses import fields
from pathlib import Path
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.options import option
from renderer.cli.output import name_of, note, open_working, prepare_image, show_progress, write_image
from renderer.cli.subcommand import Subcommand
from renderer.lab.comparison import Column, Frames, Subject, average, compare, ratio, time
from renderer.lab.measure import format_rows
from renderer.renderer import FrameStatistics, Renderer
from renderer.scene import FRAME_COUNT

_PICTURED = {"ground": 900, "sky": 700}
"""The frame of each path that is written as a picture."""

_ALGORITHMS = ("none", "frustum")
"""The algorithms compared: those that also run on the null device, which answers no queries. `compare visibility`
compares all."""


_IDLE = ("simulation_steps", "skipped_simulations")
"""The counters that say nothing where nothing is simulated."""


_OPTIONS: Final = (
    option("scene", "a scene generator (see `scenes`) or a model file", "city", nargs="?", metavar="SCENE"),
    options.file("--output", "folder for the pictures", "DIR", "out"),
    options.frames(9, "number of frames of each path"),
    options.size(what="size of the images in pixels"),
)


def _run(given: argparse.Namespace) -> None:
    scene = open_scene(given.scene)
    with ExitStack() as stack:
        devices = open_devices(stack)
        numbers = [(2 * number + 1) * FRAME_COUNT // (2 * given.frames) for number in range(given.frames)]
        subjects, variants = [], []
        for name, path in scene.paths.items():
            for device in devices:
                for algorithm in _ALGORITHMS:
                    renderer = stack.enter_context(Renderer(device, scene, visibility=algorithm, size=given.size))
                    frames = Frames(renderer, *map(path.shot, numbers))
                    about = {"path": name, "visibility": algorithm, "backend": device.backend_name}
                    subjects.append(Subject(about, frames, count=frames.count))
                    variants.append(frames)
        is_simulated = bool(len(renderer.simulator))
        columns: dict[str, Column] = {"milliseconds": time(), "vs none": ratio()}
        for counter in fields(FrameStatistics):
            if is_simulated or counter.name not in _IDLE:
                columns[counter.name] = average()
        rounds = show_progress(range(given.frames), "measure")
        rows = compare(subjects, columns, rounds, within=("path", "backend"))
        for name in scene.paths:
            seen = [
                (row["milliseconds"], number)
                for number, row in enumerate(rows)
                if row["path"] == name and variants[number].renderer.device.capabilities.renders
            ]
            if seen:
                write_picture(variants[min(seen)[1]].renderer, name, given.output)
        if not any(device.capabilities.renders for device in devices):
            note(f"the {devices[0].backend_name} device records and draws nothing: there is no image")
        print(format_rows(rows))


def open_devices(stack: ExitStack) -> list[rhi.Device]:
    """Open the device that RHI_BACKEND names, or one on each backend that works here; the null device is the last."""
    chosen = os.environ.get("RHI_BACKEND")
    devices = open_working(stack, (chosen,) if chosen else rhi.backend_names())
    if all(device.backend_name != "null" for device in devices):
        devices.append(stack.enter_context(rhi.create_device("null")))
    return devices


def write_picture(renderer: Renderer, name: str, folder: Path) -> None:
    """Write one picture of the scene's path with this name."""
    scene = renderer.scene
    suffix = "" if name == next(iter(scene.paths)) else f"-{name}"
    shot = scene.paths[name].shot(_PICTURED.get(name, FRAME_COUNT // 2))
    result = renderer.render(shot.camera, shot.seconds)
    path = prepare_image(folder / f"{name_of(scene)}{suffix}.png")
    write_image(path, result.image.read())
    note(f"wrote {path}, drawn by {renderer.device.backend_name}")


COMMAND: Final = Subcommand(
    "demo", "render a scene along its paths in several ways and print what each costs", _OPTIONS, _run, __doc__
)
