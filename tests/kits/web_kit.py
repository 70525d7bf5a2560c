"""Programs that run in node as in a page, or skips that name what is missing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import run_in_node  # noqa: E402

TIMEOUT = 900.0


def require_pyodide() -> None:
    """Fetch the packages of `run_in_node.py`, Pyodide among them, or skip the test."""
    try:
        run_in_node.fetch()
    except (OSError, SystemExit, subprocess.CalledProcessError) as error:
        pytest.skip(f"packages for node can't be had: {error}")


def require_node(*, gpu: bool = True) -> None:
    """Fetch what programs in node need, or skip the test; without `gpu`, what a page without WebGPU needs."""
    require_pyodide()
    obstacle = run_in_node.find_obstacle(gpu=gpu)
    if obstacle is not None:
        pytest.skip(obstacle)


def run_kit(backend: str, *options: str, gpu: bool = True) -> subprocess.CompletedProcess[str]:
    """Run the conformance kit in node."""
    arguments = ["--tb=short", "-rs", "--pyargs", "rhi.conformance", "--rhi-backend", backend, *options]
    return run_in_node.run(ROOT / "tests" / "kits" / "web_pytest.py", arguments, gpu=gpu, capture=True)


def run_program(
    text: str,
    folder: Path,
    *arguments: str,
    jspi: bool = True,
    gpu: bool = True,
    packages: Sequence[str] = ("numpy",),
) -> str:
    """Run the text of a program in node, assert that it succeeds, and return what it prints."""
    program = folder / "program.py"  # shaders are compiled from files
    program.write_text(text, encoding="utf-8")
    done = run_in_node.run(
        program,
        arguments,
        jspi=jspi,
        gpu=gpu,
        packages=packages,
        folders=[ROOT / "examples" / "programs"],
        capture=True,
        timeout=TIMEOUT,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout
