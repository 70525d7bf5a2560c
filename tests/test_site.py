"""The documentation's site: it has all pages and no warning, its links lead somewhere, its search knows
names."""

from __future__ import annotations

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

from build_site import (  # noqa: E402
    EXTRA_PAGES,
    MODULES,
    REDIRECTS,
    build,
    collect_pages,
    write_redirects,
)

from rhi.errors.pages import FORMER_TOPICS, read_page  # noqa: E402


def test_each_page_is_in_the_navigation_once(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    pages = sorted(
        page.relative_to(tmp_path / "docs").as_posix() for page in (tmp_path / "docs").rglob("*.md")
    )
    navigation = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    assert sorted(re.findall(r"\S+\.md", navigation)) == pages
    assert {*EXTRA_PAGES.values(), *(f"reference/{module}.md" for module in MODULES)} <= set(pages)


def test_links_to_files_outside_of_the_pages_lead_to_copies(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    assert "](files/examples/programs/triangle.py.txt)" in (tmp_path / "docs/gallery.md").read_text()
    assert (tmp_path / "docs/files/examples/programs/triangle.py.txt").exists()
    assert "](measurements/performance.md)" in (tmp_path / "docs/index.md").read_text()


def test_links_lead_from_folder_to_folder(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    for page in (tmp_path / "docs").rglob("*.md"):
        for target in re.findall(r"\]\((?![a-z]+:|#)([^)#\s]+)", page.read_text(encoding="utf-8")):
            if page.parent.name != "reference":
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_former_addresses_lead_to_the_present_ones(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    for page in (tmp_path / "docs").rglob("*.md"):  # as the generator does
        address = tmp_path / "site" / page.relative_to(tmp_path / "docs").with_suffix("")
        address.mkdir(parents=True)
        (address / "index.html").write_text("")
    pages = {page.parent for page in (tmp_path / "site").rglob("index.html")}
    assert not pages & {tmp_path / "site" / former for former in REDIRECTS}, "a page would be overwritten"
    write_redirects(tmp_path / "site")
    for former, present in REDIRECTS.items():
        (link,) = Links(tmp_path / "site" / former / "index.html").links
        assert (tmp_path / "site" / former / link).resolve() == tmp_path / "site" / present
    assert list_broken(tmp_path / "site") == []


def test_merged_pages_have_redirects_and_moved_pages_their_topics() -> None:
    assert FORMER_TOPICS.items() <= REDIRECTS.items()
    for former, present in REDIRECTS.items():
        assert read_page(former) == (ROOT / "docs" / f"{present}.md").read_text(encoding="utf-8")


class Links(HTMLParser):
    """The links of a page, and the places in it that links may lead to."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.anchors.add(values.get("id") or "")
        link = values.get("href") if tag == "a" else values.get("src")
        if link and not urlsplit(link).scheme and not link.startswith("//"):
            self.links.append(link)


def list_broken(site: Path) -> list[str]:
    """The links of a site that lead nowhere, each with its page."""
    pages = {page: Links(page) for page in site.rglob("*.html") if page.name != "404.html"}
    broken = []
    for page, links in pages.items():
        for link in links.links:
            parts = urlsplit(link)
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            target = target / "index.html" if target.is_dir() else target
            if not target.exists() or (
                target in pages and unquote(parts.fragment) not in {"", *pages[target].anchors}
            ):
                broken.append(f"{page.relative_to(site)}: {link}")
    return broken


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.html").write_text(
        '<p id="here"><a href="#here">1</a><a href="#there">2</a><a href="b.html">3</a>'
    )
    assert list_broken(tmp_path) == ["a.html: #there", "a.html: b.html"]


@pytest.mark.nightly
def test_the_site_is_built_without_a_warning_and_its_links_and_search_resolve(
    tmp_path: Path,
) -> None:
    pytest.importorskip("zensical")
    pytest.importorskip("mkdocstrings")
    assert build(tmp_path / "documentation") == []
    site = tmp_path / "documentation" / "site"
    assert list_broken(site) == []
    assert 'id="rhi.Encoder.draw_many"' in (site / "reference/rhi/index.html").read_text()
    searched = json.dumps(json.loads((site / "search.json").read_text()))
    assert "draw_many" in searched
    assert "Deferred+" in searched
