"""Files of KTX 2 (`.ktx2`): images as blocks, with mip levels.

Read are 2D images in BC1 to BC7 without signs, plain, or compressed by zlib or by Zstandard (the package zstandard, of
the extra `compression`). All else is refused by name: arrays, cubes, volumes, other formats, Basis Universal.

Source: Khronos, KTX File Format Specification 2.0.
"""

from __future__ import annotations

import struct
import zlib
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.scene.files import read_file
from renderer.scene.images import ImageBlocks
from rhi import CompressedFormat
from rhi.errors import RhiError, refuse

SIGNATURE: Final = b"\xabKTX 20\xbb\r\n\x1a\n"
"""The first bytes of a file."""
_HEADER: Final = struct.Struct("<9I4I2Q")
_LEVEL: Final = struct.Struct("<3Q")
_MAX_BYTES: Final = 1 << 30
_MAX_SIDE: Final = 1 << 16
_FORMATS: Final = {
    131: "BC1",
    132: "BC1_SRGB",
    133: "BC1",
    134: "BC1_SRGB",
    135: "BC2",
    136: "BC2_SRGB",
    137: "BC3",
    138: "BC3_SRGB",
    139: "BC4",
    141: "BC5",
    143: "BC6H",
    145: "BC7",
    146: "BC7_SRGB",
}
"""Vulkan's numbers of formats."""
_UNREAD: Final = {
    140: "BC4 with signs",
    142: "BC5 with signs",
    144: "BC6H with signs",
    37: "RGBA8",
    43: "RGBA8 (sRGB)",
}
_BLOCK: Final = 4
_ORIENTATION: Final = b"KTXorientation\0"


def read_ktx2(path: str | Path) -> ImageBlocks:
    """Read the blocks of a file, which `SceneBuilder.add_image` takes.

    Raises:
        ValidationError: `scene-bad-image` if the file can't be read, is broken, or has another kind of image.
    """
    call = f"read_ktx2({str(path)!r})"
    try:
        return decode_ktx2(read_file(path, _MAX_BYTES))
    except (OSError, ValueError) as error:
        refuse(rules.BAD_IMAGE, call, str(error), "a 2D image in BC1 to BC7")


def count_texels(content: bytes) -> int:
    """The number of texels that a file says it has, before its levels are read.

    Raises:
        ValueError: it isn't such a file.
    """
    _, width, height, *_ = _read_header(content)
    return width * height


def decode_ktx2(content: bytes) -> ImageBlocks:
    """Decode the bytes of a file.

    Raises:
        ValueError: it is broken, or has another kind of image; the text says why.
    """
    format, width, height, level_count, scheme = _read_header(content)
    levels: list[NDArray[np.uint8]] = []
    ranges: list[tuple[int, int]] = [(0, _start_of_levels(level_count))]
    for level in range(level_count):
        start, size, unpacked = _LEVEL.unpack_from(content, _start_of_levels(level))
        rows, columns = (-(-max(side >> level, 1) // _BLOCK) for side in (height, width))
        expected = rows * columns * format.block_bytes
        if start + size > len(content):
            raise ValueError(f"level {level} ends at byte {start + size:,} of {len(content):,}")
        ranges.append((start, start + size))
        if unpacked != expected or (scheme == 0 and size != expected):
            raise ValueError(f"level {level} has {unpacked:,} bytes in {size:,}, not {expected:,}")
        data = _unpack(content[start : start + size], expected, scheme)
        if len(data) != expected:
            raise ValueError(f"level {level} unpacks to {len(data):,} bytes, not {expected:,}")
        levels.append(np.frombuffer(data, np.uint8).reshape(rows, columns, format.block_bytes))
    ranges.sort()
    if any(end > start for (_, end), (start, _) in pairwise(ranges)):
        raise ValueError("its levels overlap")
    _check_orientation(content)
    try:
        return ImageBlocks(format, (width, height), tuple(levels))
    except RhiError as error:
        raise ValueError(f"{error.given} instead of {error.allowed}") from None


def _check_orientation(content: bytes) -> None:
    """Refuse an image whose first row isn't the top one, as its metadata say."""
    start, size = struct.unpack_from("<2I", content, len(SIGNATURE) + 44)
    _, key, value = content[start : start + size].partition(_ORIENTATION)
    if key and not value.startswith(b"rd"):
        raise ValueError(f"its rows and columns are {value[:2]!r}, not from the top left")


def _start_of_levels(level: int) -> int:
    """The byte at which the index has a level."""
    return len(SIGNATURE) + _HEADER.size + level * _LEVEL.size


def _read_header(content: bytes) -> tuple[CompressedFormat, int, int, int, int]:
    """Read the format, the width, the height, the number of levels, and the scheme by which they are packed."""
    if not content.startswith(SIGNATURE):
        raise ValueError("it doesn't begin as a file of KTX 2")
    if len(content) < _start_of_levels(1):
        raise ValueError(f"it ends after {len(content)} bytes, within its header")
    number, _, width, height, depth, layers, faces, levels, scheme, *_ = _HEADER.unpack_from(
        content, len(SIGNATURE)
    )
    if scheme == 1 or number == 0:
        raise ValueError("it is in Basis Universal: convert it to BC7, for example by `ktx transcode`")
    if scheme > 3:
        raise ValueError(f"it is packed by scheme {scheme}, not by zlib or Zstandard")
    if number not in _FORMATS:
        raise ValueError(f"its format is {_UNREAD.get(number, f'number {number} of Vulkan')}, not BC1 to BC7")
    if depth or layers > 1 or faces != 1:
        raise ValueError(f"it has {depth} slices, {layers} layers and {faces} faces, and isn't a 2D image")
    if not (0 < width <= _MAX_SIDE and 0 < height <= _MAX_SIDE):
        raise ValueError(f"it has {width:,} × {height:,} texels, of at most {_MAX_SIDE:,} each way")
    levels = max(levels, 1)
    if levels > max(width, height).bit_length() or len(content) < _start_of_levels(levels):
        raise ValueError(f"it has {levels} levels of {width} × {height} in {len(content):,} bytes")
    return CompressedFormat[_FORMATS[number]], width, height, levels, scheme


def _unpack(data: bytes, size: int, scheme: int) -> bytes:
    """Unpack a level, of which no more than `size` bytes and one are made."""
    if scheme == 0:
        return data
    if scheme == 3:
        try:
            return zlib.decompressobj().decompress(data, size + 1)
        except zlib.error as error:
            raise ValueError(f"zlib: {error}") from None
    try:
        import zstandard  # optional
    except ImportError:
        raise ValueError('it is packed by Zstandard: pip install "rhi[compression]"') from None
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(data) as reader:
            return reader.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise ValueError(f"Zstandard: {error}") from None
