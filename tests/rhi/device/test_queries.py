"""Queries and timers on the null device: their state machine, and the commands they become."""

from __future__ import annotations

import pytest
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


def test_a_query_outside_a_pass_is_refused(kit: Kit) -> None:
    with pytest.raises(rhi.ValidationError) as caught:
        kit.device.occlusion_query().begin()
    assert caught.value.rule.id == "draw-outside-pass"


def test_a_second_open_query_is_refused(kit: Kit) -> None:
    first, second = kit.device.occlusion_query(), kit.device.occlusion_query()
    with kit.device.render_pass(kit.image), first, pytest.raises(rhi.ValidationError) as caught:
        second.begin()
    assert caught.value.rule.id == "query-nested"


def test_one_query_after_another_is_allowed(kit: Kit) -> None:
    first, second = kit.device.occlusion_query(), kit.device.occlusion_query()
    with kit.device.render_pass(kit.image):
        with first:
            pass
        with second:
            pass
    assert len(kit.ops(Op.END_QUERY)) == 2


def test_ending_a_query_that_was_not_begun_is_refused(kit: Kit) -> None:
    with pytest.raises(rhi.ValidationError) as caught:
        kit.device.occlusion_query().end()
    assert caught.value.rule.id == "query-state"


@pytest.mark.parametrize("ask", [lambda q: q.visible_samples, lambda q: q.wait()])
def test_the_answer_of_a_query_never_begun_is_refused(kit: Kit, ask: object) -> None:
    query = kit.device.occlusion_query()
    assert not query.is_finished
    with pytest.raises(rhi.ValidationError) as caught:
        ask(query)  # type: ignore[operator]
    assert caught.value.rule.id == "query-state"


def test_a_query_left_open_at_the_end_of_its_pass_is_ended_and_reported(kit: Kit) -> None:
    query = kit.device.occlusion_query()
    with pytest.raises(rhi.ValidationError) as caught, kit.device.render_pass(kit.image):
        query.begin()
    assert caught.value.rule.id == "query-state"
    with kit.device.render_pass(kit.image), query:  # and can be used again
        pass
    assert len(kit.ops(Op.END_QUERY)) == 2


def test_an_emulated_query_cannot_make_draws_conditional(kit: Kit) -> None:
    query = kit.device.occlusion_query(emulated=True)
    with pytest.raises(rhi.ValidationError) as caught:
        kit.device.conditional(query)
    assert caught.value.rule.id == "device-capability"


def test_timers_form_a_tree_of_the_events_inside_each_other() -> None:
    with rhi.create_device("null", timing=True) as device:
        with device.event("frame"):
            with device.event("shadows"):
                pass
            with device.event("lights"):
                pass
        device.present()
        device.finish()
        (root,) = device.timers
    assert root.name == "frame"
    assert [child.name for child in root.children] == ["shadows", "lights"]
    assert root.gpu_milliseconds >= sum(child.gpu_milliseconds for child in root.children) > 0


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
    assert 0 < first.gpu_milliseconds < inner.gpu_milliseconds < between.gpu_milliseconds < second.gpu_milliseconds


def test_without_timing_events_take_no_timestamps(kit: Kit) -> None:
    with kit.device.event("frame"):
        pass
    kit.device.present()
    assert not kit.ops(Op.WRITE_QUERY)
    assert [c["text"] for c in kit.ops(Op.PUSH_LABEL)] == ["frame"]


def test_timestamps_are_used_again_by_later_frames() -> None:
    with rhi.create_device("null", timing=True) as device:
        for _ in range(20):
            with device.event("frame"):
                pass
            device.present()
        created = [c for c in device.stream if c.op is Op.CREATE_QUERY]
    assert len(created) <= 6


def test_events_left_in_the_wrong_order_are_refused(kit: Kit) -> None:
    outer, inner = kit.device.event("outer"), kit.device.event("inner")
    outer.__enter__()
    inner.__enter__()
    with pytest.raises(rhi.ValidationError) as caught:
        outer.__exit__(None, None, None)
    assert caught.value.rule.id == "scope-order"
    inner.__exit__(None, None, None)
    assert len(kit.ops(Op.POP_LABEL)) == 2  # the outer event ends with the inner one
