"""Image files that others may have written: which formats are opened, how many pixels are decoded, and how.

- Formats are a list. Pillow has readers for forty more, and one of them starts another program with the file.
- A format follows from the first bytes, never from a name or a media type.
- Pixels are counted by what the file's head says, before memory is taken.
- Whatever is wrong is `image-file`: Pillow's decoders raise whatever a broken file leads them to.
- PNG may have 16 bits a channel, of which Pillow keeps the upper 8. Here they are rounded, and a transparent
  colour is compared with all 16.
"""

from __future__ import annotations

import io
import math
import os
import stat
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
_LOW_BYTES: Final = {"RGB;16B": "RGB;16L", "RGBA;16B": "RGBA;16L"}
"""Pillow's layouts of 16 bits a channel, and those that read the lower byte of each."""

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
    return image


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
    transparency = image.info.get("transparency")
    if image.format == "PNG" and image.tile:
        layout = image.tile[0][3]
        if layout in _LOW_BYTES:
            return _round(_join_bytes(image, _LOW_BYTES[layout]), transparency)
        if layout == "LA;16B" and image.mode == "RGBA":
            pairs = _with_layout(image, "RGBA").view(">u2")  # grey and alpha, of two bytes each
            return _round(pairs[..., [0, 0, 0, 1]], None)
    if image.mode == "F" or (image.mode == "I" and not is_grey_16(image)):
        raise OSError("floats and integers of 32 bits are no colours; rhi.load_image reads them as numbers")
    if image.mode.startswith("I"):  # grey of 16 bits, which Pillow would clip to 8
        grey = np.clip(np.asarray(image, np.int64), 0, 65535)
        return _round(np.repeat(grey[..., None], 3, axis=2), transparency)
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


def _join_bytes(image: Any, low_layout: str) -> NDArray[np.uint16]:
    """Return the channels of 16 bits (height, width, 3 or 4) of a PNG: Pillow decodes one byte of each."""
    library = import_pillow("rhi.decode_colors")
    again = library.open(io.BytesIO(image.fp.getvalue()), formats=("PNG",))
    low = _with_layout(again, low_layout)
    return (np.asarray(image, np.uint16) << np.uint16(8)) | low


def _with_layout(image: Any, layout: str) -> NDArray[np.uint8]:
    """Decode an image that isn't decoded yet, as if its pixels were laid out like this."""
    codec, extents, offset, _ = image.tile[0]
    image.tile = [(codec, extents, offset, layout)]
    return np.array(image, np.uint8)


def _round(channels: NDArray[Any], transparency: Any) -> NDArray[np.uint8]:
    """Return colours (height, width, 4) for channels (height, width, 3 or 4) of 16 bits."""
    opaque = np.full((*channels.shape[:2], 1), 65535, np.uint32)
    values = channels.astype(np.uint32)
    colors = values if channels.shape[2] == 4 else np.concatenate([values, opaque], axis=2)
    if transparency is not None and channels.shape[2] == 3:
        colors[(values == np.asarray(transparency)).all(axis=2), 3] = 0
    return ((colors * 255 + 32767) // 65535).astype(np.uint8)


def _name(source: object) -> str:
    if isinstance(source, bytes | bytearray | memoryview):
        return f"{len(source):,} bytes"
    name = source if isinstance(source, str | os.PathLike) else getattr(source, "name", None)
    return str(name) if isinstance(name, str | os.PathLike) else type(source).__name__


def _list_formats() -> str:
    names = [{"WEBP": "WebP"}.get(name, name) for name in IMAGE_FORMATS]
    return f"{', '.join(names[:-1])} or {names[-1]}"
