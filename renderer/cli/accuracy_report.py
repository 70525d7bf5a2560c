"""The report of `accuracy`: charts, pictures of what goes wrong, and one page that holds all of them."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from PIL import Image

from renderer.cli.output import draw_chart
from renderer.lab.accuracy import (
    KNOBS,
    CheckedChoice,
    Demand,
    FrontPoint,
    Knob,
    KnobReport,
    Situation,
    Unit,
    ValueRow,
)

_LEAST: Final = 1e-3
"""Where some error is 0, errors are drawn on a scale of equal ratios from here on, and below it of equal steps."""
_ENLARGED: Final = 3  # pictures in files

_STYLE: Final = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
table { border-collapse: collapse; font-size: 13px } th, td { text-align: left; padding: .15rem .6rem }
tr.knob td { border-top: 1px solid #bbb } tr.default { background: #eef4ff } td.number { text-align: right }
img.chart { max-width: 100% } figcaption { font-size: 12px }
figure { display: inline-block; margin: .5rem 1rem .5rem 0 }
figure img { image-rendering: pixelated; width: 42rem; max-width: 100% }
"""


def group_of(knob: Knob) -> str:
    """Return the name of the chart that shows a knob."""
    if knob.demand is Demand.SHADOWS:
        return "shadows"
    if knob.is_encoding:
        return "encodings"
    if knob.unit is Unit.LIGHTS:
        return "lights"
    return "culling" if knob.path.startswith("visibility.") else "pictures"


ERRORS: Final = ("mean error", "p99", "max error", "flicker", "FLIP")


def show_errors(row: ValueRow) -> list[str]:
    """Format the errors of a value: those of `ERRORS`."""
    shown = (row.mean_error, row.p99, row.max_error, row.flicker, row.flip)
    return ["" if number is None else f"{number:.4g}" for number in shown]


def show_choice(choice: CheckedChoice) -> str:
    """Format settings that were chosen."""
    point = choice.point
    values = ", ".join(f"{name} {value}" for name, value in point.values.items())
    return (
        f"{values}: {point.milliseconds:.2f} ms, {point.ratio:.2f} of the most accurate settings' time, mean error "
        f"{point.error:.2f} levels in the worst view, {choice.error:.2f} in {choice.views} others, "
        f"{choice.held_out_error:.2f} in {choice.held_out_views} that had no part in the choice"
        + ("" if choice.over is None else f", {choice.over:.0%} of a walk's frames over the budget")
    )


def show_ratio(ratio: float, low: float, high: float) -> str:
    """Format a ratio with its confidence interval."""
    return f"{ratio:.2f} ({low:.2f} to {high:.2f})" if (low, high) != (ratio, ratio) else f"{ratio:.2f}"


def show_row(row: ValueRow) -> list[str]:
    """Format a value: its name, its errors and their unit, its time, and the ratios of time and processor time."""
    ratios = (row.ratio, row.low, row.high), (row.processor_ratio, row.processor_low, row.processor_high)
    return [row.value, *show_errors(row), row.unit, f"{row.milliseconds:.3g}", *(show_ratio(*one) for one in ratios)]


GROUPS: Final = {
    "pictures": "error of pictures",
    "shadows": "error of shadows",
    "lights": "error of lists",
    "culling": "error of culling",
    "encodings": "error of encodings",
}
"""The charts of single knobs, and what their errors are called."""


def list_groups(reports: Sequence[KnobReport]) -> dict[str, list[KnobReport]]:
    """Return the reports of each chart."""
    groups: dict[str, list[KnobReport]] = {name: [] for name in GROUPS}
    for report in reports:
        if report.rows:
            groups[group_of(KNOBS[report.knob])].append(report)
    return {name: some for name, some in groups.items() if some}


def draw_group(axes: Any, reports: Sequence[KnobReport], title: str) -> None:
    """Draw the mean errors of values over their processor times, a line for each knob; rings are defaults."""
    for report in reports:
        rows = report.rows
        times, errors = [row.processor_ratio for row in rows], [row.mean_error for row in rows]
        low = [max(row.processor_ratio - row.processor_low, 0.0) for row in rows]
        high = [max(row.processor_high - row.processor_ratio, 0.0) for row in rows]
        drawn = axes.errorbar(
            times, errors, xerr=(low, high), marker="o", markersize=3, linewidth=1, elinewidth=0.6, label=report.knob
        )
        color = drawn.lines[0].get_color()
        chosen = [row for row in rows if row.is_default]
        axes.scatter(
            [row.processor_ratio for row in chosen],
            [row.mean_error for row in chosen],
            s=70, facecolors="none", edgecolors=color,
        )  # fmt: skip
        for row in (rows[0], rows[-1]):
            axes.annotate(
                row.value, (row.processor_ratio, row.mean_error), (3, 3), textcoords="offset points", fontsize=6,
                color=color,
            )  # fmt: skip
    if min(row.mean_error for report in reports for row in report.rows) > 0.0:
        axes.set_yscale("log")
    else:
        axes.set_yscale("symlog", linthresh=_LEAST)
        axes.set_ylim(bottom=0.0)
    axes.axvline(1.0, color="grey", linewidth=0.5)
    units = ", ".join(dict.fromkeys(row.unit for report in reports for row in report.rows))
    axes.set(xlabel="processor time, most accurate value = 1", ylabel=f"{title}: {units}")
    axes.legend(fontsize="x-small")


def draw_front(axes: Any, points: Sequence[FrontPoint], choice: CheckedChoice | None) -> None:
    """Draw the settings that were combined, those that no others beat, and the ones that were chosen."""
    best = sorted((point for point in points if point.is_best), key=lambda point: point.milliseconds)
    axes.scatter([p.milliseconds for p in points], [p.error for p in points], s=14, color="#999", label="tried")
    axes.plot([p.milliseconds for p in best], [p.error for p in best], marker="o", markersize=4, label="front")
    if choice is not None:
        place = choice.point.milliseconds, choice.point.error
        axes.scatter(*place, s=110, facecolors="none", edgecolors="red", label="chosen")
    axes.set(xlabel="milliseconds a frame", ylabel="mean error in the worst view, levels")
    axes.legend(fontsize="x-small")


def plot_all(
    path: Path, title: str, reports: Sequence[KnobReport], points: Sequence[FrontPoint], choice: CheckedChoice | None
) -> None:
    """Write one image with all charts."""
    groups = list_groups(reports)
    count = len(groups) + bool(points)
    columns = min(count, 3)
    rows = -(-count // columns)
    with draw_chart(path, title) as figure:
        figure.set_size_inches(5.0 * columns, 3.8 * rows)
        places = list(figure.subplots(rows, columns, squeeze=False).flat)
        for axes, (name, some) in zip(places, groups.items(), strict=False):
            draw_group(axes, some, GROUPS[name])
        if points:
            draw_front(places[len(groups)], points, choice)
        for axes in places[count:]:
            axes.set_axis_off()


def write_images(
    folder: Path, reports: Sequence[KnobReport], points: Sequence[FrontPoint], choice: CheckedChoice | None
) -> list[Path]:
    """Write each chart, and of each knob the worst place of its least accurate value; return the charts."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn: dict[str, Callable[[Any], None]] = {
        name: partial(draw_group, reports=some, title=GROUPS[name]) for name, some in list_groups(reports).items()
    }
    if points:
        drawn["front"] = partial(draw_front, points=points, choice=choice)
    charts = []
    for name, draw in drawn.items():
        charts.append(folder / f"{name}.png")
        with draw_chart(charts[-1]) as figure:
            figure.set_size_inches(8, 4.5)
            draw(figure.subplots())
    for report in reports:
        value = next((row.value for row in report.rows if row.value in report.pictures), None)
        if value is not None:
            image = Image.open(BytesIO(b64decode(report.pictures[value])))
            size = image.width * _ENLARGED, image.height * _ENLARGED
            image.resize(size, Image.Resampling.NEAREST).save(folder / f"worst-{report.knob}.png", optimize=True)
    return charts


def write_page(
    path: Path,
    situation: Situation,
    reports: Sequence[KnobReport],
    points: Sequence[FrontPoint],
    choice: CheckedChoice | None,
    charts: Sequence[Path],
) -> None:
    """Write one page that needs no other file."""
    width, height = situation.size
    device = next((report.device for report in reports), "")
    parts = [
        "<!doctype html><html lang='en'><meta charset='utf-8'><title>What accuracy costs</title>",
        f"<style>{_STYLE}</style>",
        "<h1>What accuracy costs</h1>",
        f"<p>{escape(situation.scene)}, {width} × {height}, {escape(str(situation.backend))}: {escape(device)}. "
        f"{situation.views} views compared, {situation.rounds} frames timed. Ratios are to the most accurate value of "
        "a knob, with 95 % confidence intervals. Shaded rows are defaults.</p>",
    ]
    if choice is not None:
        parts.append(f"<h2>Chosen</h2><p>{escape(show_choice(choice))}.</p>")
    for chart in charts:
        parts.append(f"<p><img class='chart' alt='{chart.stem}' src='{_embed(chart.read_bytes())}'></p>")
    parts.append(_show_table(reports))
    parts.append("<h2>The worst places</h2><p>The truth, the value's picture, and four times their difference.</p>")
    for report in reports:
        for row in report.rows:
            if row.value in report.pictures:
                parts.append(_show_picture(row, report.pictures[row.value]))
    left_out = [(one.knob, value, lack) for one in reports for value, lack in one.left_out.items()]
    if left_out:
        lines = "".join(f"<li>{escape(knob)} {escape(value)}: {escape(lack)}</li>" for knob, value, lack in left_out)
        parts.append(f"<h2>Left out</h2><ul>{lines}</ul>")
    path.write_text("\n".join(parts))


def _embed(png: bytes) -> str:
    return f"data:image/png;base64,{b64encode(png).decode()}"


def _show_table(reports: Sequence[KnobReport]) -> str:
    titles = ("knob", "value", *ERRORS, "unit", "ms", "ratio", "processor ratio", "judged by", "why")
    lines = ["<h2>Knobs</h2><table><tr>", *(f"<th>{title}</th>" for title in titles), "</tr>"]
    for report in reports:
        knob = KNOBS[report.knob]
        for number, row in enumerate(report.rows):
            kind = " ".join(["knob"] * (number == 0) + ["default"] * row.is_default)
            cells = (
                row.knob if number == 0 else "",
                *show_row(row),
                knob.truth.name if number == 0 else "",
                "; ".join(filter(None, (knob.because, knob.exception))) if number == 0 else "",
            )  # fmt: skip
            lines.append(f"<tr class='{kind}'>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>")
    return "".join([*lines, "</table>"])


def _show_picture(row: ValueRow, picture: str) -> str:
    assert row.worst is not None
    frame, x, y = row.worst
    caption = f"{row.knob}, {row.value}: {row.max_error:.3g} levels at ({x}, {y}) of frame {frame}"
    return (
        f"<figure><img alt='{escape(caption)}' src='data:image/png;base64,{picture}'>"
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )
