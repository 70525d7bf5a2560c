"""Image files, read and written by Pillow, and the formats that follow from arrays of texels.

- Arrays are numbers: uint8 becomes `RGBA8`, not `RGBA8_SRGB`. Colors that are lit need the latter, by name.
- An image file holds what a screen shows: bytes of `RGBA8` and `RGBA8_SRGB` as they are, floats as linear
  light from 0 to 1 in sRGB, depth as grey.
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
_KINDS: Final = {
    "u1": ChannelKind.UNORM,
    "u2": ChannelKind.UNORM,
    "i1": ChannelKind.SNORM,
    "f2": ChannelKind.FLOAT,
    "f4": ChannelKind.FLOAT,
    "u4": ChannelKind.UINT,
    "i4": ChannelKind.INT,
}
_INFERRED: Final = {
    (f.dtype, f.channels): f for f in Format if not f.is_packed and _KINDS.get(f.dtype.str[1:]) is f.kind
}


class ImageLike(Protocol):
    """Anything that NumPy reads as an array, such as an image of Pillow."""

    @property
    def __array_interface__(self) -> dict[str, Any]: ...


def load_image(source: str | Path | bytes | BinaryIO) -> NDArray[Any]:
    """Return the texels of an image file, top row first: (height, width, 4) uint8, red, green, blue and
    alpha.

    `device.texture(load_image("wood.jpg"), Format.RGBA8_SRGB, levels=None)` is a texture of colors with all
    mip levels. A file of one channel of 16 bits is (height, width) uint16, one of floats float32. A photo is
    turned upright.

    Args:
        source: a path, the contents of a file, or an open one. Pillow reads PNG, JPEG, WebP, TIFF, BMP, DDS
            (whose blocks it decodes) and others.

    Raises:
        ValidationError: `image-file` if the source is no readable image.
        DeviceError: `image-library` without Pillow.
    """
    library, call = _import_pillow("rhi.load_image"), "rhi.load_image"
    from PIL import ImageOps, UnidentifiedImageError

    try:
        with library.open(io.BytesIO(source) if isinstance(source, bytes) else source) as image:
            return as_texels(ImageOps.exif_transpose(image))
    except (
        OSError,
        ValueError,
        SyntaxError,
        UnidentifiedImageError,
        library.DecompressionBombError,
    ) as error:
        given = f"{len(source)} bytes" if isinstance(source, bytes) else str(source)
        refuse(
            IMAGE_FILE,
            call,
            f"{given}: {error}",
            "what Pillow reads, such as PNG, JPEG, WebP and DDS; not KTX2",
        )


def as_texels(source: Any) -> NDArray[Any]:
    """Return an array-like as an array of texels; Pillow's images as `load_image` returns them."""
    library = sys.modules.get("PIL.Image")
    if library is None or not isinstance(source, library.Image):
        return np.asarray(source)
    dtype = _DATA.get(source.mode)
    return np.array(source if dtype else source.convert("RGBA"), dtype)


def infer_format(texels: NDArray[Any]) -> Format | None:
    """Return the format that fits an array of texels, ([layers, ]height, width[, channels]), or None. Three
    channels get a format of four."""
    channels = texels.shape[-1] if texels.ndim > 2 else 1
    return _INFERRED.get((texels.dtype, {3: 4}.get(channels, channels)))


def convert_to_image(format: Format, texels: NDArray[Any]) -> NDArray[Any] | None:
    """Convert texels (height, width[, components]) to (height, width) or (height, width, 3 or 4) uint8; a
    channel of 16 bits becomes uint16. None for integer formats, which hold no colors."""
    if format.is_integer:
        return None
    if format is Format.R16:
        return texels
    if format.kind in (ChannelKind.UNORM, ChannelKind.SRGB) and format.dtype == np.uint8:
        image: NDArray[Any] = texels
    else:
        values = np.nan_to_num(decode(format, texels.reshape(*texels.shape[:2], -1)), posinf=1.0)
        colors = min(format.channels, 3)
        if format.kind is ChannelKind.FLOAT:
            values[..., :colors] = to_srgb(np.clip(values[..., :colors], 0.0, 1.0))
        image = np.rint(np.clip(values, 0.0, 1.0) * 255.0).astype(np.uint8)
    if format.channels == 1:
        return image.reshape(texels.shape[:2])
    if format.channels == 2:
        return np.concatenate([image, np.zeros_like(image[..., :1])], axis=-1)
    return image


def write_image(image: NDArray[Any], target: str | Path | BinaryIO, kind: str | None = None) -> None:
    """Write an image file in the format `kind`, or in that of the file's ending. Formats without alpha get
    the colors only."""
    library = _import_pillow("Texture.save")
    pillow_image = library.fromarray(image)
    suffix = "" if kind else Path(str(target)).suffix.lower()
    if suffix in (".jpg", ".jpeg", ".bmp"):
        pillow_image = pillow_image.convert("RGB")
    try:
        pillow_image.save(target, kind)
    except ValueError as error:
        refuse(IMAGE_FILE, "Texture.save", f"{target}: {error}", "a name with a known ending, such as .png")


def _import_pillow(call: str) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise DeviceError(IMAGE_LIBRARY, call, "Pillow is missing") from error
    return Image
