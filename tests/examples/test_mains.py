"""Each example runs as users run it, in its smallest size (nightly). New ones are found by their folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "examples"
COMMANDS: Final = FOLDER / "frame_commands.py"
"""The example that draws nothing: it asserts on commands, on the desk and in a page."""
FILES: Final = sorted(
    path for path in FOLDER.rglob("*.py") if path.parent.name != "rhi_numpy" and path != COMMANDS
)  # their own tests run them
PROGRAMS: Final = [path for path in FILES if '__name__ == "__main__"' in path.read_text(encoding="utf-8")]
SMALL: Final = ("--size", "32x18")
ARGUMENTS: Final[dict[str, tuple[str, ...]]] = {
    "tiled_lights": ("--frames", "2"),
    "film": (*SMALL, "--frames", "2"),
}
"""The arguments of examples that have no option `--size`, or draw many frames."""


def run(path: Path, *arguments: str) -> str:
    """Run a copy of an example in a folder of its own, with kernels that are built quickly; return what it
    prints."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "RHI_KERNELS": "quick"}
    folder = Path(arguments[arguments.index("--output") + 1]).parent
    command = [sys.executable, shutil.copy(path, folder), *arguments]
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_each_example_is_a_program() -> None:
    assert [path.stem for path in FILES if path not in PROGRAMS] == []
    assert {"tiled_lights", "orbit_viewer", "triangle"} <= {path.stem for path in PROGRAMS}


def test_the_example_of_a_frames_commands_fails_if_the_engine_is_broken(tmp_path: Path) -> None:
    text = COMMANDS.read_text(encoding="utf-8")
    broken = text.replace("BlendFunction.ALPHA, DepthWrite.OFF", "BlendFunction.ALPHA")
    outcomes = []
    for number, program in enumerate((text, broken)):
        path = tmp_path / f"{number}.py"
        path.write_text(program, encoding="utf-8")
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            [sys.executable, path],
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
            encoding="utf-8",
        )
        outcomes.append(
            (done.returncode, "all assertions hold" in done.stdout, "AssertionError" in done.stderr)
        )
    assert outcomes == [(0, True, False), (1, False, True)]


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl"])
@pytest.mark.parametrize(
    "path", [path for path in PROGRAMS if path.stem != "orbit_viewer"], ids=lambda path: path.stem
)  # `test_window` opens its window
def test_an_example_draws_in_its_smallest_size(path: Path, backend: str, tmp_path: Path) -> None:
    image_path = tmp_path / ("video.mp4" if path.stem == "film" else "image.png")
    out = run(path, "--backend", backend, "--output", str(image_path), *ARGUMENTS.get(path.stem, SMALL))
    assert str(image_path) in out
    assert image_path.stat().st_size > 0
