"""Buffers, textures, framebuffers, quads and the fence: cases that depend on the backend's structure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import psutil
import pytest
from backend_kit import SOURCES, VALUES
from gl_kit import SIZE, GlKit

import rhi
from rhi import CullMode
from rhi.backends.gl.gl_buffers import Buffers
from rhi.backends.gl.quads import expand_indices
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract import descriptors
from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Region, TextureDescriptor, TextureKind
from rhi.contract.formats import Format, IndexFormat
from rhi.errors import DeviceError

IMAGE_BINDING_LAYERED, IMAGE_BINDING_LAYER = 0x8F3C, 0x8F3D


@pytest.mark.parametrize("usage", [BufferUsage.STATIC, BufferUsage.STREAM])  # nothing is written to READBACK
@pytest.mark.parametrize("source", SOURCES.values(), ids=SOURCES)
def test_a_buffer_takes_whatever_is_bytes_in_a_row(gl_kit: GlKit, source: object, usage: BufferUsage) -> None:
    buffer = gl_kit.buffer(bytes(64), usage)
    gl_kit.backend.write_buffer(buffer, 16, source)  # type: ignore[arg-type]
    assert gl_kit.backend.read_buffer(buffer, 0, 64) == bytes(16) + VALUES.tobytes() + bytes(16)


def test_the_gpu_sees_writes_to_a_stream_buffer(gl_kit: GlKit) -> None:
    stream, target = gl_kit.buffer(bytes(64), BufferUsage.STREAM), gl_kit.buffer(bytes(64))
    for value in (b"a", b"b"):
        gl_kit.backend.write_buffer(stream, 0, value * 64)
        gl_kit.backend.copy_buffer(stream, 0, target, 0, 64)
        assert gl_kit.backend.read_buffer(target, 0, 64) == value * 64


def test_a_write_past_the_end_of_a_stream_touches_nothing(gl_kit: GlKit) -> None:
    stream = gl_kit.buffer(bytes(16), BufferUsage.STREAM)
    gl_kit.backend.write_buffer(stream, 8, bytes(8))
    with pytest.raises(ValueError, match=r"different structures|size"):
        gl_kit.backend.write_buffer(stream, 9, b"x" * 8)
    assert gl_kit.backend.read_buffer(stream, 0, 16) == bytes(16)


def test_a_texture_too_large_is_refused_and_its_id_stays_free(gl_kit: GlKit) -> None:
    limit = gl_kit.backend.capabilities.max_texture_size
    with pytest.raises(DeviceError, match=r"^\[device-driver\]"):
        gl_kit.backend.create_texture(1, TextureDescriptor((limit + 1, 1), Format.R8))
    gl_kit.backend.create_texture(1, TextureDescriptor((limit, 1), Format.R8))
    assert gl_kit.backend.read_texture(1, 0, Region(limit - 1, 0, 1, 1), False)[0, 0, 0, 0] == 0


def test_a_framebuffer_is_made_once_and_dropped_with_a_texture(gl_kit: GlKit) -> None:
    names = gl_kit.backend._framebuffers._names
    color, depth = gl_kit.texture(), gl_kit.texture(Format.D32F)
    for _ in range(2):
        gl_kit.begin(color, depth=descriptors.DepthAttachment(depth))
        gl_kit.backend.end_pass()
    assert len(names) == 1
    gl_kit.begin(color)
    gl_kit.backend.end_pass()
    assert len(names) == 2
    gl_kit.backend.destroy(depth)
    assert len(names) == 1
    gl_kit.backend.destroy(color)
    assert names == {}


def test_a_pass_may_have_no_target_at_all(checked_kit: GlKit) -> None:
    checked_kit.backend.begin_pass(descriptors.PassDescriptor((SIZE, SIZE)))
    checked_kit.backend.end_pass()


@pytest.mark.parametrize("index_format", IndexFormat)
def test_indexed_quads_become_two_triangles_each(index_format: IndexFormat) -> None:
    indices = np.array([5, 6, 7, 8, 3, 2, 1, 0], index_format.dtype)
    expanded = expand_indices(indices.tobytes(), index_format)
    assert expanded.dtype == index_format.dtype
    assert expanded.tolist() == [5, 6, 7, 5, 7, 8, 3, 2, 1, 3, 1, 0]


@pytest.fixture
def device() -> Iterator[rhi.Device]:
    with rhi.create_device("gl") as device:
        yield device


def test_indexed_quads_read_their_indices_back_once(
    device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = rectangle()[[0, 1, 2, 5]]
    read, reads = Buffers.read, []

    def count(self: Buffers, *arguments: int) -> bytes:
        reads.append(arguments)
        return read(self, *arguments)

    monkeypatch.setattr(Buffers, "read", count)
    program, image = device.program(Colored), device.texture((4, 4), rhi.Format.RGBA8)
    mesh = device.mesh(rows, np.arange(4, dtype="u2"), primitive=rhi.Primitive.QUADS)
    with device.render_pass(image), device.states(CullMode.NONE):
        for _ in range(3):
            device.draw(program, mesh)
    assert len(reads) == 1
    assert (image.read() == 255).all()
    assert mesh.indices is not None
    mesh.indices.write(np.zeros(4, "u2"))
    with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
        for _ in range(3):
            device.draw(program, mesh)
    assert len(reads) == 2
    assert not image.read().any()


def test_a_fence_nobody_signals_is_not_waited_for(gl_kit: GlKit) -> None:
    gl_kit.backend.signal(1)
    assert gl_kit.backend.wait(1, 10.0)
    assert gl_kit.backend.completed() == 1
    assert not gl_kit.backend.wait(2, 10.0)


@pytest.mark.parametrize(("layer", "layered"), [(-1, 1), (0, 0), (2, 0)])
def test_an_image_is_bound_whole_or_as_one_layer_the_first_included(
    gl_kit: GlKit, layer: int, layered: int
) -> None:
    """llvmpipe shows no difference between all layers and the first; other drivers may."""
    backend = gl_kit.backend
    image = gl_kit.new_id()
    backend.create_texture(image, TextureDescriptor((4, 4), Format.RGBA8, TextureKind.D2_ARRAY, layers=3))
    backend.bind_image(0, image, 0, layer)
    assert backend.gl.get_integer(IMAGE_BINDING_LAYERED, 0) == layered
    assert backend.gl.get_integer(IMAGE_BINDING_LAYER, 0) == max(layer, 0)


@pytest.mark.parametrize("usage", list(BufferUsage), ids=lambda usage: usage.value)
def test_a_destroyed_buffer_gives_its_memory_back(gl_kit: GlKit, usage: BufferUsage) -> None:
    """moderngl doesn't delete buffers that it didn't make. The C heap may keep 64 MiB
    (`rhi.backends.gl.llvmpipe`)."""
    size, process = 24 << 20, psutil.Process()

    def make_and_destroy(count: int) -> int:
        for _ in range(count):
            buffer = gl_kit.new_id()
            gl_kit.backend.create_buffer(buffer, BufferDescriptor(size, usage))
            gl_kit.backend.destroy(buffer)
            gl_kit.backend.signal(buffer)  # the driver frees a buffer once it has zeroed it
            gl_kit.backend.wait(buffer, 60.0)
        return process.memory_info().rss

    before = make_and_destroy(2)
    assert make_and_destroy(12) - before < 6 * size


def test_a_buffer_begins_with_its_contents(gl_kit: GlKit) -> None:
    data = np.random.default_rng(1).bytes(1 << 16)
    buffer = gl_kit.new_id()
    gl_kit.backend.create_filled_buffer(buffer, BufferDescriptor(len(data), label="filled"), memoryview(data))
    assert gl_kit.backend.read_buffer(buffer, 0, len(data)) == data
    gl_kit.backend.write_buffer(buffer, 8, b"12345678")
    assert gl_kit.backend.read_buffer(buffer, 0, 24) == data[:8] + b"12345678" + data[16:24]
