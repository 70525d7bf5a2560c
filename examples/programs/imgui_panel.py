"""Dear ImGui, drawn through rhi: one transient mesh for all windows, and one call for each texture.

It needs `pip install imgui-bundle`. ImGui's arrays are read where they are, without a copy of their own.
"""

from __future__ import annotations

import ctypes
from itertools import groupby
from typing import Any

import numpy as np
from frame import INTERFACE_VERTEX, Colored, Interface, Pixels, main
from imgui_bundle import imgui
from numpy.typing import NDArray

import rhi
from rhi import BlendFunction, CullMode, Filter, SamplerDescriptor
from rhi.shading import Texture2D, vec4


class Windows(Interface):
    """Multiplies the color with the texture's."""

    atlas: Texture2D

    def fragment(self, v: Colored) -> vec4:
        return v.color * self.atlas.sample(v.uv)


class ImGuiRenderer:
    """Draws what ImGui wants drawn, and keeps its textures."""

    def __init__(self, device: rhi.Device) -> None:
        self.device, self.program = device, device.program(Windows)
        self.textures: dict[int, rhi.Texture] = {}
        imgui.get_io().backend_flags |= (
            imgui.BackendFlags_.renderer_has_textures.value | imgui.BackendFlags_.renderer_has_vtx_offset.value
        )

    def update_textures(self, data: Any) -> None:
        """Create, change and destroy textures as ImGui asks for it. Call it outside of passes."""
        for wanted in data.textures:
            size, number = (wanted.width, wanted.height), wanted.unique_id
            if wanted.status in (imgui.ImTextureStatus.want_create, imgui.ImTextureStatus.want_updates):
                texels = wanted.get_pixels_array().reshape(*reversed(size), wanted.bytes_per_pixel)
                part = wanted.update_rect
                if number not in self.textures:
                    self.textures[number] = self.device.texture(texels, rhi.Format.RGBA8, label="imgui")
                else:
                    changed = texels[part.y : part.y + part.h, part.x : part.x + part.w]
                    self.textures[number].write(changed, x=part.x, y=part.y)
                wanted.set_tex_id(number)
                wanted.set_status(imgui.ImTextureStatus.ok)
            elif wanted.status == imgui.ImTextureStatus.want_destroy and wanted.unused_frames:
                self.textures.pop(number).destroy()
                wanted.set_status(imgui.ImTextureStatus.destroyed)

    def draw(self, data: Any) -> None:
        """Draw all windows in the open pass."""
        lists = list(data.cmd_lists)
        if not data.total_idx_count:
            return
        vertices = np.concatenate([view(each.vtx_buffer, INTERFACE_VERTEX) for each in lists])
        indices = np.concatenate([view(each.idx_buffer, np.dtype("u4")) for each in lists])
        rows, first, base = [], 0, 0
        for each in lists:
            for command in each.cmd_buffer:
                left, top, right, bottom = (int(edge) for edge in command.clip_rect)
                start, corner = first + command.idx_offset, base + command.vtx_offset
                clip = (left, top, max(right - left, 0), max(bottom - top, 0))
                rows.append((command.get_tex_id(), start, command.elem_count, corner, clip))
            first, base = first + each.idx_buffer.size(), base + each.vtx_buffer.size()
        mesh = self.device.transient.mesh(self.program, vertices, indices)
        screen = self.device.transient.uniform(Pixels(size=tuple(data.display_size)))
        smooth = SamplerDescriptor(Filter.LINEAR, Filter.LINEAR, None)
        with self.device.states(BlendFunction.ALPHA, CullMode.NONE):
            for number, run in groupby(rows, lambda row: row[0]):
                _, starts, counts, bases, clips = zip(*run, strict=True)
                draws = mesh.draws(starts, counts, base_vertex=bases)
                atlas = self.textures[number].sampled(smooth)
                self.device.draw_clipped(self.program, mesh, draws, clips, screen=screen, atlas=atlas)


def view(buffer: Any, dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return the array in one of ImGui's vectors, without a copy."""
    size = buffer.size() * dtype.itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(buffer.data_address()), dtype)


def show_panels(size: tuple[int, int]) -> None:
    """Submit a window of widgets, and one behind it that it covers in part."""
    for number, (x, y) in enumerate([(0.3, 0.25), (0.05, 0.05)]):
        imgui.set_next_window_pos(imgui.ImVec2(x * size[0], y * size[1]))
        imgui.set_next_window_size(imgui.ImVec2(0.6 * size[0], 0.65 * size[1]))
        imgui.begin(f"window {number}")
        imgui.text("Dear ImGui on rhi")
        imgui.button("a button")
        imgui.slider_float("roughness", 0.4, 0.0, 1.0)
        imgui.color_edit3("color", [0.9, 0.5, 0.2])
        waves = np.sin(np.linspace(0, 20, 200)).astype(np.float32)
        imgui.plot_lines("frame", waves, graph_size=imgui.ImVec2(0, 0.2 * size[1]))
        imgui.end()


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw two windows over three frames, in which ImGui finds its layout."""
    context = imgui.create_context()
    imgui.get_io().set_ini_filename("")
    renderer, image = ImGuiRenderer(device), device.texture(size, rhi.Format.RGBA8)
    for _ in range(3):
        imgui.get_io().display_size = imgui.ImVec2(*size)
        imgui.new_frame()
        show_panels(size)
        imgui.render()
        renderer.update_textures(imgui.get_draw_data())
        with device.render_pass(image, clear=(0.2, 0.25, 0.3, 1)):
            renderer.draw(imgui.get_draw_data())
        device.present(image)
    imgui.destroy_context(context)
    return image


if __name__ == "__main__":
    main(render)
