"""`effect-costs`: what each effect adds to a frame, and that removing it takes exactly this away.

  python -m renderer effect-costs
  python -m renderer effect-costs --effect shadow --effect glass --backend gl --rounds 100
  python -m renderer effect-costs --backend gl --backend cl --output docs

Effect steps are scenes, each with one effect more than the one before. Counts are those of a null device, so
no GPU is needed, and are the same everywhere. With --backend, times of the processor are measured in
alternation, too, with 95 % intervals: what an effect adds, and the time of a frame from which it was removed
as a multiple of that of one that never had it. The exit code is 1 if an effect costs something in scenes
without it, or leaves something behind. With --output DIR, the page effect-costs.md and the image
images/effect-costs.webp are written to DIR.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

import rhi
from renderer.cli import options
from renderer.cli.options import option
from renderer.cli.output import OutputError, draw_chart, note, show_progress
from renderer.cli.subcommand import Subcommand
from renderer.lab.effect_costs import (
    EFFECT_STEPS,
    SIZE,
    EffectRow,
    StepRenderer,
    count_effect_costs,
    format_added,
    format_removed,
    list_steps_named,
    time_effect_collection,
    time_effect_costs,
)

_PAGE: Final = Path(__file__).with_name("effect_costs_page.md")
"""The text of `docs/measurements/effect-costs.md`, around the tables that are measured."""
_COLUMNS: Final = 4
_SIZE: Final = (640, 360)
"""The size of the images in pixels; counts and times are those of smaller frames."""
_SHOWN_FRAME: Final = 60
"""The number of the frame in images: by then the fountain is full."""


_EFFECTS: Final = [step.name for step in EFFECT_STEPS]
_OPTIONS: Final = (
    option(
        "--effect",
        "only this effect step; may be repeated",
        [],
        f"all, {', '.join(_EFFECTS)}",
        action="append",
        choices=_EFFECTS,
        metavar="NAME",
    ),
    option(
        "--backend",
        "time frames on this backend, too; may be repeated",
        [],
        "only counts",
        action="append",
        metavar="NAME",
    ),
    options.rounds("frames of each effect step that are timed", 40),
    options.output_folder("--output", "where the page and its image go"),
    *options.form("tables"),
)


def _run(arguments: argparse.Namespace) -> None:
    numbers = list_steps_named(arguments.effect)
    rows = count_effect_costs(show_progress(numbers, "counting"))
    for name in arguments.backend:
        with rhi.create_device(name) as device:
            time_effect_costs(rows, device, arguments.rounds, show_progress)
    if arguments.output is not None:
        _write_page(arguments.output, rows, arguments.backend, arguments.rounds)
    if arguments.json:
        print(json.dumps([asdict(row) for row in rows]))
    else:
        tables = (
            format_added(rows, markdown=arguments.markdown),
            format_removed(rows, markdown=arguments.markdown),
        )
        print("\n\n".join(tables))
    faults = [f"{row.name}: {fault}" for row in rows for fault in row.faults]
    if faults:
        note("\n".join(faults))
        sys.exit(1)


def _write_page(folder: Path, rows: Sequence[EffectRow], backends: Sequence[str], rounds: int) -> None:
    (folder / "images").mkdir(parents=True, exist_ok=True)
    arguments_text = "".join(
        f" --effect {row.name!r}" if " " in row.name else f" --effect {row.name}" for row in rows
    )
    arguments_text = ("" if len(rows) == len(EFFECT_STEPS) else arguments_text) + "".join(
        f" --backend {name}" for name in backends
    )
    if rounds != 40:
        arguments_text += f" --rounds {rounds}"
    image_path = folder / "images" / "effect-costs.webp"
    draw_steps(image_path, rows)
    page = _PAGE.read_text(encoding="utf-8").format(
        size="{} × {}".format(*SIZE),
        collection_time=_describe_effect_collection(backends or ("null",), rounds),
        command=f"python -m renderer effect-costs{arguments_text} --output docs",
        added=format_added(rows, markdown=True),
        removed=format_removed(rows, markdown=True),
    )
    (folder / "effect-costs.md").write_text(page, encoding="utf-8")
    note(f"wrote {folder / 'effect-costs.md'} and {image_path}")


def _describe_effect_collection(backends: Sequence[str], rounds: int) -> str:
    """Describe how long it takes to collect a frame's effects, on each backend."""
    parts = []
    for name in backends:
        with rhi.create_device(name) as device:
            times = time_effect_collection(device, rounds)
        parts.append(
            f"{times.microseconds.median:.0f} µs, {100.0 * times.fraction.median:.1f} % "
            f"of a frame of the box on {name} "
            f"({100.0 * times.fraction.low:.1f} to {100.0 * times.fraction.high:.1f} %)"
        )
    return ", ".join(parts)


def draw_steps(path: Path, rows: Sequence[EffectRow]) -> None:
    """Draw an image of each effect step, with what it adds."""
    images = _render(list_steps_named([row.name for row in rows]))
    lines = -(-len(images) // _COLUMNS)
    with draw_chart(path) as figure:
        figure.set_size_inches(3.3 * _COLUMNS, 2.25 * lines)
        for index, (row, image) in enumerate(zip(rows, images, strict=True), 1):
            axes = figure.add_subplot(lines, _COLUMNS, index)
            axes.imshow(image)
            axes.set_axis_off()
            axes.set_title(f"{row.name}: {row.description}", fontsize=8)


def _render(numbers: Iterable[int]) -> list[NDArray[Any]]:
    """Render an image of each effect step, with the first backend that draws here."""
    for name in ("gl", "cl"):
        try:
            device = rhi.create_device(name)
        except rhi.DeviceError:
            continue
        with device:
            images = []
            for number in numbers:
                step_renderer = StepRenderer(device, number + 1, _SIZE)
                step_renderer.frame = _SHOWN_FRAME
                step_renderer.render(2)
                images.append(step_renderer.read())
                step_renderer.destroy()
            return images
    raise OutputError("--output: no backend here draws images")


COMMAND: Final = Subcommand(
    "effect-costs",
    "measure what each effect adds to a frame, and what its removal takes away",
    _OPTIONS,
    _run,
    __doc__,
)
