"""Generated mip levels of all sizes: a box filter of all texels that a texel covers, in linear light.

Along an odd axis that is three texels, the outer two in part. So nothing is left out, and the mean of a level
remains. Each level is compared with the mean of the stored one above, so that roundings don't add up.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device, Format, Texture, TextureKind
from rhi.conformance.compare import assert_near, assert_same
from rhi.conformance.formats import random_texels, require_format, squeezed
from rhi.conformance.reference import channels_of, halve
from rhi.contract.formats import COLOR_FORMATS, ChannelKind

SIZES = [(7, 1), (1, 5), (3, 3), (5, 8), (31, 17), (6, 10), (2, 7), (33, 1), (1, 1), (13, 64)]
FILTERABLE = [f for f in COLOR_FORMATS if not f.is_integer]


def identity(value: Any) -> str:
    return value.name if isinstance(value, Format | TextureKind) else str(value)


def slack(format: Format, above: NDArray[Any]) -> Any:
    """Return the rounding that a level may have: one of the format's steps."""
    if format.is_packed and format.kind is ChannelKind.FLOAT:
        return np.abs(above).max() * 2.0 ** -np.array([5, 5, 4])
    if format.dtype.kind == "f":
        bits = 10 if format.dtype.itemsize == 2 else 22
        return np.abs(above.astype(np.float64)).max() * 2.0**-bits
    return 1.5 if format.kind is ChannelKind.SRGB else 1.0


def check_levels(texture: Texture) -> None:
    """Check that each layer of each level, or each level of a volume, is the mean of the one above."""
    format = texture.format
    levels = []
    for number in range(texture.levels):
        texels = texture.read_layers(number)
        levels.append(channels_of(format, texels[..., 0] if format.components == 1 else texels))
    for above, level in pairwise(levels):
        if texture.kind is TextureKind.D3:
            expected = halve(format, above)
        else:
            expected = np.stack([halve(format, layer) for layer in above])
        assert_near(level, expected, slack(format, above), "one unit of rounding")


@pytest.mark.parametrize("format", FILTERABLE, ids=identity)
def test_a_texel_is_the_mean_of_all_that_it_covers(device: Device, format: Format) -> None:
    require_format(device, format)
    for width, height in SIZES:
        data = random_texels(format, height, width, seed=width)
        with device.texture((width, height), format, levels=None) as texture:
            texture.write(squeezed(format, data))
            texture.generate_mipmaps()
            assert_same(texture.read(0), squeezed(format, data))
            check_levels(texture)


@pytest.mark.parametrize("format", [Format.R8, Format.RGBA8_SRGB, Format.RG16F, Format.RGBA32F], ids=identity)
@pytest.mark.parametrize(
    ("kind", "size", "layers"),
    [
        (TextureKind.D2_ARRAY, (7, 5), 3),
        (TextureKind.D2_ARRAY, (3, 10), 5),
        (TextureKind.CUBE, (7, 7), 6),
        (TextureKind.CUBE, (6, 6), 6),
        (TextureKind.D3, (5, 7), 3),
        (TextureKind.D3, (4, 3), 7),
        (TextureKind.D3, (1, 3), 5),
        (TextureKind.D3, (9, 2), 1),
        (TextureKind.D3, (1, 1), 11),
    ],
    ids=identity,
)
def test_so_are_layers_faces_and_volumes(
    device: Device, kind: TextureKind, size: tuple[int, int], layers: int, format: Format
) -> None:
    require_format(device, format)
    data = random_texels(format, layers, size[1], size[0], seed=layers)
    with device.texture(size, format, kind=kind, layers=layers, levels=None) as texture:
        texture.write(data)
        texture.generate_mipmaps()
        check_levels(texture)


@pytest.mark.parametrize("width", range(1, 18))
def test_no_texel_is_left_out(device: Device, width: int) -> None:
    """One texel of light has its share in the last level, wherever it is."""
    for lit in range(width):
        row = np.zeros((1, width), np.float32)
        row[0, lit] = 1
        expected: NDArray[Any] = row[..., None]
        with device.texture(row, Format.R32F, levels=None) as texture:
            texture.generate_mipmaps()
            for level in range(1, texture.levels):
                expected = halve(Format.R32F, expected)
                assert_near(texture.read(level), expected[..., 0], 1e-6, "float32")
                if width & (width + 1) == 0 and width > 1:  # 2ⁿ − 1: some texel would be left out
                    assert texture.read(level).any()


def test_only_a_part_of_the_levels_may_exist(device: Device) -> None:
    data = random_texels(Format.RGBA8, 19, 21)
    with device.texture((21, 19), Format.RGBA8, levels=3) as texture:
        texture.write(data)
        texture.generate_mipmaps()
        check_levels(texture)


def test_mip_levels_follow_draws_and_can_be_generated_again(device: Device) -> None:
    with device.texture((5, 3), Format.RGBA16F, levels=None) as texture:
        for red in (0.25, 0.75):
            with device.render_pass(texture.at(level=0), clear=(red, 0.5, 0, 1)):
                pass
            texture.generate_mipmaps()
            assert_near(texture.read(2), (red, 0.5, 0, 1), 1e-3, "float16")
