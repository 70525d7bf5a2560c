"""Measure how hard the pages of the documentation are to read.

    python scripts/measure_docs.py [PAGE …] [--check]

Prints a row for each page, and the total of each kind of page: its words, as `wc` counts them; the paragraphs that
are too long; the median and the 90th percentile of the words of a sentence; the share of sentences in the passive
voice; and the code blocks that are too wide. Sentences are those of paragraphs and list items: tables, code and
headings don't count. With `--check` the command prints what exceeds the limits of a page's kind, and ends with 1 if
anything does. It parses pages as the site does, with the extra `docs`.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Final

import markdown  # type: ignore[import-untyped]

ROOT: Final = Path(__file__).resolve().parents[1]
MAX_PARAGRAPH_WORDS: Final = 90
MAX_CODE_COLUMNS: Final = 88

_EXTENSIONS: Final = ("attr_list", "tables", "pymdownx.superfences")
_BLOCKS: Final = frozenset({"p", "li", "dd", "blockquote"})
_LEFT_OUT: Final = frozenset({"pre", "table", "h1", "h2", "h3", "h4", "h5", "h6", "script", "style"})
_ABBREVIATION: Final = re.compile(r"\b(?:e\.g|i\.e|etc|vs|cf|Fig|Eq|No|pp?)\.$")
_SENTENCE_END: Final = re.compile(r"[.!?:;…][\"”’)\]]*\s+(?=[\"“‘(\[]?[A-Z0-9`])")
_IRREGULAR: Final = (
    "been begun born bought bound broken brought built burnt caught chosen come cut dealt done drawn "
    "driven eaten fed felt forgotten found frozen given gone grown heard held hidden hit hung kept "
    "known laid led left lent let lost made meant met overwritten paid proven put read rebuilt run "
    "said seen sent set shaken shown shut skewn sold spent split spread stolen struck sunk sworn "
    "swung taken taught thought thrown told torn understood undone woken won worn wound written"
)
_PASSIVE: Final = re.compile(
    r"\b(?:is|are|was|were|be|been|being|isn't|aren't|wasn't|weren't|gets|get)\s+"
    r"(?:(?:not|never|always|also|only|still|already|then|once|again|\w+ly)\s+){0,2}"
    rf"(?:\w{{2,}}ed|{'|'.join(_IRREGULAR.split())})\b",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of a kind of page; None allows any number.

    Attributes:
        words: of a page.
        long_paragraphs: paragraphs of more than `MAX_PARAGRAPH_WORDS` words.
        median: the median number of words of a sentence.
        wide_code_blocks: code blocks with a line of more than `MAX_CODE_COLUMNS` columns.
    """

    words: int | None = None
    long_paragraphs: int | None = None
    median: float | None = None
    wide_code_blocks: int | None = None


LIMITS: Final = {
    "tutorials": Limits(words=2_500, long_paragraphs=0, median=18, wide_code_blocks=0),
    "guide": Limits(words=2_500, long_paragraphs=0, median=18, wide_code_blocks=0),
    "how-to": Limits(words=600, long_paragraphs=0, median=18, wide_code_blocks=0),
    "measurements": Limits(),
    "decisions": Limits(),
    "project": Limits(words=4_000, median=18),
}
"""The limits of each kind of page: guides are the pages of `docs/` itself, project pages those beside `docs/`."""
PAGE_LIMITS: Final = {"README.md": Limits(words=600, long_paragraphs=0, median=18, wide_code_blocks=0)}
"""Limits of single pages, in place of those of their kind."""
MAX_TOTAL_WORDS: Final = 75_000
"""The words of all pages of the kinds `READ_KINDS`, those that a command writes included."""
READ_KINDS: Final = ("tutorials", "guide", "how-to")


@dataclass(frozen=True, slots=True)
class PageFigures:
    """The figures of a page.

    Attributes:
        path: relative to the project.
        words: all words of the file.
        paragraphs: the words of each paragraph and list item.
        sentences: the words of each sentence.
        passive: sentences in the passive voice.
        wide_code_blocks: code blocks with a line that is too wide.
    """

    path: str
    words: int
    paragraphs: tuple[int, ...]
    sentences: tuple[int, ...]
    passive: int
    wide_code_blocks: int

    @property
    def kind(self) -> str:
        """The page's kind, a key of `LIMITS`."""
        folder = Path(self.path).parent.as_posix()
        return {"docs": "guide"}.get(folder, folder.removeprefix("docs/") if folder != "." else "project")

    @property
    def long_paragraphs(self) -> int:
        """The number of paragraphs that are too long."""
        return sum(words > MAX_PARAGRAPH_WORDS for words in self.paragraphs)

    @property
    def median(self) -> float:
        """The median number of words of a sentence, 0 without sentences."""
        return float(statistics.median(self.sentences)) if self.sentences else 0.0

    @property
    def percentile_90(self) -> float:
        """The number of words that nine of ten sentences don't exceed, 0 without sentences."""
        ordered = sorted(self.sentences)
        return float(ordered[(9 * len(ordered) - 1) // 10]) if ordered else 0.0

    @property
    def passive_share(self) -> float:
        """The share of sentences in the passive voice, 0 to 1."""
        return self.passive / len(self.sentences) if self.sentences else 0.0


class _Paragraphs(HTMLParser):
    """The texts of the paragraphs and list items of a page, and its code blocks."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.paragraphs: list[str] = []
        self.code_blocks: list[str] = []
        self._left_out: list[str] = []
        self._text: list[str] = []
        self.feed(html)
        self.close()
        self._end_paragraph()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in _LEFT_OUT:
            self._end_paragraph()
            self._left_out.append(tag)
            if tag == "pre":
                self.code_blocks.append("")
        elif tag in _BLOCKS:
            self._end_paragraph()

    def handle_endtag(self, tag: str) -> None:
        if self._left_out and tag == self._left_out[-1]:
            self._left_out.pop()
        elif tag in _BLOCKS:
            self._end_paragraph()

    def handle_data(self, data: str) -> None:
        if not self._left_out:
            self._text.append(data)
        elif "pre" in self._left_out:
            self.code_blocks[-1] += data

    def _end_paragraph(self) -> None:
        text = " ".join("".join(self._text).split())
        self._text.clear()
        if text:
            self.paragraphs.append(text)


def split_sentences(text: str) -> list[str]:
    """Return the sentences of a paragraph; what follows a colon or semicolon counts as one of its own only where
    it begins with a capital letter."""
    sentences, start = [], 0
    for end in _SENTENCE_END.finditer(text):
        sentence = text[start : end.start() + 1]
        if not _ABBREVIATION.search(sentence) and sentence.strip():
            sentences.append(text[start : end.end()].strip())
            start = end.end()
    return [*sentences, *([text[start:].strip()] if text[start:].strip() else [])]


def measure_text(path: str, text: str) -> PageFigures:
    """Measure the Markdown of a page."""
    parsed = _Paragraphs(markdown.markdown(text, extensions=list(_EXTENSIONS)))
    sentences = [sentence for paragraph in parsed.paragraphs for sentence in split_sentences(paragraph)]
    return PageFigures(
        path,
        len(text.split()),
        tuple(len(paragraph.split()) for paragraph in parsed.paragraphs),
        tuple(len(sentence.split()) for sentence in sentences),
        sum(bool(_PASSIVE.search(sentence)) for sentence in sentences),
        sum(any(len(line) > MAX_CODE_COLUMNS for line in block.splitlines()) for block in parsed.code_blocks),
    )


def list_pages() -> list[Path]:
    """Return the README, the contributing page, the changelog, and the pages of `docs/` and its folders."""
    return [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def measure_pages(pages: Iterable[Path]) -> list[PageFigures]:
    """Measure pages of the project."""
    return [
        measure_text(page.relative_to(ROOT).as_posix(), page.read_text(encoding="utf-8")) for page in pages
    ]


def merge(name: str, figures: Sequence[PageFigures]) -> PageFigures:
    """Return the figures of several pages together, in place of a page's path with a name."""
    return PageFigures(
        name,
        sum(page.words for page in figures),
        tuple(words for page in figures for words in page.paragraphs),
        tuple(words for page in figures for words in page.sentences),
        sum(page.passive for page in figures),
        sum(page.wide_code_blocks for page in figures),
    )


def format_rows(figures: Sequence[PageFigures]) -> Iterator[str]:
    """Yield a table's lines: the pages, the total of each kind, and that of all."""
    totals = [
        merge(f"all {kind}", [page for page in figures if page.kind == kind])
        for kind in LIMITS
        if any(page.kind == kind for page in figures)
    ]
    rows = [*figures, *totals, merge("all pages", figures)]
    width = max(len(row.path) for row in rows)
    yield f"{'page':{width}}   words  long par.  median  90 %  passive  wide code"
    for row in rows:
        yield (
            f"{row.path:{width}} {row.words:7,} {row.long_paragraphs:10} {row.median:7g} {row.percentile_90:5g}"
            f" {row.passive_share:7.0%} {row.wide_code_blocks:10}"
        )


def list_excesses(figures: Iterable[PageFigures]) -> list[str]:
    """Return a line for each limit that a page exceeds, and one for that of all together."""
    excesses, total = [], 0
    for page in figures:
        limits = PAGE_LIMITS.get(page.path, LIMITS[page.kind])
        total += page.words if page.kind in READ_KINDS else 0
        for name in ("words", "long_paragraphs", "median", "wide_code_blocks"):
            value, limit = getattr(page, name), getattr(limits, name)
            if limit is not None and value > limit:
                excesses.append(f"{page.path}: {name.replace('_', ' ')}: {value:g}, at most {limit:g}")
    if total > MAX_TOTAL_WORDS:
        excesses.append(f"all {', '.join(READ_KINDS)}: words: {total}, at most {MAX_TOTAL_WORDS}")
    return excesses


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the figures of pages, or what exceeds their limits."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument(
        "pages", nargs="*", type=Path, metavar="PAGE", help="pages of the project; default all"
    )
    parser.add_argument("--check", action="store_true", help="print only what exceeds the limits")
    options = parser.parse_args(arguments)
    figures = measure_pages([page.resolve() for page in options.pages] or list_pages())
    if options.check:
        excesses = list_excesses(figures)
        print("\n".join(excesses) or f"{len(figures)} pages are within their limits")
        return bool(excesses)
    print("\n".join(format_rows(figures)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
