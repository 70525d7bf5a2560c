"""`tune`: find the best b and n of CHC++ for a scene, a camera path and a device (thesis 6.5.1).

  python -m renderer tune city --camera-path ground --b 1:100 --n 1:40
  python -m renderer tune hall --camera-path walk.json --executor processes:4
  python -m renderer tune city --executor dask:tcp://scheduler:8786 --output tuned
  python -m renderer compare visibility city --settings tuned/settings.json

b is the number of hidden nodes that are queried as one batch, n the number of frames for which a visible
object isn't queried again. Each trial renders the path with one pair of values and, in turn, with the default
pair (b=50, n=20); pairs are compared by the ratio of the two times, so trials may run at the same time and on
different machines. The best three are then compared in one process. --leaf-size 1:16 then tries the best pair
with leaves of 1, 2, 4, 8 and 16 objects, which are queried and drawn together. `trials.csv`, `trials.png` and
`settings.json` are written to DIR; `render`, `compare visibility` and `debug visibility` read the last with
--settings.
"""

from __future__ import annotations

import argparse
import csv
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, fields
from pathlib import Path
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import open_scene
from renderer.cli.options import option
from renderer.cli.output import OutputError, draw_chart, note, print_report, show_progress
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_camera_path
from renderer.lab.accuracy.tuning import (
    ParameterPair,
    PathFrames,
    Trial,
    search,
    select_best,
    space_evenly,
    try_pairs,
)
from renderer.lab.measure import format_table, title_of
from renderer.scene import CameraPath
from renderer.visibility import VisibilitySettings, list_algorithms
from rhi_screen.executors import KINDS, as_completed, make_executor

_LEAF_SIZES: Final = 5
"""The most leaf sizes to try."""


def _run(arguments: argparse.Namespace) -> None:
    scene = open_scene(arguments.scene)
    path = parse_camera_path(arguments.camera_path, scene)
    first = max(0, (len(path) - arguments.frames - 1) // 2) if arguments.frame is None else arguments.frame
    path_frames = PathFrames(
        arguments.scene,
        CameraPath.record([path.camera(first + frame) for frame in range(arguments.frames + 1)]),
        first,
        arguments.backend,
        arguments.size,
        arguments.queries == "emulated",
    )
    with rhi.create_device(arguments.backend) as device:
        backend, name = device.backend_name, device.capabilities.device
        if "chc_plus_plus" not in list_algorithms(device):
            raise OutputError(
                f"--backend: the {backend} device answers no queries, so there is nothing to tune"
            )
    with make_executor(arguments.executor) as executor:
        arguments.output.mkdir(parents=True, exist_ok=True)
        trials = list(
            search(
                arguments.b,
                arguments.n,
                arguments.rounds,
                lambda pairs: _try_all(executor, path_frames, pairs),
            )
        )
        finalists = select_best(trials)
        pairs = [(trial.batch, trial.persistence) for trial in finalists]
        finals = executor.submit(try_pairs, path_frames, pairs).result()
        best = select_best(finals, 1)[0]
        least, most = arguments.leaf_size
        for size in space_evenly(least, most, _LEAF_SIZES):
            if size != best.leaf_size:
                pair = (best.batch, best.persistence)
                finals += executor.submit(try_pairs, path_frames, [pair], leaf_size=size).result()
    best = select_best(finals, 1)[0]
    is_better = best.ratio < 1.0  # than the default settings
    settings = VisibilitySettings(emulated=path_frames.emulated)
    if is_better:
        settings = VisibilitySettings(
            best.batch, best.persistence, best.leaf_size, emulated=path_frames.emulated
        )
    report = {
        "backend": backend,
        "device": name,
        "scene": scene.name,
        "camera_path": arguments.camera_path,
        "first_frame": first + 1,
        "frames": arguments.frames,
        "size": list(arguments.size),
        "ratio": min(best.ratio, 1.0),
    }
    write_trials(arguments.output / "trials.csv", trials)
    plot_trials(
        trials, finals, f"{scene.name}, {arguments.camera_path}, {name}", arguments.output / "trials.png"
    )
    settings.save(arguments.output / "settings.json", **report)
    note(f"wrote trials.csv, trials.png and settings.json to {arguments.output}")
    if arguments.json:
        print_report(
            {**report, "visibility": asdict(settings), "finals": [asdict(final) for final in finals]}, scene
        )
        return
    names = [field.name for field in fields(Trial)]
    sorted_finals = sorted(finals, key=lambda trial: trial.ratio)
    print(
        format_table(
            [_title(name) for name in names], [[getattr(t, name) for name in names] for t in sorted_finals]
        )
    )
    values_text = f"b={settings.batch}, n={settings.persistence}, leaf size {settings.leaf_size}"
    print(f"{values_text}: {report['ratio']:.2f} of the default's time")


def _try_all(executor: Executor, path_frames: PathFrames, pairs: Sequence[ParameterPair]) -> list[Trial]:
    """Try each pair, as many at a time as the executor allows, and return the trials in this order."""
    futures = [executor.submit(try_pairs, path_frames, [pair]) for pair in show_progress(pairs, "tune")]
    for _ in show_progress(
        as_completed(executor, futures), "tune", len(pairs)
    ):  # a serial executor has finished them by now
        pass
    return [trial for future in futures for trial in future.result()]


def write_trials(path: Path, trials: Sequence[Trial]) -> None:
    """Write a CSV row for each trial, in the order in which they ran."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        names = [field.name for field in fields(Trial)]
        writer.writerow(names)
        writer.writerows([getattr(trial, name) for name in names] for trial in trials)


def plot_trials(trials: Sequence[Trial], finals: Sequence[Trial], title: str, path: Path) -> None:
    """Draw a chart of all trials' values and ratios; circles mark the finalists."""
    with draw_chart(path, title) as figure:
        pair_axes, batch, persistence = figure.subplots(1, 3)
        points = pair_axes.scatter(
            [t.batch for t in trials],
            [t.persistence for t in trials],
            c=[t.ratio for t in trials],
            cmap="viridis",
        )
        pair_axes.scatter(
            [t.batch for t in finals],
            [t.persistence for t in finals],
            s=120,
            facecolors="none",
            edgecolors="red",
        )
        figure.colorbar(points, ax=pair_axes)
        pair_axes.set_title("time, default = 1", fontsize="medium")
        pair_axes.set(xscale="log", yscale="log", xlabel="b", ylabel="n")
        for axes, name, label in ((batch, "batch", "b"), (persistence, "persistence", "n")):
            axes.scatter([getattr(t, name) for t in trials], [t.ratio for t in trials], s=12, color="#4477aa")
            axes.axhline(1.0, color="grey", linewidth=0.8)
            axes.set(xscale="log", xlabel=label, ylabel="time, default = 1")


def _title(name: str) -> str:
    short = {"batch": "b", "persistence": "n", "default_milliseconds": "default ms"}
    return short.get(name, title_of(name))


def _parse_range(text: str) -> ParameterPair:
    """Parse `1:100` as (1, 100), and a single number as the range of only that number."""
    low, _, high = text.partition(":")
    high = high or low
    if not (low.isascii() and low.isdigit() and high.isascii() and high.isdigit()) or not (
        1 <= int(low) <= int(high)
    ):
        raise argparse.ArgumentTypeError(f"{text!r} is not a range; give LOW:HIGH, such as 1:100")
    return int(low), int(high)


_OPTIONS: Final = (
    options.SCENE,
    *options.path_range("number of frames that a trial renders"),
    option("--b", "range of b", (1, 100), "1:100", type=_parse_range, metavar="LOW:HIGH"),
    option("--n", "range of n", (1, 40), "1:40", type=_parse_range, metavar="LOW:HIGH"),
    option(
        "--leaf-size",
        "range of the leaf size to try with the best pair",
        (1, 1),
        "1",
        type=_parse_range,
        metavar="LOW:HIGH",
    ),
    options.rounds("rounds of the search, the first of which tries a grid of values", 4),
    options.executor("trials run", KINDS),
    options.queries("native"),
    options.BACKEND,
    options.size(),
    options.output_folder("--output", "folder for the results", "tuned"),
    options.JSON,
)
COMMAND: Final = Subcommand(
    "tune", "find the best b and n of CHC++ along a camera path", _OPTIONS, _run, __doc__
)
