"""Signals other than Ctrl-C: handlers that raise, such as those of timeouts, end neither process nor
device."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import ctrl_c_frames
import pytest

import rhi
from rhi.contract import interrupts
from rhi.contract.interrupts import DeferredInterrupts, DeferredSignals

SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGALRM, signal.SIGHUP, signal.SIGUSR1, signal.SIGUSR2]
OTHERS = [signal.SIGVTALRM, signal.SIGPROF, signal.SIGWINCH, signal.SIGCHLD, signal.SIGRTMIN]


class ArrivedError(Exception):
    """The exception that the handlers of these tests raise."""


def come(number: int, frame: Any) -> None:
    raise ArrivedError(signal.Signals(number).name)


@pytest.fixture(params=[*SIGNALS, *OTHERS], ids=lambda number: number.name)
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    """A signal whose handler raises `ArrivedError`."""
    before = signal.signal(request.param, come)
    yield request.param
    signal.signal(request.param, before)


@pytest.mark.parametrize("kind", [DeferredInterrupts, DeferredSignals])
def test_a_signal_waits_for_the_end_of_a_block(
    number: signal.Signals, kind: type[DeferredInterrupts]
) -> None:
    if kind is DeferredInterrupts and number in OTHERS:
        pytest.skip("the quick block holds the usual signals")
    done = []
    with pytest.raises(ArrivedError, match=number.name), kind():
        signal.raise_signal(number)
        done.append(1)
    assert done == [1]
    assert signal.getsignal(number) is come


def test_the_usual_signals_are_raised_at_once_if_they_come_twice(number: signal.Signals) -> None:
    done = []
    with pytest.raises(ArrivedError), DeferredInterrupts():
        signal.raise_signal(number)
        signal.raise_signal(number)
        done.append(1)
    assert done == []


def test_all_signals_wait_however_often_they_come(number: signal.Signals) -> None:
    done = []
    with pytest.raises(ArrivedError), DeferredSignals():
        for _ in range(5):
            signal.raise_signal(number)
        done.append(1)
    assert done == [1]


def test_blocks_inside_each_other_raise_once_at_the_outer_end(number: signal.Signals) -> None:
    steps = []
    with pytest.raises(ArrivedError), DeferredInterrupts():
        with DeferredSignals():
            signal.raise_signal(number)
            steps.append("inner")
        if number in SIGNALS:
            steps.append("outer")
    assert steps == (["inner", "outer"] if number in SIGNALS else ["inner"])


def test_handlers_that_return_are_called_as_often_as_their_signals_came() -> None:
    calls: list[int] = []
    before = [signal.signal(n, lambda number, frame: calls.append(number)) for n in SIGNALS]
    try:
        with DeferredSignals():
            for number in [*SIGNALS, SIGNALS[2], SIGNALS[2]]:
                signal.raise_signal(number)
            assert calls == []
        assert calls == [*SIGNALS, SIGNALS[2], SIGNALS[2]]
    finally:
        for number, handler in zip(SIGNALS, before, strict=True):
            signal.signal(number, handler)


# Each Python function that moderngl calls from C sends the process a signal first.
_LINKED = """
import os, signal, sys
import _moderngl
import rhi
from rhi.conformance.shaders import Colored, Count, Tinted

number = getattr(signal, sys.argv[1])

class Late(Exception): ...

def late(*_):
    raise Late

sent = []
def disturb(name):
    function = getattr(_moderngl, name)
    def disturbed(*arguments):
        sent.append(name)
        os.kill(os.getpid(), number)
        return function(*arguments)
    setattr(_moderngl, name, disturbed)

for name in [name for name in dir(_moderngl) if name.startswith("make_")]:
    disturb(name)
signal.signal(number, late)
with rhi.create_device("gl") as device:
    raised = 0
    for shader in (Colored, Tinted, Count):
        try:
            device.program(shader)
        except Late:
            raised += 1
    signal.signal(number, signal.SIG_IGN)
    for shader in (Colored, Tinted, Count):
        device.program(shader)
print(raised, len(sent) > 6)
"""


@pytest.mark.parametrize("number", [signal.SIGALRM, signal.SIGTERM, signal.SIGINT, signal.SIGPROF])
def test_a_signal_inside_moderngl_raises_after_the_call(number: signal.Signals) -> None:
    command = [sys.executable, "-c", _LINKED, number.name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8")
    assert (done.returncode, done.stdout.split()) == (0, ["3", "True"]), done.stderr[-2000:]


_TIMED = """
import faulthandler, random, signal, sys, time
import numpy as np
import rhi
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

class Late(Exception): ...

def late(*_):
    raise Late

backend, seed, times = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
faulthandler.dump_traceback_later(60 + times, exit=True)  # a wedge is told with its line
generator = random.Random(seed)
signal.signal(signal.SIGALRM, late)
came = 0
with rhi.create_device(backend) as device:
    mesh = device.mesh(rectangle())

    def frame():
        image = device.texture((16, 16), rhi.Format.RGBA8)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(device.program(Colored), mesh)
        texels = image.read()
        image.destroy()
        device.present()
        return texels

    expected = frame()
    began = time.perf_counter()
    frame()
    longest = min(time.perf_counter() - began, 4e-3)  # so that most timeouts come within a frame
    for _ in range(times):
        signal.setitimer(signal.ITIMER_REAL, generator.uniform(1e-5, longest))
        try:
            try:
                frame()
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
        except Late:
            came += 1
        assert np.array_equal(frame(), expected)
print(came)
"""


def interrupt_frames(backend: str, seed: int, times: int) -> int:
    """Return the number of a program's frames that were interrupted by timeouts at random times; all others are
    right."""
    command = [sys.executable, "-W", "ignore", "-c", _TIMED, backend, str(seed), str(times)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=3600, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return int(done.stdout)


def has(backend: str) -> bool:
    try:
        rhi.create_device(backend).close()
    except rhi.DeviceError:
        return False
    return True


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
def test_frames_go_on_after_timeouts(backend: str) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    assert interrupt_frames(backend, os.getpid(), 20) > 0


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
def test_frames_go_on_after_thousands_of_timeouts(backend: str) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    assert interrupt_frames(backend, os.getpid(), 2000) > 100


# -- signals while handlers are put back -------------------------------------------------------------------


@pytest.fixture
def presses(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The handlers that were called, in order. Ctrl-C comes when its own handler has just been put back, before
    those of other signals are."""
    called: list[str] = []
    numbers = [signal.SIGINT, signal.SIGALRM, signal.SIGUSR1]
    before = {number: signal.getsignal(number) for number in numbers}

    def interrupt(number: int, frame: Any) -> None:
        called.append(signal.Signals(number).name)
        raise KeyboardInterrupt

    def note(number: int, frame: Any) -> None:
        called.append(signal.Signals(number).name)

    set_handler: Any = vars(interrupts)["signal"]

    def set_and_press(number: int, handler: Any) -> None:
        set_handler(number, handler)
        if handler is interrupt and "SIGINT" not in called:
            signal.raise_signal(signal.SIGINT)

    for number in numbers:
        signal.signal(number, interrupt if number == signal.SIGINT else note)
    monkeypatch.setattr(interrupts, "signal", set_and_press)
    yield called
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("kind", [DeferredInterrupts, DeferredSignals])
def test_an_interrupt_at_the_end_of_a_block_leaves_no_handler_held(kind: type, presses: list[str]) -> None:
    handlers = signal.getsignal(signal.SIGALRM), signal.getsignal(signal.SIGUSR1)
    with pytest.raises(KeyboardInterrupt), kind():
        pass
    assert (signal.getsignal(signal.SIGALRM), signal.getsignal(signal.SIGUSR1)) == handlers
    assert presses == ["SIGINT"]


@pytest.mark.parametrize("kind", [DeferredInterrupts, DeferredSignals])
def test_an_interrupt_at_the_end_of_a_block_hides_no_signal_that_waits(
    kind: type, presses: list[str]
) -> None:
    with pytest.raises(KeyboardInterrupt), kind():
        signal.raise_signal(signal.SIGALRM)
        signal.raise_signal(signal.SIGUSR1)
    assert presses == ["SIGINT", "SIGALRM", "SIGUSR1"]


# -- Ctrl-C ------------------------------------------------------------------------------------------------


def press_in_frames(backend: str, seed: int, times: int, folder: Path | None = None) -> tuple[int, int, int]:
    """Press Ctrl-C once in or soon after each frame of a program; all others are right.

    Args:
        folder: an empty folder for compiled shaders, which each frame has new ones of; None for the usual
            folder, and the same shaders in all frames.

    Returns:
        How many interrupts were raised in a frame, how many after it, and how many came in a destructor, where
        Python prints them.
    """
    cache = "warm" if folder is None else "cold"
    command = [sys.executable, "-W", "ignore", ctrl_c_frames.__file__, backend, str(seed), str(times), cache]
    folders = {} if folder is None else dict.fromkeys(("RHI_CACHE", "MESA_SHADER_CACHE_DIR"), str(folder))
    environment = {**os.environ, **folders}
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=7200, check=False, env=environment, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr[-3000:]
    raised, late, lost = map(int, done.stdout.split()[-3:])
    return raised, late, lost


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
def test_frames_go_on_after_ctrl_c(backend: str) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    raised, late, lost = press_in_frames(backend, os.getpid(), 15)
    assert raised + late + lost == 15
    assert raised + late > 0


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
@pytest.mark.parametrize(("is_cold", "times"), [(False, 1700), (True, 200)], ids=["warm", "cold"])
def test_frames_go_on_after_thousands_of_ctrl_c(
    backend: str, is_cold: bool, times: int, tmp_path: Path
) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    raised, _, lost = press_in_frames(backend, os.getpid(), times, tmp_path if is_cold else None)
    assert raised > times // 10
    assert lost < times // 10


_STARTED = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
import numpy as np
import rhi
import rhi.shading as sl

text = '''
from rhi.shading import Shader, Storage, StorageRW, global_id
class Double(Shader):
    work_group = (4,)
    source: Storage[float]
    out: StorageRW[float]
    def compute(self) -> None:
        self.out[global_id().x] = self.source[global_id().x] * 2.0
'''
with rhi.create_device("cl") as device:
    source, out = device.storage(float, np.arange(8, dtype=np.float32)), device.storage(float, 8)
    device.dispatch(device.program(sl.from_source(text)), 2, source=source, out=out)
    print(out.read().tolist() == [2.0 * i for i in range(8)])
"""


@pytest.mark.nightly
def test_a_process_draws_after_another_was_interrupted_at_its_start(tmp_path: Path) -> None:
    """From the first import to the close of the device, with an empty cache, which the next process takes
    over."""
    if not has("cl"):
        pytest.skip("no device on cl")
    generator, command = random.Random(os.getpid()), [sys.executable, "-W", "ignore", "-c", _STARTED]

    def start(folder: Path) -> subprocess.Popen[str]:
        pipe, environment = subprocess.PIPE, {**os.environ, "RHI_CACHE": str(folder)}
        return subprocess.Popen(
            command, stdout=pipe, stderr=pipe, text=True, env=environment, encoding="utf-8"
        )

    def finish(process: subprocess.Popen[str]) -> str:
        output, errors = process.communicate(timeout=300)
        assert process.returncode in (0, 1, -signal.SIGINT), errors[-3000:]
        return output.strip() if process.returncode == 0 else "KeyboardInterrupt"

    began = time.perf_counter()
    assert finish(start(tmp_path / "first")) == "True"
    duration, outcomes = time.perf_counter() - began, []
    for number in range(15):
        process = start(tmp_path / str(number))
        time.sleep(generator.uniform(0.0, duration))
        process.send_signal(signal.SIGINT)
        outcomes.append(finish(process))
        assert finish(start(tmp_path / str(number))) == "True", number
    assert outcomes.count("KeyboardInterrupt") > 3
