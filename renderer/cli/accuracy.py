"""`accuracy`: what accuracy costs in time, one quality setting after the other.

  python -m renderer accuracy city
  python -m renderer accuracy city --quality-setting precision --quality-setting samples --backend cl
  python -m renderer accuracy hall:shadows=1 --quality-setting shadow_size --json
  python -m renderer accuracy city:shadows=1 --output swept --executor processes:2
  python -m renderer accuracy city:shadows=1 --output swept --max-error 2
  python -m renderer render city:shadows=1 --settings swept/settings.json

A quality setting trades accuracy for time. All of its values draw the same frames, which are compared with
the setting's reference: float64, super-sampling, brute force, or the exact algorithm. Then all values are
timed in turn in one process. `ratio` is a value's time divided by the most accurate value's: the median over
the rounds, by the clock and by the processor, with the ends of its 95 % confidence interval. Quality settings
that need something the scene or the device lacks are left out; stderr says why. Shadows are switched on for
the quality settings of shadows.

With --output, DIR gets a page with charts and images, the same as JSON, and each result as soon as it is
there: an interrupted sweep continues where it stopped. With --budget-ms or --max-error, the quality settings
that change images of this scene are combined greedily, drawn and timed. Their error is the mean error plus
the flicker, the change of a pixel's error from frame to frame, times the weight of --flicker: --flicker 0
looks at stills alone, and takes textures without mip levels. The choice is checked with ten more
views, where the mean of their errors plus four standard deviations must be within the bound, and tried in twenty
others. With --keep, an earlier choice remains as long as it may be within the bound and no other is surely
better by more than 5 %, so noise changes nothing. The choice is written to
DIR/settings.json, which `render`, `compare techniques`, `compare visibility` and `accuracy` read with
--settings. An older one is removed before anything is measured, so none is left if
the choice is refused.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, Final

import rhi
from renderer import rules
from renderer.cli import accuracy_report, options
from renderer.cli.arguments import load_settings, open_scene
from renderer.cli.options import option
from renderer.cli.output import OutputError, note, prepare_chart, report_omissions, show_progress
from renderer.cli.subcommand import Subcommand
from renderer.lab.accuracy import (
    FLICKER_WEIGHT,
    FRONT_PIXELS,
    QUALITY_SETTINGS,
    TRACED_PIXELS,
    CheckedChoice,
    ParetoPoint,
    SettingReport,
    SweepSetup,
    choose,
    keep_references,
    leave_to_trials,
    list_jobs,
    load_or_compute_pareto_front,
    run_jobs,
    select_effective_reports,
)
from renderer.lab.measure import format_table
from renderer.lab.measure.disturbance import DISTURBED
from renderer.lab.measure.machine import describe_machine
from renderer.scene import Scene
from renderer.scene.files import read_json
from renderer.settings import to_json
from renderer.viewer.frame_budget import BudgetStep, save_steps
from rhi import RhiError, refuse
from rhi_screen.executors import KINDS, make_executor

_SWEEP_ROUNDS: Final = 1
"""The most rounds of a sweep that only begins a choice: the front is timed again."""
_OPTIONS: Final = (
    options.SCENE,
    option(
        "--quality-setting",
        f"only this one; repeatable. {', '.join(QUALITY_SETTINGS)}",
        [],
        "",
        action="append",
        metavar="NAME",
    ),
    options.BACKEND,
    option("--camera", "a path, a walk-through or a view", "", "ground, or a view", metavar="CAMERA"),
    options.size((480, 270)),
    options.count("--views", "frames that are compared", 3),
    options.rounds("frames that are timed", 11),
    options.settings("settings to begin with, written by `accuracy` or `tune`"),
    option(
        "--budget-ms",
        "choose the most accurate settings that take at most this time for a frame",
        type=options.parse_bound,
        metavar="M",
    ),
    option(
        "--max-error",
        "choose the fastest settings with an error within this, in levels of 255: mean plus weighted flicker",
        type=options.parse_bound,
        metavar="E",
    ),
    option(
        "--flicker",
        "how many levels of error a level of flicker counts for in a choice; 0 looks at stills alone",
        FLICKER_WEIGHT,
        type=options.parse_weight,
        metavar="WEIGHT",
    ),
    option(
        "--keep",
        "settings.json of an earlier choice: its values are left only for surely better ones",
        type=Path,
        metavar="F.json",
    ),
    options.executor("shards of quality settings run", KINDS),
    options.output_file("--plot", "write charts of errors and times"),
    options.output_folder("--output", "folder for the results; an interrupted sweep is resumed from it"),
    *options.form(),
)


@dataclass(frozen=True, slots=True)
class AccuracyResult:
    """The results of a sweep.

    Attributes:
        reports: one for each quality setting, also those that were left out.
        measured: the reports that have rows.
        points: the Pareto front; empty if it wasn't computed.
        choice: the settings within the bound; None without a bound, or if none are within it.
        report: what `--json` prints.
    """

    setup: SweepSetup
    reports: list[SettingReport]
    measured: list[SettingReport]
    points: list[ParetoPoint]
    choice: CheckedChoice | None
    report: dict[str, Any]


def _run(arguments: argparse.Namespace) -> None:
    for name in arguments.quality_setting:
        if name not in QUALITY_SETTINGS:
            rules.refuse_name(
                rules.UNKNOWN_QUALITY_SETTING, "accuracy --quality-setting", name, QUALITY_SETTINGS
            )
    scene = open_scene(arguments.scene)  # raises now, not in another process
    if arguments.plot is not None:
        prepare_chart(arguments.plot)
    setup = _make_setup(arguments)
    settings_path = (arguments.output or Path()) / "settings.json"
    values_in_use = load_values_in_use(arguments.keep, is_bounded=_is_bounded(arguments))
    if _is_bounded(arguments):
        remove_old_settings(settings_path, arguments.settings)
    with keep_references(_jobs_folder(arguments)):
        _measure(arguments, setup, scene, values_in_use)


def load_values_in_use(path: Path | None, *, is_bounded: bool) -> dict[str, str] | None:
    """The values of quality settings in a file of an earlier choice; None without a file.

    Raises:
        OutputError: the file has none, or there is no bound to choose within.
    """
    if path is None:
        return None
    if not is_bounded:
        raise OutputError("--keep: there is nothing to choose without --budget-ms or --max-error")
    try:
        values = read_json(path)["values"]
        return {str(name): str(value) for name, value in values.items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        raise OutputError(f"--keep: {path} isn't the settings.json of a choice") from None


def _measure(
    arguments: argparse.Namespace, setup: SweepSetup, scene: Scene, values_in_use: dict[str, str] | None
) -> None:
    """Sweep the quality settings, choose settings if there is a bound, and write and print the results.
    Settings in use, `values_in_use`, are left only for better ones."""
    reports = _sweep(arguments, setup)
    measured = [report for report in reports if report.rows]
    if not measured:
        refuse(rules.NO_QUALITY_SETTINGS, "accuracy", ", ".join(report.setting for report in reports))
    points = list[ParetoPoint]()
    is_bounded, settings_path = _is_bounded(arguments), (arguments.output or Path()) / "settings.json"
    if is_bounded or (
        arguments.output is not None and select_effective_reports(scene, setup.settings, measured)
    ):
        progress = partial(show_progress, task="combine quality settings")
        points = load_or_compute_pareto_front(
            setup, measured, _jobs_folder(arguments), progress, values_in_use
        )
        note_disturbance(points)
    choice: CheckedChoice | None = None
    refusal: RhiError | None = None
    if is_bounded:
        try:
            choice = choose(
                setup,
                points,
                budget_ms=arguments.budget_ms,
                max_error=arguments.max_error,
                values_in_use=values_in_use,
            )
        except RhiError as error:  # raised at the end: the results show which bounds could be kept
            refusal = error
    report = describe(setup, measured, points, choice) | report_omissions(scene)
    result = AccuracyResult(setup, reports, measured, points, choice, report)
    _write_results(arguments, result)
    if choice is not None:
        leave_to_trials(choice.point.settings, setup.settings).save(settings_path, **report["choice"])
        note(f"wrote {settings_path}")
    _print_result(arguments, result)
    if refusal is not None:
        raise refusal


def _is_bounded(arguments: argparse.Namespace) -> bool:
    return arguments.budget_ms is not None or arguments.max_error is not None


def note_disturbance(points: Sequence[ParetoPoint]) -> None:
    """Say so if other programs had the processors while combinations were timed."""
    slowdown = median(point.slowdown for point in points)
    if slowdown >= DISTURBED:
        note(
            f"the machine is busy: waiting for a processor made frames take {slowdown:.1f} times as long;"
            " times are corrected for it"
        )


def _make_setup(arguments: argparse.Namespace) -> SweepSetup:
    """The scene, frames, device and settings of a sweep. Opens the device, so that a missing one is refused
    now."""
    with rhi.create_device(arguments.backend) as device:
        backend = device.backend_name
    return SweepSetup(
        arguments.scene,
        arguments.camera,
        backend,
        arguments.size,
        views=arguments.views,
        rounds=arguments.rounds,
        settings=load_settings(arguments),
        flicker_weight=arguments.flicker,
        # The sweep only begins a choice: it shares the traced pixels of the front.
        traced_pixels=FRONT_PIXELS if _is_bounded(arguments) else TRACED_PIXELS,
        begins_choice=_is_bounded(arguments),
    )


def _jobs_folder(arguments: argparse.Namespace) -> Path | None:
    """The folder of results that an interrupted sweep continues from."""
    return None if arguments.output is None else arguments.output / "jobs"


def _sweep(arguments: argparse.Namespace, setup: SweepSetup) -> list[SettingReport]:
    """Measure the quality settings that were named, or all, and say on stderr which are left out."""
    if _is_bounded(arguments):
        setup = replace(setup, rounds=min(setup.rounds, _SWEEP_ROUNDS))
    jobs = list_jobs(setup, dict.fromkeys(arguments.quality_setting or QUALITY_SETTINGS))
    with make_executor(arguments.executor) as executor:
        reports = run_jobs(
            jobs,
            executor,
            _jobs_folder(arguments),
            lambda items, total: show_progress(items, "accuracy", total),
        )
    for line in describe_left_out(reports):
        note(f"left out: {line}")
    return reports


def _write_results(arguments: argparse.Namespace, result: AccuracyResult) -> None:
    """Write the charts of --plot and the folder of --output."""
    if arguments.plot is not None:
        title = f"{arguments.scene}, {result.measured[0].device}"
        accuracy_report.plot_all(arguments.plot, title, result.measured, result.points, result.choice)
        note(f"wrote {arguments.plot}")
    if arguments.output is None:
        return
    folder: Path = arguments.output
    charts = accuracy_report.write_images(folder / "images", result.measured, result.points, result.choice)
    accuracy_report.write_page(
        folder / "report.html", result.setup, result.reports, result.points, result.choice, charts
    )
    (folder / "accuracy.json").write_text(json.dumps(result.report, indent=2) + "\n", encoding="utf-8")
    (folder / "table.md").write_text(format_reports(result.measured, markdown=True) + "\n", encoding="utf-8")
    best = [
        BudgetStep(point.settings, point.milliseconds, point.error)
        for point in result.points
        if point.is_best
    ]
    save_steps(folder / "pareto_front.json", best)
    note(f"wrote report.html, accuracy.json, pareto_front.json, table.md and images to {folder}")


def _print_result(arguments: argparse.Namespace, result: AccuracyResult) -> None:
    """Print the tables, or with --json the report."""
    if arguments.json:
        print(json.dumps(result.report))
        return
    print(format_reports(result.measured, markdown=arguments.markdown))
    if result.choice is not None:
        print(f"\nchosen: {accuracy_report.format_choice(result.choice)}")


def remove_old_settings(path: Path, begun_with: Path | None) -> None:
    """Remove the settings file of an earlier choice: if this choice is refused or interrupted, the old file
    must not look like its answer."""
    if begun_with is not None and path.exists() and path.samefile(begun_with):
        raise OutputError(
            f"--settings: the chosen settings would overwrite {path}; copy the file and pass the copy"
        )
    if path.exists():
        path.unlink()
        note(f"removed {path} of an earlier choice")


def describe_left_out(reports: Sequence[SettingReport]) -> list[str]:
    """Lines on left-out quality settings or values: one line if all values of a setting lack the same."""
    lines = []
    for report in reports:
        lacks = report.left_out
        if not report.rows and len(set(lacks.values())) == 1:
            lines.append(f"{report.setting}: {next(iter(lacks.values()))}")
        else:
            lines += [f"{report.setting}: {value}: {lack}" for value, lack in lacks.items()]
    return lines


def describe(
    setup: SweepSetup, reports: list[SettingReport], points: list[ParetoPoint], choice: CheckedChoice | None
) -> dict[str, Any]:
    """The report that `--json` prints."""
    return {
        **to_json(setup),
        "machine": asdict(describe_machine()),
        "quality_settings": [
            {
                **asdict(report),
                "reference": QUALITY_SETTINGS[report.setting].reference.name,
                "images": list(report.images),
            }
            for report in reports
        ],
        "pareto_front": [_describe_point(point) for point in points],
        "choice": None
        if choice is None
        else {
            **_describe_point(choice.point),
            "checked_error": choice.error,
            "checked_views": choice.views,
            "expected_error": choice.expected,
            "rejected": choice.rejected,
            "held_out_error": choice.held_out_error,
            "held_out_views": choice.held_out_views,
            "frames_over_budget": choice.over_budget,
            "kept": choice.is_kept,
        },
    }


def _describe_point(point: ParetoPoint) -> dict[str, Any]:
    return {field.name: getattr(point, field.name) for field in fields(point) if field.name != "settings"}


def format_reports(reports: list[SettingReport], *, markdown: bool = False) -> str:
    """Format the rows of all quality settings as a table."""
    header = ["setting", "value", *accuracy_report.ERRORS, "unit", "ms", "ratio", "processor", "default"]
    rows = [
        [row.setting, *accuracy_report.format_row(row), "default" if row.is_default else ""]
        for report in reports
        for row in report.rows
    ]
    return format_table(header, rows, markdown=markdown)


COMMAND: Final = Subcommand(
    "accuracy", "show what accuracy costs in time: error and time of each choice", _OPTIONS, _run, __doc__
)
