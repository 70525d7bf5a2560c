"""The tables of the thesis's chapter 7 over a whole camera path, its figures beside ours, and its Figure 7.7
or 7.8.

The frames are 60, 30 apart, of the path's 1,800: the same ones on all our platforms, each after some that
aren't counted. On each platform all algorithms draw each frame in turn, with native and with emulated
queries, and CHC++ also with the platform's own parameters (`benchmarks/settings`, written by `python -m
renderer tune`).

    python benchmarks/thesis_tables.py ground|sky [--backends gl,cl] [--figure F.png] [--into
    docs/measurements/visibility-tables.md]

It prints Markdown: times as ratios to no culling on all platforms, shares of what other algorithms draw and
query, and for each platform its counts, each beside the thesis's, and which kernels drew. `--into` also
replaces the page's section between the path's two markers, and writes the figure beside the page. `--save`
keeps the results; `--load` prints kept ones.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from textwrap import fill
from typing import Any, Final

sys.path.insert(0, str(Path(__file__).parents[1]))

from renderer.cli.compare_visibility import COMMAND, measure_visibility
from renderer.cli.options import add_options, parse_count, parse_frame, size
from renderer.cli.output import draw_chart
from renderer.cli.subcommand import Parser
from renderer.lab.measure import format_table
from renderer.scene import FRAME_COUNT

SETTINGS: Final = Path(__file__).parent / "settings"

MARKS: Final = ("", " (emulated)")
"""The word behind an algorithm's name, by kind of queries."""

PLATFORMS: Final = ("PC", "Xbox 360", "PlayStation 3", "Wii")

_THESIS: Final = json.loads(Path(__file__).with_name("thesis.json").read_text(encoding="utf-8"))
TIMES: Final[dict[str, dict[str, list[float | None]]]] = _THESIS["milliseconds"]
"""The thesis's milliseconds on its platforms (Tables 7.1 to 7.4); None where it gives none."""

COUNTED: Final = ("triangles", "draws", "queries", "software_state_changes", "hardware_state_changes")

COUNTS: Final[dict[str, dict[str, list[int]]]] = _THESIS["counts"]
"""The thesis's counts on its PC (Table 7.1), and of optimized CHC++ on its Xbox 360 (Table 7.2): on the PC
there are none."""


def measure(arguments: argparse.Namespace, backend: str) -> dict[str, Any]:
    """Compare the algorithms on one backend, as `compare visibility` does, and return what it reports as
    JSON."""
    stride = FRAME_COUNT // arguments.frames
    asked = {
        "camera-path": arguments.path,
        "frame": (stride - 1 - arguments.warm_up) // 2,
        "frames": arguments.frames,
        "stride": stride,
        "warm-up": arguments.warm_up,
        "size": "{}x{}".format(*arguments.size),
        "backend": backend,
        "queries": "native,emulated",
        "settings": SETTINGS / f"{backend}.json",
    }
    parser = Parser()
    add_options(parser, COMMAND.options)
    report = measure_visibility(
        parser.parse_args(["city", *(f"--{name}={value}" for name, value in asked.items())])
    )
    return {**report.metadata, "rows": report.rows}


def rows_by_algorithm(report: dict[str, Any]) -> dict[str, Any]:
    """Return the rows of a report by the names of their algorithms."""
    return {row["algorithm"]: row for row in report["rows"]}


RATIOS: Final = (
    ("triangles", "chc", "frustum"),
    ("triangles", "chc_plus_plus", "frustum"),
    ("triangles", "optimized_chc_plus_plus", "frustum"),
    ("queries", "chc", "stop_and_wait"),
    ("queries", "chc_plus_plus", "stop_and_wait"),
    ("queries", "optimized_chc_plus_plus", "stop_and_wait"),
    ("hardware_state_changes", "chc_plus_plus", "chc"),
)
"""(counter, algorithm, the algorithm that it is compared with)"""


def format_ratios(path: str, reports: list[dict[str, Any]]) -> str:
    """Return the table of an algorithm's counts as shares of another's, on our platforms and in the
    thesis."""
    header = ["share", *(report["backend"] + mark for report in reports for mark in MARKS), "thesis"]
    cells = []
    for counter, name, other in RATIOS:
        label = f"{counter.replace('_', ' ')}: {name} of {other}"
        line = [label]
        for rows in map(rows_by_algorithm, reports):
            for mark in MARKS:
                base = rows[other + mark if other + mark in rows else other]
                line.append(f"{rows[name + mark][counter] / base[counter]:.2f}")
        column = COUNTED.index(counter)
        line.append(f"{COUNTS[path][name][column] / COUNTS[path][other][column]:.2f}")
        cells.append(line)
    return format_table(header, cells, markdown=True)


def format_times(path: str, reports: list[dict[str, Any]]) -> str:
    """Return the table of times, as ratios to no culling, on our platforms and on the thesis's."""
    names = list(
        dict.fromkeys(name.partition(" ")[0] for report in reports for name in rows_by_algorithm(report))
    )
    header, cells = ["algorithm"], [[name] for name in names]
    for report in reports:
        for mark in MARKS:
            header.append(report["backend"] + mark)
            for name, line in zip(names, cells, strict=True):
                row = rows_by_algorithm(report).get(name + mark)
                line.append("" if row is None else f"{row['ratio']:.2f}")
    header += PLATFORMS
    base = TIMES[path]["none"]
    for name, line in zip(names, cells, strict=True):
        published = TIMES[path].get(name, [None] * len(PLATFORMS))
        line += [
            "" if time is None else f"{time / of:.2f}" for time, of in zip(published, base, strict=True) if of
        ]
    return format_table(header, cells, markdown=True)


def format_counts(path: str, report: dict[str, Any]) -> str:
    """Return the table of counts of one of our platforms, each beside the thesis's."""
    header = ["algorithm", "ms"]
    for name in COUNTED:
        header += [name.replace("_", " ").replace(" changes", "s"), "thesis"]
    header += ["wrong pixels", "tied pixels", "stalled ms", "kernels"]
    cells: list[list[object]] = []
    for name, row in rows_by_algorithm(report).items():
        line: list[object] = [name, row["milliseconds"]]
        published = COUNTS[path].get(name.partition(" ")[0], [])
        for column, counted in enumerate(COUNTED):
            line += [row[counted], published[column] if column < len(published) else ""]
        cells.append(
            [
                *line,
                row["wrong_pixels"],
                row["tied_pixels"],
                row["stalled_milliseconds"],
                row["kernels"] or "",
            ]
        )
    return format_table(header, cells, markdown=True)


def plot(path: str, reports: list[dict[str, Any]], file: Path) -> None:
    """Write the thesis's Figure 7.7 or 7.8: frustum culling and CHC++ on all platforms."""
    groups: list[tuple[str, list[float]]] = []
    algorithms = ("frustum", "chc_plus_plus", "optimized_chc_plus_plus")
    for report in reports:
        for mark in MARKS:
            rows = rows_by_algorithm(report)
            compared = [rows["frustum"], *(rows[name + mark] for name in algorithms[1:])]
            groups.append((f"{report['backend']}{mark}", [row["ratio"] for row in compared]))
    for index, platform in enumerate(PLATFORMS):
        times = [TIMES[path][name][index] for name in ("none", *algorithms)]
        assert times[0] is not None
        groups.append((platform, [float("nan") if time is None else time / times[0] for time in times[1:]]))
    with draw_chart(file, f"{path} level: time as a ratio to no culling") as figure:
        axes = figure.add_subplot()
        for index, (name, color) in enumerate(
            zip(algorithms, ("#bbbbbb", "#4477aa", "#66ccee"), strict=True)
        ):
            bars = axes.bar(
                [at + 0.27 * index for at in range(len(groups))],
                [g[1][index] for g in groups],
                0.25,
                label=name,
                color=color,
            )
            axes.bar_label(bars, fmt=lambda value: f"{value:.2f}" if value == value else "", fontsize="small")
        axes.axhline(1.0, color="grey", linewidth=0.8)
        axes.set_xticks(
            [at + 0.27 for at in range(len(groups))], [name.replace(" (", "\n(") for name, _ in groups]
        )
        axes.margins(y=0.15)
        axes.legend(fontsize="small")


def describe(path: str, reports: list[dict[str, Any]]) -> str:
    """Return all tables as Markdown."""
    first = reports[0]
    width, height = first["size"]
    intro = (
        f"City, {width} × {height}, {first['frames']} frames of the path, {first['stride']} apart from frame "
        f"{first['first_frame']} on, each after {first['warm_up']} that aren't counted. Times are ratios to "
        "no culling:"
    )
    parts = [
        fill(intro, 118),
        format_times(path, reports),
        "Shares of what another algorithm draws or queries:",
        format_ratios(path, reports),
    ]
    for report in reports:
        b, n = report["optimized"]["batch"], report["optimized"]["persistence"]
        parts += [
            f"{report['backend']} ({report['device']}; optimized: b = {b}, n = {n}):",
            "<!-- table: ground level -->\n" * (path == "ground" and report["backend"] == "gl")
            + format_counts(path, report),
        ]
    return "\n\n".join(parts)


def insert(page: Path, path: str, text: str) -> None:
    """Replace the page's section between the path's two markers."""
    begin, end = f"<!-- thesis_tables.py {path} -->\n", "\n<!-- end of thesis_tables.py -->"
    before, marker, rest = page.read_text(encoding="utf-8").partition(begin)
    if not marker:
        raise SystemExit(f"error: {page} has no line {begin.strip()}")
    after = rest.partition(end)[2]
    page.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")


def main() -> None:
    parser = Parser(prog="thesis_tables.py", description=__doc__)
    parser.add_argument("path", choices=TIMES)
    parser.add_argument("--backends", default="gl,cl", help="our platforms (default: %(default)s)")
    parser.add_argument(
        "--frames", type=parse_count, default=60, help="counted frames (default: %(default)s)"
    )
    parser.add_argument(
        "--warm-up", type=parse_frame, default=4, help="frames before each (default: %(default)s)"
    )
    parser.add_argument("--size", **size().keywords)
    parser.add_argument("--figure", type=Path, metavar="F.png", help="write the figure")
    parser.add_argument(
        "--into", type=Path, metavar="PAGE.md", help="replace the tables and the figure of this page"
    )
    parser.add_argument("--save", type=Path, metavar="F.json", help="keep the results")
    parser.add_argument("--load", type=Path, nargs="+", metavar="F.json", help="print these results")
    arguments = parser.parse_args()
    os.environ.setdefault("RHI_KERNELS", "optimised")  # as a long run has them
    if arguments.load is not None:
        reports = [
            report for file in arguments.load for report in json.loads(file.read_text(encoding="utf-8"))
        ]
    else:
        reports = [measure(arguments, backend) for backend in arguments.backends.split(",")]
    if arguments.save is not None:
        arguments.save.write_text(json.dumps(reports, indent=1) + "\n", encoding="utf-8")
    text = describe(arguments.path, reports)
    print(text)
    if arguments.figure is not None:
        plot(arguments.path, reports, arguments.figure)
    if arguments.into is not None:
        image = f"images/{arguments.path}-level.png"
        plot(arguments.path, reports, arguments.into.parent / image)
        caption = f"Frustum culling and CHC++ at {arguments.path} level on all platforms"
        insert(arguments.into, arguments.path, f"![{caption}]({image})\n\n{text}")


if __name__ == "__main__":
    main()
