"""Nightly tests in shards with a budget, and the record of when each last passed.

    python tests/kits/nights.py run [--shard K/N] [--minutes M] [--processes P] [PYTEST ARGUMENTS]
    python tests/kits/nights.py overdue [PYTEST ARGUMENTS]
    python tests/kits/nights.py merge RECORD…

`run` runs what is marked nightly, property tests with 20 times as many examples, and the conformance kit on gl,
cl, wgpu and null. `./test.sh --nightly --shard K/N --minutes M` calls it. Tests come in this order:

1. those responsible for what changed since the commit on which they last passed,
2. those that failed last,
3. the others, those first that haven't run for longest,
4. those in which the process has ended.

No test begins that would probably end after the budget, but for the first. Shards follow the durations in the
record as the commit has it: on one commit they are the same, whatever a shard has recorded meanwhile.

With `--processes P`, parts of the shard run side by side in P processes, each within the budget. Reports of deaths are
then in folders of their own, `process-1` and so on.

The tests run in a process of their own. If it dies, or a test takes far longer than it ever has, another process
goes on with the next test (`supervised_nights.py`).

The record, `tests/nights.tsv`, has a line for each test, with a tab between the columns of `Row`. Lines are appended
while the tests run, so a run that is interrupted keeps what has passed; reading sorts them, and of several for a
test the newest counts. `merge` adds the records of other machines. A commit ends in `+` if the tree differed from
it.

Each run of a test has the next seed: hypothesis takes it, and so does a test that calls `rotate_seed`.
`--hypothesis-seed` repeats a run with the seed in the record.

`overdue` collects the nightly tests, prints those that haven't passed on one of the last ten commits of
`main`, and fails if there are any. It counts those that have been skipped since: what a backend declares missing can't
pass.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import astuple, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Final

import pytest
from supervised_nights import ATTEMPT, Attempt, supervise

ROOT: Final = Path(__file__).resolve().parents[2]
RECORD: Final = ROOT / "tests" / "nights.tsv"
SEED_VARIABLE: Final = "RHI_NIGHTLY_SEED"

_RECENT_COMMITS: Final = 10
_SEEDS_PER_RUN: Final = 100_000
_UNKNOWN_SECONDS: Final = 10.0
_KIT: Final = (
    "--pyargs",
    "rhi.conformance",
    *(f"--rhi-backend={item}" for item in ("gl", "cl", "wgpu", "null")),
)
_KIT_PROPERTY: Final = "rhi-conformance"  # of the kit's tests; its plugin can't be imported before pytest
_PART_OF_SHARD: Final = 0.25
"""A file stays in one shard, which sets its fixtures up once, unless it is more than this part of it."""


@dataclass(frozen=True)
class Row:
    """A test's line in the record."""

    test: str
    outcome: str  # passed, failed, skipped; started: the process ended in it, or it took too long
    ran: str  # when it last began, in UTC
    seconds: float  # of processor time, which a busy machine doesn't change
    seed: int  # of its last run
    commit: str = "-"  # on which it last passed
    passed: str = "-"  # when it last passed


def rotate_seed(seed: int) -> int:
    """Return another seed in each run of the running test in a night; elsewhere the same."""
    return seed + _SEEDS_PER_RUN * int(os.environ.get(SEED_VARIABLE, "0"))


# -- the record ----------------------------------------------------------------------------------------------


def parse_record(text: str) -> dict[str, Row]:
    """Return a record's rows by test; a line that isn't whole is left out."""
    rows: dict[str, Row] = {}
    for line in text.splitlines():
        columns = line.split("\t")
        if len(columns) != len(fields(Row)):
            continue
        test, outcome, ran, seconds, seed, commit, passed = columns
        try:
            row = Row(test, outcome, ran, float(seconds), int(seed), commit, passed)
        except ValueError:
            continue
        rows[test] = _join(rows[test], row) if test in rows else row
    return rows


def merge_records(*records: Mapping[str, Row]) -> dict[str, Row]:
    """Return one record: of each test its newest run, and its newest pass. The order doesn't matter."""
    merged: dict[str, Row] = {}
    for record in records:
        for test, row in record.items():
            merged[test] = _join(merged[test], row) if test in merged else row
    return merged


def _join(first: Row, second: Row) -> Row:
    """Return the newer of two rows of a test, with the newer pass; a started test has then ended."""

    def age(row: Row) -> tuple[object, ...]:
        return (row.ran, row.outcome != "started", row.seed, astuple(row))

    def pass_age(row: Row) -> tuple[bool, str, str]:
        return (row.passed != "-", row.passed, row.commit)

    newer, passed = max(first, second, key=age), max(first, second, key=pass_age)
    return replace(newer, commit=passed.commit, passed=passed.passed)


_TITLES: Final = "\t".join(item.name for item in fields(Row)) + "\n"


def format_record(rows: Mapping[str, Row]) -> str:
    """Return the text of a record: the columns' names, and a line for each test, sorted."""
    return _TITLES + "".join(_format_row(rows[test]) for test in sorted(rows))


def _format_row(row: Row) -> str:
    row = replace(row, seconds=round(row.seconds, 2))
    return "\t".join(map(str, astuple(row))) + "\n"


def _lock(file: IO[str]) -> None:
    """Lock a file until it is closed. Windows can't, where no two processes run nights at once."""
    try:
        import fcntl
    except ImportError:
        return
    fcntl.flock(file, fcntl.LOCK_EX)


def read_record(path: Path) -> dict[str, Row]:
    """Return the rows of a file, none if there is no such file."""
    return parse_record(path.read_text(encoding="utf-8")) if path.is_file() else {}


def list_durations(record: Mapping[str, Row]) -> dict[str, float]:
    """Return the seconds of the tests that have run to their end, by test."""
    return {test: row.seconds for test, row in record.items() if row.seconds}


def read_processor_time() -> float:
    """Return the seconds of processor time of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def append_row(path: Path, row: Row) -> None:
    """Add a line to a record, which other processes may write too."""
    with path.open("a", encoding="utf-8") as file:
        _lock(file)
        file.write(_format_row(row))


def settle_record(path: Path, *others: Mapping[str, Row]) -> dict[str, Row]:
    """Sort a record's lines, one for each test, add other records, and return it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+", encoding="utf-8") as file:
        _lock(file)
        file.seek(0)
        rows = merge_records(parse_record(file.read()), *others)
        file.seek(0)
        file.truncate()
        file.write(format_record(rows))
    return rows


# -- which tests, in which order -----------------------------------------------------------------------------


def choose_shard(
    tests: Iterable[str], seconds: Mapping[str, float], number: int, count: int
) -> frozenset[str]:
    """Return the tests of shard `number`, from 1, of `count` shards that take about equally long."""
    files: dict[str, list[str]] = defaultdict(list)
    for test in sorted(set(tests)):
        files[test.partition("::")[0]].append(test)
    typical = statistics.median(seconds.values()) if seconds else _UNKNOWN_SECONDS
    duration = {
        test: seconds.get(test, typical) for tests_of_file in files.values() for test in tests_of_file
    }
    largest = _PART_OF_SHARD * sum(duration.values()) / count
    units: list[tuple[float, list[str]]] = []
    for members in files.values():
        total = sum(duration[test] for test in members)
        parts = [members] if total <= largest else [[test] for test in members]
        units += [(sum(duration[test] for test in part), part) for part in parts]
    shards: list[list[str]] = [[] for _ in range(count)]
    loads = [0.0] * count
    for total, part in sorted(units, key=lambda unit: (-unit[0], unit[1])):
        lightest = min(range(count), key=lambda index: (loads[index], len(shards[index]), index))
        loads[lightest] += total
        shards[lightest] += part
    return frozenset(shards[number - 1])


def order_tests(
    tests: Sequence[str], record: Mapping[str, Row], changed: Mapping[str, Collection[str]]
) -> list[str]:
    """Return tests in the order of a night.

    Args:
        changed: by commit the files and folders of tests responsible for what changed since then.

    Tests of a file that are equally urgent stay together, because they share fixtures.
    """

    def urgency(test: str) -> int:
        file = test.partition("::")[0]
        row = record.get(test)
        if row is None:
            return 2
        if row.outcome == "started":
            return 3
        if any(file == path or file.startswith(f"{path}/") for path in changed.get(row.commit, ())):
            return 0
        return 1 if row.outcome == "failed" else 2

    def last_run(test: str) -> str:
        return record[test].ran if test in record else ""

    groups: dict[tuple[int, str], list[str]] = defaultdict(list)
    for test in tests:
        groups[urgency(test), test.partition("::")[0]].append(test)
    ordered = sorted(groups.items(), key=lambda group: (group[0][0], min(map(last_run, group[1]))))
    return [test for _, group in ordered for test in sorted(group, key=last_run)]


def list_skipped(tests: Iterable[str], record: Mapping[str, Row], since: str) -> list[str]:
    """Return tests that were skipped, by name, when they last ran, at `since` or later.

    Some are always skipped: a backend that lacks a capability has nothing to show there.
    """
    rows = (record[test] for test in sorted(set(tests)) if test in record)
    return [row.test for row in rows if row.outcome == "skipped" and row.ran >= since]


def list_overdue(
    tests: Iterable[str], record: Mapping[str, Row], recent: Collection[str], since: str
) -> list[str]:
    """Return tests that have neither passed on one of the recent commits nor been skipped, each with its row.

    Args:
        since: when the oldest of the recent commits was made, in UTC.
    """
    skipped = set(list_skipped(tests, record, since))
    overdue = []
    for test in sorted(set(tests) - skipped):
        row = record.get(test)
        if row is None:
            overdue.append(f"{test}: never run")
        elif row.commit not in recent:
            passed = "never passed" if row.passed == "-" else f"passed last on {row.commit}, {row.passed}"
            overdue.append(f"{test}: {row.outcome} on {row.ran}, seed {row.seed}; {passed}")
    return overdue


# -- the plugin ----------------------------------------------------------------------------------------------


@dataclass(eq=False)  # pytest keeps plugins in sets
class Night:
    """The plugin of pytest that runs a night's tests and records them.

    `shard` is its number, from 1, and how many there are; `budget` is in seconds. Of `durations` the shards
    are made. `attempt` says where the supervisor learns which test runs, and which tests it leaves out.
    """

    path: Path
    commit: str
    shard: tuple[int, int] = (1, 1)
    budget: float | None = None
    changed: Mapping[str, Collection[str]] = field(default_factory=dict)
    durations: Mapping[str, float] | None = None
    lists_only: bool = False
    clock: Callable[[], float] = time.monotonic
    processor_clock: Callable[[], float] = read_processor_time
    attempt: Attempt | None = None

    def __post_init__(self) -> None:
        self.record = read_record(self.path)
        self.tests: list[str] = []
        self.left: list[str] = []
        self._outcomes: dict[str, str] = {}
        self._end = None if self.budget is None else self.clock() + self.budget

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        """Keep the shard's tests, in the order of the night."""
        nightly = {item.nodeid: item for item in items if _is_nightly(item)}
        self.tests = list(nightly)
        if self.lists_only:
            items[:] = []
            return
        durations = list_durations(self.record) if self.durations is None else self.durations
        shard_tests = choose_shard(nightly, durations, *self.shard)
        if self.attempt is not None:
            shard_tests -= self.attempt.list_begun()
        ordered = order_tests([test for test in nightly if test in shard_tests], self.record, self.changed)
        config.hook.pytest_deselected(items=[item for item in items if item.nodeid not in shard_tests])
        items[:] = [nightly[test] for test in ordered]

    def _fits(self, item: pytest.Item, before: float = 0.0) -> bool:
        if self._end is None:
            return True
        left = self._end - self.clock() - before
        return left > 0 and self._seconds(item) <= left

    def _seconds(self, item: pytest.Item) -> float:
        row = self.record.get(item.nodeid)
        return row.seconds if row else 0.0

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Run tests until the budget is used up. What is left keeps its place in the next night."""
        if session.config.option.collectonly or session.testsfailed:
            return None  # pytest's own loop says what failed
        settle_record(self.path)
        waiting = list(session.items)
        item = waiting.pop(0) if waiting else None
        while item is not None:
            following = None
            for index, waiting_item in enumerate(waiting):
                if self._fits(waiting_item, self._seconds(item)):
                    self.left += [skipped.nodeid for skipped in waiting[:index]]
                    following = waiting_item
                    del waiting[: index + 1]
                    break
            self._run(item, following)
            if session.shouldfail:
                raise session.Failed(session.shouldfail)
            if session.shouldstop:
                raise session.Interrupted(session.shouldstop)
            if following is not None and not self._fits(following):
                self.left.append(following.nodeid)
                following = None
            item = following
        self.left += [waiting_item.nodeid for waiting_item in waiting]
        return True

    def _run(self, item: pytest.Item, following: pytest.Item | None) -> None:
        """Run a test with its next seed, and record it before and after."""
        previous = self.record.get(item.nodeid)
        repeated = item.config.getoption("--hypothesis-seed", None)
        seed = int(repeated) if repeated else previous.seed + 1 if previous else 1
        now = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        row = Row(
            item.nodeid,
            "started",
            now,
            previous.seconds if previous else 0.0,
            seed,
            previous.commit if previous else "-",
            previous.passed if previous else "-",
        )
        append_row(self.path, row)
        _seed_hypothesis(seed)
        os.environ[SEED_VARIABLE] = str(seed)
        begin = self.processor_clock()
        left = None if self._end is None else self._end - self.clock()
        with nullcontext() if self.attempt is None else self.attempt.limit(row.test, row.seconds, left):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        row = replace(
            row, seconds=self.processor_clock() - begin, outcome=self._outcomes.get(item.nodeid, "failed")
        )
        if row.outcome == "passed":
            row = replace(row, commit=self.commit, passed=now)
        append_row(self.path, row)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the worst outcome of a test's phases; a failure that is expected passes."""
        outcome = "passed" if hasattr(report, "wasxfail") and not report.failed else report.outcome
        if self._outcomes.get(report.nodeid, "passed") == "passed" or outcome == "failed":
            self._outcomes[report.nodeid] = outcome

    def pytest_sessionfinish(self) -> None:
        """Sort the record, and forget the seed."""
        _seed_hypothesis(None)
        os.environ.pop(SEED_VARIABLE, None)
        if not self.lists_only:
            self.record = settle_record(self.path)
        if self.attempt is not None:
            self.attempt.finish()

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """Say how many tests the budget left for another night."""
        if self.left:
            terminalreporter.write_line(f"{len(self.left)} tests are left for another night")


def _seed_hypothesis(seed: int | None) -> None:
    """Set the seed of property tests, as `--hypothesis-seed` does."""
    from hypothesis import core  # pytest rewrites its assertions only if nothing has imported it before

    vars(core)["global_force_seed"] = seed


def _is_nightly(item: pytest.Item) -> bool:
    is_property = getattr(getattr(item, "obj", None), "is_hypothesis_test", False)
    is_of_kit = any(name == _KIT_PROPERTY for name, _ in item.user_properties)
    return is_property or is_of_kit or item.get_closest_marker("nightly") is not None


# -- commands ------------------------------------------------------------------------------------------------


def _git(*arguments: str) -> str | None:
    done = subprocess.run(
        ["git", *arguments],
        cwd=ROOT,
        env=os.environ | {"TZ": "UTC"},
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    return done.stdout if done.returncode == 0 else None


def _name_commit() -> str:
    """Return the tree's commit, with a `+` if files other than the record differ from it."""
    commit = (_git("rev-parse", "HEAD") or "-").strip()
    path = RECORD.relative_to(ROOT).as_posix()
    return commit + ("+" if _git("status", "--porcelain", "--", ".", f":!{path}") else "")


def _list_recent_commits() -> tuple[list[str], str]:
    """Return the last commits of `main`, and when the oldest of them was made, in UTC."""
    newest = ("log", "-n", str(_RECENT_COMMITS), "--first-parent", "--format=%H %cd")
    lines = (_git(*newest, "--date=format-local:%Y-%m-%dT%H:%M:%SZ", "main") or "").splitlines()
    commits = [line.split() for line in lines]
    return [commit for commit, _ in commits], min((date for _, date in commits), default="")


def _list_changed(record: Mapping[str, Row]) -> dict[str, list[str]]:
    """Return by commit of the record the tests responsible for what changed since then.

    Of a commit that this clone doesn't have, as a shallow one, nothing is listed.
    """
    sys.path.append(str(ROOT / "tests" / "meta"))
    from responsible_tests import choose_changed_tests, list_changed_files

    responsible: dict[str, list[str]] = {}
    changed: dict[str, list[str]] = {}
    for commit in sorted({row.commit for row in record.values()} - {"-"}):
        if _git("cat-file", "-e", f"{commit.rstrip('+')}^{{commit}}") is None:
            continue
        tests: dict[str, None] = {}
        for file in list_changed_files(ROOT, commit.rstrip("+")):
            if file not in responsible:
                responsible[file] = choose_changed_tests(ROOT, [file])
            tests |= dict.fromkeys(responsible[file])
        changed[commit] = [test for test in tests if (ROOT / test).exists()]
    return changed


def _parse_shard(text: str) -> tuple[int, int]:
    number, _, count = text.partition("/")
    if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
        raise argparse.ArgumentTypeError(f"{text!r} is no shard: K/N with 1 ≤ K ≤ N, such as 2/8")
    return int(number), int(count)


def _parse_processes(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of processes, 1 or more")
    return int(text)


def _parse_minutes(text: str) -> float:
    try:
        minutes = float(text)
    except ValueError:
        minutes = 0.0
    if not 0.0 < minutes < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is no number of minutes above 0")
    return minutes


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; return the exit status."""
    parser = argparse.ArgumentParser(prog="nights.py", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--record", type=Path, default=RECORD, help="the file, instead of tests/nights.tsv")
    commands = parser.add_subparsers(dest="command", required=True)
    for command, explained in (("run", "run a shard's tests within a budget"), (ATTEMPT, argparse.SUPPRESS)):
        run = commands.add_parser(command, help=explained)
        run.add_argument("--shard", type=_parse_shard, default=(1, 1), metavar="K/N")
        run.add_argument("--minutes", type=_parse_minutes, metavar="M")
        run.add_argument("--processes", type=_parse_processes, default=1, metavar="P")
        run.add_argument("--folder", type=Path, default=ROOT / "out" / "nights", help="of reports of deaths")
    commands.add_parser("overdue", help="print what hasn't passed on the last ten commits of main")
    merge = commands.add_parser("merge", help="add records of other machines")
    merge.add_argument("records", nargs="+", type=Path)
    options, rest = parser.parse_known_args(arguments)
    if options.command == "merge":
        if rest:
            parser.error(f"unknown: {' '.join(rest)}")
        missing = [str(path) for path in options.records if not path.is_file()]
        if missing:
            parser.error(f"no such file: {', '.join(missing)}")
        settle_record(options.record, *map(read_record, options.records))
        return 0
    sys.path.insert(0, str(ROOT))
    record = read_record(options.record)
    named = [path for path in rest if Path(path.partition("::")[0]).exists()]
    every = ["-m", "", "--hypothesis-profile", "nightly", *rest]
    every += [] if named else [str(ROOT / "tests"), *_KIT]
    if options.command == "overdue":
        night = Night(options.record, "-", lists_only=True)
        status = int(pytest.main(["--collect-only", "-qq", *every], plugins=[night]))
        if status not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED):
            return status
        recent, since = _list_recent_commits()
        overdue = list_overdue(night.tests, record, recent, since)
        skipped = len(list_skipped(night.tests, record, since))
        counts = f"{len(overdue)} of {len(night.tests)} nightly tests are overdue, {skipped} were skipped"
        print("\n".join([*overdue, counts]))
        return 1 if overdue else 0
    budget = None if options.minutes is None else 60.0 * options.minutes
    if options.command == "run" and options.processes > 1:
        return _run_side_by_side(options, rest)
    if options.command == "run":
        return _supervise(options, budget, rest)
    committed = _git("show", f"HEAD:{RECORD.relative_to(ROOT).as_posix()}") or ""
    attempt = Attempt(options.folder)
    night = Night(
        options.record,
        _name_commit(),
        options.shard,
        budget,
        _list_changed(record),
        list_durations(parse_record(committed)),
        attempt=attempt,
    )
    return int(pytest.main([*every, *attempt.options], plugins=[night]))


def _run_side_by_side(options: argparse.Namespace, rest: Sequence[str]) -> int:
    """Run the parts of a shard in processes of their own; return the worst exit status."""
    shutil.rmtree(options.folder, ignore_errors=True)
    number, count = options.shard
    first, parts = (number - 1) * options.processes + 1, count * options.processes
    minutes = [] if options.minutes is None else ["--minutes", str(options.minutes)]
    running = []
    for index in range(options.processes):
        command = [sys.executable, str(Path(__file__)), "--record", str(options.record), "run", *minutes]
        command += ["--shard", f"{first + index}/{parts}"]
        command += ["--folder", str(options.folder / f"process-{index + 1}"), *rest]
        running.append(subprocess.Popen(command))
    try:
        statuses = {process.wait() for process in running}
    except KeyboardInterrupt:  # which the terminal sends to all of them
        for process in running:
            process.wait()
        raise
    statuses -= {int(pytest.ExitCode.NO_TESTS_COLLECTED)} if len(statuses) > 1 else set()
    return max(map(abs, statuses))


def _supervise(options: argparse.Namespace, budget: float | None, rest: Sequence[str]) -> int:
    """Run the shard in other processes; record the tests in which one ended."""

    def record_end(test: str, seconds: float) -> None:
        row = read_record(options.record).get(test)
        if row is not None:
            append_row(options.record, replace(row, seconds=seconds))
            settle_record(options.record)

    command = [sys.executable, str(Path(__file__)), "--record", str(options.record), ATTEMPT]
    command += ["--shard", "{}/{}".format(*options.shard)]
    return supervise(command, rest, options.folder, budget, record_end)


if __name__ == "__main__":
    sys.exit(main())
