"""Asynchronous reads: their memory, their fences, and what they put into a stream."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rhi
from rhi import Device, Format, Op
from rhi.backends.null import Simulation
from rhi.conformance.compare import assert_same
from rhi.conformance.validation.refusal import refuses
from rhi.device.core.readback_pool import LIMIT
from rhi.errors import rules
from rhi.trace import load, replay, save

PAGE = 4096


def _numbered(device: Device, count: int) -> rhi.Buffer:
    return device.buffer(np.arange(count, dtype=np.uint32))


def test_reads_of_one_size_in_each_frame_use_the_same_memory() -> None:
    with rhi.create_device("null") as device:
        texture = device.texture((64, 64), Format.RGBA8)
        for _ in range(20):
            texture.read_async().result()
        created = device.stream.filter(Op.CREATE_BUFFER)
        assert len(created) == 1
        assert created[0]["descriptor"].usage is rhi.BufferUsage.READBACK


def test_reads_in_flight_have_memory_of_their_own() -> None:
    with rhi.create_device("null") as device:
        buffer = _numbered(device, 1000)
        reads = [buffer.read_async() for _ in range(3)]
        assert len(device.stream.filter(Op.CREATE_BUFFER)) == 4
        for read in reads:
            assert_same(read.result(), np.arange(1000))


def test_a_result_is_fetched_once() -> None:
    with rhi.create_device("null") as device:
        read = _numbered(device, 10).read_async()
        first = read.result()
        assert read.result() is first
        assert first.flags.writeable
        assert len(device.stream.filter(Op.READ_BUFFER)) == 1


@pytest.mark.parametrize("pages", [1, 3])
def test_memory_in_flight_is_bounded_and_no_result_is_lost(pages: int) -> None:
    with rhi.create_device("null") as device:
        pool = device._core.readbacks
        pool.limit = 4 * PAGE
        buffer = _numbered(device, pages * PAGE // 4)
        reads = []
        for value in range(12):
            buffer.write(np.full(4, value, np.uint32))
            reads.append(buffer.read_async())
            assert pool.allocated <= pool.limit
        for value, read in enumerate(reads):
            assert_same(read.result()[:4], value)
            assert_same(read.result()[4:], np.arange(4, pages * PAGE // 4))


def test_a_read_larger_than_the_limit_gets_its_memory_alone() -> None:
    with rhi.create_device("null") as device:
        pool = device._core.readbacks
        pool.limit = PAGE
        small, large = _numbered(device, 4), _numbered(device, 2 * PAGE)
        reads = small.read_async(), large.read_async()
        assert pool.allocated == 8 * PAGE
        assert reads[0].done
        assert_same(reads[1].result(), np.arange(2 * PAGE))
        assert LIMIT > PAGE


def test_the_memory_of_dropped_reads_is_used_again() -> None:
    with rhi.create_device("null") as device:
        buffer = _numbered(device, 100)
        for _ in range(50):
            buffer.read_async()
        assert device._core.readbacks.allocated <= 3 * PAGE


def test_dropped_reads_that_are_still_in_flight_are_waited_for_at_the_limit() -> None:
    """On a device that is late, memory is not used again before its fence."""
    with rhi.create_device("null", simulation=Simulation(submission_latency=10**9)) as device:
        device._core.readbacks.limit = 2 * PAGE
        buffer = _numbered(device, 100)
        for _ in range(6):
            buffer.read_async()
        assert device._core.readbacks.allocated <= 2 * PAGE
        assert_same(buffer.read_async().result(), np.arange(100))
        assert device.backend_as(rhi.backends.null.SimulatedBackend).hazards == ()


def test_a_late_device_is_not_done_until_its_fence() -> None:
    with rhi.create_device("null", simulation=Simulation(submission_latency=10**6)) as device:
        backend = device.backend_as(rhi.backends.null.SimulatedBackend)
        texture = device.texture(np.full((4, 4), 9, np.uint8), Format.R8)
        read = texture.read_async()
        assert not read.done
        assert device.completed < read.fence
        backend.spend(10**7)
        assert read.done
        before = backend.now
        assert_same(read.result(), 9)
        assert backend.now - before < 10**5  # no wait for anything
        assert backend.hazards == ()


def test_a_backend_that_read_before_its_fence_has_a_hazard() -> None:
    """Control of the test above: the read of the memory itself, without the wait."""
    with rhi.create_device("null", simulation=Simulation(submission_latency=10**6)) as device:
        backend = device.backend_as(rhi.backends.null.SimulatedBackend)
        read = device.texture((4, 4), Format.R8).read_async()
        backend.read_buffer(read._memory, 0, 16)
        (hazard,) = backend.hazards
        assert hazard.kind is rhi.backends.null.HazardKind.READ_IN_USE
        assert hazard.happened
        assert hazard.calls == ("copy_texture_to_buffer", "read_buffer")


def test_a_closed_device_has_only_fetched_results() -> None:
    with rhi.create_device("null") as device:
        buffer = _numbered(device, 4)
        fetched, other = buffer.read_async(), buffer.read_async()
        fetched.result()
    assert_same(fetched.result(), np.arange(4))
    assert fetched.done
    for call in (other.result, lambda: other.done):
        with pytest.raises(rhi.ValidationError, match=r"^\[device-closed\]"):
            call()


def test_without_copies_a_texture_is_read_at_once() -> None:
    profile = rhi.Capabilities("null", "plain", "1", shading=False)
    assert not profile.texture_buffer_copies
    with rhi.create_device("null", profile=profile) as device:
        texture = device.texture(np.full((2, 3), 5, np.uint8), Format.R8)
        read = texture.read_async()
        assert read.done
        texture.write(np.zeros((2, 3), np.uint8))
        assert_same(read.result(), np.full((2, 3), 5))
        buffer = device.buffer(64)
        with refuses(rules.DEVICE_CAPABILITY, device):
            texture.copy_to_buffer(buffer)


def test_elements_that_the_device_cannot_copy_are_read_at_once() -> None:
    profile = rhi.Capabilities("null", "words", "1", shading=False, copy_alignment=4)
    with rhi.create_device("null", profile=profile) as device:
        buffer = device.buffer(np.arange(16, dtype=np.uint8))
        assert_same(buffer.read_async(4, 8).result(), np.arange(4, 12))
        assert len(device.stream.filter(Op.COPY_BUFFER)) == 1
        for first, count in ((1, 4), (4, 3)):
            read = buffer.read_async(first, count)
            assert read.done
            assert_same(read.result(), np.arange(first, first + count))
        assert len(device.stream.filter(Op.COPY_BUFFER)) == 1


def test_rows_are_as_far_apart_as_the_device_needs() -> None:
    profile = rhi.Capabilities(
        "null", "rows", "1", shading=False, texture_buffer_copies=True, copy_row_alignment=256
    )
    data = np.random.default_rng(0).integers(0, 256, (5, 7, 4), np.uint8)
    with rhi.create_device("null", profile=profile) as device:
        texture = device.texture(data, Format.RGBA8)
        assert_same(texture.read_async().result(), data)
        (copy,) = device.stream.filter(Op.COPY_TEXTURE_TO_BUFFER)
        assert copy["row_bytes"] == 256
        buffer = device.buffer(4096)
        with refuses(rules.BUFFER_ALIGNMENT, device):
            texture.copy_to_buffer(buffer, row_bytes=28)


def test_copies_in_a_command_buffer_read_the_data_of_its_submission() -> None:
    with rhi.create_device("null") as device:
        source, target = (device.texture((2, 2), Format.RGBA8) for _ in range(2))
        buffer = device.buffer(64)
        with device.record() as commands:
            commands.copy_texture_to_buffer(source, buffer, offset=16)
            commands.copy_buffer_to_texture(buffer, target, offset=16)
        for value in (3, 4):
            source.write(np.full((2, 2, 4), value, np.uint8))
            device.submit(commands)
            assert_same(target.read(), value)
        buffer.destroy()
        with refuses(rules.RESOURCE_DESTROYED, device):
            device.submit(commands)


def test_a_trace_with_reads_is_replayed(tmp_path: Path) -> None:
    data = np.random.default_rng(0).integers(0, 256, (5, 7, 4), np.uint8)
    with rhi.create_device("null") as device:
        texture = device.texture(data, Format.RGBA8)
        texture.read_async().result()
        buffer, copy = device.buffer(256), device.texture((7, 5), Format.RGBA8)
        texture.copy_to_buffer(buffer)
        copy.copy_from_buffer(buffer)
        device.present(copy)
        save(device, tmp_path / "trace.zip")
    with rhi.create_device("null") as device:
        image = replay(load(tmp_path / "trace.zip"), on=device).image
    assert image is not None
    assert_same(image, data)
    plain = rhi.Capabilities("null", "plain", "1", shading=False)
    with rhi.create_device("null", profile=plain) as device, pytest.raises(rhi.ValidationError) as caught:
        replay(load(tmp_path / "trace.zip"), on=device)
    assert caught.value.rule.id == "trace-capability"
