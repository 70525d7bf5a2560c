"""Checked shaders that draw: an index out of range is an error with its line once the draws are complete."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import rhi
from rhi import CullMode, Device, DeviceError, Format
from rhi.errors import ShaderError
from rhi.shading import Flat, Shader, Storage, Struct, ddx, fragment_coordinate, vec2, vec4
from rhi.shading.language import rules

SIZE = (32, 16)


@pytest.fixture
def device() -> Iterator[Device]:
    try:
        created = rhi.create_device("cl")
    except DeviceError as error:
        pytest.skip(f"no OpenCL: {error}")
    with created:
        yield created


class Corner(Struct):
    position: vec2
    row_index: int


class Varying(Struct):
    clip: vec4
    depth: Flat[float]
    column: float


class Bars(Shader):
    depths: Storage[float]
    heights: Storage[float]

    def vertex(self, v: Corner) -> Varying:
        depth = self.depths[v.row_index]
        return Varying(clip=vec4(v.position, 0.0, 1.0), depth=depth, column=v.position.x * 16.0 + 16.0)

    def fragment(self, v: Varying) -> vec4:
        height = self.heights[int(v.column)]
        inside = 1.0 if fragment_coordinate().y < height else 0.0
        return vec4(inside, v.depth, ddx(v.column), 1.0)


class CheckedBars(Bars):
    checked = True


def draw(device: Device, shader: type[Shader], rows: int, columns: int) -> rhi.Texture:
    corners = np.zeros(3, Corner.dtype)
    corners["position"] = [(-1, -1), (3, -1), (-1, 3)]
    corners["row_index"] = (0, 1, 2)
    image = device.texture(SIZE, Format.RGBA32F)
    depths, heights = (device.storage(float, np.full(count, 8.0, "f4")) for count in (rows, columns))
    program, mesh = device.program(shader), device.mesh(corners)
    with device.render_pass(color=image, clear=(0, 0, 0, 0)), device.states(CullMode.NONE):
        device.draw(program, mesh, depths=depths, heights=heights)
    return image


def test_a_checked_draw_within_bounds_is_as_any_other(device: Device) -> None:
    checked = draw(device, CheckedBars, 3, 32).read()
    np.testing.assert_array_equal(checked, draw(device, Bars, 3, 32).read())
    assert (checked[:8, :, 0] == 1).all()
    assert (checked[8:, :, 0] == 0).all()
    assert (checked[..., 1] == 8).all()


@pytest.mark.parametrize(
    ("rows", "columns", "source", "index"),
    [(2, 32, "depth = self.depths[v.row_index]", 2), (3, 31, "height = self.heights[int(v.column)]", 31)],
)
def test_an_index_outside_is_an_error_with_its_line(
    device: Device, rows: int, columns: int, source: str, index: int
) -> None:
    with pytest.raises(ShaderError, match=f"index {index}\n") as caught:
        draw(device, CheckedBars, rows, columns).read()
    assert caught.value.rule is rules.INDEX
    assert source in str(caught.value)
    assert (draw(device, CheckedBars, 3, 32).read()[..., 1] == 8).all()  # the next draw begins anew
