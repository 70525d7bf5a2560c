"""Buffers and textures: staging, ranges, padding and copies of this backend."""

from __future__ import annotations

import weakref
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from backend_kit import SOURCES, VALUES
from cl_kit import FILL, ClKit, describe_program

from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.memory import cl_buffers, cl_textures, pools
from rhi.conformance.formats import random_texels
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Region, TextureDescriptor, TextureKind
from rhi.contract.formats import Format
from rhi.contract.texels import decode, encode, unpack
from rhi.errors import DeviceError


@pytest.mark.parametrize("usage", BufferUsage)
@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_a_cl_buffer_takes_whatever_is_bytes_in_a_row(
    cl_kit: ClKit, source: object, usage: BufferUsage
) -> None:
    buffer = cl_kit.buffer(bytes(64), usage)
    cl_kit.backend.write_buffer(buffer, 16, source)  # type: ignore[arg-type]
    assert cl_kit.backend.read_buffer(buffer, 0, 64) == bytes(16) + VALUES.tobytes() + bytes(16)


@pytest.mark.parametrize("shares_memory", [True, False])
def test_kernels_see_writes_to_a_stream_buffer_with_and_without_shared_memory(
    cl_kit: ClKit, shares_memory: bool
) -> None:
    backend = ClBackend(replace(cl_kit.backend.context, shares_memory=shares_memory))
    kit = ClKit(backend)
    source = "__kernel void add(__global uint *words, int count) { words[1] += words[0]; }"
    program, stream = kit.program(describe_program(source)), kit.buffer(np.zeros(2, "u4"), BufferUsage.STREAM)
    backend.bind_storage(0, stream, 0, 8)
    for value in (3, 40):
        backend.write_buffer(stream, 0, np.array([value], "u4"))
        kit.dispatch(program)
        backend.read_buffer(stream, 0, 4)
    assert kit.words(stream, 2) == [40, 43]
    backend.close()


def test_an_array_may_change_after_it_was_written_to_a_busy_device(cl_kit: ClKit) -> None:
    backend, data = cl_kit.backend, np.full((4, 4, 4), 7, np.uint8)
    buffer, texture = cl_kit.buffer(bytes(64)), cl_kit.texture(TextureDescriptor((4, 4), Format.RGBA8))
    gate = cl_kit.hold()
    backend.write_buffer(buffer, 0, data)
    backend.write_texture(texture, 0, Region(0, 0, 4, 4), data)
    data[:] = 99
    cl_kit.release(gate)
    assert backend.read_buffer(buffer, 0, 64) == b"\7" * 64
    assert (cl_kit.read(texture, 4, 4) == 7).all()


def test_the_memory_of_a_destroyed_resource_stays_until_its_writes_are_executed(cl_kit: ClKit) -> None:
    backend, data = cl_kit.backend, np.full((4, 4, 4), 7, np.uint8)
    buffer, texture = cl_kit.buffer(bytes(1 << 16)), cl_kit.texture(TextureDescriptor((4, 4), Format.RGBA8))
    planes = backend._buffers[buffer].cl, backend._textures[texture].levels[0].memory
    memory = [weakref.ref(plane.hostbuf) for plane in planes]
    del planes
    gate = cl_kit.hold()
    backend.write_buffer(buffer, 0, data)
    backend.write_texture(texture, 0, Region(0, 0, 4, 4), data)
    backend.destroy(buffer)
    backend.destroy(texture)
    assert all(reference() is not None for reference in memory)
    cl_kit.release(gate)
    backend.signal(1)
    assert backend.wait(1, 10.0)
    assert all(reference() is None for reference in memory)


def test_a_page_of_tables_stays_when_the_next_one_begins_since_kernels_may_still_read_it() -> None:
    uploads = pools.Uploads()
    uploads.write(b"table")
    page = weakref.ref(uploads._page.bytes)
    uploads.write(bytes(len(uploads._page.bytes)))
    assert page() is not None and page() is not uploads._page.bytes  # noqa: PT018


def test_a_program_keeps_no_memory_of_destroyed_buffers(cl_kit: ClKit) -> None:
    backend, buffer = cl_kit.backend, cl_kit.buffer(bytes(64))
    memory = weakref.ref(backend._buffers[buffer].cl.hostbuf)
    backend.bind_storage(0, buffer, 0, 64)
    cl_kit.dispatch(cl_kit.program(describe_program(FILL)))
    backend.signal(1)
    assert backend.wait(1, 10.0)
    assert memory() is not None
    backend.destroy(buffer)
    assert memory() is None


@pytest.mark.parametrize("size", [(1 << 24) - 1, 1 << 24, (1 << 24) + 1])
def test_a_write_larger_than_the_room_for_copies_waits(cl_kit: ClKit, size: int) -> None:
    data = np.full(size, 7, np.uint8)
    buffer = cl_kit.buffer(data)
    cl_kit.backend.write_buffer(buffer, size - 4, b"abcd")
    assert cl_kit.backend.read_buffer(buffer, size - 8, 8) == b"\7\7\7\7abcd"


def test_copies_are_let_go_when_their_fence_has_passed(cl_kit: ClKit) -> None:
    backend = cl_kit.backend
    for value in range(1, 4):
        cl_kit.buffer(bytes(1 << 23))
        cl_kit.buffer(bytes(1 << 23))
        assert not backend._fence._in_flight.has_room(1)
        backend.signal(value)
        assert backend._fence._in_flight.has_room(1 << 24)
    assert backend.wait(3, 10.0)
    assert not backend._fence._pending


@pytest.mark.parametrize("offset", [0, 4, 8, 64, 128])
@pytest.mark.parametrize("size", [4, 12, 64, 128, 256])
def test_a_fill_repeats_its_pattern_and_touches_nothing_else(cl_kit: ClKit, offset: int, size: int) -> None:
    buffer = cl_kit.buffer(b"\1" * 512)
    cl_kit.backend.clear_buffer(buffer, offset, size, 0xA1B2C3D4)
    expected = bytearray(b"\1" * 512)
    expected[offset : offset + size] = bytes.fromhex("d4c3b2a1") * (size // 4)
    assert cl_kit.backend.read_buffer(buffer, 0, 512) == bytes(expected)


def test_nothing_may_be_read_copied_cleared_and_written(cl_kit: ClKit) -> None:
    buffer, other = cl_kit.buffer(b"abcd"), cl_kit.buffer(b"efgh")
    cl_kit.backend.write_buffer(buffer, 4, b"")
    cl_kit.backend.copy_buffer(buffer, 4, other, 0, 0)
    cl_kit.backend.clear_buffer(buffer, 4, 0, 9)
    assert cl_kit.backend.read_buffer(buffer, 4, 0) == b""
    assert cl_kit.backend.read_buffer(buffer, 0, 4) + cl_kit.backend.read_buffer(other, 0, 4) == b"abcdefgh"


def test_a_buffer_too_large_is_refused_and_the_device_goes_on(cl_kit: ClKit) -> None:
    size = cl_kit.backend.capabilities.max_storage_bytes
    for usage in BufferUsage:
        with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
            cl_kit.backend.create_buffer(1, BufferDescriptor(size * 1000, usage))
        cl_kit.backend.create_buffer(1, BufferDescriptor(64, usage))
        assert cl_kit.backend.read_buffer(1, 0, 64) == bytes(64)
        cl_kit.backend.destroy(1)


def test_a_texture_too_large_is_refused_and_its_id_stays_free(cl_kit: ClKit) -> None:
    whole = TextureDescriptor((16384, 16384), Format.RGBA32F, TextureKind.D2_ARRAY, 64)
    with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
        cl_kit.backend.create_texture(1, whole)
    cl_kit.backend.create_texture(1, TextureDescriptor((4, 4), Format.R8))
    assert not cl_kit.read(1, 4, 4).any()


def test_an_allocation_that_fails_half_way_leaves_nothing(
    cl_kit: ClKit, monkeypatch: pytest.MonkeyPatch
) -> None:
    allocated: list[weakref.ref[object]] = []
    allocate = cl_textures.allocate

    def fail_second(context: cl.Context, size: int) -> cl.Buffer:
        memory = allocate(context, size << 40 if allocated else size)
        allocated.append(weakref.ref(memory.hostbuf))
        return memory

    monkeypatch.setattr(cl_textures, "allocate", fail_second)
    with pytest.raises(DeviceError):
        cl_kit.backend.create_texture(1, TextureDescriptor((4, 4), Format.D24S8))
    assert [memory() for memory in allocated] == [None]
    monkeypatch.undo()
    cl_kit.backend.create_texture(1, TextureDescriptor((4, 4), Format.D24S8))


def test_a_range_is_bound_where_it_begins_and_knows_its_size(cl_kit: ClKit) -> None:
    grain = cl_kit.backend.capabilities.storage_alignment
    buffer, program = cl_kit.buffer(bytes(4 * grain)), cl_kit.program(describe_program(FILL))
    for part in (1, 3, 1):
        cl_kit.backend.bind_storage(0, buffer, part * grain, 8 + 4 * part)
        cl_kit.dispatch(program, 2)
    assert [cl_kit.words(buffer, 2, part * grain) for part in range(4)] == [[0, 0], [3, 4], [0, 0], [5, 6]]


def test_more_ranges_than_are_kept_may_be_bound(cl_kit: ClKit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cl_buffers, "_MAX_RANGES", 2)
    grain = cl_kit.backend.capabilities.storage_alignment
    buffer, program = cl_kit.buffer(bytes(8 * grain)), cl_kit.program(describe_program(FILL))
    for part in range(1, 8):
        cl_kit.backend.bind_storage(0, buffer, part * grain, 4)
        cl_kit.dispatch(program)
        cl_kit.dispatch(program, 2)
    assert [cl_kit.words(buffer, 2, part * grain) for part in range(1, 8)] == [[1, 2]] * 7


# -- textures ----------------------------------------------------------------------------------------------


def test_levels_and_layers_of_odd_sizes_stay_apart(cl_kit: ClKit) -> None:
    descriptor = TextureDescriptor((13, 7), Format.RG8, TextureKind.D2_ARRAY, 3, 4)
    texture, rng = cl_kit.texture(descriptor), np.random.default_rng(0)
    data = {}
    for level in range(4):
        width, height = descriptor.level_size(level)
        data[level] = rng.integers(0, 256, (3, height, width, 2), np.uint8)
        cl_kit.backend.write_texture(texture, level, Region(0, 0, width, height, 0, 3), data[level])
    cl_kit.backend.copy_texture(texture, 0, Region(3, 2, 2, 1, 2, 1), texture, 1, 4, 1, 0)
    data[1][0, 1, 4:6] = data[0][2, 2, 3:5]
    for level in range(4):
        width, height = descriptor.level_size(level)
        back = cl_kit.backend.read_texture(texture, level, Region(0, 0, width, height, 0, 3), False)
        np.testing.assert_array_equal(back, data[level])


RESOLVED = [f for f in Format if not f.is_depth and not f.is_integer]


@pytest.mark.parametrize("format", RESOLVED, ids=lambda f: f.name)
@pytest.mark.parametrize("samples", [2, 4, 8])
def test_a_resolve_averages_samples_in_linear_light(cl_kit: ClKit, format: Format, samples: int) -> None:
    rng = np.random.default_rng(samples)
    values = encode(format, rng.random((samples, 3, 5, format.channels)))
    source = cl_kit.texture(TextureDescriptor((5, 3), format, samples=samples))
    target = cl_kit.texture(TextureDescriptor((5, 3), format))
    cl_kit.backend.write_texture(
        source, 0, Region(0, 0, 5, 3, 0, samples), values.tobytes()
    )  # the samples' planes
    cl_kit.backend.resolve_texture(source, target)
    got, exact = cl_kit.read(target, 5, 3), encode(format, decode(format, values).mean(axis=0))
    slack = 1 if format.dtype.kind != "f" else 2.0 ** (-10 if format.dtype.itemsize == 2 else -22)
    slack = 2.0**-6 if format is Format.R11G11B10F else slack
    got, exact = unpack(format, got), unpack(format, exact)
    assert np.abs(got.astype(np.float64) - exact.astype(np.float64)).max() <= slack


@pytest.mark.parametrize("samples", [2, 4, 8])
def test_the_mean_of_equal_samples_equals_them(cl_kit: ClKit, samples: int) -> None:
    values = np.random.default_rng(5).random((1, 32, 32), np.float32)
    source = cl_kit.texture(TextureDescriptor((32, 32), Format.R32F, samples=samples))
    target = cl_kit.texture(TextureDescriptor((32, 32), Format.R32F))
    cl_kit.backend.write_texture(
        source, 0, Region(0, 0, 32, 32, 0, samples), np.repeat(values, samples, axis=0).tobytes()
    )
    cl_kit.backend.resolve_texture(source, target)
    np.testing.assert_array_equal(cl_kit.read(target, 32, 32)[..., 0], values[0])


def test_a_resolve_of_integers_takes_a_sample(cl_kit: ClKit) -> None:
    source = cl_kit.texture(TextureDescriptor((2, 1), Format.R8UI, samples=4))
    target = cl_kit.texture(TextureDescriptor((2, 1), Format.R8UI))
    cl_kit.backend.write_texture(source, 0, Region(0, 0, 2, 1, 0, 4), bytes(range(1, 9)))
    cl_kit.backend.resolve_texture(source, target)
    assert cl_kit.read(target, 2, 1)[0, :, 0].tolist() == [1, 2]


@pytest.mark.parametrize("size", [(5, 7), (1, 9), (6, 3), (2, 1)], ids=str)
def test_mip_levels_of_odd_sizes_keep_the_mean(cl_kit: ClKit, size: tuple[int, int]) -> None:
    """Every texel of a level has the same weight in the next one, for any size."""
    width, height = size
    texels = np.random.default_rng(0).random((height, width, 1)).astype(np.float32)
    texture = cl_kit.texture(TextureDescriptor(size, Format.R32F, levels=max(size).bit_length()))
    cl_kit.backend.write_texture(texture, 0, Region(0, 0, width, height), texels)
    cl_kit.backend.generate_mipmaps(texture)
    last = cl_kit.read(texture, 1, 1, max(size).bit_length() - 1)
    assert last[0, 0, 0] == pytest.approx(texels.mean(dtype=np.float64), rel=1e-6)


def test_all_mip_levels_are_made_by_the_same_machine_code(
    cl_kit: ClKit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PoCL generates other code for other sizes of work-groups."""
    groups: list[object] = []
    enqueue = cl.enqueue_nd_range_kernel

    def note(
        queue: cl.CommandQueue, kernel: cl.Kernel, size: tuple[int, ...], group: tuple[int, ...]
    ) -> cl.Event:
        groups.append(group)
        return enqueue(queue, kernel, size, group)

    texture = cl_kit.texture(TextureDescriptor((64, 48), Format.RGBA8, levels=7))
    monkeypatch.setattr(cl, "enqueue_nd_range_kernel", note)
    cl_kit.backend.generate_mipmaps(texture)
    assert groups == [(1, 1)] * 6


AVERAGED = [f for f in RESOLVED if f.dtype.kind in "ui" and not f.is_packed]


@pytest.mark.parametrize("format", AVERAGED, ids=lambda f: f.name)
def test_the_mean_of_equal_texels_is_the_same_stored_number(cl_kit: ClKit, format: Format) -> None:
    limits = np.iinfo(format.dtype)  # type: ignore[type-var]
    low = -limits.max if limits.min < 0 else 0  # of the two numbers that mean -1, either may come
    every = np.linspace(low, limits.max, 256).round().astype(format.dtype)
    level = np.tile(np.repeat(every, 2)[None, :, None], (2, 1, format.channels))
    texture = cl_kit.texture(TextureDescriptor((512, 2), format, levels=2))
    cl_kit.backend.write_texture(texture, 0, Region(0, 0, 512, 2), np.ascontiguousarray(level))
    cl_kit.backend.generate_mipmaps(texture)
    np.testing.assert_array_equal(cl_kit.read(texture, 256, 1, 1)[0], level[0, ::2])


@pytest.mark.parametrize("format", [Format.RGB10A2, Format.R11G11B10F], ids=lambda f: f.name)
def test_the_mean_of_equal_packed_texels_is_the_same_texel(cl_kit: ClKit, format: Format) -> None:
    every = random_texels(format, 256)
    level = np.ascontiguousarray(np.tile(np.repeat(every, 2, axis=0)[None], (2, 1, 1)))
    texture = cl_kit.texture(TextureDescriptor((512, 2), format, levels=2))
    cl_kit.backend.write_texture(texture, 0, Region(0, 0, 512, 2), level)
    cl_kit.backend.generate_mipmaps(texture)
    np.testing.assert_array_equal(cl_kit.read(texture, 256, 1, 1)[0], every)
