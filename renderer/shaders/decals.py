"""Decals in shaders: the boxes, and the grid of cells by which a point finds those around it."""

from __future__ import annotations

import rhi.shading as sl
from renderer.shaders.pixels import PixelRays


class Decal(sl.Struct):
    """A decal: the world position of its centre, `high` + `low` (two floats for each double), the matrix from offsets
    from it to its box from -0.5 to 0.5, and the array and the layer of its image.

    `axis` is the unit normal of the surfaces that face it. It fades out from angles whose cosine is `outer` + 1 /
    `fade` to those of `outer`.
    """

    to_box: sl.mat3
    high: sl.vec3
    array: int  # type: ignore[assignment]  # hides Struct.array
    low: sl.vec3
    layer: float
    axis: sl.vec3
    outer: float
    color: sl.vec3
    strength: float
    fade: float


class DecalGrid(sl.Struct):
    """The grid of cells around all decals: the world position of its corner, `high` + `low`, how many cells a metre
    has along each axis, and how many cells there are."""

    high: sl.vec3
    low: sl.vec3
    density: sl.vec3
    counts: sl.vec3


@sl.function
def step_along_plane(
    rays: PixelRays, position: sl.vec3, normal: sl.vec3, to_eye: sl.vec3, axis: sl.vec3
) -> sl.vec3:
    """Return the step of a plane's position to the next pixel along an `axis` of the image, in first order.
    It follows from the plane alone, so all techniques have the same."""
    width = rays.projection.y - rays.projection.w * sl.dot(position, rays.forward)
    step = rays.across @ axis * width
    return step - to_eye * (sl.dot(normal, step) / sl.max(sl.dot(normal, to_eye), 0.01))
