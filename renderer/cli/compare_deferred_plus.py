"""`compare deferred-plus`: Deferred+ and clustered forward shading, with and without culling.

  python -m renderer compare deferred-plus city --camera-path ground --frames 30
  python -m renderer compare deferred-plus city --size 1280x720 --backend cl --markdown
  python -m renderer compare deferred-plus hall --frames 2 --output buffers.png

The frames of a walk are drawn in turn by Deferred+ in one pass over the screen, by Deferred+ with each material in
rectangles of its own, and by clustered forward shading, with two-pass culling and with frustum culling only. Times of
frames are from the scene's update until the device is finished, medians of all frames; those of steps lie between
timestamps of the device, and include what it has been given before. `processor ms` is the time of all threads. Then
follows what culling has drawn: what its first pass held to be visible, and what only the second one has found. `wrong
pixels` are those that aren't the same without culling. Under OpenCL set RHI_KERNELS=optimised; `kernels` says which
ones cl ran in the frames whose times were taken.
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
from renderer.content import find_path
from renderer.lab.comparison import Record
from renderer.lab.deferred_plus import STEPS, compare_deferred_plus
from renderer.lab.measure import format_table
from renderer.lab.measure.buffers import picture_buffers

_OPTIONS: Final = (
    options.SCENE,
    options.PATH,
    options.frame(),
    options.frames(16),
    options.size(),
    options.BACKEND,
    options.file("--output", "write a picture of the buffers and rectangles"),
    *options.form("tables"),
)


def _measure(given: argparse.Namespace) -> Report:
    if given.output is not None:
        prepare_image(given.output)
    scene = open_scene(given.scene)
    path = find_path(given.camera_path, scene)
    cameras = [path.camera(given.frame + number) for number in range(given.frames)]
    with rhi.create_device(given.backend) as device:
        found = compare_deferred_plus(
            device, scene, cameras, given.size, progress=partial(show_progress, what="compare")
        )
        if given.output is not None:
            write_image(given.output, picture_buffers(device, scene, cameras[0], given.size))
            note(f"wrote {given.output}")
        about = describe(device) | {"scene": scene.name} | repeat(given, "camera_path", "frame", "frames", "size")
    return Report(about | {"culling": found["culling"]}, found["rows"], scene=scene)


def show_steps(rows: Sequence[Record]) -> Sequence[Record]:
    """Give each step a column of its own, before that of wrong pixels."""
    used = [name for name in STEPS if any(name in row["steps"] for row in rows)]
    return [
        {name: value for name, value in row.items() if name not in ("steps", "wrong_pixels")}
        | {name: f"{row['steps'][name]:.2f}" if name in row["steps"] else "" for name in used}
        | {"wrong_pixels": row["wrong_pixels"]}
        for row in rows
    ]


def show_culling(about: Mapping[str, Any], markdown: bool) -> Sequence[str]:
    """Return tables of what culling has drawn, and of what its steps took."""
    culling = about["culling"]
    counts: list[list[object]] = [
        ["instances in the view", culling["instances"]],
        ["drawn by the first pass", culling["first"]],
        ["found by the second pass", culling["second"]],
        ["the second pass adds, %", culling["missed"]],
        ["culled, %", culling["culled"]],
    ]
    tables = [format_table(["culling, a frame", ""], counts, markdown=markdown)]
    if culling["steps"]:
        tables.append(format_table(["step of culling", "ms"], list(culling["steps"].items()), markdown=markdown))
    return tables


COMMAND: Final = ComparisonProgram(
    "deferred-plus", "compare Deferred+ and clustered forward shading, with and without culling", __doc__,
    _OPTIONS, _measure, show=show_steps, more=show_culling,
).command  # fmt: skip
