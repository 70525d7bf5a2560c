"""The line that says which kernels a program waits for: once, in time, and silent where nobody wants it."""

from __future__ import annotations

import io
import logging
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyopencl as cl
import pytest

from rhi.backends.cl import build_progress
from rhi.backends.cl.build_progress import LOGGER, LONG_WAIT, BuildProgress
from rhi.conformance.waiting import wait_until


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def progress() -> Iterator[BuildProgress]:
    progress = BuildProgress(lambda: (2, 7))
    yield progress
    progress.close()


def open_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Make standard error a terminal, to which no handler of the logger writes."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(LOGGER, "propagate", False)  # in the test: pytest adds handlers after fixtures
    return terminal


def test_a_long_wait_is_a_warning_and_each_four_times_as_long_another(
    caplog: pytest.LogCaptureFixture, progress: BuildProgress
) -> None:
    counts = []
    for seconds in (0.9, 0.2, 2.0, 1.0, 30.0, 1.0):
        progress.add(LONG_WAIT * seconds)
        counts.append(len(caplog.records))
    assert counts == [0, 1, 1, 2, 3, 3]
    assert {record.levelname for record in caplog.records} == {"WARNING"}
    assert "2 of 7 so far" in caplog.messages[-1]
    assert "waited 34.1 s" in caplog.messages[-1]


def test_the_warning_appears_during_the_wait_and_names_the_kernels(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, progress: BuildProgress
) -> None:
    monkeypatch.setattr(build_progress, "_STEP", 0.001)
    progress.waited = LONG_WAIT
    with progress.waiting("set_up, scatter"):
        assert wait_until(lambda: bool(caplog.records))
    assert "now set_up, scatter" in caplog.messages[0]


def test_quick_builds_show_nothing_and_their_thread_ends(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch, progress: BuildProgress
) -> None:
    monkeypatch.setattr(build_progress, "_STEP", 0.001)
    monkeypatch.setattr(build_progress, "IDLE", 0.01)
    for _ in range(2):
        with progress.waiting("raster"):
            assert progress._thread is not None
        assert wait_until(lambda: progress._thread is None)
    assert progress.waited < LONG_WAIT
    assert not caplog.records


def test_time_between_builds_is_no_wait(monkeypatch: pytest.MonkeyPatch, progress: BuildProgress) -> None:
    monkeypatch.setattr(build_progress, "_STEP", 0.001)
    with progress.waiting("raster"):
        time.sleep(0.01)
    time.sleep(0.01)
    waited = progress.waited
    time.sleep(0.1)
    assert progress.waited == waited
    assert waited > 0


def test_a_launch_is_a_wait_until_it_has_ended(
    monkeypatch: pytest.MonkeyPatch, progress: BuildProgress
) -> None:
    monkeypatch.setattr(build_progress, "_STEP", 0.001)
    event: Any = SimpleNamespace(status=3)
    event.get_info = lambda _: event.status
    progress.note_launch("raster", event)
    assert not progress._is_busy()  # nothing was built before
    with progress.waiting("stage"):
        progress.note_launch("raster", event)
    assert progress._is_busy()
    event.status = cl.command_execution_status.COMPLETE
    assert not progress._is_busy()
    assert not progress._is_busy()
    assert progress._latest == "raster"


@pytest.mark.parametrize("off", ["level", "disabled"])
def test_a_silent_logger_shows_nothing(
    monkeypatch: pytest.MonkeyPatch, progress: BuildProgress, off: str
) -> None:
    terminal = open_terminal(monkeypatch)
    try:
        if off == "level":
            monkeypatch.setattr(LOGGER, "level", logging.ERROR)
            LOGGER.manager._clear_cache()  # type: ignore[attr-defined]
        else:
            logging.disable(logging.CRITICAL)
        progress.add(100.0)
        assert not terminal.getvalue()
    finally:
        monkeypatch.undo()
        logging.disable(logging.NOTSET)
        LOGGER.manager._clear_cache()  # type: ignore[attr-defined]


def test_a_terminal_gets_a_bar_which_vanishes(
    monkeypatch: pytest.MonkeyPatch, progress: BuildProgress
) -> None:
    terminal = open_terminal(monkeypatch)
    pytest.importorskip("tqdm")
    progress._latest = "raster"
    progress.add(0.9 * LONG_WAIT)
    assert not terminal.getvalue()
    progress.add(0.2 * LONG_WAIT)
    assert "2/7" in terminal.getvalue()
    assert "raster" in terminal.getvalue()
    assert "\n" not in terminal.getvalue()
    progress._hide()
    assert terminal.getvalue().rstrip("\r").endswith(" ")


@pytest.mark.parametrize("missing", ["tqdm", "terminal"])
def test_without_tqdm_or_a_terminal_there_is_one_line(
    monkeypatch: pytest.MonkeyPatch, progress: BuildProgress, missing: str
) -> None:
    terminal = open_terminal(monkeypatch)
    if missing == "tqdm":
        monkeypatch.setitem(sys.modules, "tqdm", None)
    else:
        monkeypatch.setattr(terminal, "isatty", lambda: False)
    progress.add(LONG_WAIT)
    progress.add(0.1)
    assert terminal.getvalue().count("\n") == 1
    assert terminal.getvalue().startswith("OpenCL kernels are being built: 2 of 7 so far")


CHILD = """
import sys
import logging
import numpy as np
import rhi
from rhi.backends.cl import build_progress
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
build_progress.LONG_WAIT = float(sys.argv[1])
if "silent" in sys.argv:
    logging.getLogger("rhi.kernels").setLevel(logging.ERROR)
with rhi.create_device("cl") as device:
    image = device.texture((8, 8), rhi.Format.RGBA8)
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(Colored), device.mesh(rectangle()))
    assert image.read().any()
"""


@pytest.mark.parametrize(("seconds", "mode", "lines"), [(0.05, "", 1), (0.05, "silent", 0), (600.0, "", 0)])
def test_a_first_frame_says_once_that_it_builds_kernels(
    tmp_path: Path, seconds: float, mode: str, lines: int
) -> None:
    variables = {"RHI_CACHE": str(tmp_path / "kernels"), "PYTHONPATH": os.pathsep.join(sys.path)}
    script = tmp_path / "first_frame.py"
    script.write_text(CHILD, encoding="utf-8")
    done = subprocess.run(
        [sys.executable, str(script), str(seconds), mode],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env=os.environ | variables,
        check=True,
    )
    printed = done.stderr.splitlines()
    assert len(printed) >= lines if lines else not printed
    assert all(line.startswith("OpenCL kernels are being built") for line in printed)
