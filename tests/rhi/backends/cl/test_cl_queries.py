"""The fence and timestamps, against a kernel that takes a while."""

from __future__ import annotations

import time

import pytest
from cl_kit import SPIN, ClKit, describe_program

from rhi.backends.cl.queries import is_done
from rhi.errors import DeviceError
from rhi.timeline import FOREVER


@pytest.fixture
def busy_kit(cl_kit: ClKit) -> ClKit:
    """What `dispatch(program)` of its last id starts runs for some tenths of a second."""
    program, words = cl_kit.program(describe_program(SPIN)), cl_kit.buffer(bytes(4))
    cl_kit.backend.bind_storage(0, words, 0, 4)
    cl_kit.backend.bind_program(program)
    return cl_kit


def test_a_fence_behind_running_work_is_neither_passed_nor_waited_for(busy_kit: ClKit) -> None:
    backend = busy_kit.backend
    backend.signal(1)
    assert backend.wait(1, 10.0)
    backend.dispatch(1, 1, 1)
    start = time.monotonic()
    backend.signal(2)
    assert backend.completed() == 1
    assert not backend.wait(2, 0.0)
    assert not backend.wait(2, 0.001)
    assert time.monotonic() - start < 0.05
    assert backend.wait(2, 10.0)
    assert backend.completed() == 2


def test_a_wait_without_a_limit_ends_at_its_own_value(
    busy_kit: ClKit, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend = busy_kit.backend
    for value in (1, 2):
        backend.dispatch(1, 1, 1)
        backend.signal(value)
    with monkeypatch.context() as patch:
        patch.delattr(time, "sleep")  # no naps, which are late
        assert backend.wait(1, FOREVER)
        assert backend.completed() == 1
        assert backend.wait(2, FOREVER)
    assert backend.completed() == 2


def test_a_signal_starts_the_work_before_it(busy_kit: ClKit) -> None:
    backend = busy_kit.backend
    backend.dispatch(1, 1, 1)
    backend.signal(1)
    end = time.monotonic() + 10
    while backend.completed() < 1:
        assert time.monotonic() < end
        time.sleep(0.005)


def test_a_fence_that_nobody_signals_is_not_waited_for(cl_kit: ClKit) -> None:
    cl_kit.backend.signal(1)
    assert cl_kit.backend.wait(1, 10.0)
    assert not cl_kit.backend.wait(2, 10.0)


def test_timestamps_enclose_the_time_of_the_work_between_them(busy_kit: ClKit) -> None:
    backend = busy_kit.backend
    before, after = busy_kit.timestamp(), busy_kit.timestamp()
    assert backend.read_query(before) is None
    start = time.monotonic_ns()
    backend.write_query(before)
    backend.dispatch(1, 1, 1)
    backend.write_query(after)
    assert backend.read_query(after) is None
    backend.signal(1)
    backend.wait(1, 10.0)
    whole = time.monotonic_ns() - start
    first, last = backend.read_query(before), backend.read_query(after)
    assert first is not None
    assert last is not None
    assert whole / 2 < last - first <= whole


def test_a_timestamp_taken_again_forgets_the_earlier_one(busy_kit: ClKit) -> None:
    backend, query = busy_kit.backend, busy_kit.timestamp()
    backend.write_query(query)
    backend.signal(1)
    backend.wait(1, 10.0)
    first = backend.read_query(query)
    backend.dispatch(1, 1, 1)
    backend.write_query(query)
    assert backend.read_query(query) is None
    backend.signal(2)
    backend.wait(2, 10.0)
    second = backend.read_query(query)
    assert first is not None
    assert second is not None
    assert second > first


def test_a_command_that_failed_is_reported_and_not_waited_for() -> None:
    class Failed:
        command_execution_status = -5

    with pytest.raises(DeviceError) as caught:
        is_done(Failed())  # type: ignore[arg-type]
    assert caught.value.rule.id == "device-lost"
    assert "-5" in caught.value.given
