"""`need`: what each effect adds to a frame, and that removing it takes exactly this away.

  python -m renderer need
  python -m renderer need --rung shadow --rung glass --backend gl --rounds 100
  python -m renderer need --backend gl --backend cl --output docs

A ladder of scenes, each of which has one effect more than the one before. Counts are those of a null device, so no
GPU is needed, and are the same everywhere. With --backend, times of the processor are measured in alternation, too,
with 95 % intervals: what an effect adds, and the time of a frame from which it was removed as a multiple of that of
one that never had it. The exit code is 1 if an effect costs something where it isn't, or leaves something behind.
With --output DIR, the page need.md and the picture images/need.png are written to DIR.
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
from renderer.lab.need import (
    LADDER,
    SIZE,
    Ascent,
    RungRow,
    count_need,
    find_rungs,
    show_added,
    show_removed,
    time_asking,
    time_need,
)

_PAGE: Final = Path(__file__).with_name("need_page.md")
"""The text of `docs/need.md`, around the tables that are measured."""
_COLUMNS: Final = 4
_SIZE: Final = (640, 360)
"""The size of the pictures; counts and times are those of smaller frames."""
_SHOWN: Final = 60
"""The number of the frame that pictures show: by then the fountain is full."""


_RUNGS: Final = [rung.name for rung in LADDER]
_OPTIONS: Final = (
    option("--rung", "only this rung; may be repeated", [], f"all, {', '.join(_RUNGS)}", action="append",
           choices=_RUNGS, metavar="NAME"),
    option("--backend", "time frames on this backend, too; may be repeated", [], "only counts", action="append",
           metavar="NAME"),
    options.rounds("frames of each rung that are timed", 40),
    options.file("--output", "where the page and its picture go", "DIR"),
    *options.form("tables"),
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    numbers = find_rungs(given.rung)
    rows = count_need(show_progress(numbers, "counting"))
    for name in given.backend:
        with rhi.create_device(name) as device:
            time_need(rows, device, given.rounds, show_progress)
    if given.output is not None:
        _write_page(given.output, rows, given.backend, given.rounds)
    if given.json:
        print(json.dumps([asdict(row) for row in rows]))
    else:
        tables = show_added(rows, markdown=given.markdown), show_removed(rows, markdown=given.markdown)
        print("\n\n".join(tables))
    faults = [f"{row.name}: {fault}" for row in rows for fault in row.faults]
    if faults:
        note("\n".join(faults))
        sys.exit(1)


def _write_page(folder: Path, rows: Sequence[RungRow], backends: Sequence[str], rounds: int) -> None:
    (folder / "images").mkdir(parents=True, exist_ok=True)
    asked = "".join(f" --rung {row.name!r}" if " " in row.name else f" --rung {row.name}" for row in rows)
    asked = ("" if len(rows) == len(LADDER) else asked) + "".join(f" --backend {name}" for name in backends)
    if rounds != 40:
        asked += f" --rounds {rounds}"
    picture = folder / "images" / "need.png"
    draw_ladder(picture, rows)
    page = _PAGE.read_text(encoding="utf-8").format(
        size="{} × {}".format(*SIZE),
        asking=_describe_asking(backends or ("null",), rounds),
        command=f"python -m renderer need{asked} --output docs",
        added=show_added(rows, markdown=True),
        removed=show_removed(rows, markdown=True),
    )
    (folder / "need.md").write_text(page, encoding="utf-8")
    note(f"wrote {folder / 'need.md'} and {picture}")


def _describe_asking(backends: Sequence[str], rounds: int) -> str:
    """Say how long it takes to find what frames need, on each backend."""
    said = []
    for name in backends:
        with rhi.create_device(name) as device:
            asking = time_asking(device, rounds)
        said.append(
            f"{asking.microseconds.median:.0f} µs, {100.0 * asking.share.median:.1f} % of a frame of the box on {name} "
            f"({100.0 * asking.share.low:.1f} to {100.0 * asking.share.high:.1f} %)"
        )
    return ", ".join(said)


def draw_ladder(path: Path, rows: Sequence[RungRow]) -> None:
    """Draw a picture of each rung, with what it adds."""
    pictures = _render(find_rungs([row.name for row in rows]))
    lines = -(-len(pictures) // _COLUMNS)
    with draw_chart(path) as figure:
        figure.set_size_inches(3.3 * _COLUMNS, 2.25 * lines)
        for place, (row, picture) in enumerate(zip(rows, pictures, strict=True), 1):
            axes = figure.add_subplot(lines, _COLUMNS, place)
            axes.imshow(picture)
            axes.set_axis_off()
            axes.set_title(f"{row.name}: {row.adds}", fontsize=8)


def _render(numbers: Iterable[int]) -> list[NDArray[Any]]:
    """Return a picture of each rung, drawn by the first backend that draws here."""
    for name in ("gl", "cl"):
        try:
            device = rhi.create_device(name)
        except rhi.DeviceError:
            continue
        with device:
            pictures = []
            for number in numbers:
                ascent = Ascent(device, number + 1, _SIZE)
                ascent.frame = _SHOWN
                ascent.render(2)
                pictures.append(ascent.read())
                ascent.destroy()
            return pictures
    raise OutputError("--output: no backend here draws pictures")


COMMAND: Final = Subcommand("need", "what each effect adds to a frame, and takes away", _OPTIONS, _run, __doc__)
