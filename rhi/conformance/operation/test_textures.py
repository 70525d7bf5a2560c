"""Textures as memory: every format, level, layer and region written, copied, cleared and read back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from rhi import Access, Device, Format, Region, TextureKind
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_format, require_renderable, squeezed
from rhi.conformance.reference import channels_of, decode, encode, halve, largest, rounding
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind

FILTERABLE = tuple(f for f in COLOR_FORMATS if not f.is_integer)


def identity(value: Any) -> str:
    return value.name if isinstance(value, Format | TextureKind) else str(value)


@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
def test_a_color_format_reads_back_as_written(device: Device, format: Format) -> None:
    require_format(device, format)
    data = squeezed(format, random_texels(format, 5, 7))
    with device.texture((7, 5), format) as texture:
        texture.write(data)
        back = texture.read()
    assert back.dtype == format.dtype
    assert_same(back, data)


@pytest.mark.parametrize("format", list(Format), ids=identity)
def test_a_new_texture_holds_zeros_in_all_levels(device: Device, format: Format) -> None:
    require_format(device, format)
    with device.texture((8, 4), format, levels=None) as texture:
        assert texture.levels == 4
        for level, size in enumerate([(4, 8), (2, 4), (1, 2), (1, 1)]):
            back = texture.read(level)
            assert back.shape[:2] == size
            assert_same(back, 0)


@pytest.mark.parametrize("format", [f for f in DEPTH_FORMATS if f.has_stencil], ids=identity)
def test_new_stencil_holds_zeros(device: Device, format: Format) -> None:
    require_format(device, format)
    with device.texture((3, 2), format) as texture:
        assert_same(texture.read_stencil(), np.zeros((2, 3)))


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (3, 5), (31, 33), (256, 2)], ids=str)
def test_every_size_reads_back_as_written(device: Device, size: tuple[int, int]) -> None:
    data = random_texels(Format.RG8, size[1], size[0])
    with device.texture(data, Format.RG8) as texture:
        assert texture.size == size
        assert_same(texture.read(), data)


@pytest.mark.parametrize("width", [6, 64])
def test_a_texture_is_created_from_texels_and_the_array_that_is_read_is_writable(
    device: Device, width: int
) -> None:
    data = random_texels(Format.RGBA8, 3, width)
    with device.texture(data, Format.RGBA8) as texture:
        assert texture.size == (width, 3)
        assert_same(texture.read(), data)
        texture.read()[:] = 0


@pytest.mark.parametrize("format", [Format.R8, Format.RGBA8, Format.R16, Format.RGBA32F], ids=identity)
def test_a_write_changes_its_region_only(device: Device, format: Format) -> None:
    require_format(device, format)
    expected = random_texels(format, 6, 9)
    part = random_texels(format, 2, 3, seed=1)
    with device.texture(squeezed(format, expected), format) as texture:
        texture.write(squeezed(format, part), x=5, y=3)
        expected[3:5, 5:8] = part
        assert_same(texture.read(), squeezed(format, expected))


@pytest.mark.parametrize("format", [Format.R8, Format.RGBA8, Format.RG16F], ids=identity)
@pytest.mark.parametrize("box", [(0, 0, 9, 6), (0, 0, 1, 1), (8, 5, 1, 1), (2, 1, 5, 3)], ids=str)
def test_a_read_of_a_region_gives_that_region(
    device: Device, format: Format, box: tuple[int, int, int, int]
) -> None:
    data = squeezed(format, random_texels(format, 6, 9))
    x, y, width, height = box
    with device.texture(data, format) as texture:
        assert_same(texture.read(region=Region(x, y, width, height)), data[y : y + height, x : x + width])


def test_rows_of_an_odd_byte_count_are_not_padded(device: Device) -> None:
    data = random_texels(Format.R8, 5, 3)[..., 0]
    with device.texture(data, Format.R8) as texture:
        texture.write(data[1:4, :1].copy(), x=2, y=2)
        expected = data.copy()
        expected[2:5, 2] = data[1:4, 0]
        assert_same(texture.read(), expected)


def test_texels_that_are_not_contiguous_are_written_in_their_order(device: Device) -> None:
    data = random_texels(Format.RGBA8, 8, 8)
    with device.texture((4, 8), Format.RGBA8) as texture:
        texture.write(data[::-1, ::2])
        assert_same(texture.read(), data[::-1, ::2])


def test_each_level_holds_its_own_texels(device: Device) -> None:
    sizes = [(8, 4), (4, 2), (2, 1), (1, 1)]
    data = [random_texels(Format.RGBA8, h, w, seed=level) for level, (w, h) in enumerate(sizes)]
    with device.texture((8, 4), Format.RGBA8, levels=4) as texture:
        for level, values in enumerate(data):
            texture.write(values, level=level)
        for level, values in enumerate(data):
            assert_same(texture.read(level), values)


@pytest.mark.parametrize(
    ("kind", "layers"), [(TextureKind.D2_ARRAY, 3), (TextureKind.D3, 4), (TextureKind.CUBE, 6)], ids=identity
)
def test_each_layer_holds_its_own_texels(device: Device, kind: TextureKind, layers: int) -> None:
    data = random_texels(Format.RGBA8, layers, 4, 4)
    with device.texture((4, 4), Format.RGBA8, kind=kind, layers=layers) as texture:
        for layer in reversed(range(layers)):
            texture.write(data[layer], layer=layer)
        assert_same(texture.read_layers(), data)
        for layer in range(layers):
            assert_same(texture.read(layer=layer), data[layer])


@pytest.mark.parametrize(
    ("kind", "layers"), [(TextureKind.D2_ARRAY, 4), (TextureKind.D3, 4), (TextureKind.CUBE, 6)], ids=identity
)
def test_several_layers_are_written_at_once(device: Device, kind: TextureKind, layers: int) -> None:
    data = random_texels(Format.RG16UI, 2, 3, 2)
    with device.texture((4, 4), Format.RG16UI, kind=kind, layers=layers) as texture:
        texture.write(data, layer=1, x=2, y=1)
        expected = np.zeros((layers, 4, 4, 2))
        expected[1:3, 1:4, 2:4] = data
        assert_same(texture.read_layers(), expected)


def test_the_depth_of_a_3d_texture_shrinks_with_its_levels(device: Device) -> None:
    with device.texture((4, 4), Format.R8, kind=TextureKind.D3, layers=4, levels=3) as texture:
        assert [len(texture.read_layers(level)) for level in range(3)] == [4, 2, 1]
        data = random_texels(Format.R8, 2, 2, 2)
        texture.write(data, level=1)
        assert_same(texture.read_layers(1), data)
        assert_same(texture.read_layers(0), 0)


def test_the_layers_of_an_array_stay_with_its_levels(device: Device) -> None:
    with device.texture((4, 4), Format.R8, kind=TextureKind.D2_ARRAY, layers=3, levels=3) as texture:
        data = random_texels(Format.R8, 3, 1, 1)
        texture.write(data, level=2)
        assert_same(texture.read_layers(2), data)


# -- texels without alpha ----------------------------------------------------------------------------------


each_opaque = pytest.mark.parametrize(
    ("format", "opaque"),
    [
        (Format.RGBA8, 255),
        (Format.RGBA8_SRGB, 255),
        (Format.RGBA8_SNORM, 127),
        (Format.RGBA16, 65535),
        (Format.RGBA16F, 1),
        (Format.RGBA32F, 1),
    ],
    ids=identity,
)
"""Runs a test with each format that has alpha, and with the alpha of an opaque texel."""


@each_opaque
def test_texels_created_without_alpha_are_opaque(device: Device, format: Format, opaque: int) -> None:
    require_format(device, format)
    data = random_texels(format, 1, 3, 5)[0, ..., :3]
    with device.texture(np.ascontiguousarray(data), format) as texture:
        assert_same(texture.read()[..., :3], data)
        assert_same(texture.read()[..., 3], opaque)


@each_opaque
def test_texels_written_without_alpha_are_opaque(device: Device, format: Format, opaque: int) -> None:
    require_format(device, format)
    data = random_texels(format, 2, 3, 5)
    with device.texture(data[0], format) as texture:
        texture.write(data[1, :2, :2, :3], x=1, y=1)  # a view
        texels = texture.read()[1:3, 1:3]
        assert_same(texels[..., :3], data[1, :2, :2, :3])
        assert_same(texels[..., 3], opaque)


@each_opaque
def test_layers_written_without_alpha_are_opaque(device: Device, format: Format, opaque: int) -> None:
    require_format(device, format)
    data = random_texels(format, 2, 3, 5)
    with device.texture((5, 3), format, kind=TextureKind.D2_ARRAY, layers=2) as layered:
        layered.write(data[..., :3])
        assert_same(layered.read_layers()[..., :3], data[..., :3])
        assert_same(layered.read_layers()[..., 3], opaque)


# -- locks -------------------------------------------------------------------------------------------------


def test_a_read_lock_shows_the_texels(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8) as texture, texture.lock(Access.READ) as array:
        assert_same(array, data)


def test_a_write_lock_replaces_its_region(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8) as texture:
        with texture.lock(Access.WRITE, region=Region(1, 2, 2, 1)) as array:
            assert array.shape == (1, 2, 4)
            array[:] = 9
        data[2:3, 1:3] = 9
        assert_same(texture.read(), data)


def test_changes_to_the_array_of_a_read_write_lock_are_written_back(device: Device) -> None:
    data = random_texels(Format.R32F, 2, 3)
    with device.texture(data[..., 0], Format.R32F) as texture:
        with texture.lock(Access.READ_WRITE) as array:
            assert_same(array, data)
            array *= 2
        assert_same(texture.read(), data[..., 0] * 2)


def test_an_exception_inside_a_texture_lock_writes_nothing(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8) as texture:
        with pytest.raises(ZeroDivisionError), texture.lock(Access.WRITE) as array:
            array[:] = 0
            raise ZeroDivisionError
        assert_same(texture.read(), data)


# -- copies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
def test_a_copy_carries_the_bits(device: Device, format: Format) -> None:
    require_format(device, format)
    data = squeezed(format, random_texels(format, 4, 6))
    with device.texture(data, format) as source, device.texture((6, 4), format) as target:
        source.copy_to(target)
        assert_same(target.read(), data)


def test_a_copy_moves_its_region_only(device: Device) -> None:
    data, old = random_texels(Format.RGBA8, 6, 6), random_texels(Format.RGBA8, 6, 8, seed=1)
    with device.texture(data, Format.RGBA8) as source, device.texture(old, Format.RGBA8) as target:
        source.copy_to(target, region=Region(1, 3, 4, 2), x=3, y=1)
        old[1:3, 3:7] = data[3:5, 1:5]
        assert_same(target.read(), old)


def test_a_copy_goes_between_levels_and_layers(device: Device) -> None:
    data = random_texels(Format.RGBA8, 2, 4, 4)
    with (
        device.texture((4, 4), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2) as source,
        device.texture((8, 8), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=4, levels=2) as target,
    ):
        source.write(data)
        source.copy_to(target, region=Region(0, 0, 4, 4, 0, 2), target_level=1, layer=2)
        back = target.read_layers(1)
        assert_same(back[2:], data)
        assert_same(back[:2], 0)


def test_reading_an_unwritten_slice_leaves_a_copied_slice_unchanged(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with (
        device.texture(data, Format.RGBA8) as source,
        device.texture((4, 4), Format.RGBA8, kind=TextureKind.D3, layers=4) as volume,
    ):
        source.copy_to(volume, layer=3)
        for layer, expected in ((3, data), (0, 0), (3, data)):
            assert_same(volume.read(layer=layer), expected)


def test_a_copy_within_a_texture_moves_to_where_nothing_overlaps(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8) as texture:
        texture.copy_to(texture, region=Region(0, 0, 2, 4), x=2)
        assert_same(texture.read()[:, 2:], data[:, :2])


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=identity)
def test_a_copy_carries_depth_and_stencil(device: Device, format: Format) -> None:
    require_format(device, format)
    with device.texture((4, 4), format) as source, device.texture((4, 4), format) as target:
        with device.render_pass(
            depth=source, clear_depth=0.25, clear_stencil=77 if format.has_stencil else None
        ):
            pass
        source.copy_to(target)
        assert_near(target.read(), 0.25, 2.0**-16, "16 bits of depth")
        if format.has_stencil:
            assert_same(target.read_stencil(), 77)


# -- copies to and from buffers ----------------------------------------------------------------------------


def _row_bytes(device: Device, format: Format, width: int) -> int:
    """Return a distance between rows that leaves a gap behind each row."""
    step = max(format.transfer_bytes, device.capabilities.copy_row_alignment)
    return (width * format.transfer_bytes // step + 2) * step


@pytest.mark.requires("texture_buffer_copies")
@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
def test_a_copy_to_a_buffer_writes_the_texels_and_nothing_between_them(
    device: Device, format: Format
) -> None:
    require_format(device, format)
    data = squeezed(format, random_texels(format, 5, 7))
    row, start = _row_bytes(device, format, 4), 2 * max(16, device.capabilities.copy_offset_alignment)
    with device.texture(data, format) as texture, device.buffer(np.full(4096, 7, np.uint8)) as buffer:
        texture.copy_to_buffer(buffer, region=Region(2, 1, 4, 3), offset=start, row_bytes=row)
        back = buffer.read()
    expected = np.full(4096, 7, np.uint8)
    taken = np.ascontiguousarray(data[1:4, 2:6]).view(np.uint8).reshape(3, -1)
    for y in range(3):
        expected[start + y * row :][: taken.shape[1]] = taken[y]
    assert_same(back, expected)


@pytest.mark.requires("texture_buffer_copies")
@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
def test_a_copy_from_a_buffer_replaces_its_region_only(device: Device, format: Format) -> None:
    require_format(device, format)
    old, new = (squeezed(format, random_texels(format, 5, 7, seed=seed)) for seed in (0, 1))
    row, start = _row_bytes(device, format, 4), max(16, device.capabilities.copy_offset_alignment)
    memory = np.full(4096, 7, np.uint8)
    taken = np.ascontiguousarray(new[:3, :4]).view(np.uint8).reshape(3, -1)
    for y in range(3):
        memory[start + y * row :][: taken.shape[1]] = taken[y]
    with device.texture(old, format) as texture, device.buffer(memory) as buffer:
        texture.copy_from_buffer(buffer, offset=start, row_bytes=row, region=Region(3, 2, 4, 3))
        back = texture.read()
    expected = old.copy()
    expected[2:5, 3:7] = new[:3, :4]
    assert_same(back, expected)


@pytest.mark.requires("texture_buffer_copies")
@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=identity)
def test_depth_is_copied_to_a_buffer_as_float32(device: Device, format: Format) -> None:
    require_format(device, format)
    with device.texture((64, 3), format) as texture, device.buffer(64 * 3, np.float32) as buffer:
        with device.render_pass(
            depth=texture, clear_depth=0.3, clear_stencil=9 if format.has_stencil else None
        ):
            pass
        texture.copy_to_buffer(buffer)
        assert_same(buffer.read().reshape(3, 64), texture.read())


@pytest.mark.requires("texture_buffer_copies")
@pytest.mark.parametrize(
    ("kind", "layers"), [(TextureKind.D2_ARRAY, 4), (TextureKind.D3, 8), (TextureKind.CUBE, 6)], ids=identity
)
def test_layers_of_a_level_follow_each_other_in_a_buffer(
    device: Device, kind: TextureKind, layers: int
) -> None:
    data = random_texels(Format.RGBA8, 3, 4, 4)
    row = _row_bytes(device, Format.RGBA8, 4)
    with (
        device.texture((8, 8), Format.RGBA8, kind=kind, layers=layers, levels=2) as source,
        device.texture((8, 8), Format.RGBA8, kind=kind, layers=layers, levels=2) as target,
        device.buffer(3 * 4 * row) as buffer,
    ):
        source.write(data, level=1, layer=1)
        box = Region(0, 0, 4, 4, 1, 3)
        source.copy_to_buffer(buffer, level=1, region=box, row_bytes=row)
        assert_same(buffer.read().reshape(3, 4, row)[:, :, :16], data.reshape(3, 4, 16))
        target.copy_from_buffer(buffer, row_bytes=row, level=1, region=box)
        assert_same(target.read_layers(1)[1:4], data)
        assert_same(target.read_layers(1)[0], 0)
        assert_same(target.read_layers(0), 0)


@pytest.mark.requires("texture_buffer_copies")
def test_copies_through_a_buffer_keep_the_order_of_the_commands(device: Device) -> None:
    row = _row_bytes(device, Format.RGBA8, 2)
    with (
        device.texture((2, 2), Format.RGBA8) as source,
        device.texture((2, 2), Format.RGBA8) as target,
        device.buffer(2 * row) as buffer,
    ):
        for value in range(1, 6):
            source.write(np.full((2, 2, 4), value, np.uint8))
            source.copy_to_buffer(buffer, row_bytes=row)
            source.write(np.full((2, 2, 4), 99, np.uint8))
            target.copy_from_buffer(buffer, row_bytes=row)
            buffer.clear(0)
            assert_same(target.read(), value)


@pytest.mark.requires("texture_buffer_copies")
def test_a_copy_to_a_buffer_may_end_with_its_last_byte(device: Device) -> None:
    """The last row needs no gap behind it."""
    row = _row_bytes(device, Format.RGBA8, 4)
    data = random_texels(Format.RGBA8, 2, 4)
    with device.texture(data, Format.RGBA8) as texture, device.buffer(row + 16) as buffer:
        texture.copy_to_buffer(buffer, row_bytes=row)
        assert_same(buffer.read()[row:], data[1].reshape(-1))
        texture.write(np.zeros_like(data))
        texture.copy_from_buffer(buffer, row_bytes=row)
        assert_same(texture.read(), data)


# -- clears ------------------------------------------------------------------------------------------------

COLORS = [
    (0.0, 0.0, 0.0, 0.0),
    (1.0, 1.0, 1.0, 1.0),
    (0.25, 0.5, 0.75, 0.125),
    (0.2, 0.3, 0.7, 0.9),
    (-0.4, 2.0, -3.0, 0.6),
]


@pytest.mark.parametrize("color", COLORS, ids=str)
@pytest.mark.parametrize("format", FILTERABLE, ids=identity)
def test_a_clear_converts_its_color_to_the_format(
    device: Device, format: Format, color: tuple[float, float, float, float]
) -> None:
    require_renderable(device, format)
    if format.kind is ChannelKind.FLOAT:  # a number that floats of this format lack is refused
        least = [low for low, _ in format.channel_bounds]
        color = (*np.maximum(color[: len(least)], least).tolist(), *color[len(least) :])
    with device.texture((3, 2), format) as texture:
        with device.render_pass(texture, clear=color):
            pass
        back = channels_of(format, texture.read())
    expected = encode(format, color)
    assert_near(back.reshape(6, -1), expected, *rounding(format, expected))


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_integer], ids=identity)
def test_a_clear_of_integers_stores_the_numbers(device: Device, format: Format) -> None:
    require_renderable(device, format)
    color = (1.0, 120.0, 3.0, 0.0) if format.kind is ChannelKind.UINT else (1.0, -120.0, 3.0, -1.0)
    with device.texture((3, 2), format) as texture:
        with device.render_pass(texture, clear=color):
            pass
        stored = np.minimum(color[: format.channels], 2.0 ** np.array(format.channel_bits) - 1)
        assert_same(channels_of(format, texture.read()), stored)


@pytest.mark.parametrize("depth", [0.0, 1.0, 0.5, 0.3])
@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=identity)
def test_a_clear_of_depth_stores_it(device: Device, format: Format, depth: float) -> None:
    require_format(device, format)
    bits = {Format.D16: 16, Format.D24: 24, Format.D24S8: 24}.get(format, 23)
    with device.texture((3, 2), format) as texture:
        with device.render_pass(depth=texture, clear_depth=depth):
            pass
        assert_near(texture.read(), depth, 2.0**-bits, f"{bits} bits of depth")


@pytest.mark.requires("stencil")
@pytest.mark.parametrize("value", [0, 1, 128, 255])
@pytest.mark.parametrize("format", [f for f in DEPTH_FORMATS if f.has_stencil], ids=identity)
def test_a_clear_of_stencil_stores_it_and_leaves_depth(device: Device, format: Format, value: int) -> None:
    require_format(device, format)
    with device.texture((3, 2), format) as texture:
        with device.render_pass(depth=texture, clear_depth=0.5, clear_stencil=9):
            pass
        with device.render_pass(depth=texture, clear_stencil=value):
            pass
        assert_same(texture.read_stencil(), value)
        assert_near(texture.read(), 0.5, 2.0**-24, "24 bits of depth")


def test_a_pass_without_clear_keeps_the_contents_of_its_targets(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8) as texture:
        with device.render_pass(texture):
            pass
        assert_same(texture.read(), data)


@pytest.mark.parametrize(
    ("format", "value"),
    [(Format.R32UI, 2**32 - 1), (Format.R32UI, 2**24 + 1), (Format.R32I, -(2**31)), (Format.R32I, 2**31 - 1)],
    ids=str,
)
def test_a_clear_of_integers_keeps_all_bits(device: Device, format: Format, value: int) -> None:
    with device.texture((2, 2), format) as texture:
        with device.render_pass(texture, clear=(float(value), 0, 0, 0)):
            pass
        assert_same(texture.read(), value)


def test_levels_of_a_texture_made_from_texels_are_filled(device: Device) -> None:
    data = random_texels(Format.RGBA8, 4, 4)
    with device.texture(data, Format.RGBA8, levels=None) as texture:
        assert texture.levels == 3
        assert_near(texture.read(1), halve(Format.RGBA8, data), 1, "one unit of rounding")


def test_each_target_is_cleared_to_its_own_color(device: Device) -> None:
    formats = (Format.RGBA8, Format.R32F, Format.RGBA16UI)
    targets = [device.texture((4, 4), format) for format in formats]
    with device.render_pass(targets, clear=[(1, 0, 0, 1), (0.5, 0, 0, 0), (7, 8, 9, 10)]):
        pass
    assert_same(targets[0].read(), (255, 0, 0, 255))
    assert_same(targets[1].read(), 0.5)
    assert_same(targets[2].read(), (7, 8, 9, 10))
    for target in targets:
        target.destroy()


@pytest.mark.parametrize(
    ("kind", "layers"), [(TextureKind.D2_ARRAY, 3), (TextureKind.D3, 3), (TextureKind.CUBE, 6)], ids=identity
)
def test_a_clear_of_one_layer_leaves_the_others(device: Device, kind: TextureKind, layers: int) -> None:
    with device.texture((4, 4), Format.RGBA8, kind=kind, layers=layers) as texture:
        with device.render_pass(texture.at(layer=2), clear=(1, 1, 1, 1)):
            pass
        expected = np.zeros((layers, 4, 4, 4))
        expected[2] = 255
        assert_same(texture.read_layers(), expected)


def test_a_clear_of_one_layer_of_depth_and_stencil_leaves_the_others(device: Device) -> None:
    require_format(device, Format.D24S8)
    with device.texture((4, 4), Format.D24S8, kind=TextureKind.D2_ARRAY, layers=3) as texture:
        with device.render_pass(depth=texture.at(layer=1), clear_depth=1.0, clear_stencil=7):
            pass
        for layer, cleared in enumerate((0, 1, 0)):
            assert_same(texture.read(0, layer), cleared)
            assert_same(texture.read_stencil(0, layer), 7 * cleared)


@pytest.mark.parametrize("format", [Format.D16, Format.D32F], ids=identity)
@pytest.mark.parametrize("layer", [0, 1])
def test_a_clear_of_depth_alone_reaches_one_layer_of_one_level(
    device: Device, format: Format, layer: int
) -> None:
    require_format(device, format)
    with device.texture((4, 4), format, kind=TextureKind.D2_ARRAY, layers=3, levels=2) as texture:
        with device.render_pass(depth=texture.at(level=1, layer=layer), clear_depth=1.0):
            pass
        for level in range(2):
            cleared = np.arange(3) == layer if level == 1 else np.zeros(3, bool)
            assert_same(texture.read_layers(level)[:, 0, 0].ravel(), cleared)
            assert_same(texture.read_layers(level).reshape(3, -1).min(axis=1), cleared)


def test_a_clear_of_one_level_leaves_the_others(device: Device) -> None:
    with device.texture((8, 8), Format.RGBA8, levels=3) as texture:
        with device.render_pass(texture.at(level=1), clear=(1, 1, 1, 1)):
            pass
        assert_same(texture.read(0), 0)
        assert_same(texture.read(1), 255)
        assert_same(texture.read(2), 0)


# -- mipmaps -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("format", FILTERABLE, ids=identity)
def test_mipmaps_are_boxes_of_two_by_two(device: Device, format: Format) -> None:
    require_format(device, format)
    data = random_texels(format, 8, 16)
    with device.texture((16, 8), format, levels=None) as texture:
        texture.write(squeezed(format, data))
        texture.generate_mipmaps()
        level0 = texture.read(0)
        levels = [channels_of(format, texture.read(level)) for level in range(1, 4)]
    assert_same(level0, squeezed(format, data))
    above = channels_of(format, squeezed(format, data))
    for level in levels:
        # Each level is compared with one computed from the level above, so that rounding errors don't
        # accumulate.
        expected = halve(format, above)
        slack: Any
        if format.is_packed and format.kind is ChannelKind.FLOAT:
            slack = np.abs(above).max() * 2.0 ** -np.array([5, 5, 4])
        elif format.dtype.kind == "f":
            slack = np.abs(above.astype(np.float64)).max() * (
                2.0**-10 if format.dtype.itemsize == 2 else 2.0**-22
            )
        elif format.kind is ChannelKind.SRGB:
            slack = 1.5
        else:
            slack = 1.0
        assert_near(level, expected, slack, "one unit of rounding")
        above = level


def test_mipmaps_of_srgb_are_averaged_in_linear_light(device: Device) -> None:
    board = np.zeros((2, 2, 4), np.uint8)
    board[0, 0] = board[1, 1] = 255
    with device.texture(board, Format.RGBA8_SRGB, levels=2) as texture:
        texture.generate_mipmaps()
        gray = texture.read(1)[0, 0]
    assert_near(gray, (187.5, 187.5, 187.5, 127.5), 1.5, "half of the light is 188 in sRGB; alpha is linear")


@pytest.mark.parametrize(("kind", "layers"), [(TextureKind.D2_ARRAY, 3), (TextureKind.CUBE, 6)], ids=identity)
def test_mipmaps_of_layers_do_not_mix(device: Device, kind: TextureKind, layers: int) -> None:
    data = np.broadcast_to(
        np.arange(layers, dtype=np.uint8)[:, None, None, None] * 40, (layers, 4, 4, 4)
    ).copy()
    with device.texture((4, 4), Format.RGBA8, kind=kind, layers=layers, levels=3) as texture:
        texture.write(data)
        texture.generate_mipmaps()
        for level in (1, 2):
            assert_same(texture.read_layers(level), data[:, :1, :1])


def test_mipmaps_of_a_3d_texture_average_its_depth(device: Device) -> None:
    data = np.zeros((2, 2, 2), np.uint8)
    data[1] = 200
    with device.texture((2, 2), Format.R8, kind=TextureKind.D3, layers=2, levels=2) as texture:
        texture.write(data[..., None])
        texture.generate_mipmaps()
        assert_near(texture.read(1), 100, 1, "one unit of rounding")


def test_mipmaps_of_odd_sizes_stay_within_the_range_of_their_texels(device: Device) -> None:
    data = np.full((5, 7, 4), 90, np.uint8)
    with device.texture((7, 5), Format.RGBA8, levels=None) as texture:
        texture.write(data)
        texture.generate_mipmaps()
        for level in range(texture.levels):
            assert_near(texture.read(level), 90, 1, "one unit of rounding")


# -- conversions -------------------------------------------------------------------------------------------


def test_the_reference_conversion_is_its_own_inverse() -> None:
    """A test of the reference: `encode` after `decode` returns every stored number."""
    for format in (Format.RGBA8, Format.RGBA8_SRGB, Format.RGBA8_SNORM, Format.RGBA16):
        top = largest(format)
        stored: Sequence[int] = range(-top if format.kind is ChannelKind.SNORM else 0, top + 1)
        numbers = np.stack([np.array(stored)] * 4, axis=-1)
        assert_near(encode(format, decode(format, numbers)), numbers, 1e-9 * top, "float64")
