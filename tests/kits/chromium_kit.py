"""A page in headless Chromium, driven by its DevTools protocol: `open_page`; WebGPU draws by SwiftShader."""

from __future__ import annotations

import base64
import functools
import http.server
import io
import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final
from urllib.request import urlopen

import numpy as np
import pytest
from numpy.typing import NDArray

FLAGS: Final = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--remote-debugging-port=0",
    "--window-size=1200,900",
)
SWIFTSHADER: Final = (
    "--enable-unsafe-webgpu",
    "--use-angle=swiftshader",
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
)
"""Canvas elements of WebGPU are shown only with all of them."""
TIMEOUT: Final = 120.0


class Page:
    """A page of a browser.

    Attributes:
        timeout: seconds that a call may take.
    """

    def __init__(self, socket: Any) -> None:
        self.timeout = TIMEOUT
        self._socket = socket
        self._latest = 0
        self.messages: list[dict[str, Any]] = []
        self.begin()

    def begin(self) -> None:
        """Ask the browser to report what happens in the page."""
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol; return its result."""
        self._latest += 1
        self._socket.send(json.dumps({"id": self._latest, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=self.timeout))
            if message.get("id") == self._latest:
                assert "error" not in message, message
                return message["result"]
            self.messages.append(message)

    def evaluate(self, text: str) -> Any:
        """Evaluate JavaScript; return its value."""
        result = self.call("Runtime.evaluate", expression=text, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in result, result["exceptionDetails"]
        return result["result"].get("value")

    def wait_for(self, text: str) -> Any:
        """Wait until JavaScript has a true value; return it."""
        until = time.monotonic() + TIMEOUT
        while time.monotonic() < until:
            value = self.evaluate(text)
            if value:
                return value
            time.sleep(0.2)
        pytest.fail(f"waited in vain for {text}; the page says {self.list_errors()}")

    def open(self, address: str) -> None:
        """Load a page."""
        self.call("Page.navigate", url=address)
        self.wait_for('document.readyState === "complete"')

    def list_errors(self) -> list[str]:
        """The exceptions that the page has thrown, and nobody has caught."""
        thrown = [each for each in self.messages if each.get("method") == "Runtime.exceptionThrown"]
        return [json.dumps(each["params"]["exceptionDetails"])[-1500:] for each in thrown]

    def read_png(self) -> bytes:
        """The visible part of the page as a PNG."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def screenshot(self, path: Path | None = None) -> NDArray[np.uint8]:
        """The visible part of the page, (height, width, 3); `path`: also write it there, as PNG."""
        image = pytest.importorskip("PIL.Image")
        data = self.read_png()
        if path is not None:
            path.write_bytes(data)
        return np.asarray(image.open(io.BytesIO(data)).convert("RGB"))

    def move_mouse(self, kind: str, x: float, y: float, **fields: Any) -> None:
        """Send an event of the mouse: "mousePressed", "mouseMoved", "mouseReleased" or "mouseWheel"."""
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **fields)


@contextmanager
def open_page(profile: Path, *flags: str) -> Iterator[Page]:
    """Open a browser with a page, or skip the test."""
    client = pytest.importorskip("websockets.sync.client", reason='no websockets: pip install "rhi[viewer]"')
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("no browser: apt install chromium")
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(profile)}
    with (profile / "log").open("wb") as log:
        browser = subprocess.Popen(
            [program, *FLAGS, *flags, f"--user-data-dir={profile}", "about:blank"],
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        )
    try:
        ports = profile / "DevToolsActivePort"
        until = time.monotonic() + TIMEOUT
        while not (ports.exists() and "\n" in ports.read_text(encoding="utf-8")):
            is_starting = browser.poll() is None and time.monotonic() < until
            assert is_starting, (profile / "log").read_text(encoding="utf-8")[-2000:]
            time.sleep(0.1)
        port = ports.read_text(encoding="utf-8").split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json") as answer:
            tabs = json.load(answer)
        address = next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")
        with client.connect(address, max_size=None, open_timeout=TIMEOUT) as socket:
            page = Page(socket)
            yield page
            with suppress(Exception):
                page.call("Browser.close")
    finally:
        end_browser(browser)


def end_browser(browser: subprocess.Popen[bytes]) -> None:
    """Wait for a browser that has been closed; kill it if it stays."""
    with suppress(subprocess.TimeoutExpired):
        browser.wait(10)
    if browser.poll() is None:
        browser.kill()
        browser.wait()


class _Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *values: Any) -> None:
        pass


@contextmanager
def serve(folder: Path) -> Iterator[str]:
    """Serve a folder's files as `python -m http.server` does; yields its address."""
    handler = functools.partial(_Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
