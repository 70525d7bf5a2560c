"""Buffers and textures of the null backend: writes, reads, copies, clears, in order."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhi.backends.null import create_backend
from rhi.backends.null.backend import QUEUED_BYTES
from rhi.contract.descriptors import (
    Attachment,
    BufferDescriptor,
    BufferUsage,
    DepthAttachment,
    PassDescriptor,
    Region,
    TextureDescriptor,
    TextureKind,
)
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, Format
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


def test_a_buffer_starts_as_zeros(backend):
    backend.create_buffer(1, BufferDescriptor(5))
    assert backend.read_buffer(1, 0, 5) == bytes(5)


def test_what_is_written_can_be_read_in_part(backend):
    backend.create_buffer(1, BufferDescriptor(8))
    backend.write_buffer(1, 2, np.array([1, 2], np.uint16))
    assert backend.read_buffer(1, 0, 8) == bytes([0, 0, 1, 0, 2, 0, 0, 0])
    assert backend.read_buffer(1, 4, 1) == b"\2"


def test_the_writers_array_may_change_after_the_call(backend):
    backend.create_buffer(1, BufferDescriptor(4))
    data = np.full(4, 7, np.uint8)
    backend.write_buffer(1, 0, data)
    data[:] = 9
    assert backend.read_buffer(1, 0, 4) == b"\7\7\7\7"


def test_what_was_read_stays_as_it_was(backend):
    descriptor = texture(backend, 1)
    before = backend.read_texture(1, 0, whole(descriptor), False)
    backend.write_texture(1, 0, whole(descriptor), bytes([3]) * 16)
    backend.signal(1)
    assert not before.any()


def test_a_copy_takes_what_was_there_at_its_place_in_the_stream(backend):
    for buffer in (1, 2):
        backend.create_buffer(buffer, BufferDescriptor(4))
    backend.write_buffer(1, 0, b"aaaa")
    backend.copy_buffer(1, 1, 2, 0, 2)
    backend.write_buffer(1, 0, b"bbbb")
    assert backend.read_buffer(2, 0, 4) == b"aa\0\0"
    assert backend.read_buffer(1, 0, 4) == b"bbbb"


def test_a_copy_may_stay_within_one_buffer(backend):
    backend.create_buffer(1, BufferDescriptor(8))
    backend.write_buffer(1, 0, b"abcdefgh")
    backend.copy_buffer(1, 0, 1, 4, 4)
    assert backend.read_buffer(1, 0, 8) == b"abcdabcd"


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
    with pytest.raises(DeviceError) as caught:
        backend.create_buffer(1, BufferDescriptor(1 << 62))
    assert caught.value.rule.id == "device-out-of-memory"
    with pytest.raises(DeviceError) as caught:
        texture(backend, 2, (1 << 30, 1 << 30))
    assert caught.value.rule.id == "device-out-of-memory"
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
    st.tuples(st.sampled_from(["write", "copy", "clear", "run"]), st.integers(0, 7), st.integers(0, 7),
              st.integers(0, 255)), max_size=30,
)  # fmt: skip


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


# -- textures --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", list(Format), **BY_NAME)
def test_a_texture_of_any_format_starts_as_zeros(backend, format):
    descriptor = texture(backend, 1, (5, 3), format, levels=2)
    for level, shape in ((0, (1, 3, 5)), (1, (1, 1, 2))):
        texels = backend.read_texture(1, level, whole(descriptor, level), False)
        assert texels.shape == (*shape, format.components)
        assert texels.dtype == format.dtype
        assert not texels.any()


@pytest.mark.parametrize("format", COLOR_FORMATS, **BY_NAME)
def test_texels_of_any_color_format_can_be_written_and_read(backend, format):
    descriptor = texture(backend, 1, (5, 3), format)
    raw = np.random.default_rng(0).integers(0, 256, 3 * 5 * format.texel_bytes, np.uint8)
    backend.write_texture(1, 0, whole(descriptor), raw)
    assert backend.read_texture(1, 0, whole(descriptor), False).tobytes() == raw.tobytes()


@pytest.mark.parametrize(
    ("kind", "layers", "shapes"),
    [
        (TextureKind.D2, 1, [(1, 4, 8), (1, 2, 4), (1, 1, 2)]),
        (TextureKind.D2_ARRAY, 3, [(3, 4, 8), (3, 2, 4), (3, 1, 2)]),
        (TextureKind.CUBE, 6, [(6, 4, 8), (6, 2, 4), (6, 1, 2)]),
        (TextureKind.D3, 5, [(5, 4, 8), (2, 2, 4), (1, 1, 2)]),
    ],
)
def test_levels_have_the_sizes_of_their_kind(backend, kind, layers, shapes):
    descriptor = texture(backend, 1, (8, 4), Format.R8, kind=kind, layers=layers, levels=3)
    for level, shape in enumerate(shapes):
        assert backend.read_texture(1, level, whole(descriptor, level), False).shape == (*shape, 1)


def test_a_region_is_written_and_nothing_else(backend):
    descriptor = texture(backend, 1, (4, 3), Format.RG8, kind=TextureKind.D2_ARRAY, layers=3)
    region = Region(1, 2, 2, 1, 1, 2)
    data = np.arange(1, 9, dtype=np.uint8).reshape(2, 1, 2, 2)
    backend.write_texture(1, 0, region, data)
    expected = np.zeros((3, 3, 4, 2), np.uint8)
    expected[1:3, 2:3, 1:3] = data
    np.testing.assert_array_equal(backend.read_texture(1, 0, whole(descriptor), False), expected)
    np.testing.assert_array_equal(backend.read_texture(1, 0, region, False), data)


def test_texels_are_copied_between_levels_layers_and_places(backend):
    source = texture(backend, 1, (4, 4), kind=TextureKind.D2_ARRAY, layers=2)
    target = texture(backend, 2, (8, 8), kind=TextureKind.D2_ARRAY, layers=3, levels=2)
    data = np.arange(32, dtype=np.uint8).reshape(2, 4, 4, 1)
    backend.write_texture(1, 0, whole(source), data)
    backend.copy_texture(1, 0, Region(1, 0, 2, 3, 0, 2), 2, 1, 2, 1, 1)
    expected = np.zeros((3, 4, 4, 1), np.uint8)
    expected[1:3, 1:4, 2:4] = data[:, 0:3, 1:3]
    np.testing.assert_array_equal(backend.read_texture(2, 1, whole(target, 1), False), expected)
    assert not backend.read_texture(2, 0, whole(target), False).any()


def test_mip_levels_are_made_one_from_the_other(backend):
    descriptor = texture(backend, 1, (4, 2), Format.R32F, levels=3)
    backend.write_texture(1, 0, whole(descriptor), np.arange(8, dtype=np.float32))
    backend.generate_mipmaps(1)
    assert backend.read_texture(1, 1, whole(descriptor, 1), False).ravel().tolist() == [2.5, 4.5]
    assert backend.read_texture(1, 2, whole(descriptor, 2), False).ravel().tolist() == [3.5]
    assert backend.read_texture(1, 0, whole(descriptor), False).ravel().tolist() == list(range(8))


# -- passes ----------------------------------------------------------------------------------------------


def run_pass(backend, size, *colors, depth=None, samples=1):
    backend.begin_pass(PassDescriptor(size, colors, depth, samples))
    backend.end_pass()


@pytest.mark.parametrize(
    ("format", "texel"),
    [
        (Format.R8, [64]),
        (Format.RG8, [64, 128]),
        (Format.RGBA8, [64, 128, 191, 255]),
        (Format.RGBA8_SRGB, [137, 188, 225, 255]),
        (Format.RGBA8_SNORM, [32, 64, 95, 127]),
        (Format.RGBA16, [16384, 32768, 49151, 65535]),
        (Format.RGBA16F, [0.25, 0.5, 0.75, 1.0]),
        (Format.RGBA32F, [0.25, 0.5, 0.75, 1.0]),
        (Format.RGBA8UI, [0, 0, 1, 1]),
    ],
    ids=str,
)
def test_a_pass_clears_a_color_target_to_what_its_format_stores(backend, format, texel):
    descriptor = texture(backend, 1, (3, 2), format)
    run_pass(backend, (3, 2), Attachment(1, clear=(0.25, 0.5, 0.75, 1.0)))
    texels = backend.read_texture(1, 0, whole(descriptor), False)
    assert (texels == np.array(texel)).all()


def test_a_pass_clears_one_level_and_layer_and_keeps_what_it_was_not_asked_to_clear(backend):
    descriptor = texture(backend, 1, (4, 4), kind=TextureKind.D2_ARRAY, layers=3, levels=2)
    backend.write_texture(1, 0, whole(descriptor), np.full(48, 9, np.uint8))
    run_pass(backend, (2, 2), Attachment(1, level=1, layer=2, clear=(1.0, 0.0, 0.0, 0.0)))
    run_pass(backend, (4, 4), Attachment(1))
    smaller = backend.read_texture(1, 1, whole(descriptor, 1), False)
    assert smaller.reshape(3, 4).max(axis=1).tolist() == [0, 0, 255]
    assert (backend.read_texture(1, 0, whole(descriptor), False) == 9).all()


def test_several_targets_are_cleared_each_to_its_own(backend):
    for id in (1, 2):
        texture(backend, id, (2, 2))
    run_pass(backend, (2, 2), Attachment(1, clear=(1.0, 0, 0, 0)), Attachment(2, clear=(0.2, 0, 0, 0)))
    values = [int(backend.read_texture(id, 0, Region(0, 0, 1, 1), False)[0, 0, 0, 0]) for id in (1, 2)]
    assert values == [255, 51]


@pytest.mark.parametrize("format", DEPTH_FORMATS, **BY_NAME)
def test_a_pass_clears_depth_and_stencil(backend, format):
    descriptor = texture(backend, 1, (3, 2), format)
    run_pass(backend, (3, 2), depth=DepthAttachment(1, clear=0.25, clear_stencil=0x1FE))
    depth = backend.read_texture(1, 0, whole(descriptor), False)
    assert depth.dtype == np.float32
    assert np.abs(depth - 0.25).max() <= 1 / 65535
    if format.has_stencil:
        stencil = backend.read_texture(1, 0, whole(descriptor), True)
        assert (stencil.dtype, stencil.shape) == (np.uint8, (1, 2, 3, 1))
        assert (stencil == 0xFE).all()


def test_depth_and_stencil_are_cleared_one_without_the_other(backend):
    descriptor = texture(backend, 1, (1, 1), Format.D32FS8)
    run_pass(backend, (1, 1), depth=DepthAttachment(1, clear=0.5, clear_stencil=7))
    run_pass(backend, (1, 1), depth=DepthAttachment(1, clear=0.75))
    run_pass(backend, (1, 1), depth=DepthAttachment(1))
    assert backend.read_texture(1, 0, whole(descriptor), False).item() == 0.75
    assert backend.read_texture(1, 0, whole(descriptor), True).item() == 7
    run_pass(backend, (1, 1), depth=DepthAttachment(1, clear_stencil=8))
    assert backend.read_texture(1, 0, whole(descriptor), False).item() == 0.75
    assert backend.read_texture(1, 0, whole(descriptor), True).item() == 8


def test_a_depth_texture_is_copied_with_its_stencil(backend):
    descriptor = texture(backend, 1, (2, 2), Format.D24S8)
    texture(backend, 2, (2, 2), Format.D24S8)
    run_pass(backend, (2, 2), depth=DepthAttachment(1, clear=1.0, clear_stencil=5))
    backend.copy_texture(1, 0, Region(0, 0, 1, 2), 2, 0, 1, 0, 0)
    assert backend.read_texture(2, 0, whole(descriptor), False).ravel().tolist() == [0.0, 1.0, 0.0, 1.0]
    assert backend.read_texture(2, 0, whole(descriptor), True).ravel().tolist() == [0, 5, 0, 5]


def test_a_multi_sampled_target_is_resolved_at_the_end_of_its_pass_and_not_before(backend):
    descriptor = texture(backend, 1, (2, 2))
    texture(backend, 3, (2, 2), samples=4)
    attachment = Attachment(3, clear=(0.4, 0, 0, 0), resolve=1)
    backend.begin_pass(PassDescriptor((2, 2), (attachment,), samples=4))
    assert not backend.read_texture(1, 0, whole(descriptor), False).any()
    backend.end_pass()
    assert (backend.read_texture(1, 0, whole(descriptor), False) == 102).all()


def test_a_multi_sampled_texture_is_resolved_by_command(backend):
    descriptor = texture(backend, 1, (2, 2))
    texture(backend, 3, (2, 2), samples=4)
    run_pass(backend, (2, 2), Attachment(3, clear=(0.4, 0, 0, 0)), samples=4)
    backend.resolve_texture(3, 1)
    assert (backend.read_texture(1, 0, whole(descriptor), False) == 102).all()
