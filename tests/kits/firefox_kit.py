"""A page in headless Firefox, driven by WebDriver BiDi: `open_firefox`; WebGPU draws by Mesa's Vulkan."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import pytest
from chromium_kit import TIMEOUT, Page, end_browser

PREFERENCES: Final = {
    "dom.webgpu.enabled": True,
    "gfx.webgpu.ignore-blocklist": True,
    "browser.shell.checkDefaultBrowser": False,
    "app.normandy.enabled": False,
    "datareporting.policy.dataSubmissionEnabled": False,
}
"""On Linux, WebGPU is off by default and blocked for drivers on the processor."""


class FirefoxPage(Page):
    """A page of Firefox. It has no `move_mouse`."""

    def begin(self) -> None:
        """Begin a session, and ask the browser to report what happens in the page."""
        self.call("session.new", capabilities={})
        self.call("session.subscribe", events=["log.entryAdded"])
        tree = self.call("browsingContext.getTree")
        self._context = tree["contexts"][0]["context"]
        size = {"width": 1200, "height": 900}
        self.call("browsingContext.setViewport", context=self._context, viewport=size)

    def evaluate(self, text: str) -> Any:
        """Evaluate JavaScript; return its value."""
        result = self.call(
            "script.evaluate",
            expression=f"(async () => JSON.stringify(await (0, eval)({json.dumps(text)})))()",
            target={"context": self._context},
            awaitPromise=True,
        )
        assert result["type"] == "success", result
        value = result["result"].get("value")
        return None if value is None else json.loads(value)

    def open(self, address: str) -> None:
        """Load a page."""
        self.call("browsingContext.navigate", context=self._context, url=address, wait="complete")

    def list_errors(self) -> list[str]:
        """The exceptions that the page has thrown, and nobody has caught."""
        entries = [each["params"] for each in self.messages if each.get("method") == "log.entryAdded"]
        return [
            entry["text"] for entry in entries if entry["type"] == "javascript" and entry["level"] == "error"
        ]

    def read_png(self) -> bytes:
        """The visible part of the page as a PNG."""
        return base64.b64decode(self.call("browsingContext.captureScreenshot", context=self._context)["data"])


@contextmanager
def open_firefox(profile: Path) -> Iterator[FirefoxPage]:
    """Open Firefox with a page, or skip the test."""
    client = pytest.importorskip("websockets.sync.client", reason='no websockets: pip install "rhi[viewer]"')
    program = shutil.which("firefox-esr") or shutil.which("firefox")
    if program is None:
        pytest.skip("no browser: apt install firefox-esr")
    lines = [f"user_pref({json.dumps(name)}, {json.dumps(value)});\n" for name, value in PREFERENCES.items()]
    (profile / "user.js").write_text("".join(lines), encoding="utf-8")
    environment = {**os.environ, "HOME": str(profile), "XDG_RUNTIME_DIR": str(profile)}
    log_path = profile / "log"
    with log_path.open("wb") as log:
        browser = subprocess.Popen(
            [
                program,
                "--headless",
                "--no-remote",
                "--profile",
                profile,
                "--remote-debugging-port=0",
                "about:blank",
            ],
            stdout=log,
            stderr=log,
            env=environment,
            start_new_session=True,
        )
    try:
        until = time.monotonic() + TIMEOUT
        while not (
            match := re.search(
                r"ws://127\.0\.0\.1:\d+", log_path.read_text(encoding="utf-8", errors="replace")
            )
        ):
            is_starting = browser.poll() is None and time.monotonic() < until
            assert is_starting, log_path.read_text(encoding="utf-8", errors="replace")[-2000:]
            time.sleep(0.1)
        with client.connect(
            f"{match[0]}/session", max_size=None, open_timeout=TIMEOUT, origin=None
        ) as socket:
            page = FirefoxPage(socket)
            yield page
            with suppress(Exception):
                page.call("browser.close")
    finally:
        end_browser(browser)
