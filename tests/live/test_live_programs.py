"""Live programs of the site in headless Chromium: they draw, can be edited, stopped and steered, and fail at their
line."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium_kit import SWIFTSHADER, Page, open_page, serve
from web_kit import ROOT, run_in_node

sys.path.insert(0, str(ROOT / "scripts"))

import live_site

PYODIDE = run_in_node.FOLDER / "pyodide"
PAGE = [*(f"{name}.py" for name in live_site.LIVE), "orbit_viewer.py"]
SCREENSHOTS = os.environ.get("RHI_LIVE_SCREENSHOTS")
"""A folder to which the tests write their screenshots, to be looked at."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a site with two pages of live programs."""
    if not PYODIDE.is_dir():
        pytest.skip("no Pyodide: python scripts/run_in_node.py --fetch")
    folder = tmp_path_factory.mktemp("site")
    live_site.write_live(folder / "live", PYODIDE)
    elements = {
        "index": [live_site.make_element(name) for name in PAGE],
        "null": [live_site.make_element("frame_commands.py", "null")],
    }
    for name, parts in elements.items():
        head = '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">'
        text = live_site.add_script(head + "\n".join(parts), "live/")
        (folder / f"{name}.html").write_text(text, encoding="utf-8")
    with serve(folder) as address:
        yield address


@pytest.fixture(scope="module")
def page(site: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with open_page(tmp_path_factory.mktemp("profile"), *SWIFTSHADER) as opened:
        opened.open(site)
        yield opened


class Program:
    """A live program of a page."""

    def __init__(self, page: Page, index: int) -> None:
        self.page = page
        self.element = f'document.querySelectorAll(".rhi-live")[{index}]'

    def open(self) -> None:
        self.page.wait_for(f'!!{self.element}.querySelector("button")')
        self.page.evaluate(f'{self.element}.querySelector("button").click()')
        self.page.wait_for(f"!!{self.element}.dataset.state")

    @property
    def text(self) -> str:
        return str(self.page.evaluate(f'{self.element}.querySelector("textarea").value'))

    @text.setter
    def text(self, text: str) -> None:
        area = f'{self.element}.querySelector("textarea")'
        self.page.evaluate(f'{area}.value = {json.dumps(text)}; {area}.dispatchEvent(new Event("input"))')

    def click(self, name: str) -> None:
        self.page.evaluate(f'{self.element}.querySelector(".rhi-live-{name}").click()')

    def run(self, *states: str) -> str:
        """Press Run; wait for a state of the program, or for its end."""
        self.page.evaluate(f'{self.element}.dataset.state = "pressed"')
        self.click("run")
        expected_states = json.dumps([*states, "failed", "ended"])
        return str(self.page.wait_for(f"{expected_states}.includes({self.state}) && {self.state}"))

    @property
    def state(self) -> str:
        return f"{self.element}.dataset.state"

    def read(self, name: str) -> str:
        return str(self.page.evaluate(f'{self.element}.querySelector(".rhi-live-{name}").textContent'))

    def canvas(self, name: str = "") -> np.ndarray[Any, Any]:
        """The canvas as the page shows it, (height, width, 3)."""
        self.page.evaluate(f'{self.element}.scrollIntoView({{behavior: "instant"}})')
        box = self.page.evaluate(
            f'(({{x, y, width, height}}) => [x, y, width, height])({self.element}.querySelector("canvas")'
            ".getBoundingClientRect())"
        )
        image = self.page.screenshot(Path(SCREENSHOTS) / f"{name}.png" if SCREENSHOTS and name else None)
        ratio = self.page.evaluate("devicePixelRatio")
        x, y, width, height = (round(ratio * value) for value in box)
        return image[max(y, 0) + 4 : y + height - 4, x + 4 : x + width - 4].astype(int)

    def drawing(self, name: str = "") -> np.ndarray[Any, Any]:
        """The canvas, once it has more than its background."""
        for _ in range(60):
            image = self.canvas()
            if len(np.unique(image.reshape(-1, 3), axis=0)) > 8:
                break
            self.page.evaluate("new Promise((resolve) => setTimeout(resolve, 500))")
        return self.canvas(name)


def test_a_reader_runs_a_program_edits_its_colour_and_sees_an_error_at_its_line(page: Page) -> None:
    """The triangle, as in the gallery; then with a yellow corner instead of the red one; then with a fault."""
    program = Program(page, PAGE.index("triangle.py"))
    assert not page.evaluate("!!globalThis._createPyodideModule")
    program.open()
    assert "MB" in program.read("status")
    assert page.evaluate("!!globalThis._createPyodideModule") is False  # nothing is loaded before Run
    assert program.run("running") == "running", program.read("output")
    first = program.drawing("triangle")
    height, width, _ = first.shape
    red, green = first[int(0.86 * height), int(0.14 * width)], first[int(0.86 * height), int(0.86 * width)]
    assert red[0] > 200 > red[2], red
    assert green[1] > 200 > green[0], green

    text = program.text
    assert text == (ROOT / "examples/programs/triangle.py").read_text(encoding="utf-8")
    program.text = text.replace("(1, 0, 0)", "(1, 1, 0)")
    assert program.run("running") == "running", program.read("output")
    for _ in range(60):
        edited = program.canvas("triangle-edited")
        if edited[int(0.86 * height), int(0.14 * width), 1] > 200:
            break
    yellow = edited[int(0.86 * height), int(0.14 * width)]
    assert yellow[:2].min() > 200 > yellow[2], yellow

    program.text = text.replace("vec4(v.color, 1.0)", "vec4(v.colour, 1.0)")
    assert program.run() == "failed"
    line = next(i for i, row in enumerate(text.splitlines(), 1) if "vec4(v.color, 1.0)" in row)
    assert program.read("wrong") == str(line)
    assert "colour" in program.read("output")
    if SCREENSHOTS:
        page.screenshot(Path(SCREENSHOTS) / "error.png")

    program.click("reset")
    assert program.text == text
    assert page.list_errors() == []


@pytest.mark.nightly
def test_a_viewer_turns_by_dragging_follows_its_size_and_is_stopped(site: str, tmp_path: Path) -> None:
    with open_page(tmp_path, *SWIFTSHADER, "--force-device-scale-factor=2") as page:
        page.open(site)
        program = Program(page, PAGE.index("orbit_viewer.py"))
        program.open()
        assert program.run("running") == "running", program.read("output")
        before = program.drawing("orbit")
        canvas = f'{program.element}.querySelector("canvas")'
        x, y = page.evaluate(f"(({{x, y}}) => [x, y])({canvas}.getBoundingClientRect())")
        drag(page, x + 100, y + 100)
        for _ in range(60):
            turned = program.canvas("orbit-turned")
            if np.abs(turned - before).mean() > 2:
                break
        assert np.abs(turned - before).mean() > 2

        assert page.evaluate("devicePixelRatio") == 2
        wide = page.evaluate(f"{canvas}.width")
        assert abs(wide - 2 * page.evaluate(f"{canvas}.getBoundingClientRect().width")) <= 2
        page.evaluate(f'{canvas}.style.width = "50%"')
        page.wait_for(f"Math.abs(2 * {canvas}.width - {wide}) <= 2")
        program.click("stop")
        page.wait_for(f'{program.state} === "ended"')
        assert "frames" in program.read("output")
        assert page.list_errors() == []


def drag(page: Page, x: float, y: float) -> None:
    """Drag to the right, in eight steps."""
    page.move_mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    for step in range(8):
        page.move_mouse("mouseMoved", x + 12 * step, y, button="left", buttons=1)
    page.move_mouse("mouseReleased", x + 84, y, button="left")


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name in PAGE if name not in ("triangle.py", "orbit_viewer.py")])
def test_a_program_of_the_gallery_draws_its_image(name: str, page: Page) -> None:
    """Compared with the gallery's image in blocks of 1/16: the page's pixels are others."""
    image = pytest.importorskip("PIL.Image")
    program = Program(page, PAGE.index(name))
    program.open()
    assert program.run("running") == "running", program.read("output")
    drawn = program.drawing(name.removesuffix(".py"))
    path = ROOT / "docs/images/gallery" / f"{name.removesuffix('.py')}.webp"
    blocks = [
        np.asarray(image.fromarray(np.asarray(each, np.uint8)).resize((16, 12), image.Resampling.BOX)).astype(
            int
        )
        for each in (drawn, np.asarray(image.open(path).convert("RGB")))
    ]
    assert np.abs(blocks[0] - blocks[1]).mean() < 8


def test_commands_are_asserted_on_and_listed_without_webgpu(site: str, tmp_path: Path) -> None:
    with open_page(tmp_path, "--disable-features=WebGPU", "--disable-gpu") as page:
        page.open(f"{site}null.html")
        program = Program(page, 0)
        program.open()
        assert program.run() == "ended", program.read("output")
        assert "all assertions hold" in program.read("output")
        rows = page.evaluate(
            f'[...{program.element}.querySelectorAll("tr")]'
            ".map((row) => [...row.cells].map((cell) => cell.textContent))"
        )
        draws = [row for row in rows if row[1].startswith("draw(")]
        text = program.text.splitlines()
        assert len(draws) == 8
        assert {text[int(line) - 1].strip().split("(")[0] for _, _, line in draws} == {"self.device.draw"}
        if SCREENSHOTS:
            page.screenshot(Path(SCREENSHOTS) / "null.png")

        program.text = program.text.replace("self.draw_boxes(opaque)", "self.draw_boxes(boxes)")
        assert program.run() == "failed"
        assert text[int(program.read("wrong")) - 1].startswith("assert [draw.labels")

        page.evaluate('Object.defineProperty(navigator, "gpu", {value: undefined, configurable: true})')
        refused = page.evaluate(
            'document.body.insertAdjacentHTML("beforeend", \'<div class="rhi-live" data-program="triangle.py"></div>\')'
            ' ?? import("./live/live.mjs?again")'
        )
        assert refused is not None
        program = Program(page, 1)
        program.open()
        assert page.evaluate(program.state) == "refused"
        assert "no WebGPU" in page.evaluate(f"{program.element}.textContent")


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


def test_no_address_is_read_and_each_file_is_checked() -> None:
    script = (live_site.SOURCES / "live.mjs").read_text(encoding="utf-8")
    assert not re.search(r"\blocation\b|URLSearchParams|\bhash\b", script)
    assert "file.sha256" in script
    assert all(re.fullmatch(r"[0-9a-f]{64}", part.sha256) for part in live_site.PYODIDE)
    assert all(live_site.VERSION in part.url for part in live_site.PYODIDE)


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
    for part in live_site.PYODIDE:
        file = manifest["files"][part.name]
        assert file == {"url": part.url + part.name, "bytes": part.bytes, "sha256": part.sha256}
