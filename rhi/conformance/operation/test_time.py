"""Fences, frames, deferred destruction, timers, labels. None of these tests draws."""

from __future__ import annotations

import time

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import Access, Device, Format, Op, Region
from rhi.conformance.compare import assert_same
from rhi.conformance.waiting import TIMEOUT, wait_until


def test_signals_count_up(device: Device) -> None:
    first = device.signal()
    assert device.signal() == first + 1
    assert device.signal() == first + 2


def test_completed_reaches_the_signalled_value(device: Device) -> None:
    value = device.signal()
    assert device.wait(value)
    assert device.completed >= value


def test_completed_never_falls_and_never_runs_ahead(device: Device) -> None:
    last = device.completed
    for _ in range(50):
        value = device.signal()
        now = device.completed
        assert last <= now <= value
        last = now
    device.wait(value)
    assert device.completed == value


def test_completed_gets_there_without_a_wait(device: Device) -> None:
    """Polling is enough for a signal to complete, because `signal` submits the work before it."""
    value = device.signal()
    assert wait_until(lambda: device.completed >= value)


def test_a_wait_for_the_past_returns_at_once(device: Device) -> None:
    value = device.signal()
    device.wait(value)
    start = time.monotonic()
    assert device.wait(value, 2 * TIMEOUT)
    assert device.wait(0, 2 * TIMEOUT)
    assert time.monotonic() - start < TIMEOUT


def test_a_wait_of_no_time_says_whether_it_is_done(device: Device) -> None:
    value = device.signal()
    done = device.wait(value, 0)
    assert done in (True, False)
    assert not done or device.completed >= value
    assert device.wait(value)


# -- asynchronous reads ------------------------------------------------------------------------------------


def _texels(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)


def test_an_asynchronous_read_of_a_texture_equals_a_read(device: Device) -> None:
    data = _texels(5, 7)
    with device.texture(data, Format.RGBA8) as texture:
        assert_same(texture.read_async().result(), data)
        assert_same(texture.read_async(region=Region(2, 1, 3, 2)).result(), data[1:3, 2:5])
    with device.texture(data[..., 0], Format.R8, levels=2) as texture:
        assert_same(texture.read_async(level=1).result(), texture.read(1))


def test_an_asynchronous_read_of_a_buffer_equals_a_read(device: Device) -> None:
    data = np.arange(600, dtype=np.uint32).reshape(-1)
    with device.buffer(data) as buffer:
        assert_same(buffer.read_async().result(), data)
        assert_same(buffer.read_async(7, 5).result(), data[7:12])
        assert buffer.read_async(3, 0).result().shape == (0,)


def test_an_asynchronous_read_is_of_the_moment_of_its_call(device: Device) -> None:
    data = _texels(4, 4)
    texture, buffer = device.texture(data, Format.RGBA8), device.buffer(data.reshape(-1))
    reads = texture.read_async(), buffer.read_async()
    texture.write(np.zeros_like(data))
    buffer.clear(0)
    texture.destroy()
    buffer.destroy()
    device.present()
    assert_same(reads[0].result(), data)
    assert_same(reads[1].result(), data.reshape(-1))


def test_an_asynchronous_read_is_done_without_a_wait(device: Device) -> None:
    """Polling is enough, because the read submits the work before it."""
    data = _texels(64, 64)
    with device.texture(data, Format.RGBA8) as texture:
        read = texture.read_async()
        assert wait_until(lambda: read.done)
        assert device.completed >= read.fence
        assert_same(read.result(), data)
        assert read.done


def test_many_asynchronous_reads_do_not_mix(device: Device) -> None:
    with device.texture((8, 8), Format.RGBA8) as texture:
        reads = []
        for value in range(40):
            texture.write(np.full((8, 8, 4), value, np.uint8))
            reads.append(texture.read_async(region=Region(0, 0, 1 + value % 8, 8)))
        for value in (*range(39, -1, -3), *range(40)):
            assert_same(reads[value].result(), value)


def test_waits_for_several_values_in_any_order(device: Device) -> None:
    values = [device.signal() for _ in range(5)]
    for value in reversed(values):
        assert device.wait(value)
    for value in values:
        assert device.wait(value)


def test_a_fence_is_passed_only_after_the_work_before_it(device: Device) -> None:
    with device.buffer(1 << 16) as a, device.buffer(1 << 16) as b:
        a.clear(0x01010101)
        a.copy_to(b)
        device.wait(device.signal())
        assert_same(b.read(0, 16), 1)


def test_finish_completes_everything(device: Device) -> None:
    value = device.signal()
    device.finish()
    assert device.completed >= value


# -- frames ------------------------------------------------------------------------------------------------


def test_a_frame_may_show_an_image_or_none(device: Device) -> None:
    with device.texture((4, 4), Format.RGBA8) as image:
        with device.render_pass(image, clear=(1, 1, 1, 1)):
            pass
        device.present(image)
        device.present()
        assert_same(image.read(), 255)


def test_present_ends_the_frame_in_the_stream(recording: Device) -> None:
    since = len(recording.stream)
    with recording.texture((4, 4), Format.RGBA8) as image:
        recording.present(image)
        (present,) = recording.stream[since:].filter(Op.PRESENT)
        assert present["texture"] == image.id


def test_the_cpu_stays_a_few_frames_ahead_at_most(backend: str) -> None:
    with rhi.create_device(backend, frames_in_flight=2) as device:
        ends = []
        for _ in range(10):
            device.present()
            ends.append(device.signal())
            if len(ends) > 3:
                assert device.completed >= ends[-4], "frame n can't begin before frame n - 2 is done"


# -- destruction -------------------------------------------------------------------------------------------


def test_a_resource_is_destroyed_after_the_work_that_uses_it(recording: Device) -> None:
    recording.finish()
    since = len(recording.stream)
    with recording.buffer(np.full(64, 7, "u4")) as source, recording.buffer(64, np.dtype("u4")) as target:
        source.copy_to(target)
        source.destroy()
        assert_same(target.read(), 7)
    recording.finish()
    destroyed = [command["resource"] for command in recording.stream[since:].filter(Op.DESTROY)]
    assert sorted(destroyed) == sorted([source.id, target.id])
    copies = recording.stream[since:].filter(Op.COPY_BUFFER)
    destroys = recording.stream[since:].filter(Op.DESTROY)
    assert copies[0].index < destroys[0].index


def test_nothing_is_destroyed_twice(recording: Device) -> None:
    recording.finish()
    since = len(recording.stream)
    buffer = recording.buffer(4)
    buffer.destroy()
    buffer.destroy()
    for _ in range(3):
        recording.finish()
    ids = [command["resource"] for command in recording.stream[since:].filter(Op.DESTROY)]
    assert ids == [buffer.id]


def test_ids_are_never_used_twice(device: Device) -> None:
    seen: set[int] = set()
    for _ in range(20):
        with device.buffer(4) as buffer, device.texture((1, 1), Format.R8) as texture:
            assert not seen & {buffer.id, texture.id}
            seen |= {buffer.id, texture.id}
        device.finish()


# -- timers and labels -------------------------------------------------------------------------------------


def frame(device: Device) -> None:
    with device.event("frame"):
        with device.event("first"), device.buffer(1 << 12) as buffer:
            buffer.clear(1)
        with device.event("second"):
            with device.event("part"):
                pass
            with device.event("part"):
                pass


@pytest.mark.requires("timestamps")
def test_timers_form_a_tree(device: Device) -> None:
    device.present()
    frame(device)
    device.present()
    device.finish()
    (root,) = device.timers
    assert root.name == "frame"
    assert [child.name for child in root.children] == ["first", "second"]
    assert [child.name for child in root.children[1].children] == ["part", "part"]


@pytest.mark.requires("timestamps")
def test_times_of_parts_fit_into_those_of_the_whole(device: Device) -> None:
    device.present()
    frame(device)
    device.present()
    device.finish()
    (root,) = device.timers
    assert root.gpu_milliseconds >= 0
    assert sum(child.gpu_milliseconds for child in root.children) <= root.gpu_milliseconds + SLACK
    assert sum(child.cpu_milliseconds for child in root.children) <= root.cpu_milliseconds + SLACK


@pytest.mark.requires("timestamps")
def test_work_takes_time(device: Device) -> None:
    """As much work as a coarse clock needs to see it."""
    repetitions, measured = 1, 0.0
    with device.buffer(1 << 22) as buffer:
        while not measured and repetitions < 1 << 12:
            device.present()
            with device.event("work"):
                for value in range(repetitions):
                    buffer.clear(value)
            device.present()
            device.finish()
            measured = device.timers[0].gpu_milliseconds
            repetitions *= 4
    assert measured > 0


SLACK = 1e-3
"""Milliseconds: timestamps may have a granularity of one microsecond."""


def list_nodes(root: rhi.TimerNode) -> list[rhi.TimerNode]:
    """The nodes of a frame's tree."""
    return [root, *root.children, *root.children[1].children]


@pytest.fixture
def dated_frames(device: Device) -> list[rhi.TimerNode]:
    """The timers of three frames on a backend that dates timestamps. Each frame is waited for before the
    next."""
    roots: list[rhi.TimerNode] = []
    for _ in range(3):
        device.present()
        frame(device)
        device.present()
        device.finish()
        roots += device.timers
    if roots[0].cpu_span is None:
        pytest.skip("the backend doesn't date timestamps")
    return roots


@pytest.mark.requires("timestamps")
def test_all_timers_are_dated_or_none_is(device: Device) -> None:
    for _ in range(3):
        device.present()
        frame(device)
        device.present()
        device.finish()
        nodes = [node for root in device.timers for node in list_nodes(root)]
        assert len({node.cpu_span is None for node in nodes} | {node.gpu_span is None for node in nodes}) == 1


@pytest.mark.requires("timestamps")
def test_spans_end_after_they_begin(dated_frames: list[rhi.TimerNode]) -> None:
    for root in dated_frames:
        for node in list_nodes(root):
            for span in (node.cpu_span, node.gpu_span):
                assert span is not None
                assert span[0] <= span[1]


@pytest.mark.requires("timestamps")
def test_work_is_executed_after_it_is_issued(dated_frames: list[rhi.TimerNode]) -> None:
    for root in dated_frames:
        for node in list_nodes(root):
            assert node.cpu_span is not None
            assert node.gpu_span is not None
            for issued, executed in zip(node.cpu_span, node.gpu_span, strict=True):
                assert issued <= executed + SLACK


@pytest.mark.requires("timestamps")
def test_work_issued_after_a_wait_comes_after_all_that_was_waited_for(
    dated_frames: list[rhi.TimerNode],
) -> None:
    finished = 0.0
    for root in dated_frames:
        for node in list_nodes(root):
            assert node.cpu_span is not None
            assert finished <= node.cpu_span[0] + SLACK
        assert root.gpu_span is not None
        finished = root.gpu_span[1]


@pytest.mark.requires("timestamps")
def test_a_gpu_span_lasts_as_long_as_its_timer_measures(dated_frames: list[rhi.TimerNode]) -> None:
    for root in dated_frames:
        for node in list_nodes(root):
            assert node.gpu_span is not None
            assert abs(node.gpu_span[1] - node.gpu_span[0] - node.gpu_milliseconds) < SLACK


@pytest.mark.requires("timestamps")
def test_a_formatted_timer_has_its_gpu_span(dated_frames: list[rhi.TimerNode]) -> None:
    for root in dated_frames:
        for node in list_nodes(root):
            assert node.gpu_span is not None
            assert f"gpu {node.gpu_span[0]:.3f} … {node.gpu_span[1]:.3f} ms" in node.format()


@pytest.mark.requires("timestamps")
def test_each_frame_has_a_tree_of_its_own(device: Device) -> None:
    for name in ("one", "two", "three"):
        with device.event(name):
            pass
        device.present()
        device.finish()
        assert [node.name for node in device.timers] == [name]


def test_events_without_timing_are_labels_only(recording: Device) -> None:
    since = len(recording.stream)
    frame(recording)
    ops = [command.op for command in recording.stream[since:]]
    assert ops.count(Op.PUSH_LABEL) == ops.count(Op.POP_LABEL) == 5
    assert Op.WRITE_QUERY not in ops


def test_timing_can_be_switched(backend: str) -> None:
    with rhi.create_device(backend) as device:
        if not device.capabilities.timestamps:
            pytest.skip(f"{backend} declares no timestamps")
        assert not device.timing
        device.timing = True
        with device.event("timed"):
            pass
        device.present()
        device.finish()
        assert [node.name for node in device.timers] == ["timed"]


# -- devices -----------------------------------------------------------------------------------------------


def test_two_devices_live_side_by_side(device: Device, backend: str) -> None:
    with device.buffer(np.full(8, 1, "u4")) as mine, rhi.create_device(backend) as other:
        with other.buffer(np.full(8, 2, "u4")) as theirs:
            mine.write(np.full(8, 3, "u4"))
            theirs.write(np.full(4, 4, "u4"), 4)
            assert_same(mine.read(), 3)
            assert_same(theirs.read(), [2, 2, 2, 2, 4, 4, 4, 4])
        with device.texture((2, 2), Format.RGBA8) as image, other.texture((2, 2), Format.RGBA8) as image2:
            with device.render_pass(image, clear=(1, 1, 1, 1)), other.render_pass(image2, clear=(0, 0, 0, 1)):
                pass
            assert_same(image.read(), 255)
            assert_same(image2.read(), (0, 0, 0, 255))
    with device.buffer(np.full(8, 5, "u4")) as buffer:
        assert_same(buffer.read(), 5)


def test_a_closed_device_leaves_others_alone(device: Device, backend: str) -> None:
    with device.buffer(np.full(8, 1, "u4")) as mine:
        with rhi.create_device(backend):
            pass
        with mine.lock(Access.READ_WRITE) as array:
            array += 1
        assert_same(mine.read(), 2)


def test_devices_come_and_go(backend: str) -> None:
    for number in range(3):
        with rhi.create_device(backend) as device, device.buffer(np.full(4, number, "u4")) as buffer:
            assert_same(buffer.read(), number)


def test_a_device_says_the_name_of_its_backend(device: Device, backend: str) -> None:
    assert device.backend_name == device.capabilities.backend
    assert device.backend_name == backend or ":" in backend  # module:function, not installed
    assert device.capabilities.device


def test_a_device_has_the_least_limits_of_the_contract(device: Device) -> None:
    assert device.capabilities.max_texture_size >= 4096
    assert device.capabilities.max_color_targets >= 4


@pytest.mark.parametrize("limit", ["uniform_alignment", "storage_alignment"])
def test_an_alignment_is_a_power_of_two(device: Device, limit: str) -> None:
    alignment = getattr(device.capabilities, limit)
    assert alignment & (alignment - 1) == 0
