"""The conformance kit in a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def take_the_kit(backend: str, folder: Path, *groups: str, **environment: str) -> tuple[int, str]:
    """Run groups of the kit for a backend whose module is in a folder; return the exit status and the
    output."""
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-q",
        "--color=no",
        "--rhi-backend",
        backend,
        "--pyargs",
        *groups,
    ]
    paths = os.pathsep.join([str(folder), *filter(None, sys.path)])
    run = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths, "PYTEST_ADDOPTS": "", **environment},
        encoding="utf-8",
    )
    assert run.returncode in (0, 1), run.stdout + run.stderr
    return run.returncode, run.stdout
