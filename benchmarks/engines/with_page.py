"""The city in a page of headless Chromium, on SwiftShader: this renderer in Pyodide (`web`), or three.js.

`page.html` has the programs. three.js loads the file by its `GLTFLoader` and draws by its `WebGPURenderer`. Both
read their image back in the page; only the last one leaves it. Memory is what JavaScript and WebAssembly hold,
after a collection: textures and buffers are in another process.
"""

from __future__ import annotations

import base64
import json
import sys
import zipfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import typing_extensions
from serving import Job, serve

ROOT = Path(__file__).resolve().parents[2]
sys.path += [str(ROOT / "tests" / "kits"), str(ROOT / "scripts")]

import run_in_node  # noqa: E402
from chromium_kit import SWIFTSHADER, Page, open_page  # noqa: E402
from chromium_kit import serve as serve_files  # noqa: E402

LONGEST = 600.0
"""Seconds that a page may take to load Python and the city."""
_opened = ExitStack()


def write_site(folder: Path, model: Path) -> None:
    """Write the files of the page: the libraries, this checkout's packages as an archive, and the model."""
    run_in_node.fetch((*run_in_node.PACKAGES, run_in_node.THREE))
    for name in ("pyodide", "three"):
        (folder / name).symlink_to(run_in_node.FOLDER / name)
    (folder / "model.glb").symlink_to(model)
    (folder / "index.html").symlink_to(Path(__file__).with_name("page.html"))
    with zipfile.ZipFile(folder / "packages.zip", "w") as archive:
        archive.write(Path(__file__).with_name("with_rhi.py"), "with_rhi.py")
        archive.write(typing_extensions.__file__, "typing_extensions.py")
        for package in ("rhi", "rhi_screen", "renderer"):
            for path in sorted((ROOT / package).rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    archive.write(path, path.relative_to(ROOT))


def read_memory(page: Page) -> dict[str, float]:
    """Return the MiB that the page holds: of JavaScript's objects and arrays, and of WebAssembly."""
    page.call("HeapProfiler.collectGarbage")
    usage = page.call("Runtime.getHeapUsage")
    heap = usage["usedSize"] + usage.get("embedderHeapUsedSize", 0)
    wasm = page.evaluate("wasmBytes()")
    arrays = max(0.0, usage.get("backingStorageSize", 0) - wasm)
    return {"heap": heap / 2**20, "arrays": arrays / 2**20, "wasm": wasm / 2**20}


def load(job: Job) -> tuple[str, Callable[[], Any]]:
    folder = Path(_opened.enter_context(TemporaryDirectory()))
    write_site(folder, Path(job["path"]))
    address = _opened.enter_context(serve_files(folder))
    profile = Path(_opened.enter_context(TemporaryDirectory()))
    page = _opened.enter_context(open_page(profile, *SWIFTSHADER))
    page.timeout = LONGEST
    page.open(address)
    device = page.evaluate(f"load({json.dumps(job)})")

    def image() -> Any:
        data = base64.b64decode(page.evaluate("image()"))
        pixels = np.frombuffer(data, np.uint8).reshape(job["height"], job["width"], 4)
        return pixels, read_memory(page)

    def draw() -> Any:
        page.evaluate("frame()")
        return image

    return device, draw


if __name__ == "__main__":
    with _opened:
        serve(load)
