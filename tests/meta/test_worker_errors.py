"""A test worker that ends says what it wrote to standard error last."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KITS = Path(__file__).parents[1] / "kits"
TESTS = """
import os

def test_one():
    os.write(2, b"words of a test that passed\\n")

def test_two():
    os.write(2, b"last words of a driver\\n")
    {end}
"""


def run(folder: Path, end: str, *options: str) -> str:
    (folder / "test_ends.py").write_text(TESTS.format(end=end), encoding="utf-8")
    plugins = ["-p", "worker_errors", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", "-n", "1", "--max-worker-restart", "0", *plugins, *options]
    done = subprocess.run(
        [*command, "-o", f"pythonpath={KITS}", "test_ends.py"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(KITS)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        encoding="utf-8",
    )
    return done.stdout + done.stderr


@pytest.mark.parametrize("end", ["os.abort()", "os._exit(3)"])
def test_the_last_words_of_a_worker_that_ends_are_printed(tmp_path: Path, end: str) -> None:
    text = run(tmp_path, end)
    assert "last words of a driver" in text
    assert "standard error of gw0" in text
    assert "words of a test that passed" not in text
    assert ("Fatal Python error: Aborted" in text) == (end == "os.abort()")


def test_a_worker_that_lives_prints_only_failures(tmp_path: Path) -> None:
    assert "standard error of" not in run(tmp_path, "pass")
    failed = run(tmp_path, "assert False")
    assert "last words of a driver" in failed  # captured, as without this plugin
    assert "standard error of" not in failed


def test_without_the_plugin_the_words_are_lost(tmp_path: Path) -> None:
    """The control: if pytest prints them itself one day, the plugin isn't needed."""
    assert "last words of a driver" not in run(tmp_path, "os.abort()", "-p", "no:worker_errors")
