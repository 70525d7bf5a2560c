"""Shaders of whole targets, and the way from a pixel to the position of its surface.

A position is a *distance*, along the view, times the *ray* of the pixel, relative to the eye and along the axes of the
world. A geometry buffer stores the distance; elsewhere it follows from the depth (`distance_at`). The numbers of all
rays are computed in float64 (`renderer.techniques.parts.full_screen`), and nothing is inverted in float32. So a
position is as exact 3,000 km from the world's origin as near it, with every lens: perspective with or without a far
plane, parallel, off-axis.

*Nearness* is how far a depth is from the farthest one: 0 is farthest, in both directions of depth. For standard depth
it is exact in floats where depth is coarse (1 - d for d above 1/2), so that nothing is lost on the way back from it.
"""

from __future__ import annotations

import rhi.shading as sl


class PixelRays(sl.Struct):
    """The rays of a view's pixels: what is d along the view in the pixel at (x, y) is at
    `across @ (x, y, 1) * w + along * d + start`, relative to the eye. The width w of the view is d with a perspective
    lens and 1 with a parallel one: `lens.y - lens.w * d`. A nearness n is a distance of
    `(lens.x - lens.y * n) / (lens.z - lens.w * n)`.

    `size` is that of the image in pixels, `forward` the direction of the view, `far` the distance of its far plane, and
    `farthest` its depth.
    """

    across: sl.mat3
    along: sl.vec3
    start: sl.vec3
    size: sl.vec2
    forward: sl.vec3
    far: float
    farthest: float
    lens: sl.vec4


@sl.function
def nearness_of(rays: PixelRays, depth: float) -> float:
    """Return the distance of a depth from the farthest one, which is that of pixels without a surface: 0."""
    return sl.abs(depth - rays.farthest)


@sl.function
def distance_at(rays: PixelRays, nearness: float) -> float:
    """Return how far along the view something of this nearness is."""
    return (rays.lens.x - rays.lens.y * nearness) / (rays.lens.z - rays.lens.w * nearness)


@sl.function
def place_pixel(rays: PixelRays, pixel: sl.vec2, distance: float) -> sl.vec3:
    """Return the position relative to the eye, along the world's axes, of what is `distance` along the view at `pixel`:
    a `fragment_coordinate()`, or a texel plus a half."""
    width = rays.lens.y - rays.lens.w * distance
    return rays.across @ sl.vec3(pixel, 1.0) * width + (rays.along * distance + rays.start)


class PixelShader(sl.Shader):
    """The base of shaders that are run for a pixel: that of the fragment, unless a derived shader has another."""

    def find_pixel(self) -> sl.ivec2:
        """Return the pixel."""
        return sl.ivec2(sl.fragment_coordinate().xy)

    def light_sample(self, sample: int) -> sl.vec4:
        """Return the colour of a sample of the pixel that has a surface; of the pixel if it has one."""
        return sl.vec4(0.0)


class BackgroundScreen(sl.FullScreen):
    """The base of shaders whose fragments are all pixels of a view, at the depth of its background. So a depth test
    tells the pixels that have a surface."""

    rays: sl.Uniform[PixelRays]

    def screen_depth(self) -> float:
        return self.rays.farthest
