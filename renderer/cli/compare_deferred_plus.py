"""`compare deferred-plus`: Deferred+ and clustered forward shading, with and without culling.

  python -m renderer compare deferred-plus city --camera-path ground --frames 30
  python -m renderer compare deferred-plus city --size 1280x720 --backend cl --markdown
  python -m renderer compare deferred-plus hall --frames 2 --output buffers.png

The frames of a walk are drawn in turn by Deferred+ in one pass over the screen, by Deferred+ with each
material in rectangles of its own, and by clustered forward shading, with two-pass culling and with frustum
culling only. Times of frames are from the scene's update until the device is finished, medians of all frames;
those of steps lie between timestamps of the device, and include what it has been given before. `processor ms`
is the time of all threads. Then follows what culling has drawn: what its first pass held to be visible, and
what only the second one has found. `wrong pixels` are those that aren't the same without culling. Under
OpenCL set RHI_KERNELS=optimised; `kernels` says which ones cl ran in the frames whose times were taken.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import note, prepare_image, show_progress, write_image
from renderer.content import parse_camera_path
from renderer.lab.comparison import Record
from renderer.lab.comparisons.deferred_plus_comparison import STEPS, compare_deferred_plus
from renderer.lab.measure import format_table
from renderer.lab.measure.geometry_buffer_image import render_geometry_buffer_image

_OPTIONS: Final = (
    options.SCENE,
    options.PATH,
    options.frame(),
    options.frames(16),
    options.size(),
    options.BACKEND,
    options.output_file("--output", "write an image of the buffers and rectangles"),
    *options.form("tables"),
)


def _measure(arguments: argparse.Namespace) -> Report:
    if arguments.output is not None:
        prepare_image(arguments.output)
    scene = open_scene(arguments.scene)
    path = parse_camera_path(arguments.camera_path, scene)
    cameras = [path.camera(arguments.frame + number) for number in range(arguments.frames)]
    with rhi.create_device(arguments.backend) as device:
        comparison = compare_deferred_plus(
            device, scene, cameras, arguments.size, progress=partial(show_progress, task="compare")
        )
        if arguments.output is not None:
            write_image(
                arguments.output, render_geometry_buffer_image(device, scene, cameras[0], arguments.size)
            )
            note(f"wrote {arguments.output}")
        metadata = (
            describe(device)
            | {"scene": scene.name}
            | repeat(arguments, "camera_path", "frame", "frames", "size")
        )
    return Report(metadata | {"culling": comparison["culling"]}, comparison["rows"], scene=scene)


def add_step_columns(rows: Sequence[Record]) -> Sequence[Record]:
    """Give each step its own column, before that of wrong pixels."""
    used = [name for name in STEPS if any(name in row["steps"] for row in rows)]
    return [
        {name: value for name, value in row.items() if name not in ("steps", "wrong_pixels")}
        | {name: f"{row['steps'][name]:.2f}" if name in row["steps"] else "" for name in used}
        | {"wrong_pixels": row["wrong_pixels"]}
        for row in rows
    ]


def format_culling_tables(metadata: Mapping[str, Any], markdown: bool) -> Sequence[str]:
    """Format tables of what culling has drawn, and of the times of its steps."""
    culling = metadata["culling"]
    counts: list[list[object]] = [
        ["instances in the view", culling["instances"]],
        ["drawn by the first pass", culling["first"]],
        ["found by the second pass", culling["second"]],
        ["the second pass adds, %", culling["missed"]],
        ["culled, %", culling["culled"]],
    ]
    tables = [format_table(["culling, a frame", ""], counts, markdown=markdown)]
    if culling["steps"]:
        tables.append(
            format_table(["step of culling", "ms"], list(culling["steps"].items()), markdown=markdown)
        )
    return tables


COMMAND: Final = ComparisonProgram(
    "deferred-plus",
    "compare Deferred+ and clustered forward shading, with and without culling",
    __doc__,
    _OPTIONS,
    _measure,
    display_rows=add_step_columns,
    extra_tables=format_culling_tables,
).command
