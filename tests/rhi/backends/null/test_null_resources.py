"""Buffers and textures of the null backend: writes, reads, copies, clears, in order."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhi.backends.null import create_backend
from rhi.backends.null.null_backend import QUEUED_BYTES
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Region, TextureDescriptor
from rhi.contract.formats import Format
from rhi.errors import DeviceError

BY_NAME = {"ids": lambda f: f.name}


@pytest.fixture
def backend():
    return create_backend()


def texture(backend, id, size=(4, 4), format=Format.R8, **rest):
    descriptor = TextureDescriptor(size, format, **rest)
    backend.create_texture(id, descriptor)
    return descriptor


def whole(descriptor, level=0):
    width, height = descriptor.level_size(level)
    return Region(0, 0, width, height, 0, descriptor.level_layers(level))


# -- buffers ---------------------------------------------------------------------------------------------


def test_data_read_from_a_texture_do_not_change_with_later_writes(backend):
    descriptor = texture(backend, 1)
    before = backend.read_texture(1, 0, whole(descriptor), False)
    backend.write_texture(1, 0, whole(descriptor), bytes([3]) * 16)
    backend.signal(1)
    assert not before.any()


@pytest.mark.parametrize("value", [0x01020304, 0xFFFFFFFF, 0, -2])
def test_a_clear_repeats_32_bits(backend, value):
    backend.create_buffer(1, BufferDescriptor(14))
    backend.clear_buffer(1, 4, 8, value)
    pattern = (value & 0xFFFFFFFF).to_bytes(4, "little")
    assert backend.read_buffer(1, 0, 14) == bytes(4) + pattern * 2 + bytes(2)


def test_stream_memory_is_written_at_once(backend):
    backend.create_buffer(1, BufferDescriptor(4, BufferUsage.STREAM))
    backend.create_buffer(2, BufferDescriptor(4))
    backend.write_buffer(1, 0, b"1111")
    backend.copy_buffer(1, 0, 2, 0, 4)
    backend.write_buffer(1, 0, b"2222")  # too early: the copy isn't done
    assert backend.read_buffer(2, 0, 4) == b"2222"


def test_stream_memory_written_after_a_fence_is_safe(backend):
    backend.create_buffer(1, BufferDescriptor(4, BufferUsage.STREAM))
    backend.create_buffer(2, BufferDescriptor(4))
    backend.write_buffer(1, 0, b"1111")
    backend.copy_buffer(1, 0, 2, 0, 4)
    backend.signal(1)
    assert backend.completed() == 1
    backend.write_buffer(1, 0, b"2222")
    assert backend.read_buffer(2, 0, 4) == b"1111"


def test_memory_waiting_in_the_queue_is_bounded(backend):
    backend.create_buffer(1, BufferDescriptor(QUEUED_BYTES))
    data = bytes(QUEUED_BYTES // 2)
    for _ in range(5):
        backend.write_buffer(1, 0, data)
        assert sum(len(part) for part in backend._queue if isinstance(part, bytes)) <= QUEUED_BYTES


def test_too_large_a_resource_is_out_of_memory_and_leaves_the_backend_usable(backend):
    with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
        backend.create_buffer(1, BufferDescriptor(1 << 62))
    with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
        texture(backend, 2, (1 << 30, 1 << 30))
    backend.create_buffer(1, BufferDescriptor(1))
    assert backend.read_buffer(1, 0, 1) == b"\0"


def test_a_destroyed_resource_was_there_for_the_commands_before(backend):
    for buffer in (1, 2):
        backend.create_buffer(buffer, BufferDescriptor(4))
    backend.write_buffer(1, 0, b"abcd")
    backend.copy_buffer(1, 0, 2, 0, 4)
    backend.destroy(1)
    assert backend.read_buffer(2, 0, 4) == b"abcd"
    with pytest.raises(KeyError):
        backend.read_buffer(1, 0, 4)


OPERATIONS = st.lists(
    st.tuples(
        st.sampled_from(["write", "copy", "clear", "run"]),
        st.integers(0, 7),
        st.integers(0, 7),
        st.integers(0, 255),
    ),
    max_size=30,
)


@given(OPERATIONS)
@settings(max_examples=100)
def test_the_queue_makes_no_difference_to_memory(operations):
    backend, models = create_backend(), {1: bytearray(32), 2: bytearray(32)}
    for buffer in models:
        backend.create_buffer(buffer, BufferDescriptor(32))
    for fence, (kind, a, b, value) in enumerate(operations):
        buffer = 1 + value % 2
        if kind == "write":
            backend.write_buffer(buffer, a * 4, bytes([value]) * 3)
            models[buffer][a * 4 : a * 4 + 3] = bytes([value]) * 3
        elif kind == "copy":
            backend.copy_buffer(buffer, a * 4, 3 - buffer, b * 4, 4)
            models[3 - buffer][b * 4 : b * 4 + 4] = models[buffer][a * 4 : a * 4 + 4]
        elif kind == "clear":
            backend.clear_buffer(buffer, a * 4, 4, value)
            models[buffer][a * 4 : a * 4 + 4] = value.to_bytes(4, "little")
        else:
            backend.signal(fence + 1)
    for buffer, model in models.items():
        assert backend.read_buffer(buffer, 0, 32) == model
