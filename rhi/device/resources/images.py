"""Image files, read and written by Pillow, and the formats that follow from arrays of texels.

- Arrays are numbers: uint8 becomes `RGBA8`, not `RGBA8_SRGB`. Colors that are lit need the latter, by name.
- An image file holds what a screen shows: bytes of `RGBA8` and `RGBA8_SRGB` as they are, floats as linear
  light from 0 to 1 in sRGB, depth as grey.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import ChannelKind, Format
from rhi.contract.texels import decode, to_srgb
from rhi.device.resources.image_decoding import (
    MAX_PIXELS,
    ImageSource,
    check_pixels,
    decode_colors,
    encoded_png,
    import_pillow,
    open_image,
    read_integers,
    refuse_image,
)
from rhi.errors import RhiError, refuse
from rhi.errors.array_likes import to_array
from rhi.errors.rules import IMAGE_FILE

MAX_CHANNELS: Final = 4
_DATA: Final = {**dict.fromkeys(("I;16", "I;16L", "I;16B", "I;16N"), np.uint16), "F": np.float32}
"""Modes of Pillow whose texels are numbers rather than colors."""
_ORIENTATION: Final = 0x0112  # the tag of EXIF that says how a camera was held
_TURNS: Final[Mapping[int, Callable[[NDArray[Any]], NDArray[Any]]]] = {
    2: lambda texels: texels[:, ::-1],
    3: lambda texels: texels[::-1, ::-1],
    4: lambda texels: texels[::-1],
    5: lambda texels: texels.swapaxes(0, 1),
    6: lambda texels: np.rot90(texels, -1),
    7: lambda texels: texels[::-1, ::-1].swapaxes(0, 1),
    8: lambda texels: np.rot90(texels),
}
"""What turns an image upright, by its orientation."""
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


def load_image(source: ImageSource, *, max_pixels: float = MAX_PIXELS) -> NDArray[Any]:
    """Return the texels of an image file, top row first: (height, width, 4) uint8, red, green, blue and
    alpha.

    `device.texture(load_image("wood.jpg"), Format.RGBA8_SRGB, levels=None)` is a texture of colors with all
    mip levels. A file of one channel of 16 bits is (height, width) uint16, one of floats float32, one of
    integers of 32 bits int32 or uint32; colors of 16 bits, and greys of which one is transparent, are rounded
    to 8. A photo is turned upright. Only PNG, JPEG, WebP, TIFF, BMP, DDS (whose blocks are decoded) and TGA
    are read.

    Args:
        source: the path of a regular file, the contents of a file, or an open one.
        max_pixels: images of more pixels are refused before they are decoded. Pillow itself refuses more than
            178 million.

    Raises:
        ValidationError: `image-file` if the source is no readable image of these formats.
        DeviceError: `image-library` without Pillow.

    Examples:
        >>> device.texture(np.full((2, 3, 4), 200, np.uint8)).save("grey.png")
        >>> rhi.load_image("grey.png").shape
        (2, 3, 4)
    """
    call = "rhi.load_image"
    image = open_image(source, max_pixels=max_pixels, call=call)
    try:
        dtype = _DATA.get(image.mode)
        is_transparent = image.format == "PNG" and "transparency" in image.info
        if is_transparent or (image.mode != "I" and dtype is None):
            texels: NDArray[Any] = decode_colors(image, call=call)
        else:
            content = encoded_png(image)
            texels = read_integers(image) if dtype is None else np.array(image, dtype)
            check_pixels(image, content)
        turn = _TURNS.get(image.getexif().get(_ORIENTATION, 1))
    except RhiError:
        raise
    except Exception as error:
        refuse_image(call, source, error)
    return texels if turn is None else np.ascontiguousarray(turn(texels))


def as_texels(source: Any) -> NDArray[Any]:
    """Return an array-like as an array of texels; Pillow's images as `load_image` returns them."""
    image = getattr(sys.modules.get("PIL.Image"), "Image", None)  # another thread may be importing it
    if image is None or not isinstance(source, image):
        return to_array(source)
    if source.mode == "I":
        return read_integers(source)
    dtype = _DATA.get(source.mode)
    return np.array(source if dtype else source.convert("RGBA"), dtype)


def infer_format(texels: NDArray[Any], has_layers: bool = False) -> Format | None:
    """Return the format that fits an array of texels, ([layers, ]height, width[, channels]), or None. Three
    channels get a format of four, float64 one of float32. With layers, three axes without channels are (layers,
    height, width)."""
    channels = texels.shape[-1] if texels.ndim > 2 else 1
    if has_layers and texels.ndim == 3 and channels > MAX_CHANNELS:
        channels = 1
    dtype = np.dtype(np.float32) if texels.dtype == np.float64 else texels.dtype
    return _INFERRED.get((dtype, {3: 4}.get(channels, channels)))


def tip_for_texels(texels: NDArray[Any], dtype: np.dtype[Any] | None, has_layers: bool) -> str:
    """The tip that makes an array fit a format of `dtype` (None: any format); "" if there is no simple one."""
    actual = texels.dtype
    if actual == np.bool_:
        return "a mask is mask.astype(np.uint8) * 255"
    if actual.kind in "iuf" and dtype is not None and actual != dtype:
        if actual.kind == "f" and dtype.kind != "f":
            return f"scale it and convert it, e.g. (array * {np.iinfo(dtype).max}).astype(np.{dtype.name})"
        return f"array.astype(np.{dtype.name}) converts it"
    if dtype is None and actual.kind in "iu" and actual.itemsize == 8:
        return "array.astype(np.int32) or another of these types converts it"
    if texels.ndim == 3 and texels.shape[-1] > MAX_CHANNELS:
        if has_layers:
            return "layers of one channel are array[..., None]"
        return "a volume of one channel is texture(array, kind=TextureKind.D3); channels are the last axis"
    return ""


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
    call = "Texture.save"
    pillow_image = import_pillow(call).fromarray(image)
    suffix = "" if kind else Path(str(target)).suffix.lower()
    if suffix in (".jpg", ".jpeg", ".bmp"):
        pillow_image = pillow_image.convert("RGB")
    try:
        pillow_image.save(target, kind)
    except Exception as error:
        reason = str(error) if isinstance(error, OSError | ValueError) else f"{type(error).__name__}: {error}"
        refuse(
            IMAGE_FILE, call, f"{target}: {reason}", "a file in a folder, with a known ending such as .png"
        )
