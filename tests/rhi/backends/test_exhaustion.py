"""Memory that runs out at any creation, errors in any scope, many devices, and processes that end with everything open.

Afterwards everything is closed, a fixed picture is drawn right, and the backend has the resources that it had before
(`house_kit`). Memory runs out in front of every `create_…` of the contract, and in the driver behind it.
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
from house_kit import CALLS, House, create_a_buffer, draw, make_things_to_destroy
from nightly_reasons import SAME_ON_EACH_BACKEND

import rhi
from rhi import Access, CullMode, DeviceError, Scissor
from rhi.backends.cl.backend import ClBackend
from rhi.backends.gl import buffers as gl_buffers
from rhi.backends.gl import textures as gl_textures
from rhi.errors.rules import DEVICE_MEMORY

CREATIONS = [
    "create_buffer", "create_texture", "create_sampler", "create_program", "create_vertex_array", "create_query",
]  # fmt: skip
MOST = 12
"""Creations of a call that are made to fail."""


@pytest.fixture(scope="module", params=["gl", "cl", "null"])
def houses(request: pytest.FixtureRequest) -> Iterator[list[House]]:
    """A list with the house of this backend; a test that damages it takes it away."""
    kept: list[House] = [House(rhi.create_device(request.param, record=False))]
    yield kept
    for house in kept:
        house.device.close()


@pytest.fixture
def house(houses: list[House], request: pytest.FixtureRequest) -> Iterator[House]:
    if not houses:
        backend = request.node.callspec.params["houses"]
        houses.append(House(rhi.create_device(backend, record=False)))
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


def exhaust(house: House, call: Callable[[House], None], failing: Failing) -> None:
    """Make a call fail at each of its allocations, and check the device after each."""
    if not house.can(call):
        pytest.skip("nothing is rasterised")
    for at in range(1, MOST + 1):
        if call.__name__ == "destroy_everything":
            make_things_to_destroy(house)
        failing.count, failing.at = 0, at
        try:
            call(house)
        except DeviceError as error:
            if error.rule is not DEVICE_MEMORY:
                raise
        finally:
            failing.at = 0
        made = failing.count
        try:
            house.check()
        except BaseException as error:
            error.add_note(f"{call.__name__}, allocation {at} failed")
            raise
        if made < at:
            return


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_when_the_backend_has_no_memory(
    house: House, monkeypatch: pytest.MonkeyPatch, call: Callable[[House], None]
) -> None:
    failing = Failing(monkeypatch, lambda: DeviceError(DEVICE_MEMORY, "a test"))
    for name in CREATIONS:
        failing.patch(house.device._core.backend, name)
    exhaust(house, call, failing)


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_a_device_goes_on_when_the_driver_has_no_memory(
    house: House, monkeypatch: pytest.MonkeyPatch, call: Callable[[House], None]
) -> None:
    name = house.device.backend_name
    if name == "null":
        pytest.skip("it has no driver")
    if name == "cl":
        import pyopencl as cl

        with pytest.raises(cl.Error) as caught:
            cl.Buffer(house.device.backend_as(ClBackend).context.context, cl.mem_flags.READ_WRITE, 1 << 60)
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
    exhaust(house, call, failing)


FIRST_DRAWS = 30
"""More allocations than the first picture of a device makes: bindings, counters, and the pools of the rasteriser."""


@pytest.mark.nightly
@pytest.mark.parametrize("at", range(1, FIRST_DRAWS + 1))
def test_the_first_draws_can_be_repeated_when_the_driver_had_no_memory(
    monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    import pyopencl as cl

    with rhi.create_device("cl", record=False) as device:
        house = House(device, warm_up=False)
        with pytest.raises(cl.Error) as caught:
            cl.Buffer(device.backend_as(ClBackend).context.context, cl.mem_flags.READ_WRITE, 1 << 60)
        failing = Failing(monkeypatch, lambda: caught.value)
        failing.patch(cl, "Buffer")
        failing.at = at
        try:
            house.picture()
        except DeviceError as error:
            if error.rule is not DEVICE_MEMORY:
                raise
        assert failing.count <= FIRST_DRAWS
        failing.at = 0
        again = house.picture()
    with rhi.create_device("cl", record=False) as device:
        np.testing.assert_array_equal(again, House(device, warm_up=False).picture())


def test_memory_of_destroyed_resources_is_used_before_a_creation_fails(
    house: House, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend: Any = house.device._core.backend
    create, room = backend.create_buffer, [1]

    def limited(*arguments: Any) -> None:
        if not room:
            raise DeviceError(DEVICE_MEMORY, "a test")
        create(*arguments)
        room.pop()

    destroy = backend.destroy
    monkeypatch.setattr(backend, "create_buffer", limited)
    monkeypatch.setattr(backend, "destroy", lambda resource: (destroy(resource), room.append(1)))
    first = house.device.buffer(16)
    with pytest.raises(DeviceError):
        house.device.buffer(16)  # the first is in use
    first.destroy()
    house.device.buffer(16).destroy()
    monkeypatch.undo()
    house.check()


@pytest.mark.parametrize("inside", ["pass", "scopes", "query", "event", "lock", "immediate", "record"])
def test_a_device_goes_on_after_an_error_in_any_scope(house: House, inside: str) -> None:
    device, error = house.device, RuntimeError("mine")
    with pytest.raises(RuntimeError, match="mine"):
        if inside == "lock":
            with house.numbers.lock(Access.READ_WRITE) as numbers:
                numbers[:] = 99
                raise error
        if inside == "record":
            with device.record() as commands, commands.render_pass(house.other):
                raise error
        with device.event("event"), device.states(CullMode.NONE), device.render_pass(house.other):
            if inside == "event":
                with device.event("inner"), device.event("innermost"):
                    raise error
            if inside == "scopes":
                with device.states(Scissor(1, 1, 2, 2)), device.states(Scissor(2, 2, 1, 1)):
                    device.draw(house.flat, house.full, tint=house.tints[0])
                    raise error
            if inside == "query":
                with house.query:
                    device.draw(house.flat, house.full, tint=house.tints[0])
                    raise error
            if inside == "immediate":
                with device.immediate(house.flat, rhi.Primitive.POINTS, tint=house.tints[0]) as points:
                    points.vertex(position=(0, 0))
                    raise error
            raise error
    house.check()


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
import gc, sys
from house_kit import House, draw
import rhi

def resident():
    lines = open("/proc/self/smaps_rollup").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Rss:"))

def use():
    with rhi.create_device(sys.argv[1], record=False) as device:
        house = House(device)
        draw(house)
        house.check()

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
from house_kit import House, make_things_to_destroy
import rhi
from rhi import Access, Scissor

house = House(rhi.create_device(sys.argv[1], record=False))
device, how = house.device, sys.argv[2]
device.timing = device.capabilities.timestamps
make_things_to_destroy(house)
house.made[1].destroy()
opened = [device.states(Scissor(0, 0, 1, 1)), device.event("event"), house.numbers.lock(Access.WRITE)]
opened += [device.render_pass(house.image, house.depth, clear=(0, 0, 0, 0)), house.query, device.record()]
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
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment)


@pytest.mark.nightly_cases(
    "end-0-null", "end-0-cl", "error-1-cl", "error-1-gl", "exit-3-gl", "exit-3-null", reason=SAME_ON_EACH_BACKEND
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


def test_the_calls_that_fail_do_allocate(house: House, monkeypatch: pytest.MonkeyPatch) -> None:
    failing = Failing(monkeypatch, lambda: DeviceError(DEVICE_MEMORY, "a test"))
    for name in CREATIONS:
        failing.patch(house.device._core.backend, name)
    create_a_buffer(house)
    assert failing.count == 1
    draw(house)
    assert failing.count == 1
    house.settle()
