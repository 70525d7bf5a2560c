"""Packages of npm for tests: pinned with their hashes in node/package-lock.json, installed in a cache.

`RHI_NODE_PACKAGES` names a folder `node_modules` that has them; else they are in the user's cache. Tests
of the default run only use what is there. Nightly ones install it, if the registry can be reached.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pytest

ENVIRONMENT: Final = "RHI_NODE_PACKAGES"
LOCK_FOLDER: Final = Path(__file__).parent / "node"
_LOCK: Final = LOCK_FOLDER / "package-lock.json"
_MAX_SECONDS: Final = 600


def require_package(name: str, install: bool = False) -> Path:
    """Return the folder `node_modules` that has a package, or skip the test.

    Args:
        install: whether to install the packages if they are missing.
    """
    if shutil.which("node") is None:
        pytest.skip("node isn't installed")
    folder = _package_folder()
    if not _has_pinned(folder, name) and install and ENVIRONMENT not in os.environ:
        _install(folder)
    if not _has_pinned(folder, name):
        version = read_pinned_version(name)
        pytest.skip(
            f"the package {name} {version} of npm isn't installed in {folder}: nightly tests install it"
        )
    return folder


def read_pinned_version(name: str) -> str:
    """Return the version of a package that the lock file names."""
    lock = json.loads(_LOCK.read_text(encoding="utf-8"))
    return str(lock["packages"][f"node_modules/{name}"]["version"])


def run_node(script: str, arguments: Sequence[object], stdin: str = "", seconds: float = _MAX_SECONDS) -> str:
    """Run a script of the folder node/ and return what it prints; fail if it fails."""
    done = subprocess.run(
        ["node", str(LOCK_FOLDER / script), *map(str, arguments)],
        input=stdin,
        capture_output=True,
        text=True,
        encoding="utf-8",
        timeout=seconds,
        check=False,
    )
    assert done.returncode == 0, f"{script}: {done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


def _package_folder() -> Path:
    if ENVIRONMENT in os.environ:
        return Path(os.environ[ENVIRONMENT])
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    digest = hashlib.sha256(_LOCK.read_bytes()).hexdigest()[:12]
    return cache / "rhi-tests" / f"node-{digest}" / "node_modules"


def _has_pinned(folder: Path, name: str) -> bool:
    path = folder / name / "package.json"
    if not path.is_file():
        return False
    return bool(json.loads(path.read_text(encoding="utf-8"))["version"] == read_pinned_version(name))


def _install(folder: Path) -> None:
    """Install the locked packages; npm compares their hashes, and no script of theirs runs."""
    if shutil.which("npm") is None:
        pytest.skip("npm isn't installed")
    folder.parent.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent.parent) as scratch:
        for name in ("package.json", "package-lock.json"):
            shutil.copy(LOCK_FOLDER / name, scratch)
        command = ["npm", "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
        done = subprocess.run(
            command,
            cwd=scratch,
            capture_output=True,
            text=True,
            timeout=_MAX_SECONDS,
            check=False,
            encoding="utf-8",
        )
        if done.returncode:
            pytest.skip(f"npm can't install the packages: {done.stderr.strip()[-300:]}")
        folder.parent.mkdir(exist_ok=True)
        try:
            (Path(scratch) / "node_modules").rename(folder)
        except OSError:  # another process was faster
            assert folder.is_dir()
