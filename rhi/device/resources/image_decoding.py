"""Image files that others may have written: which formats are opened, how many pixels are decoded, and how.

- Formats are a list. Pillow has readers for forty more, and one of them starts another program with the file.
- A format follows from the first bytes, never from a name or a media type.
- Pixels are counted by what the file's head says, before memory is taken.
- Whatever is wrong is `image-file`: Pillow's decoders raise whatever a broken file leads them to.
- A PNG whose compressed pixels can't be all of them is refused before memory is taken, and one that ends early
  after it is decoded: Pillow would show black rows.
- PNG may have 16 bits a channel, of which Pillow keeps the upper 8. Here they are rounded, and a transparent
  colour is compared with all 16. A transparent grey of 2 or 4 bits is widened as the pixels are.
"""

from __future__ import annotations

import io
import math
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from typing import Any, BinaryIO, Final, NoReturn, TypeAlias

import numpy as np
from numpy.typing import NDArray

from rhi.errors import DeviceError, RhiError, refuse
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.rules import IMAGE_FILE, IMAGE_LIBRARY

_BITS: Final = 258
_SAMPLE_FORMAT: Final = 339
"""Tags of TIFF: bits of a channel; 1 for numbers without a sign."""
IMAGE_FORMATS: Final = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "DDS", "TGA")
"""The formats that are opened, by Pillow's names. TGA has no mark at its beginning, and is tried last."""

MAX_PIXELS: Final = 1 << 26
"""The most pixels of an image unless a call says otherwise: 8192², 256 MiB of decoded bytes."""

_DERIVED: Final = ("MPO", None)  # a JPEG of several photos; an image that is in memory already
_MAX_BYTES: Final = 1 << 30  # of an encoded image
_SHOWN_BYTES: Final = 12  # of a file of another format, in a message
_BAND_PIXELS: Final = 1 << 20  # that are rounded at a time
_DEFLATE_RATIO: Final = 1032  # the most bytes that a compressed one stands for
_PNG_MARK: Final = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""The channels of a PNG by its color type."""
_ADAM7: Final = (
    (0, 0, 8, 8),
    (4, 0, 8, 8),
    (0, 4, 4, 8),
    (2, 0, 4, 4),
    (0, 2, 2, 4),
    (1, 0, 2, 2),
    (0, 1, 1, 2),
)
"""The first column and row of each pass of an interlaced PNG, and the steps between columns and rows."""
_LOW_BYTES: Final = {"RGB;16B": "RGB;16L", "RGBA;16B": "RGBA;16L"}
"""Pillow's layouts of 16 bits a channel, and those that read the lower byte of each."""
_GREY_STEPS: Final = {"L;2": 85, "L;4": 17}
"""Layouts of fewer than 8 bits, which Pillow widens to 8 by these factors, but not the transparent grey."""

ImageSource: TypeAlias = "str | os.PathLike[str] | bytes | bytearray | memoryview | BinaryIO"


def open_image(source: ImageSource, *, max_pixels: float = MAX_PIXELS, call: str = "rhi.open_image") -> Any:
    """Open an image file without decoding it: an image of Pillow, whose `size` is known.

    Only PNG, JPEG, WebP, TIFF, BMP, DDS and TGA are opened, whatever else Pillow reads. A path is that of a
    regular file. `decode_colors` decodes the image.

    Args:
        source: a path, the contents of a file, or an open one.
        max_pixels: images of more pixels are refused before they are decoded. Pillow itself refuses more than
            178 million.

    Raises:
        ValidationError: `image-file` if the source is no such image, or can't be read; `device-argument` if
            `max_pixels` is no number of pixels.
        DeviceError: `image-library` without Pillow.
    """
    library = import_pillow(call)
    if max_pixels != math.inf:
        max_pixels = ArgumentChecker(call).number("max_pixels", max_pixels, 1)
    try:
        content = _read(source)
    except Exception as error:
        refuse_image(call, source, error)
    try:
        image = library.open(io.BytesIO(content), formats=IMAGE_FORMATS)
    except library.UnidentifiedImageError:
        beginning = f"it begins with {bytes(content[:_SHOWN_BYTES])!r}" if content else "it is empty"
        refuse(IMAGE_FILE, call, f"{_name(source)}: {beginning}", _list_formats())
    except Exception as error:
        refuse_image(call, source, error)
    if image.width * image.height > max_pixels:
        size = f"{image.width * image.height:,} pixels, {image.width:,} × {image.height:,}"
        tip = f"for a file that you trust, {call}(…, max_pixels=…) allows more"
        refuse(IMAGE_FILE, call, f"{_name(source)}: {size}", f"at most {max_pixels:,.0f} pixels", tip)
    if image.format == "PNG":
        try:
            _check_png_length(content)
        except Exception as error:
            refuse_image(call, source, error)
    return image


def check_pixels(image: Any, content: bytes) -> None:
    """Raise OSError if a decoded PNG has fewer pixels than its head says. `content` is that of `encoded_png`.

    Pillow leaves those that are missing black. So only images that end black, and those whose rows come in
    another order, are counted.
    """
    if not content:
        return
    is_interlaced = content[28] != 0
    if not is_interlaced and np.asarray(image.crop((0, image.height - 1, *image.size))).any():
        return
    needed, available, inflater = _count_png_bytes(content), 0, zlib.decompressobj()
    for chunk in _png_pixels(content):
        part = bytes(chunk)
        while part and available < needed and not inflater.eof:
            available += len(inflater.decompress(part, _BAND_PIXELS))
            part = inflater.unconsumed_tail
    available += len(inflater.flush()) if available < needed else 0
    if available < needed:
        raise OSError(f"{available:,} of {needed:,} bytes of pixels")


def encoded_png(image: Any) -> bytes:
    """Return the bytes of the PNG that an image isn't decoded from yet; none for others."""
    file = getattr(image, "fp", None)
    return file.getvalue() if image.format == "PNG" and isinstance(file, io.BytesIO) else b""


def _check_png_length(content: bytes | bytearray | memoryview) -> None:
    if bytes(content[12:16]) != b"IHDR":
        raise OSError("a PNG begins with its head, IHDR")
    needed, available = _count_png_bytes(content), sum(map(len, _png_pixels(content))) * _DEFLATE_RATIO
    if available < needed:
        raise OSError(f"at most {available:,} of {needed:,} bytes of pixels")


def _count_png_bytes(content: bytes | bytearray | memoryview) -> int:
    """Return the bytes that the pixels of a PNG have, with one more for each row, before compression."""
    width, height, depth, color_type, _, _, interlace = struct.unpack(">IIBBBBB", content[16:29])
    bits = depth * _PNG_CHANNELS.get(color_type, 1)
    if not interlace:
        return int(height * (1 + -(-width * bits // 8)))
    sizes = (
        (len(range(column, width, right)), len(range(row, height, down)))
        for column, row, right, down in _ADAM7
    )
    return sum(rows * (1 + -(-columns * bits // 8)) for columns, rows in sizes if columns)


def _png_pixels(content: bytes | bytearray | memoryview) -> Iterator[memoryview]:
    """Yield the compressed pixels of a PNG, chunk by chunk."""
    view, at = memoryview(content), len(_PNG_MARK)
    while at + 12 <= len(view):
        length, kind = struct.unpack(">I4s", view[at : at + 8])
        if kind == b"IDAT":
            yield view[at + 8 : at + 8 + length]
        at += 12 + length


def decode_colors(image: Any, *, call: str = "rhi.decode_colors") -> NDArray[np.uint8]:
    """Decode an image of `open_image`: (height, width, 4) uint8, red, green, blue and alpha, top row first.

    16 bits a channel are rounded to 8. Of several frames it is the first.

    Raises:
        ValidationError: `image-file` if the file is broken, or Pillow has opened one of another format.
    """
    if image.format not in (*IMAGE_FORMATS, *_DERIVED):
        refuse(IMAGE_FILE, call, f"an image of the format {image.format}", _list_formats())
    try:
        return _decode(image)
    except RhiError:
        raise
    except Exception as error:
        refuse_image(call, image, error)


def import_pillow(call: str) -> Any:
    """Return the module `PIL.Image`, or raise `image-library`."""
    try:
        from PIL import Image
    except ImportError as error:
        raise DeviceError(IMAGE_LIBRARY, call, "Pillow is missing") from error
    return Image


def refuse_image(call: str, source: object, error: BaseException) -> NoReturn:
    """Refuse a source because of what reading or decoding it has raised."""
    text = str(error) if isinstance(error, OSError) and str(error) else f"{type(error).__name__}: {error}"
    refuse(IMAGE_FILE, call, f"{_name(source)}: {text}", f"a file of {_list_formats()}; not KTX2")


def _read(source: ImageSource) -> bytes | bytearray | memoryview:
    if isinstance(source, bytes | bytearray | memoryview):
        return source
    if isinstance(source, str | os.PathLike):
        if not stat.S_ISREG(os.stat(source).st_mode):  # a pipe would be waited for
            raise OSError("it isn't a regular file")
        with open(source, "rb") as file:
            content = file.read(_MAX_BYTES + 1)
    elif hasattr(source, "read"):
        if hasattr(source, "seek") and (not hasattr(source, "seekable") or source.seekable()):
            source.seek(0)
        content = source.read(_MAX_BYTES + 1)
        if not isinstance(content, bytes | bytearray | memoryview):
            raise TypeError(f"its read() returns {type(content).__name__}; open it in binary mode")
    else:
        raise TypeError("a path, the bytes of a file, or an open file is needed")
    if len(content) > _MAX_BYTES:
        raise OSError(f"it has more than {_MAX_BYTES:,} bytes")
    return content


def _decode(image: Any) -> NDArray[np.uint8]:
    content = encoded_png(image)
    colors = _decode_colors(image)
    check_pixels(image, content)
    return colors


def _decode_colors(image: Any) -> NDArray[np.uint8]:
    transparency = image.info.get("transparency")
    if image.format == "PNG" and image.tile:
        layout = image.tile[0][3]
        if layout in _LOW_BYTES:
            again = import_pillow("rhi.decode_colors").open(io.BytesIO(image.fp.getvalue()), formats=("PNG",))
            low = _with_layout(again, _LOW_BYTES[layout])  # Pillow decodes one byte of each channel
            return _round(np.asarray(image, np.uint8), transparency, low)
        if layout in _GREY_STEPS and isinstance(transparency, int):
            image.info["transparency"] = transparency * _GREY_STEPS[layout]
        if layout == "LA;16B" and image.mode == "RGBA":
            pairs = _with_layout(image, "RGBA").view(">u2")  # grey and alpha, of two bytes each
            return _round(pairs[..., [0, 0, 0, 1]], None)
    if image.mode == "F" or (image.mode == "I" and not is_grey_16(image)):
        raise OSError("floats and integers of 32 bits are no colours; rhi.load_image reads them as numbers")
    if image.mode.startswith("I"):  # grey of 16 bits, which Pillow would clip to 8
        grey = np.asarray(image)
        return _round(np.broadcast_to(grey[..., None], (*grey.shape, 3)), transparency)
    return np.array(image.convert("RGBA"), np.uint8)


def is_grey_16(image: Any) -> bool:
    """True if an image of Pillow's mode "I" has grey of 16 bits, as PNG has with older versions."""
    return bool(image.format == "PNG")


def read_integers(image: Any) -> NDArray[Any]:
    """Return the numbers (height, width) of an image of Pillow's mode "I": uint16, int32, or uint32 where the
    file says so."""
    numbers = np.array(image, np.int32)
    if is_grey_16(image):
        return numbers.astype(np.uint16)
    tags = getattr(image, "tag_v2", {})
    bits, signs = (tags.get(tag, default) for tag, default in ((_BITS, 32), (_SAMPLE_FORMAT, 2)))
    is_unsigned = np.ravel(bits)[0] == 32 and np.ravel(signs)[0] == 1
    return numbers.view(np.uint32) if is_unsigned else numbers


def _with_layout(image: Any, layout: str) -> NDArray[np.uint8]:
    """Decode an image that isn't decoded yet, as if its pixels were laid out like this."""
    codec, extents, offset, _ = image.tile[0]
    image.tile = [(codec, extents, offset, layout)]
    return np.array(image, np.uint8)


def _round(
    channels: NDArray[Any], transparency: Any, low: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Return colours (height, width, 4) for channels (height, width, 3 or 4) of 16 bits, or for their high bytes
    and low bytes, both (height, width, 3 or 4)."""
    height, width, size = channels.shape
    colors = np.full((height, width, 4), 255, np.uint8)
    step = max(_BAND_PIXELS // max(width, 1), 1)
    for first in range(0, height, step):
        rows = slice(first, first + step)
        values = channels[rows].astype(np.int64)
        values = np.clip(values, 0, 65535) if low is None else values << 8 | low[rows]
        colors[rows, :, :size] = (values * 255 + 32767) // 65535
        if transparency is not None and size == 3:
            colors[rows, :, 3][(values == np.asarray(transparency)).all(axis=2)] = 0
    return colors


def _name(source: object) -> str:
    if isinstance(source, bytes | bytearray | memoryview):
        return f"{len(source):,} bytes"
    name = source if isinstance(source, str | os.PathLike) else getattr(source, "name", None)
    return str(name) if isinstance(name, str | os.PathLike) else type(source).__name__


def _list_formats() -> str:
    names = [{"WEBP": "WebP"}.get(name, name) for name in IMAGE_FORMATS]
    return f"{', '.join(names[:-1])} or {names[-1]}"
