"""Columns and their shadows: a depth pass from the sun, and a comparison sampler."""

from __future__ import annotations

import numpy as np

import rhi
import rhi.shading as sl
from rhi import Comparison, CullMode, Format, PolygonOffset, SamplerDescriptor, Wrap
from rhi.math import look_at, make_cube, perspective
from rhi_screen import save_image

SHADOW = (1024, 1024)


class Vertex(sl.Struct):
    position: sl.vec3
    normal: sl.vec3


class Box(sl.Struct):
    center: sl.vec3
    size: sl.vec3
    color: sl.vec3


class Frame(sl.Struct):
    view_projection: sl.mat4
    sun_projection: sl.mat4
    sun: sl.vec3


class Surface(sl.Struct):
    clip: sl.vec4
    normal: sl.vec3
    color: sl.vec3
    shadow_coordinates: sl.vec3


class DepthOnly(sl.Shader):
    """The boxes as the sun sees them; no fragment stage."""

    frame: sl.Uniform[Frame]
    boxes: sl.Storage[Box]

    def vertex(self, v: Vertex) -> sl.vec4:
        box = self.boxes[sl.instance_index()]
        return self.frame.sun_projection @ sl.vec4(v.position * box.size + box.center, 1.0)


class Shadowed(sl.Shader):
    """Sunlight where nothing is nearer to the sun, filtered over 2×2 texels."""

    frame: sl.Uniform[Frame]
    boxes: sl.Storage[Box]
    shadows: sl.DepthTexture2D

    def vertex(self, v: Vertex) -> Surface:
        box = self.boxes[sl.instance_index()]
        center = sl.vec4(v.position * box.size + box.center, 1.0)
        seen = (self.frame.sun_projection @ center).xyz
        return Surface(
            clip=self.frame.view_projection @ center,
            normal=v.normal,
            color=box.color,
            shadow_coordinates=sl.vec3(seen.x * 0.5 + 0.5, 0.5 - seen.y * 0.5, seen.z),
        )

    def fragment(self, s: Surface) -> sl.vec4:
        lit = max(sl.dot(sl.normalize(s.normal), self.frame.sun), 0.0)
        lit *= self.shadows.sample_compare(sl.vec2(s.shadow_coordinates.xy), s.shadow_coordinates.z)
        return sl.vec4(s.color * (0.1 + 0.9 * lit), 1.0)


def make_boxes() -> np.ndarray:
    """Return a floor and 36 columns."""
    rng = np.random.default_rng(5)
    rows = np.zeros(37, Box.dtype)
    rows[0] = ((0, -0.5, 0), (12, 0.5, 12), (0.4, 0.4, 0.35))
    x, z = np.meshgrid(np.linspace(-8, 8, 6), np.linspace(-8, 8, 6))
    height = rng.uniform(0.5, 3, 36)
    rows["center"][1:] = np.stack([x.ravel(), height, z.ravel()], axis=-1)
    rows["size"][1:] = np.stack([np.full(36, 0.5), height, np.full(36, 0.5)], axis=-1)
    rows["color"][1:] = rng.uniform(0.05, 0.7, (36, 3))
    return rows


def render(device: rhi.Device, size: tuple[int, int]) -> rhi.Texture:
    """Draw the shadow map, then the image."""
    positions, normals, _, indices = make_cube()
    mesh = device.mesh({"position": positions, "normal": normals}, indices)
    rows = make_boxes()
    boxes = device.storage(Box, rows)
    sun = np.array((0.5, 0.8, 0.3)) / np.linalg.norm((0.5, 0.8, 0.3))
    box = np.array(
        [(1 / 14, 0, 0, 0), (0, 1 / 14, 0, 0), (0, 0, 1 / 60, 1.0), (0, 0, 0, 1)]
    )  # parallel, reversed
    frame = device.uniform(
        Frame(
            view_projection=perspective(np.radians(45), size[0] / size[1]) @ look_at((14, 12, 18), (0, 1, 0)),
            sun_projection=box @ look_at(sun * 30, (0, 0, 0)),
            sun=sun,
        )
    )
    compared = SamplerDescriptor(
        wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP, mip=None, compare=Comparison.GREATER_EQUAL
    )
    shadows = device.texture(SHADOW, Format.D32F)
    image, depth = device.texture(size, Format.RGBA8_SRGB), device.texture(size, Format.D32F)
    with (
        device.render_pass(depth=shadows, clear_depth=0.0),
        device.states(CullMode.NONE, PolygonOffset(slope=-2)),
    ):
        device.draw(device.program(DepthOnly), mesh, len(rows), frame=frame, boxes=boxes)
    with device.render_pass(image, depth, clear=(0.5, 0.65, 0.85, 1), clear_depth=0.0):
        device.draw(
            device.program(Shadowed),
            mesh,
            len(rows),
            frame=frame,
            boxes=boxes,
            shadows=shadows.sampled(compared),
        )
    return image


if __name__ == "__main__":
    save_image(render)
