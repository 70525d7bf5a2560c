"""`compare encodings`: what the encodings of a geometry buffer lose, and what they cost.

  python -m renderer compare encodings
  python -m renderer compare encodings --backend cl --json
  python -m renderer compare encodings --plot encodings.png
  python -m renderer compare encodings --image patches.png

Each device stores and reads random values. Errors are those against the values in float64: for directions the
angle, for derivatives the difference of the vectors in percent of their length, for texture coordinates
millionths of a repetition, for positions millionths of the distance along the view, or pixels beside their
place in the image. Times are for encoding and decoding one value, on all cores together; they are medians.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

from renderer.cli import options
from renderer.cli.comparison import ComparisonProgram, Report, repeat
from renderer.cli.options import option
from renderer.cli.output import note, open_available_devices, prepare_image, show_progress, write_image
from renderer.lab.comparison import Record
from renderer.lab.comparisons.encoding_comparison import compare_encodings
from renderer.lab.measure.encoding_errors import ENCODINGS
from renderer.lab.measure.normal_patches import draw_patches

_OPTIONS: Final = (
    option("--backend", "gl or cl", None, "all devices here that run shaders", metavar="NAME"),
    options.count("--count", "number of values", 1 << 14),
    options.rounds("times each is timed"),
    options.output_file("--plot", "write a chart of errors and times", "FILE"),
    options.output_file(
        "--image", "write a highlight drawn from normals of 8 bits, of 16, and from none that are stored"
    ),
    *options.form(),
)


def _measure(arguments: argparse.Namespace) -> Report:
    if arguments.image is not None:
        prepare_image(arguments.image, "--image")
    with ExitStack() as stack:
        devices = open_available_devices(
            stack, ("gl", "cl") if arguments.backend is None else (arguments.backend,)
        )
        rows = compare_encodings(
            devices,
            ENCODINGS,
            count=arguments.count,
            rounds=arguments.rounds,
            progress=partial(show_progress, task="store"),
        )
        names = {device.backend_name: device.capabilities.device for device in devices}
        if arguments.image is not None:
            patches = draw_patches(devices[0])
            write_image(arguments.image, patches.join())
            errors = [
                f"{levels} of 255 with {bits} bits" for bits, levels in patches.measure_errors().items()
            ]
            note(f"wrote {arguments.image}: at most {', '.join(errors)} from the exact image")
    return Report({"devices": names} | repeat(arguments, "count"), rows, "Encodings of a geometry buffer")


def add_device_columns(rows: Sequence[Record]) -> Sequence[Record]:
    """Round errors, and give each device a column."""
    errors = {"mean_error": ".2g", "max_error": ".3g"}
    return [
        {name: row[name] for name in ("name", "stores", "bits")}
        | {name: f"{row[name]:{form}}" for name, form in errors.items()}
        | {"unit": row["unit"]}
        | {f"ns, {name}": time for name, time in row["nanoseconds"].items()}
        for row in rows
    ]


def plot_rows(figure: Any, rows: Sequence[Record]) -> None:
    """Draw the errors of normals over their bits, and the times of all encodings."""
    errors, times = figure.subplots(1, 2, gridspec_kw={"width_ratios": [2, 3]})
    lines: dict[str, list[Record]] = {}
    for row in rows:
        if row["stores"] == "normal":
            lines.setdefault(row["name"].partition(", ")[2], []).append(row)
    for name, encoding_rows in lines.items():
        bits = [row["bits"] // 2 for row in encoding_rows]
        (line,) = errors.plot(bits, [row["max_error"] for row in encoding_rows], marker="o", label=name)
        errors.plot(
            bits, [row["mean_error"] for row in encoding_rows], linestyle="dotted", color=line.get_color()
        )
    errors.set(yscale="log", xlabel="bits of each number", ylabel="degrees: largest, and dotted the mean")
    errors.legend()
    for number, name in enumerate(rows[0]["nanoseconds"]):
        positions = [row_index + 0.4 * number for row_index in range(len(rows))]
        times.barh(positions, [row["nanoseconds"][name] for row in rows], height=0.4, label=name)
    times.set_yticks(
        [row_index + 0.2 for row_index in range(len(rows))], [row["name"] for row in rows], fontsize=6
    )
    times.invert_yaxis()
    times.set(xlabel="ns to encode and decode a value")
    times.legend()


COMMAND: Final = ComparisonProgram(
    "encodings",
    "compare the encodings of a geometry buffer",
    __doc__,
    _OPTIONS,
    _measure,
    titles={"name": "encoding", "unit": ""},
    display_rows=add_device_columns,
    plot=plot_rows,
).command
