"""`capture`: write the times of frames and of their passes to a file.

  python -m renderer capture city --camera ground --frames 1000 --output city.csv
  python -m renderer capture hall --technique forward_multipass --visibility frustum --output hall.csv --plot hall.svg

Each row is a frame: its milliseconds from the scene's update until the GPU is finished, and for each pass of its plan
those between its timestamps on the GPU, and those that the CPU took to issue its commands. The first frame isn't
counted, nor are those in which `auto` looks for what is the fastest before it. A device that works in batches has the
work of a pass between its timestamps only in part: the sum of a frame is exact, its division among passes is not.
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
from renderer.content import parse_shots
from renderer.lab.measure.capture import CapturedFrame, capture_frames, list_passes, write_frames
from renderer.lab.measure.table import format_table
from renderer.renderer import Renderer
from renderer.visibility import check_algorithm

_OPTIONS: Final = (
    options.SCENE,
    options.BACKEND,
    *options.technique("forward"),
    options.visibility("frustum"),
    options.camera(shown="the scene's first path"),
    options.frame(),
    options.frames(1000),
    options.size(),
    options.file("--output", "table of all frames to write", "F.csv", required=True),
    options.file("--plot", "chart of the frames' times to write", "F.svg"),
    options.switch("--json", "print the medians as JSON"),
)


def _run(given: argparse.Namespace) -> None:
    if given.plot is not None:
        prepare_chart(given.plot)
    scene = open_scene(given.scene)
    camera = given.camera or next(iter(scene.paths or scene.views))
    shots = parse_shots(camera, scene, range(given.frame, given.frame + given.frames))
    given.output.parent.mkdir(parents=True, exist_ok=True)
    with rhi.create_device(given.backend) as device:
        check_algorithm(given.visibility, device, "capture")
        with Renderer(
            device,
            scene,
            technique=make_technique(given, scene, device),
            visibility=given.visibility,
            size=given.size,
        ) as renderer:
            list(capture_frames(renderer, shots[:1]))
            while renderer.is_trying:
                list(capture_frames(renderer, shots[:1]))
            frames = list(show_progress(capture_frames(renderer, shots), "capture", len(shots)))
    write_frames(given.output, frames)
    note(f"wrote {given.output}: {len(frames)} frames")
    if given.plot is not None:
        plot_frames(frames, given.plot, f"{given.technique}: {scene.name}")
        note(f"wrote {given.plot}")
    medians = find_medians(frames)
    rows = [[name, *times.values()] for name, times in medians.items()]
    if given.json:
        print_report(medians, scene)
    else:
        print(format_table(("", "median", "least", "most"), rows))


def find_medians(frames: list[CapturedFrame]) -> dict[str, dict[str, float]]:
    """Return the median, the least and the most milliseconds of the frame and of each pass, on the GPU where it has
    timestamps and otherwise on the CPU."""
    columns = {"frame": [one.milliseconds for one in frames]} | {
        name: [time for time in _list_times(frames, name) if time is not None] for name in list_passes(frames)
    }
    return {name: {"median": median(times), "least": min(times), "most": max(times)} for name, times in columns.items()}


def _list_times(frames: list[CapturedFrame], name: str) -> list[float | None]:
    """Return the milliseconds of a pass in each frame, None where a frame lacks it."""
    times = (one.passes.get(name) for one in frames)
    return [None if time is None else time.cpu if time.gpu is None else time.gpu for time in times]


def plot_frames(frames: list[CapturedFrame], path: Path, title: str) -> None:
    """Draw the frames' times, and under them those of their passes, one on top of the other."""
    numbers = [one.frame for one in frames]
    with draw_chart(path, title) as figure:
        axes = figure.add_subplot()
        stacked = [[time or 0.0 for time in _list_times(frames, name)] for name in list_passes(frames)]
        axes.stackplot(numbers, *stacked, labels=list_passes(frames), alpha=0.8, step="mid")
        axes.plot(
            numbers,
            [one.milliseconds for one in frames],
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
