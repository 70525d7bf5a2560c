"""Pages that replay a trace: their calls of WebGPU, and in a browser the image after each command."""

from __future__ import annotations

import importlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium_kit import SWIFTSHADER, Page, open_page, serve

import rhi
from rhi.errors import DeviceError, ValidationError
from rhi.trace import load, save
from rhi.trace.cli import main
from rhi.trace.page import make_page

ROOT = Path(__file__).parents[3]
SIZE = (200, 150)
PROGRAMS = ("bloom", "curves", "draw_lists", "particles", "picking", "shadow_map", "sprites", "terrain",
            "textured_cube", "triangle")  # fmt: skip
SCREENSHOTS = os.environ.get("RHI_LIVE_SCREENSHOTS")


@pytest.fixture(autouse=True)
def on_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "programs"))


def record(name: str, folder: Path, backend: str = "null") -> Path:
    """The file of a trace of a program of the gallery."""
    with rhi.create_device(backend, record=True) as device:
        device.present(importlib.import_module(name).render(device, SIZE))
        save(device, folder / f"{name}.zip")
    return folder / f"{name}.zip"


def read_data(page: str) -> Any:
    """The data of a page."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


@pytest.mark.parametrize(
    ("name", "backend"), [*((name, "null") for name in PROGRAMS), ("shadow_map", "gl"), ("terrain", "gl")]
)
def test_each_object_is_made_before_it_is_used_and_each_pass_ends(
    name: str, backend: str, tmp_path: Path
) -> None:
    trace = load(record(name, tmp_path, backend), trusted=True)
    data = read_data(make_page(trace))
    existing, open_passes = {1, 2}, set()
    for result, target, method, values in data["calls"]:
        numbers = {int(number) for number in re.findall(r'{"\$": (\d+)}', json.dumps(values))}
        assert {target, *numbers} <= existing, (method, values)
        existing.add(result)
        if method in ("beginRenderPass", "beginComputePass"):
            open_passes.add(result)
        open_passes -= {target} if method == "end" else set()
    assert open_passes == set()
    steps = [calls for _, _, calls, _ in data["commands"]]
    assert len(steps) == len(trace)
    assert steps == sorted(steps)
    draws = [index for index, command in enumerate(trace.stream) if command.op is rhi.Op.DRAW]
    for index in draws:
        methods = [method for _, _, method, _ in data["calls"][steps[index - 1] : steps[index]]]
        assert any(method.startswith("draw") for method in methods)
    assert data["commands"][-1][3] is not None


def test_a_page_needs_a_trusted_file_and_says_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, page = record("triangle", tmp_path), tmp_path / "page.html"
    assert main(["page", str(file), str(page)]) == 2
    assert "[trace-trust]" in capsys.readouterr().err
    assert not page.exists()
    assert main(["page", str(file), str(page), "--trust"]) == 0
    assert capsys.readouterr().out == f"{page}\n"
    assert "createShaderModule" in page.read_text(encoding="utf-8")


def test_text_of_a_trace_is_no_html_of_the_page() -> None:
    with rhi.create_device("null") as device:
        with device.event("</script><script>alert(1)</script>"):
            device.texture((4, 4), rhi.Format.RGBA8, label="<b>")
        page = make_page(device, title="<i>&</i>")
    assert page.count("<script") == 2
    assert "<b>" not in page
    assert "<title>&lt;i&gt;&amp;&lt;/i&gt;</title>" in page
    texts = [text for text, *_ in read_data(page)["commands"]]
    assert any("</script>" in text for text in texts)


def test_a_page_loads_nothing_and_runs_nothing_before_a_click() -> None:
    page = (ROOT / "rhi/trace/replay_page.html").read_text(encoding="utf-8")
    assert "default-src 'none'" in page
    assert not re.search(r"(?<!@)\blocation\b|fetch\(|eval\(|innerHTML|https?:", page)


def test_another_capability_is_refused() -> None:
    with rhi.create_device("null") as device:
        device.texture((4, 4), rhi.Format.R16)
        with pytest.raises(ValidationError, match="trace-capability"):
            make_page(device)


def test_a_command_that_needs_a_read_is_refused_by_its_number() -> None:
    """Fans of indirect draws are lists of triangles in WebGPU, made from the arguments."""
    from rhi.shading import Shader, vec4

    class Fan(Shader):
        def vertex(self) -> vec4:
            return vec4(0.0, 0.0, 0.0, 1.0)

        def fragment(self) -> vec4:
            return vec4(1.0, 1.0, 1.0, 1.0)

    with rhi.create_device("null") as device:
        image, program = device.texture((4, 4), rhi.Format.RGBA8), device.program(Fan)
        record = np.zeros(1, rhi.DRAW_UNINDEXED)
        computed = device.buffer(record)
        device.buffer(record).copy_to(computed)
        draws = rhi.IndirectDraws(computed, 1)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw_indirect(program, device.mesh(4), draws)
        assert "drawIndirect" in make_page(device)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw_indirect(program, device.mesh(4, primitive=rhi.Primitive.TRIANGLE_FAN), draws)
        with pytest.raises(DeviceError, match="trace-page") as caught:
            make_page(device)
    assert "draw_indirect" in caught.value.given


# -- in a browser ----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with open_page(tmp_path_factory.mktemp("profile"), *SWIFTSHADER) as page:
        yield page


def test_a_slider_shows_the_image_after_each_command(browser: Page, tmp_path: Path) -> None:
    """Before the triangle's draw the target is cleared, after it there is the triangle, as on gl."""
    trace = load(record("triangle", tmp_path), trusted=True)
    (tmp_path / "page.html").write_text(make_page(trace, title="triangle"), encoding="utf-8")
    with serve(tmp_path) as address:
        browser.open(f"{address}page.html")
        assert browser.evaluate("document.body.dataset.shown ?? null") is None
        browser.evaluate('document.getElementById("replay").click()')
        last = len(trace) - 1
        browser.wait_for(f'document.body.dataset.shown === "{last}"')
        drawn = read_canvas(browser, "trace-drawn")
        (draw,) = (index for index, command in enumerate(trace.stream) if command.op is rhi.Op.DRAW)
        browser.evaluate(
            f'(() => {{ const slider = document.getElementById("slider"); slider.value = {draw - 1};'
            ' slider.dispatchEvent(new Event("input")); })()'
        )
        browser.wait_for(f'document.body.dataset.shown === "{draw - 1}"')
        cleared = read_canvas(browser, "trace-cleared")
        assert browser.evaluate('document.getElementById("status").className') == ""
    assert len(np.unique(cleared.reshape(-1, 3), axis=0)) == 1
    with rhi.create_device("gl") as device:
        expected = importlib.import_module("triangle").render(device, SIZE).read()[..., :3].astype(int)
    assert drawn.shape == expected.shape
    assert (np.abs(drawn - expected).max(axis=-1) > 1).mean() < 0.002


@pytest.mark.nightly
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_page_shows_the_image_of_gl(name: str, browser: Page, tmp_path: Path) -> None:
    """Edges differ, as SwiftShader's do; nine pixels of ten don't."""
    trace = load(record(name, tmp_path), trusted=True)
    (tmp_path / "page.html").write_text(make_page(trace, title=name), encoding="utf-8")
    with serve(tmp_path) as address:
        browser.open(f"{address}page.html")
        browser.evaluate('document.getElementById("replay").click()')
        browser.wait_for(f'document.body.dataset.shown === "{len(trace) - 1}"')
        assert browser.evaluate('document.getElementById("status").className') == "", browser.evaluate(
            'document.getElementById("status").textContent'
        )
        drawn = read_canvas(browser, f"trace-{name}")
    with rhi.create_device("gl") as device:
        expected = importlib.import_module(name).render(device, SIZE).read()[..., :3].astype(int)
    assert (np.abs(drawn - expected).max(axis=-1) > 3).mean() < 0.1


def read_canvas(page: Page, name: str) -> np.ndarray[Any, Any]:
    """The canvas as the page shows it, (height, width, 3)."""
    x, y, width, height = page.evaluate(
        "(({x, y, width, height}) => [x, y, width, height])"
        '(document.getElementById("canvas").getBoundingClientRect())'
    )
    page.evaluate("new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve)))")
    image = page.screenshot(Path(SCREENSHOTS) / f"{name}.png" if SCREENSHOTS else None)
    return image[round(y) : round(y + height), round(x) : round(x + width)].astype(int)
