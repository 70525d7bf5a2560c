"""Nights: which tests run in which order, what is recorded, and what an interrupted run keeps."""

from __future__ import annotations

import itertools
import random
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import nights
import pytest
from hypothesis import given
from hypothesis import strategies as st
from nights import (
    Night,
    Row,
    choose_shard,
    format_record,
    list_overdue,
    list_skipped,
    main,
    merge_records,
    order_tests,
    parse_record,
    read_record,
    rotate_seed,
)

pytest_plugins = ["pytester"]

TESTS = """
import pytest

pytestmark = pytest.mark.nightly

@pytest.mark.parametrize("number", range(6))
def test_passes(number):
    pass

def test_fails():
    assert False

def test_skips():
    pytest.skip("not here")

@pytest.mark.xfail(strict=True)
def test_is_expected_to_fail():
    assert False
"""


def row(
    test: str,
    outcome: str = "passed",
    ran: str = "2020-01-01T00:00:00Z",
    *,
    seconds: float = 1.0,
    seed: int = 1,
    commit: str = "-",
    passed: str = "-",
) -> Row:
    return Row(test, outcome, ran, seconds, seed, commit, passed)


rows = st.builds(
    row,
    st.sampled_from(["a.py::test_a", "a.py::test_b[1]", "b.py::test_c"]),
    st.sampled_from(["passed", "failed", "skipped", "started"]),
    st.sampled_from([f"2020-01-0{day}T00:00:00Z" for day in range(1, 5)]),
    seconds=st.integers(0, 900).map(lambda number: number / 4),
    seed=st.integers(1, 9),
    commit=st.sampled_from(["-", "aaaa", "bbbb+"]),
    passed=st.sampled_from(["-", "2020-01-01T00:00:00Z", "2020-01-03T00:00:00Z"]),
)
records = st.lists(rows, max_size=6).map(
    lambda lines: merge_records(*({table_row.test: table_row} for table_row in lines))
)


# -- the record ----------------------------------------------------------------------------------------------


@given(records, records, records)
def test_records_are_merged_in_any_order_and_any_number_of_times(
    first: dict[str, Row], second: dict[str, Row], third: dict[str, Row]
) -> None:
    merged = merge_records(first, second, third)
    for order in itertools.permutations([first, second, third]):
        assert merge_records(*order, first) == merged
    assert merge_records(merge_records(first, second), third) == merged
    assert parse_record(format_record(merged)) == merged
    assert parse_record(format_record(first) + format_record(second) + format_record(third)) == merged


def test_a_newer_failure_keeps_the_last_pass() -> None:
    passed = row("a.py::test_a", ran="2020-01-01T00:00:00Z", commit="aaaa", passed="2020-01-01T00:00:00Z")
    failed = row("a.py::test_a", "failed", "2020-01-02T00:00:00Z")
    (merged,) = merge_records({"a": failed}, {"a": passed}).values()
    assert (merged.outcome, merged.ran) == ("failed", "2020-01-02T00:00:00Z")
    assert (merged.commit, merged.passed) == ("aaaa", "2020-01-01T00:00:00Z")


def test_a_line_that_was_cut_off_is_left_out() -> None:
    text = format_record({"a": row("a.py::test_a"), "b": row("b.py::test_b")})
    titles, first, _ = text.splitlines(keepends=True)
    for end in range(len(titles) + len(first), len(text) - 3):
        assert set(parse_record(text[:end])) == {"a.py::test_a"}
    assert len(parse_record(text)) == 2


def test_the_record_is_merged_by_a_command(tmp_path: Path) -> None:
    for name, test in [("first", "b.py::test_b"), ("second", "a.py::test_a")]:
        (tmp_path / name).write_text(format_record({test: row(test)}), encoding="utf-8")
    record = tmp_path / "record.tsv"
    assert main(["--record", str(record), "merge", str(tmp_path / "first"), str(tmp_path / "second")]) == 0
    assert list(read_record(record)) == ["a.py::test_a", "b.py::test_b"]
    before = record.read_text(encoding="utf-8")
    assert main(["--record", str(record), "merge", str(tmp_path / "second")]) == 0
    assert record.read_text(encoding="utf-8") == before


def test_tests_without_a_recent_pass_are_overdue() -> None:
    record = {
        text.test: text
        for text in [
            row("a.py::recent", commit="new", passed="2020-01-02T00:00:00Z"),
            row("a.py::old", commit="old", passed="2020-01-01T00:00:00Z"),
            row("a.py::differs", commit="new+", passed="2020-01-02T00:00:00Z"),
            row("a.py::failed", "failed"),
            row("a.py::skipped", "skipped", "2020-01-03T00:00:00Z"),
            row("a.py::skipped_long_ago", "skipped", "2020-01-01T00:00:00Z"),
        ]
    }
    since = "2020-01-02T00:00:00Z"
    overdue = list_overdue([*record, "a.py::unknown"], record, ["new"], since)
    assert [text.partition(":")[2].partition(": ")[0] for text in overdue] == [
        ":differs",
        ":failed",
        ":old",
        ":skipped_long_ago",
        ":unknown",
    ]
    assert overdue[-1].endswith("never run")
    assert list_overdue(["a.py::recent"], record, ["new"], since) == []
    assert list_skipped([*record, "a.py::unknown"], record, since) == ["a.py::skipped"]


# -- shards and order ----------------------------------------------------------------------------------------


@given(st.integers(1, 9), st.integers(0, 60), st.integers(0, 2**20))
def test_shards_have_every_test_exactly_once(count: int, number: int, seed: int) -> None:
    chance = random.Random(seed)
    tests = [f"{chance.choice('abc')}.py::test_{index}" for index in range(number)]
    seconds = {test: chance.uniform(0.0, 90.0) for test in tests if chance.random() < 0.8}
    shards = [choose_shard(tests, seconds, shard_number, count) for shard_number in range(1, count + 1)]
    assert sorted(test for shard in shards for test in shard) == sorted(tests)
    assert shards[0] == choose_shard(reversed(tests), seconds, 1, count)


def test_shards_take_about_equally_long() -> None:
    chance = random.Random(1)
    seconds = {f"{file}.py::test_{n}": chance.uniform(0.1, 60.0) for file in "abcdefgh" for n in range(40)}
    loads = [sum(seconds[test] for test in choose_shard(seconds, seconds, shard, 8)) for shard in range(1, 9)]
    assert max(loads) < 1.1 * sum(loads) / 8


def test_a_short_file_stays_in_one_shard() -> None:
    seconds = {f"long.py::test_{n}": 100.0 for n in range(20)} | {
        f"short.py::test_{n}": 1.0 for n in range(9)
    }
    short = [
        sum("short" in test for test in choose_shard(seconds, seconds, shard, 4)) for shard in (1, 2, 3, 4)
    ]
    assert sorted(short) == [0, 0, 0, 9]


def test_a_night_runs_changed_tests_first_then_failed_tests_then_those_that_waited_longest() -> None:
    tests = ["ended.py::t", "new.py::t", "old.py::t", "failed.py::t", "never.py::t", "some/changed.py::t"]
    record = {
        "ended.py::t": row("ended.py::t", "started", "2019-01-01T00:00:00Z"),
        "new.py::t": row("new.py::t", ran="2020-01-03T00:00:00Z"),
        "old.py::t": row("old.py::t", ran="2020-01-01T00:00:00Z"),
        "failed.py::t": row("failed.py::t", "failed", "2020-01-04T00:00:00Z"),
        "some/changed.py::t": row("some/changed.py::t", ran="2020-01-05T00:00:00Z"),
    }
    expected = ["some/changed.py::t", "failed.py::t", "never.py::t", "old.py::t", "new.py::t", "ended.py::t"]
    assert order_tests(tests, record, {"-": ["some"]}) == expected
    assert order_tests(tests[::-1], record, {"-": ["some/changed.py"]}) == expected
    assert order_tests(tests, record, {"-": ["som"]})[0] == "failed.py::t"


def test_a_test_is_urgent_if_something_changed_since_it_last_passed() -> None:
    """Of two tests of a folder that has changed between the commits, only that which passed before."""
    tests = ["some/a.py::t", "some/b.py::t", "other.py::t"]
    record = {
        "some/a.py::t": row("some/a.py::t", ran="2020-01-02T00:00:00Z", commit="new"),
        "some/b.py::t": row("some/b.py::t", ran="2020-01-03T00:00:00Z", commit="old+"),
        "other.py::t": row("other.py::t", ran="2020-01-01T00:00:00Z", commit="old+"),
    }
    expected = ["some/b.py::t", "other.py::t", "some/a.py::t"]
    assert order_tests(tests, record, {"old+": ["some"], "new": []}) == expected


def test_tests_of_a_file_stay_together() -> None:
    tests = ["a.py::1", "b.py::1", "a.py::2", "b.py::2"]
    record = {"a.py::1": row("a.py::1", ran="2020-01-03T00:00:00Z"), "b.py::1": row("b.py::1")}
    assert order_tests(tests, record, {}) == ["a.py::2", "a.py::1", "b.py::2", "b.py::1"]


# -- runs ----------------------------------------------------------------------------------------------------


@pytest.fixture
def folder(pytester: pytest.Pytester) -> pytest.Pytester:
    pytester.makeini("[pytest]\nmarkers = nightly: takes long")
    pytester.makepyfile(test_some=TESTS)
    return pytester


def run(folder: pytest.Pytester, night: Night, *arguments: str) -> list[str]:
    """Run a night, and return the tests in the order in which they ran."""
    result = folder.inline_run("-p", "no:randomly", *arguments, plugins=[night])
    return [call.item.nodeid for call in result.getcalls("pytest_runtest_protocol")]


def test_a_run_records_every_outcome(folder: pytest.Pytester) -> None:
    path = folder.path / "record.tsv"
    assert len(run(folder, Night(path, "aaaa"))) == 9
    record = read_record(path)
    outcomes = {test.partition("::")[2]: (row.outcome, row.commit) for test, row in record.items()}
    assert outcomes.pop("test_fails") == ("failed", "-")
    assert outcomes.pop("test_skips") == ("skipped", "-")
    assert set(outcomes.values()) == {("passed", "aaaa")}
    assert path.read_text(encoding="utf-8") == format_record(record)


def test_the_next_night_begins_with_the_failure_and_rotates_seeds(folder: pytest.Pytester) -> None:
    path = folder.path / "record.tsv"
    run(folder, Night(path, "aaaa"))
    again = run(folder, Night(path, "bbbb"))
    assert again[0] == "test_some.py::test_fails"
    assert {row.seed for row in read_record(path).values()} == {2}
    run(folder, Night(path, "bbbb"), "--hypothesis-seed", "7")
    assert {row.seed for row in read_record(path).values()} == {7}


def test_a_night_leaves_out_tests_of_the_default_run_except_property_tests(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        test_day="""
        from hypothesis import given, strategies
        def test_plain(): pass
        @given(strategies.integers())
        def test_property(number): pass
        """
    )
    assert run(pytester, Night(pytester.path / "record.tsv", "a")) == ["test_day.py::test_property"]


def test_tests_of_several_folders_with_plugins_of_their_own_run(pytester: pytest.Pytester) -> None:
    """As those of the project and of the conformance kit: pytest then leaves plugins out by folder."""
    for name in ("first", "second"):
        folder = pytester.mkdir(name)
        (folder / "conftest.py").write_text("def pytest_runtest_logreport(report): pass", encoding="utf-8")
        (folder / f"test_{name}.py").write_text(TESTS, encoding="utf-8")
    pytester.makeini("[pytest]\nmarkers = nightly: takes long")
    assert len(run(pytester, Night(pytester.path / "record.tsv", "a"))) == 18


def test_shards_of_a_run_cover_it_once(folder: pytest.Pytester) -> None:
    path = folder.path / "record.tsv"
    ran = [run(folder, Night(path, "a", (shard, 3), durations={})) for shard in (1, 2, 3)]
    assert all(ran)
    tests = [test for shard in ran for test in shard]
    assert len(tests) == len(set(tests)) == len(read_record(path)) == 9


class Clock:
    """A clock that goes on a second each time it is read."""

    def __init__(self) -> None:
        self.times = itertools.count()

    def __call__(self) -> float:
        return float(next(self.times))


def test_a_budget_ends_the_night_and_the_next_goes_on(folder: pytest.Pytester) -> None:
    path = folder.path / "record.tsv"
    nights_needed = 0
    ran: list[str] = []
    while len(set(ran)) < 9 and nights_needed < 9:
        night = Night(path, "a", budget=12.0, clock=Clock())
        tests = run(folder, night)
        assert 0 < len(tests) < 9
        assert sorted([*tests, *night.left]) == sorted(night.tests)
        ran += tests
        nights_needed += 1
    assert len(set(ran)) == 9
    assert nights_needed > 1


def test_a_test_longer_than_the_remaining_budget_waits_and_a_shorter_test_runs(
    folder: pytest.Pytester,
) -> None:
    path = folder.path / "record.tsv"
    long = "test_some.py::test_passes[2]"
    path.write_text(
        format_record({long: row(long, seconds=900.0, ran="2000-01-01T00:00:00Z")}), encoding="utf-8"
    )
    night = Night(path, "a", budget=600.0)
    assert len(run(folder, night)) == 8
    assert night.left == [long]
    assert run(folder, Night(path, "a", budget=600.0), "-k", "test_passes and 2") == [long]


def test_seconds_are_of_the_processor_also_in_processes_but_not_of_waiting(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nmarkers = nightly: takes long")
    pytester.makepyfile(
        test_costs="""
        import subprocess, sys, time
        import pytest
        pytestmark = pytest.mark.nightly
        WORK = "import time\\nwhile time.process_time() < 1.0: pass"
        def test_waits():
            time.sleep(1.0)
        def test_works():
            begin = time.process_time()
            while time.process_time() < begin + 1.0: pass
        def test_calls():
            subprocess.run([sys.executable, "-S", "-c", WORK], check=True)
        """
    )
    path = pytester.path / "record.tsv"
    run(pytester, Night(path, "a"))
    seconds = {row.test.partition("::")[2]: row.seconds for row in read_record(path).values()}
    assert seconds["test_waits"] < 0.5
    assert all(0.9 < seconds[name] < 1.9 for name in ("test_works", "test_calls"))


def test_fixtures_of_a_file_are_set_up_once_though_a_test_is_left_out(pytester: pytest.Pytester) -> None:
    pytester.makeini("[pytest]\nmarkers = nightly: takes long")
    pytester.makepyfile(
        test_shared="""
        import pytest
        pytestmark = pytest.mark.nightly
        count = []
        @pytest.fixture(scope="module")
        def shared():
            count.append(1)
            yield count
            print("torn down", len(count))
        @pytest.mark.parametrize("number", range(4))
        def test_shares(shared, number):
            assert len(shared) == 1
        """
    )
    path = pytester.path / "record.tsv"
    long = "test_shared.py::test_shares[1]"
    path.write_text(format_record({long: row(long, seconds=900.0)}), encoding="utf-8")
    run(pytester, Night(path, "a", budget=600.0))
    record = read_record(path)
    assert [outcome_row.outcome for outcome_row in record.values() if outcome_row.passed != "-"] == [
        "passed"
    ] * 3


def run_apart(folder: pytest.Pytester, path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    kits = Path(nights.__file__).parent
    text = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(kits)!r})
import pytest
from nights import Night
sys.exit(pytest.main({list(arguments)!r}, plugins=[Night(Path({str(path)!r}), "a")]))
"""
    return subprocess.run(
        [sys.executable, "-c", text],
        cwd=folder.path,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


@pytest.mark.parametrize("end", ["os._exit(3)", "raise KeyboardInterrupt"])
def test_an_interrupted_run_records_the_tests_that_passed(pytester: pytest.Pytester, end: str) -> None:
    pytester.makeini("[pytest]\nmarkers = nightly: takes long")
    pytester.makepyfile(
        test_some=f"""
        import os, pytest
        pytestmark = pytest.mark.nightly
        def test_a(): pass
        def test_b(): {end}
        def test_c(): pass
        """
    )
    path = pytester.path / "record.tsv"
    assert run_apart(pytester, path).returncode != 0
    record = {test.partition("::")[2]: row for test, row in read_record(path).items()}
    assert set(record) == {"test_a", "test_b"}
    assert (record["test_a"].outcome, record["test_a"].commit) == ("passed", "a")
    assert record["test_b"].outcome != "passed"
    assert run_apart(pytester, path, "-k", "not test_b").returncode == 0
    after = {test.partition("::")[2]: row.outcome for test, row in read_record(path).items()}
    assert (after["test_a"], after["test_c"]) == ("passed", "passed")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--shard", "0/2"], "no shard"),
        (["--shard", "3/2"], "no shard"),
        (["--shard", "2"], "no shard"),
        (["--minutes", "0"], "no number of minutes"),
        (["--minutes", "nan"], "no number of minutes"),
        (["--minutes", "soon"], "no number of minutes"),
        (["--processes", "0"], "no number of processes"),
        (["--processes", "many"], "no number of processes"),
    ],
)
def test_bad_options_are_refused(
    arguments: Sequence[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["run", *arguments])
    assert says in capsys.readouterr().err


def test_seeds_rotate_in_nights_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(nights.SEED_VARIABLE, raising=False)
    assert [rotate_seed(seed) for seed in (0, 5)] == [0, 5]
    seeds: set[int] = set()
    for number in (1, 2, 3):
        monkeypatch.setenv(nights.SEED_VARIABLE, str(number))
        seeds |= {rotate_seed(seed) for seed in range(1000)}
    assert len(seeds) == 3000
