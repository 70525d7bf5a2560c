"""Phrases of new users in the site's search: `site/search_phrases.toml`.

The theme's search finds sections that have all words of a query, and shows matches in titles first. A title of the
docs has the project's words, and a new user types others. A phrase is a further title of its page.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

PHRASES: Final = Path(__file__).resolve().parent / "site" / "search_phrases.toml"
LATER_FOLDERS: Final = ("reference/", "measurements/", "decisions/", "changelog/")
"""Pages whose results stand below equally good ones of other pages."""


def read_phrases(redirects: Mapping[str, str]) -> dict[str, list[str]]:
    """Return the phrases of each page, by its path in the site.

    Args:
        redirects: former paths of pages, with the present ones.
    """
    phrases: dict[str, list[str]] = {}
    for page, titles in tomllib.loads(PHRASES.read_text(encoding="utf-8"))["phrases"].items():
        phrases.setdefault(redirects.get(page, page), []).extend(titles)
    return phrases


def add_phrases(items: Iterable[dict[str, Any]], phrases: Mapping[str, list[str]]) -> list[dict[str, Any]]:
    """Return the items of a search index with an item for each phrase.

    Members with names of Python's own, as `__annotations__`, are left out.

    Args:
        items: of the index; titles are HTML.
        phrases: of each page, by its path.

    Raises:
        KeyError: a page isn't in the index.
    """
    documented = [item for item in items if not item["title"].startswith("__")]
    pages = {item["location"].rstrip("/"): item for item in documented if "#" not in item["location"]}
    titles = [
        {**pages[page], "title": phrase, "text": f"<p>How do I do this? See “{pages[page]['title']}”.</p>"}
        for page, page_phrases in phrases.items()
        for phrase in page_phrases
    ]
    later = [item for item in documented if item["location"].startswith(LATER_FOLDERS)]
    return [*titles, *(item for item in documented if not item["location"].startswith(LATER_FOLDERS)), *later]


def correct_index(path: Path, redirects: Mapping[str, str]) -> None:
    """Add the phrases to the search index of a site.

    Args:
        path: of the site's `search.json`.
        redirects: former paths of pages, with the present ones.
    """
    index = json.loads(path.read_text(encoding="utf-8"))
    index["items"] = add_phrases(index["items"], read_phrases(redirects))
    path.write_text(json.dumps(index, ensure_ascii=False, separators=(",", ":")), encoding="utf-8")
