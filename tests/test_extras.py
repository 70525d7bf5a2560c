"""Each extra in a clean environment of its own, from a wheel: its programs run, and the page shows its
image."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser_kit import TIMEOUT, wait_for
from browser_kit import browser as browser
from PIL import Image

ROOT = Path(__file__).parents[1]

pytestmark = [pytest.mark.nightly, pytest.mark.filterwarnings("ignore")]

DRAW = (
    "import rhi; d = rhi.create_device('{}'); "
    "t = d.texture((4, 4), rhi.Format.RGBA8); print(t.read().shape); d.close()"
)
PROGRAMS = {
    "": [["-m", "rhi"], ["-c", DRAW.format("null")], ["-c", DRAW.format("gl")]],
    "renderer": [
        ["-m", "renderer", "render", "hall", "--backend", "cl", "--size", "64x36", "--output", "hall.png"]
    ],
    "spirv": [
        ["-m", "rhi"],
        ["-c", "import shutil, sys, os; sys.exit(not os.path.exists(sys.prefix + '/bin'))"],
    ],
    "wgpu": [["-c", DRAW.format("wgpu")]],
    "images": [["-c", "import PIL, rhi"]],
    "video": [["-c", "import av, rhi"]],
    "flip": [["-c", "import flip_evaluator, rhi"]],
    "imgui": [["-c", "import imgui_bundle, rhi"]],
    "dask": [["-c", "import distributed, rhi"]],
    "cuda": [["-c", "import cuda.core, rhi; cuda.core.GraphicsResource.from_gl_buffer"]],
    "film": [["-c", "import av, distributed, PIL, tqdm, rhi_screen"]],
    "test": [
        ["-m", "pytest", "-q", "--pyargs", "rhi.conformance", "--rhi-backend", "null", "-k", "blending"]
    ],
    "docs": [["-c", "import zensical, mkdocstrings"]],
    "viewer": [
        ["-m", "renderer", "view", "--help"],
        ["-c", "from rhi_screen import open_canvas; open_canvas('page')"],
    ],
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of a copy of the project, so that nothing is left in it."""
    folder = tmp_path_factory.mktemp("wheel")
    leave = shutil.ignore_patterns(".*", "out", "build", "dist", "__pycache__", "*.egg-info")
    shutil.copytree(ROOT, folder / "project", ignore=leave)
    command = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--no-deps",
        "-q",
        "-w",
        str(folder),
        str(folder / "project"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8")
    if done.returncode:
        pytest.skip(f"no wheel can be made here: {done.stderr[-300:]}")
    return next(folder.glob("*.whl"))


def install(wheel: Path, extra: str, folder: Path) -> str:
    """Return the interpreter of a clean environment with the wheel and an extra of it."""
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    python = str(folder / "bin" / "python")
    name = f"{wheel}[{extra}]" if extra else str(wheel)
    done = subprocess.run(
        [python, "-m", "pip", "install", "-q", name],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    if done.returncode and "No matching distribution" not in done.stderr.replace("\n", " "):
        pytest.fail(done.stderr[-2000:])
    if done.returncode:
        pytest.skip("no package index is reached")
    return python


@pytest.mark.parametrize("extra", PROGRAMS)
def test_the_programs_of_an_extra_run(extra: str, wheel: Path, tmp_path: Path) -> None:
    assert set(
        re.findall(
            r"^(\w+) = \[",
            (ROOT / "pyproject.toml").read_text(encoding="utf-8").partition("optional-dep")[2],
            re.M,
        )
    ) >= {name for name in PROGRAMS if name}
    python = install(wheel, extra, tmp_path / "environment")
    for program in PROGRAMS[extra]:
        done = subprocess.run(
            [python, *program], cwd=tmp_path, capture_output=True, text=True, check=False, encoding="utf-8"
        )
        assert done.returncode == 0, (program, done.stdout[-1000:], done.stderr[-2000:])


ATTACK = """\
<script>
const socket = new WebSocket("ws" + decodeURIComponent(location.search.slice(9)))
socket.onopen = () => { document.title = "in" }
socket.onerror = () => { document.title = "out" }
</script>"""


class Attacker(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(ATTACK.encode())

    def log_message(self, *_: object) -> None:
        pass


def test_the_page_of_an_installed_viewer_is_its_users_only(browser: Any, wheel: Path, tmp_path: Path) -> None:
    from selenium.webdriver import ActionChains, Keys

    python = install(wheel, "viewer", tmp_path / "environment")
    command = [
        python,
        "-m",
        "renderer",
        "view",
        "hall",
        "--canvas",
        "page",
        "--size",
        "480x270",
        "--backend",
        "cl",
    ]
    viewer = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, env={**os.environ}, encoding="utf-8"
    )
    attacker = ThreadingHTTPServer(("127.0.0.1", 0), Attacker)
    threading.Thread(target=attacker.serve_forever, daemon=True).start()
    try:
        assert viewer.stderr is not None
        address = next(match[0] for line in viewer.stderr if (match := re.search(r"http\S+", line)))
        for victim in (address, address.rsplit("/", 2)[0] + "/"):
            browser.get(f"http://127.0.0.1:{attacker.server_port}/?url={victim}")
            assert wait_for(lambda: browser.title in ("in", "out") and browser.title, "the attack") == "out"
        browser.get(address)
        element = browser.find_element("css selector", "img")
        wait_for(
            lambda: browser.execute_script("return arguments[0].naturalWidth", element) == 480, "an image"
        )
        assert (element.size["width"], element.size["height"]) == (480, 270)
        wait_for(
            lambda: browser.title.startswith("hall") and "?" not in browser.title, "the title with its rate"
        )

        def look() -> Any:
            with Image.open(io.BytesIO(element.screenshot_as_png)) as image:
                return np.array(image.convert("RGB"))[50:]

        wait_for(lambda: len(np.unique(look().reshape(-1, 3), axis=0)) > 500, "the hall")
        before = look()
        ActionChains(browser).move_to_element(element).click_and_hold().move_by_offset(
            120, 0
        ).release().perform()
        wait_for(lambda: (look() != before).mean() > 0.1, "another image")
        chain = ActionChains(browser).move_to_element(element).click().pause(0.5)
        chain.send_keys(Keys.F2).pause(0.5).send_keys("quit").send_keys(Keys.ENTER).perform()
        assert viewer.wait(TIMEOUT) == 0
    finally:
        viewer.kill()
        viewer.communicate()
        attacker.shutdown()
        attacker.server_close()
