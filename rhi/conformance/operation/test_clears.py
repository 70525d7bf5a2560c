"""Clears under draws: a backend may defer a clear until it draws, so the result must not depend on what is
drawn where.

Targets are larger than a rasteriser's tiles, and their sizes aren't multiples of a tile's.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import (
    BlendFunction,
    ColorWrite,
    DepthFunction,
    DepthWrite,
    Device,
    Format,
    State,
    StencilTest,
    Texture,
)
from rhi.conformance.compare import assert_mask, assert_same
from rhi.conformance.formats import require_format, require_renderable, require_samples
from rhi.conformance.shaders import Colored, IntColored, UintColored
from rhi.conformance.shapes import rectangle, texel_rectangle
from rhi.conformance.single_draws import draw_once
from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind
from rhi.shading import Shader

pytestmark = pytest.mark.requires("draws", "shading")

SIZE = (150, 70)
RED = (1, 0, 0, 1)
SHADERS: dict[ChannelKind, type[Shader]] = {ChannelKind.UINT: UintColored, ChannelKind.INT: IntColored}


def identity(value: Any) -> str:
    return value.name if isinstance(value, Format) else str(value)


def box(x: int, y: int, width: int, height: int, size: tuple[int, int] = SIZE) -> np.ndarray[Any, Any]:
    mask = np.zeros(size[::-1], bool)
    mask[y : y + height, x : x + width] = True
    return mask


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (64, 64), (65, 66), (130, 5), (7, 200), SIZE], ids=str)
def test_a_clear_reaches_all_texels_around_a_draw(device: Device, size: tuple[int, int]) -> None:
    with (
        device.texture(size, Format.RGBA8) as image,
        device.texture(size, Format.D32F) as depth,
        device.mesh(texel_rectangle(0, 0, 1, 1, size, depth=0.5)) as mesh,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25):
            device.draw(device.program(Colored), mesh)
        drawn = box(0, 0, 1, 1, size)
        assert_mask(image.read()[..., 1], drawn)
        assert_mask(image.read()[..., 0], np.ones_like(drawn))
        assert_same(depth.read(), np.where(drawn, 0.5, 0.25))


def draw_over(
    device: Device,
    image: Texture,
    shader: type[Shader],
    clear: tuple[float, float, float, float],
    together: bool,
    blend: BlendFunction = BlendFunction.OFF,
) -> None:
    """Return the target after a clear and a rectangle, in one pass or in two."""
    with device.mesh(texel_rectangle(60, 3, 30, 40, SIZE, color=(0.25, 1, 0.5, 0.75))) as mesh:
        if not together:
            with device.render_pass(image, clear=clear):
                pass
        with device.render_pass(image, clear=clear if together else None), device.states(blend):
            device.draw(device.program(shader), mesh)


@pytest.mark.parametrize("format", COLOR_FORMATS, ids=identity)
def test_a_color_format_is_cleared_under_a_draw_as_in_a_pass_before(device: Device, format: Format) -> None:
    require_renderable(device, format)
    shader = SHADERS.get(format.kind, Colored)
    clear = (3.0, 1.0, 2.0, 0.0) if format.is_integer else (3.0, 0.3, 2.0, 0.75)
    with device.texture(SIZE, format) as image, device.texture(SIZE, format) as expected:
        draw_over(device, image, shader, clear, True)
        draw_over(device, expected, shader, clear, False)
        assert_same(image.read(), expected.read())
        assert (image.read()[-1, -1] == image.read()[0, 0]).all()


def test_blending_reads_the_cleared_color(device: Device) -> None:
    with device.texture(SIZE, Format.RGBA16F) as first, device.texture(SIZE, Format.RGBA16F) as second:
        for image, together in ((first, True), (second, False)):
            draw_over(device, image, Colored, (0.5, 0.25, 1, 1), together, BlendFunction.ADDITIVE)
        assert_same(first.read(), second.read())
        assert_same(first.read()[10, 70, 1], 1.25)


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=identity)
@pytest.mark.parametrize("depth", [0.25, 0.75])
def test_a_depth_format_is_cleared_under_a_draw(device: Device, format: Format, depth: float) -> None:
    require_format(device, format)
    with (
        device.texture(SIZE, format) as target,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE, depth=0.5)) as mesh,
    ):
        with device.render_pass(depth=target, clear_depth=depth), device.states(DepthFunction.GREATER):
            device.draw(device.program(Colored), mesh)
        passes = box(60, 3, 30, 40) & (depth < 0.5)
        np.testing.assert_allclose(target.read(), np.where(passes, 0.5, depth), atol=2.0**-15)


@pytest.mark.parametrize("state", [DepthWrite.OFF, DepthFunction.NEVER], ids=identity)
def test_a_depth_that_draws_do_not_write_is_cleared_under_them(device: Device, state: State) -> None:
    with (
        device.texture(SIZE, Format.D32F) as target,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE, depth=0.5)) as mesh,
    ):
        for depth in (0.25, 0.75):
            with device.render_pass(depth=target, clear_depth=depth), device.states(state):
                device.draw(device.program(Colored), mesh)
            assert_same(target.read(), np.full(SIZE[::-1], depth, np.float32))


@pytest.mark.requires("stencil")
@pytest.mark.parametrize("used", [False, True], ids=["test off", "test on"])
def test_stencil_is_cleared_under_a_draw_that_uses_it_or_not(device: Device, used: bool) -> None:
    require_format(device, Format.D24S8)
    with (
        device.texture(SIZE, Format.D24S8) as target,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE)) as mesh,
    ):
        with (
            device.render_pass(depth=target, clear_depth=0.25, clear_stencil=7),
            device.states(StencilTest.ON if used else StencilTest.OFF),
        ):
            device.draw(device.program(Colored), mesh)
        assert_same(target.read_stencil(), 7)
        assert_mask(target.read() > 0.3, box(60, 3, 30, 40))


@pytest.mark.parametrize(
    "first", [(ColorWrite.OFF,), (rhi.DepthTest.OFF, DepthWrite.OFF)], ids=["depth", "color"]
)
def test_targets_that_the_first_draw_does_not_write_are_cleared_for_the_second(
    device: Device, first: tuple[State, ...]
) -> None:
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(texel_rectangle(0, 0, 70, 70, SIZE, depth=0.5)) as left,
        device.mesh(texel_rectangle(80, 0, 70, 70, SIZE, depth=0.75)) as right,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.25):
            with device.states(*first):
                device.draw(device.program(Colored), left)
            device.draw(device.program(Colored), right)
        color_only = first != (ColorWrite.OFF,)
        in_color = box(80, 0, 70, 70) | (box(0, 0, 70, 70) & color_only)
        in_depth = np.where(
            box(80, 0, 70, 70), 0.75, np.where(box(0, 0, 70, 70) & (not color_only), 0.5, 0.25)
        )
        assert_mask(image.read()[..., 1], in_color)
        assert_same(image.read()[..., 0], 255)
        assert_same(depth.read(), in_depth)


def test_a_clear_is_done_under_draws_of_nothing(device: Device) -> None:
    with device.texture(SIZE, Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image, clear=RED):
            device.draw(device.program(Colored), mesh, 0)
        assert_same(image.read(), (255, 0, 0, 255))


def test_a_clear_is_done_under_a_scissor_that_holds_nothing_of_the_draw(device: Device) -> None:
    drawn = draw_once(
        device, SIZE, Format.RGBA8, texel_rectangle(0, 0, 9, 9, SIZE), rhi.Scissor(100, 50, 20, 10), clear=RED
    )
    assert_same(drawn, (255, 0, 0, 255))


def make_mesh(device: Device) -> None:
    device.mesh(rectangle()).destroy()


def write_storage(device: Device) -> None:
    device.storage(float, np.zeros(4, np.float32)).destroy()


def make_texture(device: Device) -> None:
    device.texture(np.zeros((3, 3, 4), np.uint8), Format.RGBA8).destroy()


@pytest.mark.parametrize("between", [make_mesh, write_storage, make_texture], ids=lambda make: make.__name__)
def test_other_commands_may_stand_between_a_clear_and_its_draws(
    device: Device, between: Callable[[Device], None]
) -> None:
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE)) as mesh,
    ):
        with device.render_pass(image, clear=RED):
            between(device)
            device.draw(device.program(Colored), mesh)
            between(device)
        assert_mask(image.read()[..., 1], box(60, 3, 30, 40))
        assert_same(image.read()[..., 0], 255)


def test_a_layer_is_cleared_under_a_draw_and_no_other(device: Device) -> None:
    with (
        device.texture(SIZE, Format.RGBA8, kind=rhi.TextureKind.D2_ARRAY, layers=3) as image,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE)) as mesh,
    ):
        with device.render_pass(image.at(layer=1), clear=RED):
            device.draw(device.program(Colored), mesh)
        back = image.read_layers()
        assert_same(back[::2], 0)
        assert_same(back[1, ..., 0], 255)
        assert_mask(back[1, ..., 1], box(60, 3, 30, 40))


def test_all_samples_are_cleared_under_a_draw(device: Device) -> None:
    require_samples(device, 4)
    with (
        device.texture(SIZE, Format.RGBA8, samples=4) as image,
        device.texture(SIZE, Format.D32F, samples=4) as depth,
        device.texture(SIZE, Format.RGBA8) as target,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE, depth=0.5)) as mesh,
        device.mesh(rectangle(depth=0.3, color=(0, 1, 0, 1))) as behind,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.4, resolve=target):
            device.draw(device.program(Colored), mesh)
            device.draw(device.program(Colored), behind)
        assert_mask(target.read()[..., 1], box(60, 3, 30, 40))
        assert_same(target.read()[..., 0], 255)


def test_a_second_pass_clears_the_draws_of_the_first_pass(device: Device) -> None:
    with (
        device.texture(SIZE, Format.RGBA8) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(rectangle(depth=0.9)) as near,
        device.mesh(texel_rectangle(60, 3, 30, 40, SIZE, depth=0.5)) as far,
    ):
        with device.render_pass(image, depth, clear=RED, clear_depth=0.0):
            device.draw(device.program(Colored), near)
        with device.render_pass(image, depth, clear=RED, clear_depth=0.0):
            device.draw(device.program(Colored), far)
        assert_mask(image.read()[..., 1], box(60, 3, 30, 40))
        assert_same(depth.read(), np.where(box(60, 3, 30, 40), 0.5, 0.0))


def test_an_asynchronous_read_of_depth_returns_float32(device: Device) -> None:
    with device.texture((5, 3), Format.D24) as texture:
        with device.render_pass(depth=texture, clear_depth=0.3):
            pass
        result = texture.read_async().result()
        assert result.dtype == np.float32
        assert_same(result, texture.read())
