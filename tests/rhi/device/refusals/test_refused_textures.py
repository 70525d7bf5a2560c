"""Rules of textures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Access, BufferUsage, CompressedFormat, Device, Format, Op, Region, TextureKind
from rhi.conformance.compare import assert_same
from rhi.conformance.validation.refusal import refuses
from rhi.contract.formats import DEPTH_FORMATS
from rhi.errors import rules


@pytest.mark.parametrize("size", [(0, 4), (4, 0), (-1, 4), (0, 0)], ids=str)
def test_a_texture_needs_a_size(recording: Device, size: tuple[int, int]) -> None:
    with refuses(rules.TEXTURE_SIZE, recording):
        recording.texture(size, Format.RGBA8)
    recording.texture((1, 1), Format.RGBA8).destroy()


@pytest.mark.parametrize("size", [(4,), (4, 4, 4), (4.0, 4.0), ("4", "4")], ids=str)
def test_a_size_is_two_whole_numbers(recording: Device, size: Any) -> None:
    with refuses(rules.TEXTURE_SIZE, recording):
        recording.texture(size, Format.RGBA8)


@pytest.mark.parametrize(
    ("kind", "layers", "fits"),
    [
        (TextureKind.D2, 2, False),
        (TextureKind.D2, 1, True),
        (TextureKind.D2_ARRAY, 0, False),
        (TextureKind.D2_ARRAY, 1, True),
        (TextureKind.D2_ARRAY, 7, True),
        (TextureKind.D3, 0, False),
        (TextureKind.D3, 5, True),
        (TextureKind.CUBE, 5, False),
        (TextureKind.CUBE, 6, True),
        (TextureKind.CUBE, 12, False),
    ],
    ids=str,
)
def test_each_kind_has_its_number_of_layers(
    recording: Device, kind: TextureKind, layers: int, fits: bool
) -> None:
    if fits:
        recording.texture((4, 4), Format.R8, kind=kind, layers=layers).destroy()
    else:
        with refuses(rules.TEXTURE_SIZE, recording):
            recording.texture((4, 4), Format.R8, kind=kind, layers=layers)


@pytest.mark.parametrize(("maximum", "fits"), [(5, False), (6, True)])
def test_the_faces_of_a_cube_are_layers(
    recording: Device, monkeypatch: pytest.MonkeyPatch, maximum: int, fits: bool
) -> None:
    limits = replace(recording.capabilities, max_texture_layers=maximum)
    monkeypatch.setattr(recording._core, "capabilities", limits)
    if fits:
        recording.texture((4, 4), Format.R8, kind=TextureKind.CUBE).destroy()
    else:
        with refuses(rules.DEVICE_CAPABILITY, recording):
            recording.texture((4, 4), Format.R8, kind=TextureKind.CUBE)


def test_the_faces_of_a_cube_are_square(recording: Device) -> None:
    with refuses(rules.TEXTURE_SIZE, recording):
        recording.texture((4, 5), Format.R8, kind=TextureKind.CUBE)
    recording.texture((4, 4), Format.R8, kind=TextureKind.CUBE).destroy()


@pytest.mark.parametrize(
    ("size", "levels", "fits"),
    [
        ((8, 8), 4, True),
        ((8, 8), 5, False),
        ((8, 8), 0, False),
        ((1, 1), 2, False),
        ((9, 3), 4, True),
        ((9, 3), 5, False),
    ],
    ids=str,
)
def test_levels_end_at_one_texel(recording: Device, size: tuple[int, int], levels: int, fits: bool) -> None:
    if fits:
        recording.texture(size, Format.R8, levels=levels).destroy()
    else:
        with refuses(rules.TEXTURE_LEVELS, recording):
            recording.texture(size, Format.R8, levels=levels)


def test_multi_sampled_textures_are_flat_and_have_one_level(recording: Device) -> None:
    with refuses(rules.TEXTURE_SAMPLES, recording):
        recording.texture((4, 4), Format.R8, samples=2, levels=2)
    with refuses(rules.TEXTURE_SAMPLES, recording):
        recording.texture((4, 4), Format.R8, samples=2, kind=TextureKind.D2_ARRAY, layers=2)
    recording.texture((4, 4), Format.R8, samples=2).destroy()


def test_depth_is_not_3d(recording: Device) -> None:
    with refuses(rules.TEXTURE_FORMAT, recording):
        recording.texture((4, 4), Format.D32F, kind=TextureKind.D3, layers=2)
    recording.texture((4, 4), Format.D32F, kind=TextureKind.D2_ARRAY, layers=2).destroy()


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((4, 4, 2), "u1"),
        np.zeros((4, 4, 4), "f4"),
        np.zeros((4, 4), "u1"),
        np.zeros(4, "u1"),
        np.zeros((1, 1, 4, 4, 4), "u1"),
        np.zeros((4, 4, 4), "i1"),
    ],
    ids=lambda a: f"{a.shape}{a.dtype}",
)
def test_texels_must_have_the_format_s_shape_and_dtype(recording: Device, array: Any) -> None:
    with recording.texture((4, 4), Format.RGBA8) as texture:
        with refuses(rules.TEXTURE_DATA, recording):
            texture.write(array)
        assert_same(texture.read(), 0)
        texture.write(np.ones((4, 4, 4), "u1"))


def test_a_texture_made_from_wrong_texels_leaves_nothing_behind(recording: Device) -> None:
    creations = recording.statistics.creations
    with refuses(rules.TEXTURE_DATA):
        recording.texture(np.zeros((4, 4, 2), "u1"), Format.RGBA8)
    with refuses(rules.TEXTURE_DATA):
        recording.texture(np.zeros((4, 4, 4), "f4"), Format.RGBA8)
    recording.finish()
    created = recording.stream.filter(Op.CREATE_TEXTURE)
    gone = {command["resource"] for command in recording.stream.filter(Op.DESTROY)}
    assert recording.statistics.creations == creations or created[-1]["texture"] in gone


@pytest.mark.parametrize(
    ("x", "y", "width", "height"),
    [(1, 0, 4, 4), (0, 1, 4, 4), (-1, 0, 2, 2), (0, -1, 2, 2), (4, 0, 1, 1), (0, 0, 5, 1)],
)
def test_a_region_must_lie_in_the_level(recording: Device, x: int, y: int, width: int, height: int) -> None:
    with recording.texture((4, 4), Format.R8) as texture, recording.texture((8, 8), Format.R8) as other:
        region = Region(x, y, width, height)
        with refuses(rules.TEXTURE_REGION, recording):
            texture.write(np.ones((height, width), "u1"), x=x, y=y)
        with refuses(rules.TEXTURE_REGION, recording):
            texture.read(region=region)
        with refuses(rules.TEXTURE_REGION, recording):
            texture.lock(Access.READ, region=region)
        with refuses(rules.TEXTURE_REGION, recording):
            texture.copy_to(other, region=region)
        with refuses(rules.TEXTURE_REGION, recording):
            other.copy_to(texture, region=Region(0, 0, width, height), x=x, y=y)
        texture.write(np.ones((4, 4), "u1"))
        texture.write(np.ones((1, 1), "u1"), x=3, y=3)


def test_a_region_that_is_read_has_one_layer(recording: Device) -> None:
    """The call or the region says which; they may not say two."""
    texels = np.arange(48, dtype=np.uint8).reshape(3, 4, 4, 1)
    texture = recording.texture(texels, Format.R8, kind=TextureKind.D2_ARRAY)
    reads: list[Callable[[int, Region], Any]] = [
        lambda layer, region: texture.read(0, layer, region),
        lambda layer, region: texture.read_async(0, layer, region).result(),
        lambda layer, region: texture.lock(Access.READ, 0, layer, region).__enter__()[..., 0],
    ]
    for read in reads:
        for layer, in_region in ((2, 0), (0, 2), (2, 2)):
            assert_same(read(layer, Region(1, 1, 2, 3, in_region)), texels[2, 1:4, 1:3, 0])
        for layer, region in ((2, Region(1, 1, 2, 3, 1)), (0, Region(0, 0, 4, 4, 0, 2))):
            with refuses(rules.TEXTURE_REGION, recording):
                read(layer, region)


@pytest.mark.parametrize(("width", "height"), [(0, 1), (1, 0)])
def test_a_region_is_not_empty(recording: Device, width: int, height: int) -> None:
    with recording.texture((4, 4), Format.R8) as texture, refuses(rules.TEXTURE_REGION, recording):
        texture.read(region=Region(0, 0, width, height))


@pytest.mark.parametrize(("level", "layer"), [(3, 0), (-1, 0), (0, 2), (0, -1)])
def test_a_level_and_layer_must_exist(recording: Device, level: int, layer: int) -> None:
    with recording.texture((4, 4), Format.R8, kind=TextureKind.D2_ARRAY, layers=2, levels=3) as texture:
        for use in (
            lambda: texture.read(level, layer),
            lambda: texture.write(np.ones((1, 1), "u1"), level, layer),
            lambda: texture.at(level, layer),
            lambda: texture.image(level, layer),
            lambda: texture.lock(Access.READ, level, layer),
        ):
            with refuses(rules.TEXTURE_LEVELS, recording):
                use()
        texture.read(2, 1)
        texture.at(2, 1)


def test_the_layers_of_a_3d_level_shrink(recording: Device) -> None:
    with recording.texture((4, 4), Format.R8, kind=TextureKind.D3, layers=4, levels=3) as texture:
        with refuses(rules.TEXTURE_LEVELS, recording):
            texture.read(1, 2)
        texture.read(1, 1)


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=lambda f: f.name)
def test_depth_is_not_written_by_the_cpu(recording: Device, format: Format) -> None:
    with recording.texture((4, 4), format) as depth:
        with refuses(rules.TEXTURE_FORMAT, recording):
            depth.write(np.zeros((4, 4), "f4"))
        with refuses(rules.TEXTURE_FORMAT, recording):
            depth.lock(Access.WRITE)
        depth.read()
        with depth.lock(Access.READ):
            pass


@pytest.mark.parametrize("format", [Format.D32F, Format.RGBA8], ids=lambda f: f.name)
def test_stencil_is_read_where_there_is_some(recording: Device, format: Format) -> None:
    with recording.texture((4, 4), format) as texture, refuses(rules.TEXTURE_FORMAT, recording):
        texture.read_stencil()
    with recording.texture((4, 4), Format.D24S8) as texture:
        texture.read_stencil()


@pytest.mark.parametrize("format", [Format.R32UI, Format.R32I, Format.D32F], ids=lambda f: f.name)
def test_mipmaps_need_a_format_that_can_be_filtered(recording: Device, format: Format) -> None:
    with recording.texture((4, 4), format, levels=None) as texture, refuses(rules.TEXTURE_FORMAT, recording):
        texture.generate_mipmaps()
    with recording.texture((4, 4), Format.R32F, levels=None) as texture:
        texture.generate_mipmaps()


def test_a_copy_keeps_the_format(recording: Device) -> None:
    with (
        recording.texture((4, 4), Format.RGBA8) as first,
        recording.texture((4, 4), Format.RGBA8_SRGB) as second,
    ):
        with refuses(rules.TEXTURE_FORMAT, recording):
            first.copy_to(second)
    with recording.texture((4, 4), Format.RGBA8) as first, recording.texture((4, 4), Format.RGBA8) as second:
        first.copy_to(second)


@pytest.mark.parametrize(("x", "overlaps"), [(1, True), (2, False)])
def test_a_copy_within_a_texture_must_not_overlap(recording: Device, x: int, overlaps: bool) -> None:
    with recording.texture((4, 4), Format.RGBA8) as texture:
        if overlaps:
            with refuses(rules.TEXTURE_REGION, recording):
                texture.copy_to(texture, region=Region(0, 0, 2, 4), x=x)
        else:
            texture.copy_to(texture, region=Region(0, 0, 2, 4), x=x)


def test_samples_are_resolved_not_read(recording: Device) -> None:
    with (
        recording.texture((4, 4), Format.RGBA8, samples=2) as samples,
        recording.texture((4, 4), Format.RGBA8) as plain,
    ):
        with refuses(rules.TEXTURE_SAMPLES, recording):
            samples.read()
        with refuses(rules.TEXTURE_SAMPLES, recording):
            samples.write(np.zeros((4, 4, 4), "u1"))
        with refuses(rules.TEXTURE_SAMPLES, recording):
            samples.copy_to(plain)
        with refuses(rules.TEXTURE_SAMPLES, recording):
            plain.copy_to(samples)
        with refuses(rules.TEXTURE_SAMPLES, recording), samples.lock(Access.READ):
            pass
        with refuses(rules.TEXTURE_SAMPLES, recording), samples.lock(Access.WRITE):
            pass
        samples.resolve_to(plain)


def test_a_resolve_goes_from_several_samples_to_one(recording: Device) -> None:
    with (
        recording.texture((4, 4), Format.RGBA8) as plain,
        recording.texture((4, 4), Format.RGBA8) as other,
        recording.texture((4, 4), Format.RGBA8, samples=2) as samples,
    ):
        with refuses(rules.TEXTURE_SAMPLES, recording):
            plain.resolve_to(other)
        with refuses(rules.TEXTURE_SAMPLES, recording):
            samples.resolve_to(samples)


@pytest.mark.parametrize(("size", "format"), [((5, 4), Format.RGBA8), ((4, 4), Format.RGBA16F)], ids=str)
def test_a_resolve_keeps_size_and_format(recording: Device, size: tuple[int, int], format: Format) -> None:
    with (
        recording.texture((4, 4), Format.RGBA8, samples=2) as samples,
        recording.texture(size, format) as target,
    ):
        with refuses(rules.TEXTURE_FORMAT, recording):
            samples.resolve_to(target)


def test_a_texture_is_locked_once_at_a_time(recording: Device) -> None:
    with recording.texture((4, 4), Format.R8) as texture:
        first, second = texture.lock(Access.WRITE), texture.lock(Access.WRITE)
        with first, refuses(rules.LOCK_TWICE, recording), second:
            pass
        with second:
            pass


def test_a_texture_locked_for_reading_is_not_locked_again(recording: Device) -> None:
    with recording.texture((4, 4), Format.R8) as texture:
        with texture.lock(Access.READ), refuses(rules.LOCK_OPEN, recording), texture.lock(Access.READ):
            pass


@pytest.mark.parametrize("use", ["read", "write", "copy", "mipmaps", "clear", "sampled"])
def test_a_locked_texture_is_not_used(recording: Device, use: str) -> None:
    with (
        recording.texture((4, 4), Format.R8, levels=2) as texture,
        recording.texture((4, 4), Format.R8) as other,
    ):
        uses: dict[str, Callable[[], Any]] = {
            "read": texture.read,
            "write": lambda: texture.write(np.ones((4, 4), "u1")),
            "copy": lambda: texture.copy_to(other),
            "mipmaps": texture.generate_mipmaps,
            "clear": lambda: recording.render_pass(texture, clear=(0, 0, 0, 0)),
            "sampled": lambda: texture.image(),
        }
        with texture.lock(Access.READ), refuses(rules.LOCK_OPEN, recording):
            uses[use]()
        uses[use]()


def test_the_end_of_a_texture_lock_needs_its_beginning(recording: Device) -> None:
    with recording.texture((4, 4), Format.R8) as texture:
        lock = texture.lock(Access.WRITE)
        with refuses(rules.LOCK_CLOSED, recording):
            lock.__exit__(None, None, None)


def test_a_destroyed_texture_is_not_used(recording: Device) -> None:
    texture = recording.texture((4, 4), Format.R8)
    with recording.texture((4, 4), Format.R8) as other:
        texture.destroy()
        for use in (
            texture.read,
            lambda: texture.write(np.ones((4, 4), "u1")),
            lambda: texture.copy_to(other),
            lambda: other.copy_to(texture),
            lambda: texture.lock(Access.READ),
            lambda: texture.image(),
            lambda: texture.at(),
            lambda: recording.render_pass(texture),
            lambda: recording.present(texture),
        ):
            with refuses(rules.RESOURCE_DESTROYED, recording):
                use()


def test_a_texture_of_another_device_is_not_used(recording: Device, device: Device) -> None:
    with recording.texture((4, 4), Format.R8) as mine, device.texture((4, 4), Format.R8) as theirs:
        for use in (
            lambda: mine.copy_to(theirs),
            lambda: recording.render_pass(theirs),
            lambda: recording.present(theirs),
        ):
            with refuses(rules.RESOURCE_FOREIGN, recording):
                use()


def test_a_format_is_no_text(recording: Device) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.texture((4, 4), "R8")  # type: ignore[arg-type]
    recording.texture((4, 4), Format.R8).destroy()


# -- copies to and from buffers ----------------------------------------------------------------------------


def test_a_copy_to_a_buffer_stays_inside_it(recording: Device) -> None:
    with recording.texture((4, 3), Format.RGBA8) as texture, recording.buffer(64) as buffer:
        for bad in ({"offset": 20}, {"offset": -16}, {"row_bytes": 28}):
            with refuses(rules.BUFFER_RANGE, recording):
                texture.copy_to_buffer(buffer, **bad)
            with refuses(rules.BUFFER_RANGE, recording):
                texture.copy_from_buffer(buffer, **bad)
        texture.copy_to_buffer(buffer, offset=16)
        texture.copy_from_buffer(buffer, row_bytes=24)


@pytest.mark.parametrize(
    ("format", "bad", "good"),
    [
        (Format.R8, {"offset": 2}, {"offset": 4}),
        (Format.RGBA32F, {"offset": 8}, {"offset": 16}),
        (Format.RGBA8, {"row_bytes": 15}, {"row_bytes": 16}),
        (Format.RGBA8, {"row_bytes": 12}, {"row_bytes": 20}),
        (Format.RG16F, {"row_bytes": 18}, {"row_bytes": 20}),
    ],
)
def test_rows_and_offsets_are_whole_texels(
    recording: Device, format: Format, bad: dict[str, int], good: dict[str, int]
) -> None:
    with recording.texture((4, 3), format) as texture, recording.buffer(512) as buffer:
        with refuses(rules.BUFFER_ALIGNMENT, recording):
            texture.copy_to_buffer(buffer, **bad)
        with refuses(rules.BUFFER_ALIGNMENT, recording):
            texture.copy_from_buffer(buffer, **bad)
        texture.copy_to_buffer(buffer, **good)
        texture.copy_from_buffer(buffer, **good)


def test_a_single_row_that_is_too_long_for_a_driver_is_refused(recording: Device) -> None:
    with recording.texture((4, 3), Format.RGBA8) as texture, recording.buffer(16) as buffer:
        row = rhi.Region(0, 0, 4, 1)
        with refuses(rules.BUFFER_ALIGNMENT, recording):
            texture.copy_to_buffer(buffer, region=row, row_bytes=1 << 31)
        with refuses(rules.BUFFER_ALIGNMENT, recording):
            texture.copy_from_buffer(buffer, region=row, row_bytes=1 << 70)
        texture.copy_from_buffer(buffer, region=row, row_bytes=(1 << 31) - 4)
        texture.read()


def test_depth_is_not_copied_from_a_buffer(recording: Device) -> None:
    with recording.texture((4, 4), Format.D32F) as texture, recording.buffer(64) as buffer:
        with refuses(rules.TEXTURE_FORMAT, recording):
            texture.copy_from_buffer(buffer)
        texture.copy_to_buffer(buffer)


def test_samples_are_not_copied_to_a_buffer(recording: Device) -> None:
    with recording.texture((4, 4), Format.RGBA8, samples=4) as texture, recording.buffer(256) as buffer:
        with refuses(rules.TEXTURE_SAMPLES, recording):
            texture.copy_to_buffer(buffer)
        with refuses(rules.TEXTURE_SAMPLES, recording):
            texture.copy_from_buffer(buffer)
        with refuses(rules.TEXTURE_SAMPLES, recording):
            texture.read_async()


def test_both_ends_of_a_copy_must_be_usable(recording: Device) -> None:
    texture, buffer = recording.texture((4, 4), Format.RGBA8), recording.buffer(64)
    with buffer.lock(Access.READ), refuses(rules.LOCK_OPEN, recording):
        texture.copy_to_buffer(buffer)
    buffer.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        texture.copy_to_buffer(buffer)
    other = recording.buffer(64)
    texture.destroy()
    for call in (lambda: texture.copy_from_buffer(other), lambda: texture.read_async()):
        with refuses(rules.RESOURCE_DESTROYED, recording):
            call()


def test_memory_for_reads_is_made_by_reads_only(recording: Device) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.buffer(64, usage=BufferUsage.READBACK)
    recording.buffer(64, usage=BufferUsage.STREAM).destroy()


@pytest.mark.parametrize(
    ("format", "shape", "dtype"),
    [
        (Format.RGBA8UI, (4, 4, 3), "u1"),
        (Format.RG8, (4, 4, 3), "u1"),
        (Format.RGBA8, (4, 4, 2), "u1"),
        (Format.RGBA8, (4, 4, 3), "f4"),
        (Format.RGBA16F, (4, 4, 3), "f4"),
        (Format.R11G11B10F, (4, 4, 3), "u4"),
    ],
)
def test_only_colors_may_lack_alpha(
    recording: Device, format: Format, shape: tuple[int, ...], dtype: str
) -> None:
    with recording.texture((4, 4), format) as texture, refuses(rules.TEXTURE_DATA, recording):
        texture.write(np.zeros(shape, dtype))


# -- compressed textures -----------------------------------------------------------------------------------


def test_a_compressed_texture_is_only_written_and_sampled(recording: Device) -> None:
    with (
        recording.texture((8, 8), CompressedFormat.BC1, levels=2) as texture,
        recording.texture((8, 8), Format.RGBA8) as other,
        recording.buffer(1024) as buffer,
    ):
        calls: list[Callable[[], object]] = [
            texture.read,
            texture.read_layers,
            texture.read_async,
            texture.generate_mipmaps,
            texture.at,
            texture.image,
            lambda: texture.lock(Access.READ),
            lambda: texture.copy_to(other),
            lambda: other.copy_to(texture),
            lambda: texture.copy_to_buffer(buffer),
            lambda: texture.copy_from_buffer(buffer),
        ]
        for call in calls:
            with refuses(rules.TEXTURE_FORMAT, recording):
                call()
        with refuses(rules.PASS_TARGET, recording):
            recording.render_pass(texture)
        texture.write(np.zeros((2, 2, 8), "u1"))


@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((2, 2, 16), "u1"), ((2, 2, 8), "i1"), ((8, 8, 4), "u1"), ((4, 8), "u1"), ((1, 1, 2, 2, 8), "u1")],
)
def test_blocks_are_bytes_of_their_format(recording: Device, shape: tuple[int, ...], dtype: str) -> None:
    with recording.texture((8, 8), CompressedFormat.BC1) as texture, refuses(rules.TEXTURE_DATA, recording):
        texture.write(np.zeros(shape, dtype))


@pytest.mark.parametrize(
    ("x", "y", "columns", "rows", "fits"),
    [(0, 0, 3, 2, True), (4, 4, 2, 1, True), (8, 4, 1, 1, True), (2, 0, 1, 1, False), (0, 2, 1, 1, False),
     (0, 0, 4, 2, False), (0, 0, 3, 3, False), (12, 0, 1, 1, False), (-4, 0, 1, 1, False)],
)  # fmt: skip
def test_blocks_lie_inside_the_level(
    recording: Device, x: int, y: int, columns: int, rows: int, fits: bool
) -> None:
    """A level of 10×7 texels has 3×2 blocks."""
    blocks = np.zeros((rows, columns, 8), "u1")
    with recording.texture((10, 7), CompressedFormat.BC1) as texture:
        if fits:
            texture.write(blocks, x=x, y=y)
        else:
            with refuses(rules.TEXTURE_REGION, recording):
                texture.write(blocks, x=x, y=y)


def test_volumes_and_samples_are_not_compressed(recording: Device) -> None:
    with refuses(rules.TEXTURE_FORMAT, recording):
        recording.texture((8, 8), CompressedFormat.BC7, kind=TextureKind.D3, layers=4)
    with refuses(rules.TEXTURE_SAMPLES, recording):
        recording.texture((8, 8), CompressedFormat.BC7, samples=4)
    recording.texture((8, 8), CompressedFormat.BC7, kind=TextureKind.CUBE).destroy()


def test_a_device_that_stores_blocks_gets_them_as_they_are() -> None:
    blocks = np.random.default_rng(0).integers(0, 256, (2, 3, 8), np.uint8)
    stores = rhi.Capabilities(
        "null", "blocks", "1", shading=False, compressed_formats=frozenset({CompressedFormat.BC1})
    )
    for profile, native in ((stores, True), ("everything", False)):
        with rhi.create_device("null", profile=profile) as device:
            device.texture(blocks, CompressedFormat.BC1)
            (created,), (written,) = (
                device.stream.filter(op) for op in (Op.CREATE_TEXTURE, Op.WRITE_TEXTURE)
            )
            assert created["descriptor"].compressed is (CompressedFormat.BC1 if native else None)
            assert created["descriptor"].format is Format.RGBA8
            assert written["region"] == Region(0, 0, 12, 8)
            assert len(written["data"]) == (48 if native else 12 * 8 * 4)
