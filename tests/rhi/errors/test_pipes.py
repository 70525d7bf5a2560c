"""A command whose output nobody reads any more ends quietly, at whatever place that is noticed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import NoReturn

import pytest
from pipe_kit import stream_to_pipe

from rhi.errors.pipes import BROKEN_PIPE_STATUS, run_until_pipe_closes


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
        assert run_until_pipe_closes(main) == BROKEN_PIPE_STATUS
        print("what is left goes nowhere", flush=True)
    assert capfd.readouterr().err == ""


def test_notes_without_a_reader_end_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with stream_to_pipe(monkeypatch, "stderr", is_read=False):
        assert run_until_pipe_closes(lambda: print("a note", file=sys.stderr) or 0) == BROKEN_PIPE_STATUS


def test_a_command_with_a_reader_has_its_own_status(monkeypatch: pytest.MonkeyPatch) -> None:
    with stream_to_pipe(monkeypatch, "stdout", is_read=True) as read:
        assert run_until_pipe_closes(write_little) == 1
        assert read() == "a line that stays in the buffer"
        with pytest.raises(SystemExit, match="0"):
            run_until_pipe_closes(write_and_exit)
        assert read() == "the help"


def test_another_pipe_that_breaks_is_an_error_in_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    def write_elsewhere() -> NoReturn:
        raise BrokenPipeError("the socket of a scheduler")

    assert run_until_pipe_closes(write_elsewhere) == 2
    assert capfd.readouterr().err == "error: the socket of a scheduler\n"
