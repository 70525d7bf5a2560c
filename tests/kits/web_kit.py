"""Programs that run in node as in a page, or skips that name what is missing."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import run_in_node  # noqa: E402

TIMEOUT = 900.0


def require_node() -> None:
    """Skip the test if programs can't be run in node here."""
    obstacle = run_in_node.find_obstacle()
    if obstacle is not None:
        pytest.skip(obstacle)


def run_program(text: str, folder: Path, *arguments: str, jspi: bool = True, gpu: bool = True) -> str:
    """Run the text of a program in node, assert that it succeeds, and return what it prints."""
    program = folder / "program.py"  # shaders are compiled from files
    program.write_text(text, encoding="utf-8")
    done = run_in_node.run(
        program,
        arguments,
        jspi=jspi,
        gpu=gpu,
        folders=[ROOT / "examples" / "programs"],
        capture=True,
        timeout=TIMEOUT,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout
