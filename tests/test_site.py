"""The documentation's site: it has all pages and no warning, its links lead somewhere, its search knows
names."""

from __future__ import annotations

import ast
import html
import importlib
import inspect
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable
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
    add_version,
    collect_pages,
    correct_edit_links,
    write_configuration,
    write_redirects,
)
from gallery_cards import BACKENDS, PROGRAM_TOPICS, TOPICS, list_cards, write_grid, write_style  # noqa: E402
from live_site import LIVE  # noqa: E402
from search_phrases import add_phrases, read_phrases  # noqa: E402
from site_kit import built_site  # noqa: E402

from rhi.errors.pages import FORMER_TOPICS, read_page  # noqa: E402


def test_each_page_is_in_the_navigation_once(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    pages = sorted(
        page.relative_to(tmp_path / "docs").as_posix() for page in (tmp_path / "docs").rglob("*.md")
    )
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    assert sorted(re.findall(r"\S+\.md", navigation)) == pages
    assert {*EXTRA_PAGES.values(), *(f"reference/{module}.md" for module in MODULES)} <= set(pages)


KINDS = ["Tutorials", "How-to", "Explanation", "Reference", "Measurements", "Decisions"]


def list_linked(kind: str) -> set[str]:
    """The pages below the heading of a kind in the list of all pages."""
    text = (ROOT / "docs" / "contents.md").read_text(encoding="utf-8").partition(f"\n## {kind}\n")[2]
    return set(re.findall(r"\]\(([\w./-]+\.md)\)", text.partition("\n## ")[0]))


def test_the_navigation_and_the_list_of_all_pages_have_the_same_four_kinds_of_page() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    parts = dict(zip(KINDS, re.split(r"^  - [\w-]+:\n", navigation, flags=re.MULTILINE)[1:], strict=True))
    assert re.findall(r"^  - ([\w-]+):\n", navigation, re.MULTILINE) == KINDS
    listed = re.findall(r"^## (.*)$", (ROOT / "docs/contents.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == KINDS
    left_out = r"(?:how-to|reference)/.*|(?:numpy-backend|contents|contributing|changelog)\.md"
    for kind, part in parts.items():
        pages = {page for page in re.findall(r"\S+\.md", part) if not re.fullmatch(left_out, page)}
        assert pages == {page for page in list_linked(kind) if not page.startswith("../")}, kind


def test_links_to_files_outside_of_the_pages_lead_to_copies(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    assert "](files/examples/programs/triangle.py.txt)" in (tmp_path / "docs/gallery.md").read_text(
        encoding="utf-8"
    )
    assert (tmp_path / "docs/files/examples/programs/triangle.py.txt").exists()
    assert "](measurements/performance.md)" in (tmp_path / "docs/index.md").read_text(encoding="utf-8")


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
        (address / "index.html").write_text("", encoding="utf-8")
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
        '<p id="here"><a href="#here">1</a><a href="#there">2</a><a href="b.html">3</a>', encoding="utf-8"
    )
    assert list_broken(tmp_path) == ["a.html: #there", "a.html: b.html"]


def list_classes_and_functions(module: str) -> list[str]:
    """The public names of a module that the reference has, but for functions with the name of a submodule."""
    imported = importlib.import_module(module)
    return [
        f"{module}.{name}"
        for name in getattr(imported, "__all__", ())
        if (inspect.isclass(getattr(imported, name)) or inspect.isfunction(getattr(imported, name)))
        and f"{module}.{name}" not in sys.modules
        and getattr(imported, name).__module__.startswith("rhi")  # ids are numbers
    ]


def test_the_reference_inspects_modules_with_public_names_and_leaves_out_drivers() -> None:
    pytest.importorskip("griffe")
    pytest.importorskip("zensical")
    from zensical_pages import list_documented_modules

    documented = list_documented_modules()
    defining = {
        value.__module__
        for module in MODULES
        for value in vars(importlib.import_module(module)).values()
        if inspect.isclass(value) and value.__module__.startswith("rhi.")
    }
    assert defining | {"rhi", "rhi.device", "rhi.device.device", *MODULES} <= documented
    drivers = ("rhi.backends.gl", "rhi.backends.cl", "rhi.backends.wgpu", "rhi.backends.web")
    assert [name for name in documented if name.startswith(drivers)] == []
    assert len(documented) < 150, "the site's build inspects them all"


def test_docstrings_of_attributes_and_annotations_are_those_of_the_source() -> None:
    pytest.importorskip("griffe")
    pytest.importorskip("zensical")
    from zensical_pages import read_annotations, read_attribute_docstrings

    source = '''
LIMIT: int = 4
"""The most targets of a pass."""
NAMES = ("a",)
count = 1
class Kind:
    """A kind."""
    size: int = 3
    """Bytes of
    an element."""
    def method(self, values: ArrayLike, *, first: int = 0): "No attribute."
'''
    tree = ast.parse(source)
    assert read_annotations(tree) == {"Kind.method": {"values": "ArrayLike", "first": "int"}}
    assert read_attribute_docstrings(tree) == {
        "LIMIT": "The most targets of a pass.",
        "Kind.size": "Bytes of\nan element.",
    }


# -- cards of the gallery ----------------------------------------------------------------------------------

GALLERY = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")


def test_each_program_of_the_gallery_has_a_card_with_a_topic_and_its_backends() -> None:
    cards = {card.name: card for card in list_cards(GALLERY)}
    assert (
        cards.keys()
        == PROGRAM_TOPICS.keys()
        >= {path.stem for path in (ROOT / "examples/programs").glob("*.py")}
    )
    assert {topic for card in cards.values() for topic in card.topics} == TOPICS.keys()
    assert {name for name, card in cards.items() if "live" in card.backends} == set(LIVE)
    assert all({"gl", "cl", "null"} <= set(card.backends) <= BACKENDS.keys() for card in cards.values())
    assert all((ROOT / "docs/images" / card.image).exists() for card in cards.values())
    assert all(5 < len(card.sentence) < 150 for card in cards.values())


def test_a_program_without_a_topic_is_refused() -> None:
    with pytest.raises(KeyError, match="unknown"):
        list_cards("## Unknown\n\nA program.\n\n![Unknown](images/gallery/unknown.webp)\n")


def test_filters_are_radio_buttons_with_labels_and_cards_are_links_with_texts() -> None:
    """The keyboard and screen readers work with them, and the style sheet has a rule for each choice."""
    cards = list_cards(GALLERY)
    grid, style = write_grid(cards, "gallery/"), write_style()
    assert grid.count("<fieldset") == grid.count("<legend>") == 2
    assert grid.count('<label><input type="radio"') == len(TOPICS) + len(BACKENDS) + 2
    assert grid.count(" checked>") == 2
    assert len(re.findall(r'<li data-tags="topic-[^"]+"><a href="gallery/#[\w-]+">', grid)) == len(cards)
    assert len(re.findall(r'<img src="images/\S+" alt="[^"]{5,}"', grid)) == len(cards)
    for value in re.findall(r'value="(\w+-\w+)"', grid):
        assert f'li:not([data-tags~="{value}"])' in style
        assert re.search(rf'data-tags="[^"]*\b{value}\b', grid), f"no card is left by {value}"


def test_the_first_page_and_the_gallery_have_the_cards(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs", live=True)
    first, gallery = (
        (tmp_path / "docs" / name).read_text(encoding="utf-8") for name in ("index.md", "gallery.md")
    )
    assert 0 < first.index("## Gallery") < first.index('<a href="gallery/#triangle">')
    assert '<img src="images/gallery/triangle.webp"' in first
    assert gallery.index('<a href="#triangle">') < gallery.index("## Triangle")
    assert '<img src="images/gallery/triangle.webp"' in gallery
    assert 'class="rhi-card-live"' in first
    collect_pages(tmp_path / "still")
    assert 'class="rhi-card-live"' not in (tmp_path / "still" / "index.md").read_text(encoding="utf-8")


# -- edit links and versions -------------------------------------------------------------------------------


def test_pages_have_an_edit_link_only_if_there_is_a_home(tmp_path: Path) -> None:
    configuration = tmp_path / "mkdocs.yml"
    write_configuration(configuration, home=None, versions=False)
    assert configuration.read_text(encoding="utf-8") == (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    write_configuration(configuration, home="https://example.org/me/rhi/", versions=False)
    text = configuration.read_text(encoding="utf-8")
    assert "content.action.edit" in text
    assert "repo_url: https://example.org/me/rhi\nedit_uri: edit/main/docs/\n" in text


def test_edit_links_lead_to_the_files_of_pages_and_the_reference_has_none(tmp_path: Path) -> None:
    home = "https://example.org/me/rhi"
    for page in ("scene", "index", "numpy-backend", "reference/rhi"):
        (tmp_path / page).mkdir(parents=True)
        link = f'<p><a href="{home}/edit/main/docs/{page}.md" rel="edit">\n<svg></svg></a></p>'
        (tmp_path / page / "index.html").write_text(link, encoding="utf-8")
    correct_edit_links(tmp_path, home)
    texts = {page.parent.name: page.read_text(encoding="utf-8") for page in tmp_path.rglob("index.html")}
    assert f"{home}/edit/main/docs/scene.md" in texts["scene"]
    assert f"{home}/edit/main/README.md" in texts["index"]
    assert f"{home}/edit/main/examples/numpy_backend/README.md" in texts["numpy-backend"]
    assert texts["rhi"] == "<p></p>"


def test_versions_are_listed_with_the_newest_first_and_the_first_page_leads_to_it(tmp_path: Path) -> None:
    site, releases = tmp_path / "site", tmp_path / "releases"
    site.mkdir()
    for version in ("0.9.0", "0.10.0", "0.2.0", "0.9.0"):
        (site / "search.json").write_text(version, encoding="utf-8")
        add_version(releases, version, site)
    rows = json.loads((releases / "versions.json").read_text(encoding="utf-8"))
    assert [row["version"] for row in rows] == ["0.10.0", "0.9.0", "0.2.0"]
    assert [row["aliases"] for row in rows] == [["latest"], [], []]
    assert Links(releases / "index.html").links == ["0.10.0/"]


# -- the search --------------------------------------------------------------------------------------------


def test_phrases_of_the_search_lead_to_pages(tmp_path: Path) -> None:
    collect_pages(tmp_path / "docs")
    phrases = read_phrases(REDIRECTS)
    assert [page for page in phrases if not (tmp_path / "docs" / f"{page}.md").exists()] == []
    titles = [title for page_titles in phrases.values() for title in page_titles]
    assert len(titles) == len(set(titles)) > 80


def test_a_phrase_is_a_title_of_its_page_and_results_of_the_reference_come_last() -> None:
    items = [
        {"location": "reference/rhi/", "title": "rhi", "text": "", "path": ["Reference"]},
        {"location": "reference/rhi/#rhi.Kind.__annotations__", "title": "__annotations__", "text": ""},
        {"location": "states/", "title": "Render &lt;states&gt;", "text": "", "path": ["Reference"]},
    ]
    index = add_phrases(items, {"states": ["Depth buffer"]})
    assert [(item["location"], item["title"]) for item in index] == [
        ("states/", "Depth buffer"),
        ("states/", "Render &lt;states&gt;"),
        ("reference/rhi/", "rhi"),
    ]
    assert index[0]["path"] == ["Reference"]
    assert "Render &lt;states&gt;" in index[0]["text"]
    with pytest.raises(KeyError, match="absent"):
        add_phrases(items, {"absent": ["Depth buffer"]})


QUERIES = {
    "draw a triangle": ("tutorials/first-triangle", "gallery"),
    "uniform buffer": ("memory-and-time",),
    "read pixels back": ("how-to/save-an-image", "how-to/read-without-waiting"),
    "test without gpu": ("testing",),
    "shadow acne": ("shadows",),
    "install on windows": ("installation",),
    "port a backend": ("porting",),
    "hot reload shader": ("how-to/reload-shaders", "reload"),
    "instancing": ("how-to/many-instances",),
    "many lights": ("lighting", "light-culling"),
    "screenshot": ("how-to/save-an-image",),
    "depth buffer": ("states",),
    "compute shader": ("how-to/compute-on-arrays",),
    "black screen": ("how-to/nothing-to-see",),
    "framebuffer": ("passes",),
    "count draw calls": ("testing",),
    "gltf": ("scene-files",),
    "antialiasing": ("how-to/multi-sampling",),
}
"""What a new user types, and the pages of which one must be among the first three results."""


def search(site: Path, queries: Iterable[str]) -> dict[str, list[str]]:
    """The addresses of the first three results of each query, by the search of the site's own theme."""
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node")
    answer = subprocess.run(
        [node, str(ROOT / "scripts" / "search_site.mjs"), str(site), *queries],
        capture_output=True,
        text=True,
        check=True,
        encoding="utf-8",
    )
    return {query: [address for address, _ in rows[:3]] for query, rows in json.loads(answer.stdout).items()}


@pytest.mark.nightly
def test_queries_of_new_users_lead_to_the_right_pages() -> None:
    results = search(built_site(), QUERIES)
    missed = {
        query: results[query]
        for query, pages in QUERIES.items()
        if not {REDIRECTS.get(page, page) for page in pages}
        & {address.partition("#")[0].rstrip("/") for address in results[query]}
    }
    assert missed == {}


@pytest.mark.nightly
def test_a_query_without_results_has_none() -> None:
    assert search(built_site(), ["qqqqqqqqqqqqqq"]) == {"qqqqqqqqqqqqqq": []}


# -- the built site ----------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_the_site_is_built_without_a_warning_and_its_links_and_search_resolve() -> None:
    site = built_site()
    assert list_broken(site) == []
    for module in MODULES:
        reference = (site / "reference" / module / "index.html").read_text(encoding="utf-8")
        assert [name for name in list_classes_and_functions(module) if f'id="{name}"' not in reference] == []
        machinery = re.findall(
            r'id="rhi[^"]*\.(__(?!init|call|enter|exit|len|getitem|iter|await|version)\w+)"', reference
        )
        assert machinery == []
        assert "str(object=" not in reference, "a docstring of a value's type"
        assert str(ROOT) not in reference
        text = html.unescape(re.sub(r"<[^>]+>", "", reference))
        assert re.findall(r"\w+: Union\b(?!\[)", text) == []
    searched = json.dumps(json.loads((site / "search.json").read_text(encoding="utf-8")))
    assert "draw_many" in searched
    assert "Deferred+" in searched
