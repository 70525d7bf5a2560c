"""The documentation of installed users: `python -m rhi docs`, the pages in the package, and the metadata's links."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest
from setuptools import Distribution

from rhi.__main__ import main
from rhi.errors import pages

ROOT = Path(__file__).parents[1]
PAGES = sorted(file.stem for file in (ROOT / "docs").glob("*.md"))


def test_each_page_is_a_topic_with_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == PAGES
    assert all(len(line.split()) > 1 for line in listed)


@pytest.mark.parametrize("topic", ["traces", "docs/traces.md", "traces.md", "trac", "TRACES"])
def test_a_page_is_printed(topic: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", topic]) == 0
    expected = (ROOT / "docs" / "traces.md").read_text(encoding="utf-8")
    assert capsys.readouterr().out.rstrip("\n") == expected.rstrip("\n")


def test_a_whole_name_wins_over_the_beginning_of_others() -> None:
    assert pages.read_page("shading").startswith("# ")
    assert pages.read_page("shading") == (ROOT / "docs" / "shading.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("topic", "hint"), [("tracs", "traces"), ("back", "backends-gl"), ("../README", "lists"), ("", "lists")]
)
def test_an_unknown_page_is_one_line(topic: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", topic]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("error: there is no page")
    assert hint in captured.err
    assert len(captured.err.splitlines()) == 1


def test_a_browser_gets_the_page(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", lambda address: opened.append(address) or True)
    assert main(["docs", "glossary", "--browser"]) == 0
    assert opened == [capsys.readouterr().out.strip()]
    html = Path(opened[0].removeprefix("file://")).read_text(encoding="utf-8")
    assert "<title>Glossary</title>" in html
    assert "&lt;" not in html.partition("<pre>")[0]


def test_the_package_contains_the_pages(tmp_path: Path) -> None:
    build = load_setup().BuildWithPages(Distribution())
    build.build_lib = str(tmp_path)
    build.copy_pages()
    built = sorted(file.stem for file in (tmp_path / "rhi" / "documentation").glob("*.md"))
    assert built == PAGES


def test_an_installed_package_finds_its_own_pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    installed, checkout = tmp_path / "documentation", ROOT / "docs"
    monkeypatch.setattr(pages, "_FOLDERS", (installed, tmp_path / "none"))
    with pytest.raises(pages.UnknownPageError, match="aren't installed"):
        pages.list_topics()
    installed.mkdir()
    for name in ("contents.md", "null.md"):
        (installed / name).write_text((checkout / name).read_text(encoding="utf-8"), encoding="utf-8")
    assert list(pages.list_topics()) == ["contents", "null"]


MENTION = re.compile(r"python -m rhi docs ([a-z-]+)")


def test_each_topic_that_a_message_or_docstring_names_exists() -> None:
    mentions = [
        (file, topic)
        for package in ("rhi", "rhi_screen", "rhi_pytest", "renderer")
        for file in sorted((ROOT / package).rglob("*.py"))
        for topic in MENTION.findall(file.read_text(encoding="utf-8"))
    ]
    assert len(mentions) > 10
    assert [(file, topic) for file, topic in mentions if topic not in PAGES] == []


def load_setup() -> ModuleType:
    spec = importlib.util.spec_from_file_location("project_setup", ROOT / "setup.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_addresses_of_the_metadata_lead_to_files_of_the_project() -> None:
    urls = load_setup().list_urls("https://example.org/me/rhi", "1.2.3")
    files = [url.partition("/v1.2.3/")[2] for url in urls.values() if "/blob/" in url]
    assert len(files) == 2
    assert [file for file in files if not (ROOT / file).is_file()] == []
