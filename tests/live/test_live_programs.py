"""Live programs in a bare page of headless Chromium: they draw, can be edited, stopped and steered, and fail at
their line. `test_built_site.py` opens them in the whole site."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from chromium_kit import SWIFTSHADER, Page, open_page, serve
from live_kit import PYODIDE, PYTHON_IS_LOADED, LiveProgram, line_of, live_site, save_screenshot
from web_kit import ROOT

RED_CORNER, GREEN_CORNER = (0.86, 0.14), (0.86, 0.86)
"""Texels of the triangle near two of its corners: fractions of the canvas's height and width."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a site with two pages of live programs."""
    if not PYODIDE.is_dir():
        pytest.skip("no Pyodide: python scripts/run_in_node.py --fetch")
    folder = tmp_path_factory.mktemp("site")
    live_site.write_live(folder / "live", PYODIDE)
    elements = {
        "index": [live_site.make_element(name) for name in ("triangle.py", "orbit_viewer.py")],
        "null": [
            live_site.make_element("frame_commands.py", "null"),
            live_site.make_element("triangle.py"),
        ],
    }
    for name, parts in elements.items():
        head = '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">'
        text = live_site.add_script(head + "\n".join(parts), "live/")
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    with serve(folder) as address:
        yield address


# -- a program that is edited ------------------------------------------------------------------------------


class OpenedTriangle(LiveProgram):
    """The triangle's live program, and what its page said before Run was pressed."""

    def __init__(self, page: Page) -> None:
        super().__init__(page, "triangle.py")
        self.open()
        self.first_status = self.read("status")
        self.first_text = self.text
        self.was_loaded = page.evaluate(PYTHON_IS_LOADED)


@pytest.fixture(scope="module")
def opened_triangle(site: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpenedTriangle]:
    with open_page(tmp_path_factory.mktemp("profile"), *SWIFTSHADER) as page:
        page.open(site)
        yield OpenedTriangle(page)
        assert page.list_errors() == []


@pytest.fixture
def triangle(opened_triangle: OpenedTriangle) -> OpenedTriangle:
    """The program as in its file."""
    opened_triangle.click("reset")
    return opened_triangle


def test_nothing_is_loaded_before_run(triangle: OpenedTriangle) -> None:
    assert triangle.was_loaded is False


def test_the_page_says_the_contents_and_size_of_its_load(triangle: OpenedTriangle) -> None:
    assert re.fullmatch(
        r"Run first loads Python \(Pyodide [\d.]+\), NumPy, rhi: \d\d\.\d MB from this site, once for this page\.",
        triangle.first_status,
    )


def test_the_editor_has_the_file_of_the_desk(triangle: OpenedTriangle) -> None:
    assert triangle.first_text == (ROOT / "examples/programs/triangle.py").read_text(encoding="utf-8")


def test_a_program_draws_on_the_canvas(triangle: OpenedTriangle) -> None:
    assert triangle.run("running") == "running", triangle.read("output")
    red = triangle.wait_for_texel(RED_CORNER, lambda texel: texel[0] > 200 > texel[1], "triangle")
    green = triangle.wait_for_texel(GREEN_CORNER, lambda texel: texel[1] > 200)
    assert red[0] > 200 > red[1:].max(), red
    assert green[1] > 200 > green[0], green


def test_an_edited_colour_is_drawn(triangle: OpenedTriangle) -> None:
    triangle.text = triangle.text.replace("(1, 0, 0)", "(1, 1, 0)")
    assert triangle.run("running") == "running", triangle.read("output")
    yellow = triangle.wait_for_texel(RED_CORNER, lambda texel: texel[1] > 200, "triangle-edited")
    assert yellow[:2].min() > 200 > yellow[2], yellow


def test_an_error_is_marked_at_its_line(triangle: OpenedTriangle) -> None:
    text = triangle.text
    triangle.text = text.replace("vec4(v.color, 1.0)", "vec4(v.colour, 1.0)")
    assert triangle.run() == "failed"
    save_screenshot(triangle.page, "error")
    assert triangle.read("wrong") == str(line_of(text, "vec4(v.color, 1.0)"))
    assert "colour" in triangle.read("output")


def test_reset_restores_the_file(triangle: OpenedTriangle) -> None:
    triangle.text = "pass"
    triangle.click("reset")
    assert triangle.text == triangle.first_text


# -- a viewer ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def viewer(site: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveProgram]:
    """The viewer, opened in a page with two device pixels a CSS pixel."""
    profile = tmp_path_factory.mktemp("profile")
    with open_page(profile, *SWIFTSHADER, "--force-device-scale-factor=2") as page:
        page.open(site)
        program = LiveProgram(page, "orbit_viewer.py")
        program.open()
        yield program
        assert page.list_errors() == []


@pytest.fixture
def running_viewer(viewer: LiveProgram) -> LiveProgram:
    assert viewer.run("running") == "running", viewer.read("output")
    viewer.drawing("orbit")
    return viewer


@pytest.mark.nightly
def test_a_viewer_turns_by_dragging(running_viewer: LiveProgram) -> None:
    before = running_viewer.canvas()
    canvas = f'{running_viewer.element}.querySelector("canvas")'
    x, y = running_viewer.page.evaluate(f"(({{x, y}}) => [x, y])({canvas}.getBoundingClientRect())")
    drag(running_viewer.page, x + 100, y + 100)
    for _ in range(60):
        turned = running_viewer.canvas("orbit-turned")
        if np.abs(turned - before).mean() > 2:
            break
    assert np.abs(turned - before).mean() > 2


@pytest.mark.nightly
def test_a_viewer_follows_the_size_of_its_element(running_viewer: LiveProgram) -> None:
    page, canvas = running_viewer.page, f'{running_viewer.element}.querySelector("canvas")'
    wide = page.evaluate(f"{canvas}.width")
    assert abs(wide - 2 * page.evaluate(f"{canvas}.getBoundingClientRect().width")) <= 2
    page.evaluate(f'{canvas}.style.width = "50%"')
    page.wait_for(f"Math.abs(2 * {canvas}.width - {wide}) <= 2")


@pytest.mark.nightly
def test_stop_ends_a_viewer(running_viewer: LiveProgram) -> None:
    running_viewer.click("stop")
    running_viewer.page.wait_for(f'{running_viewer.state} === "ended"')
    assert "frames" in running_viewer.read("output")


def drag(page: Page, x: float, y: float) -> None:
    """Drag to the right, in eight steps."""
    page.move_mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    for step in range(8):
        page.move_mouse("mouseMoved", x + 12 * step, y, button="left", buttons=1)
    page.move_mouse("mouseReleased", x + 84, y, button="left")


# -- commands, without WebGPU ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def opened_commands(site: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveProgram]:
    """The program of a frame's commands, in a browser that has no WebGPU."""
    with open_page(tmp_path_factory.mktemp("profile"), "--disable-features=WebGPU", "--disable-gpu") as page:
        page.call(
            "Page.addScriptToEvaluateOnNewDocument",
            source='Object.defineProperty(navigator, "gpu", {value: undefined, configurable: true})',
        )
        page.open(f"{site}null.html")
        program = LiveProgram(page, "frame_commands.py")
        program.open()
        yield program
        assert page.list_errors() == []


@pytest.fixture
def commands(opened_commands: LiveProgram) -> LiveProgram:
    """The program as in its file."""
    opened_commands.click("reset")
    return opened_commands


def test_assertions_on_commands_hold_without_webgpu(commands: LiveProgram) -> None:
    assert commands.run() == "ended", commands.read("output")
    assert "all assertions hold" in commands.read("output")


def test_commands_are_listed_with_their_lines(commands: LiveProgram) -> None:
    assert commands.run() == "ended", commands.read("output")
    rows = commands.page.evaluate(
        f'[...{commands.element}.querySelectorAll("tr")]'
        ".map((row) => [...row.cells].map((cell) => cell.textContent))"
    )
    save_screenshot(commands.page, "null")
    draws = [row for row in rows if row[1].startswith("draw(")]
    text = commands.text.splitlines()
    assert len(draws) == 8
    assert {text[int(line) - 1].strip().split("(")[0] for _, _, line in draws} == {"self.device.draw"}


def test_an_assertion_that_fails_is_marked_at_its_line(commands: LiveProgram) -> None:
    commands.text = commands.text.replace("self.draw_boxes(opaque)", "self.draw_boxes(boxes)")
    assert commands.run() == "failed"
    line = commands.text.splitlines()[int(commands.read("wrong")) - 1]
    assert line.startswith("assert [draw.labels")


def test_a_program_that_draws_is_refused_without_webgpu(commands: LiveProgram) -> None:
    program = LiveProgram(commands.page, "triangle.py")
    program.open()
    assert program.page.evaluate(program.state) == "refused"
    assert "no WebGPU" in program.page.evaluate(f"{program.element}.textContent")


# -- what needs no browser -------------------------------------------------------------------------------------


def test_each_program_of_the_gallery_is_live_or_says_why_it_is_not() -> None:
    page = (ROOT / "docs/gallery.md").read_text(encoding="utf-8")
    live = live_site.add_live_programs(page)
    for name in sorted(path.stem for path in live_site.PROGRAMS.glob("*.py")):
        if name in live_site.NOT_LIVE:
            assert live_site.NOT_LIVE[name] in live
        else:
            assert live.count(f'data-program="{name}.py"') == 1
    assert live.count("live.mjs") == 1
    assert live_site.add_live_programs("# Another page\n") == "# Another page\n"


def test_a_program_whose_package_the_folder_lacks_is_absent_and_says_why(tmp_path: Path) -> None:
    page = (ROOT / "docs/gallery.md").read_text(encoding="utf-8")
    live = live_site.add_live_programs(page, live_site.list_absent(tmp_path))
    assert "it needs Pillow, which the site's Pyodide lacks" in live
    assert 'data-program="text.py"' not in live
    (tmp_path / live_site.PILLOW).touch()
    assert live_site.list_absent(tmp_path) == live_site.NOT_LIVE


def test_no_address_is_read_and_each_file_is_checked() -> None:
    script = (live_site.SOURCES / "live.mjs").read_text(encoding="utf-8")
    assert not re.search(r"\blocation\b|URLSearchParams|\bhash\b", script)
    assert "file.sha256" in script
    assert all(re.fullmatch(r"[0-9a-f]{64}", part.sha256) for part in live_site.PYODIDE)
    assert all(live_site.VERSION in part.url for part in live_site.PYODIDE)


def test_a_further_package_is_loaded_for_its_program_alone(tmp_path: Path) -> None:
    pytest.importorskip("rendercanvas")
    live_site.write_live(tmp_path)
    manifest = json.loads((tmp_path / "manifest.json").read_text(encoding="utf-8"))
    assert {name for name in manifest["files"] if name not in manifest["core"]} == {live_site.PILLOW}
    assert {name: further["files"] for name, further in manifest["further"].items()} == {
        "text.py": [live_site.PILLOW]
    }


def test_another_pyodide_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rendercanvas")
    with pytest.raises(SystemExit, match=r"has no pyodide\.mjs"):
        live_site.write_live(tmp_path / "a", tmp_path)
    (tmp_path / "pyodide.mjs").write_text("", encoding="utf-8")
    with pytest.raises(SystemExit, match="another SHA-256"):
        live_site.write_live(tmp_path / "b", tmp_path)


def test_without_a_folder_pyodide_comes_from_its_distribution(tmp_path: Path) -> None:
    pytest.importorskip("rendercanvas")
    live_site.write_live(tmp_path / "live")
    manifest = json.loads((tmp_path / "live/manifest.json").read_text(encoding="utf-8"))
    assert not (tmp_path / "live/pyodide").exists()
    for part in (*live_site.PYODIDE, *(package.part for package in live_site.FURTHER.values())):
        file = manifest["files"][part.name]
        assert file == {"url": part.url + part.name, "bytes": part.bytes, "sha256": part.sha256}
