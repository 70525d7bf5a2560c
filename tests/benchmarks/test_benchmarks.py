"""Each program of benchmarks/ runs, in its smallest size (nightly). New ones are found by their folder."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
FILES: Final = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "benchmarks").glob("*.py")}
PROGRAMS: Final = sorted(name for name, text in FILES.items() if "__main__" in text)

SMALLEST: Final = {
    "--boxes": "40",
    "--cold-runs": "1",
    "--commands": "200",
    "--draws": "20",
    "--frames": "2",
    "--joints": "2",
    "--largest": "1",
    "--materials": "4",
    "--meshes": "4",
    "--objects": "20",
    "--processes": "1",
    "--queries": "10",
    "--repeats": "1",
    "--rounds": "1",
    "--runs": "1",
    "--scale": "0.001",
    "--side": "8",
    "--size": "32x18",
    "--triangles": "1000",
    "--vertices": "100",
    "--views": "1",
    "--warm-up": "1",
}
"""The options that say how much a program does, with the least that each of them may say."""
FREE: Final = {"--programs", "--seed"}
"""Options with a number that says nothing of how much a program does, or is the least by itself."""

ON_CL: Final = dict.fromkeys(
    ("animation", "command_buffers", "effects", "frame_batch", "occlusion", "shadows", "techniques"),
    ("--backend", "cl"),
)
OWN: Final[dict[str, tuple[str, ...]]] = {
    **ON_CL,
    "engines": ("--only", "gl,cl", "--scene", "city:blocks=2"),
    "equal_error": ("--scene", "city:blocks=2", "--backend", "gl"),
    "growth": ("--backend", "null"),
    "memory": ("--backend", "null"),
    "scaling": ("--backend", "null"),
    "occlusion": (*ON_CL["occlusion"], "--scene", "city:blocks=4"),
    "startup": ("--only", "import,triangle,states"),
    "techniques": (*ON_CL["techniques"], "--scenes", "grid:4"),
    "thesis_tables": ("ground",),
}
"""What programs are given besides: what they can't do without, smaller scenes, and cl where another is the
default."""
TIMES_CL: Final = {
    *ON_CL,
    "backends",
    "emulated_queries",
    "small_programs",
    "small_triangles",
    "software_depth",
    "tessellation",
    "text",
}
"""Programs that say beside each figure which kernels cl ran."""
TEXT: Final = {"thesis_tables"}
"""Programs that print pages, and so no JSON."""


def run(name: str, *arguments: str) -> str:
    """Run a program as users do, with kernels that are built quickly; return what it prints."""
    command = [sys.executable, f"benchmarks/{name}.py", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RHI_KERNELS": "quick"}
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_file_is_a_program_that_the_nightly_test_runs_or_shared_by_them() -> None:
    assert {"recording", "memory", "draw_cost"} <= set(PROGRAMS)
    assert sorted(FILES.keys() - set(PROGRAMS)) == ["scenes"]  # what several of them draw
    assert set(OWN) <= set(PROGRAMS)


@pytest.mark.parametrize("name", PROGRAMS)
def test_a_benchmark_prints_by_the_command_line_of_all(name: str) -> None:
    """So it has `--json` and `--markdown`, and cl runs the kernels of a long run unless it says otherwise."""
    assert ("run_benchmark(" in FILES[name]) is (name not in TEXT)
    assert "argparse.ArgumentParser" not in FILES[name]


@pytest.mark.nightly
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_benchmark_runs_in_its_smallest_size(name: str) -> None:
    text = run(name, "--help")
    options = set(re.findall(r"--[a-z-]+", text))
    assert set(re.findall(r"(--[a-z-]+) N\b", text)) <= SMALLEST.keys() | FREE
    small = [part for option in sorted(options & set(SMALLEST)) for part in (option, SMALLEST[option])]
    out = run(name, *OWN.get(name, ()), *small, *(() if name in TEXT else ("--json",)))
    if name in TEXT:
        assert out.strip()
        return
    rows = json.loads(out)["rows"]
    assert rows
    assert any(row.get("kernels") for row in rows) is (name in TIMES_CL)


def test_starting_up_is_measured_with_the_kernels_of_a_first_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kernel_settings: list[str | None] = []

    def run_none(*_: object, env: dict[str, str], **__: object) -> subprocess.CompletedProcess[str]:
        kernel_settings.append(env.get("RHI_KERNELS"))
        return subprocess.CompletedProcess([], 0, stdout="0.5")

    monkeypatch.setenv("RHI_KERNELS", "optimised")  # and so back to what it was at the end
    monkeypatch.delenv("RHI_KERNELS")
    monkeypatch.setattr(subprocess, "run", run_none)
    monkeypatch.setattr(sys, "argv", ["startup.py", "--only", "import", "--runs", "1", "--json"])
    runpy.run_path(str(ROOT / "benchmarks/startup.py"), run_name="__main__")
    assert [row["seconds"] for row in json.loads(capsys.readouterr().out)["rows"]] == [0.5] * 3
    assert set(kernel_settings) == {""}
