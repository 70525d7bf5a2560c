"""Mip levels on gl: rounded to nearest, and made without a trace in what is bound."""

from __future__ import annotations

import pytest

import rhi
from rhi import Format
from rhi.conformance.formats import random_texels, squeezed
from rhi.contract.texels import halve
from rhi.shading import FullScreen, UintImage2D, image, ivec2, uint, uvec4, vec4

SMALL_FLOATS = (Format.R16F, Format.RG16F, Format.RGBA16F, Format.R11G11B10F)


@pytest.mark.parametrize("format", SMALL_FLOATS, ids=lambda f: f.name)
def test_small_floats_are_rounded_to_nearest(format: Format) -> None:
    """llvmpipe truncates what it converts itself. Sums in float32 may fall on the other side of a half."""
    data = random_texels(format, 37, 54)
    with rhi.create_device("gl") as device, device.texture((54, 37), format, levels=2) as texture:
        texture.write(squeezed(format, data))
        texture.generate_mipmaps()
        expected = squeezed(format, halve(format, data[None], 1)[0])
        assert (texture.read(1) != expected).mean() < 0.01


class Stored(FullScreen):
    """Counts the fragments of a texel in an image."""

    target: UintImage2D = image(Format.R32UI)

    def fragment(self) -> vec4:
        at = ivec2(0, 0)
        self.target.store(at, self.target.load(at) + uvec4(uint(1)))
        return vec4(1.0, 1.0, 1.0, 1.0)


def test_an_image_stays_bound_while_levels_are_made() -> None:
    with (
        rhi.create_device("gl") as device,
        device.texture((1, 1), Format.R32UI) as target,
        device.texture((1, 1), Format.RGBA8) as drawn,
        device.texture((5, 5), Format.RGBA8, levels=None) as texture,
    ):
        program, mesh = device.program(Stored), device.mesh(3)
        with device.render_pass(drawn):
            for _ in range(3):
                device.draw(program, mesh, target=target.image())
                texture.generate_mipmaps()
        assert target.read()[0, 0] == 3
        assert not texture.read(1).any()
