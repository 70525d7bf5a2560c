"""`python -m renderer` beside a file of that name: what runs is said, and the commands run ours anywhere."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SCRIPTS: dict[str, str] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"][
    "scripts"
]


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder, with our packages behind it on the path."""
    command = [sys.executable, *arguments]
    return subprocess.run(
        command,
        cwd=folder,
        env={"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )


def write(path: Path, text: str) -> None:
    path.parent.mkdir(exist_ok=True)
    path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("file", ["renderer.py", "renderer/__main__.py"])
def test_a_file_that_runs_in_place_of_the_renderer_is_named(file: str, tmp_path: Path) -> None:
    write(tmp_path / file, "import rhi; print('mine', rhi.Format.R8.name)")
    write(tmp_path / "renderer/__init__.py", "") if "/" in file else None
    done = run(tmp_path, "-m", "renderer")
    assert (done.returncode, done.stdout) == (0, "mine R8\n")
    assert f"python -m renderer runs {tmp_path / file}" in done.stderr
    assert "rhi-renderer" in done.stderr


@pytest.mark.parametrize(
    "arguments", [["renderer.py"], ["-m", "other"], ["-c", "import rhi"], ["-P", "-m", "rhi", "-h"]]
)
def test_other_programs_print_no_warning_about_namesakes(arguments: list[str], tmp_path: Path) -> None:
    write(tmp_path / "renderer.py", "import rhi")
    write(tmp_path / "other.py", "import rhi")
    done = run(tmp_path, *arguments)
    assert (done.returncode, done.stderr) == (0, "")


def test_the_renderer_itself_prints_no_warning_about_namesakes(tmp_path: Path) -> None:
    done = run(tmp_path, "-m", "renderer", "render", "--help")
    assert (done.returncode, done.stderr) == (0, "")


def test_a_file_that_hides_the_interface_from_the_renderer_is_named(tmp_path: Path) -> None:
    write(tmp_path / "rhi.py", "")
    done = run(tmp_path, "-m", "renderer", "--help")
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {tmp_path / 'rhi.py'} hides the package rhi")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "says"), [("rhi", "usage: python -m rhi"), ("rhi-renderer", "usage: python -m renderer")]
)
def test_commands_run_this_project_s_packages_beside_files_of_the_same_names(
    name: str, says: str, tmp_path: Path
) -> None:
    for file in ("rhi.py", "renderer.py"):
        write(tmp_path / "folder" / file, "raise SystemExit('mine')")
    module, _, function = SCRIPTS[name].partition(":")
    script = tmp_path / "bin" / name  # as an installer writes it
    write(script, f"import sys\nfrom {module} import {function}\nsys.exit({function}())\n")
    done = run(tmp_path / "folder", str(script), "--help")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(says)
