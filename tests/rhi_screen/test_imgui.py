"""Dear ImGui on a screen: what is drawn on each backend, what it costs, and who gets which event."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Format, Op

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")
imgui = pytest.importorskip("imgui_bundle", reason="no imgui-bundle: pip install rhi[imgui]").imgui

from rhi_screen import OrbitCamera, Screen, open_canvas, open_screen  # noqa: E402
from rhi_screen.imgui import ImGui  # noqa: E402

SIZE = (200, 150)
PLAIN = imgui.WindowFlags_.no_decoration | imgui.WindowFlags_.no_background


@pytest.fixture
def screen() -> Iterator[Screen]:
    with open_screen("null", canvas="offscreen", size=SIZE) as opened:
        yield opened


def show(gui: ImGui, image: rhi.Texture, widgets: Callable[[], Any], frames: int = 3) -> None:
    """Draw a few frames, in which ImGui finds its layout."""
    for _ in range(frames):
        with gui.frame(image, 1 / 60):
            imgui.set_next_window_pos(imgui.ImVec2(10, 10))
            imgui.set_next_window_size(imgui.ImVec2(120, 100))
            widgets()


def open_gui(screen: Screen) -> tuple[ImGui, rhi.Texture]:
    return ImGui(screen), screen.targets().image


def draw_panel() -> None:
    imgui.begin("panel")
    imgui.text("Ägypten")
    imgui.button("a button")
    imgui.slider_float("roughness", 0.4, 0.0, 1.0)
    imgui.end()


def draw_on(backend: str) -> np.ndarray:
    with open_screen(backend, canvas="offscreen", size=SIZE) as screen:
        gui, image = open_gui(screen)
        with screen.device.render_pass(image, clear=(0.2, 0.4, 0.6, 1)):
            pass
        show(gui, image, draw_panel)
        gui.close()
        return image.read().astype(int)


def test_widgets_are_drawn_over_the_image() -> None:
    image = draw_on("gl")
    assert (image[120:, 150:] == (51, 102, 153, 255)).all(), "beside the panel is the image"
    assert len(np.unique(image.reshape(-1, 4), axis=0)) > 20


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["cl", "wgpu"])
def test_widgets_are_the_same_image_on_each_backend(backend: str) -> None:
    """Within 2/255 where textures are filtered."""
    if not any(candidate.name == backend and candidate.usable for candidate in rhi.report()):
        pytest.skip(f"no {backend} on this machine")
    assert np.abs(draw_on(backend) - draw_on("gl")).max() <= 2


def test_a_texture_is_shown_texel_by_texel_and_cut_by_its_window() -> None:
    with open_screen("gl", canvas="offscreen", size=SIZE) as screen:
        gui, image = open_gui(screen)
        texels = np.random.default_rng(1).integers(0, 256, (400, 16, 4), np.uint8)
        texels[..., 3] = 255
        texture = screen.device.texture(texels)

        def widgets() -> None:
            imgui.begin("image", None, PLAIN)
            imgui.set_cursor_pos(imgui.ImVec2(20, 20))
            imgui.image(gui.renderer.texture(texture), imgui.ImVec2(16, 400))
            imgui.end()

        with screen.device.render_pass(image, clear=(0, 0, 0, 1)):
            pass
        show(gui, image, widgets)
        seen = image.read()
        rows = np.flatnonzero(seen[:, 30:46].any(axis=(1, 2), where=[True, True, True, False]))
        assert (rows[0], rows[-1] + 1) == (30, 109), "it is cut off at the window's border"
        assert np.array_equal(seen[30:109, 30:46], texels[:79])
        assert not seen[:, 46:, :3].any()


@pytest.mark.parametrize("texels_are_light", [True, False])
@pytest.mark.parametrize("image_is_light", [True, False])
def test_colors_are_the_same_in_linear_light(texels_are_light: bool, image_is_light: bool) -> None:
    """A texture and an image of sRGB or not: the bytes of both are those of a screen."""
    formats = {True: Format.RGBA8_SRGB, False: Format.RGBA8}
    with open_screen("gl", canvas="offscreen", size=SIZE) as screen:
        gui, image = ImGui(screen), screen.targets(formats[image_is_light]).image
        texels = np.arange(256, dtype=np.uint8).reshape(16, 16).repeat(4).reshape(16, 16, 4) | (0, 0, 0, 255)
        texture = screen.device.texture(texels.astype(np.uint8), formats[texels_are_light])

        def widgets() -> None:
            imgui.begin("image", None, PLAIN)
            imgui.set_cursor_pos(imgui.ImVec2(20, 20))
            imgui.image(gui.renderer.texture(texture), imgui.ImVec2(16, 16))
            imgui.get_window_draw_list().add_rect_filled(
                (60, 60), (80, 80), imgui.IM_COL32(200, 100, 50, 255)
            )
            imgui.end()

        with screen.device.render_pass(image, clear=(0, 0, 0, 1)):
            pass
        show(gui, image, widgets)
        seen = image.read().astype(int)
        assert np.abs(seen[30:46, 30:46] - texels).max() <= 1
        assert np.abs(seen[70, 70] - (200, 100, 50, 255)).max() <= 1


def test_a_dense_display_has_widgets_of_as_many_more_pixels() -> None:
    sizes = []
    for ratio in (1.0, 2.0):
        canvas = open_canvas("offscreen", size=SIZE, pixel_ratio=ratio)
        with Screen(canvas, "gl") as screen:
            gui, image = open_gui(screen)
            with screen.device.render_pass(image, clear=(0, 0, 0, 1)):
                pass
            show(gui, image, draw_panel)
            drawn = np.argwhere(image.read()[..., :3].any(axis=2))
            sizes.append((drawn.min(0).tolist(), drawn.max(0).tolist()))
    (begin, end), (far_begin, far_end) = sizes
    assert np.allclose(far_begin, 2 * np.array(begin), atol=1)
    assert np.allclose(np.add(far_end, 1), 2 * np.add(end, 1), atol=1)


def test_a_frame_is_one_pass_with_a_draw_for_each_rectangle_that_cuts_it(screen: Screen) -> None:
    gui, image = open_gui(screen)
    stream = screen.device.stream
    show(gui, image, draw_panel)
    stream.clear()
    show(gui, image, draw_panel, frames=1)
    counts = [len(stream.filter(op)) for op in (Op.BEGIN_PASS, Op.DRAW, Op.CREATE_TEXTURE, Op.CREATE_BUFFER)]
    assert counts == [1, 2, 0, 0], "the window's and what is in it"
    stream.clear()
    with gui.frame(image):
        pass
    assert not stream.filter(Op.BEGIN_PASS), "without a widget nothing is drawn"


def test_an_error_between_widgets_is_raised_and_the_next_frame_is_whole(screen: Screen) -> None:
    gui, image = open_gui(screen)

    def fail() -> None:
        imgui.begin("half")
        imgui.begin_child("a part")
        raise KeyError("widgets")

    with pytest.raises(KeyError, match="widgets"):
        show(gui, image, fail)
    show(gui, image, draw_panel)
    assert screen.device.stream.filter(Op.DRAW)


def test_a_click_presses_a_button_and_moves_no_camera_below_it(screen: Screen) -> None:
    gui, image = open_gui(screen)
    orbit, pressed = OrbitCamera(screen), []

    def widgets() -> None:
        imgui.begin("panel", None, PLAIN)
        pressed.append(imgui.button("a button", imgui.ImVec2(100, 80)))
        imgui.end()

    show(gui, image, widgets)
    begin = orbit.camera.position
    screen.send("pointer_move", x=60.0, y=50.0)
    show(gui, image, widgets)
    assert gui.wants_pointer
    screen.send("pointer_down", x=60.0, y=50.0, button=1, buttons=(1,))
    screen.send("pointer_move", x=64.0, y=60.0, buttons=(1,))
    show(gui, image, widgets)
    screen.send("pointer_up", x=64.0, y=60.0, button=1)
    show(gui, image, widgets)
    assert sum(pressed) == 1
    assert np.array_equal(orbit.camera.position, begin)
    screen.send("pointer_move", x=180.0, y=140.0)
    show(gui, image, widgets)
    assert not gui.wants_pointer
    screen.send("pointer_down", x=180.0, y=140.0, button=1, buttons=(1,))
    screen.send("pointer_move", x=150.0, y=140.0, buttons=(1,))
    assert not np.array_equal(orbit.camera.position, begin), "beside the panel a drag turns"


def test_typed_text_goes_into_a_text_field(screen: Screen) -> None:
    gui, image = open_gui(screen)
    text, keys = ["ab"], []
    screen.canvas.add_event_handler(lambda event: keys.append(event["key"]), "key_down")

    def widgets() -> None:
        imgui.begin("panel", None, PLAIN)
        imgui.set_keyboard_focus_here()
        text[0] = imgui.input_text("name", text[0])[1]
        imgui.end()

    screen.send("key_down", key="x")
    show(gui, image, widgets)
    assert gui.wants_keys
    for key in ("End", "Backspace"):
        screen.send("key_down", key=key)
        show(gui, image, widgets, 2)
        screen.send("key_up", key=key)
    screen.send("char", data="é")
    show(gui, image, widgets)
    assert text == ["aé"]
    assert keys == ["x"], "before there was a field"


def test_the_binding_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "rhi_screen.imgui")
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    with pytest.raises(ImportError, match=r"pip install \"rhi\[imgui\]\""):
        import rhi_screen.imgui  # noqa: F401
