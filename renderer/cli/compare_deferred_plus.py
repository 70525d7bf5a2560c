"""`compare deferred-plus`: Deferred+ and clustered forward shading, with and without culling."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Final

import rhi
from renderer.cli.arguments import (
    add_backend,
    add_camera_path,
    add_form,
    add_frame,
    add_frames,
    add_scene,
    add_size,
    open_scene,
)
from renderer.cli.output import note, prepare_image, print_report, show_progress, write_image
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import find_path
from renderer.lab.measure import format_table
from renderer.lab.measure.buffers import picture_buffers
from renderer.lab.measure.deferred_plus import STEPS, DeferredPlusReport, compare_deferred_plus

_NOTES: Final = """\
  python -m renderer compare deferred-plus city --camera-path ground --frames 30
  python -m renderer compare deferred-plus city --size 1280x720 --backend cl --markdown
  python -m renderer compare deferred-plus hall --frames 2 --output buffers.png

The frames of a walk are drawn in turn by Deferred+ in one pass over the screen, by Deferred+ with each material in
rectangles of its own, and by clustered forward shading, with two-pass culling and with frustum culling only. Times of
frames are from the scene's update until the device is finished, medians of all frames; those of steps lie between
timestamps of the device, and include what it has been given before. `processor ms` is the time of all threads. Then
follows what culling has drawn: what its first pass held to be visible, and what only the second one has found. `wrong
pixels` are those that aren't the same without culling. Under OpenCL set RHI_KERNELS=optimised."""


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    add_camera_path(parser)
    add_frame(parser)
    add_frames(parser, 16)
    add_size(parser)
    add_backend(parser)
    parser.add_argument("--output", type=Path, metavar="F.png", help="write a picture of the buffers and rectangles")
    add_form(parser, "tables")


def _run(given: argparse.Namespace) -> None:
    if given.output is not None:
        prepare_image(given.output)
    scene = open_scene(given.scene)
    path = find_path(given.camera_path, scene)
    cameras = [path.camera(given.frame + number) for number in range(given.frames)]

    def progress(count: int) -> Iterable[int]:
        return show_progress(range(count), count, "compare")

    with rhi.create_device(given.backend) as device:
        report = compare_deferred_plus(device, scene, cameras, given.size, progress=progress)
        if given.output is not None:
            write_image(given.output, picture_buffers(device, scene, cameras[0], given.size))
            note(f"wrote {given.output}")
        about = {
            "backend": device.backend_name,
            "device": device.capabilities.device,
            "scene": scene.name,
            "camera_path": given.camera_path,
            "frame": given.frame,
            "frames": given.frames,
            "size": list(given.size),
        }
    if given.json:
        print_report(about | asdict(report), scene)
    else:
        print(show_report(report, markdown=given.markdown))


def show_report(report: DeferredPlusReport, *, markdown: bool = False) -> str:
    """Format the report as tables: aligned text, or Markdown."""
    used = [name for name in STEPS if any(name in row.steps for row in report.rows)]
    header = ["technique", "culling", "ms", "processor ms", *used, "wrong pixels"]
    cells = [
        [
            row.technique,
            "on" if row.culling else "off",
            row.milliseconds,
            row.processor_milliseconds,
            *(f"{row.steps[name]:.2f}" if name in row.steps else "" for name in used),
            row.wrong_pixels,
        ]
        for row in report.rows
    ]
    culling = report.culling
    counts: list[list[object]] = [
        ["instances in the view", culling.instances],
        ["drawn by the first pass", culling.first],
        ["found by the second pass", culling.second],
        ["the second pass adds, %", culling.missed],
        ["culled, %", culling.culled],
    ]
    steps = [[name, milliseconds] for name, milliseconds in culling.steps.items()]
    tables = [
        format_table(header, cells, markdown=markdown),
        format_table(["culling, a frame", ""], counts, markdown=markdown),
    ]
    if steps:
        tables.append(format_table(["step of culling", "ms"], steps, markdown=markdown))
    return "\n\n".join(tables)


COMMAND: Final = Subcommand(
    "deferred-plus", "compare Deferred+ and clustered forward shading, with and without culling", _add_arguments, _run,
    _NOTES,
)  # fmt: skip
