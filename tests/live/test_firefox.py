"""The site's live programs in headless Firefox: they draw as in Chromium, are edited, and name errors.

WebGPU draws by Mesa's Vulkan there. `RHI_LIVE_SCREENSHOTS=FOLDER` keeps screenshots.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from chromium_kit import serve
from firefox_kit import FirefoxPage, open_firefox
from live_kit import PYODIDE, LiveProgram, live_site, mean_difference
from web_kit import ROOT, require_pyodide

pytestmark = pytest.mark.nightly

PROGRAMS = [f"{name}.py" for name in live_site.LIVE]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FirefoxPage]:
    """A page with all live programs."""
    require_pyodide()
    folder = tmp_path_factory.mktemp("site")
    live_site.write_live(folder / "live", PYODIDE)
    head = '<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,">'
    elements = "\n".join(live_site.make_element(name) for name in PROGRAMS)
    (folder / "index.html").write_text(live_site.add_script(head + elements, "live/"), encoding="utf-8")
    with serve(folder) as address, open_firefox(tmp_path_factory.mktemp("profile")) as opened:
        opened.open(address)
        if not opened.evaluate("!!navigator.gpu"):
            pytest.skip("this Firefox has no WebGPU")
        yield opened
        assert opened.list_errors() == []


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_program_of_the_gallery_draws_its_image_in_firefox(name: str, page: FirefoxPage) -> None:
    pytest.importorskip("PIL.Image")
    program = LiveProgram(page, name)
    program.open()
    assert program.run("running") == "running", program.read("output")
    drawn = program.drawing(f"firefox-{name.removesuffix('.py')}")
    program.click("stop")
    image = ROOT / "docs/images/gallery" / f"{name.removesuffix('.py')}.webp"
    assert len({tuple(texel) for texel in drawn.reshape(-1, 3)[::7]}) > 1
    assert name == "text.py" or not image.exists() or mean_difference(drawn, image) < 8


def test_the_triangle_is_edited_in_firefox(page: FirefoxPage) -> None:
    program, corner = LiveProgram(page, "triangle.py"), (0.86, 0.14)
    program.open()
    program.click("reset")
    program.text = program.text.replace("(1, 0, 0)", "(0, 1, 1)")
    assert program.run("running") == "running", program.read("output")
    cyan = program.wait_for_texel(corner, lambda texel: texel[2] > 200, "firefox-edited")
    assert cyan[1:].min() > 200 > cyan[0], cyan


def test_an_error_names_its_line_in_firefox(page: FirefoxPage) -> None:
    program = LiveProgram(page, "triangle.py")
    program.open()
    program.click("reset")
    program.text = program.text.replace("vec4(v.color, 1.0)", "vec4(v.colour, 1.0)")
    assert program.run() == "failed"
    assert "colour" in program.read("output")
    program.click("reset")
