"""Block compression of images (BC1, BC3, BC5, BC7), with all mip levels.

The package etcpak makes the blocks (the extra `compression`). A texel of a level is the mean of all that it covers, in
linear light; normals have unit length in each level.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.scene.images import Compression, ImageBlocks, ImagePixels, read_values
from renderer.scene.scene_builder import SceneBuilder
from rhi import CompressedFormat, to_srgb
from rhi.errors import Rule, refuse

_BLOCK: Final = 4
_EFFORT: Final = 2
"""Of BC7, 0 to 4: above 2 errors stay as they are."""
_MISSING: Final = 'pip install "rhi[compression]"'


def check_compression(rule: Rule, call: str, value: Compression) -> None:
    """Refuse a compression if the package for it is missing."""
    if value is not Compression.NONE:
        _import_encoder(rule, call, value)


def _import_encoder(rule: Rule, call: str, value: Compression) -> Any:
    try:
        import etcpak  # optional
    except ImportError:
        refuse(rule, call, f"{value.value} without the package etcpak", "etcpak", tip=_MISSING)
    return etcpak


def choose_format(
    pixels: ImagePixels, compression: Compression, *, is_color: bool, is_normal: bool
) -> CompressedFormat | None:
    """Return the format in which an image is compressed; None for one of high range, which no encoder has."""
    if compression is Compression.NONE or pixels.dtype != np.uint8:
        return None
    if is_normal:
        return CompressedFormat.BC5
    name = "BC7"
    if compression is Compression.BC1:
        name = "BC1" if (pixels[..., 3] == 255).all() else "BC3"
    return CompressedFormat[f"{name}_SRGB" if is_color else name]


def compress_images(builder: SceneBuilder, first: int, compression: Compression) -> None:
    """Give the images of a builder from an id on blocks, unless they have some."""
    for image, pixels, is_color, is_normal in builder.list_image_uses(first):
        format = choose_format(pixels, compression, is_color=is_color, is_normal=is_normal and not is_color)
        if format is not None and image not in builder.blocks:
            builder.blocks[image] = compress_image(pixels, format)


def compress_image(pixels: ImagePixels, format: CompressedFormat) -> ImageBlocks:
    """Compress an image (height, width, 4) of uint8 and its mip levels."""
    import etcpak  # optional: `check_compression` has said so

    is_color, is_normal = format.name.endswith("_SRGB"), format is CompressedFormat.BC5
    levels = []
    values = read_values(pixels, is_color=is_color)
    texels = pixels
    while True:
        levels.append(_encode(etcpak, texels, format))
        if max(values.shape[:2]) == 1:
            return ImageBlocks(format, (pixels.shape[1], pixels.shape[0]), tuple(levels))
        values = _halve(_halve(values, 0), 1)
        texels = _quantize(values, is_color=is_color, is_normal=is_normal)


def _halve(values: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Return the means of pairs along an axis; of three, where their number is odd."""
    values = np.moveaxis(values, axis, 0)
    size = len(values)
    if size == 1:
        return np.moveaxis(values, 0, axis)
    half = size // 2
    if size % 2 == 0:
        halved = 0.5 * (values[0::2] + values[1::2])
    else:
        index = np.arange(half).reshape(-1, *[1] * (values.ndim - 1))
        first, middle, last = values[0:-1:2], values[1::2], values[2::2]
        halved = ((half - index) * first + half * middle + (index + 1) * last) / size
    return np.moveaxis(halved, 0, axis)


def _quantize(values: NDArray[np.float64], *, is_color: bool, is_normal: bool) -> ImagePixels:
    """Return linear light or data as pixels of 8 bits."""
    if is_normal:
        vectors = values[..., :3] * 2.0 - 1.0
        length = np.linalg.norm(vectors, axis=-1, keepdims=True)
        values = np.concatenate(
            [
                np.where(length > 1e-3, vectors / np.maximum(length, 1e-3), (0.0, 0.0, 1.0)) * 0.5 + 0.5,
                values[..., 3:],
            ],
            axis=-1,
        )
    elif is_color:
        values = np.concatenate([to_srgb(values[..., :3]), values[..., 3:]], axis=-1)
    return np.round(values * 255.0).astype(np.uint8)


def _encode(etcpak: Any, texels: ImagePixels, format: CompressedFormat) -> NDArray[np.uint8]:
    """Return the blocks (rows, columns, bytes) of a level; texels at the edges are repeated to whole blocks."""
    height, width = texels.shape[:2]
    rows, columns = -(-height // _BLOCK), -(-width // _BLOCK)
    padding = ((0, rows * _BLOCK - height), (0, columns * _BLOCK - width), (0, 0))
    padded = np.ascontiguousarray(np.pad(texels, padding, mode="edge"))
    name = format.name.removesuffix("_SRGB").lower()
    arguments: list[Any] = [padded.tobytes(), columns * _BLOCK, rows * _BLOCK]
    if name == "bc7":
        parameters = etcpak.BC7CompressBlockParams()
        parameters.init_linear_weights()
        parameters.m_uber_level = _EFFORT
        arguments.append(parameters)
    blocks = getattr(etcpak, f"compress_{name}")(*arguments)
    return np.frombuffer(blocks, np.uint8).reshape(rows, columns, format.block_bytes)
