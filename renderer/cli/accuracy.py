"""`accuracy`: what accuracy costs in time, knob by knob.

  python -m renderer accuracy city
  python -m renderer accuracy city --knob precision --knob samples --backend cl
  python -m renderer accuracy hall:shadows=1 --knob shadow_size --json
  python -m renderer accuracy city:shadows=1 --output swept --executor processes:2
  python -m renderer accuracy city:shadows=1 --output swept --error-at-most 2
  python -m renderer render city:shadows=1 --settings swept/settings.json

A knob is a choice between accuracy and time. Each of its values draws the same frames, and is compared with the truth
of the knob: float64, super-sampling, brute force, or the exact algorithm. Then all values are timed in turn in one
process. `ratio` is a value's time in that of the most accurate one, the median of the rounds' ratios, by the clock and
by the processor, with the ends of its 95 % confidence interval. A knob that needs what the scene or the device lacks is
left out, and why is said on stderr. Shadows are switched on for the knobs of shadows.

With --output, DIR gets one page with charts and pictures, the same as JSON, and each result as soon as it is there: a
sweep that was interrupted goes on where it stopped. With --budget-ms or --error-at-most, the knobs that change pictures
of this scene are combined greedily, drawn and timed. The choice is checked by ten more views, where the mean of their
errors and four standard deviations must be within the bound, and tried in twenty others. It is written to
DIR/settings.json, which `render`, `compare techniques`, `compare visibility` and `accuracy` read with --settings; an
older one is removed before anything is measured, so none is left where the choice is refused.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any, Final

import rhi
from renderer import rules
from renderer.cli import accuracy_report, options
from renderer.cli.arguments import load_settings, open_scene
from renderer.cli.executors import KINDS, make_executor
from renderer.cli.options import option
from renderer.cli.output import OutputError, note, prepare_chart, show_progress
from renderer.cli.output import list_left_out as list_omissions
from renderer.cli.subcommand import Subcommand
from renderer.lab.accuracy import (
    KNOBS,
    CheckedChoice,
    FrontPoint,
    KnobReport,
    Situation,
    choose,
    find_choices,
    keep_front,
    leave_to_trials,
    list_jobs,
    run_jobs,
)
from renderer.lab.measure import format_table
from renderer.settings import to_plain
from renderer.viewer.budget import BudgetStep, save_steps
from rhi import RhiError, refuse

_OPTIONS: Final = (
    options.SCENE,
    option("--knob", f"only this one; repeatable. {', '.join(KNOBS)}", [], "", action="append", metavar="K"),
    options.BACKEND,
    option("--camera", "a path, a walk-through or a view", "", "ground, or a view", metavar="CAMERA"),
    options.size((480, 270)),
    options.count("--views", "frames that are compared", 3),
    options.rounds("frames that are timed", 11),
    options.settings("settings to begin with, written by `accuracy` or `tune`"),
    option("--budget-ms", "choose the most accurate settings that take at most this time for a frame",
           type=options.parse_bound, metavar="M"),
    option("--error-at-most", "choose the fastest settings with a mean error within this, in levels of 255",
           type=options.parse_bound, metavar="E"),
    options.executor("shares of knobs", KINDS),
    options.file("--plot", "write charts of errors and times"),
    options.file("--output", "folder for the results; a sweep that was interrupted goes on there", "DIR"),
    *options.form(),
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    for name in given.knob:
        if name not in KNOBS:
            rules.refuse_name(rules.UNKNOWN_KNOB, "accuracy --knob", name, KNOBS)
    scene = open_scene(given.scene)  # raises now, not in another process
    if given.plot is not None:
        prepare_chart(given.plot)
    with rhi.create_device(given.backend) as device:
        backend = device.backend_name
    situation = Situation(
        given.scene,
        given.camera,
        backend,
        given.size,
        views=given.views,
        rounds=given.rounds,
        settings=load_settings(given),
    )
    is_bounded = given.budget_ms is not None or given.error_at_most is not None
    answer = (given.output or Path()) / "settings.json"
    if is_bounded:
        clear_answer(answer, given.settings)
    jobs = list_jobs(situation, dict.fromkeys(given.knob or KNOBS))
    folder = None if given.output is None else given.output / "jobs"
    with make_executor(given.executor) as executor:
        reports = run_jobs(jobs, executor, folder, lambda items, total: show_progress(items, "accuracy", total))
    for line in list_left_out(reports):
        note(f"left out: {line}")
    shown = [report for report in reports if report.rows]
    if not shown:
        refuse(rules.NO_KNOBS, "accuracy", ", ".join(report.knob for report in reports))
    points, choice = list[FrontPoint](), None
    if is_bounded or (given.output is not None and find_choices(scene, situation.settings, shown)):
        points = keep_front(situation, shown, folder, partial(show_progress, what="combine knobs"))
    refusal: RhiError | None = None
    if is_bounded:
        try:
            choice = choose(situation, points, budget_ms=given.budget_ms, error_at_most=given.error_at_most)
        except RhiError as error:  # what was measured shows which bounds could be kept
            refusal = error
    found = describe(situation, shown, points, choice) | list_omissions(scene)
    title = f"{given.scene}, {shown[0].device}"
    if given.plot is not None:
        accuracy_report.plot_all(given.plot, title, shown, points, choice)
        note(f"wrote {given.plot}")
    if given.output is not None:
        charts = accuracy_report.write_images(given.output / "images", shown, points, choice)
        accuracy_report.write_page(given.output / "report.html", situation, reports, points, choice, charts)
        (given.output / "accuracy.json").write_text(json.dumps(found, indent=2) + "\n")
        (given.output / "table.md").write_text(show_reports(shown, markdown=True) + "\n")
        best = [BudgetStep(point.settings, point.milliseconds, point.error) for point in points if point.is_best]
        save_steps(given.output / "front.json", best)
        note(f"wrote report.html, accuracy.json, front.json, table.md and images to {given.output}")
    if choice is not None:
        leave_to_trials(choice.point.settings, situation.settings).save(answer, **found["chosen"])
        note(f"wrote {answer}")
    print(json.dumps(found) if given.json else show_reports(shown, markdown=given.markdown))
    if choice is not None and not given.json:
        print(f"\nchosen: {accuracy_report.show_choice(choice)}")
    if refusal is not None:
        raise refusal


def clear_answer(path: Path, begun_with: Path | None) -> None:
    """Remove settings that an earlier choice has left where a choice will be written: if this one is refused or
    interrupted, they must not look like its answer."""
    if begun_with is not None and path.exists() and path.samefile(begun_with):
        raise OutputError(f"--settings: {path} is where the choice will be written; copy it, and begin with the copy")
    if path.exists():
        path.unlink()
        note(f"removed {path} of an earlier choice")


def list_left_out(reports: Sequence[KnobReport]) -> list[str]:
    """Return a line for each knob or value that is left out: a knob whose values all lack the same has one."""
    lines = []
    for report in reports:
        lacks = report.left_out
        if not report.rows and len(set(lacks.values())) == 1:
            lines.append(f"{report.knob}: {next(iter(lacks.values()))}")
        else:
            lines += [f"{report.knob}: {value}: {lack}" for value, lack in lacks.items()]
    return lines


def describe(
    situation: Situation, reports: list[KnobReport], points: list[FrontPoint], choice: CheckedChoice | None
) -> dict[str, Any]:
    """Return what `--json` prints."""
    return {
        **to_plain(situation),
        "knobs": [
            {**asdict(report), "truth": KNOBS[report.knob].truth.name, "pictures": list(report.pictures)}
            for report in reports
        ],
        "front": [_describe_point(point) for point in points],
        "chosen": None
        if choice is None
        else {
            **_describe_point(choice.point),
            "checked_error": choice.error,
            "checked_views": choice.views,
            "expected_error": choice.expected,
            "refused": choice.refused,
            "held_out_error": choice.held_out_error,
            "held_out_views": choice.held_out_views,
            "frames_over_budget": choice.over,
        },
    }


def _describe_point(point: FrontPoint) -> dict[str, Any]:
    return {one.name: getattr(point, one.name) for one in fields(point) if one.name != "settings"}


def show_reports(reports: list[KnobReport], *, markdown: bool = False) -> str:
    """Format the rows of all knobs as a table."""
    header = ["knob", "value", *accuracy_report.ERRORS, "unit", "ms", "ratio", "processor", "default"]
    rows = [
        [row.knob, *accuracy_report.show_row(row), "default" if row.is_default else ""]
        for report in reports
        for row in report.rows
    ]
    return format_table(header, rows, markdown=markdown)


COMMAND: Final = Subcommand(
    "accuracy", "show what accuracy costs in time: error and time of each choice", _OPTIONS, _run, __doc__
)
