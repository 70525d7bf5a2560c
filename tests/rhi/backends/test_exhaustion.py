"""Memory that runs out at any creation, errors in any scope, many devices, and processes that end with
everything open.

Afterwards everything is closed, a fixed image is drawn right, and the backend has the resources that it had
before (`harness_kit`). Memory runs out in front of every `create_…` of the contract, and in the driver behind
it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from harness_kit import CALLS, DeviceHarness, create_a_buffer, draw, make_things_to_destroy
from nightly_reasons import SAME_ON_EACH_BACKEND

import rhi
from rhi import Access, CullMode, DeviceError, Scissor
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.gl import gl_buffers as gl_buffers
from rhi.backends.gl import gl_textures as gl_textures
from rhi.errors.rules import DEVICE_MEMORY

CREATIONS = [
    "create_buffer",
    "create_texture",
    "create_sampler",
    "create_program",
    "create_vertex_array",
    "create_query",
]
MAX_FAILURES = 12
"""Creations of a call that are made to fail."""


@pytest.fixture(scope="module", params=["gl", "cl", "null"])
def houses(request: pytest.FixtureRequest) -> Iterator[list[DeviceHarness]]:
    """A list with the house of this backend; a test that damages it takes it away."""
    harnesses: list[DeviceHarness] = [DeviceHarness(rhi.create_device(request.param, record=False))]
    yield harnesses
    for harness in harnesses:
        harness.device.close()


@pytest.fixture
def harness(houses: list[DeviceHarness], request: pytest.FixtureRequest) -> Iterator[DeviceHarness]:
    if not houses:
        backend = request.node.callspec.params["houses"]
        houses.append(DeviceHarness(rhi.create_device(backend, record=False)))
    taken = houses.pop()
    yield taken
    houses.append(taken)


class Failing:
    """Counts the calls of functions, and lets one of them and all that follow in the same call fail."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, error: Callable[[], Exception]) -> None:
        self._patch = monkeypatch
        self._error = error
        self.at = 0
        self.count = 0

    def patch(self, owner: Any, name: str) -> None:
        function = getattr(owner, name)

        def fail(*arguments: Any, **named: Any) -> Any:
            self.count += 1
            if self.at and self.count >= self.at:
                raise self._error()
            return function(*arguments, **named)

        self._patch.setattr(owner, name, fail)


def exhaust(harness: DeviceHarness, call: Callable[[DeviceHarness], None], failing: Failing) -> None:
    """Make a call fail at each of its allocations, and check the device after each."""
    if not harness.can(call):
        pytest.skip("nothing is rasterised")
    for at in range(1, MAX_FAILURES + 1):
        if call.__name__ == "destroy_everything":
            make_things_to_destroy(harness)
        failing.count, failing.at = 0, at
        try:
            call(harness)
        except DeviceError as error:
            if error.rule is not DEVICE_MEMORY:
                raise
        finally:
            failing.at = 0
        count = failing.count
        try:
            harness.check()
        except BaseException as error:
            error.add_note(f"{call.__name__}, allocation {at} failed")
            raise
        if count < at:
            return


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_when_the_backend_has_no_memory(
    harness: DeviceHarness, monkeypatch: pytest.MonkeyPatch, call: Callable[[DeviceHarness], None]
) -> None:
    failing = Failing(monkeypatch, lambda: DeviceError(DEVICE_MEMORY, "a test"))
    for name in CREATIONS:
        failing.patch(harness.device._core.backend, name)
    exhaust(harness, call, failing)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_when_the_driver_has_no_memory(
    harness: DeviceHarness, monkeypatch: pytest.MonkeyPatch, call: Callable[[DeviceHarness], None]
) -> None:
    name = harness.device.backend_name
    if name == "null":
        pytest.skip("it has no driver")
    if name == "cl":
        import pyopencl as cl

        with pytest.raises(cl.Error) as caught:
            cl.Buffer(harness.device.backend_as(ClBackend).context.context, cl.mem_flags.READ_WRITE, 1 << 60)
        failing = Failing(monkeypatch, lambda: caught.value)
        failing.patch(cl, "Buffer")
    else:
        failing = Failing(monkeypatch, lambda: DeviceError(DEVICE_MEMORY, "a test"))
        for module in (gl_buffers, gl_textures):
            find_error = module.find_error

            def find(*arguments: Any, find_error: Any = find_error) -> DeviceError | None:
                failing.count += 1
                if failing.at and failing.count >= failing.at:
                    return DeviceError(DEVICE_MEMORY, "a test")
                error: DeviceError | None = find_error(*arguments)
                return error

            monkeypatch.setattr(module, "find_error", find)
    exhaust(harness, call, failing)


FIRST_DRAWS = 30
"""More allocations than the first image of a device makes: bindings, counters, and the pools of the
rasteriser."""


@pytest.mark.nightly
@pytest.mark.parametrize("at", range(1, FIRST_DRAWS + 1))
def test_the_first_draws_can_be_repeated_when_the_driver_had_no_memory(
    monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    import pyopencl as cl

    with rhi.create_device("cl", record=False) as device:
        harness = DeviceHarness(device, warm_up=False)
        with pytest.raises(cl.Error) as caught:
            cl.Buffer(device.backend_as(ClBackend).context.context, cl.mem_flags.READ_WRITE, 1 << 60)
        failing = Failing(monkeypatch, lambda: caught.value)
        failing.patch(cl, "Buffer")
        failing.at = at
        try:
            harness.draw_image()
        except DeviceError as error:
            if error.rule is not DEVICE_MEMORY:
                raise
        assert failing.count <= FIRST_DRAWS
        failing.at = 0
        again = harness.draw_image()
    with rhi.create_device("cl", record=False) as device:
        np.testing.assert_array_equal(again, DeviceHarness(device, warm_up=False).draw_image())


def test_memory_of_destroyed_resources_is_used_before_a_creation_fails(
    harness: DeviceHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend: Any = harness.device._core.backend
    create, room = backend.create_buffer, [1]

    def limited(*arguments: Any) -> None:
        if not room:
            raise DeviceError(DEVICE_MEMORY, "a test")
        create(*arguments)
        room.pop()

    destroy = backend.destroy
    monkeypatch.setattr(backend, "create_buffer", limited)
    monkeypatch.setattr(backend, "destroy", lambda resource: (destroy(resource), room.append(1)))
    first = harness.device.buffer(16)
    with pytest.raises(DeviceError):
        harness.device.buffer(16)  # the first is in use
    first.destroy()
    harness.device.buffer(16).destroy()
    monkeypatch.undo()
    harness.check()


@pytest.mark.parametrize("inside", ["pass", "scopes", "query", "event", "lock", "immediate", "record"])
def test_a_device_goes_on_after_an_error_in_any_scope(harness: DeviceHarness, inside: str) -> None:
    device, error = harness.device, RuntimeError("mine")
    with pytest.raises(RuntimeError, match="mine"):
        if inside == "lock":
            with harness.numbers.lock(Access.READ_WRITE) as numbers:
                numbers[:] = 99
                raise error
        if inside == "record":
            with device.record() as commands, commands.render_pass(harness.other):
                raise error
        with device.event("event"), device.states(CullMode.NONE), device.render_pass(harness.other):
            if inside == "event":
                with device.event("inner"), device.event("innermost"):
                    raise error
            if inside == "scopes":
                with device.states(Scissor(1, 1, 2, 2)), device.states(Scissor(2, 2, 1, 1)):
                    device.draw(harness.flat, harness.full, tint=harness.tints[0])
                    raise error
            if inside == "query":
                with harness.query:
                    device.draw(harness.flat, harness.full, tint=harness.tints[0])
                    raise error
            if inside == "immediate":
                with device.immediate(harness.flat, rhi.Primitive.POINTS, tint=harness.tints[0]) as points:
                    points.vertex(position=(0, 0))
                    raise error
            raise error
    harness.check()


@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
def test_devices_are_opened_and_closed_without_open_files_or_threads_left(backend: str) -> None:
    def count() -> tuple[int, int]:
        return len(os.listdir("/proc/self/fd")), len(os.listdir("/proc/self/task"))

    def use() -> None:
        with rhi.create_device(backend, record=False) as device:
            device.buffer(64).read()

    use()
    before = count()
    for _ in range(20):
        use()
    assert count() == before


MANY = """
import gc, logging, sys
from harness_kit import DeviceHarness, draw
import rhi
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)

def resident():
    lines = open("/proc/self/smaps_rollup").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))

def use():
    with rhi.create_device(sys.argv[1], record=False) as device:
        harness = DeviceHarness(device)
        draw(harness)
        harness.check()

for _ in range(5):
    use()
gc.collect()
before = resident()
for _ in range(200):
    use()
    gc.collect()
print((resident() - before) / 200)
"""


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
def test_two_hundred_devices_keep_less_than_a_megabyte_each(backend: str) -> None:
    done = run_python(MANY, backend)
    assert done.stderr == ""
    assert float(done.stdout) < 1024


OPEN = """
import sys
from harness_kit import DeviceHarness, make_things_to_destroy
import rhi
from rhi import Access, Scissor

harness = DeviceHarness(rhi.create_device(sys.argv[1], record=False))
device, how = harness.device, sys.argv[2]
device.timing = device.capabilities.timestamps
make_things_to_destroy(harness)
harness.created[1].destroy()
opened = [device.states(Scissor(0, 0, 1, 1)), device.event("event"), harness.numbers.lock(Access.WRITE)]
opened += [device.render_pass(harness.image, harness.depth, clear=(0, 0, 0, 0)), harness.query, device.record()]
for block in opened:
    block.__enter__()
if how == "exit":
    sys.exit(3)
if how == "error":
    raise ValueError("mine")
"""


def run_python(text: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    folders = [str(Path(__file__).parents[1]), *sys.path]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(folder for folder in folders if folder)}
    command = [sys.executable, "-c", text, *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, encoding="utf-8"
    )


@pytest.mark.nightly_cases(
    "end-0-null",
    "end-0-cl",
    "error-1-cl",
    "error-1-gl",
    "exit-3-gl",
    "exit-3-null",
    reason=SAME_ON_EACH_BACKEND,
)
@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
@pytest.mark.parametrize(("how", "status"), [("end", 0), ("exit", 3), ("error", 1)])
def test_a_process_ends_quietly_with_everything_open(backend: str, how: str, status: int) -> None:
    done = run_python(OPEN, backend, how)
    assert done.returncode == status
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    if how == "error":
        assert lines[0].startswith("Traceback")
        assert lines[-1] == "ValueError: mine"
        assert sum("Error" in line or "Exception" in line for line in lines) == 1
    else:
        assert lines == []


def test_the_calls_that_fail_do_allocate(harness: DeviceHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = Failing(monkeypatch, lambda: DeviceError(DEVICE_MEMORY, "a test"))
    for name in CREATIONS:
        failing.patch(harness.device._core.backend, name)
    create_a_buffer(harness)
    assert failing.count == 1
    draw(harness)
    assert failing.count == 1
    harness.settle()
