"""Textures as fragments read them: row 0 is the top row, of written textures and of drawn ones."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from rhi import Device, Filter, Format, Mesh, Primitive, SamplerDescriptor, Wrap
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, FlatShade, Loads, TexturedVarying, TexturedVertex, Tint, Tinted
from rhi.conformance.shapes import centers, corners, rectangle
from rhi.conformance.single_draws import draw_once
from rhi.shading import Shader, Texture2D, ivec2, vec4

pytestmark = [pytest.mark.requires("draws", "shading", "max_texture_slots"), pytest.mark.recorded_too]

NEAREST = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None, Wrap.CLAMP, Wrap.CLAMP)
UPRIGHT = [(0, 1), (1, 1), (1, 0), (0, 0)]


def texels(width: int, height: int) -> NDArray[Any]:
    """Return texels of distinct colors."""
    y, x = np.mgrid[0:height, 0:width]
    return np.stack([x, y, 255 - x, 255 - y], axis=-1).astype(np.uint8)


class Textured(Shader):
    """Samples a texture at uv."""

    source: Texture2D

    def vertex(self, v: TexturedVertex) -> TexturedVarying:
        return TexturedVarying(clip=v.position, uv=v.uv)

    def fragment(self, v: TexturedVarying) -> vec4:
        return self.source.sample(v.uv)


def make_rectangle(uvs: object) -> NDArray[Any]:
    """Return a full rectangle with these uv at its lower left, lower right, upper right and upper left
    corners."""
    rows = np.zeros(6, TexturedVertex.dtype)
    rows["position"] = rectangle()["position"]
    rows["uv"] = np.asarray(uvs)[[0, 1, 2, 0, 2, 3]]
    return rows


def test_v_0_is_the_top_row(device: Device) -> None:
    """A texture drawn with v = 0 at the top of the target comes out as it was written."""
    data = texels(5, 3)
    with device.texture(data, Format.RGBA8) as source:
        sampled, rows = source.sampled(NEAREST), make_rectangle(UPRIGHT)
        assert_same(draw_once(device, (5, 3), Format.RGBA8, rows, shader=Textured, source=sampled), data)


def test_a_drawn_texture_is_sampled_like_a_written_one(device: Device) -> None:
    with (
        device.texture((4, 4), Format.RGBA8) as drawn,
        device.texture((4, 4), Format.RGBA8) as target,
        device.mesh(rectangle(-1, 0, 0, 1)) as corner,
        device.mesh(make_rectangle(UPRIGHT)) as whole,
    ):
        with device.render_pass(drawn, clear=(0, 0, 0, 0)):
            device.draw(device.program(Colored), corner)
        with device.render_pass(target):
            device.draw(device.program(Textured), whole, source=drawn.sampled(NEAREST))
        expected = np.zeros((4, 4, 4))
        expected[:2, :2] = 255
        assert_same(target.read(), expected)


def test_texel_loads_count_from_the_top_left(device: Device, mesh: Mesh) -> None:
    data = texels(5, 3)
    with device.texture(data, Format.RGBA8) as source, device.texture((5, 3), Format.RGBA8) as target:
        with device.render_pass(target):
            device.draw(device.program(Loads), mesh, source=source)
        assert_same(target.read(), data)


class TintedTexel(Tinted):
    """Multiplies the tint with a texel."""

    source: Texture2D

    def fragment(self, v: FlatShade) -> vec4:
        return self.tint.color * self.source.load(ivec2(0, 0))


def test_each_draw_has_its_own_constants_where_its_texture_is_another_one(device: Device) -> None:
    size, program = (8, 1), device.program(TintedTexel)
    rows = corners(centers([(column, 0) for column in range(8)], size))
    textures = [device.texture(np.full((1, 1), 10.0**number, np.float32), Format.R32F) for number in range(2)]
    with device.texture(size, Format.R32F) as image, device.mesh(rows, primitive=Primitive.POINTS) as mesh:
        with device.render_pass(image):
            for index in range(8):
                tint = device.transient.uniform(Tint(color=(index, 0, 0, 0)))
                device.draw(program, mesh.view(index, 1), tint=tint, source=textures[index % 2])
        device.present()
        assert_same(image.read().reshape(-1), [0, 10, 2, 30, 4, 50, 6, 70])
    for texture in textures:
        texture.destroy()
