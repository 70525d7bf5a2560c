"""A program whose frames are interrupted by Ctrl-C: `python ctrl_c_frames.py BACKEND SEED TIMES warm|cold`.

A frame has a draw of a program that may be new, a draw within states, an upload, a dispatch and three reads. A
process of its own presses Ctrl-C once in or soon after each, so that the interpreter's lock doesn't choose the
moment. The next frame must be right.

`warm`: all programs are built. `cold`: each frame builds one, and devices are opened anew.

It prints how many interrupts were raised in a frame, how many after it, and how many came in a destructor,
where Python prints them and goes on.
"""

from __future__ import annotations

import faulthandler
import random
import signal
import subprocess
import sys
import time
from typing import Any

import numpy as np

import rhi
import rhi.shading as sl
from rhi.backends.null import NullBackend
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

_PRESSER = """
import os, signal, sys, time
for line in sys.stdin:
    time.sleep(float(line))
    os.kill(os.getppid(), signal.SIGINT)
"""

_SOURCE = """
from rhi.shading import FullScreen, vec4
class Fresh(FullScreen):
    def fragment(self) -> vec4:
        return vec4({red}.0 / 255.0, {number}.0 * 0.0, 0.0, 1.0)
"""

_FRAMES_PER_DEVICE = 25
_LONGEST_WAIT = 30.0  # seconds, until an interrupt that nobody raises is lost


class Double(sl.Shader):
    """Twice the numbers of a buffer."""

    work_group = (4,)
    source: sl.Storage[float]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        self.out[i] = self.source[i] * 2.0


class Program:
    """A device, and the frame that it draws."""

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self.red = 0
        self.use_new_program(0)
        self.open()

    def open(self) -> None:
        """Open the device."""
        self.device = rhi.create_device(self.backend)
        if self.backend == "null":
            self.device.backend_as(NullBackend).run_shaders()
        self.meshes = self.device.mesh(rectangle()), self.device.mesh(3)

    def use_new_program(self, number: int) -> None:
        """Draw with a program that nobody has built."""
        self.red = 1 + number % 250
        self.shader: Any = sl.from_source(_SOURCE.format(number=number, red=self.red), "Fresh")

    def draw(self) -> tuple[Any, Any, Any]:
        """Draw a frame; return what it has drawn, uploaded, and computed."""
        device = self.device
        image, small = (device.texture((size, size), rhi.Format.RGBA8) for size in (16, 8))
        small.write(np.full((8, 8, 4), 7, np.uint8))
        source, out = device.storage(float, np.arange(8, dtype=np.float32)), device.storage(float, 8)
        rectangle_mesh, triangle = self.meshes
        with device.event("frame"), device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(device.program(self.shader), triangle)
            with device.states(rhi.CullMode.NONE, rhi.Scissor(0, 0, 8, 8)):
                device.draw(device.program(Colored), rectangle_mesh)
        device.dispatch(device.program(Double), 2, source=source, out=out)
        results = image.read(), small.read(), out.read()
        for resource in (image, small, source, out):
            resource.destroy()
        device.present()
        return results

    def check(self) -> None:
        """Draw a frame, and see that it is right."""
        image, small, doubled = self.draw()
        assert (small == 7).all()
        assert doubled.tolist() == [2.0 * i for i in range(8)]
        if self.backend != "null":
            assert image[8:, 8:].reshape(-1, 4).tolist() == [[self.red, 0, 0, 255]] * 64
            assert (image[:8, :8] != image[15, 15]).any()


def measure(program: Program) -> float:
    """Seconds that a frame takes."""
    began = time.perf_counter()
    program.draw()
    return time.perf_counter() - began


def run(backend: str, seed: int, times: int, *, is_cold: bool) -> tuple[int, int, int]:
    """Draw frames that Ctrl-C interrupts; return the numbers that are printed."""
    generator, ignored = random.Random(seed), []
    sys.unraisablehook = lambda error: ignored.append(error.exc_type)
    program = Program(backend)
    program.draw()
    if is_cold:
        program.use_new_program(1)
    longest = measure(program) if is_cold else max(measure(program) for _ in range(9))
    raised = late = lost = 0
    command = [sys.executable, "-c", _PRESSER]
    presser = subprocess.Popen(command, stdin=subprocess.PIPE, text=True, start_new_session=True)
    assert presser.stdin is not None
    try:
        for number in range(2, times + 2):
            if is_cold:
                program.use_new_program(number)
                if number % _FRAMES_PER_DEVICE == 0:
                    program.device.close()
                    program.open()
            is_drawn, before = False, len(ignored)
            try:
                print(generator.uniform(0.0, 1.1 * longest), file=presser.stdin, flush=True)
                program.draw()
                is_drawn = True
                end = time.monotonic() + _LONGEST_WAIT
                while len(ignored) == before and time.monotonic() < end:
                    time.sleep(1e-4)
                lost += 1
            except KeyboardInterrupt:
                late, raised = late + is_drawn, raised + (not is_drawn)
            else:
                assert len(ignored) > before, f"the interrupt of frame {number} is lost"
            program.check()
    finally:
        presser.kill()
        presser.wait()
    program.device.close()
    return raised, late, lost


if __name__ == "__main__":
    _, backend, seed, times, cache = sys.argv
    faulthandler.dump_traceback_later(300 + 30 * int(times), exit=True)  # a wedge says its line
    signal.signal(signal.SIGINT, signal.default_int_handler)
    print(*run(backend, int(seed), int(times), is_cold=cache == "cold"))
