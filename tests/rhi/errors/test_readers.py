"""A command whose output nobody reads any more ends quietly, at whatever place that is noticed."""

from __future__ import annotations

import os
import runpy
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import NoReturn

import pytest

import renderer
import rhi
from renderer import cli
from renderer.cli.subcommand import Subcommand
from rhi.errors.readers import GONE, run_for_reader

VERSION_1 = Path(__file__).parents[1] / "trace/version-1.zip"


@contextmanager
def stream_to_pipe(monkeypatch: pytest.MonkeyPatch, name: str, *, is_read: bool) -> Iterator[Callable[[], str]]:
    """Make a stream of the process a pipe, whose reader goes away at once or stays; yield what reads it."""
    source, sink = os.pipe()
    if not is_read:
        os.close(source)
    with open(sink, "w", encoding="utf-8") as stream:
        monkeypatch.setattr(sys, name, stream)
        yield lambda: os.read(source, 1 << 16).decode()
    if is_read:
        os.close(source)


def write_much() -> int:
    for _ in range(1000):
        print("a line that fills the buffer, so that it is written before the end")
    return 0


def write_little() -> int:
    print("a line that stays in the buffer", end="")
    return 1


def write_and_exit() -> NoReturn:
    print("the help", end="")
    sys.exit(0)


@pytest.mark.parametrize("main", [write_much, write_little, write_and_exit])
def test_a_command_without_a_reader_ends_quietly(
    main: Callable[[], int], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with stream_to_pipe(monkeypatch, "stdout", is_read=False):
        assert run_for_reader(main) == GONE
        print("what is left goes nowhere", flush=True)
    assert capfd.readouterr().err == ""


def test_notes_without_a_reader_end_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with stream_to_pipe(monkeypatch, "stderr", is_read=False):
        assert run_for_reader(lambda: print("a note", file=sys.stderr) or 0) == GONE


def test_a_command_with_a_reader_has_its_own_status(monkeypatch: pytest.MonkeyPatch) -> None:
    with stream_to_pipe(monkeypatch, "stdout", is_read=True) as read:
        assert run_for_reader(write_little) == 1
        assert read() == "a line that stays in the buffer"
        with pytest.raises(SystemExit, match="0"):
            run_for_reader(write_and_exit)
        assert read() == "the help"


def test_another_pipe_that_breaks_is_an_error_in_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    def write_elsewhere() -> NoReturn:
        raise BrokenPipeError("the socket of a scheduler")

    assert run_for_reader(write_elsewhere) == 2
    assert capfd.readouterr().err == "error: the socket of a scheduler\n"


@pytest.mark.parametrize(
    ("package", "arguments"),
    [
        (renderer, ["much"]),
        (renderer, ["accuracy", "--help"]),
        (rhi, ["trace", "--help"]),
        (rhi, ["trace", "show", str(VERSION_1)]),
    ],
)
def test_commands_of_both_packages_end_quietly(
    package: ModuleType, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    much = Subcommand("much", "print much", lambda parser: None, lambda given: print(write_much()), "")
    monkeypatch.setattr(cli, "COMMANDS", (*cli.COMMANDS, much))
    monkeypatch.setattr(sys, "argv", [package.__name__, *arguments])
    with stream_to_pipe(monkeypatch, "stdout", is_read=False), pytest.raises(SystemExit) as ended:
        runpy.run_path(str(Path(str(package.__file__)).parent / "__main__.py"), run_name="__main__")
    assert ended.value.code == GONE
    assert capfd.readouterr().err == ""
