"""Shaders of whole targets, and the way back from a pixel and its depth to a position.

A clip matrix and a viewport are one linear map of homogeneous coordinates. Its inverse leads from (x, y, nearness, 1)
to a position relative to the eye, for every lens: perspective with or without a far plane, orthographic, off-axis.
*Nearness* is the distance of a depth from the farthest one: 0 is farthest, in both directions of depth. For standard
depth it is exact in floats where depth is coarse (1 - d for d above 1/2), so nothing is lost in the inverse.
"""

from __future__ import annotations

from rhi.shading import Shader, Struct, abs, function, mat4, vec2, vec3, vec4, vertex_index


class PixelConstants(Struct):
    """Leads from pixels to positions: `from_pixel` @ (x, y in pixels, nearness, 1) is a position relative to the eye,
    in homogeneous coordinates. `farthest` is the depth that targets are cleared to."""

    from_pixel: mat4
    farthest: float


@function
def nearness_of(depth: float, pixels: PixelConstants) -> float:
    """Return the distance of a depth from the farthest one, which is that of pixels without a surface: 0."""
    return abs(depth - pixels.farthest)


@function
def position_at(place: vec2, nearness: float, pixels: PixelConstants) -> vec3:
    """Return the position relative to the eye, along the world's axes, of what is drawn at `place`, in pixels: those of
    `fragment_coordinate()`, or a texel plus a half."""
    position = pixels.from_pixel @ vec4(place, nearness, 1.0)
    return position.xyz / position.w


class FullScreen(Shader):
    """The base of shaders whose fragments are all pixels of a target: one triangle around it, at half the depth."""

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)
