"""Shaders of whole targets, and the way from a pixel to the position of its surface.

A position is a *distance*, along the view, times the *ray* of the pixel, relative to the eye and along the
axes of the world. A geometry buffer stores the distance; elsewhere it follows from the depth
(`nearness_to_distance`). The numbers of all rays are computed in float64
(`renderer.techniques.parts.full_screen`), and nothing is inverted in float32. So a position is as exact 3,000
km from the world's origin as near it, with every projection: perspective with or without a far plane,
parallel, off-axis.

*Nearness* is how far a depth is from the farthest one: 0 is farthest, in both directions of depth. For
standard depth it is exact in floats where depth is coarse (1 - d for d above 1/2), so that nothing is lost on
the way back from it.
"""

from __future__ import annotations

import rhi.shading as sl
from renderer.light_kinds.incidence import safe_normalize


class PixelRays(sl.Struct):
    """The rays of a view's pixels: what is d along the view in the pixel at (x, y) is at `across @ (x, y, 1)
    * w + along * d + start`, relative to the eye. The width w of the view is d with a perspective projection
    and 1 with a parallel one: `projection.y - projection.w * d`. A nearness n is a distance of `(projection.x
    - projection.y * n) / (projection.z - projection.w * n)`.

    `size` is that of the image in pixels, `forward` the direction of the view, `far` the distance of its far
    plane, and `farthest` its depth.
    """

    across: sl.mat3
    along: sl.vec3
    start: sl.vec3
    size: sl.vec2
    forward: sl.vec3
    far: float
    farthest: float
    projection: sl.vec4


@sl.function
def depth_to_nearness(rays: PixelRays, depth: float) -> float:
    """Return the nearness of a depth: its difference from the farthest depth, so 0 for pixels without a
    surface."""
    return sl.abs(depth - rays.farthest)


@sl.function
def nearness_to_distance(rays: PixelRays, nearness: float) -> float:
    """Return the distance along the view, in metres, of this nearness."""
    return (rays.projection.x - rays.projection.y * nearness) / (
        rays.projection.z - rays.projection.w * nearness
    )


@sl.function
def pixel_position(rays: PixelRays, pixel: sl.vec2, distance: float) -> sl.vec3:
    """Return the position, relative to the eye and along the world's axes, at `distance` along the view in
    `pixel`: a `fragment_coordinate()`, or a texel plus a half."""
    width = rays.projection.y - rays.projection.w * distance
    return rays.across @ sl.vec3(pixel, 1.0) * width + (rays.along * distance + rays.start)


class ViewRayShader(sl.Shader):
    """The base of shaders that ask from where a point is seen: from the eye, or with a parallel projection
    from the plane of the eye, against the direction of the view.

    Attributes:
        has_parallel_rays: whether the view's projection is parallel. Only then is `rays` read for it.
    """

    has_parallel_rays = False

    rays: sl.Uniform[PixelRays]

    def direction_to_eye(self, position: sl.vec3) -> sl.vec3:
        """Return the unit direction in which light leaves `position`, relative to the eye, to be seen."""
        if self.has_parallel_rays:
            return -safe_normalize(self.rays.along)
        return safe_normalize(-position)

    def path_from_eye(self, position: sl.vec3) -> sl.vec3:
        """Return the way in metres on which `position` is seen, against the light: from the eye, or from its
        plane. It is 0 for what a parallel projection shows behind that plane."""
        if self.has_parallel_rays:
            return self.rays.along * sl.max(sl.dot(position, self.rays.forward), 0.0)
        return position

    def get_pixel(self) -> sl.ivec2:
        """Return the coordinates of the pixel: the fragment's, unless a derived shader overrides this."""
        return sl.ivec2(sl.fragment_coordinate().xy)


class PixelShader(ViewRayShader):
    """The base of shaders that run once for each pixel."""

    def shade_sample(self, sample: int) -> sl.vec4:
        """Return the colour of one sample of the pixel, which has a surface there; without multisampling, of
        the pixel."""
        return sl.vec4(0.0)


class BackgroundScreen(sl.FullScreen):
    """The base of shaders drawn to all pixels of a view, at the depth of its background, so that a depth test
    selects the pixels that have a surface."""

    rays: sl.Uniform[PixelRays]

    def screen_depth(self) -> float:
        return self.rays.farthest
