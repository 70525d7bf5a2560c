"""The fence and timestamps, with work that is held back."""

from __future__ import annotations

import time
import weakref
from collections.abc import Callable

import pyopencl as cl
import pytest
from cl_kit import FILL, ClKit, describe_program

import rhi
from rhi.backends.cl import create_backend
from rhi.backends.cl.cl_fence import is_done
from rhi.conformance.waiting import TIMEOUT, wait_until
from rhi.contract.backend import FOREVER
from rhi.contract.descriptors import QueryKind
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_LOST


def test_a_fence_behind_running_work_is_neither_passed_nor_waited_for(cl_kit: ClKit) -> None:
    backend = cl_kit.backend
    backend.signal(1)
    assert backend.wait(1, TIMEOUT)
    gate = cl_kit.hold()
    backend.signal(2)
    assert backend.completed() == 1
    assert not backend.wait(2, 0.0)
    assert not backend.wait(2, 0.001)
    cl_kit.release(gate)
    assert backend.wait(2, TIMEOUT)
    assert backend.completed() == 2


def test_a_wait_without_a_limit_ends_at_its_own_value(cl_kit: ClKit, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = cl_kit.backend
    backend.signal(1)
    gate = cl_kit.hold()
    backend.signal(2)
    with monkeypatch.context() as patch:
        patch.delattr(time, "sleep")  # no naps, which are late
        assert backend.wait(1, FOREVER)
        assert backend.completed() == 1
        cl_kit.release(gate)
        assert backend.wait(2, FOREVER)
    assert backend.completed() == 2


def test_a_signal_starts_the_work_before_it(cl_kit: ClKit) -> None:
    backend = cl_kit.backend
    backend.bind_storage(0, cl_kit.buffer(bytes(4)), 0, 4)
    cl_kit.dispatch(cl_kit.program(describe_program(FILL)))
    backend.signal(1)
    assert wait_until(lambda: backend.completed() == 1)


def test_a_fence_that_nobody_signals_is_not_waited_for(cl_kit: ClKit) -> None:
    cl_kit.backend.signal(1)
    assert cl_kit.backend.wait(1, TIMEOUT)
    assert not cl_kit.backend.wait(2, TIMEOUT)


def test_timestamps_enclose_the_time_of_the_work_between_them(cl_kit: ClKit) -> None:
    """Hold work back for a time by the clock."""
    backend, before, after = (
        cl_kit.backend,
        cl_kit.query(QueryKind.TIMESTAMP),
        cl_kit.query(QueryKind.TIMESTAMP),
    )
    assert backend.read_query(before) is None
    start = time.monotonic_ns()
    backend.write_query(before)
    assert wait_until(lambda: backend.read_query(before) is not None)
    held_from = time.monotonic_ns()
    gate = cl_kit.hold()
    backend.write_query(after)
    assert backend.read_query(after) is None
    time.sleep(0.02)
    held_for = time.monotonic_ns() - held_from
    cl_kit.release(gate)
    assert wait_until(lambda: backend.read_query(after) is not None)
    whole = time.monotonic_ns() - start
    first, last = backend.read_query(before), backend.read_query(after)
    assert first is not None
    assert last is not None
    assert 0.99 * held_for < last - first < 1.01 * whole  # two clocks


def test_a_timestamp_taken_again_forgets_the_earlier_one(cl_kit: ClKit) -> None:
    backend, query = cl_kit.backend, cl_kit.query(QueryKind.TIMESTAMP)
    backend.write_query(query)
    backend.signal(1)
    backend.wait(1, TIMEOUT)
    first = backend.read_query(query)
    gate = cl_kit.hold()
    backend.write_query(query)
    assert backend.read_query(query) is None
    cl_kit.release(gate)
    backend.signal(2)
    backend.wait(2, TIMEOUT)
    second = backend.read_query(query)
    assert first is not None
    assert second is not None
    assert second > first


def test_a_command_that_failed_is_reported_and_not_waited_for() -> None:
    class Failed:
        command_execution_status = -5

    with pytest.raises(DeviceError, match=r"^\[device-lost\]") as caught:
        is_done(Failed())  # type: ignore[arg-type]
    assert "-5" in caught.value.given


def test_a_lost_queue_is_reported_to_each_caller_and_the_device_can_be_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """PoCL 3.1 ends the process when a command fails, so the status is mocked."""

    class Failed:
        command_execution_status = -5

        def wait(self) -> None:
            raise cl.LogicError("a command failed")

    with rhi.create_device("cl") as device:
        assert device.wait(device.signal())
        monkeypatch.setattr(cl, "enqueue_marker", lambda *_: Failed())
        value = device.signal()
        asks: list[Callable[[], object]] = [
            lambda: device.completed,
            lambda: device.wait(value),
            lambda: device.wait(value, 0.1),
            device.finish,
        ]
        for ask in asks:
            with pytest.raises(DeviceError, match=r"^\[device-lost\]") as caught:
                ask()
            assert "create a new one" in caught.value.tip
    monkeypatch.undo()
    with rhi.create_device("cl") as device:
        assert device.wait(device.signal())


def test_a_close_that_fails_gives_memory_back_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    backend = create_backend()
    kit = ClKit(backend)
    buffer = kit.buffer(bytes(64))
    memory = weakref.ref(backend._buffers[buffer].cl.hostbuf)
    error = DeviceError(DEVICE_LOST, "the command queue")
    errors = [error]

    def flush_once() -> None:
        while errors:
            raise errors.pop()

    monkeypatch.setattr(backend, "_flush", flush_once)
    with pytest.raises(DeviceError) as caught:
        backend.close()
    assert caught.value is error
    assert memory() is None
