"""`exam`: the hard cases, measured on each backend.

  python -m renderer exam
  python -m renderer exam --backend numpy --json
  python -m renderer exam --case 13 --case 21
  python -m renderer exam --executor processes:4
  python -m renderer exam --show 21 --backend cl --output case21.png

Each case has a reference, and a tolerance with its reason, which --show prints. What a device lacks is
declared in its capabilities; a case that needs it doesn't apply, and isn't passed. A case that raises an
error has failed. With --executor each case has a device of its own on a worker, and a case that ends its
process has failed, too. The exit code is 1 if a case has failed on some backend.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.options import option
from renderer.cli.output import note, open_available_devices, prepare_image, show_progress, write_image
from renderer.cli.subcommand import Subcommand
from renderer.lab.exam import CASES, Case, ExamRow, examine, examine_elsewhere, select_cases
from renderer.lab.exam.case import NOTHING
from renderer.lab.exam.case_images import join_images
from renderer.lab.measure import format_table
from rhi.errors.output_paths import check_output_file
from rhi_screen.executors import KINDS, SERIAL, make_executor

_BACKENDS: Final = ("gl", "cl", "null")
_OPTIONS: Final = (
    option(
        "--backend",
        "a registered backend; may be repeated",
        None,
        "gl, cl and null, as far as they work here",
        action="append",
        metavar="NAME",
    ),
    option("--case", "only this case; may be repeated", [], "", action="append", type=int, metavar="N"),
    options.switch("--long", "also the cases that take minutes"),
    option("--show", "print all numbers of one case", type=int, metavar="N"),
    replace(
        option(
            "--output",
            "with --show: where its images go",
            None,
            "none is written",
            type=Path,
            metavar="F.png",
        ),
        output=check_output_file,
    ),
    options.executor("cases run", KINDS),
    *options.form(),
)


def _run(arguments: argparse.Namespace) -> None:
    if arguments.output is not None:
        prepare_image(arguments.output)
    if arguments.executor != SERIAL and arguments.show is None:
        _report(_examine_elsewhere(arguments), arguments)
        return
    with ExitStack() as stack:
        devices = (
            [stack.enter_context(rhi.create_device(name)) for name in arguments.backend]
            if arguments.backend
            else open_available_devices(stack, _BACKENDS)
        )
        if arguments.show is not None:
            (case,) = select_cases([arguments.show])
            has_failed = _print_case(case, devices, arguments.output, as_json=arguments.json)
        else:
            cases = select_cases(arguments.case, are_long=arguments.long)
            rows = [
                row
                for device in devices
                for row in show_progress(examine(device, cases), device.backend_name, len(cases))
            ]
            _report(rows, arguments)
            return
    if has_failed:
        sys.exit(1)


def _examine_elsewhere(arguments: argparse.Namespace) -> list[ExamRow]:
    """Examine backends on an executor; return the rows in the order in which one process has them."""
    cases = select_cases(arguments.case, are_long=arguments.long)
    backends = arguments.backend
    if not backends:
        with ExitStack() as stack:
            backends = [device.backend_name for device in open_available_devices(stack, _BACKENDS)]
    with make_executor(arguments.executor) as executor:
        rows = list(
            show_progress(examine_elsewhere(executor, backends, cases), "exam", len(backends) * len(cases))
        )
    numbers = [case.number for case in cases]
    return sorted(rows, key=lambda row: (backends.index(row.backend), numbers.index(row.case)))


def _report(rows: Sequence[ExamRow], arguments: argparse.Namespace) -> None:
    """Print the rows; end the process with 1 if a case has failed."""
    if arguments.json:
        print(json.dumps([row.as_record() for row in rows]))
    else:
        print(format_rows_by_backend(rows, markdown=arguments.markdown))
    if any(row.passed is False for row in rows):
        sys.exit(1)


def format_rows_by_backend(rows: Sequence[ExamRow], *, markdown: bool = False) -> str:
    """Format the rows as a table with a line for each case and a column for each backend, and a line of the
    counts."""
    backends = list(dict.fromkeys(row.backend for row in rows))
    lines: dict[int, dict[str, ExamRow]] = {}
    for row in rows:
        lines.setdefault(row.case, {})[row.backend] = row
    header = ["case", "description", "reference", "tolerance", *backends]
    cells: list[list[object]] = []
    for number, rows_by_backend in lines.items():
        first = next(iter(rows_by_backend.values()))
        tolerance = f"{first.tolerance:.3g} {first.unit}"
        results = [_describe(rows_by_backend[name]) if name in rows_by_backend else "" for name in backends]
        cells.append([str(number), first.description, first.reference, tolerance, *results])
    counts = []
    for name in backends:
        passes = [row.passed for row in rows if row.backend == name and row.device_use != NOTHING]
        applied = len(passes) - passes.count(None)
        counts.append(
            f"{name}: {passes.count(True)} of {applied} passed, {passes.count(None)} not applicable"
        )
    others = [row.passed for row in rows if row.backend == backends[0] and row.device_use == NOTHING]
    if others:
        counts.append(f"that ask nothing of a device: {others.count(True)} of {len(others)} passed")
    table = format_table(header, cells, markdown=markdown)
    return f"{table}\n\n{'; '.join(counts)}"


def _describe(row: ExamRow) -> str:
    if row.passed is None:
        return row.remark
    error = "" if row.error is None else f"{row.error:.3g}"
    if row.passed:
        return error
    return f"FAILED: {'; '.join(part for part in (error, row.remark) if part)}"


def _print_case(case: Case, devices: Sequence[rhi.Device], output: Path | None, *, as_json: bool) -> bool:
    """Print a case and its results on each device; write its images."""
    report: dict[str, object] = {
        "case": case.number,
        "description": case.description,
        "reference": case.reference,
        "tolerance": f"{case.tolerance:g} {case.unit}",
        "why": case.why,
    }
    images, has_failed = {}, False
    for device in devices:
        lack = case.find_missing_capability(device.capabilities)
        if lack is not None:
            report[device.backend_name] = {"missing": lack}
            continue
        result = case.measure(device)
        passed = case.passes(result)
        has_failed |= not passed
        report[device.backend_name] = {
            "error": float(result.error),
            "passed": passed,
            **result.numbers,
            **result.holds,
        }
        if output is not None:
            case_images = result.images()
            images.update({f"{device.backend_name}: {title}": image for title, image in case_images.items()})
    print(json.dumps(report, default=str) if as_json else _list_report(report))
    if images and output is not None:
        write_image(output, join_images(images))
        note(f"wrote {output}: {', '.join(images)}")
    elif output is not None:
        note(f"case {case.number} has numbers only, no images")
    return has_failed


def _list_report(report: dict[str, object]) -> str:
    lines = []
    for name, value in report.items():
        if isinstance(value, dict):
            lines += ["", f"{name}:", *(f"  {title}: {number}" for title, number in value.items())]
        else:
            lines.append(f"{name}: {value}")
    return "\n".join(lines)


COMMAND: Final = Subcommand("exam", f"examine backends in {len(CASES)} hard cases", _OPTIONS, _run, __doc__)
