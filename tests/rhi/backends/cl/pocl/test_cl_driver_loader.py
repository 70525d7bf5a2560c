"""The drivers that are loaded in a thread: with or without it the same devices are found, and nothing of it
stays."""

from __future__ import annotations

import subprocess
import sys
import threading

import pyopencl as cl
import pytest

from rhi.backends.cl import create_backend
from rhi.backends.cl.cl_context import list_devices, open_context
from rhi.backends.cl.pocl import driver_loader
from rhi.backends.cl.pocl.driver_loader import DriverLoader
from rhi.backends.cl.pocl.workers import list_threads

LIBRARY = cl._cl.__file__
FIRST = """
import ctypes, sys
import pyopencl
from rhi.backends.cl.pocl import workers
from rhi.backends.cl.pocl.driver_loader import DriverLoader
from rhi.backends.cl.pocl.workers import list_threads
loading = DriverLoader(pyopencl._cl.__file__)
before = loading.finish()
loaded = "libpocl" in open("/proc/self/maps").read()
devices = pyopencl.get_platforms()[0].get_devices()
print(loaded, len(workers.list_threads() - before), [device.name for device in devices])
"""


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_the_drivers_are_loaded_when_it_has_finished() -> None:
    """The threads that they start aren't counted among those before."""
    if list_devices()[0].platform.name != "Portable Computing Language":
        pytest.skip("another driver")
    output = subprocess.run(
        [sys.executable, "-c", FIRST], capture_output=True, text=True, check=True, encoding="utf-8"
    ).stdout
    loaded, started, name = output.split(" ", 2)
    assert loaded == "True"
    assert int(started) in (0, list_devices()[0].max_compute_units)
    assert list_devices()[0].name in name


@pytest.mark.parametrize("library", ["missing.so", __file__])
def test_a_library_that_cannot_be_asked_changes_nothing(library: str) -> None:
    assert open_context(DriverLoader(library)).device in list_devices()


def test_without_another_thread_they_are_loaded_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def fail(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", fail)
    monkeypatch.setattr(driver_loader, "_load", asked.append)
    loading = DriverLoader(LIBRARY)
    assert asked == [LIBRARY]
    assert loading.finish() == list_threads()


def test_no_thread_of_it_is_left() -> None:
    backend = create_backend()
    assert not [thread for thread in threading.enumerate() if thread.name == "rhi drivers"]
    backend.close()
