"""Image files of strangers: formats by a list, limits before decoding, and one rule for all that is wrong."""

from __future__ import annotations

import ast
import io
import math
import os
import random
import struct
import tracemalloc
import warnings
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from image_files import LISTED, WAYS_TO_RUN_A_PROGRAM, ProgramWatch, make_deep_png, make_png, save

import rhi
from rhi import Format, ValidationError

Image = pytest.importorskip("PIL.Image", reason="no Pillow: pip install rhi[images]")
ROOT = Path(__file__).parents[3]
RNG = np.random.default_rng(11)
TEXELS = RNG.integers(0, 256, (6, 9, 3), np.uint8)
OPENERS = ("Image.open", "PIL.Image.open", "library.open")
LOSSY = ("JPEG", "WEBP")


def list_formats() -> list[str]:
    """The formats of which Pillow has a reader here, by its names."""
    Image.init()
    return sorted(set(Image.OPEN) | {"EPS"})


@cache  # encoders of some formats take half a second
def list_writable() -> tuple[str, ...]:
    """The formats that Pillow both writes and reads here."""
    writable = []
    for name in list_formats():
        try:
            save(name, TEXELS)
        except Exception:
            continue
        writable.append(name)
    return tuple(writable)


def refusal(source: Any, **options: Any) -> ValidationError:
    with pytest.raises(ValidationError) as error:
        rhi.load_image(source, **options)
    assert error.value.rule.id == "image-file"
    return error.value


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProgramWatch:
    from PIL import EpsImagePlugin

    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)  # what it has found, it looks for once
    return ProgramWatch(tmp_path / "programs", monkeypatch)


@pytest.mark.parametrize("name", LISTED)
def test_listed_formats_are_read(name: str) -> None:
    read = rhi.load_image(save(name, TEXELS))
    assert read.shape == (6, 9, 4)
    assert np.abs(read[..., :3].astype(int) - TEXELS).mean() < (90 if name in LOSSY else 0.1)


@pytest.mark.parametrize("name", sorted(set(list_writable()) - set(LISTED) - {"DIB", "MPO"}))
def test_image_formats_that_are_not_listed_are_refused_with_their_first_bytes(name: str) -> None:
    content = save(name, TEXELS)
    error = refusal(content)
    assert "it begins with" in error.given or name == "ICO"
    assert "PNG, JPEG, WebP, TIFF, BMP, DDS or TGA" in error.allowed


@pytest.mark.parametrize("content", WAYS_TO_RUN_A_PROGRAM.values(), ids=WAYS_TO_RUN_A_PROGRAM)
def test_no_file_starts_a_program(content: bytes, programs: ProgramWatch, tmp_path: Path) -> None:
    (tmp_path / "wood.png").write_bytes(content)
    for source in (content, bytearray(content), io.BytesIO(content), tmp_path / "wood.png"):
        refusal(source)
    assert programs.calls == []
    opened = Image.open(io.BytesIO(content))  # by someone else, who asks for its colours
    with pytest.raises(ValidationError, match="image-file"):
        rhi.decode_colors(opened)
    assert programs.calls == []
    with pytest.raises(Exception, match=r".*"):  # so the stand-in would have noticed it
        opened.load()
    assert programs.calls


def test_every_call_that_opens_images_lists_formats() -> None:
    """A reader that is added later lists formats, too."""
    calls = []
    for package in ("rhi", "rhi_screen", "renderer", "examples"):
        for path in sorted((ROOT / package).rglob("*.py")):
            text = path.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text)) if "PIL" in text or "pillow" in text else ():
                if isinstance(node, ast.Call) and ast.unparse(node.func) in OPENERS:
                    has_formats = any(keyword.arg == "formats" for keyword in node.keywords)
                    calls.append((f"{path.relative_to(ROOT)}:{node.lineno}", has_formats))
    assert len(calls) >= 2
    assert [line for line, has_formats in calls if not has_formats] == []


# -- limits ------------------------------------------------------------------------------------------------


def make_heads(width: int, height: int) -> dict[str, bytes]:
    """Files that claim a size and have no pixels."""
    tga = np.zeros(18, np.uint8)
    tga[2], tga[16] = 2, 24
    tga[12:16] = np.array([width, height], "<u2").view(np.uint8)
    dds = np.zeros(32, "<u4")
    dds[:8] = 0x20534444, 124, 0x81007, height, width, 8, 0, 0
    dds[19:22] = 32, 4, 0x31545844
    dds[27] = 0x1000
    bmp = np.zeros(13, "<u4")
    bmp[:4] = 40, width, height, 1 | 24 << 16
    return {
        "PNG": make_png(width, height, b""),
        "PNG of bits": make_png(width, height, b"", depth=1, color_type=0),
        "TGA": tga.tobytes(),
        "DDS": dds.tobytes(),
        "BMP": b"BM" + np.array([0, 0, 54], "<u4").tobytes() + bmp.tobytes()[:40],
    }


@pytest.mark.parametrize("name", make_heads(1, 1))
def test_pixels_are_counted_before_they_are_decoded(name: str) -> None:
    error = refusal(make_heads(8193, 8192)[name])
    assert "67,117,056 pixels, 8,193 × 8,192" in error.given
    assert error.allowed == "at most 67,108,864 pixels"
    assert "max_pixels" in error.tip
    assert "pixels, " not in refusal(make_heads(8193, 8192)[name], max_pixels=8193 * 8192).given  # broken
    assert "pixels, " not in refusal(make_heads(64, 64)[name]).given


def test_an_image_at_the_limit_is_read_and_one_beyond_is_not() -> None:
    content = save("PNG", TEXELS)
    assert rhi.load_image(content, max_pixels=54).shape == (6, 9, 4)
    refusal(content, max_pixels=53)
    with rhi.open_image(content, max_pixels=54) as image:
        assert image.size == (9, 6)
    with pytest.raises(ValidationError, match=r"rhi\.open_image"):
        rhi.open_image(content, max_pixels=53)


@pytest.mark.parametrize("limit", [None, "x", math.nan, 0, -1, -math.inf, True, 1j, [54]])
def test_a_limit_that_is_no_number_of_pixels_is_refused(limit: Any) -> None:
    content = save("PNG", TEXELS)
    assert rhi.load_image(content, max_pixels=math.inf).shape == (6, 9, 4)
    with pytest.raises(ValidationError, match=r"(?s)^\[device-argument\].*max_pixels"):
        rhi.load_image(content, max_pixels=limit)


@pytest.mark.parametrize("side", [9_500, 14_000, 50_000])  # Pillow warns, and refuses, at sizes of its own
def test_warnings_that_are_errors_are_the_same_rule(side: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        refusal(make_heads(side, side)["PNG"])


# -- whatever is wrong ------------------------------------------------------------------------------------


def mutate(content: bytes, seed: int) -> bytes:
    """Return a file with a few bytes changed, cut off, or repeated."""
    pick, data = random.Random(seed), bytearray(content)
    for _ in range(pick.randrange(1, 6)):
        data[pick.randrange(len(data))] = pick.randrange(256)
    if pick.random() < 0.3:
        del data[pick.randrange(len(data)) :]
    if pick.random() < 0.2:
        start = pick.randrange(max(len(data), 1))
        data[start:start] = data[start : start + 40]
    return bytes(data)


def check_mutations(name: str, count: int) -> None:
    contents = [save(name, TEXELS)]
    if name == "PNG":
        contents += [make_deep_png(RNG.integers(0, 65536, (6, 9, size), np.uint16)) for size in (1, 2, 3, 4)]
    outcomes = set()
    for seed in range(count):
        try:
            rhi.load_image(mutate(contents[seed % len(contents)], seed), max_pixels=1 << 20)
        except rhi.RhiError as error:
            outcomes.add(error.rule.id)
    assert outcomes == {"image-file"}


@pytest.mark.parametrize("name", list_writable())
def test_a_damaged_file_is_read_or_refused_by_one_rule(name: str) -> None:
    check_mutations(name, 40)


@pytest.mark.nightly
@pytest.mark.parametrize("name", list_writable())
def test_thousands_of_damaged_files_are_read_or_refused_by_one_rule(name: str) -> None:
    check_mutations(name, 2000)


PNG_KINDS = [
    (1, 0, 1),
    (8, 0, 8),
    (16, 0, 16),
    (8, 2, 24),
    (16, 2, 48),
    (8, 4, 16),
    (16, 4, 32),
    (8, 6, 32),
    (16, 6, 64),
]
"""Depth, color type and bits of a pixel."""
PASSES = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
"""Of interlaced files: first column and row, steps to the right and down."""


@pytest.mark.parametrize(("depth", "color_type", "bits"), PNG_KINDS)
@pytest.mark.parametrize("level", [0x50, 0])
def test_a_png_whose_pixels_end_early_is_refused(depth: int, color_type: int, bits: int, level: int) -> None:
    row = 1 + 16 * bits // 8
    rows = (b"\0" + bytes([level]) * (row - 1)) * 16
    whole = make_png(16, 16, rows, depth=depth, color_type=color_type)
    assert rhi.load_image(whole).shape[:2] == (16, 16)  # one that ends black, too
    for length in (0, 1, row, row * 15, row * 15 + 1, row * 16 - 1):
        cut = make_png(16, 16, rows[:length], depth=depth, color_type=color_type)
        refusal(cut)
        with pytest.raises(ValidationError, match="image-file"):
            rhi.decode_colors(rhi.open_image(cut))


@pytest.mark.parametrize("size", [(16, 16), (1, 1), (2, 1), (3, 2), (1, 7), (5, 9)])
def test_an_interlaced_png_whose_pixels_end_early_is_refused(size: tuple[int, int]) -> None:
    width, height = size
    rows = b""
    for column, row, right, down in PASSES:
        columns = len(range(column, width, right))
        rows += (b"\0" + bytes([90]) * columns * 3) * len(range(row, height, down)) if columns else b""
    read = rhi.load_image(make_png(width, height, rows, color_type=2, interlace=1))
    assert (read == (90, 90, 90, 255)).all()
    for length in {0, 1, len(rows) // 2, len(rows) - 1}:
        refusal(make_png(width, height, rows[:length], color_type=2, interlace=1))


def test_few_compressed_bytes_are_refused_before_memory_is_taken() -> None:
    tracemalloc.start()
    try:
        assert "of 335,544,320 bytes of pixels" in refusal(make_png(1, 1 << 26, b"\0" * 99)).given
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    refusal(make_png(8192, 8192, b"\0" * 8192, depth=16, color_type=0))
    solid = make_png(600, 600, (b"\0" + b"\7" * 600) * 600, color_type=0)  # compressed 1000 times
    assert (rhi.load_image(solid)[..., 0] == 7).all()


def test_a_png_begins_with_its_head() -> None:
    content = save("PNG", TEXELS)
    text = b"\0\0\0\3tEXta\0b" + (0x3A4E3D45).to_bytes(4, "big")
    refusal(content[:8] + text + content[8:])


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_rounding_sixteen_bits_takes_little_memory(size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    from rhi.device.resources import image_decoding

    monkeypatch.setattr(image_decoding, "_BAND_PIXELS", 1 << 12)
    content = make_deep_png(RNG.integers(0, 65536, (256, 256, size), np.uint16))
    image = rhi.open_image(content)
    tracemalloc.start()
    try:
        rhi.decode_colors(image)
        assert tracemalloc.get_traced_memory()[1] < 256 * 256 * 16 + 3 * len(
            content
        )  # 4 bytes are the result's
    finally:
        tracemalloc.stop()


class Failing(io.BytesIO):
    def read(self, *_: object) -> bytes:
        raise RuntimeError("the archive is closed")


WRONG: dict[str, Callable[[Path], Any]] = {
    "nothing": lambda _: None,
    "a number": lambda _: 3,
    "texels": lambda _: np.zeros((2, 2, 4), np.uint8),
    "a list": lambda _: [1, 2],
    "a folder": lambda folder: folder,
    "a missing file": lambda folder: folder / "missing.png",
    "an empty name": lambda _: "",
    "a name with a zero": lambda _: "a\0.png",
    "no bytes": lambda _: b"",
    "text": lambda folder: io.StringIO("PNG"),
    "a file that fails": lambda _: Failing(),
    "a closed file": lambda _: _closed(),
}


def _closed() -> io.BytesIO:
    file = io.BytesIO(save("PNG", TEXELS))
    file.close()
    return file


@pytest.mark.parametrize("name", WRONG)
def test_unreadable_image_files_are_refused_by_the_same_rule(name: str, tmp_path: Path) -> None:
    error = refusal(WRONG[name](tmp_path))
    assert error.site is not None
    assert error.site.file == __file__


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes in folders")
def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.png")
    assert "regular file" in refusal(tmp_path / "pipe.png").given


def test_all_forms_of_a_file_are_read(tmp_path: Path) -> None:
    content = save("PNG", TEXELS)
    (tmp_path / "a.png").write_bytes(content)
    file = io.BytesIO(content)
    file.seek(0, io.SEEK_END)  # as it is after writing
    with open(tmp_path / "a.png", "rb") as opened:
        sources: list[Any] = [
            content,
            bytearray(content),
            memoryview(content),
            file,
            opened,
            tmp_path / "a.png",
        ]
        for source in [*sources, str(tmp_path / "a.png")]:
            assert np.array_equal(rhi.load_image(source)[..., :3], TEXELS)


@pytest.mark.parametrize("target", ["missing/a.png", "folder", "a.hologram", "noending"])
def test_a_file_that_cannot_be_written_is_refused_by_the_same_rule(
    target: str, tmp_path: Path, null_device: rhi.Device
) -> None:
    (tmp_path / "folder").mkdir()
    texture = null_device.texture((2, 2), Format.RGBA8)
    with pytest.raises(ValidationError, match="image-file"):
        texture.save(tmp_path / target)
    texture.save(tmp_path / "a.png")


# -- 16 bits -----------------------------------------------------------------------------------------------


def round_to_bytes(channels: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return np.rint(channels / 257.0).astype(np.uint8)


@pytest.mark.parametrize("size", [1, 2, 3, 4])
@pytest.mark.parametrize("has_transparency", [False, True])
def test_sixteen_bits_of_a_png_are_rounded_with_their_transparency(size: int, has_transparency: bool) -> None:
    if has_transparency and size in (2, 4):
        pytest.skip("a PNG with alpha has no transparent colour")
    channels = RNG.integers(0, 65536, (40, 30, size), np.uint16)
    channels[0, :4] = np.array([0, 127, 129, 65535])[:, None]  # below and above a half
    channels[1, 0] = channels[1, 1] = 0x1234
    channels[1, 1, 0] ^= 1  # differs in the lowest bit, so it isn't the transparent colour
    transparent = channels[1, 0] if has_transparency else None
    image = rhi.open_image(make_deep_png(channels, transparent))
    read = rhi.decode_colors(image)
    colors = round_to_bytes(channels)
    expected = np.full((40, 30, 4), 255, np.uint8)
    expected[..., :3] = colors[..., :1] if size < 3 else colors[..., :3]
    if size in (2, 4):
        expected[..., 3] = colors[..., -1]
    if transparent is not None:
        expected[(channels == transparent).all(axis=2), 3] = 0
        assert expected[1, :2, 3].tolist() == [0, 255]
    assert np.array_equal(read, expected)


@pytest.mark.parametrize("read", [rhi.load_image, lambda content: rhi.decode_colors(rhi.open_image(content))])
@pytest.mark.parametrize("bits", [1, 2, 4, 8, 16])
def test_a_grey_of_any_depth_may_be_transparent(bits: int, read: Callable[[bytes], Any]) -> None:
    top = 2**bits - 1
    greys = np.array([0, 1, top // 2, top - 1, top])
    row = "".join(f"{grey:0{bits}b}" for grey in greys)
    row += "0" * (-len(row) % 8)
    pixels = zlib.compress(b"\0" + int(row, 2).to_bytes(len(row) // 8, "big"))
    head = struct.pack(">IIBBBBB", len(greys), 1, bits, 0, 0, 0, 0)
    for transparent in {*greys.tolist()}:
        chunks = [
            (b"IHDR", head),
            (b"tRNS", struct.pack(">H", transparent)),
            (b"IDAT", pixels),
            (b"IEND", b""),
        ]
        texels = read(b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(*chunk) for chunk in chunks))
        expected = np.rint(greys * (255 / top))
        assert texels.tolist() == [
            [
                [grey, grey, grey, 0 if number == transparent else 255]
                for number, grey in zip(greys, expected, strict=True)
            ]
        ]


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("deep", [False, True])
def test_photos_are_turned_upright_as_pillow_turns_them(orientation: int, deep: bool) -> None:
    from PIL import ImageOps

    file, texels = io.BytesIO(), TEXELS[..., 0].astype(np.uint16) * 257 if deep else TEXELS
    image = Image.fromarray(texels)
    tags = image.getexif()
    tags[0x0112] = orientation
    image.save(file, "PNG", exif=tags)
    with Image.open(file) as again:
        expected = np.asarray(ImageOps.exif_transpose(again))
    read = rhi.load_image(file)
    assert np.array_equal(read if deep else read[..., :3], expected)
