"""`demo`: measure several variants to render a scene along its paths, and write images made by the fastest
device.

  python -m renderer demo
  python -m renderer demo hall --output images
  python -m renderer demo city:blocks=12 --frames 20

All backends that work here are compared, or only the one that RHI_BACKEND names; the fastest writes the
images. The frames are spread evenly along each path, and each is rendered in all ways in turn. Times are
medians, until the GPU is finished. `vs none` is the median of the frames' ratios to no culling. Counters are
means per frame. The null device records the same commands and draws nothing: its time is that of the CPU.
`kernels` says which kernels cl ran: those of a first run are `quick` ones, unless RHI_KERNELS=optimised.
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
from renderer.cli.output import (
    note,
    open_available_devices,
    prepare_image,
    short_name,
    show_progress,
    write_image,
)
from renderer.cli.subcommand import Subcommand
from renderer.lab.comparison import Column, Frames, Subject, average, compare, ratio, time
from renderer.lab.measure import format_rows
from renderer.renderer import FrameStatistics, Renderer
from renderer.scene import FRAME_COUNT, Scene
from rhi.errors.output_paths import check_output_file

_IMAGE_FRAMES = {"ground": 900, "sky": 700}
"""The frame of each path that is written as an image."""

_ALGORITHMS = ("none", "frustum")
"""The algorithms compared: those that also run on the null device, which answers no queries. `compare
visibility` compares all."""


_IDLE = ("simulation_steps", "skipped_simulations")
"""Counters that are always 0 if nothing is simulated."""


_OPTIONS: Final = (
    option("scene", "a scene generator (see `scenes`) or a model file", "city", nargs="?", metavar="SCENE"),
    options.output_folder("--output", "folder for the images", "out"),
    options.frames(9, "number of frames of each path"),
    options.size(what="size of the images in pixels"),
)


def _run(arguments: argparse.Namespace) -> None:
    scene = open_scene(arguments.scene)
    for name in scene.paths:
        check_output_file(_image_path(scene, name, arguments.output), "--output")
    with ExitStack() as stack:
        devices = open_devices(stack)
        numbers = [
            (2 * number + 1) * FRAME_COUNT // (2 * arguments.frames) for number in range(arguments.frames)
        ]
        subjects, variants = [], []
        for name, path in scene.paths.items():
            for device in devices:
                for algorithm in _ALGORITHMS:
                    renderer = stack.enter_context(
                        Renderer(device, scene, visibility=algorithm, size=arguments.size)
                    )
                    frames = Frames(renderer, *map(path.path_frame, numbers))
                    labels = {"path": name, "visibility": algorithm, "backend": device.backend_name}
                    subjects.append(Subject(labels, frames, count=frames.count))
                    variants.append(frames)
        is_simulated = bool(len(renderer.simulator))
        columns: dict[str, Column] = {"milliseconds": time(), "vs none": ratio()}
        for counter in fields(FrameStatistics):
            if is_simulated or counter.name not in _IDLE:
                columns[counter.name] = average()
        rounds = show_progress(range(arguments.frames), "measure")
        rows = compare(subjects, columns, rounds, group_by=("path", "backend"))
        for name in scene.paths:
            seen = [
                (row["milliseconds"], number)
                for number, row in enumerate(rows)
                if row["path"] == name and variants[number].renderer.device.capabilities.renders
            ]
            if seen:
                write_path_image(variants[min(seen)[1]].renderer, name, arguments.output)
        if not any(device.capabilities.renders for device in devices):
            note(f"the {devices[0].backend_name} device records and draws nothing: there is no image")
        print(format_rows(rows))


def open_devices(stack: ExitStack) -> list[rhi.Device]:
    """Open the device that RHI_BACKEND names, or one on each backend that works here; the null device is the
    last."""
    backend = os.environ.get("RHI_BACKEND")
    devices = open_available_devices(stack, (backend,) if backend else rhi.backend_names())
    if all(device.backend_name != "null" for device in devices):
        devices.append(stack.enter_context(rhi.create_device("null")))
    return devices


def write_path_image(renderer: Renderer, name: str, folder: Path) -> None:
    """Write one image of the scene's path with this name."""
    scene = renderer.scene
    path_frame = scene.paths[name].path_frame(_IMAGE_FRAMES.get(name, FRAME_COUNT // 2))
    result = renderer.render(path_frame.camera, path_frame.seconds)
    path = prepare_image(_image_path(scene, name, folder))
    write_image(path, result.image.read())
    note(f"wrote {path}, drawn by {renderer.device.backend_name}")


def _image_path(scene: Scene, name: str, folder: Path) -> Path:
    """The file of the image of the scene's path with this name."""
    suffix = "" if name == next(iter(scene.paths)) else f"-{name}"
    return folder / f"{short_name(scene)}{suffix}.png"


COMMAND: Final = Subcommand(
    "demo",
    "render a scene along its paths in several ways and print what each costs",
    _OPTIONS,
    _run,
    __doc__,
)
