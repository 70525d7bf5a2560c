"""Figures of the docs: each table has the command that makes it; what doesn't depend on time is compared
(nightly)."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

from write_tables import TABLES, MeasuredTable, list_differences, list_ratios, replace_cells  # noqa: E402

PAGE = (
    "<!-- table: sums -->\n| of | sum | ms |\n|---|---|---|\n| 1, 2 | 3 | 8.1 |\n| 4, 5 | 8 | 8.2 |\n\nMore."
)


def test_only_the_cells_of_the_columns_that_do_not_depend_on_time_are_written() -> None:
    written = replace_cells(PAGE, "sums", ["sum"], {"1, 2": ["3"], "4, 5": ["9"]})
    assert written == PAGE.replace("| 8 |", "| 9 |")
    assert list(list_differences(PAGE, written)) == ["- | 4, 5 | 8 | 8.2 |\n+ | 4, 5 | 9 | 8.2 |"]
    assert (
        list(list_differences(PAGE, replace_cells(PAGE, "sums", ["sum"], {"1, 2": ["3"], "4, 5": ["8"]})))
        == []
    )


@pytest.mark.parametrize(
    ("cell", "is_near"), [("8.5", True), ("8.51", False), ("7.5", True), ("7.49", False), ("x", False)]
)
def test_numbers_may_differ_by_a_fraction_of_the_old_number(cell: str, is_near: bool) -> None:
    after = PAGE.replace("| 8 |", f"| {cell} |")
    assert (list(list_differences(PAGE, after, 0.0625)) == []) is is_near
    assert list(list_differences(PAGE, after)) != []


def test_ratios_of_times_are_printed_old_and_new() -> None:
    rows = {"1, 2": ["3", "2.0"], "4, 5": ["9", "3.0"]}
    (line,) = list_ratios(PAGE, "sums", MeasuredTable("", ("sum",), lambda: rows, ("ms",)), rows)
    assert line.split() == ["sums", "4,", "5", "ms", "1.01", "1.50"]


def test_rows_without_new_values_are_unchanged() -> None:
    assert replace_cells(PAGE, "sums", ["sum"], {"4, 5": ["9"]}) == PAGE.replace("| 8 |", "| 9 |")


@pytest.mark.parametrize("rows", [{}, {"1, 2": ["3"], "4, 5": ["9"], "6": ["6"]}])
def test_a_table_that_lacks_a_row_or_all_of_them_is_an_error(rows: dict[str, list[str]]) -> None:
    with pytest.raises(ValueError, match="the page has rows"):
        replace_cells(PAGE, "sums", ["sum"], rows)


def test_each_mark_of_the_pages_has_a_figure() -> None:
    marks = [
        (page.relative_to(ROOT).as_posix(), name)
        for page in (ROOT / "docs").rglob("*.md")
        for name in re.findall(r"^<!-- table: (.*) -->$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert sorted(marks) == sorted((figure.page, name) for name, figure in TABLES.items())
    assert len(marks) >= 3


@pytest.mark.nightly
@pytest.mark.parametrize("name", TABLES)
def test_a_table_that_does_not_depend_on_time_equals_the_output_of_its_command(name: str) -> None:
    figure = TABLES[name]
    text = (ROOT / figure.page).read_text(encoding="utf-8")
    computed = replace_cells(text, name, figure.columns, figure.compute())
    assert list(list_differences(text, computed, figure.tolerance)) == []


# -- commands ------------------------------------------------------------------------------------------------

COMMAND = re.compile(r"(?:python |pytest |\./\w+\.sh)\S+")
ONCE = "measured once"


def list_tables(lines: list[str]) -> Iterator[tuple[int, int]]:
    """The first line and the end of each table that is mostly figures."""
    number, is_code = 0, False
    while number < len(lines):
        first = number
        number += 1
        is_code ^= lines[first].startswith("```")
        if is_code or not lines[first].startswith("|"):
            continue
        while number < len(lines) and lines[number].startswith("|"):
            number += 1
        cells = [
            cell.strip(" *`") for line in lines[first + 2 : number] for cell in line.strip("|").split("|")
        ]
        figures = sum(bool(re.match(r"[×~<>≤±+–-]?\s?\.?\d", cell)) and len(cell) <= 40 for cell in cells)
        letters = sum(character.isalpha() for cell in cells if cell[:1].isdigit() for character in cell)
        if figures >= 4 and 2 * figures > sum(bool(cell) for cell in cells) and letters <= 6 * figures:
            yield first, number


def surrounding_text(lines: list[str], first: int, end: int) -> str:
    """The text of a table's section, and that of the sections around it up to their first part."""
    level, sections = 7, []
    for number in range(first, -1, -1):
        depth = len(lines[number]) - len(lines[number].lstrip("#"))
        if 0 < depth < level:
            part = next((n for n in range(number + 1, len(lines)) if re.match(r"#+ ", lines[n])), len(lines))
            sections.append("\n".join(lines[number : max(part, first if level == 7 else 0)]))
            level = depth
    after = next((n for n in range(end, len(lines)) if re.match(r"#+ ", lines[n])), len(lines))
    return "\n".join([*sections, *lines[end:after]])


def list_lacking(text: str) -> list[str]:
    """The tables of figures that neither have a command nor are said to be measured once."""
    lines = text.split("\n")
    return [
        f"line {first + 1}: {lines[first]}"
        for first, end in list_tables(lines)
        if not COMMAND.search(around := surrounding_text(lines, first, end)) and ONCE not in around
    ]


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_each_table_of_figures_has_the_command_that_makes_it(page: Path) -> None:
    assert list_lacking(page.read_text(encoding="utf-8")) == []


def test_a_table_without_a_command_is_found() -> None:
    table = "\n| of | ms | share |\n|---|---|---|\n| a | 1.5 | 12 % |\n| b | 2.5 ms | 20 % |\n"
    other = "## Other\n\n`python benchmarks/text.py`\n\n"
    assert len(list_lacking(f"# Page\n\n{other}## Times\n{table}")) == 1
    assert list_lacking(f"# Page\n\n## Times\n\n`python benchmarks/text.py`\n\n### Part\n{table}") == []
    assert list_lacking(f"# Page\n\n## Times\n{table}\n{other}") != []
    assert list_lacking(f"# Page\n\n## Times\n{table}\nAs `python benchmarks/text.py` says.\n") == []
