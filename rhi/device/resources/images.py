"""Image files and texels: pictures that are read and written by Pillow, and formats that follow from arrays.

- Arrays are numbers: uint8 becomes `RGBA8`, not `RGBA8_SRGB`. Colors that are lit need the latter, by name.
- A picture is what a screen shows: bytes of `RGBA8` and `RGBA8_SRGB` as they are, floats as linear light from 0 to 1
  in sRGB, depth as grey.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import ChannelKind, Format
from rhi.contract.texels import decode, to_srgb
from rhi.errors import DeviceError, refuse
from rhi.errors.rules import IMAGE_FILE, IMAGE_LIBRARY

_DATA: Final = {"I;16": np.uint16, "I;16L": np.uint16, "I;16B": np.uint16, "F": np.float32}
"""Modes of Pillow whose texels are numbers rather than colors."""
_KINDS: Final = {"u1": ChannelKind.UNORM, "u2": ChannelKind.UNORM, "i1": ChannelKind.SNORM, "f2": ChannelKind.FLOAT,
                 "f4": ChannelKind.FLOAT, "u4": ChannelKind.UINT, "i4": ChannelKind.INT}  # fmt: skip
_INFERRED: Final = {
    (f.dtype, f.channels): f for f in Format if not f.is_packed and _KINDS.get(f.dtype.str[1:]) is f.kind
}


class ImageLike(Protocol):
    """What NumPy reads as an array: an array, an image of Pillow, and others."""

    @property
    def __array_interface__(self) -> dict[str, Any]: ...


def load_image(source: str | Path | bytes | BinaryIO) -> NDArray[Any]:
    """Return the texels of an image file, top row first: (height, width, 4) uint8, red, green, blue and alpha.

    `device.texture(load_image("wood.jpg"), Format.RGBA8_SRGB, levels=None)` is a texture of colors with all mip levels.
    A file of one channel of 16 bits is (height, width) uint16, one of floats float32. A photo is turned upright.

    Args:
        source: a path, the contents of a file, or an open one. Pillow reads PNG, JPEG, WebP, TIFF, BMP, DDS (whose
            blocks it decodes) and others.

    Raises:
        ValidationError: `image-file` for what is no image that can be read.
        DeviceError: `image-library` without Pillow.
    """
    library, call = _import_pillow("rhi.load_image"), "rhi.load_image"
    from PIL import ImageOps, UnidentifiedImageError

    try:
        with library.open(io.BytesIO(source) if isinstance(source, bytes) else source) as image:
            return as_texels(ImageOps.exif_transpose(image))
    except (OSError, ValueError, SyntaxError, UnidentifiedImageError, library.DecompressionBombError) as error:
        given = f"{len(source)} bytes" if isinstance(source, bytes) else str(source)
        refuse(IMAGE_FILE, call, f"{given}: {error}", "what Pillow reads, such as PNG, JPEG, WebP and DDS; not KTX2")


def as_texels(source: Any) -> NDArray[Any]:
    """Return an array-like as texels; of an image of Pillow as `load_image` does."""
    library = sys.modules.get("PIL.Image")
    if library is None or not isinstance(source, library.Image):
        return np.asarray(source)
    wanted = _DATA.get(source.mode)
    return np.array(source if wanted else source.convert("RGBA"), wanted)


def infer_format(texels: NDArray[Any]) -> Format | None:
    """Return the format of texels, (height, width[, channels]) or with layers in front, None if there is no such one.
    Three channels get a fourth one."""
    channels = texels.shape[-1] if texels.ndim > 2 else 1
    return _INFERRED.get((texels.dtype, {3: 4}.get(channels, channels)))


def make_picture(format: Format, texels: NDArray[Any]) -> NDArray[Any] | None:
    """Return texels (height, width[, components]) as (height, width) or (height, width, 3 or 4) uint8, of one channel
    of 16 bits as uint16; None if they are integers, which are no colors."""
    if format.is_integer:
        return None
    if format is Format.R16:
        return texels
    if format.kind in (ChannelKind.UNORM, ChannelKind.SRGB) and format.dtype == np.uint8:
        picture: NDArray[Any] = texels
    else:
        values = np.nan_to_num(decode(format, texels.reshape(*texels.shape[:2], -1)), posinf=1.0)
        colors = min(format.channels, 3)
        if format.kind is ChannelKind.FLOAT:
            values[..., :colors] = to_srgb(np.clip(values[..., :colors], 0.0, 1.0))
        picture = np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
    if format.channels == 1:
        return picture.reshape(texels.shape[:2])
    if format.channels == 2:
        return np.concatenate([picture, np.zeros_like(picture[..., :1])], axis=-1)
    return picture


def write_image(picture: NDArray[Any], target: str | Path | BinaryIO, kind: str | None = None) -> None:
    """Write a picture; the file's name says in what format, or `kind`. Formats without alpha get the colors only."""
    library = _import_pillow("Texture.save")
    image = library.fromarray(picture)
    suffix = "" if kind else Path(str(target)).suffix.lower()
    if suffix in (".jpg", ".jpeg", ".bmp"):
        image = image.convert("RGB")
    try:
        image.save(target, kind)
    except ValueError as error:
        refuse(IMAGE_FILE, "Texture.save", f"{target}: {error}", "a name with a known ending, such as .png")


def _import_pillow(call: str) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise DeviceError(IMAGE_LIBRARY, call, "Pillow is missing") from error
    return Image
