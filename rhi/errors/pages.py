"""The pages of the documentation that are installed with the package: `python -m rhi docs TOPIC`, or words to
search for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from html import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

from rhi.errors.data_classes import dataclass

_PACKAGE: Final = Path(__file__).parents[1]
_FOLDERS: Final = (_PACKAGE / "documentation", _PACKAGE.parent / "docs")
"""Where the pages lie: in an installed package, and in a checkout."""
_INDEXES: Final = ("contents", "questions")
"""Topics of pages that only list others, which a search doesn't look through."""
_UNSEARCHED_FOLDER: Final = "decisions"
"""The folder of pages that answer no question of a user, such as tables of former names."""
FORMER_TOPICS: Final = {
    "tutorial": "tutorials/first-triangle",
    "visibility-device": "visibility-algorithms",
}
"""Topics of former pages, with the topic of the page that has their text now."""
_HTML: Final = """\
<!doctype html>
<meta charset="utf-8">
<title>{title}</title>
<style>pre {{ max-width: 50rem; margin: 2rem auto; white-space: pre-wrap; font-size: 1rem; line-height: 1.4 }}</style>
<pre>{text}</pre>
"""


_COMMON_WORDS: Final = frozenset(
    [
        "a",
        "an",
        "and",
        "are",
        "at",
        "can",
        "do",
        "does",
        "for",
        "from",
        "how",
        "i",
        "in",
        "is",
        "it",
        "my",
        "of",
        "on",
        "or",
        "that",
        "the",
        "this",
        "to",
        "what",
        "when",
        "which",
        "with",
    ]
)
"""Words of questions that say nothing about what is asked."""
_HEADING_SCORE: Final = 8
_MAX_COUNT: Final = 3  # occurrences of a word in a section that count


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a page from one heading to the next.

    Attributes:
        topic: the page.
        heading: the words of the heading.
        text: the part as Markdown, with the heading.
    """

    topic: str
    heading: str
    text: str


class UnknownPageError(LookupError):
    """There is no such page; the message says which there are.

    Attributes:
        close: topics with similar names.
    """

    def __init__(self, message: str, close: Sequence[str] = ()) -> None:
        super().__init__(message)
        self.close = tuple(close)

    def __str__(self) -> str:
        return str(self.args[0])


def list_topics() -> dict[str, str]:
    """Return the title of each page by its topic: the name of its file, such as "traces"."""
    titles: dict[str, str] = {}
    for topic, file in _list_files().items():
        first = file.read_text(encoding="utf-8").partition("\n")[0]
        titles[topic] = first.removeprefix("#").strip()
    return titles


def read_page(topic: str) -> str:
    """Return the text of a page, which is Markdown.

    Args:
        topic: the name of its file, or the beginning of one that no other has; a former name, too.

    Raises:
        UnknownPageError: there is no such page, or several.
    """
    topics = _list_files()
    topic = re.sub(r"^(docs/)?(([a-z-]+)/)?", "", topic).removesuffix(".md").lower()
    topic = FORMER_TOPICS.get(topic, topic).rpartition("/")[2]
    matches = [topic] if topic in topics else [name for name in topics if topic and name.startswith(topic)]
    if len(matches) != 1:
        close = matches or get_close_matches(topic, topics, 3)
        hint = f"did you mean {', '.join(close)}? " if close else ""
        raise UnknownPageError(
            f"there is no page {topic!r}; {hint}`python -m rhi docs` lists the topics", close
        )
    return topics[matches[0]].read_text(encoding="utf-8")


def search(words: Sequence[str]) -> list[Section]:
    """Return the sections that have most of some words, the best first, but not those of lists of pages.

    A word counts wherever it begins one, in capitals or not, and twice in a heading or a page's title. Long
    tables have many words, headings few that matter. Words such as "how" don't count beside others.

    Raises:
        UnknownPageError: no section has any of the words.
    """
    asked = [word for text in words for word in re.findall(r"[\w.]+", text.lower())]
    asked = [word for word in asked if word not in _COMMON_WORDS] or asked
    stems = [_stem(word) for word in asked]
    patterns = [re.compile(rf"\b{re.escape(stem)}", re.IGNORECASE) for stem in stems]
    titles = list_topics()
    scores: dict[Section, tuple[int, int]] = {}
    for section in _list_sections():
        text = section.text.lower()
        counts = [
            min(len(pattern.findall(section.text)), _MAX_COUNT)
            if stem in text
            else 0  # several times as fast
            for stem, pattern in zip(stems, patterns, strict=True)
        ]
        if any(counts):
            title = f"{titles[section.topic]} {section.heading}"
            in_title = sum(bool(pattern.search(title)) for pattern in patterns)
            in_heading = sum(bool(pattern.search(section.heading)) for pattern in patterns)
            present = sum(count > 0 for count in counts)
            scores[section] = present + in_title, sum(counts) + _HEADING_SCORE * in_heading
    if not scores:
        raise UnknownPageError(f"no page has {' or '.join(asked)}; `python -m rhi docs` lists the topics")
    return sorted(scores, key=scores.__getitem__, reverse=True)


def _stem(word: str) -> str:
    """Return the beginning that other forms of a word share: "render" of "rendering"."""
    word = word.strip(".")
    return re.sub(r"(?<=\w{4})(ing|ed|s)$", "", word)


def _list_sections() -> Iterator[Section]:
    """Split all pages at their headings, but not at comments of programs."""
    for topic, file in _list_files().items():
        if topic in _INDEXES or file.parent.name == _UNSEARCHED_FOLDER:
            continue
        heading, in_program = "", False
        lines: list[str] = []
        page = file.read_text(encoding="utf-8")
        for line in [*page.splitlines(), "# "]:
            in_program ^= line.startswith("```")
            if line.startswith("#") and not in_program:
                if heading:
                    yield Section(topic, heading, "\n".join(lines).rstrip())
                heading, lines = line.strip("# "), []
            lines.append(line)


def write_html(text: str) -> Path:
    """Write a page's text to a file for a browser, in a new folder for temporary files, and return its path."""
    title = text.partition("\n")[0].removeprefix("#").strip()
    file = Path(mkdtemp(prefix="rhi-docs-")) / "page.html"
    file.write_text(_HTML.format(title=escape(title), text=escape(text)), encoding="utf-8")
    return file


def _list_files() -> dict[str, Path]:
    """Return the file of each topic, in the order of their names."""
    return {file.stem: file for file in sorted(_folder().rglob("*.md"), key=lambda file: file.stem)}


def _folder() -> Path:
    for folder in _FOLDERS:
        if (folder / "contents.md").is_file():
            return folder
    raise UnknownPageError(
        "the pages aren't installed: install rhi from its wheel or its source distribution"
    )
