"""`compare visibility`: print the thesis's tables (chapter 7) for a scene, a camera path and a backend.

  python -m renderer compare visibility city --camera-path ground --frames 60
  python -m renderer compare visibility city --camera-path sky --frames 60 --json
  python -m renderer compare visibility hall --algorithms none,frustum,chc_plus_plus --plot hall.png
  python -m renderer compare visibility city --algorithms none,chc,chc_plus_plus --threshold 10
  python -m renderer compare visibility city --teleport 5
  python -m renderer compare visibility city --stride 30 --warm-up 8 --frames 60
  python -m renderer compare visibility city --queries native,emulated --settings tuned/settings.json

Each frame is first drawn without culling and untimed: this brings the device up to date and makes the image
that the others are compared with. Then every algorithm draws it; each frame starts with another algorithm.
Algorithms depend on what earlier frames have shown: with --stride, frames far apart are counted, and each
follows as many frames of the path as --warm-up says, which are drawn and not counted. Times are medians, from
the scene's update until the GPU is finished. `ratio` is the median of the frames' ratios to the first
algorithm's time. Counters are means per frame. `triangles` and `draws` include the boxes drawn in queries, as
in the thesis. `wrong pixels` is the largest number, in any frame, of pixels that show something else. `tied
pixels` is the largest number of pixels that show another surface at exactly the same depth: of two such
surfaces the one drawn first stays. `stalled` is how long the CPU waited. Where a scene simulates something,
`simulation steps` counts the steps of what was drawn, and `skipped simulations` what wasn't drawn. `kernels`
says which kernels cl ran in the counted frames: RHI_KERNELS=optimised measures a long run. The null device
answers no queries. On it `auto` is frustum culling, and algorithms that use queries don't run.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any, Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import OutputError, show_progress
from renderer.content import parse_camera_path
from renderer.lab.comparison import Record
from renderer.lab.comparisons.visibility_comparison import compare_algorithms, list_contenders, list_frames
from renderer.renderer import Renderer
from renderer.visibility import ALGORITHMS, VisibilitySettings, check_algorithm, list_algorithms


def measure_visibility(arguments: argparse.Namespace) -> Report:
    """Compare the algorithms that the command's arguments ask for."""
    if arguments.teleport is not None and arguments.stride > 1:
        raise OutputError("--teleport: it jumps between consecutive frames; leave out --stride")
    settings = VisibilitySettings()
    tuned = None if arguments.settings is None else VisibilitySettings.load(arguments.settings)
    if arguments.threshold is not None:
        settings = replace(settings, threshold=arguments.threshold)
        tuned = None if tuned is None else replace(tuned, threshold=arguments.threshold)
    scene = open_scene(arguments.scene)
    path = parse_camera_path(arguments.camera_path, scene)
    drawn = arguments.warm_up + (arguments.frames - 1) * arguments.stride + 1
    first = max(0, (len(path) - drawn + 1) // 2) if arguments.frame is None else arguments.frame
    path.camera(first + drawn - 1)  # raises now, not after minutes
    frames = list_frames(
        first,
        arguments.frames,
        len(path),
        stride=arguments.stride,
        warm_up=arguments.warm_up,
        teleport=arguments.teleport,
    )
    arguments.queries = [kind for kind in options.QUERY_KINDS if kind in arguments.queries]
    emulated = [kind == "emulated" for kind in arguments.queries]
    with (
        rhi.create_device(arguments.backend) as device,
        Renderer(device, scene, size=arguments.size) as renderer,
    ):
        names = arguments.algorithms or [
            name for name in list_algorithms(device) if name != "conditional" or not emulated[0]
        ]
        for name in names:
            check_algorithm(name, device, "compare visibility")
        contenders = list_contenders(names, settings, tuned, emulated)
        rows = compare_algorithms(renderer, contenders, path, show_progress(frames, "compare"))
        metadata = describe(device) | {"scene": scene.name, "camera_path": arguments.camera_path}
    metadata |= {"first_frame": first + arguments.warm_up}
    metadata |= repeat(arguments, "frames", "stride", "warm_up", "teleport", "size", "queries")
    metadata |= {"settings": asdict(settings), "optimized": None if tuned is None else asdict(tuned)}
    return Report(metadata, rows, f"{scene.name}, {arguments.camera_path}, {metadata['device']}", scene)


def drop_idle_columns(rows: Sequence[Record]) -> Sequence[Record]:
    """Drop the columns of simulations if nothing is simulated."""
    idle = ("simulation_steps", "skipped_simulations")
    if any(row[name] for row in rows for name in idle):
        return rows
    return [{name: value for name, value in row.items() if name not in idle} for row in rows]


def plot_algorithms(figure: Any, rows: Sequence[Record]) -> None:
    """Draw times and triangles, with a bar for each algorithm."""
    names = [row["algorithm"] for row in rows]
    for number, (key, form) in enumerate({"milliseconds": "{:,.1f}", "triangles": "{:,}"}.items(), 1):
        values = [row[key] for row in rows]
        axes = figure.add_subplot(1, 2, number)
        bars = axes.barh(names, values, color="#4477aa")
        axes.bar_label(bars, labels=[form.format(value) for value in values], padding=3)
        axes.set_xlabel(f"{key} a frame")
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.locator_params(axis="x", nbins=5)
        axes.margins(x=0.3)
        axes.invert_yaxis()


_OPTIONS: Final = (
    options.SCENE,
    *options.path_range("number of frames to time"),
    options.BACKEND,
    options.names("--algorithms", ALGORITHMS, "is not an algorithm", None, "all that the device can run"),
    options.names(
        "--queries",
        options.QUERY_KINDS,
        "is not a kind of query",
        ["native"],
        help="emulated ones are two counters and a fence; ",
    ),
    options.settings("adds a row for CHC++ with the parameters in this file, which `tune` has written"),
    options.size(),
    options.count("--stride", "count every Nth frame of the path", 1),
    options.count(
        "--warm-up",
        "number of frames that are drawn before a counted one, unless they are counted",
        1,
        minimum=0,
    ),
    options.count(
        "--threshold",
        "count boxes that pass at most this many samples as hidden",
        None,
        "the settings', 0",
        minimum=0,
    ),
    options.count("--teleport", "jump to the other half of the path, or back, after every N frames"),
    *options.form(),
    options.chart("times and triangles"),
)
COMMAND: Final = ComparisonProgram(
    "visibility",
    "compare visibility algorithms along a camera path",
    __doc__,
    _OPTIONS,
    measure_visibility,
    display_rows=drop_idle_columns,
    plot=plot_algorithms,
).command
