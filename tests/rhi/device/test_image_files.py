"""Image files and inferred formats: what is read and written, and what is refused by name."""

from __future__ import annotations

import io
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import DeviceError, Format, ValidationError
from rhi.contract import encode

Image = pytest.importorskip("PIL.Image", reason="no Pillow: pip install rhi[images]")

RNG = np.random.default_rng(5)


@pytest.fixture(scope="module")
def gl_device() -> Iterator[rhi.Device]:
    with rhi.create_device("gl") as device:
        yield device


COLORS = RNG.integers(0, 256, (5, 7, 4), np.uint8)


@pytest.mark.parametrize("format", [Format.RGBA8, Format.RGBA8_SRGB, Format.R8, Format.R16])
def test_bytes_come_back_from_a_file_as_they_are(
    format: Format, gl_device: rhi.Device, tmp_path: Path
) -> None:
    largest = np.iinfo(format.dtype).max
    texels = RNG.integers(0, largest + 1, (5, 7, format.channels), format.dtype, endpoint=False)
    texture = gl_device.texture(texels, format)
    texture.save(tmp_path / "image.png")
    read = rhi.load_image(tmp_path / "image.png")
    if format is Format.R16:
        assert np.array_equal(read, texels[..., 0])
    elif format is Format.R8:
        assert np.array_equal(read[..., :3], texels.repeat(3, axis=2))
    else:
        assert np.array_equal(read, texels)


@pytest.mark.parametrize(
    "format", [Format.RGBA16F, Format.R11G11B10F, Format.RGBA16, Format.RGB10A2, Format.RG8]
)
def test_other_formats_are_written_as_a_screen_shows_them(format: Format, gl_device: rhi.Device) -> None:
    """Floats as sRGB, which the standard's own numbers say: half of the light is 188 of 255; unsigned ones as
    bytes."""
    light = np.zeros((2, 3, format.channels))
    light[..., :] = 0.5
    light[0, 0] = 7.0 if format.kind.value == "float" else 1.0
    texels = encode(format, light)
    texture = gl_device.texture(
        texels if texels.shape[-1] == format.components else texels[..., None], format
    )
    png = texture._repr_png_()
    assert png is not None
    image = rhi.load_image(png)
    expected = 188 if format.kind.value == "float" else 128
    assert np.abs(image[1, 1, : min(format.channels, 3)].astype(int) - expected).max() <= 1
    assert (image[0, 0, : min(format.channels, 3)] == 255).all()
    assert (image[..., 2] == 0).all() == (format is Format.RG8)


def test_depth_is_grey(gl_device: rhi.Device) -> None:
    depth = gl_device.texture((4, 4), Format.D32F)
    with gl_device.render_pass((), depth, clear_depth=0.25):
        pass
    png = depth._repr_png_()
    assert png is not None
    assert np.unique(rhi.load_image(png)[..., :3]).tolist() == [64]


def test_integers_are_refused_and_show_nothing(null_device: rhi.Device, tmp_path: Path) -> None:
    texture = null_device.texture((2, 2), Format.R32UI)
    with pytest.raises(ValidationError, match="texture-format") as error:
        texture.save(tmp_path / "image.png")
    assert error.value.site is not None
    assert error.value.site.file == __file__
    assert texture._repr_png_() is None
    texture = null_device.texture((2, 2), Format.RGBA8)
    assert texture._repr_png_() is not None
    texture.destroy()
    assert texture._repr_png_() is None


def test_a_file_s_suffix_selects_the_format_and_an_unknown_suffix_is_refused(
    gl_device: rhi.Device, tmp_path: Path
) -> None:
    texture = gl_device.texture(COLORS)
    texture.save(tmp_path / "image.jpg")
    assert (tmp_path / "image.jpg").read_bytes().startswith(b"\xff\xd8\xff")
    with pytest.raises(ValidationError, match="image-file"):
        texture.save(tmp_path / "image.hologram")


@pytest.mark.parametrize("source", [b"GIF89a", b"", "missing.png", __file__])
def test_a_file_that_is_not_an_image_is_refused(source: Any) -> None:
    with pytest.raises(ValidationError, match="image-file") as error:
        rhi.load_image(source)
    assert error.value.site is not None
    assert error.value.site.file == __file__


def test_a_photo_is_turned_upright_and_grey_is_a_color() -> None:
    photo, file = Image.fromarray(COLORS[..., :3]), io.BytesIO()
    tags = photo.getexif()
    tags[0x0112] = 6  # the camera was held a quarter turn
    photo.save(file, "png", exif=tags)
    assert np.array_equal(rhi.load_image(file.getvalue())[..., :3], np.rot90(COLORS[..., :3], -1))
    file = io.BytesIO()
    Image.fromarray(COLORS[..., 0]).save(file, "png")
    assert np.array_equal(
        rhi.load_image(file), np.dstack([*[COLORS[..., 0]] * 3, np.full((5, 7), 255, np.uint8)])
    )


@pytest.mark.parametrize(
    ("shape", "dtype", "format"),
    [
        ((4, 4), "u1", Format.R8),
        ((4, 4, 2), "u1", Format.RG8),
        ((4, 4, 3), "u1", Format.RGBA8),
        ((4, 4, 4), "u1", Format.RGBA8),
        ((2, 4, 4, 4), "u1", Format.RGBA8),
        ((4, 4), "u2", Format.R16),
        ((4, 4, 3), "f2", Format.RGBA16F),
        ((4, 4), "f4", Format.R32F),
        ((4, 4, 2), "u4", Format.RG32UI),
        ((4, 4, 4), "i4", Format.RGBA32I),
    ],
)
def test_a_format_follows_from_an_array(
    shape: tuple[int, ...], dtype: str, format: Format, null_device: rhi.Device
) -> None:
    kind = rhi.TextureKind.D2_ARRAY if len(shape) == 4 else rhi.TextureKind.D2
    texture = null_device.texture(np.ones(shape, dtype), kind=kind)
    assert (texture.format, texture.size) == (format, (4, 4))
    assert np.array_equal(texture.read()[..., :2], np.ones(texture.read()[..., :2].shape))


@pytest.mark.parametrize(
    ("shape", "dtype"), [((4, 4), "i2"), ((4, 4, 5), "u1"), ((4, 4), "?"), ((4, 4, 3), "i8")]
)
def test_an_array_of_no_format_is_refused_with_those_that_are(
    shape: tuple[int, ...], dtype: str, null_device: rhi.Device
) -> None:
    with pytest.raises(ValidationError, match="texture-data") as error:
        null_device.texture(np.ones(shape, dtype))
    assert "float32" in error.value.allowed


def test_a_size_needs_a_format(null_device: rhi.Device) -> None:
    with pytest.raises(ValidationError, match="device-argument"):
        null_device.texture((4, 4))


@pytest.mark.parametrize("mode", ["RGBA", "RGB", "L", "P", "1", "LA"])
def test_an_image_of_pillow_becomes_colors_with_mip_levels_on_request(
    mode: str, null_device: rhi.Device
) -> None:
    image = Image.fromarray(COLORS).convert(mode)
    texture = null_device.texture(image, levels=None)
    assert (texture.format, texture.levels) == (Format.RGBA8, 3)
    assert np.array_equal(texture.read(), np.array(image.convert("RGBA")))


def write_tiff(texels: np.ndarray, sample_format: int) -> bytes:
    """Return an uncompressed TIFF of one channel; `sample_format`: 1 without a sign, 2 with one, 3 floats."""
    tags = {256: texels.shape[1], 257: texels.shape[0], 258: texels.itemsize * 8, 259: 1, 262: 1, 273: 134}
    tags |= {277: 1, 278: texels.shape[0], 279: texels.nbytes, 339: sample_format}
    rows = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + rows + bytes(4) + texels.tobytes()


@pytest.mark.parametrize(
    ("dtype", "sample_format"), [("<u2", 1), ("<u4", 1), ("<i4", 2), ("<f4", 3), ("<i2", 2)]
)
def test_numbers_of_a_tiff_are_read_unchanged(
    dtype: str, sample_format: int, null_device: rhi.Device
) -> None:
    rng = np.random.default_rng(3)
    numbers = rng.integers(0, 256, (3, 5, np.dtype(dtype).itemsize), np.uint8).view(dtype)[..., 0]
    numbers = np.nan_to_num(numbers) if dtype == "<f4" else numbers
    content = write_tiff(np.ascontiguousarray(numbers), sample_format)
    texels = rhi.load_image(content)
    assert texels.dtype == ("<i4" if dtype == "<i2" else dtype)
    assert np.array_equal(texels, numbers)
    assert np.array_equal(null_device.texture(texels).read(), numbers)
    with rhi.open_image(content) as image:
        if dtype == "<u2":
            expected = (numbers.astype(np.uint32) * 255 + 32767) // 65535
            assert np.array_equal(rhi.decode_colors(image)[..., 0], expected)
        else:
            with pytest.raises(ValidationError, match=r"image-file[\s\S]*no colours"):
                rhi.decode_colors(image)


def test_integers_of_pillow_are_numbers(null_device: rhi.Device) -> None:
    numbers = np.array([[-5, 70_000], [0, 2**31 - 1]], np.int32)
    texture = null_device.texture(Image.fromarray(numbers))
    assert texture.format is Format.R32I
    assert np.array_equal(texture.read(), numbers)


def test_a_block_compressed_dds_is_decoded() -> None:
    """One block of BC1: both end colors are pure red, 5:6:5, and all texels take the first."""
    header = np.zeros(32, "<u4")
    header[:8] = 0x20534444, 124, 0x81007, 4, 4, 8, 0, 0
    header[19:22] = 32, 4, 0x31545844  # DXT1
    header[27] = 0x1000
    block = np.array([0xF800, 0xF800, 0, 0], "<u2")
    texels = rhi.load_image(header.tobytes() + block.tobytes())
    assert np.array_equal(texels, np.full((4, 4, 4), (255, 0, 0, 255)))


def test_pillow_is_named_where_it_is_missing(
    monkeypatch: pytest.MonkeyPatch, null_device: rhi.Device
) -> None:
    monkeypatch.setitem(sys.modules, "PIL", None)
    for call in (
        lambda: rhi.load_image("a.png"),
        lambda: null_device.texture((1, 1), Format.R8).save("a.png"),
    ):
        with pytest.raises(DeviceError, match="image-library") as error:
            call()
        assert 'pip install "rhi[images]"' in error.value.tip
