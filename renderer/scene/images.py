"""The images of a scene: the pixels that textures read.

An image has 8 bits a channel, colours in sRGB or linear data, or it has a high range: float16, always linear. Only
emitted light is brighter than 1, so only an emissive texture, or one of a material's own shader, may be.

Beside its pixels an image may have blocks: the same in a compressed format, with mip levels, which devices store as
they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from rhi import CompressedFormat, decode_blocks, from_srgb, to_srgb
from rhi.errors import refuse
from rhi.errors.choices import Choice

ImagePixels = NDArray[Any]
"""A texture's pixels, (height, width, 4), top row first: uint8 with colours in sRGB and linear alpha, or with linear
data; or float16, linear, of high range."""

BRIGHTEST: Final = float(np.finfo(np.float16).max)
"""The largest texel of an image of high range: float16 ends at 65,504."""
_RANGE_TIP: Final = "scale the image down, and raise the material's `emissive` as much"


_BLOCK: Final = 4
_DRAWN: Final = ("BC1", "BC2", "BC3", "BC4", "BC5", "BC6H", "BC7")


class Compression(Choice):
    """The compression of images: none; BC1, where an image has alpha BC3; or BC7. Normal maps have BC5."""

    NONE = "none"
    BC1 = "bc1"
    BC7 = "bc7"


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class ImageBlocks:
    """An image in a compressed format.

    Attributes:
        format: one without signs. Blocks of colours are the same with sRGB and without.
        size: width and height in texels.
        levels: the blocks (rows, columns, bytes) of each mip level, the largest first.
    """

    format: CompressedFormat
    size: tuple[int, int]
    levels: tuple[NDArray[np.uint8], ...]

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            ValidationError: `scene-bad-image`.
        """
        call = "ImageBlocks"
        if self.format.name.removesuffix("_SRGB") not in _DRAWN:
            refuse(rules.BAD_IMAGE, f"{call}(format=...)", self.format.name, ", ".join(_DRAWN))
        width, height = self.size
        if min(width, height) < 1 or not 1 <= len(self.levels) <= max(width, height).bit_length():
            size = f"{width} × {height}, {len(self.levels)} levels"
            refuse(rules.BAD_IMAGE, call, size, "a level or more, as far as a texel")
        for number, blocks in enumerate(self.levels):
            rows, columns = (-(-max(side >> number, 1) // _BLOCK) for side in (height, width))
            shape = rows, columns, self.format.block_bytes
            if blocks.shape != shape or blocks.dtype != np.uint8:
                refuse(
                    rules.BAD_IMAGE,
                    f"{call}(levels=...)",
                    f"shape {blocks.shape} of {blocks.dtype}",
                    f"{shape}",
                )

    @property
    def bytes(self) -> int:
        """The memory of all levels."""
        return sum(level.nbytes for level in self.levels)

    def choose_view(self, *, is_color: bool) -> CompressedFormat | None:
        """Return the format in which a texture of colours, or of data, reads the blocks; None if there is none."""
        name = self.format.name.removesuffix("_SRGB")
        if name == "BC6H":
            return self.format
        if name in ("BC4", "BC5"):
            return None if is_color else self.format
        return CompressedFormat[f"{name}_SRGB" if is_color else name]

    def decode(self) -> ImagePixels:
        """Return the pixels of the largest level. Where there are two channels, the third is a unit normal's."""
        width, height = self.size
        rows, columns = self.levels[0].shape[:2]
        decoded = decode_blocks(self.format, self.levels[0]).swapaxes(1, 2)
        texels = decoded.reshape(rows * _BLOCK, columns * _BLOCK, -1)[:height, :width]
        if texels.shape[2] == 4:
            return np.ascontiguousarray(texels)
        pixels = np.zeros((height, width, 4), np.uint8)
        pixels[..., 3] = 255
        pixels[..., : texels.shape[2]] = texels
        if texels.shape[2] == 2:
            across = texels.astype(np.float64) / 127.5 - 1.0
            toward = np.sqrt(np.maximum(1.0 - (across**2).sum(axis=-1), 0.0))
            pixels[..., 2] = np.round((toward * 0.5 + 0.5) * 255.0)
        return pixels


def check_image(image: NDArray[Any]) -> ImagePixels:
    """Return `image` as the scene keeps it; refuse arrays that aren't images."""
    if not isinstance(image, np.ndarray):
        refuse(rules.BAD_IMAGE, "add_image", type(image).__name__, "an array")
    is_light = image.dtype in (np.float16, np.float32)
    channels = (3, 4) if is_light else (4,)
    if not (is_light or image.dtype == np.uint8) or image.ndim != 3 or image.shape[2] not in channels:
        refuse(rules.BAD_IMAGE, "add_image", f"{image.dtype}, shape {image.shape}")
    if not image.size:
        refuse(rules.BAD_IMAGE, "add_image", f"{image.dtype}, shape {image.shape}")
    return _convert_light(image) if is_light else np.ascontiguousarray(image)


def _convert_light(image: NDArray[Any]) -> ImagePixels:
    """Return linear light (height, width, 3 or 4) as float16 with alpha; refuse what isn't finite and in range."""
    limits = np.array((BRIGHTEST, BRIGHTEST, BRIGHTEST, 1.0), np.float32)[: image.shape[2]]
    is_valid = (image >= 0.0) & (image <= limits)  # False for NaN
    if not is_valid.all():
        worst, channel = image[~is_valid][0], int(np.nonzero(~is_valid)[2][0])
        allowed = "alpha from 0 to 1" if channel == 3 else f"finite texels from 0 to {BRIGHTEST:,.0f}"
        tip = _RANGE_TIP if channel < 3 and worst > 0.0 and np.isfinite(worst) else "replace such texels"
        refuse(rules.BAD_IMAGE, "add_image", f"a texel of {worst}", allowed, tip=tip)
    if image.dtype == np.float16 and image.shape[2] == 4:
        return np.ascontiguousarray(image)
    light = np.ones((*image.shape[:2], 4), np.float16)
    light[..., : image.shape[2]] = image
    return light


def has_high_range(image: ImagePixels) -> bool:
    """True if an image is float16."""
    return image.dtype == np.float16


def read_values(texels: NDArray[Any], *, is_color: bool) -> NDArray[np.float64]:
    """Return the values of texels (…, 4) in float64: linear light and alpha, or data."""
    if texels.dtype == np.float16:
        return texels.astype(np.float64)
    values: NDArray[np.float64] = texels / 255.0
    if is_color:
        values[..., :3] = from_srgb(values[..., :3])
    return values


def make_likeness(image: ImagePixels, *, is_color: bool) -> ImagePixels:
    """Return an image with 8 bits a channel; one of high range is cut at 1."""
    if not has_high_range(image):
        return image
    values = np.minimum(image.astype(np.float64), 1.0)
    if is_color:
        values[..., :3] = to_srgb(values[..., :3])
    return np.round(values * 255.0).astype(np.uint8)


def make_opaque(values: NDArray[np.float64]) -> ImagePixels:
    """Return values (height, width, 3) from 0 to 1 as the pixels of an image without transparency."""
    opaque = np.full((*values.shape[:2], 4), 255, np.uint8)
    opaque[..., :3] = np.clip(np.round(values * 255.0), 0, 255)
    return opaque
