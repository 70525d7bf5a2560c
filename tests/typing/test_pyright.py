"""Pyright says of shaders and of the device what mypy says: right use passes, each mistake is refused on its
line.

Pyright and its node come as wheels (`pyright[nodejs]`), without any download. Checking a file takes .2 s, so
mistakes on different lines share one.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import test_device_typing
import test_shading_typing

ROOT = Path(__file__).parents[2]
SUITES: list[Any] = [test_device_typing, test_shading_typing]
Edit = tuple[int, int, int, str]
"""The first and last line of a mistake, where in the text it begins, what is there, and what takes its
place."""


def pack(source: str, mistakes: list[tuple[str, str, str]]) -> list[dict[int, tuple[int, str, str]]]:
    """Return files of mistakes of which no two touch one line: by line, the place, the right text and the
    wrong one."""
    files: list[dict[int, tuple[int, str, str]]] = []
    for old, new, _ in mistakes:
        assert old.count("\n") == new.count("\n")
        at = source.index(old)
        line = source.count("\n", 0, at) + 1
        taken = range(line, line + old.count("\n") + 1)
        for file in files:
            if not any(taken_name in file for taken_name in taken):
                break
        else:
            files.append(file := {})
        file[line] = at, old, new
    return files


def apply(source: str, file: dict[int, tuple[int, str, str]]) -> str:
    for at, old, new in sorted(file.values(), reverse=True):
        source = source[:at] + new + source[at + len(old) :]
    return source


@pytest.fixture(scope="module")
def mistakes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, set[int]]:
    """The lines of errors by file, of the right programs and of those with mistakes, in one run."""
    pytest.importorskip("pyright")
    folder = tmp_path_factory.mktemp("pyright")
    for suite in SUITES:
        source = suite.RIGHT.read_text(encoding="utf-8")
        (folder / suite.RIGHT.name).write_text(source, encoding="utf-8")
        for number, file in enumerate(pack(source, suite.MISTAKES)):
            (folder / f"{suite.__name__}_{number}.py").write_text(apply(source, file), encoding="utf-8")
    (folder / "pyrightconfig.json").write_text(
        json.dumps({"extraPaths": [str(ROOT)], "pythonVersion": "3.11"}), encoding="utf-8"
    )
    environment = os.environ | {"PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    arguments = ["--pythonpath", sys.executable]  # not the first that PATH has, which may lack NumPy
    command = [sys.executable, "-m", "pyright", "--outputjson", "-p", str(folder), *arguments]
    done = subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, encoding="utf-8"
    )
    lines: dict[str, set[int]] = {}
    for row in json.loads(done.stdout)["generalDiagnostics"]:
        if row["severity"] == "error":
            lines.setdefault(Path(row["file"]).name, set()).add(row["range"]["start"]["line"] + 1)
    return lines


@pytest.mark.parametrize("suite", SUITES, ids=lambda suite: suite.__name__)
def test_right_use_passes_pyright(mistakes: dict[str, set[int]], suite: Any) -> None:
    assert suite.RIGHT.name not in mistakes


@pytest.mark.parametrize("suite", SUITES, ids=lambda suite: suite.__name__)
def test_pyright_refuses_every_mistake_on_its_line(
    mistakes: dict[str, set[int]], suite: ModuleType | Any
) -> None:
    files = pack(suite.RIGHT.read_text(encoding="utf-8"), suite.MISTAKES)
    assert sum(map(len, files)) == len(suite.MISTAKES)
    accepted = [
        file[line][2]
        for number, file in enumerate(files)
        for line in file.keys() - mistakes.get(f"{suite.__name__}_{number}.py", set())
    ]
    assert accepted == []
