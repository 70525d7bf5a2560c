"""Levels that a device generates: on gl and cl more exact than the kit asks of every platform."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from rhi import Format
from rhi.conformance.reference import linear_to_srgb
from rhi.contract.texels import decode


@pytest.mark.parametrize(("backend", "most"), [("gl", 0.8), ("cl", 0.501)])
def test_each_mip_level_is_the_mean_of_the_level_before(backend: str, most: float) -> None:
    """Averages in linear light are rounded to nearest. On gl llvmpipe's curve adds up to 0.3."""
    texels = np.random.default_rng(3).integers(0, 256, (64, 64, 4), np.uint8)
    with (
        rhi.create_device(backend) as device,
        device.texture(texels, Format.RGBA8_SRGB, levels=None) as image,
    ):
        image.generate_mipmaps()
        for level in range(1, image.levels):
            linear = decode(Format.RGBA8_SRGB, image.read(level - 1)).astype(np.float64)
            means = linear.reshape(len(linear) // 2, 2, -1, 2, 4).mean(axis=(1, 3))
            expected = 255 * np.concatenate([linear_to_srgb(means[..., :3]), means[..., 3:]], axis=-1)
            assert np.abs(image.read(level) - expected).max() <= most
