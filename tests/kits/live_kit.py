"""Live programs of the site, in a page of headless Chromium: opened, edited, run, and their canvases read."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any, Final

import numpy as np
from chromium_kit import Page
from numpy.typing import NDArray
from web_kit import ROOT, run_in_node

sys.path.insert(0, str(ROOT / "scripts"))

import live_site  # noqa: F401

PYODIDE: Final = run_in_node.FOLDER / "pyodide"
SCREENSHOTS: Final = os.environ.get("RHI_LIVE_SCREENSHOTS")
"""A folder to which the tests write their screenshots, to be looked at."""
BACKGROUND: Final = 8
"""An image of more colours than that has something drawn."""
PYTHON_IS_LOADED: Final = "!!globalThis._createPyodideModule"
"""JavaScript: whether the page has loaded Pyodide."""


def save_screenshot(page: Page, name: str) -> None:
    """Write a screenshot of the page, if it has a name and they are asked for."""
    if SCREENSHOTS and name:
        page.screenshot(Path(SCREENSHOTS) / f"{name}.png")


class LiveProgram:
    """A live program of a page, by the name of its file."""

    def __init__(self, page: Page, name: str) -> None:
        self.page = page
        self.name = name
        self.element = f"document.querySelector('.rhi-live[data-program=\"{name}\"]')"

    def open(self) -> None:
        """Press the button that opens the editor."""
        button = f'{self.element}?.querySelector("button")'
        self.page.wait_for(f"!!{self.element}.dataset.state || !!{button}")
        self.page.evaluate(f"{self.element}.dataset.state || {button}.click()")
        self.page.wait_for(f"!!{self.element}.dataset.state")

    @property
    def text(self) -> str:
        return str(self.page.evaluate(f'{self.element}.querySelector("textarea").value'))

    @text.setter
    def text(self, text: str) -> None:
        area = f'{self.element}.querySelector("textarea")'
        self.page.evaluate(f'{area}.value = {json.dumps(text)}; {area}.dispatchEvent(new Event("input"))')

    def click(self, name: str) -> None:
        """Press the button "run", "stop" or "reset"."""
        self.page.evaluate(f'{self.element}.querySelector(".rhi-live-{name}").click()')

    def run(self, *states: str) -> str:
        """Press Run; wait for a state of the program, or for its end."""
        self.page.evaluate(f'{self.element}.dataset.state = "pressed"')
        self.click("run")
        expected_states = json.dumps([*states, "failed", "ended"])
        return str(self.page.wait_for(f"{expected_states}.includes({self.state}) && {self.state}"))

    @property
    def state(self) -> str:
        """JavaScript: the state of the program."""
        return f"{self.element}.dataset.state"

    def read(self, name: str) -> str:
        """The text of a part: "status", "output" or "wrong" (the number of the marked line)."""
        return str(self.page.evaluate(f'{self.element}.querySelector(".rhi-live-{name}").textContent'))

    def canvas(self, name: str = "") -> NDArray[np.int64]:
        """The canvas as the page shows it, (height, width, 3), without 4 pixels of its edge; `name`: of a
        screenshot."""
        canvas = f'{self.element}.querySelector("canvas")'
        self.page.evaluate(f'{canvas}.scrollIntoView({{behavior: "instant", block: "center"}})')
        box = self.page.evaluate(
            f"(({{x, y, width, height}}) => [x, y, width, height])({canvas}.getBoundingClientRect())"
        )
        image = self.page.screenshot(Path(SCREENSHOTS) / f"{name}.png" if SCREENSHOTS and name else None)
        ratio = self.page.evaluate("devicePixelRatio")
        x, y, width, height = (round(ratio * value) for value in box)
        return image[max(y, 0) + 4 : y + height - 4, x + 4 : x + width - 4].astype(np.int64)

    def drawing(self, name: str = "") -> NDArray[np.int64]:
        """The canvas, once it has more than its background."""
        for _ in range(60):
            image = self.canvas()
            if len(np.unique(image.reshape(-1, 3), axis=0)) > BACKGROUND:
                break
            self.page.evaluate("new Promise((resolve) => setTimeout(resolve, 500))")
        return self.canvas(name)

    def wait_for_texel(
        self, position: tuple[float, float], condition: Any, name: str = ""
    ) -> NDArray[np.int64]:
        """A texel of the canvas at fractions of its height and width, once a condition of it holds."""
        for _ in range(60):
            image = self.canvas()
            texel = image[int(position[0] * len(image)), int(position[1] * image.shape[1])]
            if condition(texel):
                break
        save_screenshot(self.page, name)
        return texel


def line_of(text: str, part: str) -> int:
    """The number of the first line that has a part."""
    return next(number for number, line in enumerate(text.splitlines(), 1) if part in line)


def mean_difference(drawn: NDArray[Any], expected: Path) -> float:
    """The mean difference of an image and a file, in 16 × 12 blocks: a page has other pixels."""
    from PIL import Image

    def shrink(image: Image.Image) -> NDArray[np.int64]:
        return np.asarray(image.convert("RGB").resize((16, 12), Image.Resampling.BOX)).astype(np.int64)

    blocks = shrink(Image.fromarray(np.asarray(drawn, np.uint8))), shrink(Image.open(expected))
    return float(np.abs(blocks[0] - blocks[1]).mean())
