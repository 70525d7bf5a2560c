"""The built site as a stranger opens it: served from a folder, in headless Chromium.

The gallery's programs draw in their page, the triangle's colour is edited, and a browser without WebGPU keeps the
images. `test_site_pages.py` opens all pages. `RHI_LIVE_SCREENSHOTS=FOLDER` keeps screenshots.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest
from chromium_kit import SWIFTSHADER, Page, open_page, serve
from live_kit import PYODIDE, LiveProgram, line_of, live_site, mean_difference, save_screenshot
from web_kit import ROOT, require_pyodide

pytestmark = pytest.mark.nightly

PROGRAMS: Final = [*(f"{name}.py" for name in live_site.LIVE), "orbit_viewer.py"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the site, built with Pyodide in it."""
    for package in ("zensical", "mkdocstrings", "rendercanvas"):
        pytest.importorskip(package)
    require_pyodide()
    from build_site import build

    target = tmp_path_factory.mktemp("documentation") / "site"
    assert build(target, pyodide=PYODIDE) == []
    return target / "site"


@pytest.fixture(scope="module")
def site(folder: Path) -> Iterator[str]:
    with serve(folder) as address:
        yield address


@pytest.fixture(scope="module")
def gallery(site: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """The gallery's page, on SwiftShader."""
    with open_page(tmp_path_factory.mktemp("profile"), *SWIFTSHADER) as page:
        page.open(f"{site}gallery/")
        yield page
        assert page.list_errors() == []


@pytest.fixture
def triangle(gallery: Page) -> LiveProgram:
    """The triangle's program as in its file."""
    program = LiveProgram(gallery, "triangle.py")
    program.open()
    program.click("reset")
    return program


# -- the gallery -------------------------------------------------------------------------------------------


def test_a_page_shows_the_progress_of_its_load(site: str, folder: Path, tmp_path: Path) -> None:
    """At 8 MB a second: the numbers rise to the size that the page said before."""
    with open_page(tmp_path, *SWIFTSHADER) as page:
        page.call("Network.enable")
        page.call(
            "Network.emulateNetworkConditions",
            offline=False,
            latency=0,
            downloadThroughput=8e6,
            uploadThroughput=-1,
        )
        page.open(f"{site}gallery/")
        program = LiveProgram(page, "triangle.py")
        program.open()
        size = program.read("status").partition(" MB")[0].rpartition(" ")[2]
        bar, status = (
            f'{program.element}.querySelector("{part}")' for part in ("progress", ".rhi-live-status")
        )
        page.evaluate(
            "globalThis.steps = []; new MutationObserver(() => "
            f"steps.push([{bar}.hidden ? -1 : {bar}.value, {status}.textContent]))"
            f".observe({status}, {{childList: true}})"
        )
        program.click("run")
        page.wait_for(f'{bar}.value > 0.3 && {status}.textContent.includes(" of ")')
        page.evaluate(f'{program.element}.scrollIntoView({{behavior: "instant", block: "center"}})')
        save_screenshot(page, "progress")
        page.wait_for(f'!["open", "loading"].includes({program.state})')
        steps = page.evaluate("steps")
    loads = [(part, float(text.split(" of ")[0])) for part, text in steps if text.endswith(f" of {size} MB")]
    manifest = json.loads((folder / "live/manifest.json").read_text(encoding="utf-8"))
    total = sum(manifest["files"][name]["bytes"] for name in manifest["core"]) / 1e6
    assert len(loads) > 20
    assert loads == sorted(loads)
    assert loads[-1] == (1, float(size))
    assert abs(float(size) - total) < 0.06


def test_numbers_of_lines_stand_beside_their_lines(triangle: LiveProgram) -> None:
    tops = triangle.page.evaluate(
        f"""(() => {{
            const [gutter, code] = {triangle.element}.querySelectorAll(".rhi-live-editor pre");
            const range = document.createRange();
            const tops = [...gutter.querySelectorAll("span")].map((span) => span.getBoundingClientRect().top);
            const string = code.querySelector("span");
            range.selectNodeContents(string);
            const height = {triangle.element}.querySelector("textarea").getBoundingClientRect().height;
            return [tops[0], range.getBoundingClientRect().top, tops.at(-1) - tops[0], height / tops.length];
        }})()"""
    )
    first, string, all_lines, line_height = tops
    count = len(triangle.text.split("\n"))
    assert abs(first - string) < 2
    assert abs(all_lines - (count - 1) * line_height) < line_height


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_of_the_gallery_draws_its_image(name: str, gallery: Page) -> None:
    """The letters of `text.py` have one size on any canvas, and a viewer has no image: they draw anything at
    all."""
    pytest.importorskip("PIL.Image")
    program = LiveProgram(gallery, name)
    program.open()
    assert program.run("running") == "running", program.read("output")
    drawn = program.drawing(f"live-{name.removesuffix('.py')}")
    program.click("stop")
    image = ROOT / "docs/images/gallery" / f"{name.removesuffix('.py')}.webp"
    assert len({tuple(texel) for texel in drawn.reshape(-1, 3)[::7]}) > 1
    assert name == "text.py" or not image.exists() or mean_difference(drawn, image) < 8


def test_a_stranger_edits_the_colour_of_the_triangle(triangle: LiveProgram) -> None:
    corner = (0.86, 0.14)
    assert triangle.run("running") == "running", triangle.read("output")
    red = triangle.wait_for_texel(corner, lambda texel: texel[0] > 200, "stranger-first")
    triangle.text = triangle.text.replace("(1, 0, 0)", "(0, 1, 1)")
    assert triangle.run("running") == "running", triangle.read("output")
    cyan = triangle.wait_for_texel(corner, lambda texel: texel[2] > 200, "stranger-edited")
    assert red[0] > 200 > red[1:].max(), red
    assert cyan[1:].min() > 200 > cyan[0], cyan


def test_an_error_is_marked_at_its_line_in_the_visible_part_of_the_editor(triangle: LiveProgram) -> None:
    text = triangle.text
    triangle.text = text.replace("vec4(v.color, 1.0)", "vec4(v.colour, 1.0)")
    assert triangle.run() == "failed"
    triangle.page.evaluate(f'{triangle.element}.scrollIntoView({{behavior: "instant", block: "center"}})')
    save_screenshot(triangle.page, "stranger-error")
    assert triangle.read("wrong") == str(line_of(text, "vec4(v.color, 1.0)"))
    assert triangle.page.evaluate(
        f"""(() => {{
            const editor = {triangle.element}.querySelector(".rhi-live-editor").getBoundingClientRect();
            const mark = {triangle.element}.querySelector(".rhi-live-wrong").getBoundingClientRect();
            return editor.top <= mark.top && mark.bottom <= editor.bottom;
        }})()"""
    )


def test_without_webgpu_the_page_keeps_the_image_and_says_why(site: str, tmp_path: Path) -> None:
    with open_page(tmp_path, "--disable-gpu") as page:
        page.open(f"{site}gallery/")
        program = LiveProgram(page, "triangle.py")
        program.open()
        page.evaluate(f'{program.element}.scrollIntoView({{behavior: "instant", block: "center"}})')
        page.wait_for(f"{program.element}.previousElementSibling.querySelector('img').naturalWidth > 0")
        save_screenshot(page, "refused")
        reason = page.evaluate(f"{program.element}.textContent")
    assert reason.startswith(("This browser has no WebGPU", "This browser has WebGPU, but no adapter"))
    assert reason.endswith("The image above is what the program draws.")
