"""Rings with a GPU that lags behind: memory that it may still read is never allocated again."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rhi.contract.descriptors import BufferDescriptor
from rhi.device.core.ring import Ring
from rhi.device.core.timeline import Timeline
from rhi.errors import ValidationError


class LaggingGpu:
    """The part of a Backend that rings and timelines use. Fences complete when the test says so."""

    def __init__(self) -> None:
        self.reached = 0
        self.signalled = 0
        self.sizes: dict[int, int] = {}
        self.destroyed: list[int] = []
        self.writes: list[tuple[int, int, int]] = []

    def create_buffer(self, buffer: int, descriptor: BufferDescriptor) -> None:
        self.sizes[buffer] = descriptor.size

    def write_buffer(self, buffer: int, offset: int, data: bytes) -> None:
        self.writes.append((buffer, offset, len(data)))

    def signal(self, value: int) -> None:
        self.signalled = value

    def completed(self) -> int:
        return self.reached

    def wait(self, value: int, seconds: float) -> bool:
        self.reached = max(self.reached, value)
        return True

    def destroy(self, resource: int) -> None:
        self.destroyed.append(resource)


def make_ring(
    capacity: int, limit: int = 1 << 28, *, restarts: bool = False
) -> tuple[Ring, Timeline, LaggingGpu]:
    gpu = LaggingGpu()
    backend: Any = gpu
    timeline = Timeline(backend)
    ids = itertools.count(1)
    ring = Ring(backend, timeline, lambda: next(ids), capacity, "test", limit, restarts=restarts)
    return ring, timeline, gpu


def end_frame(ring: Ring, timeline: Timeline) -> int:
    value = timeline.signal()
    ring.mark(value)
    timeline.collect()
    return value


def test_a_ring_whose_frames_fit_does_not_grow() -> None:
    ring, timeline, gpu = make_ring(1024)
    for _ in range(100):
        ring.allocate(300, 4)
        gpu.reached = end_frame(ring, timeline) - 1
    assert (ring.capacity, ring.generation) == (1024, 0)


def test_a_ring_that_the_gpu_has_not_freed_grows_instead_of_waiting() -> None:
    ring, timeline, gpu = make_ring(1024)
    for _ in range(4):
        ring.allocate(300, 4)
        end_frame(ring, timeline)
    assert ring.generation == 1
    assert ring.capacity == 2048
    assert gpu.reached == 0


def test_the_old_buffer_of_a_grown_ring_is_destroyed_only_after_its_last_use() -> None:
    ring, timeline, gpu = make_ring(256)
    ring.allocate(200, 1)
    old = ring.buffer
    ring.allocate(200, 1)
    end_frame(ring, timeline)
    assert gpu.destroyed == []
    gpu.reached = timeline.signal()
    timeline.collect()
    assert gpu.destroyed == [old]


def test_at_its_limit_a_ring_waits_for_the_oldest_fence() -> None:
    ring, timeline, gpu = make_ring(256, limit=256)
    ring.allocate(200, 1)
    value = end_frame(ring, timeline)
    ring.allocate(200, 1)
    assert gpu.reached == value
    assert ring.capacity == 256


def test_a_frame_that_needs_more_than_the_limit_is_refused() -> None:
    ring, _, _ = make_ring(256, limit=256)
    ring.allocate(200, 1)
    with pytest.raises(ValidationError, match=r"^\[transient-size\]"):
        ring.allocate(200, 1)


def test_a_ring_outgrown_in_mid_frame_lives_to_the_end_of_the_frame() -> None:
    ring, timeline, gpu = make_ring(256)
    ring.allocate(200, 1)
    ring.allocate(200, 1)
    gpu.reached = timeline.signal()
    timeline.collect()
    assert gpu.destroyed == []


def test_a_request_of_the_limit_is_served() -> None:
    ring, _, _ = make_ring(256, limit=1024)
    ring.allocate(1024, 1)
    assert ring.capacity == 1024


def test_a_request_over_the_limit_is_refused() -> None:
    ring, _, _ = make_ring(256, limit=1024)
    with pytest.raises(ValidationError, match=r"^\[transient-size\]"):
        ring.allocate(1025, 1)


@settings(max_examples=200)
@given(
    st.lists(
        st.one_of(
            st.tuples(st.just("write"), st.integers(1, 300), st.sampled_from([1, 4, 12, 16, 20, 256])),
            st.tuples(st.just("frame"), st.integers(0, 3), st.just(0)),
        ),
        max_size=200,
    ),
    st.booleans(),
)
@example(
    [("write", 200, 1), ("frame", 0, 0), ("write", 40, 1), ("write", 100, 1)], False
)  # not across the end
def test_no_write_of_a_ring_touches_memory_that_the_gpu_may_still_read(
    steps: list[tuple[str, int, int]], capped: bool
) -> None:
    ring, timeline, gpu = make_ring(256, limit=2048 if capped else 1 << 28)
    live: list[tuple[int, int, int, int | None]] = []  # buffer, begin, end, fence after which it is free
    for what, number, alignment in steps:
        if what == "frame":
            value = end_frame(ring, timeline)
            live = [(b, s, e, value if f is None else f) for b, s, e, f in live]
            gpu.reached = max(gpu.reached, value - number)
            continue
        try:
            offset = ring.write(bytes(number), number, alignment)
        except ValidationError:  # one frame needs more than the limit
            assert sum(e - s for b, s, e, f in live if f is None and b == ring.buffer) + number > 2048 // 2
            continue
        assert offset % alignment == 0
        assert offset + number <= gpu.sizes[ring.buffer]
        assert ring.buffer not in gpu.destroyed
        live = [allocation for allocation in live if allocation[3] is None or allocation[3] > gpu.reached]
        for buffer, begin, end, _ in live:
            assert buffer != ring.buffer or offset >= end or offset + number <= begin
        live.append((ring.buffer, offset, offset + number, None))


# -- where writes are ordered ------------------------------------------------------------------------------


def test_where_writes_are_ordered_each_frame_begins_at_the_first_byte() -> None:
    """The GPU has passed no frame, and the ring has neither grown nor waited."""
    ring, timeline, gpu = make_ring(1024, restarts=True)
    for _ in range(8):
        assert [ring.allocate(300, 256) for _ in range(2)] == [0, 512]
        end_frame(ring, timeline)
    assert (gpu.reached, list(gpu.sizes.values()), ring.in_use) == (0, [1024], 0)


def test_where_writes_are_ordered_memory_of_a_frame_is_not_allocated_twice_in_it() -> None:
    ring, timeline, gpu = make_ring(256, 512, restarts=True)
    assert [ring.allocate(200, 1) for _ in range(3)] == [0, 0, 200]  # the second in a larger buffer
    assert sorted(gpu.sizes.values()) == [256, 512]
    with pytest.raises(ValidationError, match="transient-size"):
        ring.allocate(200, 1)
    end_frame(ring, timeline)
    assert ring.allocate(512, 1) == 0
