"""Every Python example in README.md and docs/ runs as it stands, page by page, from top to bottom."""

from __future__ import annotations

import re
import runpy
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

import rhi

ROOT = Path(__file__).parents[1]
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]
EXAMPLES = {
    page: re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL) for page in PAGES
}


@cache
def can_render() -> bool:
    return any(report.capabilities and report.capabilities.renders for report in rhi.report())


@pytest.mark.parametrize("page", [p for p in PAGES if EXAMPLES[p]], ids=lambda p: p.name)
def test_the_examples_of_a_page_run_one_after_the_other(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not can_render():
        pytest.skip("no backend that renders works here")
    monkeypatch.chdir(tmp_path)  # for what an example writes
    program = tmp_path / "example.py"
    program.write_text("\n".join(EXAMPLES[page]), encoding="utf-8")
    runpy.run_path(str(program), run_name="example")


def test_the_first_example_of_the_readme_has_at_most_30_lines() -> None:
    lines = [line for line in EXAMPLES[ROOT / "README.md"][0].splitlines() if line.strip()]
    assert len(lines) <= 30


def test_examples_of_shaders_do_not_replace_built_ins_of_python() -> None:
    programs = {path: path.read_text(encoding="utf-8") for path in (ROOT / "examples").rglob("*.py")}
    programs |= {page: "\n".join(texts) for page, texts in EXAMPLES.items()}
    replaced = r"from rhi\.shading import (\*|\(?[\w,\s]*\b(abs|min|max)\b)"
    assert [str(path) for path, text in programs.items() if re.search(replaced, text)] == []
    assert re.search(replaced, "from rhi.shading import (\n    dot,\n    max,\n)")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def list_anchors(page: Path) -> set[str]:
    """The addresses of a page's headings, as the site and forges make them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text), re.MULTILINE)
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading.strip().lower())) for heading in headings}


def list_broken_anchors(page: Path) -> list[str]:
    """The links of a page to headings that don't exist."""
    links = re.findall(r"\]\(([^)#\s]*)#([^)\s]+)\)", page.read_text(encoding="utf-8"))
    targets = [(page.parent / file if file else page, anchor) for file, anchor in links if "://" not in file]
    return [f"{target.name}#{anchor}" for target, anchor in targets if anchor not in list_anchors(target)]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_to_headings_lead_somewhere(page: Path) -> None:
    assert list_broken_anchors(page) == []


def test_a_link_to_a_missing_heading_is_found(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A `b`: c\n\n[1](#a-b-c) [2](page.md#a-b-c) [3](#d)\n```\n# d\n```\n", encoding="utf-8")
    assert list_broken_anchors(page) == ["page.md#d"]


def test_frames_are_shown_and_compressed() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    sizes = {path: path.stat().st_size for path in (ROOT / "docs" / "images").rglob("*.*")}
    assert [str(path) for path in sizes if path.name not in pages] == []
    assert [str(path) for path, size in sizes.items() if size > 450_000] == []
    assert sum(sizes.values()) < 4_500_000, (
        "as WebP, without loss where edges are coloured, they take half of it"
    )


def test_the_examples_of_the_readme_pass_mypy_strict(
    mypy_strict: Callable[..., tuple[str, int]], tmp_path: Path
) -> None:
    program = tmp_path / "readme.py"
    program.write_text("\n".join(EXAMPLES[ROOT / "README.md"]), encoding="utf-8")
    out, _ = mypy_strict(program)
    assert [line for line in out.splitlines() if program.name in line] == []


def test_the_summary_of_the_five_works_counts_the_rows_of_its_tables() -> None:
    page = (ROOT / "docs" / "decisions" / "coverage.md").read_text(encoding="utf-8")
    summary, *sections = re.split(r"^## ", page, flags=re.MULTILINE)
    states = ("yes", "partly", "no", "left out")
    counted = []
    for section in sections:
        rows = [line for line in section.splitlines() if re.match(r"\| (?!where|-)", line)]
        counted.append([len(rows), *(sum(f"| {state} |" in row for row in rows) for state in states)])
    counted.append([sum(column) for column in zip(*counted, strict=True)])
    written = [
        [int(number) for number in re.findall(r"\| (\d+)", line)]
        for line in summary.splitlines()
        if re.search(r"\| \d", line)
    ]
    assert written == counted
