"""The console: editing, completion and history."""

from __future__ import annotations

import pytest

from renderer.viewer.command_table import CommandTable, Parameter, ViewerCommand
from renderer.viewer.console import Console


@pytest.fixture
def ran() -> list[str]:
    return []


@pytest.fixture
def console(ran: list[str]) -> Console:
    names = Parameter("NAME", words=lambda: ("deferred", "deferred_plus", "forward"))
    table = CommandTable([ViewerCommand("technique", "", str, (names,)), ViewerCommand("time", "", str)])
    return Console(table, ran.append)


def press(console: Console, *keys: str) -> str:
    for key in keys:
        assert console.press(key)
    return console.text


def test_characters_are_inserted_at_the_cursor(console: Console) -> None:
    console.insert("tme")
    press(console, "ArrowLeft", "ArrowLeft")
    console.insert("i")
    assert (console.text, console.cursor) == ("time", 2)
    console.insert("\x07\n")
    assert console.text == "time"


def test_keys_delete_and_stay_in_the_line(console: Console) -> None:
    assert press(console, "Backspace", "Delete", "ArrowLeft", "ArrowRight") == ""
    console.insert("abc")
    assert press(console, "Home", "Delete") == "bc"
    assert press(console, "Backspace") == "bc"
    assert press(console, "End", "Backspace", "Delete") == "b"


def test_tab_completes_as_far_as_it_is_certain(console: Console) -> None:
    console.insert("tech")
    assert press(console, "Tab") == "technique "
    console.insert("d")
    assert press(console, "Tab") == "technique deferred"
    assert console.choices == ["deferred", "deferred_plus"]
    console.insert("_")
    assert console.choices == []
    assert press(console, "Tab") == "technique deferred_plus "
    assert press(console, "Tab") == "technique deferred_plus "


def test_enter_runs_the_line_and_arrows_recall_it(console: Console, ran: list[str]) -> None:
    for line in ("time", "technique forward", "technique forward", "  "):
        console.insert(line)
        press(console, "Enter")
    assert ran == ["time", "technique forward", "technique forward"]
    console.insert("draft")
    assert press(console, "ArrowUp") == "technique forward"
    assert press(console, "ArrowUp") == "time"  # a line that is repeated is kept once
    assert press(console, "ArrowUp") == "time"
    assert press(console, "ArrowDown") == "technique forward"
    assert press(console, "ArrowDown") == "draft"
    assert press(console, "ArrowDown") == "draft"


def test_escape_empties_the_line_and_then_closes(console: Console) -> None:
    console.is_open = True
    console.insert("abc")
    press(console, "Escape")
    assert (console.text, console.is_open) == ("", True)
    press(console, "Escape")
    assert not console.is_open


def test_keys_that_mean_nothing_here_are_reported(console: Console) -> None:
    assert not console.press("F5")
    assert not console.press("a")


def test_a_long_life_keeps_few_lines(console: Console, ran: list[str]) -> None:
    for number in range(1000):
        console.insert(f"time {number}")
        press(console, "Enter")
        console.show_message("so\nbe it")
    assert len(console.lines) == 200
    console.insert("x" * 5000)
    assert len(console.text) == 1000
    for _ in range(500):
        press(console, "ArrowUp")
    assert console.text == "time 800"
