"""The kit's pytest plugin: the `--rhi-backend` option, the `needs` marker and the scoreboard.

It is registered as an entry point, since an option that is defined in a conftest below `--pyargs` is unknown
when pytest reads its command line. It imports nothing, so that it costs other test runs nothing.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pytest

OPTION = "--rhi-backend"
KIT = "rhi/conformance/"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--rhi-backend NAME`, which may be given several times."""
    parser.getgroup("rhi").addoption(
        OPTION,
        action="append",
        metavar="NAME",
        help="backend that rhi.conformance examines; repeatable (default: RHI_BACKEND, else gl)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Declare the kit's marker."""
    config.addinivalue_line("markers", "needs(*capabilities): skipped where the device declares one missing")


def get_backend_names(config: pytest.Config) -> list[str]:
    """The backends to examine, each once."""
    names = config.getoption(OPTION) or [os.environ.get("RHI_BACKEND") or "gl"]
    return list(dict.fromkeys(names))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the scoreboard: per group of the kit how many tests passed, failed and were skipped."""
    outcomes = ("passed", "failed", "error", "skipped")
    board: dict[str, dict[str, int]] = {}
    missing: dict[str, int] = {}
    for outcome in outcomes:
        for report in terminalreporter.stats.get(outcome, ()):
            _, found, path = report.nodeid.split("::")[0].rpartition(KIT)
            if not found:
                # With --pyargs a node id is relative to the invocation directory, or to the package.
                path = report.nodeid.split("::")[0]
                if not path.startswith(("operation/", "validation/")):
                    continue
            group = path.removesuffix(".py").replace("/test_", " · ").replace("_", " ")
            board.setdefault(group, dict.fromkeys(outcomes, 0))[outcome] += 1
            if outcome == "skipped":
                reason = str(report.longrepr[-1]).removeprefix("Skipped: ")
                missing[reason] = missing.get(reason, 0) + 1
    if not board:
        return
    terminalreporter.section("rhi conformance: " + ", ".join(get_backend_names(terminalreporter.config)))
    width = max(map(len, board))
    for group in sorted(board):
        counts = board[group]
        failed = counts["failed"] + counts["error"]
        line = f"{group:<{width}}  {counts['passed']:4} passed"
        line += f"  {failed:3} failed" if failed else ""
        line += f"  {counts['skipped']:3} skipped" if counts["skipped"] else ""
        terminalreporter.write_line(line, red=bool(failed))
    total = {outcome: sum(counts[outcome] for counts in board.values()) for outcome in outcomes}
    terminalreporter.write_line(
        f"{'total':<{width}}  {total['passed']:4} passed  {total['failed'] + total['error']:3} failed"
        f"  {total['skipped']:3} skipped", bold=True,
    )  # fmt: skip
    for reason, count in sorted(missing.items()):
        terminalreporter.write_line(f"  {count:4} × {reason}")
