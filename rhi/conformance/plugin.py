"""The kit's pytest plugin: its markers, the order of its tests, the scoreboard, and what to implement next.

- The tests run in the order of the steps of a port, so `pytest -x` stops at the first problem.
- A test that fails because a method of the backend is missing is reported as "missing", apart from failures:
  the scoreboard counts it, and no traceback is printed for it, which would say no more.

The kit's conftest registers it, so pytest imports it only when it collects the kit. The option
`--rhi-backend` comes from `rhi_pytest`, which pytest loads through an entry point: it would not know the
option if a conftest below `--pyargs` defined it.
"""

from __future__ import annotations

import gc
import sys
from collections import Counter, defaultdict
from collections.abc import Generator
from typing import Any, Final

import pytest

from rhi.conformance.port_steps import STEPS, missing_method, step_of

pytest_plugins = ("rhi_pytest",)

PROPERTY: Final = "rhi-conformance"
"""Key of the user property that holds the backend and group of a kit test."""
MISSED: Final = pytest.StashKey[str]()
"""The backend method because of which a test failed."""
MISSING: Final = "rhi-missing-method"
"""Key of the user property that holds the missing backend method of a failed test."""
FAILED: Final = pytest.StashKey[bool]()
"""Key of the stash of a kit test that has failed in any of its phases."""
MAX_SHOWN: Final = 5


def pytest_configure(config: pytest.Config) -> None:
    """Declare the kit's markers."""
    config.addinivalue_line(
        "markers", "requires(*capabilities): skipped where the device declares one missing"
    )
    config.addinivalue_line("markers", "threads: starts threads; skipped where Python can't")
    config.addinivalue_line(
        "markers", "recorded_too: runs without and with a recorder in front of the backend"
    )


def has_threads() -> bool:
    """Return whether Python can start threads here; in a browser, in Pyodide, it can't."""
    emscripten = getattr(sys, "_emscripten_info", None)
    return emscripten is None or bool(emscripten.pthreads)


@pytest.fixture(scope="module")
def quick_collections() -> None:
    """Exclude older objects from garbage collections in a module that runs many of them.

    After thousands of tests one takes 0.7 s, most of it for shaders' syntax trees.
    """
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Sort the kit's tests of each backend by the steps of a port. Other tests keep their places."""
    positions: list[int] = []
    kit_tests: list[tuple[str, int, pytest.Item]] = []
    for position, item in enumerate(items):
        key = _board_key(item)
        if key is not None:
            positions.append(position)
            kit_tests.append((key[0], step_of(key[1]), item))
    order = list(dict.fromkeys(backend for backend, _, _ in kit_tests))
    kit_tests.sort(key=lambda entry: (order.index(entry[0]), entry[1]))
    for position, (_, _, item) in zip(positions, kit_tests, strict=True):
        items[position] = item


def _board_key(entry: pytest.Item | pytest.TestReport) -> tuple[str, str] | None:
    """Return the backend and group of a kit test, or None for another test."""
    key: Any = dict(getattr(entry, "user_properties", ())).get(PROPERTY)
    return None if key is None else (key[0], key[1])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Attach to a failed kit test the backend method that it is missing.

    Such a failure is replaced by a line with the method's name: formatting the tracebacks of 1,600 would take
    a minute.
    """
    method = ""
    if call.excinfo is not None and _board_key(item) is not None:
        method = missing_method(call.excinfo.value)
        if call.when == "teardown":  # it fails because of what the test has left behind
            method = method or item.stash.get(MISSED, "")
        if method:
            item.stash[MISSED] = method
            try:
                pytest.fail(f"{method} is missing", pytrace=False)
            except pytest.fail.Exception as missing:
                call.excinfo = pytest.ExceptionInfo.from_exception(missing)
    report = yield
    if report.failed and _board_key(item) is not None:
        item.stash[FAILED] = True
        report.user_properties.append((MISSING, method))
    return report


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(
    report: pytest.CollectReport | pytest.TestReport,
) -> tuple[str, str, object] | None:
    """Count a kit test that fails for a missing method as "missing"."""
    if report.failed and dict(getattr(report, "user_properties", ())).get(MISSING):
        return "missing", "m", ("MISSING", {"red": True})
    return None


class Board:
    """The results of the kit's tests on one backend. A test counts once, also if its teardown fails too."""

    def __init__(self) -> None:
        self._counted: set[str] = set()
        self.groups: dict[str, Counter[str]] = defaultdict(Counter)
        self.reasons: Counter[str] = Counter()
        self.missing: dict[str, set[str]] = defaultdict(set)
        self.failed: dict[str, list[str]] = defaultdict(list)

    def add(self, outcome: str, group: str, report: pytest.TestReport) -> None:
        """Count one report, the worst of a test first."""
        if report.nodeid in self._counted:
            return
        self._counted.add(report.nodeid)
        self.groups[group][outcome] += 1
        if outcome == "skipped" and isinstance(report.longrepr, tuple):
            self.reasons[report.longrepr[-1].removeprefix("Skipped: ")] += 1
        if report.failed:
            method = dict(report.user_properties).get(MISSING)
            if isinstance(method, str) and method:
                self.missing[method].add(report.nodeid)
            self.failed[group].append(report.nodeid.partition("::")[2])


@pytest.hookimpl(wrapper=True, tryfirst=True)  # after pytest's own summary, which has a line for each failure
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> Generator[None]:
    """Print the scoreboard: per backend and group of the kit how many tests passed, failed and were
    skipped."""
    yield
    boards: dict[str, Board] = defaultdict(Board)
    for outcome in ("failed", "error", "missing", "passed", "skipped"):
        for report in terminalreporter.stats.get(outcome, ()):
            key = _board_key(report)
            if key is not None:
                boards[key[0]].add(outcome, key[1], report)
    # The board that names the next step is printed last.
    for backend, board in sorted(boards.items(), key=lambda entry: entry[0] != "any"):
        terminalreporter.section(f"rhi conformance: {backend}")
        _write_board(terminalreporter, board)


def _write_board(reporter: pytest.TerminalReporter, board: Board) -> None:
    width = max(map(len, board.groups))
    for group in sorted(board.groups, key=lambda group: (step_of(group), group)):
        number = step_of(group)
        step = str(number) if number <= len(STEPS) else ""
        _write_row(reporter, f"{step:>2} {group:<{width}}", board.groups[group])
    _write_row(reporter, f"   {'total':<{width}}", sum(board.groups.values(), Counter()), bold=True)
    for reason, count in sorted(board.reasons.items()):
        reporter.write_line(f"  {count:4} × {reason}")
    for line in describe_next(board):
        reporter.write_line(line, bold=True)


def _write_row(
    reporter: pytest.TerminalReporter, name: str, counts: Counter[str], *, bold: bool = False
) -> None:
    failed = counts["failed"] + counts["error"] + counts["missing"]
    row = f"{name}  {counts['passed']:5} passed"
    row += f"  {failed:4} failed" if failed or bold else ""
    row += f"  {counts['skipped']:4} skipped" if counts["skipped"] or bold else ""
    reporter.write_line(row, red=bool(failed), bold=bold)


def describe_next(board: Board) -> list[str]:
    """Return the lines about the first step with a failure: its missing methods, or else its failing
    tests."""
    if not board.failed:
        return []
    number = min(map(step_of, board.failed))
    if number > len(STEPS):
        return []
    step = STEPS[number - 1]
    lines = [f"next: step {number}, {step.title} (python -m rhi docs porting)"]
    early = {method for earlier_step in STEPS[:number] for method in earlier_step.methods}
    lacking = [method for method in board.missing if method in early]
    lacking.sort(key=lambda method: -len(board.missing[method]))
    if lacking:
        return [
            *lines,
            *(f"  write {method}: {len(board.missing[method])} tests stop there" for method in lacking),
        ]
    failed = [f"{group}: {test}" for group in step.groups for test in board.failed.get(group, ())]
    more = [f"  … and {len(failed) - MAX_SHOWN} more"] if len(failed) > MAX_SHOWN else []
    return [*lines, *(f"  {test}" for test in failed[:MAX_SHOWN]), *more]
