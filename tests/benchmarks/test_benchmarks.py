"""Each program of benchmarks/ runs, in its smallest size (nightly). New ones are found by their folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
PROGRAMS: Final = sorted(path.stem for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text())

SMALLEST: Final = {
    "--boxes": "40", "--cold-runs": "1", "--commands": "200", "--draws": "20", "--frames": "2", "--materials": "4",
    "--meshes": "4", "--objects": "20", "--processes": "1", "--queries": "10", "--repeats": "1", "--rounds": "1",
    "--runs": "1", "--scale": "0.001", "--size": "32x18", "--teleports": "1", "--triangles": "1000", "--warm-up": "1",
}  # fmt: skip
"""The options that say how much a program does, with the least that each of them may say."""

OWN: Final[dict[str, tuple[str, ...]]] = {
    "accuracy_scaling": ("--backend", "null", "--knob", "fxaa"),
    "memory": ("--backend", "null"),
    "occlusion": ("--scene", "city:blocks=4"),
    "techniques": ("--scenes", "grid:4"),
    "thesis_tables": ("ground",),
    "two_pass": ("--scene", "city:blocks=4"),
}
"""What programs are given besides: what they can't do without, and smaller scenes."""


def run(name: str, *arguments: str) -> str:
    """Run a program as users do, with kernels that are built quickly; return what it prints."""
    command = [sys.executable, f"benchmarks/{name}.py", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RHI_KERNELS": "quick"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_programs_are_found() -> None:
    assert {"recording", "lanes", "draw_cost"} <= set(PROGRAMS)
    assert "scenes" not in PROGRAMS  # what several of them draw


@pytest.mark.nightly
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_benchmark_runs_in_its_smallest_size(name: str) -> None:
    options = set(re.findall(r"--[a-z-]+", run(name, "--help")))
    small = [part for option in sorted(options & set(SMALLEST)) for part in (option, SMALLEST[option])]
    assert run(name, *OWN.get(name, ()), *small).strip()
