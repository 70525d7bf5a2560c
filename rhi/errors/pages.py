"""The pages of the documentation that are installed with the package: `python -m rhi docs TOPIC`."""

from __future__ import annotations

from difflib import get_close_matches
from html import escape
from pathlib import Path
from tempfile import mkdtemp
from typing import Final

_PACKAGE: Final = Path(__file__).parents[1]
_FOLDERS: Final = (_PACKAGE / "documentation", _PACKAGE.parent / "docs")
"""Where the pages lie: in an installed package, and in a checkout."""
_HTML: Final = """\
<!doctype html>
<meta charset="utf-8">
<title>{title}</title>
<style>pre {{ max-width: 50rem; margin: 2rem auto; white-space: pre-wrap; font-size: 1rem; line-height: 1.4 }}</style>
<pre>{text}</pre>
"""


class UnknownPageError(LookupError):
    """There is no such page; the message says which there are."""

    def __str__(self) -> str:
        return str(self.args[0])


def list_topics() -> dict[str, str]:
    """Return the title of each page by its topic: the name of its file, such as "traces"."""
    titles: dict[str, str] = {}
    for file in sorted(_folder().glob("*.md"), key=lambda file: file.stem):
        first = file.read_text(encoding="utf-8").partition("\n")[0]
        titles[file.stem] = first.removeprefix("#").strip()
    return titles


def read_page(topic: str) -> str:
    """Return the text of a page, which is Markdown.

    Args:
        topic: the name of its file, or the beginning of one that no other has.

    Raises:
        UnknownPageError: there is no such page, or several.
    """
    topics = list_topics()
    topic = topic.removeprefix("docs/").removesuffix(".md").lower()
    matches = [topic] if topic in topics else [each for each in topics if topic and each.startswith(topic)]
    if len(matches) != 1:
        close = matches or get_close_matches(topic, topics, 3)
        hint = f"did you mean {', '.join(close)}? " if close else ""
        raise UnknownPageError(f"there is no page {topic!r}; {hint}`python -m rhi docs` lists the topics")
    return (_folder() / f"{matches[0]}.md").read_text(encoding="utf-8")


def write_html(text: str) -> Path:
    """Write a page's text to a file for a browser, in a new folder for temporary files, and return its path."""
    title = text.partition("\n")[0].removeprefix("#").strip()
    file = Path(mkdtemp(prefix="rhi-docs-")) / "page.html"
    file.write_text(_HTML.format(title=escape(title), text=escape(text)), encoding="utf-8")
    return file


def _folder() -> Path:
    for folder in _FOLDERS:
        if (folder / "contents.md").is_file():
            return folder
    raise UnknownPageError(
        "the pages aren't installed: install rhi from its wheel or its source distribution"
    )
