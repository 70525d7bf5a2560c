"""Depth textures with given contents."""

from __future__ import annotations

import numpy as np

import rhi
from rhi import CullMode, DepthFunction, Format
from rhi.shading import (
    FragmentDepth,
    Shader,
    Storage,
    Struct,
    fragment_coordinate,
    ivec2,
    vec4,
    vertex_index,
)


class GivenDepth(Struct):
    depth: FragmentDepth


class PutDepth(Shader):
    """Writes depths from memory; the width is the first of them."""

    depths: Storage[float]

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> GivenDepth:
        at = ivec2(fragment_coordinate().xy)
        return GivenDepth(depth=self.depths[1 + at.y * int(self.depths[0]) + at.x])


def put_depths(device: rhi.Device, depths: np.ndarray) -> rhi.Texture:
    """Create a depth texture with these depths (h, w)."""
    height, width = depths.shape
    texture = device.texture((width, height), Format.D32F)
    with (
        device.storage(float, np.append(np.float32(width), depths).astype(np.float32)) as memory,
        device.mesh(3) as triangle,
        device.render_pass(depth=texture, clear_depth=0.5),
        device.states(CullMode.NONE, DepthFunction.ALWAYS),
    ):
        device.draw(device.program(PutDepth), triangle, depths=memory)
    assert (texture.read() == depths).all()
    return texture
