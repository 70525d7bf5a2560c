"""`device.memory()`: the bytes of buffers and textures by kind and label, and the peak."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import SampleFrame, backend_works

import rhi
from rhi import BufferUsage, Device, Format


@pytest.fixture(params=["null", "gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    if not backend_works(request.param):
        pytest.skip(f"no device of {request.param} here")
    with rhi.create_device(request.param) as opened:
        yield opened


TEXELS: Final = sum(max(16 >> i, 1) * max(8 >> i, 1) for i in range(5))
"""Texels of all levels of the image."""


def create_resources(device: Device) -> list[Any]:
    """Create two buffers of 800 bytes together, a stream of 64 bytes, and an image with its levels."""
    buffers = [device.buffer(100, np.float32, label="positions") for _ in range(2)]
    stream = device.buffer(64, usage=BufferUsage.STREAM, label="ring")
    return [*buffers, stream, device.texture((16, 8), Format.RGBA8, levels=None, label="image")]


def test_each_label_has_the_bytes_of_its_resources(device: Device) -> None:
    create_resources(device)
    labels = device.memory().labels
    assert labels["buffers", "positions"] == 800
    assert labels["streams", "ring"] == 64
    assert labels["textures", "image"] == 4 * TEXELS


def test_kinds_and_labels_add_up_to_the_total(device: Device) -> None:
    before = device.memory().total
    create_resources(device)
    memory = device.memory()
    assert memory.total - before == 800 + 64 + 4 * TEXELS
    assert sum(memory.kinds.values()) == sum(memory.labels.values()) == memory.total
    assert memory.kinds["textures"] == 4 * TEXELS


def test_the_text_shows_labels_with_their_bytes(device: Device) -> None:
    create_resources(device)
    text = str(device.memory())
    assert device.backend_name in text
    assert "positions" in text
    assert "800 bytes" in text


def test_the_peak_stays_until_statistics_are_reset(device: Device) -> None:
    before = device.memory().total
    resources = create_resources(device)
    total = device.memory().total
    for resource in resources:
        resource.destroy()
    device.finish()
    memory = device.memory()
    assert memory.total == before
    assert memory.peak >= total
    device.reset_statistics()
    assert device.memory().peak == memory.total


def test_destroyed_resources_count_until_the_device_has_finished(null_device: Device) -> None:
    buffer = null_device.buffer(1000, label="old")
    total = null_device.memory().total
    buffer.destroy()
    memory = null_device.memory()
    assert (memory.total, memory.retired) == (total, 1000)
    assert "destroyed, until" in str(memory)
    null_device.finish()
    memory = null_device.memory()
    assert (memory.total, memory.retired) == (total - 1000, 0)


def test_rings_and_reads_are_in_it(device: Device) -> None:
    frame = SampleFrame(device)
    kinds = device.memory().kinds
    with device.render_pass(depth=frame.map):
        value = frame.light.owner.read()["offset"][0]
        device.draw(frame.shadow, frame.walls, light={"offset": value})
    assert device.memory().kinds.get("streams", 0) > kinds.get("streams", 0)
    reading = device.buffer(np.zeros(4, np.float32)).read_async()
    assert device.memory().kinds.get("readbacks", 0) >= 16
    reading.result()


def test_a_creation_that_fails_counts_nothing(null_device: Device) -> None:
    before = null_device.memory()
    with pytest.raises(rhi.ValidationError):
        null_device.texture((1 << 20, 1 << 20), Format.RGBA8)
    with pytest.raises(rhi.ValidationError):
        null_device.buffer(-1)
    assert null_device.memory().total == before.total


def test_frames_that_repeat_take_no_more_memory(device: Device) -> None:
    frame = SampleFrame(device)
    for _ in range(3):
        frame.render()
    expected = device.memory().total
    device.reset_statistics()
    for _ in range(20):
        frame.render()
    device.finish()
    assert device.memory().total == device.memory().peak == expected


def test_a_closed_device_is_refused(null_device: Device) -> None:
    null_device.close()
    with pytest.raises(rhi.ValidationError, match="device-closed"):
        null_device.memory()


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(st.sampled_from(["buffer", "texture", "destroy", "finish"]), st.integers(1, 50)),
        max_size=30,
    )
)
def test_the_total_is_the_sum_of_living_resources(steps: list[tuple[str, int]]) -> None:
    with rhi.create_device("null") as device:
        living: list[tuple[rhi.Buffer | rhi.Texture, int]] = []
        peak = total = device.memory().total
        waiting = 0
        for kind, number in steps:
            if kind == "buffer":
                living.append((device.buffer(number), number))
                total += number
            elif kind == "texture":
                living.append((device.texture((number, 2), Format.R8), 2 * number))
                total += 2 * number
            elif kind == "destroy" and living:
                resource, size = living.pop(number % len(living))
                resource.destroy()
                waiting += size
            elif kind == "finish":
                device.finish()
                total, waiting = total - waiting, 0
            peak = max(peak, total)
            memory = device.memory()
            assert (memory.total, memory.peak, memory.retired) == (total, peak, waiting)
