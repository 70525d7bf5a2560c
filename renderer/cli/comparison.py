"""Comparisons as programs: rows become a table, Markdown, JSON or a chart."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import groupby
from typing import Any

import rhi
from renderer.cli.options import CommandOption, add_options, executor, form
from renderer.cli.output import draw_chart, note, prepare_chart, report_omissions
from renderer.cli.subcommand import Parser, Subcommand
from renderer.lab.comparison import KERNELS, Record
from renderer.lab.measure.machine import describe_machine
from renderer.lab.measure.table import format_table, format_value, title_of
from renderer.scene import Scene
from rhi_screen.executors import KINDS, SERIAL, as_completed, make_executor


@dataclass(frozen=True, slots=True)
class Report:
    """Rows, and the metadata that JSON has besides, including what was left out of the scene if there is one.

    `title` is that of their chart."""

    metadata: Mapping[str, object]
    rows: Sequence[Record]
    title: str = ""
    scene: Scene | None = None


def describe(device: rhi.Device) -> Record:
    """The device's part of a report."""
    return {"backend": device.backend_name, "device": device.capabilities.device}


def repeat(arguments: argparse.Namespace, *names: str) -> Record:
    """The arguments that a report repeats."""
    return {name: getattr(arguments, name) for name in names}


@dataclass(frozen=True, slots=True)
class ComparisonProgram:
    """A comparison that can be run: a subject of `compare`, or a program of `benchmarks`.

    Attributes:
        notes: the docstring of the module: after its first line examples, and what the columns mean.
        options: all its options: those of `options.form`, too, and that of `options.chart` if there is a
            chart.
        measure: makes the report.
        titles: the titles of columns whose names don't say enough.
        display_rows: makes rows for people from those for JSON.
        plot: draws a chart on a figure.
        extra_tables: makes further tables of what a report says besides its rows; they are Markdown if the
            second argument is true.
    """

    name: str
    summary: str
    notes: str | None
    options: Sequence[CommandOption]
    measure: Callable[[argparse.Namespace], Report]
    titles: Mapping[str, str] = field(default_factory=dict)
    display_rows: Callable[[Sequence[Record]], Sequence[Record]] = lambda rows: rows
    plot: Callable[[Any, Sequence[Record]], None] | None = None
    extra_tables: Callable[[Mapping[str, Any], bool], Sequence[str]] = lambda metadata, markdown: ()

    @property
    def command(self) -> Subcommand:
        """The comparison as a command, which can also run elsewhere: as one call, because its times are
        ratios of what one process does in turns."""
        options = (*self.options, executor("the comparison runs", KINDS))
        return Subcommand(self.name, self.summary, options, self.run, self.notes)

    def run(self, arguments: argparse.Namespace) -> None:
        """Compare, and print the report."""
        if self.plot is not None and arguments.plot is not None:
            prepare_chart(arguments.plot)
        report = self._measure(arguments)
        if any("quick" in (row.get(KERNELS) or "") for row in report.rows):
            note("quick kernels ran, which a long run has not: RHI_KERNELS=optimised measures its own")
        if self.plot is not None and arguments.plot is not None:
            with draw_chart(arguments.plot, report.title) as figure:
                self.plot(figure, report.rows)
            note(f"wrote {arguments.plot}")
        if arguments.json:
            left_out = {} if report.scene is None else report_omissions(report.scene)
            machine = asdict(describe_machine())
            print(json.dumps({**report.metadata, "machine": machine, "rows": report.rows, **left_out}))
        else:
            tables = [
                self.format(report.rows, markdown=arguments.markdown),
                *self.extra_tables(report.metadata, arguments.markdown),
                f"Measured on {describe_machine()}.",
            ]
            print("\n\n".join(tables))

    def _measure(self, arguments: argparse.Namespace) -> Report:
        """Make the report where the arguments say."""
        where = getattr(arguments, "executor", SERIAL)
        if where == SERIAL:
            return self.measure(arguments)
        sent = {name: value for name, value in vars(arguments).items() if name != "run"}
        with make_executor(where) as workers:
            future = workers.submit(self.measure, argparse.Namespace(**sent))
            (done,) = as_completed(workers, [future])
            return done.result()

    def format(self, rows: Sequence[Record], *, markdown: bool = False) -> str:
        """Format rows as tables; rows with other columns begin another table."""
        tables = []
        for names, table_rows in groupby(self.display_rows(rows), tuple):
            header = [self.titles.get(name, title_of(name)) for name in names]
            cells = [[format_value(value) for value in row.values()] for row in table_rows]
            tables.append(format_table(header, cells, markdown=markdown))
        return "\n\n".join(tables)


def run_benchmark(
    text: str | None,
    options: Sequence[CommandOption],
    measure: Callable[[argparse.Namespace], Iterable[Record]],
    plot: Callable[[Any, Sequence[Record]], None] | None = None,
    kernels: str = "optimised",
) -> None:
    """Run a program of `benchmarks`: its docstring, its options but for those of `form`, and the function
    that yields its rows, of one table or of several; with a chart, which `plot` draws, `options.chart` is one
    of the options.

    Unless RHI_KERNELS says otherwise, cl runs these `kernels`: optimised ones, as a long run does, "quick"
    ones, or with "" those that a first run has.
    """
    os.environ.setdefault("RHI_KERNELS", kernels)
    comparison = ComparisonProgram(
        "", "", "", options, lambda arguments: Report({}, list(measure(arguments))), plot=plot
    )
    parser = Parser(description=text)
    add_options(parser, (*options, *form()))
    comparison.run(parser.parse_args())
