"""The project's first impression: where a change goes, versions and dates, workflows, settings of editors, and
metadata."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
README = (ROOT / "README.md").read_text(encoding="utf-8")
FILE = re.compile(r"`((?:[\w.<>]+/)+[\w<>]+\.\w+)`")


def read_changes() -> dict[str, list[str]]:
    """The named files of each row of the table that says where a change goes."""
    table = CONTRIBUTING.partition("## Where a change goes")[2].partition("\n## ")[0]
    rows = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("| ")][1:]
    return {cells[0].strip(): FILE.findall("|".join(cells[1:])) for cells in rows}


CHANGES = read_changes()


def exists(file: str) -> bool:
    """True if a file exists, or if its name is to be chosen, one beside it."""
    return any(ROOT.glob(file.replace("<name>", "*")))


def test_contributing_says_where_a_dozen_changes_go() -> None:
    assert len(CHANGES) >= 12
    assert [change for change, files in CHANGES.items() if len(set(files)) < 2] == []


@pytest.mark.parametrize("change", CHANGES)
def test_the_files_of_a_change_exist(change: str) -> None:
    assert [file for file in CHANGES[change] if not exists(file)] == []


def test_a_file_that_does_not_exist_is_found() -> None:
    assert not exists("renderer/techniques/technique_table.py")
    assert not exists("renderer/technique/<name>.py")


# -- commands ------------------------------------------------------------------------------------------------


def list_commands(text: str) -> Iterator[list[str]]:
    """The commands in a page's blocks of shell text, as words, without comments and what follows `&&`."""
    for block in re.findall(r"```\n(.*?)```", text, re.DOTALL):
        for line in block.splitlines():
            yield shlex.split(line.partition("&&")[0], comments=True)


def missing_files(words: list[str]) -> list[str]:
    """The paths among the words of a command that don't exist."""
    paths = [
        word for word in words if re.fullmatch(r"(\./)?[\w./-]+(\.(py|sh))|(tests|scripts)/[\w./-]+", word)
    ]
    return [path for path in paths if not (ROOT / path).exists()]


def test_the_commands_of_the_page_name_files_that_exist() -> None:
    commands = list(list_commands(CONTRIBUTING))
    assert len(commands) >= 8
    assert [file for words in commands for file in missing_files(words)] == []
    assert missing_files(["pytest", "tests/rhi/no_such_folder"]) == ["tests/rhi/no_such_folder"]


def test_each_command_of_the_workflow_names_existing_files_and_runs_on_a_system_that_has_it() -> None:
    yaml = pytest.importorskip("yaml")
    jobs = yaml.safe_load((ROOT / ".github/workflows/checks.yml").read_text(encoding="utf-8"))["jobs"]
    commands = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert {"./demo.sh", "./test.sh"} <= set(commands["linux"])
    assert jobs["without-drivers"]["strategy"]["matrix"]["system"] == ["windows-latest", "macos-latest"]
    for job, lines in commands.items():
        for line in lines:
            words = shlex.split(line)
            assert missing_files(words) == []
            if words[0].startswith("./"):
                assert os.access(ROOT / words[0], os.X_OK)
                assert "ubuntu" in jobs[job]["runs-on"], "the two commands are written for Debian's kin"
    (test,) = (line for line in commands["without-drivers"] if "pytest" in line)
    assert {"tests/rhi/backends/null", "tests/rhi/shading", "tests/test_docs.py"} <= set(test.split())


def test_the_checks_before_a_commit_are_those_of_the_test_command() -> None:
    yaml = pytest.importorskip("yaml")
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    tested = (ROOT / "test.sh").read_text(encoding="utf-8")
    for hook in repository["hooks"]:
        words = shlex.split(hook["entry"])
        assert missing_files(words) == []
        assert " ".join(words[:2]) in tested


def test_editors_wrap_lines_where_the_formatters_do() -> None:
    text = (ROOT / ".editorconfig").read_text(encoding="utf-8")
    length = PROJECT["tool"]["ruff"]["line-length"]
    for files in ("*.{py,pyi}", "*.md"):
        assert f"[{files}]\nmax_line_length = {length}\n" in text
    opencl_length = re.search(
        r"^ColumnLimit: (\d+)$", (ROOT / ".clang-format").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert opencl_length is not None
    assert f"[*.cl]\nmax_line_length = {opencl_length[1]}\n" in text


# -- versions and metadata -----------------------------------------------------------------------------------


def test_the_changelog_has_the_version_and_falling_dates() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## (\d+\.\d+\.\d+), (not released yet|\d{4}-\d\d-\d\d)$", text, re.MULTILINE)
    assert len(versions) == len(re.findall(r"^## ", text, re.MULTILINE))
    assert versions[0][0] == PROJECT["project"]["version"]
    dates = [date.fromisoformat(day) for day in re.findall(r"^### (\S+)$", text, re.MULTILINE)]
    assert dates == sorted(dates, reverse=True)
    assert len(dates) >= 1
    assert not (ROOT / "docs/changes.md").exists(), "entries belong in CHANGELOG.md"


def test_a_package_index_finds_the_files_and_images_of_the_readme() -> None:
    sys.path.insert(0, str(ROOT))
    try:
        from setup import link_absolutely
    finally:
        sys.path.remove(str(ROOT))
    home = "https://forge.example/someone/rhi"
    text = link_absolutely(README, home, "0.1.0")
    targets = re.findall(r"\]\(([^)]+)\)", text)
    assert [target for target in targets if not target.startswith("https://")] == []
    assert f"]({home}/raw/v0.1.0/docs/images/city.webp)" in text
    assert f"]({home}/blob/v0.1.0/docs/measurements/performance.md#small-programs)" in text
    assert (
        link_absolutely("[a](#part) [b](https://x.example/y.md)", home, "1")
        == "[a](#part) [b](https://x.example/y.md)"
    )


@pytest.mark.nightly
def test_the_source_distribution_passes_a_part_of_its_own_tests(tmp_path: Path) -> None:
    pytest.importorskip("build")
    command = [sys.executable, "-m", "build", "--sdist", "--outdir", str(tmp_path), str(ROOT)]
    environment = {**os.environ, "RHI_HOME": "https://forge.example/someone/rhi"}
    subprocess.run(command, check=True, capture_output=True, env=environment)
    (archive,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(archive) as packed:
        packed.extractall(tmp_path, filter="data")
    folder = archive.with_name(archive.name.removesuffix(".tar.gz"))
    written = (folder / "PKG-INFO").read_text(encoding="utf-8")
    assert "Project-URL: Changelog, https://forge.example/someone/rhi/blob/" in written
    assert "License-Expression: MIT" in written
    tests = ["tests/test_structure.py", "tests/test_project.py", "tests/test_docs.py", "tests/rhi/contract"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout[-4000:]
    counted = [sys.executable, "scripts/count_lines.py"]
    subprocess.run(counted, cwd=folder, check=True, capture_output=True)
