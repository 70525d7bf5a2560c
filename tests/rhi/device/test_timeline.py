"""The fence of a device, and the operations that wait for it."""

from __future__ import annotations

import pytest
from null_kit import Kit

import rhi


def test_signalled_values_count_up_from_one(kit: Kit) -> None:
    assert [kit.device.signal() for _ in range(3)] == [1, 2, 3]


def test_waiting_for_a_signalled_value_succeeds(kit: Kit) -> None:
    assert kit.device.wait(kit.device.signal())


def test_waiting_for_a_value_never_signalled_is_refused(kit: Kit) -> None:
    value = kit.device.signal()
    with pytest.raises(rhi.ValidationError) as caught:
        kit.device.wait(value + 1)
    assert caught.value.rule.id == "fence-value"


def test_a_destroyed_buffer_lives_on_until_a_later_fence(kit: Kit) -> None:
    buffer = kit.device.buffer(16)
    buffer.destroy()
    assert not kit.ops(rhi.Op.DESTROY)
    kit.device.finish()
    kit.device.signal()
    assert [command["resource"] for command in kit.ops(rhi.Op.DESTROY)] == [buffer.id]


def test_destroying_twice_destroys_once(kit: Kit) -> None:
    buffer = kit.device.buffer(16)
    buffer.destroy()
    buffer.destroy()
    kit.device.finish()
    kit.device.signal()
    assert len(kit.ops(rhi.Op.DESTROY)) == 1


def test_a_frame_waits_only_when_the_cpu_is_too_far_ahead() -> None:
    with rhi.create_device("null", frames_in_flight=2) as device:
        for _ in range(2):
            device.present()
        assert not [c for c in device.stream if c.op is rhi.Op.WAIT]
