"""`capture`: write the times of frames and of their passes to a file.

  python -m renderer capture city --camera ground --frames 1000 --output city.csv python -m renderer capture
  hall --technique forward_multipass --visibility frustum --output hall.csv --plot hall.svg

Each row is a frame: its milliseconds from the scene's update until the GPU is finished, and for each pass of
its plan those between its timestamps on the GPU, and those that the CPU took to issue its commands. The first
frame isn't counted, nor are those in which `auto` looks for what is the fastest before it. A device that
works in batches has the work of a pass between its timestamps only in part: the sum of a frame is exact, its
division among passes is not.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import make_technique, open_scene
from renderer.cli.output import draw_chart, note, prepare_chart, print_report, show_progress
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_path_frames
from renderer.inspection.frame_times import CapturedFrame, capture_frames, list_passes, write_frames
from renderer.lab.measure.table import format_table
from renderer.renderer import Renderer
from renderer.visibility import check_algorithm

_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique("forward"),
    options.visibility("frustum"),
    options.camera(default_text="the scene's first path"),
    options.frame(),
    options.frames(1000),
    options.size(),
    options.output_file("--output", "table of all frames to write", "F.csv", required=True),
    options.output_file("--plot", "chart of the frames' times to write", "F.svg"),
    options.switch("--json", "print the medians as JSON"),
)


def _run(arguments: argparse.Namespace) -> None:
    if arguments.plot is not None:
        prepare_chart(arguments.plot)
    scene = open_scene(arguments.scene)
    camera = arguments.camera or next(iter(scene.paths or scene.views))
    path_frames = parse_path_frames(camera, scene, range(arguments.frame, arguments.frame + arguments.frames))
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    with rhi.create_device(arguments.backend) as device:
        check_algorithm(arguments.visibility, device, "capture")
        with Renderer(
            device,
            scene,
            technique=make_technique(arguments, scene, device),
            visibility=arguments.visibility,
            size=arguments.size,
        ) as renderer:
            list(capture_frames(renderer, path_frames[:1]))
            while renderer.is_trying:
                list(capture_frames(renderer, path_frames[:1]))
            frames = list(show_progress(capture_frames(renderer, path_frames), "capture", len(path_frames)))
    write_frames(arguments.output, frames)
    note(f"wrote {arguments.output}: {len(frames)} frames")
    if arguments.plot is not None:
        plot_frames(frames, arguments.plot, f"{arguments.technique}: {scene.name}")
        note(f"wrote {arguments.plot}")
    medians = compute_medians(frames)
    rows = [[name, *times.values()] for name, times in medians.items()]
    if arguments.json:
        print_report(medians, scene)
    else:
        print(format_table(("", "median", "least", "most"), rows))


def compute_medians(frames: list[CapturedFrame]) -> dict[str, dict[str, float]]:
    """The median, least and greatest milliseconds of the frame and of each pass, on the GPU if it has
    timestamps, otherwise on the CPU."""
    columns = {"frame": [frame.milliseconds for frame in frames]} | {
        name: [time for time in _list_times(frames, name) if time is not None] for name in list_passes(frames)
    }
    return {
        name: {"median": median(times), "least": min(times), "most": max(times)}
        for name, times in columns.items()
    }


def _list_times(frames: list[CapturedFrame], name: str) -> list[float | None]:
    """The milliseconds of a pass in each frame, None if a frame lacks it."""
    times = (frame.passes.get(name) for frame in frames)
    return [None if time is None else time.cpu if time.gpu is None else time.gpu for time in times]


def plot_frames(frames: list[CapturedFrame], path: Path, title: str) -> None:
    """Draw the frames' times, and below them the times of their passes, stacked."""
    numbers = [frame.frame for frame in frames]
    with draw_chart(path, title) as figure:
        axes = figure.add_subplot()
        stacked = [[time or 0.0 for time in _list_times(frames, name)] for name in list_passes(frames)]
        axes.stackplot(numbers, *stacked, labels=list_passes(frames), alpha=0.8, step="mid")
        axes.plot(
            numbers,
            [frame.milliseconds for frame in frames],
            drawstyle="steps-mid",
            color="black",
            linewidth=0.8,
            label="frame",
        )
        axes.set_xlabel("frame")
        axes.set_ylabel("ms")
        axes.set_ylim(bottom=0.0)
        axes.legend(loc="upper right", fontsize=8)


COMMAND: Final = Subcommand(
    "capture", "write the times of frames and of their passes to a file", _OPTIONS, _run, __doc__
)
