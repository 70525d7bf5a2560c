"""A program whose frames are interrupted by Ctrl-C: `python ctrl_c_frames.py BACKEND SEED TIMES warm|cold`.

A frame has a draw, a draw within states, an upload, a dispatch and three reads. A process of its own presses
Ctrl-C once in or soon after each, so that the interpreter's lock doesn't choose the moment. The next frame must
be right.

- `warm`: all programs are built.
- `cold`: each frame builds one: on cl nearly always a compute program, which takes a tenth of the time of one
  that draws. Devices are opened anew. On cl half of the interrupts come in a step of the build that is chosen
  first (`_STEPS`), since most steps are short. At the end another process draws all frames from the cache.

It prints how many interrupts were raised in a frame, how many after it, and how many came in a destructor,
where Python prints them and goes on; before that, for `cold`, the steps in which they came.
"""

from __future__ import annotations

import faulthandler
import random
import signal
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from types import FrameType
from typing import Any, Final, NoReturn

import numpy as np

import rhi
import rhi.shading as sl
from rhi.backends.null import NullBackend
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

_PRESSER: Final = """
import os, signal, sys, time
for line in sys.stdin:
    time.sleep(float(line))
    os.kill(os.getppid(), signal.SIGINT)
"""

_DRAWN: Final = """
from rhi.shading import FullScreen, vec4
class Fresh(FullScreen):
    def fragment(self) -> vec4:
        return vec4({red}.0 / 255.0, {number}.0 * 0.0, 0.0, 1.0)
"""
_COMPUTED: Final = """
from rhi.shading import Shader, Storage, StorageRW, global_id
class Fresh(Shader):
    work_group = (4,)
    source: Storage[float]
    out: StorageRW[float]
    def compute(self) -> None:
        i = global_id().x
        self.out[i] = self.source[i] * {number}.0
"""

_FRAMES_PER_DEVICE: Final = 25
_DRAWN_EACH: Final = 10
"""On cl each nth new program draws; its two kernels take 15 times as long as one that computes."""
_LONGEST_WAIT: Final = 30.0  # seconds, until an interrupt that nobody raises is lost


class Presser:
    """A process that presses Ctrl-C; and the stacks of Python in which it came.

    Attributes:
        came: the stack of each interrupt.
        pressed: how often it was told to press.
    """

    def __init__(self) -> None:
        command = [sys.executable, "-c", _PRESSER]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, text=True, start_new_session=True, encoding="utf-8"
        )
        self.came: list[traceback.StackSummary] = []
        self.pressed = 0
        signal.signal(signal.SIGINT, self._interrupt)

    def _interrupt(self, number: int, frame: FrameType | None) -> NoReturn:
        self.came.append(traceback.StackSummary.extract(traceback.walk_stack(frame), lookup_lines=False))
        raise KeyboardInterrupt

    def press(self, seconds: float) -> None:
        """Press Ctrl-C after this time."""
        assert self._process.stdin is not None
        self.pressed += 1
        print(seconds, file=self._process.stdin, flush=True)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()


class Step:
    """A function, in which the next call presses Ctrl-C if it was asked to.

    Attributes:
        name: the function's name.
        duration: seconds of the latest call that wasn't interrupted.
    """

    def __init__(self, owner: Any, name: str, presser: Presser) -> None:
        self.name, self.duration = name, 1e-3
        self._function: Callable[..., Any] = getattr(owner, name)
        self._presser = presser
        self._presses: random.Random | None = None
        setattr(owner, name, lambda *arguments, **named: self._run(*arguments, **named))

    def press_at_next_call(self, generator: random.Random) -> None:
        """Press Ctrl-C in or soon after the next call."""
        self._presses = generator

    def _run(self, *arguments: Any, **named: Any) -> Any:
        generator, self._presses = self._presses, None
        if generator is not None:
            self._presser.press(generator.uniform(0.0, 1.1 * self.duration))
        began = time.perf_counter()
        result = self._function(*arguments, **named)
        self.duration = time.perf_counter() - began
        return result


def name_step(stack: traceback.StackSummary, steps: dict[str, Step]) -> str:
    """The innermost step in a stack; "elsewhere" if it has none."""
    names = {step.name: name for name, step in steps.items()}
    return next((names[frame.name] for frame in stack if frame.name in names), "elsewhere")


def collect_steps(presser: Presser) -> dict[str, Step]:
    """Return the steps of a build on cl, from the text to the file with its checksums."""
    import pyopencl as cl

    from rhi.backends.cl import builds, cl_context
    from rhi.backends.cl.pocl.kernel_cache import KernelCache

    steps = {
        "open": (rhi, "create_device"),
        "look up": (KernelCache, "find"),
        "compile": (cl_context, "compile_only"),
        "keep code": (KernelCache, "store_code"),
        "link": (cl_context, "build_again"),
        "record": (KernelCache, "record"),
        "load": (builds.Builds, "_make_evictable"),
        "launch": (cl, "enqueue_nd_range_kernel"),
    }
    return {name: Step(*function, presser) for name, function in steps.items()}


class Program:
    """A device, and the frame that it draws."""

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self.red, self.factor = 1, 2
        self.drawn: Any = sl.from_source(_DRAWN.format(number=0, red=1))
        self.computed: Any = sl.from_source(_COMPUTED.format(number=2))
        self.open()

    def open(self) -> None:
        """Open the device."""
        device = rhi.create_device(self.backend)
        if self.backend == "null":
            device.backend_as(NullBackend).run_shaders()
        self.device, self.meshes = device, (device.mesh(rectangle()), device.mesh(3))

    def use_new_program(self, number: int) -> None:
        """Use a program that nobody has built."""
        if self.backend == "cl" and number % _DRAWN_EACH:
            self.factor = 2 + number
            self.computed = sl.from_source(_COMPUTED.format(number=self.factor))
        else:
            self.red = 1 + number % 250
            self.drawn = sl.from_source(_DRAWN.format(number=number, red=self.red))

    def draw(self) -> tuple[Any, Any, Any]:
        """Draw a frame; return what it has drawn, uploaded, and computed."""
        device = self.device
        image, small = (device.texture((size, size), rhi.Format.RGBA8) for size in (16, 8))
        small.write(np.full((8, 8, 4), 7, np.uint8))
        source, out = device.storage(float, np.arange(8, dtype=np.float32)), device.storage(float, 8)
        rectangle_mesh, triangle = self.meshes
        with device.event("frame"), device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(device.program(self.drawn), triangle)
            with device.states(rhi.CullMode.NONE, rhi.Scissor(0, 0, 8, 8)):
                device.draw(device.program(Colored), rectangle_mesh)
        device.dispatch(device.program(self.computed), 2, source=source, out=out)
        results = image.read(), small.read(), out.read()
        for resource in (image, small, source, out):
            resource.destroy()
        device.present()
        return results

    def check(self) -> None:
        """Draw a frame, and see that it is right."""
        image, small, computed = self.draw()
        assert (small == 7).all()
        assert computed.tolist() == [float(self.factor * i) for i in range(8)]
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
    presser = Presser()
    try:
        steps = collect_steps(presser) if is_cold and backend == "cl" else {}
        program = Program(backend)
        program.draw()
        if is_cold:
            program.use_new_program(1)
        longest = measure(program) if is_cold else max(measure(program) for _ in range(9))
        raised = late = lost = 0
        came_in: Counter[str] = Counter()
        for number in range(2, times + 2):
            if is_cold:
                program.use_new_program(number)
            step = generator.choice(list(steps)) if steps and generator.random() < 0.5 else ""
            if is_cold and (step == "open" or number % _FRAMES_PER_DEVICE == 0):
                program.device.close()
                if step != "open":
                    program.open()
            is_drawn, before, pressed = False, len(ignored), presser.pressed
            try:
                if step:
                    steps[step].press_at_next_call(generator)
                else:
                    presser.press(generator.uniform(0.0, 1.1 * longest))
                if program.device.closed:
                    program.open()
                program.draw()
                is_drawn = True
                assert presser.pressed > pressed, f"frame {number} has no step {step!r}"
                end = time.monotonic() + _LONGEST_WAIT
                while len(ignored) == before and time.monotonic() < end:
                    time.sleep(1e-4)
                lost += 1
            except KeyboardInterrupt:
                late, raised = late + is_drawn, raised + (not is_drawn)
            else:
                where = "".join(presser.came[-1].format()) if presser.came else ""
                assert len(ignored) > before, f"the interrupt of frame {number} is lost; it came in\n{where}"
            came_in[name_step(presser.came[-1], steps)] += 1
            if program.device.closed:
                program.open()
            program.check()
    finally:
        presser.close()
    program.device.close()
    if is_cold:
        command = [sys.executable, "-W", "ignore", __file__, backend, str(seed), str(times), "again"]
        subprocess.run(command, check=True, timeout=_LONGEST_WAIT * times)
        print(dict(came_in))
    return raised, late, lost


def draw_again(backend: str, times: int) -> None:
    """Draw the frames of `run` with what it has left in the cache; those of cl build nothing."""
    program = Program(backend)
    for number in range(2, times + 2):
        program.use_new_program(number)
        program.check()
    if backend == "cl":
        from rhi.backends.cl.cl_backend import ClBackend

        assert program.device.backend_as(ClBackend)._builds.built == 0
    program.device.close()


if __name__ == "__main__":
    _, backend, seed, times, cache = sys.argv
    faulthandler.dump_traceback_later(300 + 30 * int(times), exit=True)  # a wedge says its line
    signal.signal(signal.SIGINT, signal.default_int_handler)
    if cache == "again":
        draw_again(backend, int(times))
    else:
        print(*run(backend, int(seed), int(times), is_cold=cache == "cold"))
