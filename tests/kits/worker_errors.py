"""A pytest plugin: what a test worker wrote to standard error when it ended, printed by the run.

It does the same for the process that runs a night's tests (`supervised_nights`), which names the file.

While a test runs, pytest captures standard error in a file without a name, which vanishes with the worker. So
the messages of drivers that end the process are lost. Here the worker's file has a name, and the controller
prints it when the worker has crashed. pytest's own faulthandler writes to the terminal beside that.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Any, Final

import pytest
from supervised_nights import ERRORS_VARIABLE

_PATH: Final = "rhi_standard_error"
_LIMIT: Final = 20_000
"""Bytes that are printed, the last ones."""
_FOLDER: Final = pytest.StashKey[Path]()


@pytest.hookimpl(optionalhook=True)
def pytest_configure_node(node: Any) -> None:
    """Name the file of a worker that is about to start."""
    folder = node.config.stash.get(_FOLDER, None)
    if folder is None:
        folder = node.config.stash[_FOLDER] = Path(tempfile.mkdtemp(prefix="rhi-workers-"))
    node.workerinput[_PATH] = str(folder / f"{node.gateway.id}.stderr")


def pytest_configure(config: pytest.Config) -> None:
    """In a worker, or a night, give a name to the file in which pytest captures standard error."""
    path = getattr(config, "workerinput", {}).get(_PATH) or os.environ.pop(ERRORS_VARIABLE, "")
    manager = config.pluginmanager.getplugin("capturemanager")
    capturing = getattr(manager, "_global_capturing", None)
    captured = getattr(getattr(capturing, "err", None), "tmpfile", None)
    if not path or captured is None or getattr(capturing.err, "targetfd", None) != 2:
        return  # neither, or standard error goes to the terminal
    captured.flush()
    named = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
    os.dup2(named, captured.fileno())
    os.dup2(named, 2)  # which pytest leads there whenever a test begins
    os.close(named)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object | None) -> None:
    """Print the file of a worker that has crashed, and remove it."""
    path = Path(node.workerinput[_PATH])
    content = path.read_bytes()[-_LIMIT:] if path.exists() else b""
    path.unlink(missing_ok=True)
    reporter = node.config.pluginmanager.getplugin("terminalreporter")
    if error and reporter is not None:
        reporter.ensure_newline()
        reporter.section(f"standard error of {node.gateway.id}, which has ended", sep="-")
        reporter.write(content.decode(errors="replace") or "nothing\n")
        reporter.ensure_newline()


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the empty folder of the files."""
    folder = config.stash.get(_FOLDER, None)
    if folder is not None and folder.exists() and not any(folder.iterdir()):
        folder.rmdir()
