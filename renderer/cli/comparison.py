"""Comparisons as programs: rows become a table for people, Markdown, JSON or a chart."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import rhi
from renderer.cli.options import CommandOption, add_options, form
from renderer.cli.output import draw_chart, list_left_out, note, prepare_chart
from renderer.cli.subcommand import Parser, Subcommand
from renderer.lab.comparison import KERNELS, Record
from renderer.lab.measure.table import format_table, format_value, title_of
from renderer.scene import Scene


@dataclass(frozen=True, slots=True)
class Report:
    """Rows, and what JSON says besides: what they are about, and what was left out of the scene, if there is one.

    `title` is that of their chart."""

    about: Mapping[str, object]
    rows: Sequence[Record]
    title: str = ""
    scene: Scene | None = None


def describe(device: rhi.Device) -> Record:
    """Return what a report says of its device."""
    return {"backend": device.backend_name, "device": device.capabilities.device}


def repeat(given: argparse.Namespace, *names: str) -> Record:
    """Return what a report repeats of the arguments."""
    return {name: getattr(given, name) for name in names}


@dataclass(frozen=True, slots=True)
class ComparisonProgram:
    """A comparison that can be asked for: a subject of `compare`, or a program of `benchmarks`.

    Attributes:
        notes: the docstring of the module: after its first line examples, and what the columns mean.
        options: all its options: those of `options.form`, too, and that of `options.chart` if there is a chart.
        measure: makes the report.
        titles: the titles of columns whose names don't say enough.
        show: makes rows for people of those for JSON.
        plot: draws a chart on a figure.
        more: makes further tables of what a report says besides its rows; they are Markdown if the second argument is
            true.
    """

    name: str
    summary: str
    notes: str | None
    options: Sequence[CommandOption]
    measure: Callable[[argparse.Namespace], Report]
    titles: Mapping[str, str] = field(default_factory=dict)
    show: Callable[[Sequence[Record]], Sequence[Record]] = lambda rows: rows
    plot: Callable[[Any, Sequence[Record]], None] | None = None
    more: Callable[[Mapping[str, Any], bool], Sequence[str]] = lambda about, markdown: ()

    @property
    def command(self) -> Subcommand:
        """The comparison as a command."""
        return Subcommand(self.name, self.summary, self.options, self.run, self.notes)

    def run(self, given: argparse.Namespace) -> None:
        """Compare, and print what was found."""
        if self.plot is not None and given.plot is not None:
            prepare_chart(given.plot)
        report = self.measure(given)
        if any("quick" in (row.get(KERNELS) or "") for row in report.rows):
            note("quick kernels ran, which a long run has not: RHI_KERNELS=optimised measures its own")
        if self.plot is not None and given.plot is not None:
            with draw_chart(given.plot, report.title) as figure:
                self.plot(figure, report.rows)
            note(f"wrote {given.plot}")
        if given.json:
            left_out = {} if report.scene is None else list_left_out(report.scene)
            print(json.dumps({**report.about, "rows": report.rows, **left_out}))
        else:
            tables = [self.format(report.rows, markdown=given.markdown), *self.more(report.about, given.markdown)]
            print("\n\n".join(tables))

    def format(self, rows: Sequence[Record], *, markdown: bool = False) -> str:
        """Format rows as a table; those with other columns begin another one."""
        tables = []
        for names, some in groupby(self.show(rows), tuple):
            header = [self.titles.get(name, title_of(name)) for name in names]
            cells = [[format_value(value) for value in row.values()] for row in some]
            tables.append(format_table(header, cells, markdown=markdown))
        return "\n\n".join(tables)


def run_benchmark(
    text: str | None, options: Sequence[CommandOption], measure: Callable[[argparse.Namespace], Iterable[Record]],
    plot: Callable[[Any, Sequence[Record]], None] | None = None, kernels: str = "optimised",
) -> None:  # fmt: skip
    """Run a program of `benchmarks`: its docstring, its options but for those of `form`, and the function that yields
    its rows, of one table or of several; with a chart, which `plot` draws, `options.chart` is one of the options.

    Unless RHI_KERNELS says otherwise, cl runs these `kernels`: optimised ones, as a long run does, "quick" ones, or
    with "" those that a first run has.
    """
    os.environ.setdefault("RHI_KERNELS", kernels)
    comparison = ComparisonProgram("", "", "", options, lambda given: Report({}, list(measure(given))), plot=plot)
    parser = Parser(description=text)
    add_options(parser, (*options, *form()))
    comparison.run(parser.parse_args())
