"""Commands: how a line is read, refused and completed."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from renderer import rules
from renderer.viewer.command_table import CommandTable, Parameter, ViewerCommand, common_start, split_line
from rhi import RhiError, ValidationError


@pytest.fixture
def calls() -> list[object]:
    return []


@pytest.fixture
def table(calls: list[object]) -> CommandTable:
    def note(*values: object) -> str:
        calls.append(values)
        return "done"

    colors = Parameter("COLOR", words=lambda: ("red", "green", "grey"), is_exhaustive=True)
    count = Parameter("COUNT", int, is_optional=True)
    paint = ViewerCommand("paint", "paint it", note, (colors, count))
    return CommandTable([paint, ViewerCommand("pause", "stop", note)])


@pytest.mark.parametrize(
    ("line", "values"),
    [
        ("paint red", ("red",)),
        ("  paint   green  12 ", ("green", 12)),
        ("paint 'red' # but why", ("red",)),
        ("pause", ()),
    ],
)
def test_a_line_runs_its_command(
    table: CommandTable, calls: list[object], line: str, values: tuple[object]
) -> None:
    assert table.run(line) == "done"
    assert calls == [values]


@pytest.mark.parametrize("line", ["", "   ", "# a comment"])
def test_an_empty_line_does_nothing(table: CommandTable, calls: list[object], line: str) -> None:
    assert table.run(line) == ""
    assert calls == []


@pytest.mark.parametrize(
    ("line", "rule", "says"),
    [
        ("pain red", "viewer-unknown-command", "did you mean paint?"),
        ("frobnicate", "viewer-unknown-command", "did you mean paint or pause?"),  # of few, all
        ("paint gren", "viewer-bad-argument", "did you mean green or grey or red?"),
        ("paint red many", "viewer-bad-argument", "COUNT"),
        ("paint", "viewer-bad-argument", "paint COLOR [COUNT]"),
        ("paint red 1 2", "viewer-bad-argument", "3 arguments"),
        ("paint 'red", "viewer-bad-argument", "No closing quotation"),
    ],
)
def test_a_fault_is_refused_in_a_line_and_runs_nothing(
    table: CommandTable, calls: list[object], line: str, rule: str, says: str
) -> None:
    with pytest.raises(ValidationError) as caught:
        table.run(line)
    assert caught.value.rule.id == rule
    assert says in rules.describe(caught.value)
    assert "\n" not in rules.describe(caught.value)
    assert calls == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", ["paint", "pause"]),
        ("pau", ["pause"]),
        ("paint ", ["green", "grey", "red"]),
        ("paint gre", ["green", "grey"]),
        ("paint x", []),
        ("paint red ", []),
        ("pause ", []),
        ("nothing ", []),
    ],
)
def test_completion_lists_the_words_of_the_parameter(
    table: CommandTable, line: str, words: list[str]
) -> None:
    assert table.complete(line) == words


def test_the_common_start_of_words() -> None:
    assert common_start(["green", "grey"]) == "gre"
    assert common_start(["a", "b"]) == ""
    assert common_start(["same", "same"]) == "same"
    assert common_start(["in", "inner"]) == "in"


def test_quotes_keep_blanks() -> None:
    assert split_line("screenshot 'my file.png'") == ["screenshot", "my file.png"]


@pytest.mark.parametrize("text", ["'", '"a', "\\"])
def test_no_line_raises_anything_else(table: CommandTable, text: str) -> None:
    run: Callable[[str], str] = table.run
    with pytest.raises(RhiError):
        run(text)
