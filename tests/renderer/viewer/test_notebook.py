"""The widget in a notebook, in a browser without a display: it shows the image, and is dragged and clicked.

It needs `pip install jupyterlab selenium` and `apt install chromium chromium-driver`.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from browser_kit import browser as browser
from browser_kit import wait_for
from numpy.typing import NDArray
from PIL import Image

from tests.renderer.conftest import open_device

webdriver = pytest.importorskip("selenium.webdriver", reason="no selenium: pip install selenium")
pytest.importorskip("jupyter_rfb", reason="no jupyter_rfb: pip install jupyter_rfb")

pytestmark = [pytest.mark.nightly, pytest.mark.filterwarnings("ignore")]

SIZE = (480, 270)
SHOW = f"""\
import renderer, notes
widget = renderer.view("city:blocks=6", size={SIZE})
notes.take(widget)
widget"""
NOTES = """\
import gc, json
from renderer.viewer import Viewer

def take(widget):
    '''Write what the viewer says after each event.'''
    session = next(each for each in gc.get_objects() if isinstance(each, Viewer)).session

    def note(event):
        if event["event_type"] not in ("pointer_up", "key_down"):
            return
        forward = session.camera.forward.tolist()
        report = dict(kind=event["event_type"], forward=forward, hit_lines=session.hit_lines)
        with open("seen.jsonl", "a") as file:
            print(json.dumps(report | dict(technique=session.display.technique)), file=file)

    widget.add_event_handler(note, "*", order=9)  # after the viewer
"""


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def answers(url: str) -> bool:
    try:
        with urlopen(url, timeout=5):
            return True
    except OSError:
        return False


@pytest.fixture(scope="module", params=["cl", "gl"])
def backend(request: pytest.FixtureRequest) -> str:
    with open_device(request.param) as device:
        return device.backend_name


@pytest.fixture
def notebook(tmp_path: Path, backend: str) -> Iterator[str]:
    """The address of a notebook that shows a scene, in a server of its own."""
    if importlib.util.find_spec("jupyterlab") is None:
        pytest.skip("no JupyterLab: pip install jupyterlab")
    cell = {
        "cell_type": "code",
        "execution_count": None,
        "metadata": {},
        "outputs": [],
        "source": SHOW,
        "id": "show",
    }
    kernel = {"name": "python3", "display_name": "Python", "language": "python"}
    notebook = {"cells": [cell], "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    (tmp_path / "view.ipynb").write_text(json.dumps(notebook), encoding="utf-8")
    (tmp_path / "notes.py").write_text(NOTES, encoding="utf-8")
    settings = tmp_path / "lab" / "@jupyterlab" / "apputils-extension"
    settings.mkdir(parents=True)
    (settings / "notification.jupyterlab-settings").write_text('{"fetchNews": "false"}', encoding="utf-8")
    port = free_port()
    command = [
        sys.executable,
        "-m",
        "jupyterlab",
        "--no-browser",
        "--allow-root",
        f"--ServerApp.port={port}",
        "--ServerApp.port_retries=0",
        "--IdentityProvider.token=",
        f"--ServerApp.root_dir={tmp_path}",
    ]
    paths = {"JUPYTER_CONFIG_DIR": tmp_path / "config", "JUPYTER_RUNTIME_DIR": tmp_path / "run"}
    paths |= {"IPYTHONDIR": tmp_path / "ipython", "JUPYTERLAB_SETTINGS_DIR": tmp_path / "lab"}
    environment = os.environ | {name: str(path) for name, path in paths.items()} | {"RHI_BACKEND": backend}
    environment = {
        name: value for name, value in environment.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")
    }
    with (tmp_path / "server.log").open("w", encoding="utf-8") as log:
        server = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=log, stderr=log)
    try:
        wait_for(lambda: answers(f"http://127.0.0.1:{port}/api"), "the server")
        yield f"http://127.0.0.1:{port}/lab/tree/view.ipynb?reset"
    finally:
        server.terminate()
        server.wait()


def look(widget: Any) -> NDArray[np.uint8]:
    """Return the pixels of an element, as the browser shows it, without the counter."""
    with Image.open(io.BytesIO(widget.screenshot_as_png)) as image:
        return np.array(image.convert("RGB"))[50:]


def count_colors(widget: Any) -> int:
    return len(np.unique(look(widget).reshape(-1, 3), axis=0))


def test_the_widget_is_controlled_by_drags_clicks_and_keys(
    browser: Any, notebook: str, tmp_path: Path
) -> None:
    def seen(kind: str) -> list[Any]:
        path = tmp_path / "seen.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [event for event in map(json.loads, lines) if event["kind"] == kind]

    def find_widget() -> Any:
        for button in browser.find_elements("css selector", ".jp-Dialog .jp-mod-accept"):
            button.click()  # asks for the kernel if that wasn't connected yet
        elements = browser.find_elements(
            "css selector", ".jp-OutputArea-output img, .jp-OutputArea-output canvas"
        )
        return next(
            (element for element in elements if count_colors(element) > 500), None
        )  # before, it is plain

    def click_cell() -> bool:
        cells = browser.find_elements("css selector", ".jp-Cell .cm-content")
        for cell in cells[:1]:
            cell.click()
        return bool(cells)

    browser.get(notebook)
    wait_for(lambda: "Idle" in browser.page_source, "the kernel")
    wait_for(click_cell, "the notebook")
    webdriver.ActionChains(browser).key_down(webdriver.Keys.SHIFT).send_keys(webdriver.Keys.ENTER).key_up(
        webdriver.Keys.SHIFT
    ).perform()
    widget = wait_for(find_widget, "the image")
    before = look(widget)

    webdriver.ActionChains(browser).move_to_element(widget).click_and_hold().move_by_offset(
        120, 0
    ).release().perform()
    dragged = wait_for(lambda: seen("pointer_up"), "the end of the drag")[-1]
    wait_for(lambda: (look(widget) != before).mean() > 0.1, "another image")
    after = look(widget)

    webdriver.ActionChains(browser).move_to_element_with_offset(widget, 0, 60).click().perform()
    clicked = wait_for(lambda: seen("pointer_up")[1:], "the click")[-1]
    wait_for(lambda: (look(widget) != after).any(), "the outline of what was picked")
    assert clicked["forward"] == dragged["forward"]
    assert "m away" in clicked["hit_lines"][0]

    webdriver.ActionChains(browser).send_keys("t").perform()
    wait_for(lambda: [event for event in seen("key_down") if event["technique"] != "forward"], "the key")
    turned = np.degrees(np.arccos(np.clip(np.dot(dragged["forward"], clicked["forward"]), -1, 1)))
    assert turned < 0.1
    folder = os.environ.get("RHI_SCREENSHOTS")
    if folder:
        browser.save_screenshot(str(Path(folder) / "notebook.png"))
