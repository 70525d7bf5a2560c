"""Queries and timers on the null device: the commands they become. What is refused, `refusals` shows."""

from __future__ import annotations

from null_kit import Kit

import rhi
from rhi import Op


def test_a_native_query_is_a_begin_and_an_end(kit: Kit) -> None:
    query = kit.device.occlusion_query()
    with kit.device.render_pass(kit.image), query:
        pass
    assert [c["query"] for c in kit.ops(Op.BEGIN_QUERY, Op.END_QUERY)] == [query.id, query.id]


def test_an_emulated_query_takes_the_counter_at_two_fence_values(kit: Kit) -> None:
    query = kit.device.occlusion_query(emulated=True)
    with kit.device.render_pass(kit.image), query:
        pass
    ops = [c.op for c in kit.ops(Op.WRITE_QUERY, Op.SIGNAL)]
    assert ops == [Op.WRITE_QUERY, Op.SIGNAL, Op.WRITE_QUERY, Op.SIGNAL]


def test_an_event_entered_again_is_timed_each_time() -> None:
    with rhi.create_device("null", timing=True) as device:
        event = device.event("step")
        with event:
            pass
        with event, device.event("between"), event:
            device.signal()
        device.present()
        first, second = device.timers
        (between,) = second.children
        (inner,) = between.children
    assert [node.name for node in (first, second, between, inner)] == ["step", "step", "between", "step"]
    assert (
        0
        < first.gpu_milliseconds
        < inner.gpu_milliseconds
        < between.gpu_milliseconds
        < second.gpu_milliseconds
    )


def test_timestamps_are_used_again_by_later_frames() -> None:
    with rhi.create_device("null", timing=True) as device:
        for _ in range(20):
            with device.event("frame"):
                pass
            device.present()
        created = [c for c in device.stream if c.op is Op.CREATE_QUERY]
    assert len(created) <= 6
