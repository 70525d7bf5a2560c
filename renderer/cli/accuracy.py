"""`accuracy`: what accuracy costs in time, knob by knob."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from typing import Final

import rhi
from renderer import rules
from renderer.accuracy import KNOBS, KnobReport, Situation, SweepJob, run_jobs
from renderer.cli.arguments import (
    add_backend,
    add_form,
    add_rounds,
    add_scene,
    add_settings,
    add_size,
    parse_count,
)
from renderer.cli.executors import add_executor, make_executor
from renderer.cli.output import note, show_progress
from renderer.cli.subcommand import Parser, Subcommand
from renderer.content import load_scene
from renderer.measure import format_table
from renderer.settings import RenderSettings, to_plain
from rhi import refuse

_NOTES: Final = """\
  python -m renderer accuracy city
  python -m renderer accuracy city --knob precision --knob samples --backend cl
  python -m renderer accuracy hall:shadows=1 --knob shadow_size --json

A knob is a choice between accuracy and time. Each of its values draws the same frames, and is compared with the truth
of the knob: float64, super-sampling, brute force, or the exact algorithm. Then all values are timed in turn in one
process. `ratio` is a value's time in that of the most accurate one, the median of the rounds' ratios, by the clock and
by the processor, with the ends of its 95 % confidence interval. A knob that needs what the scene or the device lacks is
left out, and why is said on stderr. Shadows are switched on for the knobs of shadows."""


def _add_arguments(parser: Parser) -> None:
    add_scene(parser)
    parser.add_argument(
        "--knob", action="append", default=[], metavar="K", help=f"only this one; repeatable. {', '.join(KNOBS)}"
    )
    add_backend(parser)
    parser.add_argument(
        "--camera", default="", metavar="CAMERA", help="a path, a walk-through or a view (default: ground, or a view)"
    )
    add_size(parser, (480, 270))
    parser.add_argument(
        "--views", type=parse_count, default=3, metavar="N", help="frames that are compared (default: %(default)s)"
    )
    add_rounds(parser, "frames that are timed", 15)
    add_settings(parser, "settings to begin with, written by `accuracy` or `tune`")
    add_executor(parser, "knobs")
    add_form(parser)


def _run(given: argparse.Namespace) -> None:
    for name in given.knob:
        if name not in KNOBS:
            rules.refuse_name(rules.UNKNOWN_KNOB, "accuracy --knob", name, KNOBS)
    load_scene(given.scene)  # raises now, not in another process
    settings = RenderSettings() if given.settings is None else RenderSettings.load(given.settings)
    with rhi.create_device(given.backend) as device:
        backend = device.backend_name
    situation = Situation(
        given.scene, given.camera, backend, given.size, views=given.views, rounds=given.rounds, settings=settings
    )
    jobs = [SweepJob(situation, name) for name in dict.fromkeys(given.knob or KNOBS)]
    with make_executor(given.executor) as executor:
        reports = run_jobs(jobs, executor, None, lambda items, total: show_progress(items, total, "accuracy"))
    for report in reports:
        for value, lack in report.left_out.items():
            note(f"left out: {report.knob}: {value}: {lack}")
    shown = [report for report in reports if report.rows]
    if not shown:
        refuse(rules.NO_KNOBS, "accuracy", ", ".join(job.knob for job in jobs))
    if given.json:
        print(json.dumps(describe(situation, shown)))
    else:
        print(show_reports(shown, markdown=given.markdown))


def describe(situation: Situation, reports: list[KnobReport]) -> dict[str, object]:
    """Return what `--json` prints."""
    return {
        **to_plain(replace(situation, size=situation.size)),
        "knobs": [{**asdict(report), "truth": KNOBS[report.knob].truth.name, "pictures": None} for report in reports],
    }


def show_reports(reports: list[KnobReport], *, markdown: bool = False) -> str:
    """Format the rows of all knobs as a table."""
    header = ["knob", "value", "mean error", "max error", "unit", "ms", "ratio", "processor", "default"]
    rows: list[list[object]] = []
    for report in reports:
        for row in report.rows:
            rows.append(
                [
                    row.knob, row.value, f"{row.mean_error:.4g}", f"{row.max_error:.4g}", row.unit,
                    f"{row.milliseconds:.3g}", show_ratio(row.ratio, row.low, row.high),
                    show_ratio(row.processor_ratio, row.processor_low, row.processor_high),
                    "default" if row.is_default else "",
                ]
            )  # fmt: skip
    return format_table(header, rows, markdown=markdown)


def show_ratio(ratio: float, low: float, high: float) -> str:
    """Format a ratio with its confidence interval."""
    return f"{ratio:.2f} ({low:.2f} to {high:.2f})" if (low, high) != (ratio, ratio) else f"{ratio:.2f}"


COMMAND: Final = Subcommand(
    "accuracy", "show what accuracy costs in time: error and time of each choice", _add_arguments, _run, _NOTES
)
