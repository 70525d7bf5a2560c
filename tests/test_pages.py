"""The documentation of installed users: `python -m rhi docs`, the pages in the package, and the metadata's links."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest
from setuptools import Distribution

import rhi
from rhi.__main__ import main
from rhi.errors import pages

ROOT = Path(__file__).parents[1]
PAGES = sorted(file.stem for file in (ROOT / "docs").rglob("*.md"))


def test_each_page_is_a_topic_with_its_title(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs"]) == 0
    listed = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in listed] == PAGES
    assert all(len(line.split()) > 1 for line in listed)


def test_each_topic_is_the_name_of_a_single_page() -> None:
    assert len(PAGES) == len(set(PAGES))


@pytest.mark.parametrize("topic", ["lost-device", "docs/how-to/lost-device.md", "how-to/lost-device", "lost"])
def test_a_how_to_page_is_printed(topic: str) -> None:
    page = ROOT / "docs" / "how-to" / "lost-device.md"
    assert pages.read_page(topic) == page.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "topic",
    ["performance", "docs/measurements/performance.md", "measurements/performance", "docs/performance.md"],
)
def test_a_page_in_a_folder_is_printed(topic: str) -> None:
    page = ROOT / "docs" / "measurements" / "performance.md"
    assert pages.read_page(topic) == page.read_text(encoding="utf-8")


@pytest.mark.parametrize(("former", "topic"), pages.FORMER_TOPICS.items())
def test_a_former_topic_prints_the_page_that_has_its_text(former: str, topic: str) -> None:
    assert former not in PAGES
    assert pages.read_page(former) == pages.read_page(topic)


def test_tables_of_former_names_answer_no_question() -> None:
    assert "decisions" in {file.parent.name for file in (ROOT / "docs").rglob("*.md")}
    sections = pages.search(["old", "new", "where"])
    assert not {section.topic for section in sections} & {
        file.stem for file in (ROOT / "docs" / "decisions").glob("*.md")
    }


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


QUESTIONS = [
    ("how do tests see the instances of draw_many", "instances-in-tests"),
    ("what does a new pass bind again", "bindings-of-a-pass"),
    ("does .sampled inline cost something", "cost-of-sampled"),
    ("without geometry stages", "without-geometry-stages"),
    ("textures of many sizes in one draw", "textures-of-many-sizes"),
    ("rendering to all layers", "render-to-layers"),
    ("device memory in use", "memory-in-use"),
    ("recover lost device", "lost-device"),
    ("two windows of one device", "several-windows"),
    ("film of a scene", "film-of-a-scene"),
    ("dask frames of my own", "frames-on-dask"),
    ("warm-up and its progress", "warm-up"),
    ("ship kernel cache", "ship-kernel-cache"),
    ("points and shadows on WebGPU", "points-and-shadows-on-webgpu"),
    ("what may change before 1.0", "before-1-0"),
    ("save frame to a file", "save-an-image"),
    ("post-process an image", "post-processing"),
    ("many instances of a mesh", "many-instances"),
    ("see nothing on the screen", "nothing-to-see"),
    ("measure GPU time", "gpu-times"),
    ("variants of a shader", "shader-variants"),
    ("projection for OpenGL", "opengl-projections"),
    ("which object is at a pixel", "pick-an-object"),
    ("record a video of a window", "record-a-window"),
    ("draw beside moderngl", "beside-opengl"),
]
HOW_TO_PAGES = sorted((ROOT / "docs" / "how-to").glob("*.md"))


@pytest.mark.parametrize(("words", "topic"), QUESTIONS)
def test_words_of_a_question_lead_to_its_answer(
    words: str, topic: str, capsys: pytest.CaptureFixture[str]
) -> None:
    best = pages.search(words.split())[0]
    assert best.topic == topic
    assert main(["docs", *words.split()]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"# {best.heading}\n")
    assert f"python -m rhi docs {topic}" in printed
    assert main(["docs", words]) == 0, "in quotes, too"
    assert capsys.readouterr().out == printed


@pytest.mark.parametrize("page", HOW_TO_PAGES, ids=lambda page: page.stem)
def test_a_how_to_page_has_a_question_a_program_and_few_words(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    heading = text.partition("\n")[0].removeprefix("# ")
    assert heading.endswith("?")
    assert pages.search(heading.split())[0].topic == page.stem
    assert len(text.split()) <= 600
    programs = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert programs
    assert [line for program in programs for line in program.split("\n") if len(line) > 88] == []
    assert re.findall(r"^#+ .*$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE) == [
        f"# {heading}"
    ]


def test_the_page_of_questions_lists_each_how_to_page_by_its_question() -> None:
    text = (ROOT / "docs" / "questions.md").read_text(encoding="utf-8")
    listed = sorted(re.findall(r"^- \[(.*)\]\(how-to/(.*)\.md\)$", text, re.MULTILINE))
    titles = pages.list_topics()
    assert listed == sorted((titles[page.stem], page.stem) for page in HOW_TO_PAGES)
    assert len(listed) >= 40


def test_a_word_that_is_no_page_is_searched_and_a_misspelt_page_is_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["docs", "dask"]) == 0
    assert "dask" in capsys.readouterr().out.lower()
    assert main(["docs", "xyzzyx", "plughx"]) == 2
    assert capsys.readouterr().err.startswith("error: no page has xyzzyx or plughx")


REFERENCES = [
    ("look_at", "rhi.math.look_at(eye: ", "view matrix"),
    ("rhi.math.look_at", "rhi.math.look_at(eye: ", "view matrix"),
    ("Device.texture", "rhi.Device.texture(self, source: ", "Create a texture"),
    ("save_image", "rhi_screen.save_image(render: ", "command line"),
    ("why_bound", "rhi.testing.why_bound(", ""),
    ("CullMode", "rhi.CullMode(", "CullMode.NAME describes: BACK, FRONT, NONE"),
    ("Camera", "rhi.math.Camera(position: ", "look_at"),
]


@pytest.mark.parametrize(("name", "signature", "words"), REFERENCES)
def test_a_public_name_is_described_by_its_signature_and_docstring(
    name: str, signature: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["docs", name]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(signature)
    assert words in printed


def test_each_public_name_of_rhi_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    names = [name for name in rhi.__all__ if name.lower() not in PAGES and callable(getattr(rhi, name))]
    assert len(names) > 60
    undescribed = []
    for name in names:
        assert main(["docs", name]) == 0, name
        if not capsys.readouterr().out.startswith(f"rhi.{name}"):
            undescribed.append(name)
    pages_begin = {name: sum(page.startswith(name.lower()) for page in PAGES) for name in names}
    assert undescribed == [name for name in names if pages_begin[name] == 1]


@pytest.mark.parametrize("name", ["Device._draw", "Device.textur", "rhi.nothing", "rhi.math", "os.path"])
def test_an_unknown_name_is_an_unknown_page(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["docs", name]) == 2
    assert capsys.readouterr().err.startswith("error: there is no page")


@pytest.mark.parametrize(
    ("words", "heading"),
    [
        ("hot reload test", "Hot reload"),
        ("shadow map sun projection", "Shadow map"),
        ("draw_many mesh many meshes one buffer", "Parts, and many draws"),
        ("RHI_CACHE", "The cache of compiled kernels"),
    ],
)
def test_headings_outweigh_tables_that_have_every_word(words: str, heading: str) -> None:
    assert pages.search(words.split())[0].heading == heading


def test_comments_of_programs_are_no_headings() -> None:
    headings = {section.heading for section in pages.search(["python"])}
    assert not any(heading.startswith("a value") for heading in headings)
    assert all(section.text.count("```") % 2 == 0 for section in pages.search(["python"]))


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
    built = sorted(file.stem for file in (tmp_path / "rhi" / "documentation").rglob("*.md"))
    assert built == PAGES
    assert (tmp_path / "rhi" / "documentation" / "measurements" / "performance.md").is_file()


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
