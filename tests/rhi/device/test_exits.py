"""Processes that end while a daemon thread draws: they end as others do, and print nothing."""

from __future__ import annotations

import subprocess
import sys

import pytest
from nightly_reasons import CHEAPER_TEST

PROGRAM = """
import logging, sys, threading, time
import rhi
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import rectangle
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)  # else a slow machine says that it builds kernels

backend, wait = sys.argv[1], float(sys.argv[2])
begun = threading.Event()

def draw():
    if not wait:
        begun.set()
    device = rhi.create_device(backend)
    image = device.texture((64, 64), rhi.Format.RGBA8)
    mesh, program = device.mesh(rectangle()), device.program(FlatColored)
    while True:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            for _ in range(20):
                device.draw(program, mesh)
        image.read()
        begun.set()

threading.Thread(target=draw, daemon=True).start()
begun.wait()
time.sleep(0.02 if not wait else wait)
"""


@pytest.mark.nightly_cases("cl-0.05_0", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("backend", "wait"),
    [("cl", 0.0), ("cl", 0.05), ("null", 0.05)]
    + [pytest.param("gl", wait, marks=pytest.mark.nightly) for wait in (0.0, 0.05)]
    + [pytest.param("cl", 0.01 * number, marks=pytest.mark.nightly) for number in range(2, 20)],
)
def test_a_daemon_thread_that_draws_does_not_end_the_process_otherwise(backend: str, wait: float) -> None:
    command = [sys.executable, "-c", PROGRAM, backend, str(wait)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8")
    assert (done.returncode, done.stderr) == (0, "")
