"""Signals other than Ctrl-C: handlers that raise, such as those of timeouts, end neither process nor
device."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import ctrl_c_frames
import pytest

import rhi
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
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
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
    done = subprocess.run(command, capture_output=True, text=True, timeout=3600, check=False)
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


# -- Ctrl-C ------------------------------------------------------------------------------------------------


def press_in_frames(backend: str, seed: int, times: int, cache: str) -> tuple[int, int, int]:
    """Press Ctrl-C once in or soon after each frame of a program; all others are right.

    Returns:
        How many interrupts were raised in a frame, how many after it, and how many came in a destructor, where
        Python prints them.
    """
    command = [sys.executable, "-W", "ignore", ctrl_c_frames.__file__, backend, str(seed), str(times), cache]
    done = subprocess.run(command, capture_output=True, text=True, timeout=7200, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    raised, late, lost = map(int, done.stdout.split()[-3:])
    return raised, late, lost


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
def test_frames_go_on_after_ctrl_c(backend: str) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    raised, late, lost = press_in_frames(backend, os.getpid(), 15, "warm")
    assert raised + late + lost == 15
    assert raised + late > 0


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu", "null"])
@pytest.mark.parametrize(("cache", "times"), [("warm", 1700), ("cold", 100)])
def test_frames_go_on_after_thousands_of_ctrl_c(backend: str, cache: str, times: int) -> None:
    if not has(backend):
        pytest.skip(f"no device on {backend}")
    raised, _, lost = press_in_frames(backend, os.getpid(), times, cache)
    assert raised > times // 10
    assert lost < times // 10
