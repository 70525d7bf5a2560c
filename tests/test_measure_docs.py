"""Measures of how hard pages are to read, and the limits within which pages of each kind stay."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

pytest.importorskip("markdown")
pytest.importorskip("pymdownx")

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

from measure_docs import (  # noqa: E402
    LIMITS,
    MAX_TOTAL_WORDS,
    list_excesses,
    list_pages,
    main,
    measure_pages,
    measure_text,
    merge,
    split_sentences,
)


def test_sentences_end_at_full_stops_before_capitals() -> None:
    text = "Draws cost 1.5 µs, e.g. on gl. `draw` is fast! See Fig. 3. Is it? (Yes.) The end"
    assert split_sentences(text) == [
        "Draws cost 1.5 µs, e.g. on gl.",
        "`draw` is fast!",
        "See Fig. 3.",
        "Is it?",
        "(Yes.)",
        "The end",
    ]


PAGE = """# A heading of five words

A buffer holds bytes. It is destroyed by the device. Draws are never reordered.

- An item.
- Another item, that continues
  on a line.

| a table | is not prose |
|---|---|
| cells | are not counted |

```python
short = 1
```
"""


def test_paragraphs_and_items_count_and_tables_code_and_headings_do_not() -> None:
    figures = measure_text("docs/a.md", PAGE)
    assert figures.words == len(PAGE.split())
    assert figures.paragraphs == (14, 2, 7)
    assert figures.sentences == tuple(
        len(sentence.split())
        for sentence in (
            "A buffer holds bytes.",
            "It is destroyed by the device.",
            "Draws are never reordered.",
            "An item.",
            "Another item, that continues on a line.",
        )
    )
    assert figures.passive == 2
    assert figures.passive_share == pytest.approx(0.4)
    assert figures.median == 4
    assert figures.wide_code_blocks == 0


@pytest.mark.parametrize(
    ("sentence", "is_passive"),
    [
        ("Buffers are destroyed.", True),
        ("Buffers are not always written.", True),
        ("The list was quickly rebuilt.", True),
        ("The device destroys buffers.", False),
        ("Buffers are red.", False),
        ("The draws ended.", False),
    ],
)
def test_the_passive_voice_is_a_form_of_be_before_a_participle(sentence: str, is_passive: bool) -> None:
    assert measure_text("docs/a.md", sentence).passive == is_passive


@pytest.mark.parametrize(("columns", "count"), [(88, 0), (89, 1)])
def test_wide_code_blocks_are_counted_once(columns: int, count: int) -> None:
    line = "x" * columns
    assert measure_text("docs/a.md", f"```\n{line}\n{line}\n```\n").wide_code_blocks == count


@pytest.mark.parametrize(("words", "count"), [(90, 0), (91, 1)])
def test_long_paragraphs_are_counted(words: int, count: int) -> None:
    figures = measure_text("docs/a.md", "word " * words)
    assert figures.long_paragraphs == count
    assert [line.split(": ")[1] for line in list_excesses([figures])] == [
        *["long paragraphs"] * count,
        "median",
    ]


def test_a_percentile_is_that_of_sentences_in_order() -> None:
    text = " ".join("A" + " b" * (words - 1) + "." for words in (10, 1, 2, 3, 4, 5, 6, 7, 8, 9))
    assert measure_text("docs/a.md", text).percentile_90 == 9
    assert measure_text("docs/a.md", "").percentile_90 == 0
    assert measure_text("docs/a.md", "").median == 0


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("README.md", "project"),
        ("docs/states.md", "guide"),
        ("docs/measurements/a.md", "measurements"),
        ("docs/decisions/a.md", "decisions"),
    ],
)
def test_a_page_has_the_kind_of_its_folder(path: str, kind: str) -> None:
    assert measure_text(path, "").kind == kind


def test_measurements_may_be_long_and_guides_may_not() -> None:
    long = "A word. " * (LIMITS["guide"].words or 0)
    assert list_excesses([measure_text("docs/measurements/a.md", long)]) == []
    (line,) = [line for line in list_excesses([measure_text("docs/a.md", long)]) if " words" in line]
    assert line == "docs/a.md: words: 5000, at most 2500"


def test_the_readme_is_shorter_than_other_pages_of_the_project() -> None:
    assert list_excesses([measure_text("CONTRIBUTING.md", "A word.\n\n" * 301)]) == []
    (line,) = list_excesses([measure_text("README.md", "A word.\n\n" * 301)])
    assert line == "README.md: words: 602, at most 600"


def test_all_pages_together_have_a_limit() -> None:
    page = measure_text("docs/how-to/a.md", "A word.\n\n" * 250)
    many = [page] * (MAX_TOTAL_WORDS // 500)
    assert list_excesses(many) == []
    (line,) = list_excesses([*many, page])
    assert line == f"all tutorials, guide, how-to: words: {MAX_TOTAL_WORDS + 500}, at most {MAX_TOTAL_WORDS}"
    assert list_excesses([*many, measure_text("docs/measurements/a.md", "A word.")]) == []
    assert list_excesses([*many, measure_text("docs/shading-builtins.md", "A b.")]) != [], (
        "generated pages count"
    )


def test_totals_are_of_all_sentences() -> None:
    figures = [measure_text("docs/a.md", "A b."), measure_text("docs/b.md", "A b c d. A b c d.")]
    total = merge("all", figures)
    assert (total.words, total.sentences, total.median) == (10, (2, 4, 4), 4)


def test_the_command_prints_a_row_for_each_page_and_totals(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()
    pages = [page.relative_to(ROOT).as_posix() for page in list_pages()]
    assert [line.split()[0] for line in lines[1 : 1 + len(pages)]] == pages
    assert [line.split("  ")[0] for line in lines[1 + len(pages) :]] == [
        *(f"all {kind}" for kind in LIMITS),
        "all pages",
    ]


def test_a_page_within_its_limits_ends_the_check_with_0(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--check", str(ROOT / "docs/installation.md")]) == 0
    assert capsys.readouterr().out == "1 pages are within their limits\n"


def test_pages_are_within_the_limits_of_their_kind() -> None:
    assert list_excesses(measure_pages(list_pages())) == []


CONTENTS = (ROOT / "docs" / "contents.md").read_text(encoding="utf-8")
LINK = re.compile(r"\]\(([a-z0-9/-]+\.md)\)")


def test_the_list_of_pages_has_each_page_once_and_how_to_pages_by_their_index() -> None:
    pages = [page.relative_to(ROOT / "docs") for page in (ROOT / "docs").rglob("*.md")]
    listed = {page.as_posix() for page in pages if page.parts[0] not in ("how-to", "contents.md")}
    assert sorted(LINK.findall(CONTENTS)) == sorted(listed)


def test_at_most_twenty_pages_explain() -> None:
    section = CONTENTS.partition("## Explanation\n")[2].partition("\n## ")[0]
    assert 10 < len(LINK.findall(section)) <= 20
