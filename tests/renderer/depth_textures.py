"""Depth textures with given contents."""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi import CullMode, DepthFunction, Format


class DepthOutput(sl.Struct):
    depth: sl.FragmentDepth


class WriteDepths(sl.Shader):
    """Writes depths from memory; the width is the first of them."""

    depths: sl.Storage[float]

    def vertex(self) -> sl.vec4:
        corner = sl.vertex_index()
        return sl.vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> DepthOutput:
        at = sl.ivec2(sl.fragment_coordinate().xy)
        return DepthOutput(depth=self.depths[1 + at.y * int(self.depths[0]) + at.x])


def create_depth_texture(device: rhi.Device, depths: np.ndarray) -> rhi.Texture:
    """Create a depth texture with these depths (h, w)."""
    height, width = depths.shape
    texture = device.texture((width, height), Format.D32F)
    with (
        device.storage(float, np.append(np.float32(width), depths).astype(np.float32)) as memory,
        device.mesh(3) as triangle,
        device.render_pass(depth=texture, clear_depth=0.5),
        device.states(CullMode.NONE, DepthFunction.ALWAYS),
    ):
        device.draw(device.program(WriteDepths), triangle, depths=memory)
    assert (texture.read() == depths).all()
    return texture
