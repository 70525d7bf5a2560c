"""Ctrl-C at any step of any call: the device goes on as if the call had happened or not, and nothing is left
behind.

Each call is interrupted at each step at which Python could raise `KeyboardInterrupt` (`interrupts_kit`), or
quickly at a few of them. Afterwards everything is closed, a fixed image is drawn right, queries count right,
and the backend has the resources that it had before (`harness_kit`).
"""

from __future__ import annotations

import gc
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext, suppress
from random import randrange
from typing import Any

import numpy as np
import pytest
from harness_kit import CALLS, DeviceHarness, destroy_everything, end_a_frame, make_things_to_destroy
from interrupts_kit import EXEMPT, Interrupt, use_default_handler
from nightly_reasons import SAME_ON_EACH_BACKEND

import rhi
from rhi import BlendColor, CullMode, Device, Format, Scissor
from rhi.backends.null import NullBackend
from rhi.contract.interrupts import DeferredInterrupts

# Python prints what is raised in a destructor and goes on.
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")

EXEMPT.add(__file__)
QUICK = 10
"""Steps of each call that the default run tries."""

MAX_STEPS = 1500
"""Steps of each call that the nightly run tries: all, but only each nth of compiling programs, others each
time."""


@pytest.fixture(autouse=True)
def interrupts() -> Iterator[None]:
    with use_default_handler():
        yield


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu", "null"])
def houses(request: pytest.FixtureRequest) -> Iterator[Callable[[], DeviceHarness]]:
    """A function that returns the house of this backend: the same one until a test has damaged it."""
    harnesses: list[DeviceHarness] = []

    def get() -> DeviceHarness:
        if not harnesses:
            try:
                device = rhi.create_device(request.param, record=False)
            except rhi.DeviceError as error:
                if request.param != "wgpu":
                    raise
                pytest.skip(str(error))
            harnesses.append(DeviceHarness(device))
        return harnesses[0]

    get.drop = harnesses.clear  # type: ignore[attr-defined]
    yield get
    for harness in harnesses:
        harness.device.close()


def interrupt(harness: DeviceHarness, call: Callable[[DeviceHarness], None], at: int) -> str | None:
    """Make a call that is interrupted at a step; return where, or None if it has fewer steps."""
    if call is destroy_everything:
        make_things_to_destroy(harness)
    interrupted = Interrupt(at)
    try:
        # An interrupt at the first step of a scope's end is repaired by the scope around it.
        around = nullcontext() if call is end_a_frame else harness.device.states(BlendColor(1, 1, 1, 1))
        with around, interrupted:
            call(harness)
    except KeyboardInterrupt:
        assert at
    return interrupted.where


def count_steps(harness: DeviceHarness, call: Callable[[DeviceHarness], None]) -> int:
    if call is destroy_everything:
        make_things_to_destroy(harness)
    with Interrupt() as counted:
        call(harness)
    harness.settle()
    return counted.steps


def try_steps(harness: DeviceHarness, call: Callable[[DeviceHarness], None], steps: list[int]) -> None:
    for at in steps:
        where = interrupt(harness, call, at)
        try:
            harness.check()
        except BaseException as error:
            error.add_note(f"{call.__name__}, interrupted at step {at}: {where}")
            raise


@pytest.fixture(autouse=True)
def default_handler() -> Iterator[None]:
    before = signal.getsignal(signal.SIGINT)
    yield
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_after_an_interrupt(houses: Any, call: Callable[[DeviceHarness], None]) -> None:
    harness = houses()
    if not harness.can(call):
        pytest.skip("nothing is rasterised")
    steps = count_steps(harness, call)
    selected = np.unique(np.linspace(1, steps, QUICK).astype(int)).tolist()
    try:
        try_steps(harness, call, selected)
    except BaseException:
        houses.drop()
        raise


@pytest.mark.nightly
@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_after_an_interrupt_at_any_step(
    houses: Any, call: Callable[[DeviceHarness], None]
) -> None:
    harness = houses()
    if not harness.can(call):
        pytest.skip("nothing is rasterised")
    try:
        steps = count_steps(harness, call)
        stride = -(-steps // MAX_STEPS)
        try_steps(harness, call, list(range(1 + randrange(stride), steps + 1, stride)))
    except BaseException:
        houses.drop()
        raise


@pytest.mark.parametrize("backend", ["cl", "gl", "null"])
def test_the_first_pass_of_a_device_may_be_interrupted(backend: str) -> None:
    def clear(device: Device, image: rhi.Texture) -> None:
        with device.render_pass(image, clear=(1, 0, 0, 1)):
            pass

    def begin(at: int) -> int:
        """Interrupt the first pass at a step, and look that the second one clears; return the number of
        steps."""
        with rhi.create_device(backend, record=False) as device:
            image, interrupted = device.texture((4, 4), Format.RGBA8), Interrupt(at)
            with suppress(KeyboardInterrupt), interrupted:
                clear(device, image)
            clear(device, image)
            assert (image.read() == (255, 0, 0, 255)).all(), interrupted.where
            return interrupted.steps

    steps = begin(0)
    assert steps > 20
    for at in range(1, steps + 1, 7):
        begin(at)


GARBAGE = """
class Cycle:
    def __init__(self):
        self.itself = self
    def __del__(self):
        pass

def make_garbage():
    for _ in range(20):
        Cycle()
        (lambda: None)()
"""


def test_the_collector_may_be_interrupted_between_a_call_and_its_frame(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """CPython borrows the trace function there, which the interrupt removes: it called what came in its
    place."""
    names: dict[str, Any] = {}
    exec(compile(GARBAGE, "<garbage>", "exec"), names)
    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    thresholds = gc.get_threshold()
    try:
        for threshold in range(1, 30):
            gc.set_threshold(threshold, 1, 1)
            for at in range(20, 60):
                with suppress(KeyboardInterrupt), Interrupt(at):
                    names["make_garbage"]()
    finally:
        gc.set_threshold(*thresholds)


# -- blocks whose ends are cut off -----------------------------------------------------------------------


def cut_off(block: Any, kind: type) -> None:
    """Leave a block without its end, as an interrupt at the first step of `__exit__` does."""
    enter, leave = kind.__enter__, kind.__exit__

    def interrupted(self: object, *_: object) -> None:
        raise KeyboardInterrupt

    kind.__exit__ = interrupted  # type: ignore[method-assign, assignment]
    try:
        with pytest.raises(KeyboardInterrupt), block:
            pass
    finally:
        kind.__exit__ = leave  # type: ignore[method-assign]
    assert kind.__enter__ is enter


def test_an_outer_scope_restores_the_states_of_an_inner_scope_whose_exit_was_interrupted(
    null_device: Device,
) -> None:
    states = null_device._core.states
    default = states.requested
    with pytest.raises(KeyboardInterrupt), null_device.states(CullMode.NONE):
        outer = states.requested
        with pytest.raises(ValueError, match="mine"), null_device.states(Scissor(1, 1, 2, 2)):
            cut_off(null_device.states(CullMode.BACK), type(null_device.states(CullMode.BACK)))
            assert states.depth == 3
            raise ValueError("mine")
        assert states.requested is outer
        assert states.depth == 1
        raise KeyboardInterrupt
    assert states.requested is default
    assert states.depth == 0


def test_an_outer_scope_also_ends_an_inner_scope_whose_interrupt_was_caught(null_device: Device) -> None:
    states = null_device._core.states
    with null_device.states(CullMode.NONE):
        cut_off(null_device.states(CullMode.FRONT), type(null_device.states()))
        assert states.depth == 2
    assert states.requested[CullMode] is CullMode.BACK
    assert states.depth == 0


@pytest.mark.parametrize(
    ("kind", "cuts"), [("states", 1), ("event", 1), ("pass", 1), ("states", 2), ("event", 2)]
)
def test_a_frame_ends_scopes_whose_ends_were_cut_off(null_device: Device, kind: str, cuts: int) -> None:
    """Also one that was entered inside itself: the stack of scopes alone, for each of its places, doesn't
    hold it."""
    image = null_device.texture((4, 4), Format.RGBA8)
    block: Any
    if kind == "states":
        block = null_device.states(CullMode.NONE)
    else:
        block = null_device.event("cut") if kind == "event" else null_device.render_pass(image)
    for _ in range(cuts):
        cut_off(block, type(block))
    assert len(null_device._core.scopes) == cuts
    with pytest.raises(rhi.ValidationError):  # it may still be left: `block` holds it
        null_device.present()
    assert len(null_device._core.scopes) == cuts
    del block
    null_device.present()
    assert len(null_device._core.scopes) == 0
    assert null_device._core.states.requested[CullMode] is CullMode.BACK


@pytest.mark.parametrize("kind", ["states", "event"])
def test_a_scope_that_was_withdrawn_can_be_entered_again(null_device: Device, kind: str) -> None:
    """It isn't in the stack any more, so the only reference to it is that of the `with` statement."""
    blocks: list[Any] = [
        null_device.states(CullMode.NONE) if kind == "states" else null_device.event("again")
    ]
    scopes = null_device._core.scopes
    blocks[0].__enter__()
    scopes.withdraw(blocks[0])  # as the pass around it does when it can't be ended
    with blocks.pop():
        scopes.end_unreferenced()
        assert len(scopes) == 1
    assert len(scopes) == 0


@pytest.mark.parametrize("kind", ["states", "event"])
def test_blocks_of_withdrawn_scopes_are_left_once_without_an_error(null_device: Device, kind: str) -> None:
    outer: Any = null_device.event("outer")
    inner: Any = null_device.states(CullMode.NONE) if kind == "states" else null_device.event("inner")
    for block in (outer, inner):
        block.__enter__()
    null_device._core.scopes.withdraw(outer)
    for block in (inner, outer):
        block.__exit__(None, None, None)
        with pytest.raises(rhi.ValidationError):
            block.__exit__(None, None, None)


def test_a_pass_begins_with_the_states_of_scopes_that_are_open(null_device: Device) -> None:
    image, states = null_device.texture((4, 4), Format.RGBA8), null_device._core.states
    with null_device.states(CullMode.FRONT):
        cut_off(null_device.states(CullMode.NONE), type(null_device.states()))
        with null_device.render_pass(image):
            assert states.requested[CullMode] is CullMode.FRONT


def test_an_interrupt_ends_a_scope_that_was_left_too_early(null_device: Device) -> None:
    states, outer = null_device._core.states, null_device.states(CullMode.NONE)
    with pytest.raises(KeyboardInterrupt), null_device.states(CullMode.FRONT):
        outer.__enter__()
        with null_device.states(Scissor(1, 1, 2, 2)):
            with pytest.raises(rhi.ValidationError):
                outer.__exit__(None, None, None)
            raise KeyboardInterrupt
    assert states.requested[CullMode] is CullMode.BACK
    assert states.depth == 0


def test_blocks_whose_scopes_ended_early_are_forgotten_with_their_last_reference(null_device: Device) -> None:
    scopes, early = null_device._core.scopes, null_device.states(CullMode.NONE)
    early.__enter__()
    with null_device.states(CullMode.FRONT), pytest.raises(rhi.ValidationError):
        early.__exit__(None, None, None)
    null_device.present()
    assert scopes._cut == {early}  # it may be left once more, quietly
    cut_off(early, type(early))
    assert len(scopes) == 1
    del early
    null_device.present()
    assert len(scopes) == 0
    null_device.present()
    assert not scopes._cut


def test_scopes_inside_each_other_end_one_by_one_without_errors(null_device: Device) -> None:
    states, scope = null_device._core.states, null_device.states(CullMode.NONE)
    with scope, scope:
        with pytest.raises(ValueError, match="mine"), scope:
            raise ValueError("mine")
        assert states.depth == 2


def test_the_pass_around_leaves_the_scopes_inside(null_device: Device) -> None:
    image, states = null_device.texture((4, 4), Format.RGBA8), null_device._core.states
    with null_device.states(CullMode.NONE):
        outer = states.requested
        with pytest.raises(KeyboardInterrupt), null_device.render_pass(image):
            scope = null_device.states(Scissor(1, 1, 2, 2))
            cut_off(scope, type(scope))
            raise KeyboardInterrupt
        assert states.requested is outer
        assert states.depth == 1


def test_a_pass_whose_end_was_cut_off_is_ended_by_the_next(null_device: Device) -> None:
    image = null_device.texture((4, 4), Format.RGBA8)
    cut_off(null_device.render_pass(image), rhi.RenderPass)
    assert null_device._core.render_pass is not None
    with null_device.render_pass(image):
        pass
    ops = [command.op for command in null_device.stream]
    assert ops[-4:] == [rhi.Op.BEGIN_PASS, rhi.Op.END_PASS] * 2


def test_a_pass_that_is_open_refuses_another(null_device: Device) -> None:
    image = null_device.texture((4, 4), Format.RGBA8)
    with null_device.render_pass(image):
        with pytest.raises(rhi.ValidationError, match=r"^\[pass-nested\]"):
            null_device.render_pass(image).__enter__()


def test_a_lock_whose_end_was_cut_off_is_released(null_device: Device) -> None:
    buffer = null_device.buffer(16)
    lock = buffer.lock(rhi.Access.WRITE)
    kind = type(lock)
    del lock
    cut_off(buffer.lock(rhi.Access.WRITE), kind)
    assert null_device._core.locked
    buffer.read()
    assert not null_device._core.locked


# -- held interrupts ---------------------------------------------------------------------------------------


def raise_signal() -> None:
    signal.raise_signal(signal.SIGINT)


def test_an_interrupt_waits_for_the_end_of_a_block_that_holds_it() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):
        with DeferredInterrupts():
            with DeferredInterrupts():
                raise_signal()
                done.append("inner")
            done.append("outer")
    assert done == ["inner", "outer"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_interrupt_is_raised_at_once() -> None:
    done = []
    with pytest.raises(KeyboardInterrupt):
        with DeferredInterrupts():
            raise_signal()
            done.append("first")
            raise_signal()
            done.append("second")
    assert done == ["first"]


def test_without_an_interrupt_nothing_is_raised_and_the_handler_is_back() -> None:
    with DeferredInterrupts():
        assert signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_other_threads_hold_nothing() -> None:
    seen = []

    def run() -> None:
        with DeferredInterrupts():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


def test_a_resource_whose_creation_was_interrupted_is_destroyed(
    null_device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend = null_device.backend_as(NullBackend)
    create = backend.create_buffer
    came: list[Any] = []

    def interrupted(*arguments: Any) -> None:
        create(*arguments)
        if not came:
            came.append(arguments)
            raise_signal()

    monkeypatch.setattr(backend, "create_buffer", interrupted)
    with pytest.raises(KeyboardInterrupt):
        null_device.mesh({"position": np.zeros((3, 2))}, np.arange(3))
    monkeypatch.undo()
    null_device.finish()
    null_device.finish()
    created = [c["buffer"] for c in null_device.stream if c.op is rhi.Op.CREATE_BUFFER]
    destroyed = [c["resource"] for c in null_device.stream if c.op is rhi.Op.DESTROY]
    assert len(created) == 2
    assert sorted(destroyed) == created


# -- the end of a process ------------------------------------------------------------------------------------

SUSPENDED = """
import logging, sys
import rhi
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import rectangle
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)  # else a slow machine says that it builds kernels

device = rhi.create_device(sys.argv[1])
image, mesh = device.texture((64, 64), rhi.Format.RGBA8), device.mesh(rectangle())
program = device.program(FlatColored)

def draw():
    with device.states(rhi.CullMode.NONE), device.event("a"), device.render_pass(image, clear=(0, 0, 0, 0)):
        with device.states(rhi.CullMode.FRONT), device.event("b"):
            while True:
                device.draw(program, mesh)
                yield

draws = draw()
next(draws), next(draws)
"""


@pytest.mark.nightly_cases("cl", "null", reason=SAME_ON_EACH_BACKEND)
@pytest.mark.parametrize("backend", ["cl", "gl", "null"])
def test_a_process_ends_silently_with_a_suspended_generator_in_a_pass(backend: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", SUSPENDED, backend],
        capture_output=True,
        text=True,
        timeout=120,
        encoding="utf-8",
    )
    assert (done.returncode, done.stderr) == (0, "")
