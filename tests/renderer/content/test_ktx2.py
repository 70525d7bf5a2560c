"""Files of KTX 2: what is read, what is refused by name, and that no bytes break the reader."""

from __future__ import annotations

import struct
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from ktx2_files import NUMBERS, SIGNATURE, encode_ktx2, make_blocks
from PIL import Image

from renderer.content import load_model, save_scene
from renderer.content.ktx2 import decode_ktx2, read_ktx2
from renderer.content.limits import ModelLimits
from renderer.lab.exam.image_cases import make_screen_scene
from renderer.scene import SceneBuilder
from rhi import CompressedFormat, ValidationError

BC1 = make_blocks((12, 6), 8, 4)
WHOLE = encode_ktx2(NUMBERS["BC1"], (12, 6), BC1)


@pytest.mark.parametrize("name", sorted(NUMBERS))
@pytest.mark.parametrize("scheme", [0, 2, 3])
def test_the_levels_of_a_file_are_its_blocks(tmp_path: Path, name: str, scheme: int) -> None:
    if scheme == 2:
        pytest.importorskip("zstandard")
    format = CompressedFormat[name]
    blocks = make_blocks((12, 6), format.block_bytes, 4)
    (tmp_path / "wall.ktx2").write_bytes(encode_ktx2(NUMBERS[name], (12, 6), blocks, scheme=scheme))
    image = read_ktx2(tmp_path / "wall.ktx2")
    assert (image.format, image.size) == (format, (12, 6))
    assert [level.tolist() for level in image.levels] == [level.tolist() for level in blocks]


@pytest.mark.parametrize(("name", "number"), [("BC7", 7), ("BC3", 3)])
def test_pixels_are_those_that_pillow_decodes(name: str, number: int) -> None:
    """BC3 within a level: Pillow rounds down what lies between two ends."""
    image = decode_ktx2(encode_ktx2(NUMBERS[name], (12, 8), make_blocks((12, 8), 16, 1)))
    data = image.levels[0].tobytes()
    expected = np.asarray(Image.frombytes("RGBA", (12, 8), data, "bcn", number, name))
    assert np.abs(image.decode().astype(int) - expected).max() <= (number == 3)


def test_two_channels_have_the_third_of_a_unit_normal() -> None:
    """A block of equal ends has one value: 191 is 0.498 along x, 128 is 0 along y, so z is 0.867."""
    block = np.array([[[191, 191, *[0] * 6, 128, 128, *[0] * 6]]], np.uint8)
    pixels = decode_ktx2(encode_ktx2(NUMBERS["BC5"], (4, 4), [block])).decode()
    assert pixels[2, 1].tolist() == [191, 128, 238, 255]


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"\x89PNG" + WHOLE[4:], "doesn't begin"),
        (WHOLE[:60], "within its header"),
        (WHOLE[:-1], "ends at byte"),
        (encode_ktx2(0, (12, 6), BC1), "Basis Universal"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, scheme=1), "Basis Universal"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, scheme=4), "scheme 4"),
        (encode_ktx2(37, (12, 6), BC1), "RGBA8"),
        (encode_ktx2(144, (12, 6), BC1), "BC6H with signs"),
        (encode_ktx2(157, (12, 6), BC1), "number 157"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, faces=6), "6 faces"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, layers=3), "3 layers"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, depth=2), "2 slices"),
        (encode_ktx2(NUMBERS["BC1"], (0, 6), BC1[:1]), "0 × 6 texels"),
        (encode_ktx2(NUMBERS["BC1"], (1 << 30, 1 << 30), BC1[:1]), "of at most"),
        (encode_ktx2(NUMBERS["BC1"], (65536, 65536), BC1[:1]), "not 2,147,483,648"),
        (encode_ktx2(NUMBERS["BC1"], (12, 6), [*BC1, BC1[-1]]), "5 levels"),
        (encode_ktx2(NUMBERS["BC7"], (12, 6), BC1), "level 0 has"),
        (
            encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, metadata=b"KTXorientation\0ru\0"),
            "not from the top left",
        ),
    ],
)
def test_an_image_that_is_not_read_is_refused_by_name(content: bytes, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        decode_ktx2(content)
    decode_ktx2(WHOLE)  # the control


def replace_level(content: bytes, level: int, start: int, size: int, unpacked: int) -> bytes:
    at = 80 + 24 * level
    return content[:at] + struct.pack("<3Q", start, size, unpacked) + content[at + 24 :]


def test_levels_that_overlap_are_refused() -> None:
    start, size, unpacked = struct.unpack_from("<3Q", WHOLE, 80)
    assert (size, unpacked) == (48, 48)
    second = struct.unpack_from("<3Q", WHOLE, 104)
    with pytest.raises(ValueError, match="overlap"):
        decode_ktx2(replace_level(WHOLE, 1, start, *second[1:]))
    with pytest.raises(ValueError, match="overlap"):
        decode_ktx2(replace_level(WHOLE, 0, 60, size, unpacked))
    with pytest.raises(ValueError, match="ends at byte"):
        decode_ktx2(replace_level(WHOLE, 0, (1 << 64) - 8, size, unpacked))


def test_no_more_is_unpacked_than_a_level_has() -> None:
    bomb = zlib.compress(bytes(1 << 26), 9)
    blocks = encode_ktx2(NUMBERS["BC1"], (12, 6), BC1[:1], scheme=3)
    start = struct.unpack_from("<Q", blocks, 80)[0]
    content = replace_level(blocks[:start] + bomb, 0, start, len(bomb), 48)
    with pytest.raises(ValueError, match="unpacks to 49 bytes, not 48"):
        decode_ktx2(content)


def test_no_more_is_unpacked_by_zstandard_than_a_level_has() -> None:
    zstandard = pytest.importorskip("zstandard")
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 26))
    blocks = encode_ktx2(NUMBERS["BC1"], (12, 6), BC1[:1], scheme=2)
    start = struct.unpack_from("<Q", blocks, 80)[0]
    with pytest.raises(ValueError, match="unpacks to 49 bytes, not 48"):
        decode_ktx2(replace_level(blocks[:start] + bomb, 0, start, len(bomb), 48))


def test_a_missing_package_for_zstandard_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zstandard", None)
    content = bytearray(encode_ktx2(NUMBERS["BC1"], (12, 6), BC1))
    content[44:48] = struct.pack("<I", 2)
    with pytest.raises(ValueError, match=r'pip install "rhi\[compression\]"'):
        decode_ktx2(bytes(content))


@given(st.binary(max_size=200))
@example(b"")
def test_random_bytes_are_refused(tail: bytes) -> None:
    with pytest.raises(ValueError, match="it "):
        decode_ktx2(SIGNATURE + tail)


@given(
    st.sampled_from([0, 3]),
    st.lists(st.tuples(st.integers(12, 175), st.integers(0, 255)), min_size=1, max_size=6),
    st.integers(0, 400),
)
def test_a_changed_header_is_read_or_refused(scheme: int, edits: list[tuple[int, int]], cut: int) -> None:
    content = bytearray(encode_ktx2(NUMBERS["BC1"], (12, 6), BC1, scheme=scheme))
    for at, value in edits:
        content[at] = value
    try:
        image = decode_ktx2(bytes(content[: max(len(content) - cut, 0)]))
    except ValueError:
        return
    assert image.bytes == sum(level.nbytes for level in image.levels) <= len(WHOLE) * 300


def test_a_file_that_is_not_there_or_broken_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="scene-bad-image"):
        read_ktx2(tmp_path / "none.ktx2")
    (tmp_path / "short.ktx2").write_bytes(WHOLE[:-1])
    with pytest.raises(ValidationError, match=r"scene-bad-image(.|\n)*ends at byte"):
        read_ktx2(tmp_path / "short.ktx2")


def write_model(folder: Path, content: bytes, *, texture: str = '{"source": 0}') -> Path:
    """Write a model whose only image is a file of KTX 2."""
    path = folder / "wall.gltf"
    save_scene(make_screen_scene(1.0, 1.0), path)
    (folder / "wall.ktx2").write_bytes(content)
    text = path.read_text(encoding="utf-8")
    begin, end = text.index('"images": ['), text.index("}]", text.index('"size"')) + 2
    text = text[:begin] + '"images": [{"uri": "wall.ktx2"}]' + text[end:]
    begin = text.index('"textures": [')
    end = text.index("]", begin) + 1
    path.write_text(text[:begin] + f'"textures": [{texture}]' + text[end:], encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "texture", ['{"source": 0}', '{"extensions": {"KHR_texture_basisu": {"source": 0}}}']
)
def test_a_gltf_file_has_its_blocks_and_their_pixels(tmp_path: Path, texture: str) -> None:
    blocks = make_blocks((12, 6), 16, 4)
    scene = load_model(write_model(tmp_path, encode_ktx2(NUMBERS["BC7"], (12, 6), blocks), texture=texture))
    assert scene.blocks[0].levels[3].tolist() == blocks[3].tolist()
    assert np.array_equal(scene.images[0], scene.blocks[0].decode())


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (encode_ktx2(0, (12, 6), BC1), "Basis Universal"),
        (WHOLE[:-1], "ends at byte"),
        (encode_ktx2(NUMBERS["BC6H"], (4, 4), [np.full((1, 1, 16), 0xF3, np.uint8)]), "."),
    ],
)
def test_an_image_of_a_gltf_file_that_cannot_be_read_is_left_out_by_name(
    tmp_path: Path, content: bytes, reason: str
) -> None:
    path = write_model(tmp_path, content)
    scene = load_model(path)
    if reason == ".":
        assert len(scene.images) <= 1
        return
    assert scene.images == ()
    assert reason in str(scene.omissions[0])


def test_a_file_with_more_pixels_than_allowed_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    path = write_model(tmp_path, WHOLE)
    load_model(path, ModelLimits(pixels=72 * 8))
    with pytest.raises(ValidationError, match="scene-model-limit"):
        load_model(path, ModelLimits(pixels=72 * 8 - 1))


def test_a_builder_takes_blocks_as_an_image() -> None:
    builder = SceneBuilder("wall")
    blocks = decode_ktx2(WHOLE)
    assert builder.add_image(blocks) == builder.add_image(blocks) == 0
    assert builder.blocks == {0: blocks}
