"""A pytest plugin: test workers rewrite the assertions of different files of tests, and not all of the same.

pytest rewrites a file once and keeps the result beside its bytecode. Workers that begin together in a fresh
clone come to each file at the same time, so all of them rewrite all files: 17 s of processor time each. Here
each worker first rewrites its part.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import pytest
from _pytest.assertion import rewrite

_FOLDERS: Final = ("tests", "rhi/conformance")


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """In one of several workers that collect all tests, rewrite its part of the files."""
    worker = getattr(session.config, "workerinput", None)
    root = session.config.rootpath
    if worker is None or sys.dont_write_bytecode or not is_whole_run(session.config.args, root):
        return
    number, count = int(worker["workerid"].removeprefix("gw")), int(worker["workercount"])
    rewrite_files(session.config, list_files(root)[number::count])


def is_whole_run(arguments: Sequence[str], root: Path) -> bool:
    """Return whether the arguments of pytest name the whole folder of tests."""
    return any(Path(root, argument) == root / "tests" for argument in arguments)


def list_files(root: Path) -> list[Path]:
    """Return the files of tests, in the same order in each worker."""
    return sorted(path for folder in _FOLDERS for path in (root / folder).rglob("test_*.py"))


def rewrite_files(config: pytest.Config, paths: Iterable[Path]) -> int:
    """Rewrite files that aren't yet, and write what pytest looks for; return their number.

    A file that can't be parsed is left to pytest, which reports it.
    """
    state: Any = config.stash[rewrite.assertstate_key]
    count = 0
    for path in paths:
        folder = rewrite.get_cache_dir(path)
        target = folder / (path.name.removesuffix(".py") + rewrite.PYC_TAIL)
        if not rewrite.try_makedirs(folder):
            return count
        if rewrite._read_pyc(path, target, state.trace) is not None:
            continue
        try:
            source_hash, code = rewrite._rewrite_test(path, config)
        except (SyntaxError, ValueError):
            continue
        count += rewrite._write_pyc(state, code, source_hash, target)
    return count
