"""The report of `accuracy`: charts, images of the worst errors, and one page with all of them."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from renderer.cli.output import draw_chart
from renderer.lab.accuracy import (
    QUALITY_SETTINGS,
    CheckedChoice,
    ErrorUnit,
    ParetoPoint,
    QualitySetting,
    Requirement,
    SettingReport,
    SweepSetup,
    ValueRow,
)
from renderer.lab.measure.machine import describe_machine

_SMALLEST_ERROR: Final = 1e-3
"""If some error is 0, the axis of errors is logarithmic from here on, and linear below."""
_MAGNIFICATION: Final = 3  # of images in files

_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 76rem;
  margin: 2rem auto; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; font-size: 13px } th, td { text-align: left; padding: .15rem .6rem }
tr.setting td { border-top: 1px solid #bbb } tr.default { background: #eef4ff }
td.number { text-align: right }
img.chart { max-width: 100% } figcaption { font-size: 12px }
figure { display: inline-block; margin: .5rem 1rem .5rem 0 }
figure img { image-rendering: pixelated; width: 42rem; max-width: 100% }
"""


def chart_group(setting: QualitySetting) -> str:
    """The name of the chart that shows a quality setting."""
    if setting.requirement is Requirement.SHADOWS:
        return "shadows"
    if setting.is_encoding:
        return "encodings"
    if setting.unit is ErrorUnit.LIGHTS:
        return "lights"
    return "culling" if setting.path.startswith("visibility.") else "images"


ERRORS: Final = ("mean error", "to best", "p99", "max error", "flicker", "FLIP")


def format_errors(row: ValueRow) -> list[str]:
    """Format the errors of a value, in the order of `ERRORS`."""
    numbers = (row.mean_error, row.difference, row.p99, row.max_error, row.flicker, row.flip)
    return ["" if number is None else f"{number:.4g}" for number in numbers]


def format_choice(choice: CheckedChoice) -> str:
    """Format settings that were chosen."""
    point = choice.point
    values = ", ".join(f"{name} {value}" for name, value in point.values.items())
    return (
        f"{values}: {point.milliseconds:.2f} ms, {point.ratio:.2f} of the most accurate settings' time, "
        f"flicker {point.flicker:.2f} levels, error with weighted flicker "
        f"{point.error:.2f} in the worst view, {choice.error:.2f} in {choice.views} others, "
        f"{choice.held_out_error:.2f} in {choice.held_out_views} that had no part in the choice"
        + (
            ""
            if choice.over_budget is None
            else f", {choice.over_budget:.0%} of a walk's frames over the budget"
        )
        + (", kept from an earlier choice" if choice.is_kept else "")
    )


def format_ratio(ratio: float, low: float, high: float) -> str:
    """Format a ratio with its confidence interval."""
    return f"{ratio:.2f} ({low:.2f} to {high:.2f})" if (low, high) != (ratio, ratio) else f"{ratio:.2f}"


def format_row(row: ValueRow) -> list[str]:
    """Format a value: its name, its errors and their unit, its time, and the ratios of time and processor
    time."""
    ratios = (row.ratio, row.low, row.high), (row.processor_ratio, row.processor_low, row.processor_high)
    return [
        row.value,
        *format_errors(row),
        row.unit,
        f"{row.milliseconds:.3g}",
        *(format_ratio(*ratio) for ratio in ratios),
    ]


GROUPS: Final = {
    "images": "error of images",
    "shadows": "error of shadows",
    "lights": "error of lists",
    "culling": "error of culling",
    "encodings": "error of encodings",
}
"""The charts of single quality settings, and the titles of their errors."""


def list_groups(reports: Sequence[SettingReport]) -> dict[str, list[SettingReport]]:
    """The reports of each chart."""
    groups: dict[str, list[SettingReport]] = {name: [] for name in GROUPS}
    for report in reports:
        if report.rows:
            groups[chart_group(QUALITY_SETTINGS[report.setting])].append(report)
    return {name: members for name, members in groups.items() if members}


def draw_group(axes: Any, reports: Sequence[SettingReport], title: str) -> None:
    """Draw the mean errors of values over their processor times, a line for each quality setting; rings are
    defaults."""
    for report in reports:
        rows = report.rows
        times, errors = [row.processor_ratio for row in rows], [row.mean_error for row in rows]
        low = [max(row.processor_ratio - row.processor_low, 0.0) for row in rows]
        high = [max(row.processor_high - row.processor_ratio, 0.0) for row in rows]
        drawn = axes.errorbar(
            times,
            errors,
            xerr=(low, high),
            marker="o",
            markersize=3,
            linewidth=1,
            elinewidth=0.6,
            label=report.setting,
        )
        color = drawn.lines[0].get_color()
        default_rows = [row for row in rows if row.is_default]
        axes.scatter(
            [row.processor_ratio for row in default_rows],
            [row.mean_error for row in default_rows],
            s=70,
            facecolors="none",
            edgecolors=color,
        )
        for row in (rows[0], rows[-1]):
            axes.annotate(
                row.value,
                (row.processor_ratio, row.mean_error),
                (3, 3),
                textcoords="offset points",
                fontsize=6,
                color=color,
            )
    if min(row.mean_error for report in reports for row in report.rows) > 0.0:
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=_SMALLEST_ERROR)
        axes.set_ylim(bottom=0.0)
    axes.axvline(1.0, color="grey", linewidth=0.5)
    units = ", ".join(dict.fromkeys(row.unit for report in reports for row in report.rows))
    axes.set(xlabel="processor time, most accurate value = 1", ylabel=f"{title}: {units}")
    axes.legend(fontsize="x-small")


def draw_pareto_front(axes: Any, points: Sequence[ParetoPoint], choice: CheckedChoice | None) -> None:
    """Draw the combined settings, the Pareto front, and the choice."""
    best = sorted((point for point in points if point.is_best), key=lambda point: point.milliseconds)
    axes.scatter(
        [p.milliseconds for p in points], [p.error for p in points], s=14, color="#999", label="tried"
    )
    axes.plot(
        [p.milliseconds for p in best],
        [p.error for p in best],
        marker="o",
        markersize=4,
        label="pareto_front",
    )
    if choice is not None:
        position = choice.point.milliseconds, choice.point.error
        axes.scatter(*position, s=110, facecolors="none", edgecolors="red", label="chosen")
    axes.set(xlabel="milliseconds a frame", ylabel="error in the worst view, with weighted flicker, levels")
    axes.legend(fontsize="x-small")


def plot_all(
    path: Path,
    title: str,
    reports: Sequence[SettingReport],
    points: Sequence[ParetoPoint],
    choice: CheckedChoice | None,
) -> None:
    """Write one image with all charts."""
    groups = list_groups(reports)
    count = len(groups) + bool(points)
    columns = min(count, 3)
    rows = -(-count // columns)
    with draw_chart(path, title) as figure:
        figure.set_size_inches(5.0 * columns, 3.8 * rows)
        subplots = list(figure.subplots(rows, columns, squeeze=False).flat)
        for axes, (name, members) in zip(subplots, groups.items(), strict=False):
            draw_group(axes, members, GROUPS[name])
        if points:
            draw_pareto_front(subplots[len(groups)], points, choice)
        for axes in subplots[count:]:
            axes.set_axis_off()


def write_images(
    folder: Path,
    reports: Sequence[SettingReport],
    points: Sequence[ParetoPoint],
    choice: CheckedChoice | None,
) -> list[Path]:
    """Write each chart, and the worst region of each quality setting's least accurate value; return the
    charts."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, Callable[[Any], None]] = {
        name: partial(draw_group, reports=members, title=GROUPS[name])
        for name, members in list_groups(reports).items()
    }
    if points:
        drawn["pareto_front"] = partial(draw_pareto_front, points=points, choice=choice)
    from PIL import Image  # optional

    charts = []
    for name, draw in drawn.items():
        charts.append(folder / f"{name}.png")
        with draw_chart(charts[-1]) as figure:
            figure.set_size_inches(8, 4.5)
            draw(figure.subplots())
    for report in reports:
        value = next((row.value for row in report.rows if row.value in report.images), None)
        if value is not None:
            image = Image.open(BytesIO(b64decode(report.images[value])), formats=("PNG",))
            size = image.width * _MAGNIFICATION, image.height * _MAGNIFICATION
            image.resize(size, Image.Resampling.NEAREST).save(
                folder / f"worst-{report.setting}.png", optimize=True
            )
    return charts


def write_page(
    path: Path,
    setup: SweepSetup,
    reports: Sequence[SettingReport],
    points: Sequence[ParetoPoint],
    choice: CheckedChoice | None,
    charts: Sequence[Path],
) -> None:
    """Write one HTML page that needs no other file."""
    width, height = setup.size
    device = next((report.device for report in reports), "")
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>What accuracy costs</title>",
        f"<style>{_STYLE}</style>",
        "<h1>What accuracy costs</h1>",
        f"<p>{escape(setup.scene)}, {width} × {height}, {escape(str(setup.backend))}: {escape(device)}. "
        f"{setup.views} views compared, {setup.rounds} frames timed. Ratios are to the most accurate value "
        "of "
        "a quality setting, with 95 % confidence intervals. Shaded rows are defaults. "
        f"Measured on {escape(str(describe_machine()))}.</p>",
    ]
    if choice is not None:
        parts.append(f"<h2>Chosen</h2><p>{escape(format_choice(choice))}.</p>")
    for chart in charts:
        parts.append(f"<p><img class='chart' alt='{chart.stem}' src='{_embed(chart.read_bytes())}'></p>")
    parts.append(_format_table(reports))
    parts.append(
        "<h2>The worst regions</h2><p>The reference, the value's image, and four times their difference.</p>"
    )
    for report in reports:
        for row in report.rows:
            if row.value in report.images:
                parts.append(_format_image(row, report.images[row.value]))
    left_out = [(item.setting, value, lack) for item in reports for value, lack in item.left_out.items()]
    if left_out:
        lines = "".join(
            f"<li>{escape(setting)} {escape(value)}: {escape(lack)}</li>" for setting, value, lack in left_out
        )
        parts.append(f"<h2>Left out</h2><ul>{lines}</ul>")
    path.write_text("\n".join(parts), encoding="utf-8")


def _embed(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"


def _format_table(reports: Sequence[SettingReport]) -> str:
    titles = ("setting", "value", *ERRORS, "unit", "ms", "ratio", "processor ratio", "reference", "why")
    lines = ["<h2>Quality settings</h2><table><tr>", *(f"<th>{title}</th>" for title in titles), "</tr>"]
    for report in reports:
        setting = QUALITY_SETTINGS[report.setting]
        for number, row in enumerate(report.rows):
            kind = " ".join(["setting"] * (number == 0) + ["default"] * row.is_default)
            cells = (
                row.setting if number == 0 else "",
                *format_row(row),
                setting.reference.name if number == 0 else "",
                "; ".join(filter(None, (setting.reason, setting.non_monotonic_reason)))
                if number == 0
                else "",
            )
            lines.append(f"<tr class='{kind}'>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>")
    return "".join([*lines, "</table>"])


def _format_image(row: ValueRow, image: str) -> str:
    assert row.worst is not None
    frame, x, y = row.worst
    caption = f"{row.setting}, {row.value}: {row.max_error:.3g} levels at ({x}, {y}) of frame {frame}"
    return (
        f"<figure><img alt='{escape(caption)}' src='data:image/png;base64,{image}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
