"""The full-screen triangle: every pixel once, behind all that is drawn to the same depth."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from rhi import BlendFunction, Format
from rhi.shading import FullScreen, Shader, Struct, fragment_coordinate, vec3, vec4

BACKENDS = ["gl", pytest.param("cl", marks=pytest.mark.nightly)]


class ShowCoordinates(FullScreen):
    def fragment(self) -> vec4:
        return vec4(fragment_coordinate().xy / 255.0, 0.5, 1.0)


class Near(FullScreen):
    """The same at another depth."""

    def screen_depth(self) -> float:
        return 0.5

    def fragment(self) -> vec4:
        return vec4(0.0, 0.0, 0.0, 1.0)


class Corner(Struct):
    position: vec3


class Flat(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("size", [(1, 1), (33, 17)])
def test_each_pixel_is_drawn_once(backend: str, size: tuple[int, int]) -> None:
    with rhi.create_device(backend) as device:
        image = device.texture(size, Format.RGBA8)
        with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(BlendFunction.ADDITIVE):
            device.draw(device.program(ShowCoordinates), device.mesh(3))
        y, x = np.indices(size[::-1])
        assert np.abs(image.read()[..., :2].astype(int) - np.dstack([x, y])).max() <= 1
        assert (np.abs(image.read()[..., 2].astype(int) - 128) <= 1).all()


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("first", [True, False])
def test_a_full_screen_triangle_is_behind_all_other_draws(backend: str, first: bool) -> None:
    """The surface is as far as 10 km with a near plane at 1 mm: a depth of 1e-7."""
    with rhi.create_device(backend) as device:
        image, depth = device.texture((8, 8), Format.RGBA8), device.texture((8, 8), Format.D32F)
        corners = np.array([(-1, -1, 1e-7), (0, -1, 1e-7), (0, 1, 1e-7), (-1, 1, 1e-7)], np.float32)
        square = device.mesh({"position": corners}, np.array([0, 1, 2, 0, 2, 3], np.uint16))
        draws = [(ShowCoordinates, device.mesh(3)), (Flat, square)]
        with device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.0):
            for shader, mesh in draws if first else draws[::-1]:
                device.draw(device.program(shader), mesh)
        pixels = image.read()
        assert (pixels[:, :4] == 255).all()
        assert (pixels[:, 4:, 3] == 255).all()
        assert (pixels[:, 4:, 0] < 20).all()
        with device.render_pass(image, depth):
            device.draw(device.program(Near), device.mesh(3))
        assert not image.read()[..., :3].any()
