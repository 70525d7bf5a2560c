"""`compare visibility`: print the thesis's tables (chapter 7) for a scene, a camera path and a backend."""

from __future__ import annotations

import argparse
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final

import rhi
from renderer.cli.arguments import (
    QUERY_KINDS,
    add_backend,
    add_form,
    add_scene,
    add_settings,
    add_size,
    add_walk,
    open_scene,
    parse_count,
    parse_frame,
    parse_names,
)
from renderer.cli.output import OutputError, draw_chart, note, prepare_image, print_report, show_progress
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import find_path
from renderer.lab.measure import format_rows
from renderer.lab.measure.visibility import AlgorithmRow, compare_algorithms, list_contenders, list_frames
from renderer.renderer import Renderer
from renderer.visibility import ALGORITHMS, VisibilitySettings, check_algorithm, list_algorithms

_NOTES: Final = """\
  python -m renderer compare visibility city --camera-path ground --frames 60
  python -m renderer compare visibility city --camera-path sky --frames 60 --json
  python -m renderer compare visibility hall --algorithms none,frustum,chc_plus_plus --plot hall.png
  python -m renderer compare visibility city --algorithms none,chc,chc_plus_plus --threshold 10
  python -m renderer compare visibility city --teleport 5
  python -m renderer compare visibility city --stride 30 --warm-up 8 --frames 60
  python -m renderer compare visibility city --queries native,emulated --settings tuned/settings.json

Each frame is first drawn without culling and untimed: this brings the device up to date and makes the image that the
others are compared with. Then every algorithm draws it; each frame starts with another algorithm. Algorithms depend on
what earlier frames have shown: with --stride, frames far apart are counted, and each follows as many frames of the path
as --warm-up says, which are drawn and not counted.
Times are medians, from the scene's update until the GPU is finished. `ratio` is the median of the frames'
ratios to the first algorithm's time. Counters are means per frame. `triangles` and `draws` include the boxes drawn in
queries, as in the thesis. `wrong pixels` is the largest number, in any frame, of pixels that show something else.
`tied pixels` is the largest number of pixels that show another surface at exactly the same depth: of two such
surfaces the one drawn first stays. `stalled` is how long the CPU waited. Where a scene simulates something,
`simulation steps` counts the steps of what was drawn, and `skipped simulations` what wasn't drawn.
The null device answers no queries. On it `auto` is frustum culling, and algorithms that use queries don't run."""


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    add_walk(parser, "number of frames to time")
    add_backend(parser)
    parser.add_argument(
        "--algorithms",
        type=parse_names(ALGORITHMS, "is not an algorithm"),
        metavar="A,B,…",
        help=f"some of {', '.join(ALGORITHMS)} (default: all that the device can run)",
    )
    parser.add_argument(
        "--queries",
        type=_parse_kinds,
        default=["native"],
        metavar="KIND",
        help="native, emulated (by two counters and a fence), or both: native,emulated (default: native)",
    )
    add_settings(parser, "adds a row for CHC++ with the parameters in this file, which `tune` has written")
    add_size(parser)
    parser.add_argument(
        "--stride",
        type=parse_count,
        default=1,
        metavar="N",
        help="count every Nth frame of the path (default: %(default)s)",
    )
    parser.add_argument(
        "--warm-up",
        type=parse_frame,
        default=1,
        metavar="N",
        help="number of frames that are drawn before a counted one, unless they are counted (default: %(default)s)",
    )
    parser.add_argument(
        "--threshold",
        type=parse_frame,
        metavar="N",
        help="count boxes that pass at most this many samples as hidden (default: the settings', 0)",
    )
    parser.add_argument(
        "--teleport",
        type=parse_count,
        metavar="N",
        help="jump to the other half of the path, or back, after every N frames",
    )
    add_form(parser)
    parser.add_argument("--plot", type=Path, metavar="F.png", help="write a chart of times and triangles")


def _run(given: argparse.Namespace) -> None:
    if given.plot is not None:
        prepare_image(given.plot)
    if given.teleport is not None and given.stride > 1:
        raise OutputError("--teleport: it jumps between consecutive frames; leave out --stride")
    settings = VisibilitySettings()
    tuned = None if given.settings is None else VisibilitySettings.load(given.settings)
    if given.threshold is not None:
        settings = replace(settings, threshold=given.threshold)
        tuned = None if tuned is None else replace(tuned, threshold=given.threshold)
    scene = open_scene(given.scene)
    path = find_path(given.camera_path, scene)
    drawn = given.warm_up + (given.frames - 1) * given.stride + 1
    first = max(0, (len(path) - drawn + 1) // 2) if given.frame is None else given.frame
    path.camera(first + drawn - 1)  # raises now, not after minutes
    frames = list_frames(
        first,
        given.frames,
        len(path),
        stride=given.stride,
        warm_up=given.warm_up,
        teleport=given.teleport,
    )
    emulated = [kind == "emulated" for kind in given.queries]
    with rhi.create_device(given.backend) as device, Renderer(device, scene, size=given.size) as renderer:
        names = given.algorithms or [
            name for name in list_algorithms(device) if name != "conditional" or not emulated[0]
        ]
        for name in names:
            check_algorithm(name, device, "compare visibility")
        contenders = list_contenders(names, settings, tuned, emulated)
        rows = compare_algorithms(renderer, contenders, path, show_progress(frames, len(frames), "compare"))
        report = {
            "backend": device.backend_name,
            "device": device.capabilities.device,
            "scene": scene.name,
            "camera_path": given.camera_path,
            "first_frame": first + given.warm_up,
            "frames": given.frames,
            "stride": given.stride,
            "warm_up": given.warm_up,
            "teleport": given.teleport,
            "size": list(given.size),
            "queries": given.queries,
            "settings": asdict(settings),
            "optimized": None if tuned is None else asdict(tuned),
            "rows": [asdict(row) for row in rows],
        }
    if given.plot is not None:
        plot_algorithms(rows, f"{scene.name}, {given.camera_path}, {report['device']}", given.plot)
        note(f"wrote {given.plot}")
    if given.json:
        print_report(report, scene)
    else:
        print(show_rows(rows, markdown=given.markdown))


def show_rows(rows: list[AlgorithmRow], *, markdown: bool = False) -> str:
    """Format the rows as a table: aligned text, or Markdown."""
    shown = [asdict(row) for row in rows]
    if not any(row.simulation_steps or row.skipped_simulations for row in rows):
        for values in shown:
            del values["simulation_steps"], values["skipped_simulations"]
    return format_rows(shown, markdown=markdown)


def plot_algorithms(rows: list[AlgorithmRow], title: str, path: Path) -> None:
    """Write a chart of times and triangles, with a bar for each algorithm."""
    with draw_chart(path, title) as figure:
        names = [row.algorithm for row in rows]
        charts: list[tuple[str, list[float], str]] = [
            ("milliseconds a frame", [row.milliseconds for row in rows], "{:,.1f}"),
            ("triangles a frame", [row.triangles for row in rows], "{:,}"),
        ]
        for place, (label, values, form) in enumerate(charts, 1):
            axes = figure.add_subplot(1, len(charts), place)
            bars = axes.barh(names, values, color="#4477aa")
            axes.bar_label(bars, labels=[form.format(value) for value in values], padding=3)
            axes.set_xlabel(label)
            axes.xaxis.set_major_formatter("{x:,.0f}")
            axes.locator_params(axis="x", nbins=5)
            axes.margins(x=0.3)
            axes.invert_yaxis()


def _parse_kinds(text: str) -> list[str]:
    kinds = text.split(",")
    for kind in kinds:
        if kind not in QUERY_KINDS:
            raise argparse.ArgumentTypeError(
                f"{kind!r} is not a kind of query; give native, emulated or native,emulated"
            )
    return [kind for kind in QUERY_KINDS if kind in kinds]


COMMAND: Final = Subcommand(
    "visibility", "compare visibility algorithms along a camera path", _add_arguments, _run, _NOTES
)
