"""`python -m rhi new`: what is written is named, refused in time, and passes its own checks as it is
(nightly)."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import rhi
from rhi.__main__ import main
from rhi.errors import ValidationError
from rhi.testing.projects import KINDS, write_project
from rhi.testing.projects import names as project_names
from rhi.testing.projects.names import describe_fault


@pytest.fixture(scope="module", autouse=True)
def distributions_are_listed_once() -> Iterator[None]:
    """Metadata of all installed distributions is read once for these tests, not for each name."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(project_names, "_list_distributions", cache(project_names._list_distributions))
        yield


@pytest.mark.parametrize("kind", KINDS)
def test_a_project_has_the_requested_name(kind: str, tmp_path: Path) -> None:
    root = write_project(kind, "kite", tmp_path)
    assert sorted(path.name for path in root.iterdir()) == [
        "README.md",
        "kite.py",
        "pyproject.toml",
        "test_kite.py",
    ]
    assert tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["name"] == "kite"
    assert not [path for path in root.iterdir() if "NAME" in path.read_text(encoding="utf-8")]
    assert "from kite import" in (root / "test_kite.py").read_text(encoding="utf-8")


REFUSED = (
    """
two words|Kite|class|numpy|json|../kite||kite.py|kite-1|1kite|_kite|kite_|κite|a b|setup|pytest|conftest|test
tests|test_kite|kite_test|setuptools|pip|wheel|mypy|ruff|pillow|moderngl|glfw|imgui_bundle|rendercanvas|hypothesis|site
sitecustomize|build|dist|noxfile|con|nul|com1|rhi|rhi_screen|renderer|typing_extensions|requests|torch|antigravity|this
""".strip()
    .replace("\n", "|")
    .split("|")
)


@pytest.mark.parametrize("name", [*REFUSED, "k" * 100, "kite\n"])
def test_a_name_that_is_no_modules_or_anothers_is_refused_and_nothing_is_written(
    name: str, tmp_path: Path
) -> None:
    with pytest.raises(ValidationError, match="device-argument"):
        write_project("tool", name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_names_of_all_that_is_installed_are_refused() -> None:
    names = {package for package in packages_distributions() if package.isidentifier() and package.islower()}
    assert [name for name in sorted(names) if not describe_fault(name)] == []
    assert [name for name in sorted(sys.stdlib_module_names) if not describe_fault(name)] == []


@pytest.mark.parametrize(
    "name", ["kite", "k", "kite2", "my_kite", "contest", "setup_kite", "protest", "match"]
)
def test_a_name_that_only_resembles_anothers_is_taken(name: str, tmp_path: Path) -> None:
    assert write_project("tests", name, tmp_path) == tmp_path / name


def test_the_command_writes_a_project_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["new", "tests", "kite", "--folder", str(tmp_path)]
    assert main(arguments) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "kite")
    before = (tmp_path / "kite/kite.py").stat().st_mtime_ns
    assert main(arguments) == 2
    assert "exists" in capsys.readouterr().err
    assert (tmp_path / "kite/kite.py").stat().st_mtime_ns == before


@pytest.mark.nightly
@pytest.mark.parametrize("kind", KINDS)
def test_a_project_passes_its_checks_and_tests(kind: str, tmp_path: Path) -> None:
    if kind != "tests":
        pytest.importorskip("imgui_bundle", reason="no imgui-bundle: pip install rhi[viewer]")
    root = write_project(kind, "kite", tmp_path)
    environment = {**os.environ, "RHI_KERNELS": "quick", "PYTHONPATH": str(Path(rhi.__file__).parents[1])}
    for command in (
        ["pytest", "-q", "--rhi-backend", "gl"],
        ["mypy", "kite.py", "test_kite.py"],
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "."],
    ):
        done = subprocess.run(
            [sys.executable, "-m", *command],
            cwd=root,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert "skipped" not in done.stdout
