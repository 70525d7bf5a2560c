"""Screens on canvases that need no display, and what is said where one can't be opened."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from testing_kit import backend_works

import rhi
from rhi import DeviceError, Format, Op, ValidationError

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi_screen import CANVASES, Screen, open_canvas, open_screen


@pytest.fixture
def screen() -> Iterator[Screen]:
    with open_screen("null", canvas="offscreen", size=(6, 4)) as opened:
        yield opened


def make_texels(size: tuple[int, int]) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (size[1], size[0], 4), np.uint8)


@pytest.mark.parametrize("backend", ["null", "gl", "cl"])
@pytest.mark.parametrize("format", [Format.RGBA8, Format.RGBA8_SRGB])
def test_a_canvas_shows_the_images_colors_opaque(backend: str, format: Format) -> None:
    texels = make_texels((6, 4))
    with open_screen(backend, canvas="offscreen", size=(6, 4)) as screen:
        image = screen.device.texture(texels, format)

        def draw() -> None:
            screen.show(image)
            image.destroy()  # it is needed no longer

        screen.canvas.request_draw(draw)
        displayed = screen.canvas.draw()
    assert (displayed[..., :3] == texels[..., :3]).all()
    assert (displayed[..., 3] == 255).all()


def test_showing_an_image_ends_the_frame(screen: Screen) -> None:
    image = screen.device.texture((6, 4), Format.RGBA8)
    screen.canvas.request_draw(lambda: screen.show(image))
    for _ in range(3):
        screen.canvas.draw()
    assert len(screen.device.stream.filter(Op.PRESENT)) == 3


def test_the_size_of_a_screen_is_in_physical_pixels() -> None:
    opened = open_canvas("offscreen", size=(30, 20), pixel_ratio=1.5)
    with Screen(opened, "null") as screen:
        assert screen.size == (45, 30)
        opened.set_logical_size(10, 8)
        assert screen.size == (15, 12)


def test_a_canvas_without_a_loop_draws_one_frame(screen: Screen) -> None:
    frames = []
    screen.run(lambda: frames.append(screen.size))
    assert frames == [(6, 4)]


def test_an_error_in_a_draw_is_raised(screen: Screen) -> None:
    with pytest.raises(ZeroDivisionError):
        screen.run(lambda: 1 // 0)


def test_other_ways_with_errors_are_refused(screen: Screen) -> None:
    with pytest.raises(ValidationError, match="screen-errors"):
        screen.run(lambda: None, on_error="ignore")


@pytest.mark.parametrize(
    ("format", "options"), [(Format.RGBA16F, {}), (Format.R8, {}), (Format.RGBA8, {"samples": 4})]
)
def test_other_images_are_refused_by_name(screen: Screen, format: Format, options: dict[str, Any]) -> None:
    image = screen.device.texture((6, 4), format, **options)
    with pytest.raises(ValidationError, match=r"^\[screen-image\]") as error:
        screen.show(image)
    assert "RGBA8" in error.value.allowed
    assert error.value.site is not None
    assert error.value.site.file == __file__


def test_a_device_that_the_screen_has_created_is_closed_with_it() -> None:
    with open_screen("null", canvas="offscreen") as screen:
        assert not screen.device.closed
    assert screen.device.closed
    assert screen.canvas.get_closed()
    screen.close()


def test_closing_a_screen_leaves_the_user_s_device_open() -> None:
    with rhi.create_device("null") as device:
        with open_screen(device, canvas="offscreen") as screen:
            assert screen.device is device
        assert not device.closed


def test_options_of_the_device_are_passed_on() -> None:
    with open_screen("null", canvas="offscreen", frames_in_flight=1, validation=True) as screen:
        assert screen.device.backend_name == "null"
    with pytest.raises(ValidationError, match=r"^\[device-argument\]"):
        open_screen("null", canvas="offscreen", depth=1)


def test_an_unknown_canvas_is_refused_with_all_names() -> None:
    with pytest.raises(ValidationError, match=r"^\[screen-canvas\]") as error:
        open_canvas("vulkan")
    assert error.value.allowed == ", ".join(CANVASES)


@pytest.mark.parametrize(
    ("kind", "module", "tip"),
    [
        ("window", "glfw", 'pip install "rhi[viewer]"'),
        ("offscreen", "rendercanvas", 'pip install "rhi[viewer]"'),
        ("qt", "PySide6", "pip install pyside6"),
        ("page", "websockets", 'pip install "rhi[viewer]"'),
        ("jupyter", "jupyter_rfb", "pip install jupyter_rfb"),
    ],
)
def test_a_missing_package_is_named_with_the_command_that_installs_it(
    kind: str, module: str, tip: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] in ("rendercanvas", module)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.delitem(sys.modules, "rhi_screen.window", raising=False)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DeviceError, match=r"^\[screen-missing\]") as error:
        open_canvas(kind)
    assert module in error.value.given
    assert tip in error.value.tip


@pytest.mark.parametrize("backend", ["null", "gl", "cl", "wgpu"])
def test_two_screens_of_one_device_show_their_own_images(backend: str) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    with (
        rhi.create_device(backend) as device,
        open_screen(device, canvas="offscreen", size=(32, 16)) as first,
        open_screen(device, canvas="offscreen", size=(20, 10)) as second,
    ):
        for shade, screen in ((0.0, first), (1.0, second)):

            def draw(screen: Screen = screen, shade: float = shade) -> None:
                image = device.texture(screen.size, rhi.Format.RGBA8)
                with device.render_pass(image, clear=(shade, 0.2, 0.4, 1.0)):
                    pass
                screen.show(image)
                image.destroy()

            screen.canvas.request_draw(draw)
        for _ in range(3):  # they take turns
            images = [np.asarray(screen.canvas.draw()) for screen in (first, second)]
        assert [image.shape[:2] for image in images] == [(16, 32), (10, 20)]
        assert [image[0, 0].tolist() for image in images] == [[0, 51, 102, 255], [255, 51, 102, 255]]
        first.close()
        assert np.asarray(second.canvas.draw())[0, 0].tolist() == [255, 51, 102, 255]
