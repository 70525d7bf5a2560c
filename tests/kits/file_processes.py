"""`pytest --file-processes N` runs the test files in groups, each in a process of its own, N side by side.

Processes that collect all tests and run them for half an hour hold four times the memory of what they are doing:
the items of all files, the modules of all of them, and what drivers keep. Here a process collects the files of its
group alone, and ends after them. The process that pytest was started in, the controller, collects nothing. It starts
the others, and passes their reports on to its own plugins, so that it prints what one process would have printed.

| class | side |
|---|---|
| `Controller` | starts processes, and hands their reports to pytest |
| `Reporter` | in such a process: writes each report as a line of JSON to a file |

A process that dies is a failure of the test that it was running, with what it wrote to standard error. The rest of
its group goes on in another process.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain, groupby, zip_longest
from math import ceil
from pathlib import Path
from typing import IO, Any, Final

import pytest
from supervised_nights import ERRORS_VARIABLE, end_processes, name_status, read_end

_GROUP_BYTES: Final = 200_000
"""Of a group's test files. A process starts in 2 s; smaller groups would spend their time with that."""
_KIT: Final = "conformance"
_PERIOD: Final = 0.05
"""Seconds between two looks at the files of reports."""


_ORDERLY: Final = (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED, pytest.ExitCode.NO_TESTS_COLLECTED)
"""Exit statuses of a process that has run its tests."""


def add_options(parser: pytest.Parser) -> None:
    """Add the options, `--file-processes` and those of a group's process."""
    group = parser.getgroup("file processes")
    group.addoption(
        "--file-processes", type=int, metavar="N", help="run test files in groups, N processes at once"
    )
    group.addoption("--file-reports", metavar="FILE", help="(of a group's process) write reports to a file")
    group.addoption("--file-finished", metavar="FILE", help="(of a group's process) omit the tests in a file")


def register_side(config: pytest.Config) -> None:
    """Register the side that this process is on, if it is on one."""
    if config.option.file_reports:
        config.pluginmanager.register(Reporter(config), "file-processes-reporter")
    elif config.option.file_processes:
        config.pluginmanager.register(Controller(config), "file-processes-controller")


class Reporter:
    """The side of a group's process."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._controller = os.getppid()
        self._path = Path(config.option.file_reports)

    def _write(self, kind: str, value: object) -> None:
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps([kind, value]) + "\n")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Omit tests that another process has run."""
        if self._config.option.file_finished:
            finished = set(Path(self._config.option.file_finished).read_text(encoding="utf-8").splitlines())
            items[:] = [item for item in items if item.nodeid not in finished]

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        """Say how many tests this process will run."""
        self._write("collected", len(session.items))

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str, location: Sequence[object]) -> None:
        """Say that a test begins; end if the controller has been killed."""
        if os.getppid() != self._controller:
            pytest.exit("the process that started this one has ended")
        self._write("started", [nodeid, list(location)])

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Pass on the report of a part of a test."""
        self._write("report", self._serialize(report))

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """Say that a test has ended."""
        self._write("finished", nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Pass on that a file couldn't be imported, or skipped itself."""
        if not report.passed:
            self._write("collect", self._serialize(report))

    def pytest_sessionfinish(self) -> None:
        """Say that the process comes to its end by itself."""
        self._write("end", None)

    def _serialize(self, report: pytest.TestReport | pytest.CollectReport) -> object:
        return self._config.hook.pytest_report_to_serializable(config=self._config, report=report)


@dataclass(eq=False)
class Group:
    """Test files that a process runs, and how far it is."""

    number: int
    files: list[Path]
    process: subprocess.Popen[bytes] | None = None
    reports: IO[str] | None = None
    collected: int | None = None
    running: tuple[str, Any] | None = None
    """The test that has started, and its location."""
    finished: list[str] = field(default_factory=list)
    has_ended: bool = False
    attempt: int = 0
    _rest: str = ""

    @property
    def size(self) -> int:
        """The bytes of its files, by which groups are weighed before anything is known of their tests."""
        return sum(path.stat().st_size for path in self.files)

    def read(self) -> Iterator[tuple[str, Any]]:
        """Yield the reports that the process has written since the last call."""
        assert self.reports is not None
        *lines, self._rest = (self._rest + self.reports.read()).split("\n")
        for line in lines:
            yield tuple(json.loads(line))

    def close(self) -> None:
        """Close the file of reports."""
        if self.reports is not None:
            self.reports.close()


class Controller:
    """The side of the process that pytest was started in."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._folder = Path(tempfile.mkdtemp(prefix="rhi-file-processes-"))
        self._groups = [
            Group(number, files)
            for number, files in enumerate(divide(list_files(config), config.option.file_processes))
        ]
        self._waiting = deque(self._groups)
        self._size = sum(group.size for group in self._groups)

    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> bool:
        """Collect nothing."""
        return True

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Run all groups; raise what `--maxfail` and `-x` ask for."""
        running: list[Group] = []
        try:
            while self._waiting or running:
                while self._waiting and len(running) < self._config.option.file_processes:
                    running.append(self._start(self._waiting.popleft()))
                for group in list(running):
                    if not self._follow(group, session):
                        running.remove(group)
                if session.shouldfail:
                    raise session.Failed(session.shouldfail)
                time.sleep(_PERIOD)
        finally:
            for group in running:
                if group.process is not None:
                    end_processes(group.process)
        return True

    def pytest_unconfigure(self) -> None:
        """Remove the files of reports."""
        for path in self._folder.iterdir():
            path.unlink()
        self._folder.rmdir()

    def _path(self, group: Group, kind: str) -> Path:
        return self._folder / f"{group.number}-{group.attempt}.{kind}"

    def _start(self, group: Group) -> Group:
        """Start a group's process on what it hasn't finished."""
        group.attempt += 1
        group.running, group.has_ended = None, False
        reports, finished = self._path(group, "reports"), self._path(group, "finished")
        reports.touch()
        finished.write_text("\n".join(group.finished), encoding="utf-8")
        command = [
            sys.executable,
            "-m",
            "pytest",
            "--continue-on-collection-errors",
            *list_options(self._config),
        ]
        command += ["--file-reports", str(reports), "--file-finished", str(finished), *map(str, group.files)]
        with self._path(group, "output").open("wb") as output:
            group.process = subprocess.Popen(
                command,
                cwd=self._config.invocation_params.dir,
                env=os.environ | {ERRORS_VARIABLE: str(self._path(group, "captured"))},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        group.reports = reports.open(encoding="utf-8")
        return group

    def _follow(self, group: Group, session: pytest.Session) -> bool:
        """Pass on what a group's process has reported; return False once the group has ended."""
        assert group.process is not None
        status = group.process.poll()  # asked before the reports are read, so none comes later
        for kind, value in group.read():
            self._take(group, kind, value, session)
        if status is None:
            return True
        end_processes(group.process)  # what it has left behind
        group.close()
        if group.has_ended and status in _ORDERLY:
            return False
        self._report_death(group, status)
        if group.running is None:  # in no test: another attempt would end in the same way
            return False
        group.finished.append(group.running[0])
        self._waiting.appendleft(group)
        return False

    def _take(self, group: Group, kind: str, value: Any, session: pytest.Session) -> None:
        hook = self._config.hook
        if kind == "collected":
            group.collected = len(group.finished) + value
            session.testscollected = self._estimate_tests()
        elif kind == "started":
            group.running = (value[0], value[1])
        elif kind == "report":
            report = hook.pytest_report_from_serializable(config=self._config, data=value)
            hook.pytest_runtest_logreport(report=report)
        elif kind == "finished":
            group.finished.append(value)
            group.running = None
        elif kind == "collect":
            report = hook.pytest_report_from_serializable(config=self._config, data=value)
            hook.pytest_collectreport(report=report)
        else:
            group.has_ended = True

    def _estimate_tests(self) -> int:
        """Return the number of all tests; groups that haven't begun have as many a byte as the others."""
        begun = [group for group in self._groups if group.collected is not None]
        tests = sum(group.collected or 0 for group in begun)
        size = sum(group.size for group in begun)
        return tests if len(begun) == len(self._groups) else round(tests * self._size / max(size, 1))

    def _report_death(self, group: Group, status: int) -> None:
        """Report a failure of the test in which a process has died, or of the group's first file."""
        test, location = group.running or (str(group.files[0]), [str(group.files[0]), 0, "collection"])
        texts = [read_end(self._path(group, kind)) for kind in ("captured", "output")]
        lines = [f"the process ended: {name_status(status)}", *(text.strip() for text in texts)]
        report = pytest.TestReport(
            nodeid=test,
            location=tuple(location),
            keywords={},
            outcome="failed",
            longrepr="\n".join(filter(None, lines)),
            when="call",
        )
        self._config.hook.pytest_runtest_logreport(report=report)


def list_options(config: pytest.Config) -> list[str]:
    """Return the command line's options, for another process: without its files, and without this plugin's."""
    options: list[str] = []
    arguments = iter(map(str, config.invocation_params.args))
    for argument in arguments:
        if argument == "--file-processes":
            next(arguments)
        elif argument not in (*config.args, "--pyargs") and not argument.startswith("--file-processes="):
            options.append(argument)
    return options


def list_files(config: pytest.Config) -> list[Path]:
    """Return the test files below the folders and packages that the command line names."""
    folder = config.invocation_params.dir
    ignored = {Path(folder, path) for path in config.option.ignore or ()}
    files: dict[Path, None] = {}
    for argument in config.args:
        path = Path(folder, argument)
        if not path.exists() and config.option.pyargs:
            path = locate_package(argument)
        members = sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
        files |= dict.fromkeys(file for file in members if file not in ignored)
    return list(files)


def locate_package(name: str) -> Path:
    """Return the folder or file of a package or module."""
    spec = importlib.util.find_spec(name)
    if spec is None or spec.origin is None:
        raise pytest.UsageError(f"no package {name}")
    path = Path(spec.origin)
    return path.parent if path.name == "__init__.py" else path


def divide(files: Sequence[Path], processes: int) -> Iterator[list[Path]]:
    """Yield groups of neighbouring files, of about the same number of bytes, at least one for each process.

    Each group has files of the kit as well as others, because those in `tests` lead pytest to the settings
    there (`conftest.py`).
    """
    count = max(processes, ceil(sum(file.stat().st_size for file in files) / _GROUP_BYTES))
    parts = [
        _divide_evenly([file for file in files if (_KIT in file.parts) == of_kit], count)
        for of_kit in (False, True)
    ]
    for group in zip_longest(*parts, fillvalue=()):
        yield list(chain(*group))


def _divide_evenly(files: Sequence[Path], count: int) -> Iterator[list[Path]]:
    """Yield at most `count` groups of neighbouring files, of about the same number of bytes."""
    sizes = [file.stat().st_size for file in files]
    total = sum(sizes)
    begins = accumulate(sizes, initial=0)
    centres = {file: begin + size / 2 for file, begin, size in zip(files, begins, sizes, strict=False)}
    for _, group in groupby(files, lambda file: int(centres[file] * count / max(total, 1))):
        yield list(group)
