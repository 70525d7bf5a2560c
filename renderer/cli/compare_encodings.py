"""`compare encodings`: what the encodings of a geometry buffer lose, and what they cost."""

from __future__ import annotations

import argparse
import json
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Final

from renderer.cli import options
from renderer.cli.options import option
from renderer.cli.output import draw_chart, note, open_working, prepare_chart, show_progress
from renderer.cli.subcommand import Subcommand
from renderer.lab.measure import format_table
from renderer.lab.measure.encodings import ENCODINGS, EncodingRow, compare_encodings

_NOTES: Final = """\
  python -m renderer compare encodings
  python -m renderer compare encodings --backend cl --json
  python -m renderer compare encodings --plot encodings.png

Each device stores and reads random values. Errors are those against the values in float64: for directions the angle,
for derivatives the difference of the vectors in percent of their length, for texture coordinates millionths of a
repetition, for positions millionths of the distance along the view, or pixels beside their place in the image. Times
are for encoding and decoding one value, on all cores together; they are medians."""


_OPTIONS: Final = (
    option("--backend", "gl or cl", None, "all devices here that run shaders", metavar="NAME"),
    options.count("--count", "number of values", 1 << 14),
    options.rounds("times each is timed"),
    options.file("--plot", "write a chart of errors and times", "FILE"),
    *options.form(),
)


def _run(given: argparse.Namespace) -> None:
    path = prepare_chart(given.plot) if given.plot else None
    with ExitStack() as made:
        devices = open_working(made, ("gl", "cl") if given.backend is None else (given.backend,))
        rows = compare_encodings(
            devices,
            ENCODINGS,
            count=given.count,
            rounds=given.rounds,
            progress=lambda rounds: show_progress(rounds, len(rounds), "store"),
        )
        names = {device.backend_name: device.capabilities.device for device in devices}
    if path is not None:
        plot_rows(rows, path)
        note(f"wrote {path}")
    report = {"devices": names, "count": given.count, "rows": [asdict(row) for row in rows]}
    print(json.dumps(report) if given.json else show_rows(rows, markdown=given.markdown))


def show_rows(rows: list[EncodingRow], *, markdown: bool = False) -> str:
    """Format the rows as a table: aligned text, or Markdown."""
    backends = list(rows[0].nanoseconds)
    header = ["encoding", "stores", "bits", "mean error", "max error", "", *(f"ns, {name}" for name in backends)]
    cells = [
        [
            row.name,
            row.stores,
            row.bits,
            f"{row.mean_error:.2g}",
            f"{row.max_error:.3g}",
            row.unit,
            *row.nanoseconds.values(),
        ]
        for row in rows
    ]
    return format_table(header, cells, markdown=markdown)


def plot_rows(rows: list[EncodingRow], path: Path) -> None:
    """Draw the errors of normals over their bits, and the times of all encodings."""
    with draw_chart(path, "Encodings of a geometry buffer") as figure:
        errors, times = figure.subplots(1, 2, gridspec_kw={"width_ratios": [2, 3]})
        lines: dict[str, list[EncodingRow]] = {}
        for row in rows:
            if row.stores == "normal":
                lines.setdefault(row.name.partition(", ")[2], []).append(row)
        for name, some in lines.items():
            bits = [row.bits // 2 for row in some]
            (line,) = errors.plot(bits, [row.max_error for row in some], marker="o", label=name)
            errors.plot(bits, [row.mean_error for row in some], linestyle="dotted", color=line.get_color())
        errors.set(yscale="log", xlabel="bits of each number", ylabel="degrees: largest, and dotted the mean")
        errors.legend()
        backends = list(rows[0].nanoseconds)
        for number, name in enumerate(backends):
            places = [place + 0.4 * number for place in range(len(rows))]
            times.barh(places, [row.nanoseconds[name] for row in rows], height=0.4, label=name)
        times.set_yticks([place + 0.2 for place in range(len(rows))], [row.name for row in rows], fontsize=6)
        times.invert_yaxis()
        times.set(xlabel="ns to encode and decode a value")
        times.legend()


COMMAND: Final = Subcommand("encodings", "compare the encodings of a geometry buffer", _OPTIONS, _run, _NOTES)
