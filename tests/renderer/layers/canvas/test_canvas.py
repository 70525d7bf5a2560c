"""The canvas: its pixels on all devices that draw, and its commands on the null device."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from renderer.layers.canvas import Canvas, Font, lay_out, srgb
from rhi import Format, Op
from tests.renderer.conftest import open_device

WHITE = srgb("#ffffff")
TEXT = "AVATAR To.\tWAVE 0123456789\nÄöüß éñ÷ \x07\tgjpqy |_"


def draw(
    device: rhi.Device, size: tuple[int, int], add: Callable[[Canvas], object], font: Font | None = None
) -> NDArray[np.uint8]:
    """The image that `add` draws on black, as linear RGBA8."""
    canvas = Canvas(device, font or Font.load())
    with device.texture(size, Format.RGBA8) as image:
        add(canvas)
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            canvas.draw(size)
        pixels = np.asarray(image.read())
    canvas.destroy()
    return pixels


def compose(font: Font, text: str, size: tuple[int, int], x: int, y: int) -> NDArray[np.uint8]:
    """Return the coverage (h, w) of a text, put together of the atlas's texels."""
    image = np.zeros(size[::-1], np.uint8)
    layout = lay_out(font, text)
    for glyph, (left, top) in zip(layout.glyphs, layout.positions + np.array((x, y)), strict=True):
        (u, v), (wide, high) = font.atlas_position[glyph], font.extent[glyph]
        part = image[top : top + high, left : left + wide]
        texels = font.coverage[v : v + high, u : u + wide]
        assert not ((part > 0) & (texels > 0)).any(), "glyphs overlap here, so coverage isn't a plain copy"
        part[...] = np.maximum(part, texels)
    return image


def test_at_scale_1_text_is_the_atlas_texel_by_texel(drawing_device: rhi.Device) -> None:
    font, size = Font.load(), (251, 60)
    pixels = draw(drawing_device, size, lambda canvas: canvas.text(5, 7, TEXT, WHITE))
    expected = compose(font, TEXT, size, 5, 7)
    assert expected.max() == 255
    assert (pixels == expected[:, :, None]).all()


@pytest.mark.parametrize("scale", [2, 3])
def test_at_whole_scales_each_texel_is_a_square_of_pixels(drawing_device: rhi.Device, scale: int) -> None:
    small = compose(Font.load(), TEXT, (250, 50), 2, 3)
    size = (250 * scale, 50 * scale)
    pixels = draw(drawing_device, size, lambda canvas: canvas.text(2 * scale, 3 * scale, TEXT, WHITE, scale))
    assert (pixels[:, :, 0] == small.repeat(scale, 0).repeat(scale, 1)).all()


def test_text_at_broken_pixels_is_put_on_the_nearest_whole_ones(drawing_device: rhi.Device) -> None:
    crisp = draw(drawing_device, (80, 30), lambda canvas: canvas.text(5, 7, "crisp", WHITE))
    moved = draw(drawing_device, (80, 30), lambda canvas: canvas.text(5.4, 6.6, "crisp", WHITE))
    assert (crisp == moved).all()


def test_rectangles_outlines_and_straight_lines_cover_exactly_their_pixels(
    drawing_device: rhi.Device,
) -> None:
    def add(canvas: Canvas) -> None:
        canvas.rect(1, 2, 3, 4, (1, 0, 0, 1))
        canvas.outlines([(6, 1, 7, 5)], (0, 1, 0, 1))
        canvas.lines([((1.0, 9.5), (13.0, 9.5)), ((14.5, 1.0), (14.5, 11.0))], (0, 0, 1, 1))
        canvas.outlines([(1, 11, 2, 2), (4, 11, 1, 1)], (0, 1, 0, 1), 3.0)  # thicker than they are wide

    expected = np.zeros((14, 17, 4), np.uint8)
    expected[2:6, 1:4] = (255, 0, 0, 255)
    expected[1:6, 6:13] = (0, 255, 0, 255)
    expected[2:5, 7:12] = 0
    expected[9, 1:13] = expected[1:11, 14] = (0, 0, 255, 255)
    expected[11:13, 1:3] = expected[11, 4] = (0, 255, 0, 255)
    assert (draw(drawing_device, (17, 14), add) == expected).all()


def test_the_strips_of_an_outline_do_not_overlap(drawing_device: rhi.Device) -> None:
    pixels = draw(
        drawing_device, (12, 12), lambda canvas: canvas.outlines([(1, 1, 9, 8)], (0.5, 0.5, 0.5, 0.5), 2)
    )
    assert set(np.unique(pixels)) <= {0, 127, 128}


def test_later_rectangles_cover_earlier_ones_and_premultiplied_light_is_added(
    drawing_device: rhi.Device,
) -> None:
    def add(canvas: Canvas) -> None:
        canvas.rects(
            [(0, 0, 8, 4), (2, 0, 2, 4), (4, 0, 2, 4)], [(0, 0, 1, 1), (0.4, 0, 0, 0.4), (0.4, 0, 0, 0)]
        )

    row = draw(drawing_device, (8, 4), add)[2].astype(int)
    assert np.abs(row[1] - (0, 0, 255, 255)).max() == 0
    assert np.abs(row[2] - (102, 0, 153, 255)).max() <= 1
    assert np.abs(row[4] - (102, 0, 255, 255)).max() <= 1


def test_a_clip_rectangle_cuts_everything_at_whole_pixels_and_nests(drawing_device: rhi.Device) -> None:
    def add(canvas: Canvas) -> None:
        with canvas.clip(2, 3, 6, 5):
            canvas.rect(-5, -5, 50, 50, (1, 0, 0, 1))
            with canvas.clip(6, 0, 20, 5):
                canvas.rect(0, 0, 50, 50, (0, 1, 0, 1))
            with canvas.clip(20, 20, 5, 5):  # outside of the one around
                canvas.rect(0, 0, 50, 50, (0, 0, 1, 1))
        canvas.rect(0, 0, 1, 1, (0, 0, 1, 1))

    expected = np.zeros((12, 12, 4), np.uint8)
    expected[3:8, 2:8] = (255, 0, 0, 255)
    expected[3:5, 6:8] = (0, 255, 0, 255)
    expected[0, 0] = (0, 0, 255, 255)
    assert (draw(drawing_device, (12, 12), add) == expected).all()


def test_a_canvas_that_grows_keeps_its_shapes(drawing_device: rhi.Device) -> None:
    size = (80, 60)
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    boxes = np.stack([x, y, np.ones_like(x), np.ones_like(x)], axis=-1).reshape(-1, 4)
    colors = np.random.default_rng(1).integers(0, 256, (len(boxes), 4)) / 255.0
    colors[:, 3] = 1.0

    def add(canvas: Canvas) -> None:
        canvas.text(0, 0, "under all", WHITE)
        for part in np.array_split(np.arange(len(boxes)), 7):  # 4,800: more than fit at first
            canvas.rects(boxes[part], colors[part])

    pixels = draw(drawing_device, size, add)
    assert (pixels == np.round(colors * 255).astype(np.uint8).reshape(60, 80, 4)).all()


def add_everything(canvas: Canvas) -> None:
    canvas.rect(3, 3, 180, 90, srgb("#102030"))
    canvas.text(10, 8, TEXT, srgb("#ffc040"))
    canvas.text(10, 50, "scale 2", WHITE, 2)
    canvas.lines([((5.0, 80.0), (170.0, 20.0)), ((90.3, 4.1), (100.7, 91.9))], srgb("#4080ff"), 2.0)
    with canvas.clip(100, 40, 60, 30):
        canvas.text(80, 50, "clipped at both ends", srgb("#ff8080"))


def test_gl_and_cl_draw_the_same_pixels() -> None:
    images = []
    for name in ("gl", "cl"):
        with open_device(name) as device:
            images.append(draw(device, (190, 100), add_everything).astype(int))
    first, second = images
    difference = np.abs(first - second).max(axis=2)
    blended = np.isin(first, (0, 255)).all(axis=2)
    # Where coverage is partial, llvmpipe blends in 8 bits, which rounds the light before it is added.
    assert difference.max() <= 2
    assert (difference[blended] == 0).all()
    assert (difference > 0).mean() < 0.05


def record(null: rhi.Device, add: Callable[[Canvas], object]) -> tuple[int, int]:
    """Return the numbers of draws and of uploaded bytes."""
    canvas = Canvas(null, Font.load())
    image = null.texture((100, 100), Format.RGBA8)
    null.stream.clear()
    before = null.statistics.upload_bytes
    add(canvas)
    with null.render_pass(image):
        draw_count = canvas.draw(image.size)
    draws = sum(command.op is Op.DRAW for command in null.stream)
    assert draws == draw_count
    return draws, null.statistics.upload_bytes - before


def test_all_between_two_clip_rectangles_is_one_draw(null: rhi.Device) -> None:
    def add(canvas: Canvas) -> None:
        for number in range(20):
            canvas.rect(number, 0, 1, 1, WHITE)
            canvas.text(0, number, "abc", WHITE)
            canvas.outlines([(0, 0, 9, 9)], WHITE)

    assert record(null, add) == (1, 48 * 20 * (1 + 3 + 4) + 16)


def test_clip_rectangles_that_follow_each_other_and_are_equal_share_a_draw(null: rhi.Device) -> None:
    def add(canvas: Canvas) -> None:
        for _ in range(3):
            with canvas.clip(10, 10, 20, 20):
                canvas.rect(0, 0, 50, 50, WHITE)
        canvas.rect(0, 0, 50, 50, WHITE)
        with canvas.clip(10, 10, 20, 20):
            pass
        canvas.rect(0, 0, 50, 50, WHITE)

    assert record(null, add) == (2, 48 * 5 + 16)


def test_shapes_outside_of_the_target_and_blank_text_take_no_draw(null: rhi.Device) -> None:
    def add(canvas: Canvas) -> None:
        with canvas.clip(100, 0, 20, 20):
            canvas.rect(0, 0, 500, 50, WHITE)
        canvas.text(3, 3, " \n\t ", WHITE)

    assert record(null, add) == (0, 0)


def test_arrays_of_nothing_add_nothing(null: rhi.Device) -> None:
    canvas = Canvas(null, Font.load())
    for add in (canvas.rects, canvas.outlines, canvas.lines):
        add([], WHITE)
    assert canvas.text(0, 0, "", WHITE) == (0, canvas.font.line_height)
    assert len(canvas) == 0


def test_a_canvas_begins_anew_after_each_draw(null: rhi.Device) -> None:
    canvas = Canvas(null, Font.load())
    with null.texture((8, 8), Format.RGBA8) as image:
        canvas.rect(0, 0, 4, 4, WHITE)
        with null.render_pass(image):
            assert (canvas.draw(image.size), len(canvas), canvas.draw(image.size)) == (1, 0, 0)


def test_srgb_is_linear_and_premultiplied() -> None:
    assert srgb("#ffffff").tolist() == [1, 1, 1, 1]
    assert np.allclose(srgb("#bc0a00", 0.5), (0.5 * 0.502886, 0.5 * 0.003035, 0.0, 0.5), atol=1e-5)
