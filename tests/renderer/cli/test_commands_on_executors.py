"""`exam` and `compare` on executors: the same rows, and a case that ends its process."""

from __future__ import annotations

import json
import os
import pickle
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any

import pytest

from renderer.cli import COMMANDS, main
from renderer.cli.subcommand import SubcommandGroup
from renderer.lab.exam import CASES, examine_elsewhere
from rhi_screen.executors import LostCallError, SerialExecutor, make_executor

EXAM = ["exam", "--backend", "null", "--case", "13", "--case", "21", "--json"]
COMPARE = ["compare", "techniques", "grid:count=4", "--techniques", "forward,deferred", "--backend", "null"]
COMPARE += ["--rounds", "1", "--size", "16x9", "--json"]


class Elsewhere(SerialExecutor):
    """Runs calls in this process that were pickled, as those of another process are, and counts them."""

    def __init__(self) -> None:
        self.count = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.count += 1
        fn, args, kwargs = pickle.loads(pickle.dumps((fn, args, kwargs)))
        future = super().submit(fn, *args, **kwargs)
        if future.exception() is None:
            pickle.dumps(future.result())
        return future


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch) -> Elsewhere:
    executor = Elsewhere()

    @contextmanager
    def make(text: str) -> Iterator[Executor]:
        assert text == "processes:1"
        yield executor

    for module in ("comparison", "exam"):
        monkeypatch.setattr(f"renderer.cli.{module}.make_executor", make)
    return executor


def read(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> Any:
    assert main(arguments) == 0
    return json.loads(capsys.readouterr().out)


def test_an_exam_has_the_same_rows_elsewhere(
    capsys: pytest.CaptureFixture[str], elsewhere: Elsewhere
) -> None:
    here = read(capsys, EXAM)
    assert elsewhere.count == 0
    assert read(capsys, [*EXAM, "--executor", "processes:1"]) == here
    assert elsewhere.count == len(here) == 2


def test_a_comparison_has_the_same_counts_elsewhere(
    capsys: pytest.CaptureFixture[str], elsewhere: Elsewhere
) -> None:
    here = read(capsys, COMPARE)
    there = read(capsys, [*COMPARE, "--executor", "processes:1"])
    assert elsewhere.count == 1
    for report in (here, there):
        for row in report["rows"]:
            assert row.pop("milliseconds") > 0.0
            row.pop("processor_ms", None)
            row.pop("processor_milliseconds", None)
    assert here == there


def list_executor_commands() -> list[str]:
    names = []
    for command in COMMANDS:
        members = command.members if isinstance(command, SubcommandGroup) else (command,)
        group = f"{command.name} " if isinstance(command, SubcommandGroup) else ""
        for member in members:
            if any(option.flag == "--executor" for option in member.options):
                names.append(f"{group}{member.name}")
    return names


def test_the_commands_with_executors_share_their_option() -> None:
    names = list_executor_commands()
    comparisons = [name for name in names if name.startswith("compare ")]
    assert len(comparisons) == 8
    assert sorted(set(names) - set(comparisons)) == ["accuracy", "exam", "film", "tune"]


@pytest.mark.parametrize("command", list_executor_commands())
def test_an_executor_of_no_known_kind_is_refused_by_each_command(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    extra = ["--frames", "0:1", "--output", "%d.png"] if command == "film" else []
    scene = [] if command in ("exam", "compare encodings") else ["city:blocks=4,detail=2"]
    with pytest.raises(SystemExit) as end:
        main([*command.split(), *scene, *extra, "--executor", "magic"])
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert "'magic' is none of serial" in error
    assert "[executor-name]" in error


def test_a_case_that_ends_its_process_has_failed_and_others_are_examined() -> None:
    class Deadly(SerialExecutor):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            future = super().submit(fn, *args, **kwargs)
            if args[1] == 21:
                future = Future()
                future.set_exception(LostCallError("3 processes ended during one call"))
            return future

    rows = {row.case: row for row in examine_elsewhere(Deadly(), ["null"], [CASES[13], CASES[21]])}
    assert (rows[13].passed, rows[21].passed) == (None, False)
    assert rows[21].remark == "its process ended"


@pytest.mark.nightly
def test_processes_examine_as_one_does(capsys: pytest.CaptureFixture[str]) -> None:
    assert read(capsys, [*EXAM, "--executor", "processes:2"]) == read(capsys, EXAM)


def test_calls_of_processes_that_die_once_are_run_again(tmp_path: Any) -> None:
    with make_executor("processes:1") as executor:
        assert executor.submit(die_once, str(tmp_path / "mark")).result() == "alive"


def die_once(mark: str) -> str:
    if not os.path.exists(mark):
        open(mark, "wb").close()
        os._exit(1)
    return "alive"
