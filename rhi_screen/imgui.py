"""Dear ImGui on a screen: it draws through rhi on any backend, and gets the screen's events.

    gui = ImGui(screen)
    def draw():
        with targets.render_pass(clear=(0, 0, 0, 1)):
            ...
        with gui.frame(targets.image):  # widgets are drawn over the image at the block's end
            imgui.begin("settings")
            _, speed = imgui.slider_float("speed", speed, 0, 10)
            imgui.end()
        screen.show(targets.image)

`imgui` is that of imgui-bundle (`pip install "rhi[imgui]"`). ImGui's arrays are read where they are, without
a copy of their own: one transient mesh for all windows, and one call for each run of commands with the same
texture.

- Events that widgets take (`wants` the pointer or the keys) reach no handlers after this one, such as
  cameras.
- Positions are logical pixels; widgets and fonts are drawn with the screen's pixel ratio.
- `ImGuiRenderer` alone draws what ImGui wants drawn, without a screen.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import groupby
from time import perf_counter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

try:
    from imgui_bundle import imgui
except ImportError as error:
    raise ImportError('rhi_screen.imgui needs imgui-bundle: pip install "rhi[imgui]"') from error

import rhi
import rhi.shading as sl
from rhi import BlendFunction, CullMode, DepthTest, DepthWrite, Filter, Format, SamplerDescriptor
from rhi.shading import Shader, Struct, Texture2D, Uniform, function, vec2, vec3, vec4
from rhi_screen.screen import Screen

__all__ = ["ImGui", "ImGuiRenderer"]

_VERTEX: Final = np.dtype([("position", "f4", 2), ("uv", "f4", 2), ("color", "u1", 4)])  # ImDrawVert
_SMOOTH: Final = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None)
_FIRST_TEXTURE_ID: Final = 1 << 30  # above all numbers of ImGui's own textures
_BUTTONS: Final = {1: 0, 2: 1, 3: 2}
_EVENTS: Final = (
    "pointer_move",
    "pointer_down",
    "pointer_up",
    "pointer_leave",
    "wheel",
    "key_down",
    "key_up",
    "char",
)
_KEYS: Final = {
    "ArrowLeft": "left_arrow",
    "ArrowRight": "right_arrow",
    "ArrowUp": "up_arrow",
    "ArrowDown": "down_arrow",
    "PageUp": "page_up",
    "PageDown": "page_down",
    "Home": "home",
    "End": "end",
    "Insert": "insert",
    "Delete": "delete",
    "Backspace": "backspace",
    " ": "space",
    "Enter": "enter",
    "Escape": "escape",
    "Tab": "tab",
    "Shift": "mod_shift",
    "Control": "mod_ctrl",
    "Alt": "mod_alt",
    "Meta": "mod_super",
    **{f"F{number}": f"f{number}" for number in range(1, 13)},
    **{str(number): f"_{number}" for number in range(10)},
    **{letter: letter for letter in "abcdefghijklmnopqrstuvwxyz"},
}


class WidgetVertex(Struct):
    """A corner in pixels from the top left, with a place in a texture and a color."""

    position: vec2
    uv: vec2
    color: vec4


class WidgetCorner(Struct):
    """The varyings between such corners."""

    clip: vec4
    uv: vec2
    color: vec4


class Display(Struct):
    """The size of the display in the units of positions, and whether the texture and the image hold sRGB:
    then what is sampled and written is linear light, while ImGui's colors are those of a screen."""

    size: vec2
    texture_is_srgb: int
    target_is_srgb: int


@function
def linear_to_srgb_color(light: vec3) -> vec3:
    """Return linear light in sRGB."""
    curve = 1.055 * sl.pow(sl.max(light, vec3(0.0031308)), vec3(1.0 / 2.4)) - 0.055
    return sl.mix(curve, light * 12.92, vec3(sl.step(light, vec3(0.0031308))))


@function
def srgb_to_linear_color(color: vec3) -> vec3:
    """Return sRGB as linear light."""
    curve = sl.pow((sl.max(color, vec3(0.04045)) + 0.055) / 1.055, vec3(2.4))
    return sl.mix(curve, color / 12.92, vec3(sl.step(color, vec3(0.04045))))


class Widgets(Shader):
    """Multiplies the color with the texture's."""

    display: Uniform[Display]
    atlas: Texture2D

    def vertex(self, v: WidgetVertex) -> WidgetCorner:
        position = v.position / self.display.size
        return WidgetCorner(
            clip=vec4(position.x * 2.0 - 1.0, 1.0 - position.y * 2.0, 0.5, 1.0), uv=v.uv, color=v.color
        )

    def fragment(self, v: WidgetCorner) -> vec4:
        texel = self.atlas.sample(v.uv)
        if self.display.texture_is_srgb == 1:
            texel = vec4(linear_to_srgb_color(texel.rgb), texel.a)
        color = v.color * texel
        if self.display.target_is_srgb == 1:
            color = vec4(srgb_to_linear_color(color.rgb), color.a)
        return color


class ImGuiRenderer:
    """Draws what the current ImGui context wants drawn, and keeps its textures, fonts among them."""

    def __init__(self, device: rhi.Device) -> None:
        self._device, self._program = device, device.program(Widgets)
        self._own: dict[int, rhi.Texture] = {}
        self._user_textures: dict[int, rhi.Texture] = {}
        imgui.get_io().backend_flags |= (
            imgui.BackendFlags_.renderer_has_textures.value
            | imgui.BackendFlags_.renderer_has_vtx_offset.value
        )

    def texture(self, texture: rhi.Texture) -> Any:
        """Reference to a texture for `imgui.image` and `imgui.image_button`, valid in this frame."""
        number = _FIRST_TEXTURE_ID + len(self._user_textures)
        self._user_textures[number] = texture
        return imgui.ImTextureRef(number)

    def draw(self, image: rhi.Texture) -> None:
        """Draw all windows over an image, in a pass of their own: after `imgui.render()`, outside of
        passes."""
        data = imgui.get_draw_data()
        self._update_textures(data)
        if data.total_idx_count:
            with self._device.event("imgui"), self._device.render_pass(image, label="imgui"):
                self._draw(data, image.format is Format.RGBA8_SRGB)
        self._user_textures.clear()

    def destroy(self) -> None:
        """Destroy the textures that ImGui has asked for, and the program."""
        for texture in self._own.values():
            texture.destroy()
        self._own.clear()
        self._program.destroy()

    def _update_textures(self, data: Any) -> None:
        """Create, change and destroy textures as ImGui asks for it."""
        for request in data.textures:
            size, number = (request.width, request.height), request.unique_id
            if request.status in (imgui.ImTextureStatus.want_create, imgui.ImTextureStatus.want_updates):
                texels = request.get_pixels_array().reshape(*reversed(size), request.bytes_per_pixel)
                part = request.update_rect
                if number not in self._own:
                    self._own[number] = self._device.texture(texels, Format.RGBA8, label="imgui")
                else:
                    changed = texels[part.y : part.y + part.h, part.x : part.x + part.w]
                    self._own[number].write(changed, x=part.x, y=part.y)
                request.set_tex_id(number)
                request.set_status(imgui.ImTextureStatus.ok)
            elif request.status == imgui.ImTextureStatus.want_destroy and request.unused_frames:
                if number in self._own:
                    self._own.pop(number).destroy()
                request.set_status(imgui.ImTextureStatus.destroyed)

    def _draw(self, data: Any, target_is_srgb: bool) -> None:
        lists = list(data.cmd_lists)
        vertices = np.concatenate([_view(draw_list.vtx_buffer, _VERTEX) for draw_list in lists])
        indices = np.concatenate([_view(draw_list.idx_buffer, np.dtype("u4")) for draw_list in lists])
        across, down = data.framebuffer_scale
        rows, first, base = [], 0, 0
        for draw_list in lists:
            for command in draw_list.cmd_buffer:
                x, y, right, bottom = command.clip_rect
                left, top = max(int(x * across), 0), max(int(y * down), 0)
                clip = (left, top, max(int(right * across) - left, 0), max(int(bottom * down) - top, 0))
                start, corner = first + command.idx_offset, base + command.vtx_offset
                rows.append((command.get_tex_id(), start, command.elem_count, corner, clip))
            first, base = first + draw_list.idx_buffer.size(), base + draw_list.vtx_buffer.size()
        mesh = self._device.transient.mesh(self._program, vertices, indices)
        size = tuple(data.display_size)
        with self._device.states(BlendFunction.ALPHA, CullMode.NONE, DepthTest.OFF, DepthWrite.OFF):
            for number, run in groupby(rows, lambda row: row[0]):
                texture = self._own.get(number) or self._user_textures.get(number)
                if texture is None or texture.destroyed:  # as if it were transparent
                    continue
                _, starts, counts, bases, clips = zip(*run, strict=True)
                draws = mesh.draws(starts, counts, base_vertex=bases)
                atlas, texture_is_srgb = texture.sampled(_SMOOTH), texture.format is Format.RGBA8_SRGB
                display = Display(
                    size=size, texture_is_srgb=int(texture_is_srgb), target_is_srgb=int(target_is_srgb)
                )
                self._device.draw_clipped(self._program, mesh, draws, clips, display=display, atlas=atlas)


class ImGui:
    """A context of ImGui on a screen, with its input and its renderer, until the screen is closed or `close`
    called."""

    def __init__(self, screen: Screen) -> None:
        self._screen = screen
        self._context = imgui.create_context()
        self._enter()
        imgui.get_io().set_ini_filename("")
        self.renderer = ImGuiRenderer(screen.device)
        self._time = perf_counter()
        self._listener = self._handle  # one object: handlers are found by identity
        screen.canvas.add_event_handler(self._listener, *_EVENTS, order=-10)

    @property
    def wants_pointer(self) -> bool:
        """True if the pointer is over a window, or holds a widget."""
        self._enter()
        return bool(imgui.get_io().want_capture_mouse)

    @property
    def wants_keys(self) -> bool:
        """True if a widget takes the keys, as a text field that is edited."""
        self._enter()
        return bool(imgui.get_io().want_capture_keyboard)

    @contextmanager
    def frame(self, image: rhi.Texture, seconds: float | None = None) -> Iterator[None]:
        """Begin a frame of widgets, which is drawn over an image at the end of the block.

        Args:
            image: as large as the screen; the block must be outside of passes.
            seconds: the time since the last frame; None: as a clock says.
        """
        self._enter()
        io, ratio, now = imgui.get_io(), self._screen.pixel_ratio, perf_counter()
        io.display_size = imgui.ImVec2(image.size[0] / ratio, image.size[1] / ratio)
        io.display_framebuffer_scale = imgui.ImVec2(ratio, ratio)
        io.delta_time = max(now - self._time if seconds is None else seconds, 1e-4)
        self._time = now
        imgui.new_frame()
        try:
            yield
        except BaseException:  # between any two calls: ImGui closes what is open, and says nothing of it
            io.config_error_recovery_enable_assert = io.config_error_recovery_enable_debug_log = False
            imgui.end_frame()
            io.config_error_recovery_enable_assert = io.config_error_recovery_enable_debug_log = True
            raise
        imgui.render()
        self.renderer.draw(image)

    def close(self) -> None:
        """Listen to no more events, and destroy the context and what it has on the device."""
        self._screen.canvas.remove_event_handler(self._listener, *_EVENTS)
        if not self._screen.device.closed:
            self._enter()
            self.renderer.destroy()
        imgui.destroy_context(self._context)

    def _enter(self) -> None:
        imgui.set_current_context(self._context)

    def _handle(self, event: dict[str, Any]) -> None:
        """Pass an event on to ImGui, and stop it if a widget takes it. Releases go on: whoever holds must
        learn it."""
        self._enter()
        io, kind = imgui.get_io(), event["event_type"]
        if kind == "pointer_leave":
            io.add_mouse_pos_event(-3.4e38, -3.4e38)
        elif kind.startswith("pointer") or kind == "wheel":
            io.add_mouse_pos_event(event["x"], event["y"])
            if kind == "wheel":
                io.add_mouse_wheel_event(-event["dx"] / 100.0, -event["dy"] / 100.0)
            elif kind != "pointer_move" and event["button"] in _BUTTONS:
                io.add_mouse_button_event(_BUTTONS[event["button"]], kind == "pointer_down")
        elif kind == "char":
            io.add_input_characters_utf8(event["data"])
        else:
            name = _KEYS.get(event["key"], _KEYS.get(event["key"].lower(), ""))
            if name:
                io.add_key_event(getattr(imgui.Key, name), kind == "key_down")
        taken = io.want_capture_keyboard if kind in ("key_down", "char") else io.want_capture_mouse
        if taken and kind in ("pointer_down", "pointer_move", "wheel", "key_down", "char"):
            event["stop_propagation"] = True
        self._screen.canvas.request_draw()


def _view(buffer: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the array in one of ImGui's vectors, without a copy."""
    size = buffer.size() * dtype.itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(buffer.data_address()), dtype)
