"""The conformance kit in a page of headless Chromium, on SwiftShader; `web_pytest.py` is its program, as in node."""

from __future__ import annotations

import importlib.util
import json
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final, NamedTuple

from chromium_kit import SWIFTSHADER, Page, open_page, serve
from web_kit import ROOT, require_pyodide, run_in_node

LONGEST: Final = 3600.0
"""Seconds that the whole kit may take."""
PACKAGES: Final = (
    "pytest", "_pytest", "py", "pluggy", "iniconfig", "packaging", "pygments", "typing_extensions", "sortedcontainers",
)  # fmt: skip
"""The packages that pytest and rhi import, of this environment."""
PAGE: Final = """<!doctype html>
<meta charset="utf-8">
<link rel="icon" href="data:,">
<script type="module">
// `run(arguments)` runs the program with them; returns its exit status and what it has printed.
globalThis.run = async (programArguments) => {
  const {loadPyodide} = await import("./pyodide/pyodide.mjs");
  const python = await loadPyodide({indexURL: new URL("pyodide/", location.href).href});
  await python.loadPackage(["numpy"], {messageCallback() {}});
  python.unpackArchive(await (await fetch("packages.zip")).arrayBuffer(), "zip", {extractDir: "/home/pyodide/site"});
  const lines = [];
  python.setStdout({batched: (line) => lines.push(line)});
  python.setStderr({batched: (line) => lines.push(line)});
  python.globals.set("_arguments", python.toPy(programArguments));
  const code = await python.runPythonAsync(`
import sys
sys.path.insert(0, "/home/pyodide/site")
sys.dont_write_bytecode = True
sys.argv = ["web_pytest.py", *_arguments]
_code = 0
try:
    exec(open("/home/pyodide/site/web_pytest.py", encoding="utf-8").read(), {"__name__": "__main__"})
except SystemExit as error:
    _code = error.code
_code`);
  return [code, lines.join("\\n")];
};
</script>
"""


class KitRun(NamedTuple):
    """The exit status of pytest, and what it has printed."""

    status: int
    output: str


def list_files(package: str) -> Iterator[tuple[Path, str]]:
    """Yield the files of an importable package or module, with their names below the folder it is imported from."""
    spec = importlib.util.find_spec(package)
    assert spec is not None, package
    assert spec.origin is not None, package
    if not spec.submodule_search_locations:
        yield Path(spec.origin), Path(spec.origin).name
        return
    folder = Path(spec.origin).parent
    for path in sorted(folder.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            yield path, str(path.relative_to(folder.parent))


def write_page(folder: Path) -> None:
    """Write the page, Pyodide, and an archive of what the kit imports."""
    (folder / "index.html").write_text(PAGE, encoding="utf-8")
    (folder / "pyodide").symlink_to(run_in_node.FOLDER / "pyodide")
    with zipfile.ZipFile(folder / "packages.zip", "w") as archive:
        archive.write(ROOT / "tests" / "kits" / "web_pytest.py", "web_pytest.py")
        for package in (*PACKAGES, "rhi", "rhi_pytest"):
            for path, name in list_files(package):
                archive.write(path, name)
        for package in ("hypothesis", "attrs"):
            for path in sorted((run_in_node.FOLDER / package).rglob("*")):
                if path.is_file() and "__pycache__" not in path.parts:
                    archive.write(path, path.relative_to(run_in_node.FOLDER / package))


@contextmanager
def open_kit(folder: Path) -> Iterator[Page]:
    """Open a page that runs the kit by `run_kit`, or skip the test; `folder` is empty."""
    require_pyodide()
    site, profile = folder / "site", folder / "profile"
    site.mkdir()
    profile.mkdir()
    write_page(site)
    with serve(site) as address, open_page(profile, *SWIFTSHADER) as page:
        page.timeout = LONGEST
        page.open(address)
        yield page


def run_kit(page: Page, *options: str) -> KitRun:
    """Run the conformance kit on the page's WebGPU."""
    arguments: Sequence[str] = ["--tb=short", "-rfs", "--pyargs", *options, "--rhi-backend", "web"]
    status, output = page.evaluate(f"run({json.dumps(arguments)})")
    return KitRun(status, output)
