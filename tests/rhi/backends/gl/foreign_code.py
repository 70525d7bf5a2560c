"""Runs the conformance kit on gl while other code takes the thread before every line of a test.

`python foreign_code.py [--blind] TESTS…` prints a line of JSON: how often the thread was taken, the number of
tests that passed, and the names of those that failed.

- Outside of passes the device must find its context again by itself. Inside one, it is made current
  explicitly.
- With `--blind` it is kept from finding it: then tests must fail.
- Devices have no validation, so that draws are prepared as in a program.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from types import FrameType
from typing import Any

import moderngl
import pytest

import rhi
import rhi.conformance
from rhi.backends.gl.gl_backend import GlBackend

KIT = Path(rhi.conformance.__file__).parent
EGL: dict[str, Any] = {"backend": "egl", "libgl": "libEGL.so.1", "libegl": "libEGL.so.1"}


class ForeignCode:
    """A pytest plugin that makes a context of its own current before each line of a test."""

    def __init__(self) -> None:
        self.taken = self.passed = 0
        self.failed: list[str] = []
        self._context = moderngl.create_context(450, standalone=True, **EGL)
        self._devices: list[rhi.Device] = []
        self._create: Callable[..., rhi.Device] = rhi.create_device
        rhi.create_device = self._create_device

    def _create_device(self, *arguments: Any, validation: bool = False, **options: Any) -> rhi.Device:
        device = self._create(*arguments, **options)
        self._devices = [opened for opened in self._devices if not opened.closed] + [device]
        return device

    @pytest.hookimpl(wrapper=True)
    def pytest_pyfunc_call(self) -> Generator[None, Any, Any]:
        sys.settrace(self._watch_frame)
        try:
            return (yield)
        finally:
            sys.settrace(None)

    def _watch_frame(self, frame: FrameType, event: str, argument: object) -> Any:
        is_test = Path(frame.f_code.co_filename).name.startswith("test_")
        return self._take_thread if is_test else None

    def _take_thread(self, frame: FrameType, event: str, argument: object) -> Any:
        if event == "line":
            self._context.mglo.__enter__()
            self.taken += 1
            for device in self._devices:
                if not device.closed and device._core.render_pass is not None:
                    device.make_current()
        return self._take_thread

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid.rpartition("::")[2])
        elif report.when == "call" and report.passed:
            self.passed += 1


def main(arguments: list[str]) -> None:
    if "--blind" in arguments:
        arguments.remove("--blind")
        GlBackend.resume = lambda self: False  # type: ignore[method-assign]
    plugin = ForeignCode()
    options = ["-q", "-p", "no:cacheprovider", "-p", "rhi.conformance.plugin", "-c", os.devnull]
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        pytest.main([*options, "--rootdir", str(KIT), "--rhi-backend", "gl", *arguments], [plugin])
    print(json.dumps({"taken": plugin.taken, "passed": plugin.passed, "failed": plugin.failed}))


if __name__ == "__main__":
    main(sys.argv[1:])
