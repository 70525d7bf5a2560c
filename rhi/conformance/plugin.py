"""The kit's pytest plugin: its markers and the scoreboard.

It is the entry point that pytest finds, and brings `rhi.testing.plugin` with it: the option `--rhi-backend`,
which would be unknown when pytest reads its command line were it defined in a conftest below `--pyargs`, and
the fixtures for tests of one's own.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

pytest_plugins = ("rhi.testing.plugin",)

PROPERTY = "rhi-conformance"
"""Under which the kit notes in its tests' reports which backend and group they belong to."""


def pytest_configure(config: pytest.Config) -> None:
    """Declare the kit's markers."""
    config.addinivalue_line("markers", "needs(*capabilities): skipped where the device declares one missing")
    config.addinivalue_line(
        "markers", "recorded_too: runs without and with a recorder in front of the backend"
    )


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the scoreboard: per backend and group of the kit how many tests passed, failed and were skipped."""
    boards: dict[str, dict[str, Counter[str]]] = {}
    reasons: dict[str, Counter[str]] = {}
    for outcome in ("passed", "failed", "error", "skipped"):
        for report in terminalreporter.stats.get(outcome, ()):
            place = dict(getattr(report, "user_properties", ())).get(PROPERTY)
            if place is None:  # not a test of the kit
                continue
            backend, group = place
            boards.setdefault(backend, {}).setdefault(group, Counter())[outcome] += 1
            if outcome == "skipped":
                reasons.setdefault(backend, Counter())[report.longrepr[-1].removeprefix("Skipped: ")] += 1
    for backend, board in boards.items():
        terminalreporter.section(f"rhi conformance: {backend}")
        width = max(map(len, board))
        for group in sorted(board):
            _write_row(terminalreporter, f"{group:<{width}}", board[group])
        _write_row(terminalreporter, f"{'total':<{width}}", sum(board.values(), Counter()), bold=True)
        for reason, count in sorted(reasons.get(backend, {}).items()):
            terminalreporter.write_line(f"  {count:4} × {reason}")


def _write_row(
    reporter: pytest.TerminalReporter, name: str, counts: Counter[str], *, bold: bool = False
) -> None:
    failed = counts["failed"] + counts["error"]
    row = f"{name}  {counts['passed']:5} passed"
    row += f"  {failed:4} failed" if failed or bold else ""
    row += f"  {counts['skipped']:4} skipped" if counts["skipped"] or bold else ""
    reporter.write_line(row, red=bool(failed), bold=bold)
