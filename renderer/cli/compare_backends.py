"""`compare backends`: measure what the same passes of a scene cost on each backend."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from renderer.cli.arguments import (
    add_camera_path,
    add_rounds,
    add_scene,
    add_size,
    open_scene,
    parse_frame,
    parse_names,
)
from renderer.cli.output import draw_chart, note, prepare_image, print_report, show_progress
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import find_path
from renderer.lab.measure import format_table
from renderer.lab.measure.backends import PASSES, BackendRow, compare_backends

_NOTES: Final = """\
  python -m renderer compare backends city --passes depth,lit,textured,queries --size 1280x720
  python -m renderer compare backends city --camera-path sky --passes depth --json
  python -m renderer compare backends hall --passes depth,lit --plot hall.png

All objects are drawn without culling, front to back, with one camera. A round runs a pass once on each backend;
each round starts with another backend. Times are medians over the rounds, from the first command until the device is
finished. `ratio to gl` says how many times as fast as gl a backend is: the median of the rounds' ratios. `queries`
queries up to 1,000 boxes and then reads all results; `waited` reads each result before it issues the next query."""
_BASE = "gl"


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--passes",
        type=parse_names(PASSES, "is not a pass"),
        default=["depth", "lit", "queries"],
        metavar="A,B,…",
        help=f"some of {', '.join(PASSES)} (default: depth,lit,queries)",
    )
    parser.add_argument(
        "--backends",
        type=lambda text: text.split(","),
        default=["cl"],
        metavar="A,B,…",
        help=f"backends to compare with {_BASE} (default: cl)",
    )
    add_camera_path(parser)
    parser.add_argument(
        "--frame",
        type=parse_frame,
        metavar="N",
        help="frame whose camera is used (default: the path's middle)",
    )
    add_rounds(parser, "rounds of each pass", 15)
    add_size(parser, (1280, 720), "size of the targets in pixels")
    parser.add_argument("--json", action="store_true", help="print the result as JSON")
    parser.add_argument("--plot", type=Path, metavar="F.png", help="write a chart of the times")


def _run(given: argparse.Namespace) -> None:
    if given.plot is not None:
        prepare_image(given.plot)
    scene = open_scene(given.scene)
    path = find_path(given.camera_path, scene)
    frame = len(path) // 2 if given.frame is None else given.frame
    camera = path.camera(frame)
    backends = [_BASE, *(name for name in given.backends if name != _BASE)]

    def rounds(name: str) -> Iterable[int]:
        return show_progress(range(given.rounds), given.rounds, name)

    devices, rows = compare_backends(scene, camera, backends, given.passes, given.size, rounds)
    report = {
        "scene": scene.name,
        "triangles": scene.count_triangles(np.arange(len(scene.objects))),
        "camera_path": given.camera_path,
        "frame": frame,
        "size": list(given.size),
        "rounds": given.rounds,
        "devices": devices,
        "rows": [
            {
                "pass": row.name,
                "backend": row.backend,
                "milliseconds": row.milliseconds,
                "ratio_to_gl": row.speed,
            }
            for row in rows
        ],
    }
    if given.plot is not None:
        plot_backends(rows, f"{scene.name}, {given.camera_path}, {given.size[0]}×{given.size[1]}", given.plot)
        note(f"wrote {given.plot}")
    if given.json:
        print_report(report, scene)
    else:
        cells = [[row.name, row.backend, row.milliseconds, row.speed] for row in rows]
        print(format_table(["pass", "backend", "ms", "ratio to gl"], cells))


def plot_backends(rows: list[BackendRow], title: str, path: Path) -> None:
    """Write a chart of the times: a group of bars for each pass, a bar for each backend."""
    with draw_chart(path, dpi=110) as figure:
        axes = figure.subplots()
        names = list(dict.fromkeys(row.name for row in rows))
        backends = list(dict.fromkeys(row.backend for row in rows))
        height = 0.8 / len(backends)
        for place, backend in enumerate(backends):
            chosen = [row for row in rows if row.backend == backend]
            bars = axes.barh(
                [names.index(row.name) + place * height for row in chosen],
                [row.milliseconds for row in chosen],
                height,
                label=backend,
            )
            axes.bar_label(bars, [f" {row.milliseconds:,.1f} ms, ×{row.speed:,.1f}" for row in chosen])
        axes.set(title=title, xlabel="milliseconds", yticks=range(len(names)), yticklabels=names)
        axes.invert_yaxis()
        axes.margins(x=0.2)
        axes.legend()


COMMAND: Final = Subcommand(
    "backends", "compare what a scene's passes cost on each backend", _add_arguments, _run, _NOTES
)
